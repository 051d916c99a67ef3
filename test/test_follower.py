"""The tracker in a stream: the IMU turns it, the filter's last word guides it."""

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
from gyrocal_ros.sim.render import CeilingRenderer, ceiling_renderer
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.vision.follower import Follower
from gyrocal_ros.vision.tracker import Tracker
from gyrocal_ros.vision.turning import GAP_S, KEPT_S, Turning

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


def turned(rates: Iterator[tuple[float, float, float, float]]) -> Turning:
    turning = Turning()
    for t_s, x, y, z in rates:
        turning.add(sample(t_s, z, x, y))
    return turning


class Ride:
    """A camera that turns and drives below a ceiling, with a gyro that overstates its turns."""

    def __init__(
        self, renderer: CeilingRenderer, rate_rad_s: float, overstated: float = 1.0, bias_rad_s: float = 0.0
    ) -> None:
        self.follower = Follower(CAMERA, R_BC, TrackerConfig())
        self.rate_rad_s, self.overstated, self.bias_rad_s = rate_rad_s, overstated, bias_rad_s
        self.speed_m_s, self.start_s = 0.3, 0.0
        self._renderer, self._rng = renderer, np.random.default_rng(0)
        self._points_w: dict[int, Array] = {}
        self._heard_s = 0.0

    def pose(self, t_s: float) -> tuple[Array, Array]:
        R_wb = rotation_from_euler(np.array([0.0, 0.0, self.rate_rad_s * (t_s - self.start_s)]))
        return R_wb @ R_BC, np.array([self.speed_m_s * t_s, 0.0, 0.1])

    def hear(self, until_s: float) -> None:
        for t_s in np.arange(self._heard_s, until_s + 1e-9, 0.005):
            self.follower.add(sample(float(t_s), self.overstated * self.rate_rad_s + self.bias_rad_s))
        self._heard_s = until_s

    def look(self, t_s: float, *, covered: bool = False) -> FeatureObservations:
        image = self._renderer.render(*self.pose(t_s), rng=self._rng)
        if covered:
            image[:] = 20
        seen = self.follower.track(Frame(nanoseconds(t_s), image))
        R_wc, p_wc = self.pose(t_s)
        rays_w = np.column_stack([bearing(CAMERA, seen.pixels), np.ones(len(seen.ids))]) @ R_wc.T
        for id_, point_w in zip(seen.ids.tolist(), p_wc + rays_w * (CEILING_M - p_wc[2]), strict=True):
            self._points_w.setdefault(id_, point_w)
        return seen

    def expect(self, t_s: float) -> SearchRegions:
        """What a filter knows that has just seen the image of that time."""
        R_wc, p_wc = self.pose(t_s)
        ids = np.array(list(self._points_w), np.int64)
        points_c = (np.array(list(self._points_w.values())) - p_wc) @ R_wc
        covariances = np.tile(0.25 * np.eye(2), (len(ids), 1, 1))
        return SearchRegions(nanoseconds(t_s), ids, project(CAMERA, points_c), covariances)

    def go(
        self, start: int, end: int, *, guided: bool = True, heard: bool = True
    ) -> list[FeatureObservations]:
        seen = []
        for k in range(start, end):
            if heard:
                self.hear(k * FRAME_S)
            seen.append(self.look(k * FRAME_S))
            if guided:
                self.follower.regions = self.expect(k * FRAME_S)
        return seen


def kept(seen: list[FeatureObservations]) -> float:
    """Share of the features of each image that are found in the next."""
    pairs = list(zip(seen, seen[1:], strict=False))
    return float(np.mean([len(np.intersect1d(a.ids, b.ids)) / len(a.ids) for a, b in pairs]))


def missed_px(ride: Ride, seen: FeatureObservations) -> float:
    """How far the features of the last image were from where they were expected."""
    expected = ride.follower.expected
    assert expected is not None
    _, found, asked = np.intersect1d(seen.ids, expected.ids, return_indices=True)
    return float(np.median(np.linalg.norm(seen.pixels[found] - expected.pixels[asked], axis=1)))


# --- turning ------------------------------------------------------------------------------------


