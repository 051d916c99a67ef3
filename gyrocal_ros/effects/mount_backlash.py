"""The gyro or the camera is loose in its mount: it begins a turn to the other side late."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearMemoryEffect, column
from gyrocal_ros.model.sensor import Coefficient, Memory, TypicalRange

LEAST_TURN_RAD, LEAST_RATE_RAD_S = math.radians(0.3), math.radians(1.0)
"""Least turn in which a play is crossed that is not known, or of a camera, and rate from which a loose gyro
turns: less may be noise of the readings and of their bias."""
GYRO_TURN_RAD = math.radians(0.05)
"""Turn after which a loose gyro has crossed its play: it reads nothing before."""
CROSSING_S = 0.1
"""Time in which a simulated robot crosses the play of a camera, before the camera begins to turn."""
TURNING_RAD_S = math.radians(5.0)
"""Reading from which a simulated robot turns: slower ones may be the bias."""


@dataclass(frozen=True)
class MountBacklash(LinearMemoryEffect):
    """`play dp/dt`: the heading of a loose part jumps by its play at every turn to the other side.

    The position p in the play, from -1/2 to 1/2, follows the turn of the robot. The play is positive if the
    gyro is loose and negative if the camera is; what is known of it before, its prior mean, tells when it is
    crossed.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='A gyro or a camera that is loose in its mount stays behind where the robot begins to turn '
        'to the other side, until it has crossed its play. So the heading jumps by the play where a turn to '
        'the left follows one to the right; a further turn to the same side does nothing. These errors do '
        'not add up. The play is positive if the gyro is loose and negative if the camera is: fasten it.',
        equation='w = w_n + play dp/dt, abs(p) <= 1/2',
        usual_size='0.05 to 1 deg',
        best_motion='turns to and fro, begun and ended abruptly',
        twins=('gyro_lag', 'camera_time_offset', 'turn_hysteresis'),
        source='Nordin and Gutman 2002, Controlling mechanical systems with backlash, Automatica 38(10)',
        example=(math.radians(0.5),),
        shown_against='turn',
    )
    name: str = 'mount_backlash'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'play',
            'rad',
            prior_std=math.radians(1.0),
            typical=TypicalRange(math.radians(0.03), math.radians(0.6)),
        ),
    )

    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the column (N, 1) and where the part lies in its play."""
        place = memory if memory is not None else 0.0
        if block.wheels_at_rest:
            return np.zeros((len(block.dt_s), 1)), place
        rate_rad_s, play_rad = block.rate_rad_s[:, 2] + block.bias_rad_s, self.coefficients[0].prior_mean
        crossed_in_rad = max(-play_rad, LEAST_TURN_RAD)
        if play_rad > 0.0:
            rate_rad_s = np.where(np.abs(rate_rad_s) > LEAST_RATE_RAD_S, rate_rad_s, 0.0)
            crossed_in_rad = GYRO_TURN_RAD
        places = _followed(rate_rad_s * block.dt_s, crossed_in_rad, place)
        return column(0.5 * np.diff(places) / block.dt_s), float(places[-1])

    def turn_against_body_rad(self, values: Array) -> float:
        """Return the play of a loose camera, by which its heading differs from that of the robot."""
        return max(-float(values[0]), 0.0)

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Return what a loose gyro reads, or one on a robot that turns a loose camera."""
        play_rad = abs(float(values[0])) / scale_factor
        if play_rad == 0.0:
            return nominal_rad_s
        if values[0] < 0.0:
            return nominal_rad_s + _crossed_before(nominal_rad_s, dt_s, play_rad)
        turning = np.abs(nominal_rad_s) > TURNING_RAD_S
        places = _followed(nominal_rad_s * turning * dt_s, play_rad, 0.0)
        return nominal_rad_s - 0.5 * play_rad * np.diff(places) / dt_s


def _followed(turns_rad: Array, play_rad: float, place: float) -> Array:
    """Return the position in the play before and after turns (N,), from -1 to 1 (N + 1,)."""
    places = [place]
    for turn_rad in turns_rad.tolist():
        place = min(max(place + 2.0 * turn_rad / play_rad, -1.0), 1.0)
        places.append(place)
    return np.array(places)


def _crossed_before(rate_rad_s: Array, dt_s: Array, play_rad: float) -> Array:
    """Return the rate (n,) that is added where a robot crosses the play, before its camera turns."""
    added = np.zeros(len(rate_rad_s))
    sides = np.sign(rate_rad_s) * (np.abs(rate_rad_s) > TURNING_RAD_S)
    turning = np.flatnonzero(sides[1:]) + 1
    side, ends_s = 0.0, np.cumsum(dt_s)
    for first in turning[np.diff(sides[turning], prepend=0.0) != 0.0].tolist():
        crossed_rad = play_rad if side else 0.5 * play_rad
        side = float(sides[first])
        begin = min(int(np.searchsorted(ends_s, ends_s[first] - CROSSING_S)), first - 1)
        before = slice(max(begin, 0), first)
        added[before] += side * crossed_rad / dt_s[before].sum()
    return added
