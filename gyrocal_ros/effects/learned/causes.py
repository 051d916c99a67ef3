"""What the law of a gyro usually comes from: effects of the library and mechanisms that have its form."""

from __future__ import annotations

from gyrocal_ros.effects.learned.drives import (
    ABS_RATE,
    ANY_TURN,
    DYNAMICS,
    LAST_REST,
    LAST_TURN,
    MOVING,
    SIDE,
    START,
)
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.memory_forms import FIRST_ORDER
from gyrocal_ros.effects.learned.signals import CENTRIPETAL, GROWING_LAG, RATE
from gyrocal_ros.model.recording import TEMPERATURE

_LIBRARY = {
    ('bias', RATE, 'square'): 'scale_quadratic',
    ('bias', RATE, 'cube'): 'scale_cubic',
    ('bias', RATE, 'absolute value'): 'scale_asymmetry',
    ('bias', TEMPERATURE, 'line'): 'bias_temperature',
    ('scale', TEMPERATURE, 'line'): 'scale_temperature',
    ('bias', 'yaw_acceleration', 'line'): 'gyro_lag',
    ('bias', CENTRIPETAL, 'line'): 'g_sensitivity',
    ('bias', 'force_x', 'line'): 'g_sensitivity',
    ('bias', 'force_y', 'line'): 'g_sensitivity',
    ('bias', 'vibration', 'line'): 'vibration_rectification',
    ('bias', DYNAMICS, FIRST_ORDER): 'gyro_lag',
    ('bias', RATE, FIRST_ORDER): 'turn_hysteresis',
    ('bias', SIDE, FIRST_ORDER): 'turn_hysteresis',
    ('bias', ABS_RATE, 'at once'): 'scale_asymmetry',
    ('bias', TEMPERATURE, 'at once'): 'bias_temperature',
    ('scale', TEMPERATURE, 'at once'): 'scale_temperature',
    ('bias', START, 'fading exponential'): 'bias_warmup',
}
_CLOSEST = {
    ('bias', DYNAMICS): 'gyro_lag',
    ('bias', RATE): 'turn_hysteresis',
    ('bias', SIDE): 'turn_hysteresis',
    ('bias', LAST_TURN): 'turn_hysteresis',
    ('bias', ANY_TURN): 'scale_asymmetry',
    ('bias', LAST_REST): 'bias_warmup',
    ('bias', ABS_RATE): 'scale_asymmetry',
    ('bias', TEMPERATURE): 'bias_temperature',
    ('bias', MOVING): 'vibration_rectification',
    ('bias', START): 'bias_warmup',
    ('scale', ABS_RATE): 'scale_temperature',
    ('scale', TEMPERATURE): 'scale_temperature',
    ('scale', START): 'scale_temperature',
}
_MEANINGS = {
    RATE: 'nonlinearity of the scale factor',
    'heading': 'a field fixed in the room, such as magnetism, that the sensor feels',
    CENTRIPETAL: 'sensitivity to acceleration',
    'force_x': 'sensitivity to acceleration',
    'force_y': 'sensitivity to acceleration',
    'force_z': 'sensitivity to acceleration',
    'yaw_acceleration': 'sensitivity to angular acceleration, or a lag',
    GROWING_LAG: 'a lag that grows with the rate: a limit of the slew, or a filter that adapts',
    'vibration': 'rectified vibration',
    TEMPERATURE: 'temperature dependence',
    'time': 'a heater that is switched, a pump, or the beat of a vibration with the sampling',
    'place': 'a magnet, a motor or a cable at one place in the room, which the sensor feels',
}
_MEANINGS_OF_MEMORIES = {
    DYNAMICS: 'a low-pass filter or a mechanical resonance in the sensor or its mount (IEEE Std 1431-2004, '
    'frequency response)',
    RATE: 'hysteresis: strain or charge that a turn leaves behind (IEEE Std 528)',
    SIDE: 'hysteresis: strain or charge that a turn leaves behind (IEEE Std 528)',
    LAST_TURN: 'relaxation after a turn (Lee, Choi, Park, Myung 2012)',
    ANY_TURN: 'relaxation after a turn, or current or heat of the motors in turns',
    LAST_REST: 'current of motors that start, or a sensor that sleeps at rest and settles when it wakes',
    ABS_RATE: 'heat of the motors in turns, which reaches the sensor late (Newton: law of cooling)',
    MOVING: 'heat, vibration or supply current of the motors while the robot drives',
    TEMPERATURE: 'the sensing element is warmed later than the thermometer, or a gradient of temperature '
    '(Shupe 1980) disturbs it',
}
_SETTLING = {
    'bias': 'self-heating after power-on (Barshan and Durrant-Whyte 1995)',
    'scale': 'turn-on transient of the scale factor (IEEE Std 1431-2004)',
}
SAME_BESIDE_SCALE_FACTOR = {
    'dead band': 'beside a scale factor a dead band and a saturation of the rate are the same'
}


def library_effect(of: str, follows: str, form: str) -> str:
    """Return the effect of the library that has this form; empty without one."""
    if (of, follows, form) in _LIBRARY:
        return _LIBRARY[of, follows, form]
    is_recorded = follows not in _MEANINGS and follows not in _MEANINGS_OF_MEMORIES and follows != START
    return f'covariate_{of}:{follows}' if form in ('line', 'at once') and is_recorded else ''


def closest_effect(of: str, drive: str) -> str:
    """Return the effect of the library that resembles a memory of this drive most."""
    event = event_of(drive)
    return _CLOSEST.get((of, drive), f'covariate_{of}:{drive if event is None else event.signal}')


def meaning(signal: str, form: str = '') -> str:
    """Return what a dependence on a signal usually means, in a few words."""
    usual = _MEANINGS.get(signal, f'something that goes with {signal} disturbs the sensor')
    return (
        f'{usual}; {SAME_BESIDE_SCALE_FACTOR[form]}'
        if signal == RATE and form in SAME_BESIDE_SCALE_FACTOR
        else usual
    )


def meaning_of_memory(of: str, drive: str) -> str:
    """Return what a memory of this drive usually means, in a few words."""
    if drive == START:
        return _SETTLING[of]
    if event_of(drive) is not None:
        return 'current, heat or magnetism of what is switched then, which settles'
    return _MEANINGS_OF_MEMORIES.get(
        drive, f'heat of what goes with {drive}, which reaches the sensor late (Newton: law of cooling)'
    )
