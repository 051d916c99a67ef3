"""Simulated heading references in place of the ceiling camera."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import NS_PER_S, Array, HeadingSample, Measurement, Rig, Span
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.sensors import stream
from gyrocal_ros.sim.trajectory import TrueMotion
from gyrocal_ros.sim.world import START_NS, SimSource, SimTruth

Bounds = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ReferenceKind:
    """A kind of heading reference: bounds between which the seed draws its properties."""

    about: str
    rate_hz: Bounds
    white_deg: Bounds
    """White noise of a heading."""
    walk_deg: Bounds
    """Random walk, deg/sqrt(s)."""
    outliers: Bounds
    """Part of the headings whose white noise is `OUTLIER_FACTOR` times as large."""
    offset_s: Bounds
    """Stamp minus true time."""
    gaps_per_min: float
    jumps_per_min: float
    jump_deg: float = 0.0
    """Standard deviation of a jump."""
    holds_at_rest: bool = False
    """True if the heading of a robot at rest does not change at all."""


REST_M_S, REST_RAD_S = 1e-3, 1e-4
"""Speed and yaw rate below which the robot is at rest."""
OUTLIER_FACTOR = 6.0
"""Standard deviation of the outliers, in white noises."""
GAP_S = (0.5, 15.0)
"""Bounds of the length of a gap."""

KINDS = {
    'mocap': ReferenceKind(
        'optical motion capture', (50, 120), (0.01, 0.1), (0.003, 0.05), (0.0, 0.05), (-0.02, 0.02), 0.3, 0.0
    ),
    'lidar': ReferenceKind(
        'lidar localisation', (8, 25), (0.2, 0.8), (0.05, 0.5), (0.0, 0.1), (0.0, 0.1), 0.3, 0.3, 5.0
    ),
    'visual': ReferenceKind(
        'visual odometry', (8, 30), (0.02, 0.2), (0.05, 0.3), (0.0, 0.05), (0.0, 0.12), 0.5, 0.2, 3.0
    ),
    'compass': ReferenceKind(
        'calibrated compass', (5, 50), (0.5, 2.0), (0.05, 0.5), (0.0, 0.1), (-0.02, 0.05), 0.1, 0.0
    ),
    'encoders': ReferenceKind(
        'wheel encoders without slip',
        (20, 50),
        (0.01, 0.1),
        (0.1, 0.6),
        (0.0, 0.02),
        (0.0, 0.03),
        0.1,
        0.0,
        holds_at_rest=True,
    ),
}


@dataclass(frozen=True, slots=True)
class DrawnReference:
    """Properties of one simulated reference."""

    rate_hz: float
    white_rad: float
    walk_rad: float
    outliers: float
    offset_s: float
    gaps_s: tuple[Bounds, ...]
    """Beginning and end of each gap."""
    jumps: tuple[Bounds, ...]
    """Time (s) and size (rad) of each jump."""
    holds_at_rest: bool
    """True if neither noise nor walk goes on at rest."""


def find_kind(name: str) -> ReferenceKind:
    """Return the kind of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in KINDS:
        raise ConfigError(f'no reference {name!r}', where='--reference', todo=did_you_mean(name, KINDS))
    return KINDS[name]


def draw_reference(kind: ReferenceKind, duration_s: float, rng: np.random.Generator) -> DrawnReference:
    """Draw the properties of a reference."""
    gaps = rng.uniform(0.0, duration_s, rng.poisson(kind.gaps_per_min * duration_s / 60.0))
    jumps = rng.uniform(0.0, duration_s, rng.poisson(kind.jumps_per_min * duration_s / 60.0))
    white, walk = (
        math.radians(math.exp(rng.uniform(*np.log(bounds)))) for bounds in (kind.white_deg, kind.walk_deg)
    )
    return DrawnReference(
        rate_hz=float(rng.uniform(*kind.rate_hz)),
        white_rad=white,
        walk_rad=walk,
        outliers=float(rng.uniform(*kind.outliers)),
        offset_s=float(rng.uniform(*kind.offset_s)),
        gaps_s=tuple((start, start + rng.uniform(*GAP_S)) for start in sorted(gaps.tolist())),
        jumps=tuple(
            (time_s, math.radians(kind.jump_deg) * rng.normal()) for time_s in sorted(jumps.tolist())
        ),
        holds_at_rest=kind.holds_at_rest,
    )


