"""Calibration of good and of bad recordings, end to end."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from recordings import (
    Modification,
    ModifiedSource,
    at,
    each,
    random_pixels,
    recording,
    with_clock_step,
    with_features_of,
    without,
)
from synthetic import drive

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    FeatureObservations,
    HeadingSample,
    ImuSample,
    Measurement,
    Source,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.diagnose.analysis.drift import blind_drift, heading_rms_deg
from gyrocal_ros.diagnose.json_summary import summarise
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.errors import ConfigError, FilterDivergedError, NotObservableError, RecordingError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate, marks_on_lens
from gyrocal_ros.pipeline.calibration import (
    Calibration,
    announcement,
    conclude,
    load_calibration,
    save_calibration,
)
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.pipeline.visual_slam import VisualSlam
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.manoeuvres import DrivingStyle
from gyrocal_ros.sim.sensors import SensorErrors
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.vision.dirty_lens import LIFETIME_S, MANY_MARKS

TRUE_SCALE = SensorErrors().scale_factor


def plain(scenario: str = 'cleaning', seed: int = 1) -> SimSource:
    """Return an ordinary recording, with twice as many images as the others."""
    return recording(scenario, seed, camera_hz=10)


@cache
def plain_run(scenario: str = 'cleaning', seed: int = 1) -> Run:
    """Calibrate an ordinary recording with the default settings."""
    return calibrate(plain(scenario, seed), Config(), default_model())


def with_features(**changes: Any) -> Config:
    return replace(Config(), features=replace(Config().features, **changes))


def assert_calibrated(run: Run, percent: float = 0.04, true_scale: float = TRUE_SCALE) -> None:
    """Check the scale factor to a percentage, and to 4 of its standard deviations."""
    error = 1.0 + float(run.state.coefficients[0]) - true_scale
    std = math.sqrt(run.state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])
    assert abs(error) < 4.0 * std
    assert abs(error) < percent / 100.0 * true_scale
    assert np.all(np.linalg.eigvalsh(_correlation(run.state.covariance)) > -1e-12)


def _correlation(covariance: Array) -> Array:
    """Return the correlation matrix: its eigenvalues do not depend on the units of the state."""
    std = np.sqrt(covariance.diagonal())
    std[std == 0.0] = 1.0  # what is certain
    return covariance / np.outer(std, std)


def same_estimates(run: Run, other: Run) -> bool:
    """Return True if the estimates are bit-identical at every step."""
    return np.array_equal(run.history.mean, other.history.mean) and np.array_equal(
        run.state.covariance, other.state.covariance
    )


# --- good recordings ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 2])
@pytest.mark.parametrize('scenario', ['cleaning', 'lanes'])
def test_scale_and_bias_are_found(scenario: str, seed: int) -> None:
    run = plain_run(scenario, seed)
    assert_calibrated(run, percent=0.02)
    history = run.history
    true_bias = plain(scenario, seed).truth.bias_rad_s[-1, 2]
    assert abs(history.mean[-1, YAW_BIAS] - true_bias) < 4.0 * history.std[-1, YAW_BIAS]
    assert history.nis.sum() / history.dof.sum() == pytest.approx(1.0, abs=0.05)
    assert history.pixel_noise_px[-1] == pytest.approx(SensorErrors().pixel_noise_px, rel=0.05)
    heading = heading_rms_deg(run)
    assert heading is not None and heading < 0.1
    calibration = conclude(run)
    assert calibration.converged and run.events == ()
    assert calibration.convergence_time_s is not None and calibration.convergence_time_s < 25.0


@pytest.mark.slow
def test_errors_agree_with_the_standard_deviation_over_many_seeds() -> None:
    errors = []
    for seed in range(12):
        run = calibrate(recording('lanes', seed, 30.0, camera_hz=10), Config(), default_model())
        error = 1.0 + run.history.coefficients[-1, 0] - TRUE_SCALE
        errors.append(error / run.history.std[-1, COEFFICIENTS_START])
    assert 0.4 < np.mean(np.square(errors)) < 2.2  # chi-square of 12: 99.5 % between 0.26 and 2.36


@pytest.mark.slow
def test_the_same_recording_gives_the_same_bits() -> None:
    again = calibrate(SimSource(plain().scenario, plain().seed), Config(), default_model())
    assert same_estimates(again, plain_run())


@pytest.mark.slow
def test_ground_truth_does_not_enter_the_estimate() -> None:
    def scrambled(sample: TruthSample) -> TruthSample:
        return replace(sample, position_m=(7.0, -3.0, 99.0), yaw_rad=math.sin(1e3 * sample.yaw_rad))

    for change in (each(TruthSample, scrambled), without(TruthSample)):
        assert same_estimates(
            calibrate(ModifiedSource(plain(), change), Config(), default_model()), plain_run()
        )


def test_progress_is_reported() -> None:
    reported: list[Progress] = []
    calibrate(recording(duration_s=20.0), Config(), default_model(), report=reported.append)
    times_s = [progress.done_s for progress in reported]
    assert times_s == sorted(times_s) and len(times_s) == pytest.approx(20, abs=2)
    assert all(progress.total_s == 20.0 for progress in reported)


@pytest.mark.slow
def test_the_parametrisation_of_the_paper_calibrates() -> None:
    config = with_features(parametrisation='camera_frame')
    assert_calibrated(calibrate(recording(), config, default_model()), percent=0.05)


@pytest.mark.slow
def test_conventional_points_calibrate_with_better_known_depths() -> None:
    config = with_features(parametrisation='pixel', ray_std_m=0.3)
    assert_calibrated(calibrate(recording(), config, default_model()), percent=0.05)


def test_conventional_points_diverge_as_in_the_paper() -> None:
    with pytest.raises(FilterDivergedError, match='cleaning-1'):
        calibrate(recording(), with_features(parametrisation='pixel'), default_model())


@pytest.mark.slow
def test_a_full_map_keeps_the_features_in_view() -> None:
    """More features than the size of the map give results as good as exactly that many."""
    few, many = (
        calibrate(recording(features=count), with_features(map_size=20), default_model())
        for count in (20, 40)
    )
    assert_calibrated(many)
    assert len(many.state.landmarks.ids) <= 20
    assert many.history.std[-1, COEFFICIENTS_START] < 1.05 * few.history.std[-1, COEFFICIENTS_START]
    assert heading_rms_deg(many) == pytest.approx(heading_rms_deg(few), abs=0.03)


@pytest.mark.slow
def test_pixel_noise_is_estimated() -> None:
    for noise_px in (0.15, 1.2):
        errors = replace(SensorErrors(), pixel_noise_px=noise_px)
        run = calibrate(recording(errors=errors), Config(), default_model())
        assert_calibrated(run, percent=0.1)
        assert run.history.pixel_noise_px[-1] == pytest.approx(noise_px, rel=0.1)


def test_pixel_noise_far_above_the_settings_is_learned_while_images_are_rejected() -> None:
    """Then most features are rejected at first, so none becomes known well."""
    errors = replace(SensorErrors(), pixel_noise_px=2.0)
    source = recording(seed=3, duration_s=40.0, standing_s=0.5, camera_hz=8, errors=errors)
    history = calibrate(source, Config(), default_model()).history
    soon = np.searchsorted(history.time_s, 6.0)
    assert history.pixel_noise_px[soon] == pytest.approx(2.0, rel=0.25)
    assert history.rejected[soon:].sum() < 0.02 * history.used[soon:].sum()


# --- recordings with missing measurements -------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('step_s', [100.0, -100.0, 1.7e9, -1.6e9])
def test_a_step_of_the_clock_keeps_the_calibration(step_s: float) -> None:
    candidates = (find_effect('scale_cubic'),)
    source = ModifiedSource(recording(camera_hz=10), with_clock_step(step_s, at_s=30.0))
    run = calibrate(source, Config(), default_model(), candidates=candidates)
    assert_calibrated(run)
    assert [event.text.split(';')[0] for event in run.events] == [f'the clock stepped by {step_s:+.1f} s']
    before = run.history.time_s < 29.9
    plain = plain_run().history
    np.testing.assert_allclose(run.history.mean[before], plain.mean[: before.sum()], rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(run.history.std[-1, 9], plain.std[-1, 9], rtol=0.3)
    grown = run.history.std[run.history.time_s > 30.05][0]
    assert grown[0] > 0.2 and grown[YAW] > math.radians(3.0), 'the covariance of the pose grows'
    assert np.all(np.diff(run.history.time_s) > 0.0)
    assert run.history.time_s[-1] == pytest.approx(plain.time_s[-1], abs=0.1)
    assert conclude(run).convergence_time_s == conclude(plain_run()).convergence_time_s
    assert run.truth is not None and len(run.truth.time_s) == pytest.approx(3000, abs=5)
    drift, plain_drift = (blind_drift(one, span_s=20.0) for one in (run, plain_run()))
    assert (drift.start_s >= 30.0).all() and (plain_drift.start_s < 30.0).any(), 'none spans the step'
    later_deg = np.degrees(plain_drift.error_rad[plain_drift.start_s >= 30.0])
    np.testing.assert_allclose(np.degrees(drift.error_rad), later_deg, atol=0.3)
    assert run.scores is not None and len(run.scores.start_s) == 6


@pytest.mark.slow
@pytest.mark.parametrize(('from_s', 'to_s'), [(20.0, 21.0), (10.0, 30.0), (40.0, 1e6)])
def test_calibration_continues_after_a_gap_in_the_imu(from_s: float, to_s: float) -> None:
    run = calibrate(ModifiedSource(plain(), without(ImuSample, from_s, to_s)), Config(), default_model())
    assert_calibrated(run)
    gap_s = to_s - from_s if to_s < 60.0 else 0.0  # after the last sample of the gyro there is no recording
    assert run.history.gap_s.sum() == pytest.approx(gap_s, abs=0.3)
    drift = blind_drift(run, from_s=5.0, span_s=5.0)
    touched = (drift.start_s + 5.0 > from_s + 0.1) & (drift.start_s < to_s - 0.1)
    assert len(touched) > 4 and not touched.any(), 'spans with a gap do not count as drift'


@pytest.mark.slow
def test_a_gap_in_the_imu_is_not_rest() -> None:
    """The heading is unknown while camera and IMU are missing, even though the wheels are at rest."""
    hidden = (without(ImuSample, 1.0, 2.5), without(FeatureObservations, 1.0, 2.6))
    source = ModifiedSource(ModifiedSource(recording(), hidden[0]), hidden[1])
    history = calibrate(source, Config(), default_model()).history
    stds = [
        history.std[np.searchsorted(history.t_ns, at(2.45)) - 1, YAW]
        for history in (history, plain_run().history)
    ]
    assert stds[0] > math.radians(20.0) and stds[1] < math.radians(0.1)


@pytest.mark.slow
def test_calibration_continues_after_the_camera_was_covered() -> None:
    source = ModifiedSource(recording(), without(FeatureObservations, 20.0, 35.0))
    run = calibrate(source, Config(), default_model())
    assert_calibrated(run)
    covered = (run.history.t_ns > at(20.1)) & (run.history.t_ns < at(34.9))
    assert covered.sum() > 50 and not np.any(run.history.dof[covered])


@pytest.mark.slow
@pytest.mark.parametrize(('from_s', 'to_s'), [(20.0, 25.0), (-1.0, 1e6)])
def test_missing_wheels_do_no_harm(from_s: float, to_s: float) -> None:
    run = calibrate(
        ModifiedSource(recording(), without(WheelSample, from_s, to_s)), Config(), default_model()
    )
    assert_calibrated(run)


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.02, 0.1])
def test_outliers_are_rejected(share: float) -> None:
    errors = replace(SensorErrors(), outliers=share)
    run = calibrate(recording(errors=errors), Config(), default_model())
    assert_calibrated(run)
    rejected = run.history.rejected.sum() / (run.history.rejected.sum() + run.history.used.sum())
    assert rejected == pytest.approx(0.95 * share, rel=0.15)  # one in twenty outliers is small


def sliding(sample: FeatureObservations) -> FeatureObservations:
    """Let every tenth feature move through the image by itself, 6 px to and fro."""
    slides = (sample.ids % 10 == 3)[:, None]
    shift_px = 6.0 * np.sin(2.0 * np.pi * sample.t_ns / 3e9)
    return replace(sample, pixels=sample.pixels + np.where(slides, shift_px, 0.0))


@pytest.mark.slow
def test_features_that_are_not_fixed_in_space_are_dropped_and_counted() -> None:
    change = each(FeatureObservations, sliding)
    run = calibrate(ModifiedSource(recording(), change), Config(), default_model())
    assert_calibrated(run)
    assert run.history.dropped.sum() > 5
    assert summarise(run, conclude(run))['features']['dropped'] == run.history.dropped.sum()
    assert plain_run().history.dropped.sum() == 0


# --- recordings that cannot be calibrated -------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    'change',
    [
        with_features_of(plain(seed=7)),
        with_features_of(plain(), late_s=1.0),
        each(FeatureObservations, random_pixels),
        each(ImuSample, lambda s: replace(s, rate_rad_s=tuple(map(math.degrees, s.rate_rad_s)))),
    ],
    ids=['another recording', 'a second late', 'random', 'degrees'],
)
def test_contradictory_measurements_diverge(change: Modification) -> None:
    with pytest.raises(FilterDivergedError, match='changed cleaning-1') as caught:
        calibrate(ModifiedSource(plain(), change), Config(), default_model())
    assert caught.value.todo


def straight_on() -> SimSource:
    """Return a minute of driving straight, with a bias that accumulates to a full turn."""
    errors = replace(SensorErrors(), turn_on_bias_deg_s=3.0)
    driving_style = DrivingStyle(area_m=(24.0, 1.0))
    return recording('lanes', 2, room_m=(30.0, 5.0), driving_style=driving_style, errors=errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('source', 'message'),
    [
        (recording('standing'), 'no turns: 0 deg'),
        (straight_on(), 'no turns'),
        (ModifiedSource(recording(), without(FeatureObservations)), 'no image feature'),
    ],
    ids=['standing', 'straight', 'covered'],
)
def test_an_unobservable_scale_factor_raises(source: Source, message: str) -> None:
    with pytest.raises(NotObservableError, match=message) as caught:
        calibrate(source, Config(), default_model())
    assert caught.value.where == source.name and caught.value.todo


@pytest.mark.parametrize('kind', [ImuSample, object], ids=['no IMU', 'nothing'])
def test_a_recording_without_imu_samples_raises(kind: type[Any]) -> None:
    with pytest.raises(RecordingError, match='no stretch with IMU samples'):
        calibrate(ModifiedSource(recording(), without(kind)), Config(), default_model())


# --- hidden effects -----------------------------------------------------------------------------

HIDDEN: dict[str, tuple[float, ...]] = {
    'scale_asymmetry': (0.004,),
    'scale_quadratic': (0.003,),
    'scale_cubic': (0.003,),
    'bias_warmup': (math.radians(0.5), 300.0),
    'bias_temperature': (math.radians(0.03),),
    'scale_temperature': (0.0005,),
    'g_sensitivity': (math.radians(0.015), math.radians(-0.01)),
    'cross_axis': (0.02, -0.03),
    'gyro_lag': (0.02,),
    'vibration_rectification': (math.radians(0.5),),
    'camera_time_offset': (0.03,),
    'rolling_shutter': (0.02,),
    'turn_slip': (0.02,),
    'camera_tilt': (math.radians(1.5), math.radians(-1.0)),
    'camera_position': (0.015, -0.01),
    'focal_length': (0.02,),
    'principal_point': (5.0, -4.0),
    'radial_distortion': (0.02, -0.005),
    'covariate_bias:battery_state.current': (math.radians(0.05),),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', HIDDEN)
def test_a_model_with_the_hidden_effect_estimates_it(name: str) -> None:
    effect, values = find_effect(name), HIDDEN[name]
    images = {'camera_hz': 10} if name == 'focal_length' else {}  # it hardly shows in few of them
    source = recording(hidden=(HiddenEffect(effect, values),), **images)
    model = SensorModel('with it', BiasModel(), (find_effect('scale_factor'), effect))
    run = calibrate(source, Config(), model)
    assert_calibrated(run, percent=0.3)
    std = np.sqrt(np.diagonal(run.state.covariance))[COEFFICIENTS_START + 1 : run.state.robot_size]
    np.testing.assert_array_less(np.abs(run.state.coefficients[1:] - values), 4.0 * std)
    prior = [item.prior_std for item in effect.coefficients]
    assert np.all(std < prior), 'the coefficient is observable'
    assert run.history.nis.sum() / run.history.dof.sum() == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
def test_a_vibration_known_from_few_samples_does_not_hide_half_of_its_effect() -> None:
    effect, fan = find_effect('vibration_rectification'), find_effect('covariate_bias:fan_speed.data')
    hidden = HiddenEffect(effect, (-0.025,))
    model = SensorModel('with it', BiasModel(), (find_effect('scale_factor'), fan, effect))
    run = calibrate(SimSource(plain().scenario, 1, hidden=(hidden,)), Config(), model)
    assert run.state.coefficients[2] == pytest.approx(-0.025, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'limit'), [('rate_saturation', 60.0), ('rate_deadband', 0.3)])
def test_a_known_limit_does_no_harm(name: str, limit: float) -> None:
    effect: Any = find_effect(name)
    item = replace(effect.coefficients[0], prior_mean=math.radians(limit))
    effect = replace(effect, coefficients=(item,))
    source = recording(hidden=(HiddenEffect(effect, (math.radians(limit),)),))
    model = SensorModel('with it', BiasModel(), (find_effect('scale_factor'), effect))
    assert_calibrated(calibrate(source, Config(), model), percent=0.05)
    if name == 'rate_saturation':
        unaware = calibrate(source, Config(), default_model())
        assert abs(float(unaware.state.coefficients[0]) + 1.0 - TRUE_SCALE) > 0.01


@pytest.mark.slow
def test_score_statistics_estimate_a_candidate() -> None:
    """One pass without the effect estimates its size, and candidates do not change the estimate."""
    cubic = find_effect('scale_cubic')
    source = recording(hidden=(HiddenEffect(cubic, (0.003,)),))
    with_candidates = calibrate(
        source, Config(), default_model(), candidates=(cubic, find_effect('turn_slip'))
    )
    plain = calibrate(source, Config(), default_model())
    np.testing.assert_allclose(with_candidates.history.mean, plain.history.mean, rtol=1e-9, atol=1e-12)
    assert plain.scores is None and with_candidates.scores is not None
    information, score = (
        with_candidates.scores.information.sum(axis=0),
        with_candidates.scores.score.sum(axis=0),
    )
    estimate = np.linalg.solve(information, score)
    assert estimate[0] == pytest.approx(0.003, rel=0.15)
    assert estimate[0] > 10.0 / math.sqrt(information[0, 0])


def test_effects_on_images_require_pixels() -> None:
    model = SensorModel('tilted', BiasModel(), (find_effect('scale_factor'), find_effect('camera_tilt')))
    with pytest.raises(ConfigError, match='pixels'):
        calibrate(recording(), with_features(parametrisation='camera_frame'), model)


# --- another heading reference ------------------------------------------------------------------


def by_heading(
    noise_deg: float = 0.2, offset_s: float = 0.0, sign: float = 1.0, scale: float = 1.0
) -> Source:
    """Return a recording with noisy headings, in a frame of their own, in place of the camera."""
    rng = np.random.default_rng(0)

    def heading(sample: TruthSample) -> HeadingSample:
        yaw = scale * sample.yaw_rad + 1.0 + math.radians(noise_deg) * rng.normal()
        return HeadingSample(sample.t_ns + round(offset_s * 1e9), math.remainder(yaw, 2.0 * math.pi))

    def turned(sample: ImuSample) -> ImuSample:
        wx, wy, wz = sample.rate_rad_s
        return replace(sample, rate_rad_s=(wx, sign * wy, sign * wz))

    source = ModifiedSource(recording(duration_s=45.0, truth_hz=20), without(FeatureObservations))
    source = ModifiedSource(source, each(TruthSample, heading), replace(source.rig, camera=None))
    return ModifiedSource(source, each(ImuSample, turned))


@pytest.mark.slow
@pytest.mark.parametrize('offset_s', [0.0, 0.1])
def test_a_heading_reference_calibrates(offset_s: float) -> None:
    run = calibrate(by_heading(offset_s=offset_s), Config(), default_model())
    assert_calibrated(run, percent=0.1)
    stamped = [event.text for event in run.events if 'stamped' in event.text]
    assert len(stamped) == (1 if offset_s else 0)
    if stamped:
        late_ms, std_ms = (float(word) for word in re.findall(r'[0-9.]+', stamped[0])[:2])
        assert (
            late_ms == pytest.approx(1e3 * offset_s, abs=max(3.0 * std_ms, 0.5)) and 'too late' in stamped[0]
        )


@pytest.mark.slow
def test_a_shaken_gyro_is_not_a_noisy_one_beside_a_heading_reference() -> None:
    """A hand shakes gyro and reference alike; the readings look noisy, the headings do not."""
    rate_rad_s, amplitude_rad = 2.0 * math.pi * 3.0, math.radians(1.0)

    def phase(t_ns: int) -> float:
        return rate_rad_s * (t_ns - at(0.0)) / 1e9

    def shaken(sample: ImuSample) -> ImuSample:
        wx, wy, wz = sample.rate_rad_s
        shake_rad_s = amplitude_rad * rate_rad_s * math.cos(phase(sample.t_ns)) / TRUE_SCALE
        return replace(sample, rate_rad_s=(wx, wy, wz + shake_rad_s))

    def turned(sample: HeadingSample) -> HeadingSample:
        return replace(sample, yaw_rad=sample.yaw_rad + amplitude_rad * math.sin(phase(sample.t_ns)))

    source = ModifiedSource(by_heading(noise_deg=0.02), without(WheelSample))
    source = ModifiedSource(source, each(ImuSample, shaken))
    source = ModifiedSource(source, each(HeadingSample, turned))
    run = calibrate(source, Config(), default_model())
    assert_calibrated(run, percent=0.1)
    assert run.history.nis.sum() / run.history.dof.sum() == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ('change', 'words'),
    [({'scale': 0.3}, '0.28 times as far as the gyro'), ({'sign': -1.0}, 'turns opposite to the gyro')],
)
def test_a_reference_that_does_not_fit_is_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(NotObservableError, match=words):
        calibrate(by_heading(**change), Config(), default_model())


# --- calibration files --------------------------------------------------------------------------


def test_a_calibration_is_written_and_read_back(tmp_path: Path) -> None:
    effects = (find_effect('scale_factor'), find_effect('bias_warmup'))
    run = calibrate(recording(duration_s=20.0), Config(), SensorModel('warm', BiasModel(), effects, 2))
    calibration, file = conclude(run), tmp_path / 'calibration.yaml'
    save_calibration(calibration, Config(), file)
    loaded = load_calibration(file)
    for name in Calibration.__slots__:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(calibration, name), err_msg=name)
    tree = yaml.safe_load(file.read_text(encoding='utf-8'))
    assert tree['scale_factor'] == calibration.scale_factor == 1.0 + calibration.values[1]
    assert tree['scale_factor_volt'] == pytest.approx(146.4 * calibration.scale_factor)
    assert tree['bias_deg_s'] == pytest.approx(math.degrees(calibration.values[0]))
    assert tree['coefficients']['bias']['unit'] == 'rad/s'
    assert tree['coefficients']['bias_warmup.time_constant']['std'] == pytest.approx(calibration.stds[3])
    assert tree['settings']['camera']['pixel_noise_px'] == 0.4
    assert tree['provenance']['source'] == 'cleaning-1'


def test_an_added_effect_is_announced() -> None:
    effects = (find_effect('scale_factor'), find_effect('bias_warmup'), find_effect('scale_cubic'))
    run = calibrate(recording(duration_s=20.0), Config(), SensorModel('mine', BiasModel(), effects, 3))
    calibration = conclude(run)
    parameters = announcement(calibration)
    assert parameters['gyro.model'] == 'mine 3'
    names = ['scale_factor', 'bias_warmup.amplitude', 'bias_warmup.time_constant', 'scale_cubic']
    assert parameters['gyro.coefficient_names'] == names
    assert parameters['gyro.coefficients'] == run.state.coefficients.tolist()
    assert parameters['gyro.coefficient_stds'] == calibration.stds[1:].tolist()
    assert (calibration.stds[1:] >= run.history.std[-1, COEFFICIENTS_START:]).all()
    assert parameters['gyro.scale_factor'] == 1.0 + run.state.coefficients[0]
    assert parameters['gyro.bias'] == run.history.mean[-1, YAW_BIAS]


INVALID: dict[str, Callable[[dict[str, Any]], Any]] = {
    'another file': lambda tree: {'camera': {'pixel_noise_px': 0.4}},
    'no model': lambda tree: tree.pop('model'),
    'no list of effects': lambda tree: tree.update(model=[]),
    'an unknown effect': lambda tree: tree['model'].update(effects=['scale_factr']),
    'a model with more': lambda tree: tree['model']['effects'].append('scale_cubic'),
    'a value that is a word': lambda tree: tree['coefficients']['bias'].update(value='small'),
    'a value that is NaN': lambda tree: tree['coefficients']['bias'].update(value=math.nan),
    'a list of coefficients': lambda tree: tree.update(coefficients=[1.0]),
    'too small a covariance': lambda tree: tree.update(covariance=[[1.0]]),
    'a ragged covariance': lambda tree: tree.update(covariance=[[1.0, 0.0], [0.0]]),
    'an asymmetric covariance': lambda tree: tree.update(covariance=[[1.0, 0.5], [0.0, 1.0]]),
    'a negative variance': lambda tree: tree.update(covariance=[[1.0, 0.0], [0.0, -1.0]]),
    'a correlation beyond one': lambda tree: tree.update(covariance=[[1.0, 2.0], [2.0, 1.0]]),
    'a value in another unit': lambda tree: tree['coefficients']['bias'].update(unit='deg/s'),
    'converged in a word': lambda tree: tree.update(converged='no'),
    'an impossible temperature': lambda tree: tree['provenance'].update(temperature_c=1e300),
    'an infinite end': lambda tree: tree['provenance'].update(end_ns=math.inf),
    'no provenance': lambda tree: tree.update(provenance=None),
    'a time that is a word': lambda tree: tree.update(convergence_time_s='soon'),
}


@pytest.mark.slow
@pytest.mark.parametrize('fault', INVALID)
def test_an_invalid_calibration_file_is_refused(fault: str, tmp_path: Path) -> None:
    file = tmp_path / 'calibration.yaml'
    save_calibration(conclude(plain_run()), Config(), file)
    tree = yaml.safe_load(file.read_text(encoding='utf-8'))
    result = INVALID[fault](tree)
    file.write_text(yaml.safe_dump(result if fault == 'another file' else tree))
    with pytest.raises(ConfigError, match='calibration.yaml'):
        load_calibration(file)


@pytest.mark.slow
def test_an_earlier_calibration_shortens_the_next_one(tmp_path: Path) -> None:
    file = tmp_path / 'calibration.yaml'
    save_calibration(conclude(plain_run()), Config(), file)
    known = load_calibration(file)
    source = plain(seed=2)
    run = calibrate(source, Config(), default_model(), known.start())
    assert_calibrated(run, percent=0.02)
    cold, warm = conclude(plain_run(seed=2)), conclude(run)
    assert cold.convergence_time_s is not None and cold.convergence_time_s > 10.0
    assert warm.convergence_time_s == 0.0
    assert warm.scale_factor_std < cold.scale_factor_std, (
        'the stored one counts, less what a new start may change'
    )
    true_bias = source.truth.bias_rad_s[-1, 2]
    assert abs(warm.values[0] - true_bias) < 4.0 * warm.stds[0], 'the old bias has a large variance'


# --- the filter, measurement by measurement -----------------------------------------------------


@pytest.mark.slow
def test_measurements_before_the_imu_and_duplicates_do_no_harm() -> None:
    def doubled(measurements: Any) -> Any:
        for item in measurements:
            yield item
            if isinstance(item, FeatureObservations | ImuSample | WheelSample):
                yield item

    late_imu = ModifiedSource(recording(), without(ImuSample, -1.0, 0.5))
    assert_calibrated(calibrate(ModifiedSource(late_imu, doubled), Config(), default_model()))


@pytest.mark.slow
def test_an_image_without_features_does_no_harm() -> None:
    def nothing(sample: FeatureObservations) -> FeatureObservations:
        if sample.t_ns % 7 < 3:
            return sample
        return FeatureObservations(sample.t_ns, sample.ids[:0], sample.pixels[:0])

    run = calibrate(
        ModifiedSource(recording(), each(FeatureObservations, nothing)), Config(), default_model()
    )
    assert_calibrated(run)
    assert isinstance(run.rig.camera, CameraIntrinsics)


def test_a_stream_returns_steps_as_soon_as_the_wheels_cover_them() -> None:
    source = plain()
    slam = VisualSlam(EkfSlam(default_model(), Config(), source.rig))
    newest_ns = 0
    items: list[Measurement] = [item for item in source.measurements() if item.t_ns < at(5.0)]
    for item in items:
        for step in slam.step(item):
            assert step.t_ns <= item.t_ns
            assert step.t_ns > newest_ns
            newest_ns = step.t_ns
        if isinstance(item, FeatureObservations):
            assert newest_ns == 0 or item.t_ns - newest_ns < 0.15e9


@pytest.mark.parametrize('marks', [*range(MANY_MARKS + 2), 3 * MANY_MARKS])
@pytest.mark.parametrize('apart_s', [10.0, LIFETIME_S])
def test_many_marks_on_the_lens_are_told_once(marks: int, apart_s: float) -> None:
    run = drive(duration_s=1.0).run
    found = np.ones(marks)
    history = replace(
        run.history, t_ns=np.arange(marks), time_s=apart_s * np.arange(marks) / MANY_MARKS, on_lens=found
    )
    events = list(marks_on_lens(replace(run, history=history)))
    assert [event.t_ns for event in events] == ([MANY_MARKS - 1] if marks >= MANY_MARKS else [])
    scattered = replace(history, time_s=LIFETIME_S * np.arange(marks))
    assert not list(marks_on_lens(replace(run, history=scattered)))
