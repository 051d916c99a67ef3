"""Heading references that are wrong while every message is valid: be right, or do not converge."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from random import Random
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.bench.faults.semantic import NO_SCALE
from gyrocal_ros.data import NS_PER_S, Array, HeadingSample, ImuSample, nanoseconds
from gyrocal_ros.sim.references import KINDS, ReferenceSource
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S = 90.0
"""Length of the recordings."""
TICK_S = 0.01
"""Interval at which references are computed that have a memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Headings of a reference on a robot, n headings."""

    time_s: Array
    """(n,) stamps since the start."""
    yaw_rad: Array
    """(n,) by the reference, not wrapped."""
    robot: SimSource
    random: np.random.Generator


Change: TypeAlias = Callable[[Track, float], tuple[Array, Array]]
"""Function from a sound reference and a size to the stamps and headings of a wrong one."""


@dataclass(frozen=True, slots=True)
class ReferenceFault:
    """One way in which a heading reference is wrong."""

    sizes: tuple[float, ...]
    change: Change
    has_no_scale: bool = False
    """True if no scale factor is right."""


def _late(track: Track, size: float) -> tuple[Array, Array]:
    return track.time_s + size, track.yaw_rad


def _scattered(track: Track, size: float) -> tuple[Array, Array]:
    return track.time_s + size * track.random.standard_normal(len(track.time_s)), track.yaw_rad


def _in_steps(track: Track, size: float) -> tuple[Array, Array]:
    step = math.radians(size)
    return track.time_s, step * np.round(track.yaw_rad / step)


def _smoothed(track: Track, size: float) -> tuple[Array, Array]:
    """Return headings behind a filter of first order with time constant `size`."""
    time_s = np.arange(0.0, DURATION_S, TICK_S)
    passed = np.interp(time_s, track.time_s, track.yaw_rad)
    for k in range(1, len(passed)):
        passed[k] = passed[k - 1] + (passed[k] - passed[k - 1]) * (1.0 - math.exp(-TICK_S / size))
    return track.time_s, np.interp(track.time_s, time_s, passed)


def _chosen(track: Track, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
    return track.time_s[chosen], track.yaw_rad[chosen]


def _lost(track: Track, size: float) -> tuple[Array, Array]:
    return _chosen(track, track.random.random(len(track.time_s)) >= size)


def _with_gaps(track: Track, size: float) -> tuple[Array, Array]:
    return _chosen(track, track.time_s % 10.0 >= size)


def _slow(track: Track, size: float) -> tuple[Array, Array]:
    """Return headings once in `size` seconds."""
    return _chosen(track, np.diff(np.floor(track.time_s / size), prepend=-1.0) > 0.0)


def _jumping(track: Track, size: float) -> tuple[Array, Array]:
    """Jump by `size` degrees to a random side, every twenty seconds."""
    jumps = math.radians(size) * track.random.choice([-1.0, 1.0], math.ceil(DURATION_S / 20.0) + 1)
    return track.time_s, track.yaw_rad + np.cumsum(jumps)[(track.time_s / 20.0).astype(int)]


def _frozen(track: Track, size: float) -> tuple[Array, Array]:
    """Repeat one heading from half of the recording on, for `size` seconds."""
    since_s = track.time_s - DURATION_S / 2.0
    first = int(np.searchsorted(since_s, 0.0))
    return track.time_s, np.where((since_s >= 0.0) & (since_s < size), track.yaw_rad[first], track.yaw_rad)


def _repeated(track: Track, size: float) -> tuple[Array, Array]:
    """Publish every heading `size` times."""
    return track.time_s, track.yaw_rad[np.arange(len(track.time_s)) // int(size) * int(size)]


def _with_outliers(track: Track, size: float) -> tuple[Array, Array]:
    is_outlier = track.random.random(len(track.time_s)) < size
    return track.time_s, track.yaw_rad + is_outlier * track.random.normal(0.0, 0.5, len(is_outlier))


def _wandering(track: Track, size: float) -> tuple[Array, Array]:
    """Add a random walk of `size` deg/sqrt(s)."""
    steps = np.sqrt(np.diff(track.time_s, prepend=0.0)) * track.random.standard_normal(len(track.time_s))
    return track.time_s, track.yaw_rad + math.radians(size) * np.cumsum(steps)


def _slipping(track: Track, size: float) -> tuple[Array, Array]:
    """Add the walk of wheels that slip at random while they turn: `size` degrees in a turn of a radian."""
    turns = np.abs(np.diff(track.yaw_rad, prepend=track.yaw_rad[0]))
    steps = np.sqrt(turns) * track.random.standard_normal(len(turns))
    return track.time_s, track.yaw_rad + math.radians(size) * np.cumsum(steps)


def _near_iron(track: Track, size: float) -> tuple[Array, Array]:
    """Add an error of `size` degrees that depends on the heading."""
    return track.time_s, track.yaw_rad + math.radians(size) * np.sin(track.yaw_rad)


def _of_two(track: Track, size: float) -> tuple[Array, Array]:
    """Take the headings of two references in turn that differ by `size` degrees."""
    return track.time_s, track.yaw_rad + math.radians(size) * (np.arange(len(track.time_s)) % 2)


def _of_the_gyro(track: Track, size: float) -> tuple[Array, Array]:
    """Integrate the gyro without its bias at rest, weighted with `size` beside the truth."""
    imu = [item for item in track.robot.board_measurements() if isinstance(item, ImuSample)]
    time_s = np.array([item.t_ns - track.robot.span.start_ns for item in imu]) / NS_PER_S
    rate = np.array([item.rate_rad_s[2] for item in imu])
    rate -= rate[time_s < 0.4].mean()
    true = track.robot.truth.trajectory.motion(time_s).euler_rad[:, 2]
    turned = np.cumsum(rate * np.diff(time_s, prepend=0.0))
    return track.time_s, np.interp(track.time_s, time_s, size * turned + (1.0 - size) * true)


REFERENCE_FAULTS: dict[str, ReferenceFault] = {
    'headings late': ReferenceFault((-0.2, 0.05, 0.4), _late),
    'heading stamps jitter': ReferenceFault((0.005, 0.02, 0.06), _scattered),
    'headings in steps': ReferenceFault((0.1, 1.0, 5.0), _in_steps),
    'headings smoothed': ReferenceFault((0.03, 0.3, 1.0), _smoothed),
    'headings lost': ReferenceFault((0.3, 0.9), _lost),
    'headings with gaps': ReferenceFault((3.0, 8.0), _with_gaps),
    'headings slow': ReferenceFault((1.0, 2.0), _slow),
    'headings jump': ReferenceFault((2.0, 20.0, 90.0), _jumping),
    'headings frozen': ReferenceFault((2.0, 20.0), _frozen),
    'headings repeated': ReferenceFault((2.0, 10.0), _repeated),
    'heading outliers': ReferenceFault((0.05, 0.3), _with_outliers),
    'headings wander': ReferenceFault((0.5, 2.0), _wandering),
    'headings of wheels that slip': ReferenceFault((1.0, 5.0), _slipping),
    'headings near iron': ReferenceFault((1.0, 5.0), _near_iron),
    'headings of two references': ReferenceFault((2.0, 30.0), _of_two),
    'headings inverted': ReferenceFault((1.0,), lambda track, size: (track.time_s, -track.yaw_rad), True),
    'headings in degrees': ReferenceFault(
        (1.0,), lambda track, size: (track.time_s, np.degrees(np.angle(np.exp(1j * track.yaw_rad)))), True
    ),
    'headings of the gyro': ReferenceFault((0.7, 1.0), _of_the_gyro, True),
}
"""The faults by name."""


def write_faulty_reference(name: str, size: float, seed: int, folder: Path) -> tuple[Path, float]:
    """Simulate a robot with a heading reference, make that wrong, and write the recording.

    Args:
        name: one of `REFERENCE_FAULTS`.
        size: its size.
        seed: draws robot, room, drive, sensors and the kind of the reference.
        folder: folder of the new bag.

    Returns:
        The bag, and the true scale factor at its end; NaN where no value is right.
    """
    robot = SimSource(replace(varied_scenario(seed), duration_s=DURATION_S), seed)
    source = ReferenceSource(robot, list(KINDS)[seed % len(KINDS)])
    sound = [item for item in source.measurements() if isinstance(item, HeadingSample)]
    others = [item for item in source.measurements() if not isinstance(item, HeadingSample)]
    start_ns, fault = robot.span.start_ns, REFERENCE_FAULTS[name]
    track = Track(
        np.array([item.t_ns - start_ns for item in sound]) / NS_PER_S,
        np.unwrap([item.yaw_rad for item in sound]),
        robot,
        np.random.default_rng(Random(f'{name} {size} {seed}').getrandbits(64)),
    )
    time_s, yaw_rad = fault.change(track, size)
    headings = sorted(
        (
            HeadingSample(start_ns + nanoseconds(at_s), math.remainder(yaw, 2.0 * math.pi))
            for at_s, yaw in zip(time_s.tolist(), yaw_rad.tolist(), strict=True)
        ),
        key=attrgetter('t_ns'),
    )
    with new_bag(folder / 'bag') as bag:
        bag.write_rig(source.rig, start_ns, R_bi=np.eye(3))
        for sample in heapq.merge(others, headings, key=attrgetter('t_ns')):
            bag.write(sample)
    return folder / 'bag', NO_SCALE if fault.has_no_scale else source.truth.scale_factor
