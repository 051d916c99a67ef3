"""A recording as it is sent to running nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_bags import RIG, START_NS, drive

from gyrocal_ros.bag.playback import Kind, Playback, Track
from gyrocal_ros.bag.selection import TopicChoice, select_topics
from gyrocal_ros.bag.storage import open_storage, ros_types
from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.data import FeatureObservations, Frame, seconds
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.topics import Role

CHOICE = TopicChoice()


def write(path: Path, *, images: bool = False, namespace: str = '') -> Path:
    with new_bag(path, namespace=namespace) as bag:
        bag.write_rig(RIG, START_NS, np.eye(3))
        for sample in drive(2.0):
            bag.write(sample)
            if images and isinstance(sample, FeatureObservations):
                bag.write(Frame(sample.t_ns + 1, np.zeros((48, 64), np.uint8)))
    return path


def played(path: Path, choice: TopicChoice = CHOICE) -> tuple[list[Track], list[tuple[int, Track, bytes]]]:
    with open_storage(path) as storage:
        playback = Playback(storage, select_topics(storage.topics, choice))
        latched = [(0, track, raw) for track, raw in playback.latched()]
        return playback.tracks, [*latched, *playback.messages()]


def test_all_of_a_robot_is_played_under_the_names_that_nodes_want(tmp_path: Path) -> None:
    tracks, messages = played(write(tmp_path / 'bag', namespace='robot1'))
    assert {track.name for track in tracks} == {
        'imu/data_raw',
        'wheel/odometry',
        'imu/temperature',
        'ceiling_camera/features',
        'ceiling_camera/camera_info',
        'ground_truth/odometry',
        'battery_state',
    }
    assert messages[0][1] == Track('/tf_static', topics.TRANSFORMS, Kind.LATCHED)
    recorded_ns = [recorded for recorded, _, _ in messages[1:]]
    assert recorded_ns == sorted(recorded_ns)
    assert seconds(recorded_ns[-1] - recorded_ns[0]) == pytest.approx(2.0, abs=0.1)


def test_what_is_sent_is_what_was_recorded(tmp_path: Path) -> None:
    _, messages = played(write(tmp_path / 'bag'))
    types = ros_types()
    sent: list[Any] = [
        types.deserialize_cdr(raw, track.type_name) for _, track, raw in messages if track.name == Role.IMU
    ]
    assert [topics.stamp_ns(message) for message in sent][:2] == [START_NS, START_NS + 10_000_000]
    assert sent[0].linear_acceleration.z == 9.8


def test_features_or_images_are_played_not_both(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', images=True)
    names = [{track.name for track in played(path, TopicChoice(use_images=use))[0]} for use in (False, True)]
    assert 'ceiling_camera/features' in names[0] and 'ceiling_camera/features' not in names[1]
    assert names[1] - names[0] == {'ceiling_camera/image_raw/compressed'}


def test_the_calibration_of_the_camera_is_said_again(tmp_path: Path) -> None:
    tracks, _ = played(write(tmp_path / 'bag', images=True), TopicChoice(use_images=True))
    assert {track.name for track in tracks if track.repeats} == {'ceiling_camera/camera_info'}
    assert {track.name for track in tracks if track.kind is Kind.IMAGE} == {
        'ceiling_camera/image_raw/compressed'
    }


def as_ros1(path: Path, bag: Path) -> Path:
    """The same recording as a ROS 1 bag, and a word of a node about itself in it."""
    types, old_types = ros_types(), get_typestore(Stores.ROS1_NOETIC)
    old_types.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', topics.TRANSFORMS))
    with rosbag2.Reader(path) as reader, rosbag1.Writer(bag) as writer:
        connections = {
            item.id: writer.add_connection(item.topic, item.msgtype, typestore=old_types)
            for item in reader.connections
        }
        word = writer.add_connection('/rosout', 'rosgraph_msgs/msg/Log', typestore=old_types)
        said = old_types.types['rosgraph_msgs/msg/Log']
        header = old_types.types['std_msgs/msg/Header'](
            0, types.types['builtin_interfaces/msg/Time'](1, 2), ''
        )
        message = said(header, 1, 'node', 'hello', 'file', 'function', 3, [])
        writer.write(word, START_NS, old_types.serialize_ros1(message, 'rosgraph_msgs/msg/Log'))
        for item, recorded_ns, raw in reader.messages():
            writer.write(connections[item.id], recorded_ns, types.cdr_to_ros1(raw, item.msgtype))
    return bag


def test_a_recording_of_ros_1_is_sent_as_ros_2_does(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag')
    tracks, messages = played(path)
    old_tracks, old_messages = played(as_ros1(path, tmp_path / 'old.bag'))
    assert {track.name for track in old_tracks} == {track.name for track in tracks}
    types = ros_types()
    by_track = [{track: raw for _, track, raw in some} for some in (old_messages, messages)]
    assert by_track[0].keys() == by_track[1].keys()
    for track, raw in by_track[1].items():
        old, new = (types.deserialize_cdr(item, track.type_name) for item in (by_track[0][track], raw))
        assert repr(old) == repr(new), track.name
