"""Tests of ground truth that is wrong: it is said, and spoils neither calibration nor comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import TRUTH, heading_error, heading_rms_deg, reference_heading
from gyrocal_ros.diagnose.analysis.ground_truth import truth_fault
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.paths import truth_heading
from gyrocal_ros.diagnose.status import Status, calibration_status
from gyrocal_ros.effects import EFFECTS, default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.forward import HiddenEffect

Change = Callable[[Array, Array], Array]


@pytest.fixture(scope='module')
def run() -> Run:
    return calibrate(recording('lanes', duration_s=110.0), Config(), default_model())


def changed(run: Run, change: Change) -> Run:
    """Return the run with another ground truth, whose headings are a function of times and headings."""
    assert run.truth is not None
    yaw_rad = change(run.truth.time_s, run.truth.yaw_rad)
    return replace(run, truth=replace(run.truth, yaw_rad=yaw_rad))


def status(run: Run) -> Status:
    return calibration_status(conclude(run), run, model_fit(run))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('change', 'fault'),
    [
        (lambda time, yaw: -yaw, 'turns opposite to gyro and camera'),
        (lambda time, yaw: np.interp(time - 0.1, time, yaw), 'is 100 ms late'),
        (lambda time, yaw: np.interp(time + 0.2, time, yaw), 'is 200 ms early'),
        (lambda time, yaw: yaw + 0.001 * time, 'drifts or jumps against gyro and camera, by 3.'),
        (lambda time, yaw: yaw + (time > 70.0), 'drifts or jumps against gyro and camera, by 57'),
    ],
)
def test_wrong_ground_truth_is_named_and_not_compared_with(run: Run, change: Change, fault: str) -> None:
    wrong = changed(run, change)
    assert reference_heading(run)[1] == TRUTH and truth_fault(run) == ('', '')
    assert reference_heading(wrong)[1] == 'slam'
    said, remedy = truth_fault(wrong)
    assert fault in said and remedy.endswith('.')
    assert model_fit(wrong).fits is model_fit(run).fits is True
    assert (status(run).level, status(wrong).level) == ('green', 'yellow')
    assert said in status(wrong).sentence and status(wrong).next_step == remedy


@pytest.mark.slow
@pytest.mark.usefixtures('library')
def test_ground_truth_that_shows_what_the_model_lacks_is_right() -> None:
    hidden = HiddenEffect(EFFECTS['scale_asymmetry'], (0.01,))
    run = calibrate(recording('lanes', duration_s=110.0, hidden=(hidden,)), Config(), default_model())
    assert reference_heading(run)[1] == TRUTH and truth_fault(run) == ('', '')
    assert status(run).level == 'red'


@pytest.mark.slow
def test_nothing_is_compared_in_a_gap_of_the_ground_truth(run: Run) -> None:
    assert run.truth is not None
    kept = (run.truth.time_s < 20.0) | (run.truth.time_s > 32.0)
    columns = {name: getattr(run.truth, name)[kept] for name in ('time_s', 'position_m', 'yaw_rad')}
    away = replace(run, truth=replace(run.truth, **columns))
    error = heading_error(away)
    assert error is not None
    assert not ((error.time_s > 20.1) & (error.time_s < 31.9)).any() and error.time_s[-1] > 100.0
    assert heading_rms_deg(away) == pytest.approx(heading_rms_deg(run), abs=0.02)


@pytest.mark.slow
def test_ground_truth_that_was_frozen_for_a_while_is_right_again_afterwards(run: Run) -> None:
    def frozen(time: Array, yaw: Array) -> Array:
        last = np.searchsorted(time, 15.0)
        return np.where((time > 15.0) & (time < 35.0), yaw[last], yaw + 2.0 * np.pi * (time >= 35.0))

    heading, right = truth_heading(changed(run, frozen)), truth_heading(run)
    assert heading is not None and right is not None
    after = heading.time_s > 35.0
    np.testing.assert_allclose(heading.yaw_rad[after], right.yaw_rad[after], atol=1e-9)
    assert (heading_rms_deg(run) or 0.0) < 0.2 < (heading_rms_deg(changed(run, frozen)) or 0.0)
