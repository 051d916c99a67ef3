"""Drives of memories, and the filters that a memory is made of: for learned effects and those of your own."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import recorded
from gyrocal_ros.effects.learned.signals import RATE, values_of
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.sensor import Memory

DYNAMICS, ABS_RATE, SIDE = 'dynamics', 'abs_rate', 'turn_side'
LAST_TURN, ANY_TURN, LAST_REST = 'last_turn', 'any_turn', 'last_rest'
MOVING, START = 'moving', 'start'
TURNING_RAD_S = math.radians(5.0)
"""Rate above which the robot is in a turn."""
MOVING_M_S = 0.02
"""Speed above which the robot drives."""
REST_S = 1.0
"""Time for which a robot stands that rests: it also stops for a moment between straight ways and turns."""
ONSET_S = 0.3
"""Time in which a turn sets in, to show the dynamics."""
SMOOTHED_S = 0.02
"""Time constant of the low-passes of a derivative of the rate."""


def start_of_turn(time_s: Array, derivative: int = 0) -> Array:
    """Return the rate (n,) of a turn to 1 rad/s that sets in smoothly within `ONSET_S`, or a derivative.

    A polynomial of the fifth order, whose second derivative is continuous.
    """
    part = np.clip(time_s / ONSET_S, 0.0, 1.0)
    smooth = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    rate: Array = smooth.deriv(derivative)(part) / ONSET_S**derivative
    return rate


def driven(drive: str, block: MotionBlock, first: float | None) -> tuple[Array, float | None]:
    """Return the drive (N,) of a memory; zero where it is not recorded.

    Args:
        drive: `rate`, `abs_rate`, `turn_side` or `moving`, or a signal, which counts from its first value.
        first: that value; None before it is known.

    Returns:
        The drive, and the first value.
    """
    if drive in (RATE, ABS_RATE, SIDE, MOVING):
        return motion_drive(drive, block), None
    values = values_of(drive, block)
    known = values[~np.isnan(values)]
    if first is None:
        first = float(known[0]) if len(known) else None
    return recorded(values - (first or 0.0)), first


def lag(drive: Array, dt_s: Array, tau_s: float, start: float | None) -> tuple[Array, float]:
    """Solve `dh/dt = (u - h) / tau` for a drive (N,).

    Returns:
        h (N,) in the middle of the intervals, and at the end of the last one, where the next block starts.
    """
    h = low_pass(drive[:, None], kept_of_steady(dt_s, tau_s), np.array([start or 0.0]))[:, 0]
    return 0.5 * (h[1:] + h[:-1]), float(h[-1])


def since_turn(block: MotionBlock, memory: Memory) -> tuple[Array, Array, Memory]:
    """Return the side (N,) of the last turn and the time (N,) since its end.

    The side is 0 before the first turn; the time is 0 within a turn. The memory comes third.
    """
    last, elapsed_s = memory if memory is not None else (0.0, 0.0)
    sides, times_s = np.empty(len(block.dt_s)), np.empty(len(block.dt_s))
    for row, (side, dt_s) in enumerate(
        zip(side_of(block.rate_rad_s[:, 2]).tolist(), block.dt_s.tolist(), strict=True)
    ):
        last, elapsed_s = (side, 0.0) if side else (last, elapsed_s + dt_s)
        sides[row], times_s[row] = last, elapsed_s
    return sides, times_s, (last, elapsed_s)


def since_rest(block: MotionBlock, memory: Memory) -> tuple[Array, Array, Memory]:
    """Return 1 (N,) where the robot drives, else 0, and the time (N,) since it last rested.

    It has rested before the first block. The memory comes third.
    """
    stood_s, elapsed_s = memory if memory is not None else (REST_S, 0.0)
    drives, times_s = np.empty(len(block.dt_s)), np.empty(len(block.dt_s))
    for row, (is_moving, dt_s) in enumerate(zip(moves(block).tolist(), block.dt_s.tolist(), strict=True)):
        if is_moving and stood_s >= REST_S:
            elapsed_s = 0.0
        stood_s, elapsed_s = 0.0 if is_moving else stood_s + dt_s, elapsed_s + dt_s
        drives[row], times_s[row] = stood_s < REST_S, elapsed_s
    return drives, times_s, (stood_s, elapsed_s)


def derivatives(block: MotionBlock, memory: Memory) -> tuple[Array, Array, Memory]:
    """Return the first and the second derivative (N,) of the rate without its noise.

    With `u = s tau / (1 + s tau)`, which the rate less its low-pass is, `s tau = u + u^2 + u^3 + ...` and
    `(s tau)^2 = u^2 + 2 u^3 + ...`. The memory comes third.
    """
    fast, powers, levels = block.rate_rad_s[:, 2:], [], []
    for before in memory if memory is not None else (None, None, None):
        fast, level = fast_part(fast, block.dt_s, np.array([SMOOTHED_S]), before)
        powers.append(fast[:, 0])
        levels.append(level)
    first = (powers[0] + powers[1] + powers[2]) / SMOOTHED_S
    return first, (powers[1] + 2.0 * powers[2]) / SMOOTHED_S**2, tuple(levels)


@compiled
def low_pass(drive: Array, kept: Array, start: Array) -> Array:
    """Solve `dh/dt = (u - h) / tau` for drives (N, q) in intervals that keep a part (N, q) of h - u.

    Returns:
        h (N + 1, q) at the beginning and at the ends of the intervals.
    """
    h = np.empty((len(drive) + 1, drive.shape[1]))
    h[0] = start
    for row in range(len(drive)):
        h[row + 1] = drive[row] + kept[row] * (h[row] - drive[row])
    return h


def kept_of_steady(dt_s: Array, tau_s: Array | float) -> Array:
    """Return the part (N, q) that is kept where the drive is constant in each interval."""
    kept: Array = np.exp(-dt_s[:, None] / tau_s)
    return kept


def kept_of_smooth(dt_s: Array, tau_s: Array | float) -> Array:
    """Return the part (N, q) that is kept where the drive is smooth: by the trapezoidal rule.

    The mean of the ends of an interval then has the time constant whatever the interval is, so the dynamics
    learned at one rate of the IMU hold at another.
    """
    kept: Array = np.maximum((2.0 * tau_s - dt_s[:, None]) / (2.0 * tau_s + dt_s[:, None]), 0.0)
    return kept


def fast_part(rate: Array, dt_s: Array, tau_s: Array, start: Array | None) -> tuple[Array, Array]:
    """Return rates (N, q) less their low-passes, and the state (q,) of these at the end."""
    h = low_pass(rate, kept_of_smooth(dt_s, tau_s), np.zeros(len(tau_s)) if start is None else start)
    return rate - 0.5 * (h[1:] + h[:-1]), h[-1]


def motion_drive(drive: str, block: MotionBlock) -> Array:
    """Return the rate, its magnitude, its side, or whether the wheels move (N,)."""
    return _OF_MOTION[drive](block)


def moves(block: MotionBlock) -> Array:
    """Return 1 (N,) where the wheels drive or turn the robot, else 0."""
    drives = np.abs(block.distance_m) > MOVING_M_S * block.dt_s
    turns = np.abs(block.wheel_turn_rad) > TURNING_RAD_S * block.dt_s
    return (drives | turns).astype(float)


def side_of(rate_rad_s: Array) -> Array:
    """Return the side of the turn (N,): -1, 0 or 1."""
    return np.sign(rate_rad_s) * (np.abs(rate_rad_s) > TURNING_RAD_S)


_OF_MOTION: dict[str, Callable[[MotionBlock], Array]] = {
    RATE: lambda block: block.rate_rad_s[:, 2],
    ABS_RATE: lambda block: np.abs(block.rate_rad_s[:, 2]),
    SIDE: lambda block: side_of(block.rate_rad_s[:, 2]),
    MOVING: moves,
}
