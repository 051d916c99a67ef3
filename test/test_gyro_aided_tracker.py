"""The tracker in a stream: aided by the IMU and by the filter's latest predictions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config, TrackerConfig
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    ClockStep,
    FeatureObservations,
    Frame,
    ImuSample,
    Measurement,
    SearchRegions,
    nanoseconds,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.model.camera import bearing, mount_from_yaw, project
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.pipeline.visual_slam import VisualSlam
from gyrocal_ros.sim.image_scenes import find_scene
from gyrocal_ros.sim.render import CeilingRenderer, ceiling_renderer
from gyrocal_ros.sim.scenarios import SCENARIOS, find_scenario
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.statistics import chi_square_quantile
from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker
from gyrocal_ros.vision.gyro_attitude import HISTORY_S, MAX_GAP_S, GyroAttitude
from gyrocal_ros.vision.tracker import Tracker

CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (-0.05, 0.01, 5e-4, -3e-4, 0.0))
R_BC = mount_from_yaw(0.0, 0.0, 0.0, -90.0).R_bs
CEILING_M = 2.5
GRAVITY = (0.0, 0.0, 9.8)
FRAME_S = 0.1


@pytest.fixture(scope='module')
def renderer() -> CeilingRenderer:
    return ceiling_renderer(CAMERA, 1, ceiling_height_m=CEILING_M, objects=0)


def sample(t_s: float, z: float, x: float = 0.0, y: float = 0.0) -> ImuSample:
    return ImuSample(nanoseconds(t_s), (x, y, z), GRAVITY)


def attitude_after(rates: Iterator[tuple[float, float, float, float]]) -> GyroAttitude:
    attitude = GyroAttitude()
    for t_s, x, y, z in rates:
        attitude.add(sample(t_s, z, x, y))
    return attitude


class TrackedDrive:
    """A camera that turns and drives below a ceiling, with a gyro that may overstate the turns."""

    def __init__(
        self, renderer: CeilingRenderer, rate_rad_s: float, gain: float = 1.0, bias_rad_s: float = 0.0
    ) -> None:
        self.tracker = GyroAidedTracker(CAMERA, R_BC, TrackerConfig())
        self.rate_rad_s, self.gain, self.bias_rad_s = rate_rad_s, gain, bias_rad_s
        self.speed_m_s, self.start_s = 0.3, 0.0
        self._renderer, self._rng = renderer, np.random.default_rng(0)
        self._points_w: dict[int, Array] = {}
        self._imu_s = 0.0

    def pose(self, t_s: float) -> tuple[Array, Array]:
        R_wb = rotation_from_euler(np.array([0.0, 0.0, self.rate_rad_s * (t_s - self.start_s)]))
        return R_wb @ R_BC, np.array([self.speed_m_s * t_s, 0.0, 0.1])

    def add_imu(self, until_s: float) -> None:
        for t_s in np.arange(self._imu_s, until_s + 1e-9, 0.005):
            self.tracker.add(sample(float(t_s), self.gain * self.rate_rad_s + self.bias_rad_s))
        self._imu_s = until_s

    def add_image(self, t_s: float, *, covered: bool = False) -> FeatureObservations:
        image = self._renderer.render(*self.pose(t_s), rng=self._rng)
        if covered:
            image[:] = 20
        seen = self.tracker.track(Frame(nanoseconds(t_s), image))
        R_wc, p_wc = self.pose(t_s)
        rays_w = np.column_stack([bearing(CAMERA, seen.pixels), np.ones(len(seen.ids))]) @ R_wc.T
        for id_, point_w in zip(seen.ids.tolist(), p_wc + rays_w * (CEILING_M - p_wc[2]), strict=True):
            self._points_w.setdefault(id_, point_w)
        return seen

    def predict_regions(self, t_s: float) -> SearchRegions:
        """Return the regions that a filter predicts after the image of that time."""
        R_wc, p_wc = self.pose(t_s)
        ids = np.array(list(self._points_w), np.int64)
        points_c = (np.array(list(self._points_w.values())) - p_wc) @ R_wc
        covariances = np.tile(0.25 * np.eye(2), (len(ids), 1, 1))
        return SearchRegions(nanoseconds(t_s), ids, project(CAMERA, points_c), covariances)

    def run(
        self, start: int, end: int, *, with_filter: bool = True, with_imu: bool = True
    ) -> list[FeatureObservations]:
        seen = []
        for k in range(start, end):
            if with_imu:
                self.add_imu(k * FRAME_S)
            seen.append(self.add_image(k * FRAME_S))
            if with_filter:
                self.tracker.regions = self.predict_regions(k * FRAME_S)
        return seen


def retained(seen: list[FeatureObservations]) -> float:
    """Return the mean share of the features of an image that are found in the next one."""
    pairs = list(zip(seen, seen[1:], strict=False))
    return float(np.mean([len(np.intersect1d(a.ids, b.ids)) / len(a.ids) for a, b in pairs]))


def prediction_error_px(drive: TrackedDrive, seen: FeatureObservations) -> float:
    """Return the median distance of the features of the last image from their predicted positions."""
    expected = drive.tracker.expected
    assert expected is not None
    _, found, predicted = np.intersect1d(seen.ids, expected.ids, return_indices=True)
    return float(np.median(np.linalg.norm(seen.pixels[found] - expected.pixels[predicted], axis=1)))


# --- attitude -----------------------------------------------------------------------------------


def test_rates_are_integrated() -> None:
    attitude = attitude_after((0.01 * k, 0.0, 0.0, 0.5) for k in range(101))
    for t_s in (0.0, 0.3333, 1.0):
        euler = attitude.at(nanoseconds(t_s))
        assert euler is not None
        np.testing.assert_allclose(euler, [0.0, 0.0, 0.5 * t_s], atol=1e-9)


def test_a_tilt_rotates_with_the_body_and_decays_to_level() -> None:
    tilted = attitude_after((0.01 * k, 1.0 if k < 11 else 0.0, 0.0, 0.0) for k in range(21))
    assert tilted.at(nanoseconds(0.1))[0] == pytest.approx(0.1, rel=0.06)  # type: ignore[index]
    attitude = attitude_after(
        (0.01 * k, 1.0 if k < 11 else 0.0, 0.0, math.pi if k > 11 else 0.0) for k in range(63)
    )
    roll, pitch, _ = attitude.at(nanoseconds(0.62))  # type: ignore[misc]
    assert roll == pytest.approx(0.0, abs=0.01), 'after a quarter turn roll has become pitch'
    assert -0.1 < pitch < -0.05
    settled = attitude_after((0.01 * k, 1.0 if k < 11 else 0.0, 0.0, 0.0) for k in range(800))
    assert np.abs(settled.at(nanoseconds(7.99))).max() < 1e-3  # type: ignore[arg-type]


def test_a_biased_gyro_does_not_accumulate_tilt() -> None:
    attitude = attitude_after((0.01 * k, 0.01, -0.01, 0.0) for k in range(6000))
    assert np.abs(attitude.at(nanoseconds(59.99))[:2]).max() < 0.011  # type: ignore[index]


def test_no_attitude_outside_the_buffer() -> None:
    assert GyroAttitude().at(0) is None
    attitude = attitude_after((0.01 * k, 0.0, 0.0, 1.0) for k in range(1001))
    assert attitude.at(nanoseconds(10.0 - 3.0 * HISTORY_S)) is None
    assert attitude.at(nanoseconds(10.0 + MAX_GAP_S)) is None
    assert attitude.at(nanoseconds(10.02))[2] == pytest.approx(10.02)  # type: ignore[index]
    assert attitude.until_ns == nanoseconds(10.0)


def test_a_gap_and_an_old_sample_do_not_change_the_yaw() -> None:
    attitude = GyroAttitude()
    for t_s, z in ((0.0, 1.0), (0.1, 1.0), (0.05, 50.0), (0.1, 50.0), (5.0, 1.0), (5.1, 1.0)):
        attitude.add(sample(t_s, z))
    assert attitude.at(nanoseconds(5.1))[2] == pytest.approx(0.2)  # type: ignore[index]


# --- tracker ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_features_are_tracked_through_a_fast_turn_with_a_gyro_gain_error(
    renderer: CeilingRenderer,
) -> None:
    drive = TrackedDrive(renderer, math.radians(80.0), gain=1.08)
    seen = drive.run(0, 25)
    assert retained(seen) > 0.9, 'hardly more is lost than what leaves the image'
    assert prediction_error_px(drive, seen[-1]) < 0.1, (
        'turn and drive are predicted with the estimated gyro gain'
    )


@pytest.mark.slow
def test_features_almost_without_texture_do_not_spoil_the_gain_of_the_gyro() -> None:
    """As a turn begins, their rotation is noisier than the turn from one image to the next."""
    scenario = find_scene('plaster').applied_to(find_scenario('spins'))
    source = SimSource(replace(scenario, standing_s=1.0, duration_s=2.5), 4, images=True)
    assert source.rig.camera is not None
    tracker, waiting = GyroAidedTracker(source.rig.camera, R_BC, TrackerConfig()), list[Frame]()
    for item in source.measurements():
        if isinstance(item, ImuSample):
            tracker.add(item)
            while waiting:
                tracker.track(waiting.pop())
        elif isinstance(item, Frame):
            waiting.append(item)
    errors = tracker._gain_and_bias - [source.truth.scale_factor, source.truth.bias_rad_s[0, 2]]
    assert np.abs(errors).max() < 0.1
    assert errors @ tracker._information @ errors < chi_square_quantile(0.999, 2)


@pytest.mark.slow
def test_regions_are_large_until_the_gyro_gain_is_estimated(renderer: CeilingRenderer) -> None:
    drive = TrackedDrive(renderer, math.radians(80.0), gain=1.08)
    largest_px2 = []
    for k in range(2, 5):
        drive.run(k - 2 if k == 2 else k - 1, k)
        expected = drive.tracker.expected
        assert expected is not None
        largest_px2.append(expected.covariances_px2[:, 0, 0].max())
    assert largest_px2[0] > 2.0**2, '8 % of a turn of 8 deg are about 3 px'
    assert largest_px2[2] < 0.3 * largest_px2[0]


@pytest.mark.slow
def test_a_long_rest_with_a_biased_gyro_does_not_disturb_the_gain(renderer: CeilingRenderer) -> None:
    drive = TrackedDrive(renderer, 0.0, gain=1.08, bias_rad_s=math.radians(1.0))
    drive.speed_m_s = 0.0
    drive.run(0, 100)
    drive.rate_rad_s = math.radians(80.0)
    drive.start_s = 9.9
    assert prediction_error_px(drive, drive.run(100, 101)[-1]) < 5.0, (
        'the prediction is as accurate as the gyro'
    )
    assert retained(drive.run(101, 112)) > 0.9


@pytest.mark.slow
def test_lost_features_are_reacquired_where_the_filter_predicts_them(renderer: CeilingRenderer) -> None:
    drive = TrackedDrive(renderer, math.radians(10.0))
    before = drive.run(0, 5)[-1]
    for k in (5, 6):
        drive.add_imu(k * FRAME_S)
        assert len(drive.add_image(k * FRAME_S, covered=True).ids) == 0
        drive.tracker.regions = drive.predict_regions(k * FRAME_S)
    after = drive.run(7, 8)[0]
    assert len(np.intersect1d(before.ids, after.ids)) > 10


@pytest.mark.parametrize('with_filter', [False, True])
def test_a_slow_turn_is_tracked_without_an_imu(renderer: CeilingRenderer, with_filter: bool) -> None:
    drive = TrackedDrive(renderer, math.radians(8.0))
    seen = drive.run(0, 12, with_filter=with_filter, with_imu=False)
    assert retained(seen) > 0.9
    assert drive.tracker.expected is None, 'regions cannot be propagated over an unknown turn'


def test_tracking_works_without_the_filter(renderer: CeilingRenderer) -> None:
    drive = TrackedDrive(renderer, math.radians(60.0), gain=1.08)
    seen = drive.run(0, 15, with_filter=False)
    assert retained(seen) > 0.9
    assert drive.tracker.expected is None


def test_a_step_of_the_clock_discards_older_data(renderer: CeilingRenderer) -> None:
    drive = TrackedDrive(renderer, math.radians(20.0))
    before = drive.run(0, 4)[-1]
    drive.tracker.restart()
    drive.add_imu(0.4)
    assert drive.tracker.attitude.at(nanoseconds(0.1)) is None
    found = drive.add_image(0.4)
    assert len(found.ids) > 10 and set(found.ids) <= set(before.ids), 'the flow of the image leads to them'
    assert drive.tracker.expected is None


def test_ids_begin_at_the_first_id_and_wrap_at_32_bits(renderer: CeilingRenderer) -> None:
    image = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]))
    seen = Tracker(CAMERA, TrackerConfig(), first_id=2**32 - 5).track(Frame(0, image), np.eye(3), None)
    assert sorted(seen.ids.tolist()) == [*range(10), *range(2**32 - 5, 2**32)]


# --- the filter with the tracker ----------------------------------------------------------------


def image_source(duration_s: float = 1.0) -> SimSource:
    return SimSource(replace(SCENARIOS['demo'], duration_s=duration_s), 1, images=True)


def visual_slam(source: SimSource, tracked: list[FeatureObservations]) -> VisualSlam:
    return VisualSlam(EkfSlam(default_model(), Config(), source.rig), tracked.append)


@pytest.mark.slow
def test_an_image_waits_for_the_imu_and_is_tracked_in_order() -> None:
    source, tracked = image_source(), list[FeatureObservations]()
    stream = visual_slam(source, tracked)
    images: list[Frame] = []
    imu_ns = 0
    for item in source.measurements():
        stream.step(item)
        if isinstance(item, Frame):
            images.append(item)
        elif isinstance(item, ImuSample):
            imu_ns = item.t_ns
        assert [seen.t_ns for seen in tracked] == [image.t_ns for image in images if image.t_ns <= imu_ns]
    stream.finish()
    assert [seen.t_ns for seen in tracked] == [image.t_ns for image in images]
    assert all(len(seen.ids) > 10 for seen in tracked)


@pytest.mark.slow
def test_the_filter_uses_images_and_their_own_noise() -> None:
    source = image_source()
    slam = EkfSlam(default_model(), Config(), source.rig)
    stream = VisualSlam(slam)
    for item in source.measurements():
        stream.step(item)
    used = sum(record.update.used for record in stream.finish())
    assert used > 10 or len(slam.state.landmarks.ids) > 10
    assert slam.track_noise.pixel.std < 0.2, 'the noise of recorded features is not used'


@pytest.mark.slow
def test_images_before_a_clock_step_are_not_lost() -> None:
    source, tracked = image_source(0.5), list[FeatureObservations]()
    stream = visual_slam(source, tracked)
    items: list[Measurement] = list(source.measurements())
    image = [item for item in items if isinstance(item, Frame)][-1]
    for item in items:
        if item.t_ns > image.t_ns:
            break
        stream.step(item)
    stream.step(ClockStep(image.t_ns + nanoseconds(100.0), nanoseconds(100.0)))
    assert tracked[-1].t_ns == image.t_ns
