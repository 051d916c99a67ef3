"""The player as a process: it publishes a recording with the time of the recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph import Graph
from nav_msgs.msg import Odometry
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from small_bags import RIG, START_NS, drive
from tf2_msgs.msg import TFMessage

from gyrocal_ros.bag.pacing import MAX_UNANSWERED
from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.data import FeatureObservations, ImuSample
from gyrocal_ros.msgs import topics
from gyrocal_ros.nodes.qos import SENSOR_OUT, STATIC

LENGTH_S = 3.0


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('bags') / 'bag'
    with new_bag(path, namespace='robot1') as writer:
        writer.write_rig(RIG, START_NS, np.eye(3))
        for sample in drive(LENGTH_S):
            writer.write(sample)
    return path


@pytest.fixture
def graph() -> Iterator[Graph]:
    with Graph() as graph:
        yield graph


def listen(graph: Graph, namespace: str = '') -> dict[str, list[Any]]:
    """Subscribe to some of the played topics."""
    before = f'/{namespace}/' if namespace else ''
    kinds = {'imu/data_raw': Imu, 'ceiling_camera/features': PointCloud2, 'wheel/odometry': Odometry}
    return {name: graph.listen(kind, f'{before}{name}') for name, kind in kinds.items()}


def test_all_messages_are_played_and_then_the_node_ends(graph: Graph, bag: Path) -> None:
    received, clock = listen(graph), graph.listen(Clock, '/clock')
    infos = graph.listen(CameraInfo, 'ceiling_camera/camera_info')
    player = graph.start('player', parameters={'player.bag': str(bag), 'player.wait_for': 'test'})
    player.may_end = True
    graph.wait(lambda: player.status is not None, 'the end of the node')
    graph.spin()
    assert player.status == 0
    samples = [sample for sample in drive(LENGTH_S) if isinstance(sample, ImuSample)]
    assert [topics.IMU_SAMPLE.value(message) for message in received['imu/data_raw']] == samples
    images = [item for item in drive(LENGTH_S) if isinstance(item, FeatureObservations)]
    assert [topics.stamp_ns(message) for message in received['ceiling_camera/features']] == [
        i.t_ns for i in images
    ]
    times_ns = [Time.from_msg(message.clock).nanoseconds for message in clock]
    assert times_ns == sorted(times_ns) and len(times_ns) > 20 * LENGTH_S
    assert times_ns[0] >= START_NS and times_ns[-1] <= START_NS + 1e9 * LENGTH_S
    assert 2 <= len(infos) <= 4, 'recorded once, but repeated for late subscribers'


def test_the_player_waits_for_its_subscribers(graph: Graph, bag: Path) -> None:
    links = graph.listen(TFMessage, '/tf_static', STATIC)
    parameters = {'player.bag': str(bag), 'player.wait_for': 'test tracker'}
    player = graph.start('player', parameters=parameters)
    received = listen(graph)
    graph.wait(lambda: 'waiting for tracker' in player.output, 'the log of the missing node')
    assert not received['imu/data_raw']
    frames = {link.child_frame_id for message in links for link in message.transforms}
    assert frames == {topics.CAMERA_FRAME, topics.IMU_FRAME}, 'transforms are published at once'
    graph.start('tracker')
    graph.wait(lambda: received['imu/data_raw'], 'the first sample')
    assert topics.stamp_ns(received['imu/data_raw'][0]) == START_NS


def test_namespace_and_rate_of_the_player(graph: Graph, bag: Path) -> None:
    received = listen(graph, 'two')
    parameters = {'player.bag': str(bag), 'player.wait_for': 'test', 'player.rate': 50.0}
    graph.start('player', namespace='two', parameters=parameters).may_end = True
    graph.wait(lambda: len(received['wheel/odometry']) == 20 * LENGTH_S, 'all messages')


def test_a_bag_that_cannot_be_played_is_reported(graph: Graph, tmp_path: Path) -> None:
    for parameters, reason in (
        ({}, 'no recording is given'),
        ({'player.bag': str(tmp_path / 'none')}, 'no such bag'),
        ({'player.bag': str(tmp_path), 'player.rate': 0.0}, 'player.rate is speed relative to the recording'),
    ):
        player = graph.start('player', parameters=parameters)
        player.may_end = True
        graph.wait(lambda player=player: player.status is not None, 'the end of the node')  # type: ignore[misc]
        assert player.status == 2
        assert reason in player.output


def test_the_player_waits_for_a_slow_calibrator(graph: Graph, bag: Path) -> None:
    """The test answers as the calibrator does, but late."""
    answers = graph.node.create_publisher(Imu, 'imu/data', SENSOR_OUT)
    received, answered, behind = graph.listen(Imu, 'imu/data_raw'), 0, 0
    parameters = {'player.bag': str(bag), 'player.wait_for': 'test', 'player.rate': 100.0}
    player = graph.start('player', parameters=parameters)
    player.may_end = True

    def ended() -> bool:
        nonlocal answered, behind
        for _ in received[answered : answered + 2]:
            answers.publish(Imu())
            answered += 1
        behind = max(behind, len(received) - answered if answered else 0)
        return player.status is not None

    graph.wait(ended, 'the end of the node', 60.0)
    count = sum(isinstance(sample, ImuSample) for sample in drive(LENGTH_S))
    assert player.status == 0 and len(received) == count
    assert behind <= MAX_UNANSWERED + 2


def test_lost_messages_are_counted_and_the_player_fails(graph: Graph, bag: Path) -> None:
    answers = graph.node.create_publisher(Imu, 'imu/data', SENSOR_OUT)
    received = graph.listen(Imu, 'imu/data_raw')
    player = graph.start('player', parameters={'player.bag': str(bag), 'player.wait_for': 'test'})
    player.may_end = True
    graph.wait(lambda: received, 'the first sample')
    answers.publish(Imu())
    graph.wait(lambda: player.status is not None, 'the end of the node', 60.0)
    assert player.status == 1
    assert 'messages of imu/data_raw were lost' in player.output