def test_turns_add_up() -> None:
    turning = turned((0.01 * k, 0.0, 0.0, 0.5) for k in range(101))
    for t_s in (0.0, 0.3333, 1.0):
        euler = turning.at(nanoseconds(t_s))
        assert euler is not None
        np.testing.assert_allclose(euler, [0.0, 0.0, 0.5 * t_s], atol=1e-9)


def test_a_tilt_goes_round_with_the_body_and_comes_back_to_level() -> None:
    tipped = turned((0.01 * k, 1.0 if k < 11 else 0.0, 0.0, 0.0) for k in range(21))
    assert tipped.at(nanoseconds(0.1))[0] == pytest.approx(0.1, rel=0.06)  # type: ignore[index]
    turning = turned((0.01 * k, 1.0 if k < 11 else 0.0, 0.0, math.pi if k > 11 else 0.0) for k in range(63))
    roll, pitch, _ = turning.at(nanoseconds(0.62))  # type: ignore[misc]
    assert roll == pytest.approx(0.0, abs=0.01), 'after a quarter turn what was roll is pitch'
    assert -0.1 < pitch < -0.05
    rested = turned((0.01 * k, 1.0 if k < 11 else 0.0, 0.0, 0.0) for k in range(800))
    assert np.abs(rested.at(nanoseconds(7.99))).max() < 1e-3  # type: ignore[arg-type]


def test_a_gyro_that_is_biased_does_not_tip_the_robot_over() -> None:
    turning = turned((0.01 * k, 0.01, -0.01, 0.0) for k in range(6000))
    assert np.abs(turning.at(nanoseconds(59.99))[:2]).max() < 0.011  # type: ignore[index]


def test_what_no_sample_vouches_for_is_not_told() -> None:
    assert Turning().at(0) is None
    turning = turned((0.01 * k, 0.0, 0.0, 1.0) for k in range(1001))
    assert turning.at(nanoseconds(10.0 - 3.0 * KEPT_S)) is None
    assert turning.at(nanoseconds(10.0 + GAP_S)) is None
    assert turning.at(nanoseconds(10.02))[2] == pytest.approx(10.02)  # type: ignore[index]
    assert turning.until_ns == nanoseconds(10.0)


def test_a_gap_and_an_old_sample_turn_nothing() -> None:
    turning = Turning()
    for t_s, z in ((0.0, 1.0), (0.1, 1.0), (0.05, 50.0), (0.1, 50.0), (5.0, 1.0), (5.1, 1.0)):
        turning.add(sample(t_s, z))
    assert turning.at(nanoseconds(5.1))[2] == pytest.approx(0.2)  # type: ignore[index]


# --- follower -----------------------------------------------------------------------------------


def test_features_are_followed_through_a_fast_turn_by_a_gyro_that_overstates(
    renderer: CeilingRenderer,
) -> None:
    ride = Ride(renderer, math.radians(80.0), overstated=1.08)
    seen = ride.go(0, 25)
    assert kept(seen) > 0.9, 'what leaves the image is lost, hardly more'
    assert missed_px(ride, seen[-1]) < 0.1, 'turn and drive are foreseen, the gyro put right'


def test_regions_are_wide_until_the_gyro_is_known(renderer: CeilingRenderer) -> None:
    ride = Ride(renderer, math.radians(80.0), overstated=1.08)
    widest_px2 = []
    for k in range(2, 5):
        ride.go(k - 2 if k == 2 else k - 1, k)
        expected = ride.follower.expected
        assert expected is not None
        widest_px2.append(expected.covariances_px2[:, 0, 0].max())
    assert widest_px2[0] > 2.0**2, 'eight of a hundred parts of a turn of 8 deg are some 3 px'
    assert widest_px2[2] < 0.3 * widest_px2[0]


def test_a_long_rest_with_a_biased_gyro_teaches_nothing_wrong(renderer: CeilingRenderer) -> None:
    ride = Ride(renderer, 0.0, overstated=1.08, bias_rad_s=math.radians(1.0))
    ride.speed_m_s = 0.0
    ride.go(0, 100)
    ride.rate_rad_s = math.radians(80.0)
    ride.start_s = 9.9
    assert missed_px(ride, ride.go(100, 101)[-1]) < 5.0, 'the prediction is as good as the gyro'
    assert kept(ride.go(101, 112)) > 0.9


