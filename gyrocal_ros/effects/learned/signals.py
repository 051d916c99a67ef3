"""Signals that learned effects may follow, as columns of a block of motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gyrocal_ros.data import Array, MotionBlock, constant
from gyrocal_ros.effects.base import Stimulus
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.recording import TEMPERATURE

HEADING = 'heading'
"""The heading in the map: periodic, and valid with that map only."""
RATE = 'rate'
GROWING_LAG = 'rate_times_yaw_acceleration'
"""Magnitude of the rate times yaw acceleration: a lag that grows with the rate errs by it."""
CENTRIPETAL = 'centripetal_acceleration'
"""That of the robot by wheels and gyro; the accelerometer's also has tilt, vibration and yaw acceleration."""


def _mean(values: Array) -> Array:
    """Return the mean over the block for each interval: a single reading of these signals is mostly noise."""
    return constant(float(values.sum()) / len(values), len(values))


def _heading(block: MotionBlock) -> Array:
    if block.heading_rad is None:
        return np.full(len(block.dt_s), np.nan)
    wrapped: Array = np.remainder(block.heading_rad + np.pi, 2.0 * np.pi) - np.pi
    return wrapped


_VALUES: dict[str, Callable[[MotionBlock], Array]] = {
    RATE: lambda block: block.rate_rad_s[:, 2],
    'yaw_acceleration': lambda block: _mean(block.yaw_acceleration_rad_s2),
    GROWING_LAG: lambda block: _mean(np.abs(block.rate_rad_s[:, 2]) * block.yaw_acceleration_rad_s2),
    CENTRIPETAL: lambda block: block.distance_m / block.dt_s * block.rate_rad_s[:, 2],
    'force_x': lambda block: _mean(block.specific_force_m_s2[:, 0]),
    'force_y': lambda block: _mean(block.specific_force_m_s2[:, 1]),
    'force_z': lambda block: _mean(block.specific_force_m_s2[:, 2]),
    'vibration': lambda block: block.vibration_m2_s4,
    TEMPERATURE: lambda block: block.temperature_c,
    'time': lambda block: block.time_s,
    HEADING: _heading,
}
UNITS = {
    RATE: 'rad/s',
    'yaw_acceleration': 'rad/s^2',
    GROWING_LAG: 'rad^2/s^3',
    CENTRIPETAL: 'm/s^2',
    'force_x': 'm/s^2',
    'force_y': 'm/s^2',
    'force_z': 'm/s^2',
    'vibration': '(m/s^2)^2',
    TEMPERATURE: 'deg C',
    'time': 's',
    HEADING: 'rad',
}
"""Signals of every recording, and the temperature, with their units. Others are named by topic and field."""


_SHOWN_AGAINST: dict[str, Stimulus] = {
    RATE: 'rate',
    'yaw_acceleration': 'turn',
    GROWING_LAG: 'turn',
    CENTRIPETAL: 'turn',
    'force_x': 'force',
    'force_y': 'force',
    'force_z': 'force',
    'vibration': 'vibration',
    TEMPERATURE: 'temperature',
    'time': 'time',
    HEADING: 'heading',
}


def values_of(signal: str, block: MotionBlock) -> Array:
    """Return a signal (N,); NaN where it is not recorded."""
    if signal in _VALUES:
        return _VALUES[signal](block)
    recorded = block.covariates.get(signal)
    return np.full(len(block.dt_s), np.nan) if recorded is None else recorded


def shown_against(signal: str) -> Stimulus:
    """Return what a sketch varies to show an effect that follows a signal."""
    return _SHOWN_AGAINST.get(signal, 'signal')


def to_record(signal: str) -> str:
    """Return the signal if a recording may lack it; empty for one that every recording has."""
    return signal if signal == TEMPERATURE or signal not in UNITS else ''


def required(signal: str, known: tuple[str, ...], name: str) -> str:
    """Return the signal.

    Raises:
        ConfigError: it is none of those known.
    """
    if signal not in known:
        raise ConfigError(f'cannot follow {signal!r}', where=name, todo=f'one of {", ".join(known)}')
    return signal
