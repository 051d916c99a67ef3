"""Wheels of another size: the path stays in metres of the odometer; only the camera's lever arm shows it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, WheelSample
from gyrocal_ros.diagnose.analysis.candidate_fit import correlation
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, POSITION
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.sensors import SensorErrors, without_noise
from gyrocal_ros.sim.world import SimSource

SCALE, SLIP_M = 0.05, 0.02
WHEELS = HiddenEffect(find_effect('wheel_scale'), (SCALE,))
SLIP = HiddenEffect(find_effect('turn_slip'), (SLIP_M,))


def larger_wheels(*more: HiddenEffect) -> SimSource:
    """Return a drive with wheels that are larger than assumed."""
    return recording('cleaning', 2, 100.0, (WHEELS, *more))


def model_with(*names: str) -> SensorModel:
    base = default_model()
    return replace(base, effects=(*base.effects, *map(find_effect, names)))


@cache
def refit(*names: str) -> Run:
    """Run the filter over the drive with additional effects."""
    return calibrate(larger_wheels(), Config(), model_with(*names))


def estimate(run: Run, name: str) -> tuple[float, float]:
    """Return value and standard deviation of a coefficient at the end of a run."""
    place = COEFFICIENTS_START + run.model.coefficient_names.index(name)
    return float(run.history.mean[-1, place]), float(run.history.std[-1, place])


def examined(source: SimSource) -> tuple[ExaminedModel, dict[str, str]]:
    """Return the examined model, and the effects that are not judged with their reasons."""
    recorded = summarise_recording(source)
    stage = examine(
        default_model(), recorded, lambda model, tried: calibrate(source, Config(), model, candidates=tried)
    )
    return stage, diagnose(Search(stage, ()), recorded).not_judged


def reported_m(*hidden: HiddenEffect) -> Array:
    """Return the distance that noiseless wheels report for every interval."""
    errors = without_noise(SensorErrors())
    source = recording('cleaning', 2, 20.0, hidden, errors=errors)
    speeds = [item.speed_m_s for item in source.measurements() if isinstance(item, WheelSample)]
    return np.array(speeds) / source.scenario.wheel_hz


def test_true_distance_is_odometry_times_one_plus_s() -> None:
    np.testing.assert_allclose((1.0 + SCALE) * reported_m(WHEELS), reported_m(), atol=1e-12)


def test_turn_slip_is_in_metres_of_the_odometer() -> None:
    slipped = reported_m(SLIP) - reported_m()
    assert slipped.max() > 1e-4
    np.testing.assert_allclose(reported_m(WHEELS, SLIP) - reported_m(WHEELS), slipped, atol=1e-12)
    np.testing.assert_array_equal(reported_m(WHEELS, SLIP), reported_m(SLIP, WHEELS))


def test_the_simulated_camera_has_its_nominal_mounting() -> None:
    source = larger_wheels()
    np.testing.assert_array_equal(source.truth.camera_mount.p_bs, source.rig.camera_mount.p_bs)


@pytest.mark.slow
def test_the_estimate_agrees_with_its_standard_deviation() -> None:
    value, std = estimate(refit('wheel_scale'), 'wheel_scale')
    assert abs(value - SCALE) < 3.0 * std
    assert 0.002 < std < 0.01, 'half a millimetre of the lever arm of 9 cm'


@pytest.mark.slow
def test_the_path_stays_in_metres_of_the_odometer() -> None:
    source, run = larger_wheels(), refit('wheel_scale')
    true = source.truth.position(run.history.time_s)
    reach_m = np.linalg.norm(np.ptp(true[:, :2], axis=0))
    found_m = np.linalg.norm(np.ptp(run.history.mean[:, POSITION][:, :2], axis=0))
    assert reach_m > 1.0
    assert found_m * (1.0 + SCALE) == pytest.approx(reach_m, rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize('names', [('wheel_scale', 'camera_position'), ('camera_position', 'wheel_scale')])
def test_beside_the_camera_position_it_is_not_observable(names: tuple[str, str]) -> None:
    value, std = estimate(refit(*names), 'wheel_scale')
    assert std > 0.98 * find_effect('wheel_scale').coefficients[0].prior_std
    assert abs(value - SCALE) < 3.0 * std


@pytest.mark.slow
def test_its_score_statistics_are_those_of_the_camera_along_its_lever_arm() -> None:
    stage, not_judged = examined(larger_wheels())
    found = {ranked.effect.name: ranked for ranked in stage.ranked}
    wheels, camera = found['wheel_scale'], found['camera_position']
    assert correlation(stage.scores, wheels.columns, camera.columns) == pytest.approx(1.0, abs=1e-6)
    assert abs(wheels.fit.values[0] - SCALE) < 4.0 * np.sqrt(wheels.fit.covariance[0, 0])
    assert 'wheel_scale' not in not_judged


@pytest.mark.slow
@pytest.mark.parametrize('at_m', [0.0, 0.005])
def test_without_a_lever_arm_it_is_not_judged(at_m: float) -> None:
    centred = recording('cleaning', 2, 20.0, (WHEELS,), mount_xyz_m=(0.0, at_m, 0.1))
    stage, not_judged = examined(centred)
    assert 'wheel_scale' not in {ranked.effect.name for ranked in stage.ranked}
    assert 'distance from the turning centre' in not_judged['wheel_scale']


def test_the_effects_command_places_it_in_the_wheels(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['effects', 'wheel_scale', '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed['acts_on'] == 'wheels' and 'metres of the odometer' in printed['physics']
