"""The tracker on a running robot: order of arrival, timeouts, restarts, health."""

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
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.ekf.stream import SlamStream
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
    """Return the measurements of a robot that starts to drive after a second."""
    scenario = replace(SCENARIOS['demo'], duration_s=duration_s, standing_s=1.0)
    source = SimSource(scenario, 3, images=True)
    return source, list(source.measurements())


def frames() -> list[Frame]:
    return [item for item in film()[1] if isinstance(item, Frame)]


def tracker(*, mounted: bool = True, known: bool = True) -> LiveTracker:
    live, rig = LiveTracker(TrackerConfig(), CameraConfig(), PATIENCE_S, 0.0), film()[0].rig
    if mounted:
        live.transforms(
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
    """Return an image of a time; as on a camera, no two are equal in every pixel."""
    picture = (source or frames()[0]).image.copy()
    picture[0, 0] = round(100 * t_s) % 256
    return Frame(START_NS + nanoseconds(t_s), picture)


def show(live: LiveTracker, t_s: float, now_s: float | None = None) -> Tracked | None:
    """Deliver an image with its IMU sample; return what the tracker has tracked."""
    live.imu(still(t_s), IMU_FRAME, t_s if now_s is None else now_s)
    live.image(image(t_s), CAMERA_FRAME, t_s if now_s is None else now_s)
    return live.work(t_s if now_s is None else now_s)


def no_regions(t_s: float) -> SearchRegions:
    return SearchRegions(
        START_NS + nanoseconds(t_s), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))
    )


# --- agreement with a recording -----------------------------------------------------------------


def as_sent(values: np.ndarray) -> np.ndarray:
    """Round numbers as a message does."""
    return values.astype(np.float32).astype(float)


def run_live(delay_s: Callable[[Measurement], float]) -> tuple[list[FeatureObservations], EkfSlam]:
    """Run tracker and filter as two processes, with delayed inputs and delays between them."""
    source, measurements = film()
    slam, live = EkfSlam(default_model(), Config(), source.rig), tracker()
    stream = SlamStream(slam)
    slam.expect_pixel_noise(Config().tracker.noise_px)
    start_ns = measurements[0].t_ns
    queue: list[tuple[float, int, Any]] = [
        (seconds(item.t_ns - start_ns) + delay_s(item), n, item) for n, item in enumerate(measurements)
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
            if stream.step(item):
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
    stream.finish()
    return seen, slam


@pytest.mark.slow
def test_two_processes_give_the_result_of_a_recording() -> None:
    source, measurements = film()
    expected: list[FeatureObservations] = []
    slam = EkfSlam(default_model(), Config(), source.rig)
    visual_slam = VisualSlam(slam, expected.append)
    for item in measurements:
        visual_slam.step(item)
    visual_slam.finish()
    delay_s = {ImuSample: 0.002, Frame: 0.03}
    seen, other = run_live(lambda item: delay_s.get(type(item), 0.004))
    assert [len(image.ids) for image in seen] == [len(image.ids) for image in expected]
    for live, replayed in zip(seen, expected, strict=True):
        np.testing.assert_array_equal(live.ids - seen[0].ids.min(), replayed.ids)
        np.testing.assert_allclose(live.pixels, replayed.pixels, atol=0.02)
    std = np.sqrt(slam.state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])
    scales = [filter_.state.mean[COEFFICIENTS_START] for filter_ in (slam, other)]
    assert abs(scales[1] - scales[0]) < 0.3 * std


# --- timeouts -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_image_waits_for_the_imu_until_its_timeout() -> None:
    live = tracker()
    assert show(live, 0.0)
    live.imu(still(0.09), IMU_FRAME, 0.1)
    live.image(image(0.1), CAMERA_FRAME, 0.1)
    assert live.work(0.1) is None and live.is_waiting
    live.imu(still(0.1), IMU_FRAME, 0.102)
    assert live.work(0.102) is not None and not live.is_waiting
    live.image(image(0.2), CAMERA_FRAME, 0.2)
    assert live.work(0.2 + 0.9 * PATIENCE_S) is None
    assert live.work(0.2 + 1.1 * PATIENCE_S) is not None