def test_lost_features_come_back_where_the_filter_expects_them(renderer: CeilingRenderer) -> None:
    ride = Ride(renderer, math.radians(10.0))
    before = ride.go(0, 5)[-1]
    for k in (5, 6):
        ride.hear(k * FRAME_S)
        assert len(ride.look(k * FRAME_S, covered=True).ids) == 0
        ride.follower.regions = ride.expect(k * FRAME_S)
    after = ride.go(7, 8)[0]
    assert len(np.intersect1d(before.ids, after.ids)) > 10


@pytest.mark.parametrize('guided', [False, True])
def test_without_an_imu_a_slow_turn_is_followed(renderer: CeilingRenderer, guided: bool) -> None:
    ride = Ride(renderer, math.radians(8.0))
    seen = ride.go(0, 12, guided=guided, heard=False)
    assert kept(seen) > 0.9
    assert ride.follower.expected is None, 'nobody can tell where they are after an unknown turn'


def test_without_the_filter_all_goes_on(renderer: CeilingRenderer) -> None:
    ride = Ride(renderer, math.radians(60.0), overstated=1.08)
    seen = ride.go(0, 15, guided=False)
    assert kept(seen) > 0.9
    assert ride.follower.expected is None


def test_after_a_step_of_the_clock_nothing_old_counts(renderer: CeilingRenderer) -> None:
    ride = Ride(renderer, math.radians(20.0))
    ride.go(0, 4)
    ride.follower.restart()
    ride.hear(0.4)
    assert ride.follower.turning.at(nanoseconds(0.1)) is None
    assert len(ride.look(0.4).ids) == 15
    assert ride.follower.expected is None


def test_ids_begin_where_they_are_told_and_stay_within_32_bits(renderer: CeilingRenderer) -> None:
    image = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]))
    seen = Tracker(CAMERA, TrackerConfig(), first_id=2**32 - 5).track(Frame(0, image), np.eye(3), None)
    assert sorted(seen.ids.tolist()) == [*range(10), *range(2**32 - 5, 2**32)]


# --- the filter with eyes -----------------------------------------------------------------------


def filmed(duration_s: float = 1.0) -> SimSource:
    return SimSource(replace(SCENARIOS['demo'], duration_s=duration_s), 1, images=True)


def seeing(source: SimSource, keep: list[FeatureObservations]) -> VisualSlam:
    return VisualSlam(EkfSlam(default_model(), Config(), source.rig), keep.append)


def test_an_image_waits_for_the_imu_and_is_followed_in_its_turn() -> None:
    source, keep = filmed(), list[FeatureObservations]()
    stream = seeing(source, keep)
    images: list[Frame] = []
    imu_ns = 0
    for item in source.measurements():
        stream.step(item)
        if isinstance(item, Frame):
            images.append(item)
        elif isinstance(item, ImuSample):
            imu_ns = item.t_ns
        assert [seen.t_ns for seen in keep] == [image.t_ns for image in images if image.t_ns <= imu_ns]
    stream.finish()
    assert [seen.t_ns for seen in keep] == [image.t_ns for image in images]
    assert all(len(seen.ids) > 10 for seen in keep)


def test_the_filter_learns_from_images_and_knows_their_noise() -> None:
    source = filmed()
    slam = EkfSlam(default_model(), Config(), source.rig)
    stream = VisualSlam(slam)
    for item in source.measurements():
        stream.step(item)
    used = sum(record.update.used for record in stream.finish())
    assert used > 10 or len(slam.state.landmarks.ids) > 10
    assert slam.pixel_noise.std < 0.2, 'that of recorded features is not taken for theirs'


def test_images_before_a_step_of_the_clock_are_not_lost() -> None:
    source, keep = filmed(0.5), list[FeatureObservations]()
    stream = seeing(source, keep)
    items: list[Measurement] = list(source.measurements())
    image = [item for item in items if isinstance(item, Frame)][-1]
    for item in items:
        if item.t_ns > image.t_ns:
            break
        stream.step(item)
    stream.step(ClockStep(image.t_ns + nanoseconds(100.0), nanoseconds(100.0)))
    assert keep[-1].t_ns == image.t_ns
