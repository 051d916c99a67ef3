"""Faults on a robot: each is reported while it lasts, and the calibration survives it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_robot import START_S, measured, robot, source, switched_on
from recordings import at, random_pixels, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    FeatureObservations,
    ImuSample,
    Measurement,
    MotionBlock,
    WheelSample,
    seconds,
)
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.slam import Seen
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibration import Calibration, load_calibration, save_calibration
from gyrocal_ros.robot.health import Level
from gyrocal_ros.sim.world import START_NS


@pytest.mark.slow
def test_a_covered_camera_is_reported_and_the_last_calibration_is_kept() -> None:
    def covered(item: Measurement) -> Measurement:
        if isinstance(item, FeatureObservations) and item.t_ns > at(25.0):
            return FeatureObservations(item.t_ns, item.ids[:0], item.pixels[:0])
        return item

    new = switched_on()
    new.run(covered(item) for item in measured())
    reported_s = new.reported('no features in the images for')
    assert reported_s[0] == pytest.approx(27.0, abs=1.1)
    assert reported_s[-1] > 38.0
    calibration = new.live.calibration
    assert calibration.converged
    assert abs(calibration.scale_factor - source().truth.scale_factor) < 4.0 * calibration.scale_factor_std


def test_silent_sensors_are_named_while_they_are_silent() -> None:
    new = switched_on()
    new.run(
        item
        for item in measured(0.0, 12.0)
        if not (isinstance(item, ImuSample) and 5e9 < item.t_ns - START_NS < 9e9)
    )
    silent_s = {round(at_s) for at_s in new.reported('imu/data_raw: no message for')}
    assert {6, 7, 8} <= silent_s <= {6, 7, 8, 9}
    assert new.reported('imu/data_raw: gap of 4.0 s')
    assert max(status.level for at_s, status in new.statuses if at_s < 5) < Level.ERROR


def test_a_second_imu_on_the_topic_is_reported_and_left_out() -> None:
    alone, both = switched_on(), switched_on()
    alone.run(measured(0.0, 12.0))
    for item in measured(0.0, 12.0):
        both.run([item])
        if isinstance(item, ImuSample):
            x, y, z = item.rate_rad_s
            second = replace(item, t_ns=item.t_ns + 1_000_000, rate_rad_s=(x, y, 2.0 * z))
            assert both.live.imu(second, 'imu_two', both.now_s) is None
    assert both.live.calibration.scale_factor == alone.live.calibration.scale_factor != 1.0
    assert len(both.calibrated) == len(alone.calibrated) > 0
    assert both.reported('another IMU on the same topic') and not alone.reported('another IMU')


def test_an_imu_whose_frame_was_renamed_is_taken_up_again() -> None:
    new = switched_on()
    new.run(measured(0.0, 5.0))
    count = len(new.calibrated)
    later = [item for item in measured(7.0, 12.0) if isinstance(item, ImuSample)]
    samples = [new.live.imu(item, 'imu_two', START_S + 7.0) for item in later]
    assert None not in samples and count > 0


def test_missing_sensors_are_named() -> None:
    new = robot()
    message = new.live.status(START_S + 3.0).message
    for topic in ('imu/data_raw', 'wheel/odometry', 'ceiling_camera/features', 'ceiling_camera/camera_info'):
        assert f'{topic}: no message yet' in message


@pytest.mark.slow
@pytest.mark.parametrize('step_s', [2.0, -2.0])
def test_a_clock_step_is_reported_and_the_calibration_is_kept(step_s: float) -> None:
    new = switched_on()
    new.run(measured(0.0, 25.0))
    before = new.live.calibration
    new.run(measured(25.0), step_s=step_s)
    new.live.close()
    assert new.reported(f'the clock jumped by {step_s:+.1f} s')
    assert max(new.reported('the clock jumped')) < 25.0 + 13.0
    after = new.live.calibration
    assert after.scale_factor_std < before.scale_factor_std
    assert abs(after.scale_factor - source().truth.scale_factor) < 3.0 * after.scale_factor_std
    assert not any('left_out' in name for name in new.live.status(new.now_s).numbers)
    gaps_s = [
        abs(seconds(b.t_ns - a.t_ns)) for a, b in zip(new.calibrated[:-1], new.calibrated[1:], strict=True)
    ]
    assert sum(gap_s > 0.1 for gap_s in gaps_s) == 1, 'all samples were calibrated at once'


@pytest.mark.slow
def test_simulated_time_may_run_at_any_speed() -> None:
    new = switched_on(steady=False)
    new.run(measured(0.0, 15.0), delay_s=lambda item: -0.9 * seconds(item.t_ns - START_NS))
    assert not new.reported('the clock jumped')
    assert new.live.calibration.scale_factor != 1.0


def test_readings_without_finite_values_are_dropped_and_reported() -> None:
    def corrupted(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample) and item.t_ns // 10**7 % 7 == 0:
            return replace(item, rate_rad_s=(math.nan, 0.0, 0.0))
        if isinstance(item, WheelSample) and item.t_ns // 10**7 % 5 == 0:
            return replace(item, speed_m_s=math.inf)
        return item

    new = switched_on()
    new.run(corrupted(item) for item in measured(0.0, 8.0))
    assert new.reported('cannot be used: the values are impossible (NaN, or far too large)')
    assert all(math.isfinite(value) for sample in new.calibrated for value in sample.rate_rad_s)


@pytest.mark.slow
def test_contradicting_images_do_not_change_the_calibration() -> None:
    new = switched_on()
    new.run(measured(0.0, 30.0, 10))
    before = new.live.calibration
    new.run(
        random_pixels(item) if isinstance(item, FeatureObservations) else item
        for item in measured(30.0, camera_hz=10)
    )
    after = new.live.calibration
    assert before.converged and not after.converged
    assert new.reported('the images contradict the filter') or new.reported('is not trusted yet')
    assert after.scale_factor_std < 1e-3
    assert abs(after.scale_factor - before.scale_factor) < 3.0 * after.scale_factor_std


def test_messages_that_arrive_too_late_are_reported_by_topic() -> None:
    new = switched_on()
    new.run(measured(0.0, 12.0), delay_s=lambda item: 1.5 if isinstance(item, FeatureObservations) else 0.0)
    late = re.compile(r'ceiling_camera/features: \d+ messages in 10 s came more than 0.6 s late')
    assert [at_s for at_s, status in new.statuses if late.search(status.message)][-1] > 11.0
    assert not new.reported('imu/data_raw: gap')


@pytest.mark.slow
def test_a_diverged_filter_is_restarted_with_the_last_good_calibration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    new = switched_on()
    new.run(measured(0.0, 32.0))
    before = new.live.calibration
    assert new.live.filter is not None

    def diverge(block: MotionBlock, seen: Seen | None = None) -> StepRecord:
        raise FilterDivergedError('the images do not match the map')

    monkeypatch.setattr(new.live.filter, 'step', diverge)
    new.run(measured(32.0))
    after, status = new.live.calibration, new.live.status(new.now_s)
    assert status.numbers['filter_restarts'] == 1
    assert 'the filter diverged and was restarted' in status.message
    assert 'is not trusted yet' in status.message
    assert not after.converged, 'not yet consistent for long enough'
    assert abs(after.scale_factor - before.scale_factor) < 3.0 * after.scale_factor_std < 1e-3
    yaws = [estimate.euler_rad[2] for estimate in new.odometry]
    assert np.abs(np.diff(yaws)).max() < 0.1, 'the pose does not jump'


@pytest.mark.slow
def test_a_slow_camera_does_not_restart_the_filter_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a restart, 4 images a second need 75 s until the filter is trusted again."""
    new = switched_on()
    assert new.live.filter is not None

    def diverge(block: MotionBlock, seen: Seen | None = None) -> StepRecord:
        raise FilterDivergedError('the images do not match the map')

    new.run(measured(0.0, 2.0))
    monkeypatch.setattr(new.live.filter, 'step', diverge)
    slow = recording('cleaning', 1, 115.0, camera_hz=4)
    new.run(item for item in slow.measurements() if item.t_ns >= at(2.0))
    status = new.live.status(new.now_s)
    assert status.numbers['filter_restarts'] == 1
    assert max(new.reported('is not trusted yet')) < 85.0
    found = new.live.calibration
    assert found.converged
    assert abs(found.scale_factor - slow.truth.scale_factor) < 3.0 * found.scale_factor_std