class ReferenceSource:
    """A simulated robot with a heading reference in place of its ceiling camera.

    Args:
        robot: the robot.
        kind: name of the kind of reference; the seed of the robot draws its properties.

    Raises:
        ConfigError: there is no such kind.
    """

    def __init__(self, robot: SimSource, kind: str) -> None:
        self.robot, self._kind = robot, kind
        rng = stream(robot.seed, f'reference {kind}')
        self.reference = draw_reference(find_kind(kind), robot.scenario.duration_s, rng)
        """Properties of the reference."""

    @property
    def name(self) -> str:
        """Scenario, seed and kind of reference."""
        return f'{self.robot.name}-{self._kind}'

    @property
    def rig(self) -> Rig:
        """Geometry without a camera."""
        return replace(self.robot.rig, camera=None)

    @property
    def span(self) -> Span:
        """Interval from the first IMU sample to the end."""
        return self.robot.span

    @property
    def truth(self) -> SimTruth:
        """The truth of this recording."""
        return self.robot.truth

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements in the order of their stamps."""
        parts = (self.robot.board_measurements(), self._headings(), self.robot.truth_poses())
        return heapq.merge(*parts, key=attrgetter('t_ns'))

    def _headings(self) -> Iterator[HeadingSample]:
        drawn, rng = self.reference, stream(self.robot.seed, f'headings {self._kind}')
        time_s = np.arange(0.004, self.robot.scenario.duration_s, 1.0 / drawn.rate_hz)
        motion = self.truth.trajectory.motion(time_s)
        errors = _errors(time_s, is_at_rest(motion) if drawn.holds_at_rest else None, drawn, rng)
        yaw_rad = motion.euler_rad[:, 2] + errors
        present = np.ones(len(time_s), bool)
        for start_s, end_s in drawn.gaps_s:
            present &= (time_s < start_s) | (time_s >= end_s)
        wrapped = np.angle(np.exp(1j * (yaw_rad + rng.uniform(-math.pi, math.pi))))
        stamps = START_NS + np.round((time_s + drawn.offset_s) * NS_PER_S).astype(np.int64)
        yield from map(HeadingSample, stamps[present].tolist(), wrapped[present].tolist())


def is_at_rest(motion: TrueMotion) -> NDArray[np.bool_]:
    """Return (n,) True where the robot neither drives nor turns."""
    return (np.abs(motion.speed_m_s) < REST_M_S) & (np.abs(motion.rate_rad_s[:, 2]) < REST_RAD_S)


def _errors(
    time_s: Array, held: NDArray[np.bool_] | None, drawn: DrawnReference, rng: np.random.Generator
) -> Array:
    """Draw the errors (n,) of headings: random walk, white noise with outliers, and jumps.

    Args:
        time_s: (n,) times.
        held: (n,) True where the heading stays as it is; None for nowhere.
        drawn: properties of the reference.
        rng: source of the noise.
    """
    moved_s = np.diff(time_s, prepend=time_s[0])
    if held is not None:
        moved_s[held] = 0.0
    steps = drawn.walk_rad * np.sqrt(moved_s)
    wide = np.where(rng.random(len(time_s)) < drawn.outliers, OUTLIER_FACTOR, 1.0)
    errors: Array = np.cumsum(steps * rng.standard_normal(len(time_s)))
    white = wide * rng.standard_normal(len(time_s))
    if held is not None:
        white = white[np.maximum.accumulate(np.where(held, 0, np.arange(len(time_s))))]
    errors += drawn.white_rad * white
    for at_s, size_rad in drawn.jumps:
        errors[time_s >= at_s] += size_rad
    return errors
