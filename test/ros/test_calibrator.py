"""The calibrator as a process: a recording goes through it, and others see what it has found."""

from __future__ import annotations

import signal
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

BAG = shipped('bags/cleaning')
PLAYED_S = 30.0
IMU = 'imu/data_raw'
INPUTS = (IMU, 'wheel/odometry', 'ceiling_camera/features')
UNHEARD = ('battery_state', 'fan_speed')
AHEAD = 50
"""So many IMU samples may be on their way: then nothing is lost, however fast a recording is played."""


@cache
def recorded(duration_s: float) -> list[tuple[str, str, bytes]]:
    """Topic, type and serialised message of the start of the recording, in the order of recording."""
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
    """What the same part of the recording tells without ROS."""
    config = Config()
    bag = open_bag(BAG, config)
    end_ns = bag.span.start_ns + round(duration_s * NS_PER_S)
    start = [item for item in bag.measurements() if item.t_ns < end_ns]
    return conclude(calibrate(InMemorySource(bag.name, bag.rig, bag.span, start), config, default_model()))


def fast(**parameters: Any) -> dict[str, Any]:
    """Parameters of a calibrator that hears a recording faster than it was made, and misses nothing."""
    reliable = {f'qos_overrides./{topic}.subscription.reliability': 'reliable' for topic in INPUTS}
    return {'use_sim_time': True, **reliable, **parameters}


def play(graph: Graph, duration_s: float, answers: list[Any], others: Sequence[str] = ()) -> None:
    """Let the calibrator hear the start of the recording.

    Args:
        graph: where the calibrator is.
        duration_s: how much of the recording.
        answers: where the imu/data that it answers with gather.
        others: topics that it follows beside its usual ones.
    """
    publishers: dict[str, Publisher] = {}
    for name, type_name, _ in recorded(duration_s):
        if name not in publishers:
            topic, qos = ('/tf_static', STATIC) if name == 'tf_static' else (name, SENSOR_OUT)
            readers = 0 if name in UNHEARD and name not in others else 1
            publishers[name] = graph.publisher(get_message(type_name), topic, qos, readers=readers)
    before_ns = [0] * AHEAD
    for name, _, raw in recorded(duration_s):
        publishers[name].publish(raw)
        if name == IMU:
            before_ns.append(stamp_ns(deserialize_message(raw, Imu)))
            wait_for_stamp(graph, answers, before_ns.pop(0))
        elif name == 'tf_static':  # else the node may take the first samples before it
            publishers[name].wait_for_all_acked()
    wait_for_stamp(graph, answers, before_ns[-1])


def wait_for_stamp(graph: Graph, answers: list[Any], t_ns: int) -> None:
    """Wait until what was measured then has been answered; until the transforms are heard, nothing is."""
    if answers:
        graph.wait(lambda: stamp_ns(answers[-1]) >= t_ns, 'the calibrated samples')
    else:
        graph.spin(0.01)


def values_of(event: ParameterEvent) -> dict[str, Any]:
    """The parameters of an event by name."""
    return {item.name: parameter_value_to_python(item.value) for item in event.changed_parameters}


def said(health: list[DiagnosticArray]) -> list[str]:
    """All that was told of the health."""
    return [status.message for array in health for status in array.status]