@cache
def right_calibration() -> Calibration:
    """Return what a robot has calibrated from 10 images a second."""
    first = switched_on()
    first.run(measured(camera_hz=10))
    return first.live.calibration


@pytest.mark.slow
@pytest.mark.parametrize('wrong_by', [-0.01, 0.002, 0.05])
def test_a_wrong_stored_calibration_is_dropped_and_replaced(tmp_path: Path, wrong_by: float) -> None:
    path = tmp_path / 'calibration.yaml'
    right = right_calibration()
    save_calibration(replace(right, values=right.values + [0.0, wrong_by]), Config(), path)
    new = switched_on(path)
    new.run(measured(camera_hz=10))
    new.live.close()
    assert len(new.reported('off what was calibrated before')) > 0
    true = source().truth.scale_factor
    for found in (new.live.calibration, load_calibration(path)):
        assert found.converged
        assert abs(found.scale_factor - true) < 3.0 * found.scale_factor_std


@pytest.mark.slow
def test_a_jump_of_the_scale_factor_is_followed_without_a_restart() -> None:
    def changed(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample) and item.t_ns > at(40.0):
            x, y, z = item.rate_rad_s
            return replace(item, rate_rad_s=(x, y, 1.05 * z))
        return item

    new, longer = switched_on(), recording('cleaning', 1, 80.0)
    new.run(changed(item) for item in longer.measurements())
    found, status = new.live.calibration, new.live.status(new.now_s)
    assert status.numbers['filter_restarts'] == 0
    names = ('recent_nis', 'pixel_noise_px', 'wheel_noise_m', 'map_size')
    assert all(float(str(status.numbers[name])) > 0.0 for name in names), 'the names of the documentation'
    assert status.numbers['stamp_noise_s'] == 0.0
    assert found.converged
    assert abs(found.scale_factor - longer.truth.scale_factor / 1.05) < 3.0 * found.scale_factor_std


