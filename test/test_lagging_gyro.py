"""A gyro that lags, beside a heading reference whose time offset is not known either."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.traits import why_unobservable
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import SensorModel, with_means
from gyrocal_ros.pipeline.by_heading import for_reference
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import InMemorySource, preload
from gyrocal_ros.pipeline.run_filter import run_filter
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

LAG = find_effect('gyro_lag')
DURATION_S, SEED = 70.0, 4


@cache
def beside(
    kind: str, lag_s: float, *others: tuple[str, float]
) -> tuple[ReferenceSource, InMemorySource, Config]:
    """Return a recording with a reference of a kind: as simulated, as loaded, and its settings."""
    scenario = replace(find_scenario('cleaning'), duration_s=DURATION_S, imu_hz=100, camera_hz=5)
    hidden = [HiddenEffect(LAG, (lag_s,))] if lag_s else []
    hidden += [HiddenEffect(find_effect(name), (value,)) for name, value in others]
    simulated = ReferenceSource(SimSource(scenario, SEED, hidden=tuple(hidden)), kind)
    loaded, config = preload(simulated, Config(), default_model())
    assert isinstance(loaded, InMemorySource)
    return simulated, loaded, config


def with_lag(mean_s: float = 0.0, std_s: float | None = None) -> SensorModel:
    """Return the default model with a lag of the gyro."""
    model, effect = default_model(), with_means(LAG, (mean_s,))
    if std_s is not None:
        (tau,) = effect.coefficients
        effect = replace(effect, coefficients=(replace(tau, prior_std=std_s),))  # type: ignore[type-var]
    return replace(model, effects=(*model.effects, effect))


def off_by_sigma(run: Run, true: ReferenceSource) -> float:
    found = conclude(run)
    return abs(found.scale_factor - true.truth.scale_factor) / found.scale_factor_std


@pytest.mark.slow
@pytest.mark.parametrize('lag_s', [0.02, 0.04])
def test_the_ends_of_turns_tell_a_lag_from_late_stamps(lag_s: float) -> None:
    true, loaded, _ = beside('mocap', lag_s)
    found = loaded.reference
    assert found is not None and found.certain_effects == {'gyro_lag'}
    late_s = lag_s / true.truth.scale_factor
    assert abs(found.gyro_lag_s - late_s) < 4.0 * found.gyro_lag_std_s < 0.2 * late_s
    assert abs(found.time_offset_s - true.reference.offset_s) < 4.0 * found.gyro_lag_std_s


@pytest.mark.slow
@pytest.mark.parametrize(
    ('kind', 'hidden'),
    [
        ('mocap', ()),
        ('mocap', (('scale_asymmetry', 0.01),)),
        ('mocap', (('rate_deadband', 0.01),)),
        ('encoders', ()),
        ('lidar', ()),
    ],
)
def test_nothing_else_looks_like_a_lag(kind: str, hidden: tuple[tuple[str, float], ...]) -> None:
    _, loaded, _ = beside(kind, 0.0, *hidden)
    assert loaded.reference is not None and not loaded.reference.certain_effects
    assert 'time offset' in why_unobservable(LAG, summarise_recording(loaded))


@pytest.mark.slow
def test_a_calibration_without_the_lag_is_not_off() -> None:
    """Taken for a time offset, it was off by eight standard deviations."""
    true, loaded, config = beside('mocap', 0.04)
    run = calibrate(loaded, config, default_model(), follows_changes=True)
    assert off_by_sigma(run, true) < 3.0
    assert any('the gyro lags by' in event.text for event in run.events)


@pytest.mark.slow
def test_the_lag_is_as_doubtful_as_the_time_offset() -> None:
    true, loaded, config = beside('mocap', 0.04)
    run = calibrate(loaded, config, with_lag())
    values, stds = run.history.coefficients[-1], conclude(run).stds[1:]
    assert loaded.reference is not None and stds[1] > 0.9 * loaded.reference.gyro_lag_std_s
    assert abs(values[1] - 0.04) < 3.0 * stds[1] < 0.004
    assert off_by_sigma(run, true) < 3.0
    assert not any('the gyro lags by' in event.text for event in run.events)


@pytest.mark.slow
def test_a_known_lag_is_kept_where_the_reference_cannot_show_it() -> None:
    """The reference is late by what is left of the difference."""
    true, loaded, config = beside('lidar', 0.04)
    assert loaded.reference is not None and not loaded.reference.certain_effects
    run = calibrate(loaded, config, with_lag(0.04, 0.001))
    assert run.history.coefficients[-1, 1] == pytest.approx(0.04, abs=0.002)
    assert conclude(run).stds[2] >= 0.001
    assert off_by_sigma(run, true) < 3.0


@pytest.mark.slow
def test_the_diagnosis_names_the_lag_and_what_is_beside_it() -> None:
    _, loaded, config = beside('mocap', 0.04, ('scale_asymmetry', 0.01))
    recorded, run = summarise_recording(loaded), partial(calibrate, loaded, config)
    searched = find_missing(default_model(), recorded, lambda model, tried: run(model, candidates=tried))
    found = diagnose(searched, recorded)
    names = [item.effect.name for item in found.missing]
    assert names[0] == 'gyro_lag' and len(names) == 2
    assert 'scale_asymmetry' in (names[1], *found.missing[1].confused_with)
    values, stds = searched.last.estimate_of('gyro_lag')
    assert abs(values[0] - 0.04) < 4.0 * stds[0] < 0.01


@pytest.mark.slow
def test_a_robot_keeps_the_lag_of_its_model() -> None:
    """It learns the time offset beside it. The lag was pulled to zero, and nothing converged."""
    true, loaded, config = beside('mocap', 0.04)
    live = for_reference(config)
    run = run_filter(
        loaded, loaded.measurements(), live, with_lag(0.04, 0.001), None, None, (), follows_changes=True
    )
    found = conclude(run)
    assert found.converged and found.scale_factor_std < 5e-4 and off_by_sigma(run, true) < 3.0
    assert abs(found.values[2] - 0.04) < 3.0 * found.stds[2] < 0.006 and found.stds[2] >= 0.001