@pytest.mark.slow
def test_an_image_waits_for_the_search_regions_of_the_one_before() -> None:
    live = tracker()
    for t_s in (0.0, 0.1):
        assert show(live, t_s)
        live.regions(no_regions(t_s), t_s + 0.02)
    assert show(live, 0.2), 'the regions of the last image are there'
    assert show(live, 0.3) is None, 'they are missing'
    live.regions(no_regions(0.2), 0.31)
    assert live.work(0.31)


def test_images_do_not_wait_for_silent_sources() -> None:
    live = tracker()
    for k in range(3):
        live.image(image(0.1 * k), CAMERA_FRAME, 0.1 * k)
        assert live.work(0.1 * k), 'no IMU and no filter'
    live.regions(no_regions(0.2), 0.25)
    assert show(live, 0.3)
    assert show(live, 3.0), 'the filter is silent'


def test_the_oldest_images_are_dropped_first() -> None:
    live = tracker()
    show(live, 0.0)
    for k in range(1, MAX_WAITING + 3):
        live.image(image(0.01 * k), CAMERA_FRAME, 0.01 * k)
    seen = [tracked.seen.t_ns for tracked in iter(lambda: live.work(1.0), None)]
    assert len(seen) == MAX_WAITING and seen[-1] == image(0.01 * (MAX_WAITING + 2)).t_ns
    status = live.status(1.0)
    assert '2 images in 10 s were dropped' in status.message
    assert status.numbers['dropped'] == 2


def test_a_late_image_is_dropped_and_reported() -> None:
    live = tracker()
    assert show(live, 0.1) and show(live, 0.2)
    live.image(image(0.15), CAMERA_FRAME, 0.21)
    live.image(image(0.2), CAMERA_FRAME, 0.22)
    assert live.work(1.0) is None
    assert '2 images in 10 s are not newer than the one before' in live.status(0.3).message


# --- restarts -----------------------------------------------------------------------------------


def test_a_restarted_tracker_uses_other_ids() -> None:
    first, second = tracker(), tracker()
    before = show(first, 10.0)
    after = show(second, 10.5)
    assert before is not None and after is not None
    assert not np.intersect1d(before.seen.ids, after.seen.ids).size
    assert after.seen.ids.min() >= 0 and after.seen.ids.max() < 2**32


def test_a_clock_that_is_set_back_is_followed_and_reported() -> None:
    live = tracker()
    for k in range(3):
        assert show(live, 100.0 + 0.1 * k, now_s=0.1 * k)
    for k in range(3, 6):
        assert show(live, 98.0 + 0.1 * k, now_s=0.1 * k)
    status = live.status(0.6)
    assert status.level is Level.WARN and 'went back: a clock was set' in status.message
    assert live.status(20.0).message.count('went back') == 0


def test_another_camera_restarts_the_tracks() -> None:
    live, camera = tracker(), film()[0].rig.camera
    before = show(live, 0.0)
    assert camera is not None and before is not None
    live.camera(replace(camera, fx_px=260.0), CAMERA_FRAME, 0.05)
    after = show(live, 0.1)
    assert after is not None and not np.intersect1d(before.seen.ids, after.seen.ids).size


def test_settings_can_change_between_images() -> None:
    live = tracker()
    assert len(show(live, 0.0).seen.ids) == 15  # type: ignore[union-attr]
    live.configure(replace(TrackerConfig(), features=20), PATIENCE_S)
    last = [show(live, 0.1 * k) for k in range(1, 12)][-1]
    assert len(last.seen.ids) == 20  # type: ignore[union-attr]


# --- mounting -----------------------------------------------------------------------------------


