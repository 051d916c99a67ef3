"""Runs of the filter with many models: none is repeated, and independent ones happen side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.workers import Workers

T = TypeVar('T')

Calibrate = Callable[[SensorModel, tuple[Effect, ...]], Run]
"""Runs the filter with a model and with candidate effects."""
MOST_REMEMBERED = 16
"""Number of runs that are remembered."""


def remembered(calibrate: Calibrate, workers: Workers | None = None) -> Calibrate:
    """Return a function that does not repeat one of the latest runs.

    A search comes back to the same model: to an effect that a run has rejected, or to the law that is
    likeliest in place of a noise. The number of a revision makes no difference to a run.

    Args:
        calibrate: runs the filter.
        workers: the processes that do it, for tasks `side_by_side`; None without.
    """
    return _Remembered(calibrate, workers)


class _Remembered:
    def __init__(self, calibrate: Calibrate, workers: Workers | None) -> None:
        self.workers = workers
        self._calibrate, self._run = calibrate, lru_cache(MOST_REMEMBERED)(calibrate)

    def __call__(self, model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        key = replace(model, version=0), candidates
        if not _have_hash(key):
            return self._calibrate(model, candidates)
        return replace(self._run(*key), model=model)


def side_by_side(calibrate: Calibrate, tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Return the results of tasks that run the filter and do not need each other, in order.

    They use several cores where the runs have processes for that. The results are the same.
    """
    workers = calibrate.workers if isinstance(calibrate, _Remembered) else None
    return [task() for task in tasks] if workers is None else workers.side_by_side(tasks)


def _have_hash(key: object) -> bool:
    """Return False for an effect of one's own that is no frozen dataclass: it may have changed."""
    with suppress(TypeError):
        hash(key)
        return True
    return False
