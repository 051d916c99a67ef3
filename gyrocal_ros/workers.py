"""Processes for independent runs of one function, on several cores.

They are forked from this process when they are first needed, so they share the recording that it has in
memory. Each task waits for its run in a thread of its own, and may need one run after the other.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_all_start_methods, get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.queues import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from gyrocal_ros.errors import GyrocalError

T = TypeVar('T')

_function: Callable[..., Any]
"""What a forked process calls."""


class Workers:
    """A function, and the processes that call it; a context, which ends them.

    Args:
        function: its arguments and results pass between processes, so they can be pickled.
        count: number of processes; with 1 everything happens in this one.
        begin: called once in each process, with its number from 0.
    """

    def __init__(
        self, function: Callable[..., Any], count: int, begin: Callable[[int], None] = lambda number: None
    ) -> None:
        self._function, self._begin = function, begin
        self._count = count if 'fork' in get_all_start_methods() else 1
        self._pool: ProcessPoolExecutor | None = None
        self._processes: set[BaseProcess] = set()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def call(self, *arguments: Any) -> Any:
        """Call the function, in another process once there are some.

        Raises:
            GyrocalError: the process was ended from outside.
        """
        if self._pool is None:
            return self._function(*arguments)
        try:
            return self._pool.submit(_call, *arguments).result()
        except BrokenProcessPool as error:
            raise GyrocalError(
                'a process that ran the filter was ended', todo='free some memory, or use --jobs 1'
            ) from error

    def side_by_side(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """Return the results of independent tasks, in order; they make their calls at the same time.

        Where one raises an error, the first such error is raised once all have ended.
        """
        if self._count == 1 or len(tasks) < 2:
            return [task() for task in tasks]
        if self._pool is None:
            self._start()
        try:
            ended = [_in_thread(task) for task in tasks]
            wait(ended)
        except KeyboardInterrupt:
            self.end()
            raise
        return [future.result() for future in ended]

    def end(self) -> None:
        """End the processes, and with them what they do."""
        for process in self._processes:
            process.terminate()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _start(self) -> None:
        """Fork all processes now, while this one has no threads whose locks they would inherit."""
        others, context = set(active_children()), get_context('fork')
        numbers: SimpleQueue[int] = context.SimpleQueue()
        for number in range(self._count):
            numbers.put(number)
        self._pool = ProcessPoolExecutor(
            self._count, context, _start_process, (self._function, self._begin, numbers)
        )
        self._pool.submit(os.getpid).result()
        self._processes = set(active_children()) - others


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1


def _in_thread(task: Callable[[], T]) -> Future[T]:
    """Run a task in a thread that does not keep the program from ending."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(task())
        except BaseException as error:
            future.set_exception(error)

    Thread(target=run, daemon=True).start()
    return future


def _start_process(
    function: Callable[..., Any], begin: Callable[[int], None], numbers: SimpleQueue[int]
) -> None:
    """Begin the life of a process: an interrupt is its parent's to handle, and it ends with its parent."""
    global _function
    _function = function
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    Thread(target=_end_with_parent, daemon=True).start()
    begin(numbers.get())


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _call(*arguments: Any) -> Any:
    return _function(*arguments)