@pytest.mark.slow
def test_an_inverted_gyro_is_named_and_its_calibration_not_used() -> None:
    def inverted(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample):
            x, y, z = item.rate_rad_s
            return replace(item, rate_rad_s=(x, y, -z))
        return item

    new = switched_on()
    new.run(inverted(item) for item in measured())
    assert new.reported('the gyro turns opposite to wheels and images')
    assert new.live.status(new.now_s).numbers['filter_restarts'] == 0
    assert not new.live.calibration.converged
    assert new.live.calibration.scale_factor > 0.5


# --- memory ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('silent', [ImuSample, WheelSample, FeatureObservations])
def test_memory_is_bounded_whichever_sensor_is_silent(silent: type[Any]) -> None:
    new = switched_on()
    new.run(item for item in measured(0.0, 20.0) if not isinstance(item, silent))
    before = size_of(new.live)
    new.run(item for item in measured(20.0) if not isinstance(item, silent))
    assert size_of(new.live) < 1.2 * before + 500


def size_of(root: object) -> int:
    """Count the items of all containers that can be reached from an object; an array counts once."""
    seen: set[int] = set()
    todo, count = [root], 0
    while todo:
        item = todo.pop()
        if id(item) in seen or isinstance(item, type | str | bytes | np.ndarray):
            continue
        seen.add(id(item))
        if isinstance(item, dict):
            count, todo = count + len(item), [*todo, *item.values()]
        elif hasattr(item, '__len__') and hasattr(item, '__iter__'):
            children = list(item)
            count, todo = count + len(children), todo + children
        else:
            names = [*getattr(item, '__dict__', {}), *getattr(type(item), '__slots__', ())]
            todo += [getattr(item, name) for name in names if hasattr(item, name)]
    return count