def test_without_a_transform_the_mounting_comes_from_the_settings() -> None:
    live = tracker(mounted=False)
    assert show(live, 0.0) is None, 'a transform may still arrive'
    tracked = [show(live, 0.1 * k) for k in range(1, 40)]
    assert tracked[-1] is not None
    assert (
        'no transform from base_link to ceiling_camera_optical_frame; the mounting in the settings is used'
        in live.status(4.0).message
    )


def test_without_transform_and_imu_the_mounting_comes_from_the_settings() -> None:
    live = tracker(mounted=False)
    live.image(image(3.5), CAMERA_FRAME, 3.5)
    assert live.work(3.6) is not None
    live.image(image(3.6), CAMERA_FRAME, 3.7)
    tracked = live.work(3.8)
    assert tracked is not None and tracked.picture().shape == (480, 640, 3)


# --- health -------------------------------------------------------------------------------------


def drive_by(live: LiveTracker, images: Iterable[Frame], start_s: float = 0.0) -> Status:
    now_s = start_s
    for k, frame in enumerate(images):
        now_s = start_s + 0.1 * k
        live.imu(still(now_s), IMU_FRAME, now_s)
        live.image(image(now_s, frame), CAMERA_FRAME, now_s)
        tracked = live.work(now_s)
        if tracked is not None:
            live.health.add_latency(0.008)
    return live.status(now_s)


def test_a_healthy_tracker_has_no_problems() -> None:
    status = drive_by(tracker(), frames()[:8] * 4)
    assert status.level is Level.OK
    assert status.message.startswith('tracking 15 features in 10.')
    assert status.message.endswith('a second, without the calibrator')
    assert status.numbers['latency_ms_p99'] == 8.0


def test_missing_inputs_are_named() -> None:
    live = tracker(known=False)
    message = live.status(5.0).message
    assert live.status(5.0).level is Level.ERROR
    assert 'ceiling_camera/image_raw: no message yet' in message
    assert 'ceiling_camera/camera_info: no message yet' in message
    assert 'imu/data_raw: no message yet' in message
    show(live, 5.1)
    assert 'ceiling_camera/image_raw: no message for 3 s' in live.status(8.2).message


@pytest.mark.parametrize(
    ('grey', 'words'), [(4, 'the images are dark (grey level 4 of 255)'), (90, 'are one grey (90 of 255)')]
)
def test_a_covered_camera_is_reported_until_it_sees_features_again(grey: int, words: str) -> None:
    live = tracker()
    dark = Frame(0, np.full((480, 640), grey, np.uint8))
    assert drive_by(live, frames()[:3]).level is Level.OK
    status = drive_by(live, [dark] * 20, start_s=0.3)
    assert (
        status.level is Level.WARN and 'no feature was seen for' in status.message and words in status.message
    )
    assert drive_by(live, frames()[:3], start_s=2.3).level is Level.OK


def test_images_of_another_size_are_reported() -> None:
    live = tracker()
    small = Frame(0, np.zeros((240, 320), np.uint8))
    status = drive_by(live, [small] * 5)
    assert status.level is Level.ERROR
    assert '5 images in 10 s cannot be used: an image is 320 x 240 pixels' in status.message
    assert '640 x 480' in status.message


def test_lost_images_are_counted_by_the_stamps() -> None:
    live = tracker()
    for k in (*range(10), 12, 13):
        show(live, 0.1 * k)
    assert '2 images in 10 s were dropped' in live.status(1.4).message


@pytest.mark.parametrize(
    ('offset_s', 'words'),
    [(-0.4, 'images come 0.40 s after the IMU'), (0.06, 'images are stamped 0.06 s ahead')],
)
def test_wrong_stamps_of_the_images_are_reported(offset_s: float, words: str) -> None:
    live = tracker()
    for k in range(25):
        live.imu(still(0.1 * k), IMU_FRAME, 0.1 * k)
        live.image(image(0.1 * k + offset_s), CAMERA_FRAME, 0.1 * k)
        live.work(0.1 * k)
    assert words in live.status(2.5).message
