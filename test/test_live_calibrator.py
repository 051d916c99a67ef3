"""The live calibrator without ROS: measurements as they arrive give the same result as a replay."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from live_robot import measured, robot, source, switched_on

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    CovariateSample,
    FeatureObservations,
    ImuSample,
    Measurement,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.model_file import model_from_dict
from gyrocal_ros.ekf.noise.noise_bank import MUCH_WALK
from gyrocal_ros.files import shipped
from gyrocal_ros.msgs import clouds, topics
from gyrocal_ros.msgs.topics import BODY_FRAME, CAMERA_FRAME, IMU_FRAME, Role
from gyrocal_ros.msgs.transforms import IDENTITY, UPSIDE_DOWN, Transform
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude, load_calibration
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import with_bias_walk
from gyrocal_ros.sim.world import SimSource


@cache
def replayed() -> Calibration:
    return conclude(calibrate(source(), Config(), default_model()))


# --- the same as a replay -------------------------------------------------------------------------


@pytest.mark.slow
def test_ordered_arrival_gives_the_result_of_a_replay() -> None:
    new = switched_on()
    new.run(measured())
    new.live.close()
    live, wanted = new.live.calibration, replayed()
    np.testing.assert_allclose(live.values, wanted.values, rtol=1e-12)
    np.testing.assert_allclose(live.covariance, wanted.covariance, rtol=1e-9)
    assert live.converged and wanted.converged
    assert live.convergence_time_s == pytest.approx(wanted.convergence_time_s, abs=1e-6)


@pytest.mark.slow
def test_a_bias_that_walks_is_followed_as_in_a_replay() -> None:
    """What contradicted the filter before it expected the walk does not count, and a law may be behind it."""
    scenario = replace(find_scenario('cleaning'), duration_s=50.0, imu_hz=100, camera_hz=5)
    errors = with_bias_walk(scenario.errors, 64.0 * Config().gyro.bias_walk_deg_s, bounded_s=1e5)
    walking = SimSource(replace(scenario, errors=errors), seed=6)
    new = robot()
    new.mount(walking.rig)
    new.run(item for item in walking.measurements() if not isinstance(item, TruthSample))
    run = calibrate(walking, Config(), default_model(), follows_changes=True)
    assert run.history.bias_walk[-1] >= MUCH_WALK
    assert new.reported('the bias of the gyro walks')
    assert new.statuses[-1][1].numbers['model_fits'] == 'unknown'
    new.live.close()
    np.testing.assert_allclose(new.live.calibration.covariance, conclude(run).covariance, rtol=1e-9)


@pytest.mark.slow
def test_the_sample_bag_in_recording_order_gives_the_result_of_its_replay() -> None:
    bag, config = open_bag(shipped('bags/cleaning'), Config()), Config()
    end_ns, last_ns = bag.span.start_ns + 20 * 10**9, 0
    new = robot()
    with open_storage(shipped('bags/cleaning')) as storage:
        used = [topic for name, topic in storage.topics.items() if 'truth' not in name]
        for name, _, raw in storage.raw_messages(used):
            message, kind = storage.message(storage.topics[name], raw), storage.topics[name].type_name
            if name.endswith('tf_static'):
                new.live.transforms(topics.transforms(message))
            elif name.endswith('camera_info'):
                new.live.camera(topics.camera_intrinsics(message), message.header.frame_id, new.now_s)
            elif name.endswith('features'):
                new.run([clouds.features(message)])
            elif name.strip('/') in (Role.IMU, Role.WHEELS, Role.TEMPERATURE):
                new.run([topics.field_conversion(Role(name.strip('/')), kind).value(message)])
            last_ns = max(last_ns, topics.stamp_ns(message) if hasattr(message, 'header') else 0)
            if last_ns > end_ns:
                break
    new.live.close()
    items = [item for item in bag.measurements() if item.t_ns <= last_ns]
    wanted = conclude(calibrate(InMemorySource(bag.name, bag.rig, bag.span, items), config, default_model()))
    live = new.live.calibration
    np.testing.assert_allclose(live.values, wanted.values, rtol=0.0, atol=1e-3 * wanted.stds.min())
    np.testing.assert_allclose(live.stds, wanted.stds, rtol=1e-3)


@pytest.mark.slow
def test_delays_that_keep_the_order_of_each_stream_change_nothing() -> None:
    rng = random.Random(1)
    delay_s = {ImuSample: 0.002, WheelSample: 0.03, FeatureObservations: 0.08}
    new = switched_on()
    new.run(measured(0.0, 20.0), delay_s=lambda item: delay_s.get(type(item), 0.1) + rng.uniform(0.0, 0.005))
    new.live.close()
    in_order = switched_on()
    in_order.run(measured(0.0, 20.0))
    in_order.live.close()
    np.testing.assert_allclose(
        new.live.calibration.values, in_order.live.calibration.values, rtol=0.0, atol=1e-9
    )
    assert not any('left_out' in name for name in new.live.status(new.now_s).numbers)


@pytest.mark.slow
def test_an_effect_depends_on_its_signal() -> None:
    model = model_from_dict(
        {'name': 'fan', 'effects': ['scale_factor', 'covariate_bias:fan_speed.data']}, 'test'
    )
    new = switched_on(model=model)
    new.run(measured(0.0, 20.0))
    new.live.close()
    wanted = conclude(
        calibrate(InMemorySource('', source().rig, source().span, measured(0.0, 20.0)), Config(), model)
    )
    np.testing.assert_allclose(new.live.calibration.values, wanted.values, rtol=1e-9)
    assert not new.reported('has not been received')
    silent = switched_on(model=model)
    silent.run(item for item in measured(0.0, 4.0) if not isinstance(item, CovariateSample))
    assert silent.reported(
        'fan_speed.data has not been received yet: covariate_bias:fan_speed.data cannot be estimated'
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    'name',
    [
        'bias_curve:rate',
        'bias_curve:heading',
        'bias_map:place',
        'bias_memory:last_turn',
        'scale_memory:start',
    ],
)
def test_a_learned_effect_runs_live_as_in_a_replay(name: str) -> None:
    """Also where it follows the pose of the filter."""
    learned = {'name': name, 'low': -1.5, 'high': 1.5} if 'curve' in name else name
    model = model_from_dict({'name': 'learned', 'effects': ['scale_factor', learned]}, 'test')
    items = measured(0.0, 20.0)
    new = switched_on(model=model)
    new.run(items)
    new.live.close()
    wanted = conclude(calibrate(InMemorySource('', source().rig, source().span, items), Config(), model))
    np.testing.assert_allclose(new.live.calibration.values, wanted.values, rtol=1e-8, atol=1e-14)
    assert all(np.isfinite(sample.rate_rad_s).all() for sample in new.calibrated)


# --- mounting -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_camera_that_becomes_known_late_costs_no_accuracy() -> None:
    new = robot()
    new.live.transforms([Transform(BODY_FRAME, IMU_FRAME, IDENTITY)])
    new.run(measured(0.0, 6.0))
    assert new.reported('camera_info: no message yet')
    assert len(new.calibrated) > 500, 'the initial calibration is applied meanwhile'
    new.mount(source().rig)
    new.run(measured(6.0))
    new.live.close()
    assert abs(new.live.calibration.scale_factor - replayed().scale_factor) < replayed().scale_factor_std


@pytest.mark.slow
def test_without_transforms_the_mounting_comes_from_the_settings() -> None:
    mount, camera = source().rig.camera_mount, source().rig.camera
    assert camera is not None
    x, y, z = mount.p_bs.tolist()
    new = robot(
        config=replace(Config(), camera=replace(Config().camera, mount_x_m=x, mount_y_m=y, mount_z_m=z))
    )
    new.live.camera(camera, CAMERA_FRAME, new.now_s)
    new.run(measured())
    new.live.close()
    assert new.live.calibration.scale_factor == pytest.approx(replayed().scale_factor, abs=1e-4)
    assert new.reported(
        f'no transform from base_link to {CAMERA_FRAME}; the mounting in the settings is used'
    )


@pytest.mark.slow
@pytest.mark.parametrize('by_transform', [True, False])
def test_an_imu_mounted_upside_down(by_transform: bool) -> None:
    def turned(item: Measurement) -> Measurement:
        if not isinstance(item, ImuSample):
            return item
        (wx, wy, wz), (ax, ay, az) = item.rate_rad_s, item.specific_force_m_s2
        return ImuSample(item.t_ns, (wx, -wy, -wz), (ax, -ay, -az))

    new = robot()
    new.mount(source().rig, imu=False)
    if by_transform:
        new.live.transforms([Transform(BODY_FRAME, IMU_FRAME, replace(IDENTITY, R_bs=UPSIDE_DOWN.R_bs))])
    new.run(turned(item) for item in measured())
    new.live.close()
    np.testing.assert_allclose(new.live.calibration.values, replayed().values, rtol=1e-9)
    assert bool(new.reported('is upside down')) is not by_transform


@pytest.mark.slow
def test_another_camera_mounting_restarts_the_estimate() -> None:
    new = switched_on()
    new.run(measured(0.0, 25.0))
    assert new.live.calibration.scale_factor_std < 1e-3
    rig = source().rig
    new.live.transforms([Transform(BODY_FRAME, CAMERA_FRAME, replace(rig.camera_mount, p_bs=np.ones(3)))])
    assert new.live.calibration.scale_factor == 1.0
    new.live.work()
    assert 'has changed' in new.live.status(new.now_s).message


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stopped_estimate_is_kept_and_continued() -> None:
    new = switched_on(estimate=False)
    new.run(measured(0.0, 10.0))
    assert new.live.calibration.scale_factor == 1.0
    assert len(new.calibrated) > 900
    new.live.switch(True)
    new.run(measured(10.0, 30.0))
    stopped = new.live.calibration
    assert stopped.scale_factor_std < 1e-3
    new.live.switch(False)
    new.run(measured(30.0))
    assert new.live.calibration.scale_factor == stopped.scale_factor
    assert 'not estimating' in new.live.status(new.now_s).message


@pytest.mark.slow
def test_reset_discards_the_estimate() -> None:
    new = switched_on()
    new.run(measured(0.0, 25.0))
    new.live.reset()
    assert new.live.calibration.scale_factor == 1.0
    new.run(measured(25.0, 26.0))
    assert new.live.calibration.scale_factor_std > 1e-3


@pytest.mark.slow
def test_a_new_threshold_takes_effect_at_once() -> None:
    new = switched_on()
    new.run(measured(0.0, 25.0))
    assert new.live.calibration.converged
    strict = replace(Config(), convergence=replace(Config().convergence, scale_std=1e-7))
    new.live.configure(strict, new.live._live)
    assert not new.live.calibration.converged
    assert 'not converged yet' in new.live.status(new.now_s).message


# --- the file -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_restarted_node_continues_from_the_saved_calibration(tmp_path: Path) -> None:
    path = tmp_path / 'robot' / 'calibration.yaml'
    first = switched_on(path, save_interval_s=10.0)
    first.run(measured(0.0, 25.0))  # then the process is killed
    saved = load_calibration(path)
    assert saved.scale_factor_std < 1e-3
    second = switched_on(path)
    assert second.live.calibration.scale_factor == saved.scale_factor
    second.run(measured(25.0))
    second.live.close()
    final = load_calibration(path)
    assert final.scale_factor_std < saved.scale_factor_std
    assert abs(final.scale_factor - source().truth.scale_factor) < 3.0 * final.scale_factor_std


@pytest.mark.slow
def test_a_run_without_features_does_not_touch_the_file(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    first = switched_on(path)
    first.run(measured(0.0, 25.0))
    first.live.close()
    text = path.read_text()
    second = switched_on(path, save_interval_s=1.0)
    second.run(item for item in measured(0.0, 3.0) if not isinstance(item, FeatureObservations))
    second.live.close()
    assert path.read_text() == text
