"""An emulated board in a separate process, with fault injection."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import TracebackType

WITHIN_S = 30.0
"""Timeout for the end of the program."""


class BoardProgram:
    """The program `board_emulator`, used as a context manager."""

    def __init__(self, port: Path, *arguments: str) -> None:
        """Start the program and wait for its port.

        Args:
            port: the link to it.
            arguments: further command line arguments.
        """
        command = [sys.executable, '-m', 'gyrocal_ros.cli.board_emulator', '--link', str(port), *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == str(port)

    def __enter__(self) -> BoardProgram:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def inject_fault(self, fault: str) -> None:
        """Inject a fault immediately, as in `unplug+5`."""
        assert self._process.stdin is not None
        self._process.stdin.write(f'{fault}\n')
        self._process.stdin.flush()

    def stop(self) -> int:
        """Stop the program and return its exit status."""
        self._process.terminate()
        self._process.communicate(timeout=WITHIN_S)
        return self._process.returncode
