"""From measurements to blocks and steps: block ends, time offsets, restarts and steps of the clock."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recordings import at, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    ClockStep,
    FeatureObservations,
    Frame,
    HeadingSample,
    ImuSample,
    Measurement,
    MotionBlock,
    TemperatureSample,
    TruthSample,
    WheelSample,
    nanoseconds,
    seconds,
)
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.motion import WHEEL_TIMEOUT_NS
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, POSITION, YAW
from gyrocal_ros.ekf.stream import MAX_BLOCK_NS, SlamStream, Synchroniser
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.sim.world import START_NS

Cut = tuple[float, float, float | None]
"""Start and end of a block, and the stamp of what was seen at its end, in s."""


def imu(time_s: float) -> ImuSample:
    return ImuSample(nanoseconds(time_s), (0.0, 0.0, 0.5), (0.0, 0.0, 9.8))


def image(time_s: float) -> FeatureObservations:
    return FeatureObservations(nanoseconds(time_s), np.empty(0, np.int64), np.empty((0, 2)))


def synchroniser(*image_s: float, until_s: float = 1.0) -> Synchroniser:
    """Return one with IMU samples every 5 ms from zero on, and images."""
    sync = Synchroniser()
    for tick in range(round(until_s * 200) + 1):
        sync.add(imu(tick / 200), 0)
    for time_s in image_s:
        sync.add(image(time_s), 0)
    return sync


def cuts(
    sync: Synchroniser, until_s: float = 1.0, *, start_s: float = 0.0, offset_s: float = 0.0
) -> list[Cut]:
    found: list[Cut] = []
    start_ns = nanoseconds(start_s)
    while item := sync.next_block(start_ns, nanoseconds(until_s), offset_s):
        block, seen = item
        assert block.start_ns == start_ns
        start_ns = block.end_ns
        found.append(
            (seconds(block.start_ns), seconds(start_ns), None if seen is None else seconds(seen.t_ns))
        )
    return found


# --- synchroniser -------------------------------------------------------------------------------


def test_blocks_end_at_images() -> None:
    assert cuts(synchroniser(0.1, 0.203, 0.4)) == [
        (0.0, 0.1, 0.1),
        (0.1, 0.203, 0.203),
        (0.203, 0.4, 0.4),
        (0.4, 0.65, None),
        (0.65, 0.9, None),
    ]


def test_headings_end_blocks_as_images_do() -> None:
    sync = synchroniser(0.2)
    heading = HeadingSample(nanoseconds(0.23), 1.0)
    assert sync.add(heading, 0)
    first, second = (sync.next_block(nanoseconds(start_s), nanoseconds(0.3), 0.0) for start_s in (0.0, 0.2))
    assert first is not None and second is not None
    assert second[1] is heading and seconds(second[0].end_ns) == 0.23


def test_long_blocks_are_divided() -> None:
    longest_s = seconds(MAX_BLOCK_NS)
    assert cuts(synchroniser(0.6)) == [
        (0.0, longest_s, None),
        (longest_s, 2 * longest_s, None),
        (2 * longest_s, 0.6, 0.6),
        (0.6, 0.6 + longest_s, None),
    ]
    assert cuts(synchroniser(), longest_s) == [], 'a block of this length waits for an image'
    assert cuts(synchroniser(longest_s), 1.0)[0] == (0.0, longest_s, longest_s)


def test_images_beyond_the_imu_wait() -> None:
    sync = synchroniser(0.1, 0.35)
    assert cuts(sync, 0.2) == [(0.0, 0.1, 0.1)]
    assert cuts(sync, 0.4, start_s=0.1) == [(0.1, 0.35, 0.35)]


def test_images_before_the_time_of_the_filter_are_dropped() -> None:
    assert cuts(synchroniser(0.1, 0.2, 0.3), 0.4, start_s=0.2) == [(0.2, 0.3, 0.3)]
    twice = synchroniser(0.1, 0.1, 0.2)
    assert cuts(twice, 0.3) == [(0.0, 0.1, 0.1), (0.1, 0.2, 0.2)], 'two images of one moment'


@pytest.mark.parametrize('offset_s', [0.03, -0.03])
def test_stamps_are_corrected_by_the_time_offset(offset_s: float) -> None:
    """The offset is stamp minus true time."""
    (cut,) = cuts(synchroniser(0.1), 0.15, offset_s=offset_s)
    assert cut == pytest.approx((0.0, 0.1 - offset_s, 0.1))
    sync = synchroniser(0.1)
    assert sync.last_seen_ns(offset_s) == nanoseconds(0.1) - nanoseconds(offset_s)
    assert cuts(sync, 0.1 - offset_s - 0.001, offset_s=offset_s) == []


@pytest.mark.parametrize(
    ('every_s', 'offset_s'), [(0.2, 0.1), (0.2, 0.3), (0.5, 0.2), (0.1, 0.6), (0.2, -0.1)]
)
def test_images_that_are_stamped_late_are_all_used(every_s: float, offset_s: float) -> None:
    """The filter waits for them, however slow the camera is, instead of predicting beyond them."""
    stamps = [round(1.0 + every_s * number, 3) for number in range(10)]
    slam = EkfSlam(default_model(), Config(), recording().rig)
    stream, seen_at = SlamStream(slam), []
    slam.time_offset_s = lambda: offset_s  # type: ignore[method-assign]
    slam.step = lambda block, seen=None: seen_at.append((block.end_ns, seen)) or moved(slam, block)  # type: ignore
    for tick in range(round((stamps[-1] + 1.0) * 100)):
        for stamp_s in stamps:
            if round(stamp_s * 100) == tick:
                stream.step(image(stamp_s))
        stream.step(imu(tick / 100))
    stream.finish()
    used = [(seconds(end_ns), seconds(seen.t_ns)) for end_ns, seen in seen_at if seen is not None]
    assert used == [pytest.approx((stamp_s - offset_s, stamp_s)) for stamp_s in stamps]


def moved(slam: EkfSlam, block: MotionBlock) -> None:
    """Advance the time of a filter that only counts."""
    slam.state = replace(slam.state, t_ns=block.end_ns)


def test_the_moment_of_an_image_is_fixed_once_it_is_reached() -> None:
    """The blocks that lead to an image may change the estimate of the offset, but not its moment."""
    sync = synchroniser(0.4)
    first = sync.next_block(0, nanoseconds(0.5), 0.0)
    second = sync.next_block(nanoseconds(0.25), nanoseconds(0.5), 0.1)
    assert first is not None and first[1] is None and seconds(first[0].end_ns) == 0.25
    assert second is not None and second[1] is not None and seconds(second[0].end_ns) == 0.4


def test_blocks_become_available_with_images_and_after_the_longest_block() -> None:
    sync = Synchroniser()
    assert not sync.add(imu(0.0), 0)
    assert not sync.add(imu(0.25), 0)
    assert sync.add(imu(0.251), 0)
    assert not sync.add(imu(0.252), nanoseconds(0.2))
    assert sync.add(image(0.3), nanoseconds(0.2))
    assert sync.add(imu(0.31), nanoseconds(0.2)), 'an image waits'
    assert not sync.add(TruthSample(nanoseconds(0.31), (0.0, 0.0, 0.0), 0.0), 0)


@pytest.mark.parametrize(
    'measurement', [Frame(0, np.zeros((2, 2), np.uint8)), ClockStep(0, 1)], ids=lambda m: type(m).__name__
)
def test_measurements_that_are_not_for_the_filter_raise(measurement: Measurement) -> None:
    with pytest.raises(TypeError, match=type(measurement).__name__):
        Synchroniser().add(measurement, 0)


def test_covered_time_is_that_of_the_buffer() -> None:
    sync = Synchroniser()
    assert sync.covered_ns() is None and sync.last_seen_ns(0.0) is None
    sync.add(TemperatureSample(0, 20.0), 0)
    assert sync.covered_ns() is None
    sync.add(WheelSample(0, 0.1, 0.0), 0)
    sync.add(imu(0.5), 0)
    assert sync.covered_ns() == nanoseconds(0.5) - WHEEL_TIMEOUT_NS


def test_a_restart_drops_what_waits_and_keeps_the_running_time() -> None:
    sync = synchroniser(0.3, 0.9)
    first = sync.next_block(0, nanoseconds(0.5), 0.0)
    assert first is not None and first[1] is None, 'the image of 0.3 s is next'
    sync.restart(running_s=7.0)
    assert sync.covered_ns() is None and sync.last_seen_ns(0.0) is None
    assert sync.buffer.start_ns is None and sync.buffer.running_s(0) == 7.0
    for time_s in (5.0, 5.1):
        sync.add(imu(time_s), 0)
    assert sync.buffer.running_s(nanoseconds(5.1)) == pytest.approx(7.1)
    assert cuts(sync, 5.1, start_s=5.0) == []


# --- stream -------------------------------------------------------------------------------------


def stream(model: SensorModel | None = None, running_s: float = 0.0) -> SlamStream:
    return SlamStream(EkfSlam(model or default_model(), Config(), recording().rig), running_s)


def run(consumer: SlamStream, from_s: float, to_s: float, step_ns: int = 0) -> list[StepRecord]:
    """Give the measurements of a stretch of the recording, their clock stepped by `step_ns`."""
    records: list[StepRecord] = []
    for item in recording().measurements():
        if at(from_s) <= item.t_ns < at(to_s):
            records += consumer.step(replace(item, t_ns=item.t_ns + step_ns))
    return records


def test_a_stream_starts_at_the_first_imu_sample() -> None:
    consumer = stream()
    assert not consumer.has_started
    records = run(consumer, 0.0, 2.0)
    assert consumer.has_started
    first_ns = next(item.t_ns for item in recording().measurements() if isinstance(item, ImuSample))
    assert records[0].block.start_ns == first_ns
    assert all(a.t_ns == b.block.start_ns for a, b in zip(records, records[1:], strict=False))
    assert records[-1].t_ns == consumer.slam.state.t_ns


def test_the_end_of_the_stream_uses_the_images_that_wait() -> None:
    consumer = stream()
    run(consumer, 0.0, 2.0)
    late = replace(image(0.0), t_ns=at(2.05))
    assert consumer.step(late) == []
    records = consumer.finish()
    assert records[-1].t_ns == late.t_ns
    assert consumer.finish() == [], 'nothing waits any more'


def test_the_running_time_of_the_gyro_goes_on() -> None:
    consumer = stream(running_s=50.0)
    records = run(consumer, 0.0, 2.0)
    assert records[0].block.time_s[0] == pytest.approx(50.0, abs=0.05)
    assert consumer.running_s == pytest.approx(50.0 + seconds(records[-1].t_ns - START_NS), abs=0.05)


def test_images_are_placed_by_the_estimated_time_offset() -> None:
    offset = find_effect('camera_time_offset')
    late = replace(offset.coefficients[0], prior_mean=0.04)
    effect = replace(offset, coefficients=(late,))  # type: ignore[type-var]
    consumer = stream(SensorModel('late', BiasModel(), (find_effect('scale_factor'), effect)))
    assert consumer.slam.time_offset_s() == 0.04
    found = {record.t_ns for record in run(consumer, 0.0, 0.5) if record.update.added}
    stamps = {item.t_ns for item in recording().measurements() if isinstance(item, FeatureObservations)}
    assert found and found <= {stamp - nanoseconds(0.04) for stamp in stamps}


@pytest.mark.parametrize('step_s', [100.0, -100.0])
def test_a_clock_step_keeps_the_calibration_and_drops_the_map(step_s: float) -> None:
    consumer, step_ns = stream(), nanoseconds(step_s)
    run(consumer, 0.0, 10.0)
    before, running_s = consumer.slam.state, consumer.running_s
    assert len(before.landmarks.ids) > 10
    waiting = consumer.step(ClockStep(at(10.0) + step_ns, step_ns))
    assert all(record.t_ns < at(10.0) for record in waiting), 'steps on the old time base'
    state = consumer.slam.state
    assert state.t_ns == at(10.0) + step_ns and not consumer.has_started
    assert len(state.landmarks.ids) == 0 and len(state.mean) == state.robot_size
    np.testing.assert_allclose(state.coefficients, before.coefficients, atol=1e-6)
    grown = (
        np.diagonal(state.covariance)[: state.robot_size] - np.diagonal(before.covariance)[: state.robot_size]
    )
    assert np.all(grown[POSITION] > 0.05) and grown[YAW] > 0.005
    assert consumer.running_s == pytest.approx(running_s, abs=0.2)

    records = run(consumer, 10.0, 12.0, step_ns)
    assert consumer.has_started
    assert records[0].block.start_ns >= at(10.0) + step_ns
    assert records[0].block.time_s[0] == pytest.approx(running_s, abs=0.2)
    assert records[-1].t_ns == pytest.approx(at(12.0) + step_ns, abs=nanoseconds(0.2))
    assert len(consumer.slam.state.landmarks.ids) > 10, 'a new map'


@pytest.mark.slow
def test_a_clock_step_aligns_a_heading_reference_again() -> None:
    consumer = stream()

    def headings(from_s: float, to_s: float, turned_rad: float, step_ns: int = 0) -> list[StepRecord]:
        records: list[StepRecord] = []
        for item in recording().measurements():
            if not at(from_s) <= item.t_ns < at(to_s) or isinstance(item, FeatureObservations):
                continue
            if isinstance(item, TruthSample):
                noise_rad = 1e-6 * math.sin(item.t_ns)  # a heading that is repeated is no measurement
                yaw_rad = item.yaw_rad + turned_rad + noise_rad
                records += consumer.step(HeadingSample(item.t_ns + step_ns, yaw_rad))
            else:
                records += consumer.step(replace(item, t_ns=item.t_ns + step_ns))
        return records

    before = [record for record in headings(0.0, 3.0, 0.5) if record.update.stats.dof]
    consumer.step(ClockStep(at(3.0) + nanoseconds(9.0), nanoseconds(9.0)))
    after = [record for record in headings(3.0, 5.0, 2.5, nanoseconds(9.0)) if record.update.stats.dof]
    assert len(before) > 20 and len(after) > 20
    assert max(abs(record.update.heading_rad) for record in (*before, *after)) < 0.05


# --- pauses -------------------------------------------------------------------------------------


def test_a_pause_of_all_sensors_keeps_the_calibration_and_drops_the_map() -> None:
    """As when the recording is paused: a prediction over it would be worth nothing."""
    consumer = stream()
    run(consumer, 0.0, 30.0)
    before = consumer.slam.state
    after = run(consumer, 40.0, 60.0)
    events = [record.event for record in after if record.event]
    assert events == ['neither gyro nor images for 10 s; a new map was started']
    assert sum(record.block.gap_s for record in after) < 0.3, 'one block may reach into the pause'
    assert consumer.slam.state.coefficients[0] == pytest.approx(before.coefficients[0], abs=1e-3)
    error = abs(1.0 + consumer.slam.state.coefficients[0] - recording().truth.scale_factor)
    assert error < 5.0 * after[-1].std[COEFFICIENTS_START]


def test_a_pause_of_the_gyro_with_images_is_predicted() -> None:
    sync = synchroniser(1.5, 3.0, 4.5, until_s=0.0)
    sync.add(imu(0.0), 0)
    sync.add(imu(5.0), 0)
    assert sync.blind_until_ns(0, 0.0) is None
    assert synchroniser(2.5, until_s=0.0).blind_until_ns(0, 0.0) is None, 'the gyro may come back'
    sync = synchroniser(2.5, until_s=0.0)
    sync.add(imu(5.0), 0)
    assert sync.blind_until_ns(0, 0.0) == nanoseconds(2.5)


def test_images_long_after_the_gyro_are_not_used() -> None:
    """With its last rate, which lasts, it would look as if it were stuck."""
    consumer = stream()
    for item in recording().measurements():
        if not isinstance(item, ImuSample) or item.t_ns < at(10.0):
            consumer.step(item)
    assert all(record.block.end_ns < at(10.3) for record in consumer.finish())
