"""Laws that the library lacks, to hide in recordings: they test what is learned of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.model.recording import SPEED_SIGNAL
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place, TypicalRange
from gyrocal_ros.sim.dynamic_strangers import GrowingLag, Resonance

DEG = math.radians(1.0)
TURNING_RAD_S = 5.0 * DEG
FULL_RATE_RAD_S = 100.0 * DEG
USUAL_SPEED_M_S = 0.3
BOOST_RPM = 13_000.0
"""Speed of the fan that it has at full power only."""
Contribution: TypeAlias = Callable[[MotionBlock, Array, Memory], tuple[Array, Memory]]


@dataclass(frozen=True)
class Stranger:
    """A law of the yaw rate; its first coefficient is the size, in which the law is linear."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str
    coefficients: tuple[Coefficient, ...]
    law: Contribution
    """Contribution (N,) to the yaw rate by block, coefficients and memory, and the new memory."""
    right: tuple[str, ...]
    """Learned effects, or such that follow a recorded signal, that have this form."""
    source: str
    forms: tuple[str, ...] = ()
    """Closed forms that this law is; empty where no form is exact."""
    holds_scale: bool = True
    """False if a part of the law is a scale factor, so that the filter's includes it."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution and its derivative by the size; the others are not estimated."""
        per_unit, memory = self.law(block, np.concatenate([[1.0], values[1:]]), memory)
        by_values = np.zeros((len(per_unit), len(values)))
        by_values[:, 0] = per_unit
        return GyroTerm(values[0] * per_unit, by_values, memory)


def _size(low: float, high: float, unit: str = 'rad/s') -> Coefficient:
    return Coefficient('size', unit, prior_std=high, typical=TypicalRange(low, high))


def _fixed(name: str, unit: str, low: float, high: float, of_duration: bool = False) -> Coefficient:
    kind = TypicalRange(low, high, signed=False, is_strength=False, of_duration=of_duration)
    return Coefficient(name, unit, prior_std=0.0, prior_mean=low, typical=kind)


def _rate(block: MotionBlock) -> Array:
    return block.rate_rad_s[:, 2]


def _recorded(block: MotionBlock, signal: str) -> Array:
    return block.covariates.get(signal, np.zeros(len(block.dt_s)))


