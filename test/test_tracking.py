"""The tracker on a running robot: order of arrival, patience, restarts, and what it says of itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from heapq import heapify, heappop, heappush
from typing import Any

import numpy as np
import pytest

from gyrocal_ros.config.sections import CameraConfig, Config, TrackerConfig
from gyrocal_ros.data import (
    NS_PER_S,
    FeatureObservations,
    Frame,
    ImuSample,
    Measurement,
    SearchRegions,
    nanoseconds,
    seconds,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.msgs.topics import BODY_FRAME, CAMERA_FRAME, IMU_FRAME
from gyrocal_ros.msgs.transforms import IDENTITY, Transform
from gyrocal_ros.pipeline.visual_slam import VisualSlam
from gyrocal_ros.robot.health import Level, Status
from gyrocal_ros.robot.tracking import MAX_WAITING, LiveTracker, Tracked
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import SimSource

PATIENCE_S = 0.05
START_NS = 1_700_000_000 * NS_PER_S


@cache
def film(duration_s: float = 4.0) -> tuple[SimSource, list[Measurement]]:
    """A robot that begins to drive after a second."""
    scenario = replace(SCENARIOS['demo'], duration_s=duration_s, standing_s=1.0)
    source = SimSource(scenario, 3, images=True)
    return source, list(source.measurements())


def frames() -> list[Frame]:
    return [item for item in film()[1] if isinstance(item, Frame)]


def tracker(*, mounted: bool = True, known: bool = True) -> LiveTracker:
    live, rig = LiveTracker(TrackerConfig(), CameraConfig(), PATIENCE_S, 0.0), film()[0].rig
    if mounted:
        live.links(
            [
                Transform(BODY_FRAME, CAMERA_FRAME, rig.camera_mount),
                Transform(BODY_FRAME, IMU_FRAME, IDENTITY),
            ]
        )
    if known:
        assert rig.camera is not None
        live.camera(rig.camera, CAMERA_FRAME, 0.0)
    return live


def still(t_s: float) -> ImuSample:
    return ImuSample(START_NS + nanoseconds(t_s), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))


def image(t_s: float, source: Frame | None = None) -> Frame:
    return Frame(START_NS + nanoseconds(t_s), (source or frames()[0]).image)


def look(live: LiveTracker, t_s: float, now_s: float | None = None) -> Tracked | None:
    """Show it an image at a time, the IMU being there, and let it work."""
    live.imu(still(t_s), IMU_FRAME, t_s if now_s is None else now_s)
    live.image(image(t_s), CAMERA_FRAME, t_s if now_s is None else now_s)
    return live.work(t_s if now_s is None else now_s)


def nowhere(t_s: float) -> SearchRegions:
    return SearchRegions(
        START_NS + nanoseconds(t_s), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))
    )


# --- the same as in a recording -----------------------------------------------------------------


def as_sent(values: np.ndarray) -> np.ndarray:
    """What is left of numbers that go through a message."""
    return values.astype(np.float32).astype(float)


def run_live(late_s: Callable[[Measurement], float]) -> tuple[list[FeatureObservations], EkfSlam]:
    """Tracker and filter in two processes, what they are told and tell each other being under way a while."""
    source, measurements = film()
    slam, live = EkfSlam(default_model(), Config(), source.rig), tracker()
    slam.expect_pixel_noise(Config().tracker.noise_px)
    start_ns = measurements[0].t_ns
    queue: list[tuple[float, int, Any]] = [
        (seconds(item.t_ns - start_ns) + late_s(item), n, item) for n, item in enumerate(measurements)
    ]
    heapify(queue)
    seen: list[FeatureObservations] = []
    while queue:
        now_s, _, item = heappop(queue)
        if isinstance(item, SearchRegions):
            live.regions(item, now_s)
        elif isinstance(item, Frame):
            live.image(item, CAMERA_FRAME, now_s)
        else:
            if isinstance(item, ImuSample):
                live.imu(item, IMU_FRAME, now_s)
            if slam.step(item):
                regions = slam.regions()
                sent = replace(
                    regions,
                    pixels=as_sent(regions.pixels),
                    covariances_px2=as_sent(regions.covariances_px2),
                )
                heappush(queue, (now_s + 0.01, len(queue) + 10**6, sent))
        while (tracked := live.work(now_s)) is not None:
            seen.append(tracked.seen)
            sent_features = replace(tracked.seen, pixels=as_sent(tracked.seen.pixels))
            heappush(queue, (now_s + 0.01, len(queue) + 10**6, sent_features))
    slam.finish()
    return seen, slam


def test_two_processes_see_and_learn_what_one_does_in_a_recording() -> None:
    source, measurements = film()
    expected: list[FeatureObservations] = []
    slam = EkfSlam(default_model(), Config(), source.rig)
    eyes = VisualSlam(slam, expected.append)
    for item in measurements:
        eyes.step(item)
    eyes.finish()
    late_s = {ImuSample: 0.002, Frame: 0.03}
    seen, other = run_live(lambda item: late_s.get(type(item), 0.004))
    assert [len(image.ids) for image in seen] == [len(image.ids) for image in expected]
    for mine, theirs in zip(seen, expected, strict=True):
        np.testing.assert_array_equal(mine.ids - seen[0].ids.min(), theirs.ids)
        np.testing.assert_allclose(mine.pixels, theirs.pixels, atol=0.02)
    std = np.sqrt(slam.state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])
    scales = [filter_.state.mean[COEFFICIENTS_START] for filter_ in (slam, other)]
    assert abs(scales[1] - scales[0]) < 0.3 * std


# --- patience -----------------------------------------------------------------------------------


def test_an_image_waits_for_the_imu_and_no_longer_than_its_patience() -> None:
    live = tracker()
    assert look(live, 0.0)
    live.imu(still(0.09), IMU_FRAME, 0.1)
    live.image(image(0.1), CAMERA_FRAME, 0.1)
    assert live.work(0.1) is None and live.is_waiting
    live.imu(still(0.1), IMU_FRAME, 0.102)
    assert live.work(0.102) is not None and not live.is_waiting
    live.image(image(0.2), CAMERA_FRAME, 0.2)
    assert live.work(0.2 + 0.9 * PATIENCE_S) is None
    assert live.work(0.2 + 1.1 * PATIENCE_S) is not None


def test_an_image_waits_for_what_the_filter_says_of_the_one_before() -> None:
    live = tracker()
    for t_s in (0.0, 0.1):
        assert look(live, t_s)
        live.regions(nowhere(t_s), t_s + 0.02)
    assert look(live, 0.2), 'the filter has spoken of the last image'
    assert look(live, 0.3) is None, 'it has not yet'
    live.regions(nowhere(0.2), 0.31)
    assert live.work(0.31)


def test_nobody_waits_for_those_that_do_not_speak() -> None:
    live = tracker()
    for k in range(3):
        live.image(image(0.1 * k), CAMERA_FRAME, 0.1 * k)
        assert live.work(0.1 * k), 'there is no IMU and no filter'
    live.regions(nowhere(0.2), 0.25)
    assert look(live, 0.3)
    assert look(live, 3.0), 'the filter has ended'


def test_old_images_make_way_for_newer_ones() -> None:
    live = tracker()
    look(live, 0.0)
    for k in range(1, MAX_WAITING + 3):
        live.image(image(0.01 * k), CAMERA_FRAME, 0.01 * k)
    seen = [tracked.seen.t_ns for tracked in iter(lambda: live.work(1.0), None)]
    assert len(seen) == MAX_WAITING and seen[-1] == image(0.01 * (MAX_WAITING + 2)).t_ns
    status = live.status(1.0)
    assert '2 images in 10 s were left out' in status.message
    assert status.numbers['dropped'] == 2


def test_an_image_that_comes_late_is_left_out_and_told() -> None:
    live = tracker()
    assert look(live, 0.1) and look(live, 0.2)
    live.image(image(0.15), CAMERA_FRAME, 0.21)
    live.image(image(0.2), CAMERA_FRAME, 0.22)
    assert live.work(1.0) is None
    assert '2 images in 10 s are not newer than the one before' in live.status(0.3).message


# --- new starts ---------------------------------------------------------------------------------


def test_a_tracker_that_is_started_again_uses_other_ids() -> None:
    first, second = tracker(), tracker()
    used = look(first, 10.0)
    again = look(second, 10.5)
    assert used is not None and again is not None
    assert not np.intersect1d(used.seen.ids, again.seen.ids).size
    assert again.seen.ids.min() >= 0 and again.seen.ids.max() < 2**32


def test_a_clock_that_is_set_back_is_followed_and_told() -> None:
    live = tracker()
    for k in range(3):
        assert look(live, 100.0 + 0.1 * k, now_s=0.1 * k)
    for k in range(3, 6):
        assert look(live, 98.0 + 0.1 * k, now_s=0.1 * k)
    status = live.status(0.6)
    assert status.level is Level.WARN and 'went back: a clock was set' in status.message
    assert live.status(20.0).message.count('went back') == 0


def test_another_camera_begins_anew() -> None:
    live, camera = tracker(), film()[0].rig.camera
    before = look(live, 0.0)
    assert camera is not None and before is not None
    live.camera(replace(camera, fx_px=260.0), CAMERA_FRAME, 0.05)
    after = look(live, 0.1)
    assert after is not None and not np.intersect1d(before.seen.ids, after.seen.ids).size


def test_settings_may_change_between_images() -> None:
    live = tracker()
    assert len(look(live, 0.0).seen.ids) == 15  # type: ignore[union-attr]
    live.configure(replace(TrackerConfig(), features=20), PATIENCE_S)
    last = [look(live, 0.1 * k) for k in range(1, 12)][-1]
    assert len(last.seen.ids) == 20  # type: ignore[union-attr]


# --- mounting -----------------------------------------------------------------------------------


def test_without_a_transform_the_settings_say_how_the_camera_sits() -> None:
    live = tracker(mounted=False)
    assert look(live, 0.0) is None, 'a transform may be under way'
    told = [look(live, 0.1 * k) for k in range(1, 40)]
    assert told[-1] is not None
    assert 'no transform from base_link to ceiling_camera_optical_frame' in live.status(4.0).message


def test_without_transform_and_imu_too() -> None:
    live = tracker(mounted=False)
    live.image(image(3.5), CAMERA_FRAME, 3.5)
    assert live.work(3.6) is not None
    live.image(image(3.6), CAMERA_FRAME, 3.7)
    tracked = live.work(3.8)
    assert tracked is not None and tracked.picture().shape == (480, 640, 3)


# --- what it says -------------------------------------------------------------------------------


def drive_by(live: LiveTracker, images: Iterable[Frame], start_s: float = 0.0) -> Status:
    now_s = start_s
    for k, frame in enumerate(images):
        now_s = start_s + 0.1 * k
        live.imu(still(now_s), IMU_FRAME, now_s)
        live.image(image(now_s, frame), CAMERA_FRAME, now_s)
        tracked = live.work(now_s)
        if tracked is not None:
            live.health.hand_on(0.008)
    return live.status(now_s)


def test_a_healthy_tracker_says_so() -> None:
    status = drive_by(tracker(), frames()[:8] * 4)
    assert status.level is Level.OK
    assert status.message.startswith('following 15 features in 10.')
    assert status.message.endswith('a second, without the calibrator')
    assert status.numbers['latency_ms_p99'] == 8.0


def test_it_says_what_is_missing() -> None:
    live = tracker(known=False)
    message = live.status(5.0).message
    assert live.status(5.0).level is Level.ERROR
    assert 'ceiling_camera/image_raw: nothing has come yet' in message
    assert 'ceiling_camera/camera_info: nothing has come yet' in message
    assert 'imu/data_raw: nothing has come yet' in message
    look(live, 5.1)
    assert 'ceiling_camera/image_raw: nothing for 3 s' in live.status(8.2).message


@pytest.mark.parametrize(
    ('grey', 'said'), [(4, 'the images are dark (grey level 4 of 255)'), (90, 'show one grey (90 of 255)')]
)
def test_a_covered_camera_is_named_and_forgotten_when_it_sees_again(grey: int, said: str) -> None:
    live = tracker()
    dark = Frame(0, np.full((480, 640), grey, np.uint8))
    assert drive_by(live, frames()[:3]).level is Level.OK
    status = drive_by(live, [dark] * 20, start_s=0.3)
    assert (
        status.level is Level.WARN and 'no feature was seen for' in status.message and said in status.message
    )
    assert drive_by(live, frames()[:3], start_s=2.3).level is Level.OK


def test_images_of_another_size_are_told() -> None:
    live = tracker()
    small = Frame(0, np.zeros((240, 320), np.uint8))
    status = drive_by(live, [small] * 5)
    assert status.level is Level.ERROR
    assert '5 images in 10 s are of no use: an image is 320 x 240 pixels' in status.message
    assert '640 x 480' in status.message


def test_images_that_are_lost_on_the_way_show_in_their_stamps() -> None:
    live = tracker()
    for k in (*range(10), 12, 13):
        look(live, 0.1 * k)
    assert '2 images in 10 s were left out' in live.status(1.4).message


@pytest.mark.parametrize(
    ('offset_s', 'said'),
    [(-0.4, 'images come 0.40 s after the IMU'), (0.06, 'images are stamped 0.06 s ahead')],
)
def test_images_whose_stamps_are_off_are_told(offset_s: float, said: str) -> None:
    live = tracker()
    for k in range(25):
        live.imu(still(0.1 * k), IMU_FRAME, 0.1 * k)
        live.image(image(0.1 * k + offset_s), CAMERA_FRAME, 0.1 * k)
        live.work(0.1 * k)
    assert said in live.status(2.5).message
