"""Test drives: instructions for a technician, five minutes each, that make one effect observable.

Each is a scenario whose `about` is the instruction. Other conditions are steady: the fan is off unless it is
tested, and the robot warms up as after switching on.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from gyrocal_ros.sim.manoeuvres import Manoeuvre, arc, drive, rest, turn
from gyrocal_ros.sim.scenarios import CAMERA, Scenario, find_scenario
from gyrocal_ros.sim.sensors import Climate, Fan
from gyrocal_ros.sim.trajectory import Leg

DURATION_S = 300.0
FULL = 2.0 * math.pi
"""Full turn, rad."""
_RATE = math.radians(60.0)
"""Rate of turns, rad/s, where the drive does not test the rate."""
RATES: dict[str, Any] = {'imu_hz': 100, 'camera_hz': 10}
"""Rates of the sensors in test drives."""
FAN_OFF = Fan(math.inf, np.empty((0, 2)))
FAN_ON_AND_OFF = Fan(30.0, np.arange(60.0, DURATION_S, 30.0).reshape(-1, 2))
WARMING = Climate(room_c=22.0, drift_c=0.5, drift_phase_rad=0.0, rise_c=11.0, rise_time_s=300.0)
THEN_COOLED = Climate(room_c=10.0, drift_c=15.0, drift_phase_rad=0.9, rise_c=11.0, rise_time_s=300.0)
"""Climate from 22 deg C up to 28 in the middle of the drive, and down again by a draught."""


def _both_ways(angle_rad: float, rate_deg_s: float, times: int = 1) -> Manoeuvre:
    """Return a number of turns to the left, then as many to the right."""
    rate = math.radians(rate_deg_s)
    sides = [side for side in (1.0, -1.0) for _ in range(times)]
    return tuple(leg for side in sides for leg in (*turn(side * angle_rad, rate), *rest(1.0)))


def _creeping() -> Manoeuvre:
    rates_deg_s = (2.0, 1.0, 0.5, 0.3, 0.2)
    return tuple(leg for rate in rates_deg_s for leg in _both_ways(math.radians(6.0 * rate), rate))


def _back_and_forth() -> Manoeuvre:
    """Return a straight metre, four times forwards and backwards with hard starts and stops, then turns."""
    glide_s, hold_s, speed = 0.25, 2.5, 0.4
    straight = tuple(
        leg
        for side in (1.0, -1.0)
        for leg in (Leg(glide_s, side * speed), Leg(hold_s, side * speed), Leg(glide_s), Leg(0.5))
    )
    return (*4 * straight, *_both_ways(FULL, 60.0))


def _jerks() -> Manoeuvre:
    glide_s, hold_s, rate = 0.08, 0.2, math.radians(90.0)
    return tuple(
        leg
        for side in (1.0, -1.0)
        for leg in (Leg(glide_s, 0.0, side * rate), Leg(hold_s, 0.0, side * rate), Leg(glide_s), Leg(0.5))
    )


def _lanes() -> Manoeuvre:
    sides = (1.0, 1.0, -1.0, -1.0)
    return tuple(leg for side in sides for leg in (*drive(1.5, 0.3), *turn(side * math.pi, _RATE)))


def _waiting(pause_s: float) -> Manoeuvre:
    """Return a full turn each way, and a long rest."""
    return (*_both_ways(FULL, 60.0), *rest(pause_s))


def _square() -> Manoeuvre:
    """Return laps of a square with a full turn at each corner, counter-clockwise, then clockwise."""
    sides = (*4 * (1.0,), *4 * (-1.0,))
    return tuple(
        leg
        for side in sides
        for leg in (*drive(1.5, 0.3), *turn(side * FULL, _RATE), *turn(side * 0.25 * FULL, _RATE))
    )


def _test(name: str, about: str, legs: Manoeuvre, **more: Any) -> Scenario:
    steady: dict[str, Any] = {'climate': WARMING, 'fan': FAN_OFF, **RATES}
    return Scenario(name, about, legs=legs, duration_s=DURATION_S, **steady | more)


_TEST_DRIVES = (
    _test('one_speed', 'full turns on the spot at 60 deg/s, left and right in turn', _both_ways(FULL, 60.0)),
    _test(
        'speeds',
        'three full turns each way at 30, at 60 and at 90 deg/s',
        tuple(leg for rate in (30.0, 60.0, 90.0) for leg in _both_ways(FULL, rate, 3)),
    ),
    _test(
        'one_side',
        'five full turns left at 60 deg/s, a minute of rest, the same right',
        tuple(leg for side in (1.0, -1.0) for leg in (*turn(side * 5.0 * FULL, _RATE), *rest(60.0))),
    ),
    _test('creeping', 'turns of a few degrees each way at 2 deg/s and slower, down to 0.2', _creeping()),
    _test('jerks', 'turns of 25 deg to and fro at 90 deg/s, begun and ended abruptly', _jerks()),
    _test(
        'straight',
        'a straight metre to and fro four times, with hard starts and stops, then a full turn each way',
        _back_and_forth(),
    ),
    _test(
        'eights',
        'figures of eight, 0.8 m wide, as fast as the robot can',
        (*arc(FULL, 0.4, _RATE), *arc(-FULL, 0.4, _RATE)),
    ),
    _test('rough', 'lanes over thresholds and a rough floor', _lanes(), bumps=80, floor_tilt_deg=0.8),
    _test(
        'square',
        'round a square of 1.5 m with a full turn at each corner, left about, then right about',
        _square(),
    ),
    _test(
        'warm_up', 'from switching on, rests of a minute with a full turn each way between', _waiting(60.0)
    ),
    _test(
        'cooled',
        'from switching on, rests of 20 s with a full turn each way between; half way cool the robot by '
        'some degrees with a draught, its power on',
        _waiting(20.0),
        climate=THEN_COOLED,
    ),
    _test(
        'fan',
        'rests of 20 s with a full turn each way between; motors and fan off, on and at full power in turn',
        _waiting(20.0),
        fan=FAN_ON_AND_OFF,
    ),
)
TEST_DRIVES: dict[str, Scenario] = {drive.name: drive for drive in _TEST_DRIVES}
"""The test drives by name."""
EVERYDAY: Scenario = replace(find_scenario('cleaning'), **RATES)
"""Ordinary cleaning, for comparison."""

_SQUARE = TEST_DRIVES['square']
_LEVEL = replace(_SQUARE, floor_tilt_deg=0.0, bumps=0)
CONTROLS: dict[str, Scenario] = {
    control.name: control
    for control in (
        replace(
            _SQUARE,
            name='centred',
            about='the square, the camera over the turning centre',
            mount_xyz_m=(0.0, 0.0, 0.1),
        ),
        replace(_LEVEL, name='level', about='the square on a perfectly level floor'),
        replace(
            _LEVEL,
            name='pinhole',
            about='the same with a lens that bends nothing',
            camera=replace(CAMERA, distortion=(0.0,) * 5),
        ),
    )
}
"""One test drive by robots that lack one property, to show on which property an effect depends."""
