"""Bounds of numbers in messages. A number beyond them is a fault of its message, not a measurement.

They are wide: no robot on a floor reaches them, and a gyro that reads deg/s stays within, so that this is
recognised. Ranges of the sensors belong to the settings of the board.
"""

from __future__ import annotations

from collections.abc import Iterable

MAX_READING = 1e5
"""Bound of any reading, in SI units; no sensor of a robot reads more."""
MAX_RATE_RAD_S = 200.0
"""Bound of the rate by a gyro; the widest ranges are 70 rad/s."""
MAX_SPEED_M_S = 20.0
"""Bound of the speed by the wheels; beyond it an encoder has overflowed, or the unit is wrong."""
IMU_BOUNDS = (MAX_RATE_RAD_S,) * 3 + (MAX_READING,) * 3
"""Bounds of rates and specific force."""
WHEEL_BOUNDS = (MAX_SPEED_M_S, MAX_READING)
"""Bounds of speed and yaw rate."""
MAX_DISTANCE_M = 1e7
"""Bound of a coordinate, which may be one of a map projection."""
MAX_NUMBER = 1e30
"""Bound of any other recorded number, whose unit is unknown; its square is finite."""
IMPLAUSIBLE = 'the values are impossible (NaN, or far too large); check its driver'


def plausible(values: Iterable[float], bounds: Iterable[float]) -> bool:
    """Return True if all numbers are finite and within their bounds."""
    for value, bound in zip(values, bounds, strict=False):  # noqa: SIM110  (a generator takes twice as long)
        if not abs(value) < bound:
            return False
    return True
