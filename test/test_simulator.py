"""The simulator: repeatability, rates and the errors of each sensor."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest

from gyrocal_ros.data import (
    CovariateSample,
    FeatureObservations,
    Frame,
    ImuSample,
    Measurement,
    TemperatureSample,
    TruthSample,
    WheelSample,
    seconds,
)
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.kinematics import integrate
from gyrocal_ros.sim.scenarios import SCENARIOS, Scenario, find_scenario
from gyrocal_ros.sim.scene import Furniture
from gyrocal_ros.sim.sensors import SensorErrors, without_noise
from gyrocal_ros.sim.world import START_NS, SimSource

T = TypeVar('T')

SHORT = replace(SCENARIOS['cleaning'], duration_s=40.0)
QUIET = replace(SHORT, errors=without_noise(SensorErrors()))


def of_type(source: SimSource, kind: type[T]) -> list[T]:
    return [item for item in source.measurements() if isinstance(item, kind)]


def as_bytes(measurements: list[Measurement]) -> list[bytes]:
    return [
        repr((item.t_ns, item.ids.tolist(), item.pixels.tolist())).encode()
        if isinstance(item, FeatureObservations)
        else repr(item).encode()
        for item in measurements
    ]


def times_s(measurements: list[ImuSample] | list[FeatureObservations] | list[WheelSample]) -> np.ndarray:
    return np.array([seconds(item.t_ns - START_NS) for item in measurements])


def rates(source: SimSource) -> np.ndarray:
    return np.array([item.rate_rad_s for item in of_type(source, ImuSample)])


# --- repeatability ------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_same_seed_yields_the_same_bits_in_any_call_order() -> None:
    source = SimSource(SHORT, seed=5)
    first = as_bytes(list(source.measurements()))
    together = list(zip(source.measurements(), source.measurements(), strict=True))
    assert as_bytes([one for one, _ in together]) == first
    assert as_bytes([other for _, other in together]) == first
    assert as_bytes(list(SimSource(SHORT, seed=5).measurements())) == first
    assert as_bytes(list(SimSource(SHORT, seed=6).measurements())) != first


@pytest.mark.parametrize(
    'changed',
    [
        {'camera_hz': 10},
        {'wheel_hz': 25},
        {'features': 30, 'track_loss': 0.05},
        {'errors': replace(SensorErrors(), outliers=0.1, tick_m=1e-3, pixel_noise_px=1.0)},
    ],
)
def test_a_sensor_has_its_own_random_stream(changed: dict[str, object]) -> None:
    changed_scenario: Scenario = replace(SHORT, **changed)  # type: ignore[arg-type]
    np.testing.assert_array_equal(rates(SimSource(SHORT, 2)), rates(SimSource(changed_scenario, 2)))


def test_removing_the_noise_does_not_change_the_tracks() -> None:
    noisy, quiet = (
        of_type(SimSource(SHORT, 1), FeatureObservations),
        of_type(SimSource(QUIET, 1), FeatureObservations),
    )
    for one, other in zip(noisy, quiet, strict=True):
        np.testing.assert_array_equal(one.ids, other.ids)
    errors = np.concatenate([one.pixels - other.pixels for one, other in zip(noisy, quiet, strict=True)])
    assert errors.std() == pytest.approx(0.4, rel=0.03)


# --- order and rates ----------------------------------------------------------------------------


def test_stamps_are_in_order_and_rates_are_as_configured() -> None:
    source = SimSource(SHORT, 0)
    measurements = list(source.measurements())
    assert all(a.t_ns <= b.t_ns for a, b in itertools.pairwise(measurements))
    assert measurements[0].t_ns == source.span.start_ns
    assert measurements[-1].t_ns <= source.span.end_ns
    for kind, hz in ((ImuSample, 200), (WheelSample, 50), (FeatureObservations, 15), (TruthSample, 50)):
        count = sum(isinstance(item, kind) for item in measurements)
        assert count == pytest.approx(40 * hz, abs=2)
    names = {item.name for item in measurements if isinstance(item, CovariateSample)}
    assert names == {'fan_speed.data', 'battery_state.voltage', 'battery_state.current'}


@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_every_scenario_runs(name: str) -> None:
    scenario = replace(SCENARIOS[name], duration_s=15.0)
    assert of_type(SimSource(scenario), ImuSample)[-1].t_ns == START_NS + 15_000_000_000


def test_an_unknown_scenario_suggests_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match="'cleaning'"):
        find_scenario('cleanin')


# --- gyro ---------------------------------------------------------------------------------------


def test_gyro_reads_the_true_rate_through_scale_factor_and_bias() -> None:
    source = SimSource(QUIET, 4)
    truth = source.truth
    true_rate = truth.trajectory.motion(truth.bias_time_s).rate_rad_s
    scale = np.array([1.0, 1.0, 135.5 / 146.4])
    np.testing.assert_allclose(scale * rates(source) + truth.bias_rad_s, true_rate, atol=1e-12)


@pytest.mark.slow
def test_integrated_gyro_noise_grows_with_the_root_of_time() -> None:
    only_white = replace(SHORT, errors=replace(QUIET.errors, rate_noise_deg_s=0.0075), duration_s=120.0)
    none = replace(only_white, errors=QUIET.errors)
    error = np.degrees(rates(SimSource(only_white)) - rates(SimSource(none)))[:-1]
    for window_s in (0.1, 1.0, 2.0):
        turned = error.reshape(-1, int(window_s * 200), 3).sum(axis=1) / 200.0
        assert turned.std() == pytest.approx(0.0075 * np.sqrt(window_s), rel=0.15)


def test_turn_on_bias_and_bias_walk_have_the_configured_sizes() -> None:
    sources = [SimSource(replace(SHORT, duration_s=10.0), seed) for seed in range(60)]
    biases = np.degrees([source.truth.bias_rad_s for source in sources])
    assert biases[:, 0].std() == pytest.approx(0.2, rel=0.2)
    assert (biases[:, -1] - biases[:, 0]).std() == pytest.approx(2.5e-4 * np.sqrt(10.0), rel=0.2)


def test_the_accelerometer_measures_gravity_at_rest() -> None:
    forces = np.array([item.specific_force_m_s2 for item in of_type(SimSource(SHORT), ImuSample)])
    assert forces[:400].mean(axis=0) == pytest.approx([0.0, 0.0, 9.81], abs=0.25)
    assert np.all(forces[800:, :2].std(axis=0) > 2.0 * forces[:400, :2].std(axis=0))


@pytest.mark.parametrize('name', ['lanes', 'cleaning', 'spins'])
def test_the_motion_model_with_perfect_sensors_yields_the_true_pose(name: str) -> None:
    errors = replace(without_noise(SensorErrors()), scale_factor=1.0, turn_on_bias_deg_s=0.0)
    source = SimSource(replace(SCENARIOS[name], errors=errors, duration_s=60.0), 1)
    truth, dt = source.truth, 1.0 / source.scenario.imu_hz
    motion, rate = truth.trajectory.motion(truth.bias_time_s), rates(source)
    mean_rate, steps = 0.5 * (rate[1:] + rate[:-1]), np.diff(motion.travelled_m)
    position, euler = truth.trajectory.position(np.zeros(1))[0], motion.euler_rad[0]
    for block in np.split(np.arange(len(steps)), len(steps) // 20):
        moved = integrate(position, euler, mean_rate[block], np.full(len(block), dt), steps[block])
        position, euler = moved.position_m, moved.euler_rad
    assert np.degrees(euler) == pytest.approx(np.degrees(motion.euler_rad[-1]), abs=1e-3)
    assert position == pytest.approx(truth.trajectory.position(np.array([60.0]))[0], abs=1e-4)


# --- wheels -------------------------------------------------------------------------------------


def test_wheels_at_rest_read_zero() -> None:
    wheels = of_type(SimSource(SHORT, 1), WheelSample)
    resting = [item for item in wheels if seconds(item.t_ns - START_NS) < 3.0]
    assert len(resting) > 140
    assert all(item.speed_m_s == 0.0 and item.yaw_rate_rad_s == 0.0 for item in resting)


def test_wheels_read_the_mean_over_the_interval_that_ends_at_the_stamp() -> None:
    source = SimSource(QUIET, 1)
    wheels = of_type(source, WheelSample)
    ends = times_s(wheels)
    before, after = source.truth.trajectory.motion(ends - 0.02), source.truth.trajectory.motion(ends)
    speed = np.array([item.speed_m_s for item in wheels])
    np.testing.assert_allclose(speed * 0.02, after.travelled_m - before.travelled_m, atol=1e-9)
    turned = np.array([item.yaw_rate_rad_s for item in wheels]) * 0.02 * 1.02
    np.testing.assert_allclose(turned, (after.euler_rad - before.euler_rad)[:, 2], atol=1e-8)


@pytest.mark.slow
def test_distance_error_is_five_millimetres_per_root_metre() -> None:
    errors = []
    for seed in range(30):
        source = SimSource(replace(SCENARIOS['lanes'], duration_s=12.0), seed)
        measured = sum(item.speed_m_s for item in of_type(source, WheelSample)) * 0.02
        true = source.truth.trajectory.motion(np.array([12.0])).travelled_m[0]
        errors.append((measured - true) / np.sqrt(true))
    assert np.std(errors) == pytest.approx(0.005, rel=0.3)


# --- camera -------------------------------------------------------------------------------------


def corner_of_each_id(source: SimSource) -> dict[int, int]:
    """Return the corner of each id, found by projecting all corners into each image."""
    observations = of_type(source, FeatureObservations)
    R_wc, p_wc = source.camera_poses(times_s(observations))
    corners: dict[int, int] = {}
    for item, R, p in zip(observations, R_wc, p_wc, strict=True):
        projected = project(source.scenario.camera, (source.truth.scene.points_w - p) @ R)
        distance = np.linalg.norm(item.pixels[:, None] - projected, axis=2)
        for feature_id, nearest, miss in zip(item.ids, distance.argmin(1), distance.min(1), strict=True):
            assert miss < 1e-6
            assert corners.setdefault(int(feature_id), int(nearest)) == nearest
    return corners


@pytest.mark.slow
def test_an_id_belongs_to_one_corner() -> None:
    corners = corner_of_each_id(
        SimSource(replace(SCENARIOS['furniture'], duration_s=120.0, errors=QUIET.errors))
    )
    assert len(corners) > len(set(corners.values())) > 20


@pytest.mark.slow
def test_ids_survive_short_absences_and_are_never_reused() -> None:
    seen_s: dict[int, list[float]] = {}
    for item in of_type(SimSource(replace(SCENARIOS['furniture'], duration_s=200.0)), FeatureObservations):
        for feature_id in item.ids.tolist():
            seen_s.setdefault(feature_id, []).append(seconds(item.t_ns - START_NS))
    absences = np.concatenate([np.diff(moments) for moments in seen_s.values()])
    assert 5.0 < absences.max() <= 20.0
    assert list(seen_s) == sorted(seen_s)


def test_features_respect_their_limit_and_the_image() -> None:
    camera = SHORT.camera
    for item in of_type(SimSource(QUIET), FeatureObservations):
        assert len(item.ids) <= 15
        assert len(set(item.ids.tolist())) == len(item.ids)
        assert item.pixels.min() >= 0.0
        assert np.all(item.pixels <= [camera.width_px - 1, camera.height_px - 1])


def test_points_ahead_are_low_and_points_to_the_right_are_right_in_the_image() -> None:
    source = SimSource(QUIET)
    R_wc, p_wc = source.camera_poses(np.array([0.0]))
    ahead, right = p_wc[0] + [0.5, 0.0, 2.0], p_wc[0] + [0.0, -0.5, 2.0]  # the robot faces world x
    (u0, v0), (u1, v1) = project(source.scenario.camera, (np.stack([ahead, right]) - p_wc[0]) @ R_wc[0])
    assert v0 > 290.0
    assert abs(u0 - 319.5) < 5.0
    assert u1 > 370.0
    assert abs(v1 - 239.5) < 5.0


def test_outliers_have_the_configured_share() -> None:
    scenario = replace(SHORT, errors=replace(SensorErrors(), outliers=0.1))
    wrong = of_type(SimSource(scenario), FeatureObservations)
    right = of_type(SimSource(QUIET), FeatureObservations)
    miss = np.concatenate(
        [np.linalg.norm(one.pixels - other.pixels, axis=1) for one, other in zip(wrong, right, strict=True)]
    )
    assert np.mean(miss > 3.0) == pytest.approx(0.1, abs=0.015)


def test_furniture_occludes_all_or_part_of_the_ceiling() -> None:
    start = np.array([-2.0, -1.8])
    board = Furniture((start[0] - 1.0, start[0] + 1.0), (start[1] - 1.0, start[1] + 1.0), 0.25)
    counts = [
        len(item.ids) for item in of_type(SimSource(replace(SHORT, furniture=(board,))), FeatureObservations)
    ]
    assert set(counts[:40]) == {0}
    assert 15 in counts
    assert any(0 < count < 15 for count in counts)


def test_camera_can_be_switched_off() -> None:
    images = of_type(SimSource(replace(SHORT, camera_until_s=12.0)), FeatureObservations)
    assert times_s(images)[-1] == pytest.approx(12.0, abs=0.1)


@pytest.mark.slow
def test_images_show_furniture_and_ceiling() -> None:
    start = np.array([-2.0, -1.8])
    board = Furniture((start[0] - 1.0, start[0] + 1.0), (start[1] - 1.0, start[1] + 1.0), 0.25)
    scenario = replace(SHORT, duration_s=9.0, camera_hz=1, furniture=(board,))
    frames = of_type(SimSource(scenario, 7, images=True), Frame)
    assert [frame.t_ns for frame in frames] == [
        item.t_ns for item in of_type(SimSource(scenario, 7), FeatureObservations)
    ]
    assert frames[0].image.shape == (480, 640)
    assert frames[0].image.max() < 40  # below the board
    assert frames[-1].image.mean() > 60.0
    again = of_type(SimSource(scenario, 7, images=True), Frame)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(frames, again, strict=True))


# --- truth and slow signals ---------------------------------------------------------------------


def test_ground_truth_is_the_pose_of_the_body() -> None:
    source = SimSource(SHORT)
    samples = of_type(source, TruthSample)
    time_s = np.array([seconds(item.t_ns - START_NS) for item in samples])
    np.testing.assert_array_equal(
        [item.position_m for item in samples], source.truth.trajectory.position(time_s)
    )
    yaw = source.truth.trajectory.motion(time_s).euler_rad[:, 2]
    np.testing.assert_array_equal([item.yaw_rad for item in samples], yaw)


@pytest.mark.slow
def test_temperature_rises_and_current_follows_the_motion() -> None:
    source = SimSource(replace(SCENARIOS['cleaning'], imu_hz=100, camera_hz=1), 3)
    slow = [item for item in source.measurements() if isinstance(item, TemperatureSample | CovariateSample)]
    temperature_c = [item.temperature_c for item in slow if isinstance(item, TemperatureSample)]
    assert temperature_c[-1] - temperature_c[0] > 3.0
    battery = [item for item in slow if getattr(item, 'name', '') == 'battery_state.current']
    time_s = np.array([seconds(item.t_ns - START_NS) for item in battery])
    current = np.array([item.value for item in battery if isinstance(item, CovariateSample)])
    assert np.all(current < 0.0)
    speed = source.truth.trajectory.motion(time_s).speed_m_s
    assert np.corrcoef(current[time_s > 5.0], speed[time_s > 5.0])[0, 1] < -0.1
