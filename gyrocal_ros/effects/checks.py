"""Checks that an effect is complete and consistent before a filter runs with it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_args

import numpy as np

from gyrocal_ros.data import Array, MotionBlock, nanoseconds
from gyrocal_ros.effects.base import Explanation, Stimulus
from gyrocal_ros.effects.traits import (
    forms_of,
    is_estimated,
    is_limit,
    is_noise,
    required_signals,
    scanned_coefficient,
    strengths,
)
from gyrocal_ros.model.sensor import Coefficient, Place, ScannedColumns

METHODS = {
    'gyro': ('contribute',),
    'wheels': ('contribute',),
    'ground': ('contribute',),
    'camera': ('corrected', 'pixels_by_values'),
    'time': (),
    'shutter': ('readout_s',),
    'noise': ('density', 'bias_walk'),
}
"""Methods that an effect needs, by the place where it acts."""
REQUIRED_WORDS = ('physics', 'equation', 'usual_size', 'best_motion')
"""Fields of the explanation that must not be empty."""
MIN_SCAN = 3
"""Minimum number of values of a scan: a likelihood has a maximum only between two others."""


def faults(effect: Any) -> Iterator[str]:
    """Yield the faults of an effect that prevent its use; each check relies on the ones before."""
    name, place = getattr(effect, 'name', None), getattr(effect, 'acts_on', None)
    if not isinstance(name, str) or not re.fullmatch(r'[a-z][a-z0-9_]*', name):
        yield f'name is {name!r}, not small letters, digits and underscores'
    if place not in get_args(Place):
        yield f'acts_on is {place!r}, not one of {", ".join(get_args(Place))}'
    items = getattr(effect, 'coefficients', None)
    if not isinstance(items, tuple) or not items or not all(isinstance(item, Coefficient) for item in items):
        yield 'coefficients is no tuple of Coefficient'
        return
    if len({item.name for item in items}) < len(items):
        yield 'two coefficients have the same name'
    if not is_dataclass(effect) or 'coefficients' not in {item.name for item in fields(effect)}:
        yield 'is no dataclass with a field coefficients, so that priors could be set'
    yield from _faults_of_explanation(effect, len(items))
    missing = [method for method in METHODS[str(place)] if not callable(getattr(effect, method, None))]
    if missing:
        yield f'lacks {" and ".join(missing)}'
        return
    yield from _faults_of_scan(effect)
    if 'contribute' in METHODS[str(place)]:
        yield from _faults_of_contribution(effect)
    if scanned_coefficient(effect) is not None and is_estimated(effect):
        for form in forms_of(effect):
            yield from _faults_of_columns(form)


def _faults_of_explanation(effect: Any, count: int) -> Iterator[str]:
    about = getattr(effect, 'about', None)
    if not isinstance(about, Explanation):
        yield 'about is no Explanation'
        return
    for word in REQUIRED_WORDS:
        if not getattr(about, word).strip():
            yield f'about says nothing of {word}'
    if len(about.example) != count:
        yield f'about.example has {len(about.example)} values for {count} coefficients'
    if not isinstance(about.needs, tuple) or not all(isinstance(name, str) for name in about.needs):
        yield f"about.needs is {about.needs!r}, not a tuple of signals such as ('temperature',)"
        return
    if about.shown_against not in get_args(Stimulus):
        yield f'about.shown_against is {about.shown_against!r}, not one of {", ".join(get_args(Stimulus))}'
    elif about.shown_against == 'signal' and len(required_signals(effect)) != 1:
        yield 'about.shown_against is signal, which takes one signal in about.needs'


def _faults_of_scan(effect: Any) -> Iterator[str]:
    """Check the values that the diagnosis tries, and what makes an effect a limit."""
    if is_limit(effect):
        if effect.acts_on != 'gyro' or len(effect.coefficients) > 1 or effect.coefficients[0].prior_std > 0.0:
            yield 'is a limit, which acts on the gyro and has one coefficient with prior_std 0'
        return
    scanned = [item for item in effect.coefficients if item.scan]
    if is_noise(effect):
        if len(scanned) != 1 or len(effect.coefficients) > 1 or effect.coefficients[0].prior_std > 0.0:
            yield 'is a noise, which has one coefficient with prior_std 0 and a scan'
        return
    if len(scanned) > 1:
        yield f'{" and ".join(item.name for item in scanned)} have a scan; only one coefficient may'
    elif scanned and effect.acts_on != 'gyro':
        yield f'{scanned[0].name} has a scan; only effects on the gyro may'
    elif scanned:
        values = np.array(scanned[0].scan, float)
        if len(values) < MIN_SCAN or not (values > 0.0).all() or not (np.diff(values) > 0.0).all():
            yield f'the scan of {scanned[0].name} is not {MIN_SCAN} or more positive, increasing values'


def _faults_of_contribution(effect: Any) -> Iterator[str]:
    """Check shapes, numbers and derivative on a short motion; signals may be missing in a bag."""
    values = np.array(effect.about.example, float)
    shape = {'gyro': (6,), 'wheels': (6,), 'ground': (3,)}[effect.acts_on]
    block = _test_block()
    try:
        added, by_values = _contribution(effect, block, values)
        nothing = replace(block, temperature_c=np.full(6, np.nan), heading_rad=None, position_m=None)
        bare, _ = _contribution(effect, nothing, values)
    except Exception as error:
        yield f'contribute fails: {type(error).__name__}: {error}'
        return
    found, wanted = (np.shape(added), np.shape(by_values)), (shape, (*shape, len(values)))
    if found != wanted:
        yield f'contribute gives arrays of the shapes {found}, not {wanted}'
        return
    if not np.all(np.isfinite(added)) or not np.all(np.isfinite(bare)):
        yield 'contribute is not a number where no temperature is recorded; use `recorded`'
    for place, item in enumerate(effect.coefficients):
        step = 1e-4 * (abs(values[place]) or item.prior_std)
        nudge = step * np.eye(len(values))[place]
        after, before = (_contribution(effect, block, values + side * nudge)[0] for side in (1, -1))
        expected = (after - before) / (2.0 * step)
        wrong = np.abs(by_values[..., place] - expected).max() > 1e-3 * np.abs(expected).max() + 1e-12
        if item.prior_std > 0.0 and wrong:
            yield f'contribute gives a wrong derivative by {item.name}'


def _faults_of_columns(effect: Any) -> Iterator[str]:
    """Check that an effect with a scan is linear in its other coefficients, and its `columns_at`."""
    block, linear, place = _test_block(), strengths(effect), scanned_coefficient(effect)
    assert place is not None
    scan = np.array(effect.coefficients[place].scan)
    columns = []
    for value in scan.tolist():
        values = np.zeros(len(effect.coefficients))
        values[place] = value
        added, by_values = _contribution(effect, block, values)
        if np.any(added):
            yield f'contribute is not zero where all but {effect.coefficients[place].name} are zero'
            return
        columns.append(by_values[:, linear])
    if isinstance(effect, ScannedColumns):
        expected = np.concatenate(columns, axis=1)
        found, _ = effect.columns_at(block, scan, None)
        if np.shape(found) != expected.shape or not np.allclose(found, expected, rtol=1e-6, atol=1e-12):
            yield 'columns_at differs from the derivative that contribute gives'


def _contribution(effect: Any, block: MotionBlock, values: Array) -> tuple[Array, Array]:
    if effect.acts_on == 'gyro':
        term = effect.contribute(block, values, None)
        return term.rate_rad_s, term.by_values
    added, by_values = effect.contribute(block, values)
    return added, by_values


def _test_block() -> MotionBlock:
    """Return six intervals in which every signal varies."""
    rng = np.random.default_rng(0)
    dt_s = np.full(6, 0.005)
    rates = rng.uniform(-1.0, 1.0, (6, 3))
    return MotionBlock(
        start_ns=nanoseconds(30.0),
        end_ns=nanoseconds(30.03),
        time_s=30.0025 + np.arange(6) * 0.005,
        dt_s=dt_s,
        rate_rad_s=rates,
        yaw_acceleration_rad_s2=rng.uniform(-5.0, 5.0, 6),
        specific_force_m_s2=rng.uniform(-1.0, 1.0, (6, 3)),
        vibration_m2_s4=rng.uniform(0.01, 0.1, 6),
        distance_m=rng.uniform(1e-3, 2e-3, 6),
        wheel_turn_rad=rates[:, 2] * dt_s,
        temperature_c=rng.uniform(30.0, 40.0, 6),
        heading_rad=rng.uniform(-3.0, 3.0, 6),
        position_m=rng.uniform(-1.0, 1.0, (6, 2)),
    )
