"""An emulated board in a process of its own, and its faults at a word."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import TracebackType

WITHIN_S = 30.0


class BoardProgram:
    """The program `board_emulator`; use it as a context."""

    def __init__(self, port: Path, *arguments: str) -> None:
        """Start it and wait for its port.

        Args:
            port: the link to it.
            arguments: more of its command line.
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

    def spoil(self, fault: str) -> None:
        """Let something go wrong at once, as in `unplug+5`."""
        assert self._process.stdin is not None
        self._process.stdin.write(f'{fault}\n')
        self._process.stdin.flush()

    def stop(self) -> int:
        """End it and return its exit status."""
        self._process.terminate()
        self._process.communicate(timeout=WITHIN_S)
        return self._process.returncode