@dataclass
class Played:
    """A calibrator that has heard the start of the recording, and what it said."""

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
    path = tmp_path_factory.mktemp('kept') / 'calibration.yaml'
    with Graph() as graph:
        graph.start('calibrator', parameters=fast(**{'live.calibration': str(path)}))
        all_said = Played(
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
        play(graph, PLAYED_S, all_said.imu)
        yield all_said


def latest(graph: Graph) -> dict[str, Any]:
    """What a late subscriber of the calibration is told at once."""
    told: list[ParameterEvent] = graph.listen(ParameterEvent, 'gyro_calibration', LATCHED)
    graph.wait(lambda: told, 'the calibration')
    return values_of(told[-1])


class TestAfterARecording:
    def test_a_late_subscriber_is_told_the_calibration(self, played: Played) -> None:
        wanted = replayed(PLAYED_S)

        def is_told() -> dict[str, Any] | None:
            told = latest(played.graph)
            near = abs(told['gyro.scale_factor'] - wanted.scale_factor) < wanted.scale_factor_std
            return told if near else None

        told = played.graph.wait(is_told, 'the calibration at the end')
        assert told['gyro.converged'] is True
        assert told['gyro.coefficient_names'] == ['scale_factor']
        assert told['gyro.scale_factor_std'] == pytest.approx(wanted.scale_factor_std, rel=0.1)

    def test_its_parameters_tell_the_same(self, played: Played) -> None:
        names = ('gyro.scale_factor', 'gyro.bias', 'gyro.model')
        told = latest(played.graph)
        values = played.graph.get_parameters('calibrator', *names)
        assert dict(zip(names, values, strict=True)) == {name: told[name] for name in names}

    def test_parameter_event_handlers_see_it(self, played: Played) -> None:
        def event() -> list[dict[str, Any]]:
            own = [values_of(item) for item in played.events if item.node == '/calibrator']
            return [item for item in own if 'gyro.scale_factor' in item]

        changes = played.graph.wait(event, 'a parameter event')
        assert changes[-1]['gyro.scale_factor'] != 1.0

    def test_others_cannot_set_it(self, played: Played) -> None:
        result = played.graph.set_parameter('calibrator', 'gyro.scale_factor', 1.0)
        assert not result.successful
        assert 'estimated by this node' in result.reason

    def test_every_sample_was_calibrated(self, played: Played) -> None:
        raw = [deserialize_message(raw, Imu) for name, _, raw in recorded(PLAYED_S) if name == IMU]
        missing = {stamp_ns(item) for item in raw} - {stamp_ns(item) for item in played.imu}
        assert missing <= {stamp_ns(item) for item in raw[:AHEAD]}, 'but for those before the transforms'
        last = played.imu[-1]
        assert last.header.frame_id == 'base_link'
        for covariance in (last.orientation_covariance, last.angular_velocity_covariance):
            assert np.linalg.eigvalsh(np.array(covariance).reshape(3, 3)).min() > 0.0

    def test_it_tells_where_the_robot_is(self, played: Played) -> None:
        last = played.odometry[-1]
        assert (last.header.frame_id, last.child_frame_id) == ('map', 'base_link')
        assert np.linalg.eigvalsh(np.array(last.pose.covariance).reshape(6, 6)).min() > -1e-12
        assert played.regions[-1].width > 0

    def test_the_map_is_shown(self, played: Played) -> None:
        shown = played.graph.wait(lambda: played.maps, 'the map')[-1]
        assert {marker.header.frame_id for marker in shown.markers} == {'map'}
        assert len({marker.id for marker in shown.markers}) == len(shown.markers) > 10

    def test_only_odom_is_given_a_parent(self, played: Played) -> None:
        links = {
            (link.header.frame_id, link.child_frame_id)
            for message in played.transforms
            for link in message.transforms
        }
        assert links == {('map', 'odom')}

    def test_a_setting_takes_effect_while_it_runs(self, played: Played) -> None:
        assert played.graph.set_parameter('calibrator', 'convergence.scale_std', 1e-7).successful
        played.graph.wait(lambda: not latest(played.graph)['gyro.converged'], 'the new threshold')
        assert played.graph.set_parameter('calibrator', 'convergence.scale_std', 5e-4).successful

    @pytest.mark.parametrize(
        ('name', 'value', 'why'),
        [
            ('convergence.scale_std', -1.0, 'convergence.scale_std'),
            ('convergence.scale_std', 'small', 'type'),
            ('live.model', 'other.yaml', 'read-only'),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, played: Played, name: str, value: Any, why: str) -> None:
        result = played.graph.set_parameter('calibrator', name, value)
        assert not result.successful
        assert why in result.reason

    def test_its_health_is_told_in_sentences(self, played: Played) -> None:
        silent = 'imu/data_raw: nothing for'
        played.graph.wait(
            lambda: any(silent in message for message in said(played.health)), 'the silence of the IMU told'
        )

    def test_its_end_is_that_of_the_replay(self, played: Played) -> None:
        assert played.graph.processes[0].stop() == 0
        live, wanted = load_calibration(played.path), replayed(PLAYED_S)
        assert live.converged
        np.testing.assert_array_less(np.abs(live.values - wanted.values), 0.1 * wanted.stds)
        np.testing.assert_allclose(live.stds, wanted.stds, rtol=0.05)


class TestKeeping:
    def test_a_killed_node_goes_on_with_what_was_saved(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        parameters = fast(**{'live.calibration': str(path)})
        with Graph() as graph:
            answers = graph.listen(Imu, 'imu/data')
            first = graph.start('calibrator', parameters=parameters)
            play(graph, 12.0, answers)
            assert graph.trigger('calibrator/save').success
            first.stop(signal.SIGKILL)
            kept = load_calibration(path)
            graph.start('calibrator', parameters=parameters)
            assert graph.wait(
                lambda: latest(graph)['gyro.scale_factor'] == kept.scale_factor, 'the saved calibration'
            )

    def test_what_is_forgotten_is_not_found_again(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        with Graph() as graph:
            answers = graph.listen(Imu, 'imu/data')
            node = graph.start('calibrator', parameters=fast(**{'live.calibration': str(path)}))
            play(graph, 12.0, answers)
            graph.trigger('calibrator/save')
            assert '.old' in graph.trigger('calibrator/reset').message
            graph.wait(lambda: latest(graph)['gyro.scale_factor'] == 1.0, 'the priors')
            assert node.stop(signal.SIGINT) == 0
        assert not path.exists()

    def test_stopped_it_learns_nothing(self, tmp_path: Path) -> None:
        path = tmp_path / 'calibration.yaml'
        with Graph() as graph:
            answers = graph.listen(Imu, 'imu/data')
            node = graph.start(
                'calibrator', parameters=fast(**{'live.calibration': str(path), 'live.estimate': False})
            )
            play(graph, 5.0, answers)
            assert latest(graph)['gyro.scale_factor'] == 1.0
            assert graph.switch('calibrator/estimate', True).success
            assert node.stop() == 0
        assert not path.exists()


class TestOthers:
    def test_odom_gets_no_second_parent(self) -> None:
        with Graph() as graph:
            answers, transforms = graph.listen(Imu, 'imu/data'), graph.listen(TFMessage, '/tf')
            health = graph.listen(DiagnosticArray, '/diagnostics')
            other = graph.publisher(TFMessage, '/tf_static', STATIC, readers=0)
            link = TransformStamped(child_frame_id='odom')
            link.header.frame_id = 'world'
            other.publish(TFMessage(transforms=[link]))
            graph.start('calibrator', parameters=fast())
            play(graph, 5.0, answers)
            told = 'somebody else publishes the transform from world to odom'
            graph.wait(lambda: any(told in message for message in said(health)), 'the complaint')
            assert not transforms

    def test_an_effect_follows_a_number_of_another_topic(self, tmp_path: Path) -> None:
        model = tmp_path / 'model.yaml'
        model.write_text('effects: [scale_factor, "covariate_bias:fan_speed.data"]')
        with Graph() as graph:
            answers = graph.listen(Imu, 'imu/data')
            graph.start('calibrator', parameters=fast(**{'live.model': str(model)}))
            before = latest(graph)
            assert before['gyro.coefficient_names'] == ['scale_factor', 'covariate_bias:fan_speed.data']
            play(graph, 12.0, answers, others=('fan_speed',))
            graph.wait(
                lambda: latest(graph)['gyro.coefficient_stds'][1] < before['gyro.coefficient_stds'][1],
                'something learned of the fan',
            )


class TestStart:
    @pytest.mark.parametrize('name', ['live.model', 'live.effects_from'])
    def test_a_file_that_is_not_there_is_told_in_one_line(self, tmp_path: Path, name: str) -> None:
        with Graph() as graph:
            node = graph.start('calibrator', parameters={name: str(tmp_path / 'none')})
            graph.wait(lambda: node.status is not None, 'its end')
            assert node.status == 2
            assert len(node.said.splitlines()) == 1
            assert str(tmp_path / 'none') in node.said

    def test_two_robots_do_not_mix(self) -> None:
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
            other_told = graph.listen(ParameterEvent, '/robot2/gyro_calibration', LATCHED)
            graph.wait(lambda: other_told, 'the other robot')
            play(graph, 12.0, one)
            graph.wait(lambda: latest(graph)['gyro.scale_factor'] != 1.0, 'the calibration of the one')
            assert not other
            assert values_of(other_told[-1])['gyro.scale_factor'] == 1.0
