"""Unknown laws by name: the law that explains best what a model leaves unexplained."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose import unknown_law
from gyrocal_ros.diagnose.analysis.examined import unusual_noises, with_effect
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.laws.learning import MIN_GAIN
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.status import diagnosis_status
from gyrocal_ros.diagnose.unknown_law import name_unknown
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.learned import curve, memory, place_map, step, wave
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.hidden import DrawnEffect, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DEG = math.radians(1.0)


def diagnosed(*drawn: DrawnEffect, seconds: float = 80.0) -> Diagnosis:
    scenario = replace(find_scenario('cleaning'), duration_s=seconds, imu_hz=100, camera_hz=4)
    hidden = hide(drawn, find_effect)
    source, config = preload(SimSource(scenario, 1, hidden=hidden), Config(), default_model())
    recorded = summarise_recording(source)

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        return calibrate(source, config, model, candidates=candidates)

    return diagnose(name_unknown(find_missing(default_model(), recorded, run), recorded, run), recorded)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'values', 'signal'),
    [
        pytest.param(
            *('stranger_heading', (1.2 * DEG, 0.7), 'heading in the map (deg)'),
            id='so large that the filter diverges',
            marks=pytest.mark.thorough,
        ),
        pytest.param(
            *('stranger_scale_heading', (0.03, 0.5), 'heading in the map (deg)'),
            id='whose headings seem to follow the time',
        ),
    ],
)
def test_the_signal_of_an_unknown_law_is_named(name: str, values: tuple[float, ...], signal: str) -> None:
    found = diagnosed(DrawnEffect(name, values))
    assert found.verdict == 'unexplained' and found.missing == ()
    assert found.unexplained is not None and found.unexplained.shape.signal == signal
    status = diagnosis_status(found)
    assert status.level == 'red' and f'goes with {signal}' in status.sentence


@pytest.mark.thorough
def test_a_law_is_named_beside_an_effect_that_gains_far_more() -> None:
    late, strange = (
        DrawnEffect('camera_time_offset', (0.05,)),
        DrawnEffect('stranger_scale_heading', (0.015, 0.5)),
    )
    found = diagnosed(late, strange)
    assert [item.effect.name for item in found.missing] == ['camera_time_offset']
    assert found.verdict == 'unexplained' and found.unexplained is not None
    assert found.unexplained.gain < 0.1 * found.missing[0].gain
    assert 'the scale goes with heading in the map' in diagnosis_status(found).sentence


TWINS = ('gyro_lag', 'camera_time_offset')


def law(effect: Effect, *values: float) -> Any:
    """An effect that was learned, with these estimates."""
    estimates = np.array(values or np.zeros(len(effect.coefficients)))
    after = SimpleNamespace(estimate_of=lambda name: (estimates, estimates))
    return SimpleNamespace(effect=effect, after=after, predictive_gain=90.0, sigma=8.0)


@pytest.mark.parametrize(
    ('found', 'what', 'signal'),
    [
        (law(place_map()), 'the bias goes with the place in the map', 'the place in the map'),
        (
            law(memory('scale', 'start')),
            'the scale goes with time since the start (s)',
            'time since the start (s)',
        ),
        (
            law(memory('bias', 'abs_rate')),
            'the bias goes with earlier values of the magnitude of the rate',
            'the magnitude of the rate',
        ),
        (
            law(memory('bias', 'any_turn')),
            'the bias goes with a turn to any side, fading after it',
            'a turn to any side, fading after it',
        ),
        (
            law(memory('bias', 'last_rest')),
            'the bias goes with the end of a rest, fading after it',
            'the end of a rest, fading after it',
        ),
        (
            law(memory('bias', 'dynamics')),
            'the bias goes with changes of the rate',
            'changes of the rate',
        ),
        (
            law(step('bias', at_s=41.0), 0.3 * DEG),
            'the bias jumped by +0.300 deg/s at 41 s',
            'time since the start (s)',
        ),
        (
            law(wave('scale', period_s=23.0), 0.03, 0.0, 0.0, 0.04, 0.0, 0.0),
            'the scale oscillates with an amplitude of 5.00 % and a period of 23.0 s',
            'time since the start (s)',
        ),
    ],
)
def test_a_law_in_words(found: Any, what: str, signal: str) -> None:
    structure = unknown_law.structure_of(found)
    assert structure.what == what and structure.shape.signal == signal
    assert structure.shape.of_scale == what.startswith('the scale')
    assert structure.at_s == (41.0 if 'jumped' in what else None)
    assert structure.gain == 90.0 and structure.sigma == 8.0 and len(structure.shape.knots) == 0


def test_a_curve_is_shown_over_its_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    x: Array = np.linspace(0.0, 1.0, 101)
    learned = SimpleNamespace(x=x, y=2.0 * x, std=0.1 + 0.0 * x)
    monkeypatch.setattr(unknown_law, 'learned_curve', lambda after, effect: learned)
    shape = unknown_law.structure_of(law(curve('bias', 'force_y', 0.0, 1.0))).shape
    assert shape.signal == 'sideways acceleration (m/s^2)' and not shape.of_scale
    np.testing.assert_allclose(shape.values, 2.0 * shape.knots)
    assert len(shape.knots) == 11 and np.all(shape.stds == 0.1)


def test_effects_that_follow_signals_or_a_noise_beside_others_may_imitate_a_law(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(unknown_law, 'timing_fault', lambda examined: None)

    def may_imitate(*names: str) -> bool:
        kept = [SimpleNamespace(effect=find_effect(name)) for name in names]
        return unknown_law._may_imitate(SimpleNamespace(kept=kept, last=None))  # type: ignore[arg-type]

    voltage, current = (f'covariate_scale:battery_state.{name}' for name in ('voltage', 'current'))
    assert may_imitate(voltage, current)
    assert not may_imitate(voltage) and not may_imitate(voltage, current, 'scale_cubic')
    assert may_imitate('scale_cubic', 'gyro_lag', 'bias_instability')
    assert not may_imitate('scale_cubic', 'bias_instability') and not may_imitate('bias_instability')


@pytest.mark.parametrize(
    ('names', 'together_with', 'gain', 'is_law'),
    [
        (('gyro_lag', 'camera_time_offset'), (), MIN_GAIN + 1.0, True),
        (('scale_cubic', 'camera_time_offset', 'gyro_lag'), (), MIN_GAIN + 1.0, True),
        (('gyro_lag', 'camera_time_offset'), (), MIN_GAIN - 1.0, False),
        (('gyro_lag', 'scale_cubic'), (), MIN_GAIN + 1.0, False),
        (('gyro_lag', 'scale_cubic'), ('scale_cubic',), MIN_GAIN + 1.0, True),
        (('gyro_lag', 'scale_cubic'), ('scale_cubic',), MIN_GAIN - 1.0, False),
        (('camera_tilt', 'principal_point'), (), MIN_GAIN + 1.0, False),
    ],
)
def test_two_effects_that_look_alike_or_explain_only_together_are_given_up_for_one_law(
    names: tuple[str, ...],
    together_with: tuple[str, ...],
    gain: float,
    is_law: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A low-pass of second order was called a lag and a camera whose images are stamped early."""
    monkeypatch.setattr(unknown_law, 'timing_fault', lambda examined: None)
    monkeypatch.setattr(unknown_law, 'is_missing_something', lambda examined: False)
    monkeypatch.setattr(unknown_law, '_is_unusual', lambda searched: False)
    monkeypatch.setattr(unknown_law, 'likeliest_law', lambda *about: Mock(is_kept=True))
    monkeypatch.setattr(unknown_law, '_gain', lambda before, after: gain)
    monkeypatch.setattr(unknown_law, '_saying', lambda searched, law: 'a law alone')
    additions = [Mock(effect=find_effect(name), before=Mock(), together_with=together_with) for name in names]
    searched: Any = Mock(kept=additions, additions=additions)
    assert (name_unknown(searched, None, None) == 'a law alone') == is_law  # type: ignore[arg-type, comparison-overlap]


