"""Simulated recordings for tests, and modifications of them."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from gyrocal_ros.data import ClockStep, FeatureObservations, Measurement, Rig, Source, Span, nanoseconds
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

Modification = Callable[[Iterable[Measurement]], Iterator[Measurement]]


class KeptSource(SimSource):
    """A simulated recording that is simulated once for several runs of the filter."""

    def measurements(self) -> Iterator[Measurement]:
        return iter(_measured(self))


@lru_cache(maxsize=4)
def _measured(source: KeptSource) -> tuple[Measurement, ...]:
    return tuple(SimSource.measurements(source))


@cache
def recording(
    scenario: str = 'cleaning',
    seed: int = 1,
    duration_s: float = 60.0,
    hidden: tuple[HiddenEffect, ...] = (),
    **changes: Any,
) -> SimSource:
    """Return a short recording of a scenario with slow sensors and some changed fields."""
    changes = {'duration_s': duration_s, 'imu_hz': 100, 'camera_hz': 5, **changes}
    return KeptSource(replace(find_scenario(scenario), **changes), seed, hidden=hidden)


@dataclass(frozen=True)
class ModifiedSource:
    """A source whose measurements are modified."""

    source: Source
    change: Modification
    other_rig: Rig | None = None

    @property
    def name(self) -> str:
        return f'changed {self.source.name}'

    @property
    def rig(self) -> Rig:
        return self.other_rig or self.source.rig

    @property
    def span(self) -> Span:
        return self.source.span

    def measurements(self) -> Iterator[Measurement]:
        return self.change(self.source.measurements())


def at(time_s: float) -> int:
    """Return the stamp of a time of a simulated recording."""
    return START_NS + nanoseconds(time_s)


def without(kind: type[Any], from_s: float = -1.0, to_s: float = 1e6) -> Modification:
    """Omit one kind of measurement during an interval."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for item in measurements:
            if not (isinstance(item, kind) and at(from_s) < item.t_ns < at(to_s)):
                yield item

    return change


def each(kind: type[Any], function: Callable[[Any], Measurement]) -> Modification:
    """Replace each measurement of one kind."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for item in measurements:
            yield function(item) if isinstance(item, kind) else item

    return change


def with_clock_step(step_s: float, at_s: float) -> Modification:
    """Let the clock of all stamps step."""
    step_ns = nanoseconds(step_s)

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        stepped = False
        for item in measurements:
            if item.t_ns < at(at_s):
                yield item
                continue
            if not stepped:
                yield ClockStep(item.t_ns + step_ns, step_ns)
                stepped = True
            yield replace(item, t_ns=item.t_ns + step_ns)

    return change


def with_features_of(other: Source, late_s: float = 0.0) -> Modification:
    """Replace the features by those of another recording, or by delayed ones of the same one."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        features = (item for item in other.measurements() if isinstance(item, FeatureObservations))
        late = (replace(item, t_ns=item.t_ns + nanoseconds(late_s)) for item in features)
        others = (item for item in measurements if not isinstance(item, FeatureObservations))
        return heapq.merge(others, late, key=attrgetter('t_ns'))

    return change


def random_pixels(item: FeatureObservations) -> FeatureObservations:
    """Move features to random pixels."""
    rng = np.random.default_rng(item.t_ns % 2**32)
    return replace(item, pixels=rng.uniform(0.0, 480.0, item.pixels.shape))
