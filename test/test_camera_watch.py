"""A camera that differs from its calibration is found, and its error counts in the standard deviations."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config, ConvergenceConfig
from gyrocal_ros.data import Rig
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.history.convergence import CONSISTENCY_STEPS, STEPS_AFTER_CHANGE, Convergence
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, State
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.ekf.watches.camera_faults import time_fault
from gyrocal_ros.ekf.watches.camera_watch import GATE, PRIOR_STD, TIME, CameraWatch
from gyrocal_ros.ekf.watches.told_faults import told_fault
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.world import SimSource

COUNT = len(PRIOR_STD)


def some_state(by_k1: float) -> State:
    """Return a state whose scale factor depends on k1."""
    state = initial_state(default_model(), Config(), None, COUNT)
    state.sensitivity[COEFFICIENTS_START, 0] = by_k1
    return state


def stats_of(k1: float, sigma: float, nis: float = 0.0, dof: int = 1) -> UpdateStats:
    """Return an update that shows k1 with a significance."""
    information = np.zeros(COUNT)
    information[0] = (sigma / k1) ** 2
    return UpdateStats(sigma**2 + nis, dof, information=np.diag(information), score=information * k1)


def test_only_a_significant_error_shifts_the_scale_factor() -> None:
    state, shifts = some_state(0.5), []
    for sigma in (0.9 * math.sqrt(GATE), 20.0):
        watch = CameraWatch(0)
        watch.add(0.1, (stats_of(0.01, sigma),))
        shifts.append(watch.shift(state))
    assert SCALE == 1 and shifts[0] is None and shifts[1] is not None
    np.testing.assert_allclose(shifts[1], [0.0, 0.5 * 0.01], rtol=0.02)


def test_innovations_that_no_camera_explains_are_noise() -> None:
    watch = CameraWatch(0)
    watch.add(0.1, (stats_of(0.01, 20.0, nis=1000.0, dof=10),))
    assert watch.shift(some_state(0.5)) is None


def test_an_error_is_reported_once_it_has_mattered_for_some_time() -> None:
    watch, state = CameraWatch(0), some_state(50.0)
    watch.add(0.1, (stats_of(0.01, 20.0),))
    said = [watch.finding(4.0, state, watch.shift(state)) for _ in range(3)]
    assert said[:2] == ['', ''] and said[2].startswith('the distortion in camera_info does not fit')
    assert watch.finding(4.0, state, np.zeros(2)) == '', 'it no longer matters'


def with_rig(rig: Rig, seed: int = 1) -> Run:
    source = recording('cleaning', seed, 45.0)
    return calibrate(ModifiedSource(source, iter, rig), Config(), default_model(), follows_changes=True)


@pytest.mark.parametrize('fault', ['lens', 'tilt'])
def test_a_wrong_camera_is_named_and_no_result_claims_more_than_it_knows(fault: str) -> None:
    source = recording('cleaning', 1, 45.0)
    rig, camera = source.rig, source.rig.camera
    assert camera is not None
    if fault == 'lens':
        wrong = replace(rig, camera=replace(camera, distortion=(0.01, 0.01, 0.0, 0.0, 0.01)))
        said = 'the distortion in camera_info does not fit the images'
    else:
        R = rotation_from_euler(np.radians([1.5, 0.0, 0.0]))
        wrong = replace(rig, camera_mount=replace(rig.camera_mount, R_bs=rig.camera_mount.R_bs @ R))
        said = 'beside the direction of its transform'
    run = with_rig(wrong)
    found = conclude(run)
    assert sum(said in event.text for event in run.events) == 1
    is_right = abs(found.scale_factor - source.truth.scale_factor) < 3.0 * found.scale_factor_std
    assert is_right or not found.converged


def driven(name: str, *values: float, seed: int = 1, adds: bool = False) -> tuple[Run, SimSource]:
    """Return a run of a recording with a hidden effect, and the recording.

    Args:
        name: of the effect.
        values: its coefficients.
        seed: of the recording.
        adds: whether the model has the effect.
    """
    effect, model = find_effect(name), default_model()
    source = recording('cleaning', seed, 60.0, hidden=(HiddenEffect(effect, values),))
    model = with_effect(model, effect) if adds else model
    return calibrate(source, Config(), model, follows_changes=True), source


def calibrated(name: str, *values: float, adds: bool = False) -> tuple[Run, float]:
    """Return a run as `driven`, which has to converge, and its error of the scale factor in sigma."""
    run, source = driven(name, *values, adds=adds)
    found = conclude(run)
    assert found.convergence_time_s is not None
    return run, (found.scale_factor - source.truth.scale_factor) / found.scale_factor_std


def told(run: Run, first_words: str) -> float:
    """Return the size of the fault of the camera that a run told last."""
    faults = [told_fault(event.text) for event in run.events]
    fault = [words for words, remedy in faults if remedy.startswith('a diagnosis')][-1]
    assert fault.startswith(first_words)
    (number, *_) = re.findall(r'[0-9.]+', fault)
    return float(number)


@pytest.mark.parametrize(
    ('name', 'values', 'first_words', 'size', 'recordings'),
    [
        ('camera_time_offset', (0.02,), 'the images and the gyro are', 20.0, 1),
        ('camera_time_offset', (-0.006,), 'the images and the gyro are', 6.0, 1),
        ('gyro_lag', (0.008,), 'the images and the gyro are', 8.0, 4),
        ('rolling_shutter', (0.02,), 'the rows of an image are exposed', 20.0, 1),
        ('principal_point', (3.0, 3.0), 'the principal point in camera_info is off by', 3.0, 1),
    ],
)
def test_what_the_camera_does_is_no_change_of_the_scale_factor(
    name: str, values: tuple[float, ...], first_words: str, size: float, recordings: int
) -> None:
    run, z = calibrated(name, *values)
    assert not run.history.scale_followed.any() and abs(z) < 2.5
    others = [driven(name, *values, seed=seed)[0] for seed in range(2, recordings + 1)]
    assert np.mean([told(each, first_words) for each in (run, *others)]) == pytest.approx(size, rel=0.1)
    assert not calibrated(name, *values, adds=True)[0].events, 'the model has it'


def test_the_words_tell_which_clock_is_late() -> None:
    assert 'the images are stamped late' in time_fault(np.array([0.005]), 9.0)
    assert 'the gyro lags' in time_fault(np.array([-0.005]), 9.0)


def test_the_time_between_images_and_gyro_is_followed_once_it_is_sure() -> None:
    state, watch = some_state(0.0), CameraWatch(0)
    state.sensitivity[COEFFICIENTS_START, TIME] = 0.5
    information = np.zeros((COUNT, COUNT))
    information[TIME, TIME] = (20.0 / 0.01) ** 2
    watch.add(0.1, (UpdateStats(402.0, 2, information=information, score=information[:, TIME] * 0.01),))
    for step in range(4):
        before = state
        state, has_changed = watch.with_time_offset(state, 1.0 if step else 0.0)
        assert has_changed == (step == 3), 'three seconds with images'
    assert watch.time_offset_s == pytest.approx(0.01, rel=0.03) and '10.0 ms' in watch.allowed_for
    followed = state.mean - before.mean
    assert followed[COEFFICIENTS_START] == pytest.approx(0.5 * watch.time_offset_s)
    assert abs(watch.sums.values[TIME]) < 1e-12 and not watch.errors.any(), 'nothing is left'
    assert not watch.with_time_offset(state, 10.0)[1]


def test_a_time_that_changes_again_is_no_offset_of_the_stamps() -> None:
    state, watch = some_state(0.0), CameraWatch(0)
    told = []
    for offset_s in (0.004, 0.03, 0.012):
        information = np.zeros((COUNT, COUNT))
        information[TIME, TIME] = (20.0 / 0.002) ** 2
        left_s = offset_s - watch.time_offset_s
        nis = information[TIME, TIME] * left_s**2 + 2.0
        watch.add(0.1, (UpdateStats(nis, 2, information=information, score=information[:, TIME] * left_s),))
        for step in range(4):
            state, _ = watch.with_time_offset(state, 1.0 if step else 0.0)
        told.append(watch.allowed_for)
        watch.restart()
    assert all('images are stamped late' in words for words in told[:2])
    assert 'apart by changing times, now' in told[2] and 'images are stamped' not in told[2]


def test_a_time_offset_that_has_gone_is_no_fault_any_more() -> None:
    state, watch = some_state(0.0), CameraWatch(0)
    information = np.zeros((COUNT, COUNT))
    information[TIME, TIME] = (20.0 / 0.01) ** 2
    for offset_s, nis, is_fault in ((0.01, 402.0, True), (-0.02, 802.0, False)):
        score = information[:, TIME] * offset_s
        watch.add(0.1, (UpdateStats(nis, 2, information=information, score=score),))
        assert watch.with_time_offset(state, 10.0)[1]
        assert bool(watch.allowed_for) == is_fault
    assert abs(watch.time_offset_s) < 0.001
    assert '0.04 ms apart' in time_fault(np.array([4e-5]), 7.0)


def test_what_the_model_estimates_is_no_error_of_the_camera() -> None:
    information = np.zeros((COUNT, COUNT))
    information[TIME, TIME] = (20.0 / 0.01) ** 2
    shown = UpdateStats(402.0, 2, information=information, score=information[:, TIME] * 0.01)
    for estimated, offset_s in (((), 0.01), (('camera_time_offset',), 0.0)):
        watch = CameraWatch(0, estimated)
        watch.add(0.1, (shown,))
        assert watch.errors[TIME] == pytest.approx(offset_s, rel=0.03, abs=1e-6)


def test_runs_that_are_compared_keep_the_stamps_as_they_are() -> None:
    effect = find_effect('camera_time_offset')
    source = recording('cleaning', 1, 60.0, hidden=(HiddenEffect(effect, (0.02,)),))
    compared = calibrate(source, Config(), default_model())
    followed = calibrate(source, Config(), default_model(), follows_changes=True)
    nis = [run.history.nis.sum() / run.history.dof.sum() for run in (compared, followed)]
    assert nis[0] > 1.5 > 1.3 > nis[1]


def test_nothing_is_said_of_a_right_camera() -> None:
    run = with_rig(recording('cleaning', 1, 45.0).rig)
    assert not run.events and conclude(run).converged


def test_after_a_change_consistency_needs_enough_steps() -> None:
    config = ConvergenceConfig()
    for after_change in (False, True):
        watch = Convergence(after_change)
        for i in range(STEPS_AFTER_CHANGE):
            assert watch.is_consistent(config) == (not after_change and i > 0)
            assert ('since the scale factor changed' in watch.doubt(config)) == after_change
            watch.add(0.1 * i, 1e-4, 4.0, 2, config)
        assert watch.is_consistent(config) and not watch.doubt(config)
        assert watch.inflation == pytest.approx(math.sqrt(2.0))


def test_the_recent_nis_is_that_of_the_last_measured_steps() -> None:
    watch, config = Convergence(), ConvergenceConfig()
    assert math.isnan(watch.recent_nis)
    for i, (nis, dof) in enumerate([(2.0, 2), (0.0, 0), (9.0, 1)]):
        watch.add(0.1 * i, 1e-4, nis, dof, config)
        assert watch.recent_nis == pytest.approx([1.0, 1.0, 11.0 / 3.0][i])
    for i in range(CONSISTENCY_STEPS):
        watch.add(1.0 + 0.1 * i, 1e-4, 1.0, 2, config)
    assert watch.recent_nis == pytest.approx(0.5) and watch.overall_nis > watch.recent_nis


def test_innovations_that_stay_small_are_no_reason_for_distrust() -> None:
    """Early, the noise is not learned; later, the features are better than the filter assumes."""
    watch, config = Convergence(), ConvergenceConfig()
    for i in range(CONSISTENCY_STEPS):
        assert not watch.is_consistent(config) and watch.is_too_calm(config) == (i > 0)
        watch.add(0.1 * i, 1e-4, 0.3, 1, config)
        assert ('not yet learned' in watch.doubt(config)) == watch.is_too_calm(config)
    assert watch.is_consistent(config) and not watch.is_too_calm(config)
    assert watch.inflation == 1.0
