"""Bounds of numbers in messages. A number beyond them is a fault of its message, not a measurement.

They are wide: ranges of the sensors belong to the settings of the board.
"""

from __future__ import annotations

from collections.abc import Sequence

MAX_READING = 1e5
"""Bound of a reading, in SI units; no sensor of a robot reads more."""
MAX_DISTANCE_M = 1e7
"""Bound of a coordinate, which may be one of a map projection."""
MAX_NUMBER = 1e30
"""Bound of any other recorded number, whose unit is unknown; its square is finite."""
IMPLAUSIBLE = 'the values are impossible (NaN, or far too large); check its driver'
STAMP_NUMBERS = 2
"""A stamp is the first two numbers, seconds and nanoseconds."""


def plausible(values: Sequence[float], bound: float = MAX_READING) -> bool:
    """Return True if the numbers after the stamp are finite and within a bound."""
    return all(abs(value) < bound for value in values[STAMP_NUMBERS:])
