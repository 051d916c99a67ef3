"""The calibrator as a process: it processes a recording, and other nodes receive the calibration."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from graph import Graph
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import Imu, PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.effects import default_model
from gyrocal_ros.files import shipped
from gyrocal_ros.msgs.topics import stamp_ns
from gyrocal_ros.nodes.qos import LATCHED, SENSOR_OUT, STATIC
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude, load_calibration
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.robot.odom_parent import LISTEN_S

BAG = shipped('bags/cleaning')
PLAYED_S = 30.0
IMU = 'imu/data_raw'
INPUTS = (IMU, 'wheel/odometry', 'ceiling_camera/features')
UNSUBSCRIBED = ('battery_state', 'fan_speed')
IN_FLIGHT = 50
"""Maximum number of unanswered IMU samples, so that none is lost however fast the recording is played."""


@cache
def recorded(duration_s: float) -> list[tuple[str, str, bytes]]:
    """Return topic, type and serialised message of the start of the recording, in recording order."""
    with open_storage(BAG) as storage:
        wanted = [topic for name, topic in storage.topics.items() if 'truth' not in name]
        end_ns = storage.start_ns + round(duration_s * NS_PER_S)
        types = {topic.name: topic.type_name for topic in wanted}
        return [
            (name.lstrip('/'), types[name], bytes(raw))
            for name, recorded_ns, raw in storage.raw_messages(wanted)
            if recorded_ns < end_ns
        ]


@cache
def replayed(duration_s: float) -> Calibration:
    """Return the calibration of the same part of the recording without ROS."""
    config = Config()
    bag = open_bag(BAG, config)
    end_ns = bag.span.start_ns + round(duration_s * NS_PER_S)
    start = [item for item in bag.measurements() if item.t_ns < end_ns]
    return conclude(calibrate(InMemorySource(bag.name, bag.rig, bag.span, start), config, default_model()))


def fast(**parameters: Any) -> dict[str, Any]:
    """Return the parameters of a calibrator that loses no message of a recording played fast."""
    reliable = {f'qos_overrides./{topic}.subscription.reliability': 'reliable' for topic in INPUTS}
    return {'use_sim_time': True, **reliable, **parameters}


def play(graph: Graph, duration_s: float, outputs: list[Any], others: Sequence[str] = ()) -> None:
    """Publish the start of the recording to the calibrator.

    Args:
        graph: graph of the calibrator.
        duration_s: length of the recording to publish.
        outputs: received messages of imu/data.
        others: further topics that the calibrator subscribes to.
    """
    publishers: dict[str, Publisher] = {}
    for name, type_name, _ in recorded(duration_s):
        if name not in publishers:
            topic, qos = ('/tf_static', STATIC) if name == 'tf_static' else (name, SENSOR_OUT)
            readers = 0 if name in UNSUBSCRIBED and name not in others else 1
            publishers[name] = graph.publisher(get_message(type_name), topic, qos, readers=readers)
    before_ns = [0] * IN_FLIGHT
    for name, _, raw in recorded(duration_s):
        publishers[name].publish(raw)
        if name == IMU:
            before_ns.append(stamp_ns(deserialize_message(raw, Imu)))
            wait_for_stamp(graph, outputs, before_ns.pop(0))
        elif name == 'tf_static':  # otherwise the node may process the first samples before it
            publishers[name].wait_for_all_acked()
            graph.get_parameters('calibrator', 'use_sim_time')  # the executor takes messages before requests
    wait_for_stamp(graph, outputs, before_ns[-1])


def wait_for_stamp(graph: Graph, outputs: list[Any], t_ns: int) -> None:
    """Wait for the output with this stamp; before the transforms are received there is none."""
    if outputs:
        graph.wait(lambda: stamp_ns(outputs[-1]) >= t_ns, 'the calibrated samples')
    else:
        graph.spin(0.01)


def values_of(event: ParameterEvent) -> dict[str, Any]:
    """Return the parameters of an event by name."""
    return {item.name: parameter_value_to_python(item.value) for item in event.changed_parameters}


def messages(health: list[DiagnosticArray]) -> list[str]:
    """Return all messages of the diagnostics."""
    return [status.message for array in health for status in array.status]


@dataclass
class Played:
    """A calibrator that has processed the start of the recording, and its outputs."""

    graph: Graph
    path: Path
    imu: list[Imu]
    odometry: list[Odometry]
    regions: list[PointCloud2]
    maps: list[MarkerArray]
    transforms: list[TFMessage]
    events: list[ParameterEvent]
    health: list[DiagnosticArray]


@pytest.fixture(scope='module')
def played(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Played]:
    path = tmp_path_factory.mktemp('saved') / 'calibration.yaml'
    with Graph() as graph:
        graph.start('calibrator', parameters=fast(**{'live.calibration': str(path)}))
        outputs = Played(
            graph,
            path,
            graph.listen(Imu, 'imu/data'),
            graph.listen(Odometry, 'odometry/slam'),
            graph.listen(PointCloud2, 'ceiling_camera/search_regions'),
            graph.listen(MarkerArray, 'ceiling_map'),
            graph.listen(TFMessage, '/tf'),
            graph.listen(ParameterEvent, '/parameter_events'),
            graph.listen(DiagnosticArray, '/diagnostics'),
        )
        began_s = time.monotonic()
        graph.wait(lambda: time.monotonic() - began_s > LISTEN_S, 'the end of listening for parents of odom')
        play(graph, PLAYED_S, outputs.imu)
        yield outputs


def latest(graph: Graph) -> dict[str, Any]:
    """Return what a late subscriber of the calibration receives at once."""
    events: list[ParameterEvent] = graph.listen(ParameterEvent, 'gyro_calibration', LATCHED)
    graph.wait(lambda: events, 'the calibration')
    return values_of(events[-1])


class TestAfterARecording:
    def test_a_late_subscriber_receives_the_calibration(self, played: Played) -> None:
        wanted = replayed(PLAYED_S)

        def final() -> dict[str, Any] | None:
            values = latest(played.graph)
            near = abs(values['gyro.scale_factor'] - wanted.scale_factor) < wanted.scale_factor_std
            return values if near else None

        values = played.graph.wait(final, 'the calibration at the end')
        assert values['gyro.converged'] is True
        assert values['gyro.coefficient_names'] == ['scale_factor']
        assert values['gyro.scale_factor_std'] == pytest.approx(wanted.scale_factor_std, rel=0.1)

    def test_the_parameters_have_the_same_values(self, played: Played) -> None:
        names = ('gyro.scale_factor', 'gyro.bias', 'gyro.model')
        published = latest(played.graph)
        values = played.graph.get_parameters('calibrator', *names)
        assert dict(zip(names, values, strict=True)) == {name: published[name] for name in names}

    def test_parameter_event_handlers_receive_it(self, played: Played) -> None:
        def event() -> list[dict[str, Any]]:
            own = [values_of(item) for item in played.events if item.node == '/calibrator']
            return [item for item in own if 'gyro.scale_factor' in item]

        changes = played.graph.wait(event, 'a parameter event')
        assert changes[-1]['gyro.scale_factor'] != 1.0

    def test_other_nodes_cannot_set_it(self, played: Played) -> None:
        result = played.graph.set_parameter('calibrator', 'gyro.scale_factor', 1.0)
        assert not result.successful
        assert 'estimated by this node' in result.reason

    def test_every_sample_was_calibrated(self, played: Played) -> None:
        raw = [deserialize_message(raw, Imu) for name, _, raw in recorded(PLAYED_S) if name == IMU]
        missing = {stamp_ns(item) for item in raw} - {stamp_ns(item) for item in played.imu}
        assert missing <= {stamp_ns(item) for item in raw[:IN_FLIGHT]}, 'except those before the transforms'
        last = played.imu[-1]
        assert last.header.frame_id == 'base_link'
        for covariance in (last.orientation_covariance, last.angular_velocity_covariance):
            assert np.linalg.eigvalsh(np.array(covariance).reshape(3, 3)).min() > 0.0

    def test_the_pose_is_published(self, played: Played) -> None:
        last = played.odometry[-1]
        assert (last.header.frame_id, last.child_frame_id) == ('map', 'base_link')
        assert np.linalg.eigvalsh(np.array(last.pose.covariance).reshape(6, 6)).min() > -1e-12
        assert played.regions[-1].width > 0

    def test_the_map_is_published(self, played: Played) -> None:
        latest_map = played.graph.wait(lambda: played.maps, 'the map')[-1]
        assert {marker.header.frame_id for marker in latest_map.markers} == {'map'}
        assert len({marker.id for marker in latest_map.markers}) == len(latest_map.markers) > 10

    def test_only_map_to_odom_is_published(self, played: Played) -> None:
        links = {
            (link.header.frame_id, link.child_frame_id)
            for message in played.transforms
            for link in message.transforms
        }
        assert links == {('map', 'odom')}

    def test_a_setting_takes_effect_at_run_time(self, played: Played) -> None:
        assert played.graph.set_parameter('calibrator', 'convergence.scale_std', 1e-7).successful
        played.graph.wait(lambda: not latest(played.graph)['gyro.converged'], 'the new threshold')
        assert played.graph.set_parameter('calibrator', 'convergence.scale_std', 5e-4).successful

    @pytest.mark.parametrize(
        ('name', 'value', 'reason'),
        [
            ('convergence.scale_std', -1.0, 'convergence.scale_std'),
            ('convergence.scale_std', 'small', 'type'),
            ('live.model', 'other.yaml', 'read-only'),
        ],
    )
    def test_invalid_settings_are_refused(self, played: Played, name: str, value: Any, reason: str) -> None:
        result = played.graph.set_parameter('calibrator', name, value)
        assert not result.successful
        assert reason in result.reason

    def test_a_silent_imu_is_reported(self, played: Played) -> None:
        silent = 'imu/data_raw: no message for'
        played.graph.wait(
            lambda: any(silent in message for message in messages(played.health)),
            'the report of the silent IMU',
        )

    def test_the_saved_calibration_is_that_of_the_replay(self, played: Played) -> None:
        assert played.graph.processes[0].stop() == 0
        live, wanted = load_calibration(played.path), replayed(PLAYED_S)
        assert live.converged
        np.testing.assert_array_less(np.abs(live.values - wanted.values), 0.1 * wanted.stds)
        np.testing.assert_allclose(live.stds, wanted.stds, rtol=0.05)


class TestSaving:
    def test_a_killed_node_continues_from_the_saved_calibration(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        parameters = fast(**{'live.calibration': str(path)})
        with Graph() as graph:
            outputs = graph.listen(Imu, 'imu/data')
            first = graph.start('calibrator', parameters=parameters)
            play(graph, 12.0, outputs)
            assert graph.trigger('calibrator/save').success
            first.stop(signal.SIGKILL)
            saved = load_calibration(path)
            graph.start('calibrator', parameters=parameters)
            assert graph.wait(
                lambda: latest(graph)['gyro.scale_factor'] == saved.scale_factor, 'the saved calibration'
            )

    def test_a_reset_calibration_is_not_loaded_again(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        with Graph() as graph:
            outputs = graph.listen(Imu, 'imu/data')
            node = graph.start('calibrator', parameters=fast(**{'live.calibration': str(path)}))
            play(graph, 12.0, outputs)
            graph.trigger('calibrator/save')
            assert '.old' in graph.trigger('calibrator/reset').message
            graph.wait(lambda: latest(graph)['gyro.scale_factor'] == 1.0, 'the priors')
            assert node.stop(signal.SIGINT) == 0
        assert not path.exists()

    def test_without_estimation_nothing_is_saved(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        with Graph() as graph:
            outputs = graph.listen(Imu, 'imu/data')
            node = graph.start(
                'calibrator', parameters=fast(**{'live.calibration': str(path), 'live.estimate': False})
            )
            play(graph, 5.0, outputs)
            assert latest(graph)['gyro.scale_factor'] == 1.0
            assert graph.switch('calibrator/estimate', True).success
            assert node.stop() == 0
        assert not path.exists()


class TestOtherNodes:
    def test_no_second_parent_of_odom_is_published(self) -> None:
        with Graph() as graph:
            outputs, transforms = graph.listen(Imu, 'imu/data'), graph.listen(TFMessage, '/tf')
            health = graph.listen(DiagnosticArray, '/diagnostics')
            other = graph.publisher(TFMessage, '/tf_static', STATIC, readers=0)
            link = TransformStamped(child_frame_id='odom')
            link.header.frame_id = 'world'
            other.publish(TFMessage(transforms=[link]))
            graph.start('calibrator', parameters=fast())
            play(graph, 5.0, outputs)
            problem = 'another node publishes the transform from world to odom'
            graph.wait(lambda: any(problem in message for message in messages(health)), 'the report')
            assert not transforms

    def test_an_effect_depends_on_a_signal_of_another_topic(self, tmp_path: Path) -> None:
        model = tmp_path / 'model.yaml'
        model.write_text('effects: [scale_factor, "covariate_bias:fan_speed.data"]')
        with Graph() as graph:
            outputs = graph.listen(Imu, 'imu/data')
            graph.start('calibrator', parameters=fast(**{'live.model': str(model)}))
            before = latest(graph)
            assert before['gyro.coefficient_names'] == ['scale_factor', 'covariate_bias:fan_speed.data']
            play(graph, 12.0, outputs, others=('fan_speed',))
            graph.wait(
                lambda: latest(graph)['gyro.coefficient_stds'][1] < before['gyro.coefficient_stds'][1],
                'an estimate of the effect of the fan',
            )


class TestStart:
    @pytest.mark.parametrize('name', ['live.model', 'live.effects_from'])
    def test_a_missing_file_is_reported_in_one_line(self, tmp_path: Path, name: str) -> None:
        with Graph() as graph:
            node = graph.start('calibrator', parameters={name: str(tmp_path / 'none')})
            graph.wait(lambda: node.status is not None, 'the end of the node')
            assert node.status == 2
            assert len(node.output.splitlines()) == 1
            assert str(tmp_path / 'none') in node.output

    def test_two_robots_are_separate(self) -> None:
        with Graph(namespace='robot1') as graph:
            one, other = graph.listen(Imu, 'imu/data'), graph.listen(Imu, '/robot2/imu/data')
            for robot in ('robot1', 'robot2'):
                graph.start(
                    'calibrator',
                    namespace=robot,
                    parameters=fast(
                        **{
                            f'qos_overrides./{robot}/{topic}.subscription.reliability': 'reliable'
                            for topic in INPUTS
                        }
                    ),
                )
            other_events = graph.listen(ParameterEvent, '/robot2/gyro_calibration', LATCHED)
            graph.wait(lambda: other_events, 'the calibration of the other robot')
            play(graph, 12.0, one)
            graph.wait(
                lambda: latest(graph)['gyro.scale_factor'] != 1.0, 'the calibration of the first robot'
            )
            assert not other
            assert values_of(other_events[-1])['gyro.scale_factor'] == 1.0
