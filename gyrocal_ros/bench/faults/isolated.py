"""Runs a function in a process of its own, with limits on time and memory."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MAX_CPU_S, MAX_WALL_S = 60, 600.0
"""Limits of one case: processor time, and time by the clock, which a busy machine stretches."""
MAX_MEMORY_BYTES = 1_500_000_000
"""Limit of the resident memory of one case."""
POLL_S = 0.005


@dataclass(frozen=True, slots=True)
class Outcome:
    """End of a process."""

    status: int
    """Exit status; negative: the signal that ended it."""
    output: str
    errors: str
    peak_bytes: int
    """Largest resident memory."""

    @property
    def exceeds_limits(self) -> bool:
        """True if the process took too much time or memory."""
        return self.status in (-signal.SIGXCPU, -signal.SIGKILL) or self.peak_bytes > MAX_MEMORY_BYTES


def run_isolated(work: Callable[[], int], *, kill_after_s: float | None = None) -> Outcome:
    """Run a function in a fork of this process, which must not have threads.

    Args:
        work: the function; its result is the exit status.
        kill_after_s: time after which the process is killed; None for never.
    """
    with tempfile.TemporaryDirectory() as folder:
        output, errors = Path(folder) / 'output', Path(folder) / 'errors'
        sys.stdout.flush()
        sys.stderr.flush()
        process = os.fork()
        if process == 0:
            _in_child(work, output, errors)
        end_s = time.monotonic() + (MAX_WALL_S if kill_after_s is None else kill_after_s)
        while True:
            ended, wait_status, usage = os.wait4(process, os.WNOHANG)
            if ended:
                break
            if time.monotonic() > end_s:
                os.kill(process, signal.SIGKILL)
                end_s = float('inf')
            time.sleep(POLL_S)
        printed, said = (f.read_text(errors='replace') if f.exists() else '' for f in (output, errors))
        return Outcome(os.waitstatus_to_exitcode(wait_status), printed, said, usage.ru_maxrss * 1024)


def _in_child(work: Callable[[], int], output: Path, errors: Path) -> None:
    """Do the work and end the process, without the handlers of the parent."""
    status = 1
    try:
        for number, file in ((1, output), (2, errors)):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), number)
        sys.stdout = os.fdopen(1, 'w', closefd=False)  # those of the parent may be replaced, as by pytest
        sys.stderr = os.fdopen(2, 'w', closefd=False)
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        status = work()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