@pytest.mark.parametrize(
    ('gain', 'is_kept', 'expected'),
    [
        (1.0 - MIN_GAIN, True, 'a law alone'),
        (-1.0 - MIN_GAIN, True, 'a law beside'),
        (MIN_GAIN - 1.0, False, 'neither'),
        (MIN_GAIN + 1.0, False, 'a law alone'),
    ],
)
def test_two_effects_that_look_alike_and_need_a_law_beside_them_are_given_up_for_it(
    gain: float, is_kept: bool, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bias that fades after turns to any side was called an asymmetry and a quadratic scale beside it."""
    beside, alone = Mock(is_kept=is_kept, predictive_gain=0.0), Mock(is_kept=True)
    last = Mock(unexplained_structure=None)
    kept = [Mock(effect=find_effect(name), before=Mock(), together_with=()) for name in TWINS]
    searched: Any = Mock(kept=kept, additions=kept, last=last)
    named = {id(beside): 'a law beside', id(alone): 'a law alone'}
    monkeypatch.setattr(unknown_law, 'timing_fault', lambda examined: None)
    monkeypatch.setattr(unknown_law, 'is_missing_something', lambda examined: True)
    monkeypatch.setattr(unknown_law, 'mounting_fault', lambda run: '')
    monkeypatch.setattr(unknown_law, '_is_explained', lambda searched: False)
    monkeypatch.setattr(unknown_law, '_behind_noise', lambda examined: None)
    monkeypatch.setattr(unknown_law, 'likeliest_law', lambda model, *_: beside if model is last else alone)
    monkeypatch.setattr(unknown_law, '_gain', lambda before, after: gain)
    monkeypatch.setattr(unknown_law, '_saying', lambda searched, law: named[id(law)])
    found: Any = name_unknown(searched, None, None)  # type: ignore[arg-type]
    assert found == expected if expected != 'neither' else found is searched


@pytest.mark.parametrize(
    ('names', 'expected'),
    [
        (('scale_cubic', 'gyro_lag', 'rate_noise'), 'before rate_noise'),
        (('scale_cubic', 'rate_noise', 'gyro_lag'), 'last'),
        (('scale_cubic', 'rate_noise'), 'last'),
        (('rate_noise',), 'last'),
        ((), 'last'),
    ],
)
def test_a_noise_that_came_after_several_effects_is_a_leftover(names: tuple[str, ...], expected: str) -> None:
    kept = [
        SimpleNamespace(effect=find_effect(name), before=SimpleNamespace(run=f'before {name}'))
        for name in names
    ]
    searched: Any = SimpleNamespace(kept=kept, last=SimpleNamespace(run='last'))
    found: Any = unknown_law._without_leftover(searched)
    assert found == expected


@pytest.mark.parametrize(('part_of_typical', 'count'), [(1.0, 0), (2.4, 0), (2.6, 1)])
def test_a_model_with_a_noise_that_no_gyro_has(part_of_typical: float, count: int) -> None:
    noise = find_effect('bias_instability')
    usual = noise.coefficients[0].typical
    assert usual is not None
    model = with_effect(default_model(), with_means(noise, (part_of_typical * usual.high,)))
    assert len(unusual_noises(model)) == count


def test_where_nothing_is_missing_no_law_is_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unknown_law, 'is_missing_something', lambda examined: False)
    monkeypatch.setattr(unknown_law, '_may_imitate', lambda searched: False)
    first: Any = SimpleNamespace(model=default_model())
    searched = Search(first, ())
    assert name_unknown(searched, None, None) is searched  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('name', 'values', 'is_unusual'),
    [
        ('bias_warmup', (0.003, 120.0), False),
        ('bias_warmup', (0.003, 13.0), True),
        ('scale_temperature', (8e-4,), False),
        ('scale_temperature', (-3.8e-3,), True),
        ('gyro_noise', (1.0,), False),
        ('rate_saturation', (9.0,), False),
    ],
)
def test_an_effect_of_a_size_that_no_gyro_has_is_unusual(
    name: str, values: tuple[float, ...], is_unusual: bool
) -> None:
    """It may stand for a law that the library lacks."""
    last = SimpleNamespace(estimate_of=lambda _: (np.array(values), np.zeros(len(values))))
    searched: Any = SimpleNamespace(kept=[SimpleNamespace(effect=find_effect(name))], last=last)
    assert unknown_law._is_unusual(searched) == is_unusual
