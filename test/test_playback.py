"""Playback of a recording to running nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_bags import RIG, START_NS, drive

from gyrocal_ros.bag.pacing import Pacing
from gyrocal_ros.bag.playback import Playback, PlayedTopic, PublishMode
from gyrocal_ros.bag.selection import TopicOptions, select_topics
from gyrocal_ros.bag.storage import open_storage, ros_types
from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.data import FeatureObservations, Frame, seconds
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.topics import Role

DEFAULT = TopicOptions()
Sent: TypeAlias = tuple[int, PlayedTopic, bytes]
"""Time of recording (ns), topic and content."""


def write(path: Path, *, images: bool = False, namespace: str = '') -> Path:
    with new_bag(path, namespace=namespace) as bag:
        bag.write_rig(RIG, START_NS, np.eye(3))
        for sample in drive(2.0):
            bag.write(sample)
            if images and isinstance(sample, FeatureObservations):
                bag.write(Frame(sample.t_ns + 1, np.zeros((48, 64), np.uint8)))
    return path


def played(path: Path, options: TopicOptions = DEFAULT) -> tuple[list[PlayedTopic], list[Sent]]:
    with open_storage(path) as storage:
        playback = Playback(storage, select_topics(storage.topics, options))
        latched = [(0, topic, raw) for topic, raw in playback.latched_messages()]
        return playback.topics, [*latched, *playback.messages()]


def test_all_topics_of_a_robot_are_played_under_the_names_nodes_expect(tmp_path: Path) -> None:
    played_topics, messages = played(write(tmp_path / 'bag', namespace='robot1'))
    assert {topic.name for topic in played_topics} == {
        'imu/data_raw',
        'wheel/odometry',
        'imu/temperature',
        'ceiling_camera/features',
        'ceiling_camera/camera_info',
        'ground_truth/odometry',
        'battery_state',
    }
    assert messages[0][1] == PlayedTopic('/tf_static', topics.TRANSFORMS, PublishMode.LATCHED)
    recorded_ns = [recorded for recorded, _, _ in messages[1:]]
    assert recorded_ns == sorted(recorded_ns)
    assert seconds(recorded_ns[-1] - recorded_ns[0]) == pytest.approx(2.0, abs=0.1)


def test_sent_messages_equal_the_recorded_ones(tmp_path: Path) -> None:
    _, messages = played(write(tmp_path / 'bag'))
    types = ros_types()
    sent: list[Any] = [
        types.deserialize_cdr(raw, topic.type_name) for _, topic, raw in messages if topic.name == Role.IMU
    ]
    assert [topics.stamp_ns(message) for message in sent][:2] == [START_NS, START_NS + 10_000_000]
    assert sent[0].linear_acceleration.z == 9.8


def test_features_or_images_are_played_not_both(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', images=True)
    names = [{topic.name for topic in played(path, TopicOptions(use_images=use))[0]} for use in (False, True)]
    assert 'ceiling_camera/features' in names[0] and 'ceiling_camera/features' not in names[1]
    assert names[1] - names[0] == {'ceiling_camera/image_raw/compressed'}


def test_the_calibration_of_the_camera_is_repeated(tmp_path: Path) -> None:
    played_topics, _ = played(write(tmp_path / 'bag', images=True), TopicOptions(use_images=True))
    assert {topic.name for topic in played_topics if topic.repeats} == {'ceiling_camera/camera_info'}
    assert {topic.name for topic in played_topics if topic.mode is PublishMode.IMAGE} == {
        'ceiling_camera/image_raw/compressed'
    }


def as_ros1(path: Path, bag: Path) -> Path:
    """Convert a recording to a ROS 1 bag, with a log message added."""
    types, old_types = ros_types(), get_typestore(Stores.ROS1_NOETIC)
    old_types.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', topics.TRANSFORMS))
    with rosbag2.Reader(path) as reader, rosbag1.Writer(bag) as writer:
        connections = {
            item.id: writer.add_connection(item.topic, item.msgtype, typestore=old_types)
            for item in reader.connections
        }
        log = writer.add_connection('/rosout', 'rosgraph_msgs/msg/Log', typestore=old_types)
        log_type = old_types.types['rosgraph_msgs/msg/Log']
        header = old_types.types['std_msgs/msg/Header'](
            0, types.types['builtin_interfaces/msg/Time'](1, 2), ''
        )
        message = log_type(header, 1, 'node', 'hello', 'file', 'function', 3, [])
        writer.write(log, START_NS, old_types.serialize_ros1(message, 'rosgraph_msgs/msg/Log'))
        for item, recorded_ns, raw in reader.messages():
            writer.write(connections[item.id], recorded_ns, types.cdr_to_ros1(raw, item.msgtype))
    return bag


def test_a_recording_of_ros_1_is_sent_as_ros_2_messages(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag')
    played_topics, messages = played(path)
    old_topics, old_messages = played(as_ros1(path, tmp_path / 'old.bag'))
    assert {topic.name for topic in old_topics} == {topic.name for topic in played_topics}
    types = ros_types()
    last_old, last = ({topic: raw for _, topic, raw in sent} for sent in (old_messages, messages))
    assert last_old.keys() == last.keys()
    for topic, raw in last.items():
        old, new = (types.deserialize_cdr(item, topic.type_name) for item in (last_old[topic], raw))
        assert repr(old) == repr(new), topic.name


def test_a_playback_waits_for_a_listener_that_is_behind() -> None:
    pacing = Pacing(limit=3, patience_s=2.0)
    for _ in range(10):
        assert pacing.may_send(0.0), 'nothing is counted before the first answer'
        pacing.add_sent()
    pacing.add_answer(1.0)
    for _ in range(3):
        assert pacing.may_send(1.0)
        pacing.add_sent()
    assert not pacing.may_send(1.1)
    pacing.add_answer(1.2)
    assert pacing.may_send(1.2)
    for _ in range(2):
        pacing.add_answer(1.3)
    pacing.finish()
    assert (pacing.sent, pacing.lost) == (3, 0)


def test_messages_without_an_answer_are_counted_and_the_playback_goes_on() -> None:
    pacing = Pacing(limit=3, patience_s=2.0)
    pacing.add_answer(0.0)
    for _ in range(3):
        pacing.add_sent()
    assert pacing.is_waiting(1.9) and not pacing.may_send(1.9)
    assert not pacing.is_waiting(2.1) and pacing.may_send(2.1)
    assert (pacing.sent, pacing.lost) == (3, 3)
