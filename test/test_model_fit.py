"""Whether a model fits a recording."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import drive

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import nanoseconds
from gyrocal_ros.diagnose.analysis.drift import BlindDrift, blind_drift, drift_by_noise_deg, held_out_from_s
from gyrocal_ros.diagnose.analysis.model_fit import UNSEEN, ModelFit, count_gaps, model_fit
from gyrocal_ros.diagnose.status import calibration_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history.run import Run, RunEvent
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.ekf.watches.scale_watch import ScaleChange
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource


def simulated(hidden: tuple[HiddenEffect, ...]) -> Run:
    scenario = replace(find_scenario('cleaning'), duration_s=100.0, imu_hz=100, camera_hz=5)
    return calibrate(SimSource(scenario, 3, hidden=hidden), Config(), default_model())


@pytest.mark.slow
def test_a_clean_recording_fits() -> None:
    run = simulated(())
    assert model_fit(run).fits is True
    assert conclude(run).converged
    change = str(ScaleChange(0, 0.01, 0.001, 10.0, was_calibrated=True))
    for times_s, is_misfit in (((20.0,), False), ((80.0,), True), ((20.0, 30.0), True)):
        events = tuple(RunEvent(run.span.start_ns + nanoseconds(time_s), change) for time_s in times_s)
        misfits = model_fit(replace(run, events=events)).misfits
        assert bool(misfits) == is_misfit, 'an earlier calibration may be wrong at first, and once'


@pytest.mark.slow
def test_a_missing_effect_contradicts_the_model_and_widens_the_result() -> None:
    run = simulated((HiddenEffect(find_effect('scale_asymmetry'), (0.02,)),))
    fit, calibration = model_fit(run), conclude(run)
    assert fit.fits is False and not calibration.converged
    assert any('the estimates change' in text for text in fit.misfits)
    assert any('noise explains' in text for text in fit.misfits)
    assert calibration.scale_factor_std > 10.0 * run.history.std[-1, 9]


def test_a_short_recording_cannot_tell() -> None:
    assert ModelFit((), False).fits is None
    assert ModelFit((), True).fits is True
    assert ModelFit(('too large',), False).fits is False


def test_gaps_of_the_gyro_are_counted_once() -> None:
    """A gap lasts for some steps of the filter."""
    history = drive(duration_s=100.0).run.history
    gap_s = np.zeros_like(history.dt_s)
    gap_s[[0, 100, 101, 102, 300, 301]] = 0.1
    assert count_gaps(replace(history, gap_s=gap_s)) == 3
    assert count_gaps(history) == 0


@pytest.mark.slow
def test_a_calibration_that_no_image_confirms_is_not_green() -> None:
    """A stored one may be that of another gyro."""
    scenario = replace(find_scenario('cleaning'), duration_s=100.0, camera_hz=5, camera_until_s=3.0)
    source = SimSource(scenario, 3)
    stored = Start(('scale_factor',), np.array([source.truth.scale_factor - 0.96]), np.array([[1e-9]]))
    run = replace(calibrate(source, Config(), default_model(), stored), truth=None)
    fit = model_fit(run)
    assert fit.fits is None and not fit.misfits
    status = calibration_status(conclude(run), run, fit)
    assert status.level == 'yellow'
    assert status.sentence.endswith('but no image or heading is used after 3 of 100 s.')
    dof = run.history.dof.copy()
    dof[np.searchsorted(run.history.time_s, 52.0)] = 2
    once_more = replace(run, history=replace(run.history, dof=dof))
    fit = model_fit(once_more)
    assert fit.fits is None and fit.unseen == UNSEEN
    status = calibration_status(conclude(once_more), once_more, fit)
    assert status.level == 'yellow' and status.sentence.endswith(f'but {UNSEEN}.')


@pytest.mark.slow
def test_the_drift_is_compared_with_what_noise_explains(monkeypatch: pytest.MonkeyPatch) -> None:
    run = simulated(())
    drift = blind_drift(run, from_s=held_out_from_s(run))
    assert model_fit(run).drift_ratio == pytest.approx(drift.rms_deg / drift_by_noise_deg(run, drift))
    monkeypatch.setattr('gyrocal_ros.diagnose.analysis.model_fit.drift_by_noise_deg', lambda *_: 0.0)
    assert math.isnan(model_fit(run).drift_ratio)


def test_the_drift_by_noise_adds_all_its_sources() -> None:
    run = drive(duration_s=100.0).run
    history = run.history
    steps = len(history.time_s)
    std = np.zeros_like(history.std)
    std[:, 5], std[:, 8] = 0.001, 1e-4
    history = replace(history, std=std, gyro_valid_s=history.dt_s, resting=np.zeros(steps))
    run = replace(run, history=history)
    drift = blind_drift(run)
    gyro, span_s = run.config.gyro, drift.span_s
    rate, walk = math.radians(gyro.rate_noise_deg_s), math.radians(gyro.bias_walk_deg_s)
    expected = 2.0 * 0.001**2 + rate**2 * span_s + walk**2 * span_s**3 / 3.0 + (1e-4 * span_s) ** 2
    assert drift_by_noise_deg(run, drift) == pytest.approx(math.degrees(math.sqrt(expected)), rel=0.01)
    unread = np.where((history.time_s > 65.0) & (history.time_s < 67.5), 1e-3, 0.0)
    blind = replace(run, history=replace(history, unobserved_turn_std_rad=unread))
    whole = (unread.sum() ** 2) * np.mean((drift.start_s < 65.0) & (drift.start_s + span_s > 67.5))
    assert drift_by_noise_deg(blind, drift) == pytest.approx(
        math.degrees(math.sqrt(expected + whole)), rel=0.01
    )
    none = BlindDrift(span_s, np.empty(0), np.empty(0), 'slam')
    assert math.isnan(drift_by_noise_deg(run, none))