def _by_heading(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    assert block.heading_rad is not None
    return values[0] * np.sin(block.heading_rad + values[1]), None


def _by_heading_twice(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    assert block.heading_rad is not None
    waves = np.cos(block.heading_rad) + np.sin(2.0 * block.heading_rad + values[1])
    return 0.7 * values[0] * waves, None


def _scale_by_heading(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    assert block.heading_rad is not None
    return values[0] * np.sin(block.heading_rad + values[1]) * _rate(block), None


def _scale_by_speed(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.square(block.distance_m / block.dt_s / USUAL_SPEED_M_S) * _rate(block), None


def _by_place(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    assert block.position_m is not None
    away_m = np.hypot(*(block.position_m - np.array([0.8, 0.5])).T)
    return values[0] * np.exp(-0.5 * np.square(away_m / values[1])), None


def _by_square_force(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.square(block.distance_m / block.dt_s * _rate(block)), None


def _by_square_current(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.square(_recorded(block, 'battery_state.current') / 2.0), None


def _by_fan(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    turns = np.square(_recorded(block, 'fan_speed.data') / 1e4)
    return values[0] * turns * _rate(block), None


def _settling(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.exp(-block.time_s / values[1]) * _rate(block), None


def _scale_jump(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * (block.time_s >= values[1]) * _rate(block), None


def _ripple(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.sin(2.0 * np.pi * values[1] * _rate(block) / FULL_RATE_RAD_S), None


def _gain_step(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    fast = np.maximum(np.abs(_rate(block)) - values[1], 0.0)
    return values[0] * fast * np.sign(_rate(block)), None


def _after_turns(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    now, column = float(memory or 0.0), []
    # By the wheels: a reading at which the law itself jumps would be consistent with no rate.
    turning = block.wheel_turn_rad / block.dt_s
    sides = np.sign(turning) * (np.abs(turning) > TURNING_RAD_S)
    for side, dt_s in zip(sides.tolist(), block.dt_s.tolist(), strict=True):
        now = side if side else now * math.exp(-dt_s / values[1])
        column.append(now)
    return values[0] * np.array(column), now


def _after_any_turn(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    rates, memory = _after_turns(block, values, memory)
    return np.abs(rates), memory


def _after_boosts(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    was_full, now = memory or (True, 0.0)
    column: list[float] = []
    full = _recorded(block, 'fan_speed.data') > BOOST_RPM
    for is_full, dt_s in zip(full.tolist(), block.dt_s.tolist(), strict=True):
        now = 1.0 if is_full and not was_full else now * math.exp(-dt_s / values[1])
        was_full = is_full
        column.append(now)
    return values[0] * np.array(column), (was_full, now)


def _swinging(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.sin(2.0 * np.pi * block.time_s / values[1]), None


def _swinging_scale(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.sin(2.0 * np.pi * block.time_s / values[1]) * _rate(block), None


def _switched(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * (np.remainder(block.time_s, values[1]) < 0.5 * values[1]), None


def _scale_heated_by_turns(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    heat, memory = _heated_by_turns(block, values, memory)
    return heat * _rate(block), memory


def _heated_by_turns(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    now, column = float(memory or 0.0), []
    for rate, dt_s in zip(np.abs(_rate(block)).tolist(), block.dt_s.tolist(), strict=True):
        now += (1.0 - math.exp(-dt_s / values[1])) * (rate - now)
        column.append(now)
    return values[0] * np.array(column), now


def _by_yaw_acceleration(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    turning = block.wheel_turn_rad / block.dt_s
    before = turning[0] if memory is None else memory
    acceleration = np.diff(turning, prepend=before) / block.dt_s
    return values[0] * np.tanh(acceleration / values[1]) ** 2, float(turning[-1])


def _voltage_wave(block: MotionBlock, values: Array, memory: Memory) -> tuple[Array, Memory]:
    return values[0] * np.sin(2.0 * np.pi * _recorded(block, 'battery_state.voltage') / values[1]), None


Known: TypeAlias = Any
STRANGERS: dict[str, Known] = {
    item.name: item
    for item in (
        Stranger(
            'stranger_heading',
            (_size(0.05 * DEG, 0.4 * DEG), _fixed('phase', 'rad', 0.5, 3.0)),
            _by_heading,
            ('bias_curve:heading',),
            'IEEE Std 952-1997, magnetic sensitivity of fibre-optic gyros, which turns with the heading',
            ('sine of the heading',),
        ),
        Stranger(
            'stranger_heading_twice',
            (_size(0.05 * DEG, 0.4 * DEG), _fixed('phase', 'rad', 0.5, 3.0)),
            _by_heading_twice,
            ('bias_curve:heading',),
            'the same with the second harmonic of soft iron',
            ('sines of the heading and of twice it',),
        ),
        Stranger(
            'stranger_place',
            (_size(0.2 * DEG, DEG), _fixed('width', 'm', 0.4, 0.8)),
            _by_place,
            ('bias_map:place',),
            'IEEE Std 952-1997, magnetic sensitivity, near a motor or a cable in the floor',
        ),
        Stranger(
            'stranger_square_force',
            (_size(2.0 * DEG, 20.0 * DEG, 'rad/s/(m/s^2)^2'),),
            _by_square_force,
            (
                'bias_curve:centripetal_acceleration',
                'bias_curve:force_y',
                'bias_curve:yaw_acceleration',
                'bias_curve:rate',
            ),
            'IEEE Std 1431-2004, g-squared sensitivity',
            ('square',),
        ),
        Stranger(
            'stranger_square_current',
            (_size(0.02 * DEG, 0.2 * DEG),),
            _by_square_current,
            ('bias_curve:battery_state.current', covariate_bias('battery_state.current').name),
            'field of the supply leads through an induced heat, I squared R',
            ('square',),
        ),
        Stranger(
            'stranger_fan_scale',
            (_size(0.002, 0.02, '1'),),
            _by_fan,
            ('scale_curve:fan_speed.data', covariate_scale('fan_speed.data').name),
            'IEEE Std 1431-2004, sensitivity to vibration',
            ('square',),
            holds_scale=False,
        ),
        Stranger(
            'stranger_scale_heading',
            (_size(0.003, 0.02, '1'), _fixed('phase', 'rad', 0.5, 3.0)),
            _scale_by_heading,
            ('scale_curve:heading',),
            'IEEE Std 952-1997, magnetic sensitivity, here of the scale factor',
            ('sine of the heading',),
        ),
        Stranger(
            'stranger_scale_speed',
            (_size(0.003, 0.02, '1'),),
            _scale_by_speed,
            (f'scale_curve:{SPEED_SIGNAL}', covariate_scale(SPEED_SIGNAL).name),
            'IEEE Std 1431-2004, sensitivity to the vibration of the wheels',
            ('square',),
            holds_scale=False,
        ),
        Stranger(
            'stranger_settling',
            (_size(0.01, 0.05, '1'), _fixed('time_constant', 's', 40.0, 150.0)),
            _settling,
            ('scale_memory:start',),
            'IEEE Std 1431-2004, turn-on transient of the scale factor',
            ('fading exponential',),
        ),
        Stranger(
            'stranger_scale_jump',
            (_size(0.005, 0.03, '1'), _fixed('time', 's', 0.25, 0.75, of_duration=True)),
            _scale_jump,
            ('scale_step:time',),
            'Willsky and Jones 1976, jumps in linear systems',
        ),
        Stranger(
            'stranger_ripple',
            (_size(0.1 * DEG, 0.6 * DEG), _fixed('periods', '1', 1.0, 2.5)),
            _ripple,
            ('bias_curve:rate',),
            'IEEE Std 1554-2005, scale-factor nonlinearity, composite error over rate',
            ('sine',),
            holds_scale=False,
        ),
        Stranger(
            'stranger_fast_gain',
            (_size(0.01, 0.06, '1'), _fixed('from', 'rad/s', 40.0 * DEG, 60.0 * DEG)),
            _gain_step,
            ('bias_curve:rate',),
            'two ranges of an analogue-to-digital converter with different gains',
            ('dead band',),
            holds_scale=False,
        ),
        Stranger(
            'stranger_last_turn',
            (_size(0.1 * DEG, 0.5 * DEG), _fixed('time_constant', 's', 5.0, 25.0)),
            _after_turns,
            ('bias_memory:last_turn', 'bias_memory:turn_side'),
            'Lee, Choi, Park, Myung 2012: drift after turns',
            ('fading exponential',),
        ),
        Stranger(
            'stranger_any_turn',
            (_size(0.1 * DEG, 0.5 * DEG), _fixed('time_constant', 's', 5.0, 25.0)),
            _after_any_turn,
            ('bias_memory:any_turn',),
            'relaxation after turns to both sides alike',
            ('fading exponential',),
        ),
        Stranger(
            'stranger_boost',
            (_size(0.1 * DEG, 0.5 * DEG), _fixed('time_constant', 's', 3.0, 12.0)),
            _after_boosts,
            ('bias_memory:above_13000:fan_speed.data',),
            'field and supply ripple of a motor that runs up',
            ('fading exponential',),
        ),
        Stranger(
            'stranger_turn_heat',
            (_size(0.003, 0.02, '1'), _fixed('time_constant', 's', 10.0, 40.0)),
            _heated_by_turns,
            ('bias_memory:abs_rate',),
            'heat of the wheel motors in turns',
            ('first-order lag',),
        ),
        Stranger(
            'stranger_heated_scale',
            (_size(0.01, 0.06, 's'), _fixed('time_constant', 's', 10.0, 40.0)),
            _scale_heated_by_turns,
            ('scale_memory:abs_rate',),
            'the same heat acting on the scale factor: IEEE Std 1431-2004, thermal sensitivity',
            ('first-order lag',),
        ),
        Stranger(
            'stranger_swing',
            (_size(0.05 * DEG, 0.3 * DEG), _fixed('period', 's', 25.0, 80.0)),
            _swinging,
            ('bias_wave:time',),
            'IEEE Std 952-1997, annex C: sinusoidal noise',
        ),
        Stranger(
            'stranger_scale_swing',
            (_size(0.005, 0.02, '1'), _fixed('period', 's', 40.0, 120.0)),
            _swinging_scale,
            ('scale_wave:time',),
            'a thermostat that heats the sensor on and off',
        ),
        Stranger(
            'stranger_switched',
            (_size(0.1 * DEG, 0.5 * DEG), _fixed('period', 's', 15.0, 40.0)),
            _switched,
            ('bias_wave:time',),
            'a load on the supply that is switched regularly',
        ),
        Stranger(
            'stranger_jerk',
            (_size(0.3 * DEG, 2.0 * DEG), _fixed('from', 'rad/s^2', 0.5, 1.5)),
            _by_yaw_acceleration,
            ('bias_curve:yaw_acceleration',),
            'IEEE Std 1431-2004, sensitivity to angular acceleration',
        ),
        Stranger(
            'stranger_voltage_wave',
            (_size(0.03 * DEG, 0.3 * DEG), _fixed('period', 'V', 0.15, 0.4)),
            _voltage_wave,
            ('bias_curve:battery_state.voltage',),
            'beat of a switching regulator with the sensor, whose frequency follows the voltage',
            ('sine',),
        ),
        Resonance(),
        GrowingLag(),
    )
}
"""Laws outside the library, by name."""
