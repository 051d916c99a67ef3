"""Long work in a process of its own, so that the page answers at once and a task can be cancelled.

A studio has one such process, which executes one task after the other. Tasks arrive over a pipe; progress
and results go back over the same pipe. The process ends with the studio.
"""

from __future__ import annotations

import signal
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Lock, Thread
from typing import Any

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio.executor import Cancelled, TaskExecutor
from gyrocal_ros.studio.tasks import Failed, Listener, Task, TaskMessage

ENDED, RESTART = 'the worker process has ended', 'start the studio again, nothing is lost'


class Worker:
    """The worker process, as seen from the studio. It forks: make it before any thread is started."""

    def __init__(self) -> None:
        context = get_context('fork')
        self._pipe, other_end = context.Pipe()
        self._cancelled = context.Value('l', 0)
        self._process = context.Process(
            target=_run_tasks,
            args=(other_end, self._pipe, self._cancelled),
            name='gyrocal studio',
            daemon=True,
        )
        self._process.start()
        other_end.close()
        self._lock, self._count = Lock(), 0

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid or 0

    def listen(self, listener: Listener) -> None:
        """Pass all messages to a listener, in a thread of its own."""
        Thread(target=self._listen, args=(listener,), name='worker messages', daemon=True).start()

    def submit(self, task: Task) -> int:
        """Queue a task; return its number, which is larger than all earlier ones.

        Raises:
            GyrocalError: the process has ended.
        """
        with self._lock:
            self._count += 1
            try:
                self._pipe.send((self._count, task))
            except OSError as error:
                raise GyrocalError(ENDED, todo=RESTART) from error
            return self._count

    def cancel(self) -> None:
        """Stop all tasks that have been submitted."""
        self._cancelled.value = self._count

    def close(self) -> None:
        """End the process."""
        self.cancel()
        self._process.terminate()
        self._process.join(2.0)

    def _listen(self, listener: Listener) -> None:
        try:
            while True:
                listener(*self._pipe.recv())
        except (EOFError, OSError):
            listener(self._count, Failed(f'{ENDED}; {RESTART}'))


def _run_tasks(pipe: Connection, other_end: Connection, cancelled: Any) -> None:
    """Execute tasks until the studio closes the pipe."""
    other_end.close()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the studio decides when to end
    executor = TaskExecutor()
    with suppress(EOFError, OSError):
        while True:
            number, task = pipe.recv()

            def send(message: TaskMessage, number: int = number) -> None:
                if cancelled.value >= number:
                    raise Cancelled
                pipe.send((number, message))

            pipe.send((number, executor.execute(task, send)))
