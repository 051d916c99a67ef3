"""Names and messages of heading references."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from small_bags import RIG, START_NS, drive

from gyrocal_ros.bag.check import check_bag
from gyrocal_ros.bag.fields import field_reader
from gyrocal_ros.bag.selection import TopicOptions, select_topics
from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.bag.storage import Topic
from gyrocal_ros.bag.write import BagWriter, new_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, HeadingSample, TruthSample
from gyrocal_ros.errors import ConfigError, RecordingError
from gyrocal_ros.msgs import to_ros, topics
from gyrocal_ros.msgs.headings import (
    HEADING_TYPES,
    FrameHeading,
    HeadingName,
    heading_conversion,
    parse_heading_name,
)
from gyrocal_ros.msgs.transforms import quaternion_from_yaw

STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = to_ros.MessageMaker(STORE.types.__getitem__)
YAW_RAD = 2.5


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('/pose', HeadingName('/pose')),
        ('robot/state.heading_deg', HeadingName('robot/state', 'heading_deg')),
        ('/nav.attitude.yaw', HeadingName('/nav', 'attitude.yaw')),
        ('tf:map:base_link', HeadingName('tf', frames=('map', 'base_link'))),
    ],
)
def test_names(text: str, expected: HeadingName) -> None:
    assert parse_heading_name(text) == expected


@pytest.mark.parametrize('text', ['tf:map', 'tf::base_link', 'tf:map:odom:base_link'])
def test_a_frame_needs_a_parent_and_a_child(text: str) -> None:
    with pytest.raises(ConfigError, match='tf:PARENT:CHILD'):
        parse_heading_name(text)


def values_of(type_name: str) -> dict[str, float]:
    """Return the values of the fields of a message that show `YAW_RAD`."""
    if type_name.endswith('MagneticField'):
        return {'magnetic_field.x': 2e-5 * math.cos(YAW_RAD), 'magnetic_field.y': -2e-5 * math.sin(YAW_RAD)}
    conversion = heading_conversion(type_name)
    return dict(zip(conversion.fields[2:], quaternion_from_yaw(YAW_RAD), strict=True))


@pytest.mark.parametrize('type_name', HEADING_TYPES)
def test_every_type_gives_the_heading(type_name: str) -> None:
    conversion = heading_conversion(type_name)
    sample = conversion.build(3, 7, *values_of(type_name).values())
    assert sample.t_ns == 3_000_000_007 and sample.yaw_rad == pytest.approx(YAW_RAD)


@pytest.mark.parametrize('type_name', HEADING_TYPES)
def test_the_fields_exist(type_name: str) -> None:
    field_reader(STORE, type_name, heading_conversion(type_name).fields, cdr=True)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('state.yaw', YAW_RAD),
        ('state.heading_deg', math.degrees(YAW_RAD)),
        ('robot/yaw_degrees.vector.z', math.degrees(YAW_RAD)),
        ('degraded.yaw', YAW_RAD),
    ],
)
def test_a_yaw_field_is_in_degrees_if_its_name_says_so(name: str, value: float) -> None:
    sample = heading_conversion('my_msgs/msg/State', parse_heading_name(name)).build(0, 0, value)
    assert sample.yaw_rad == pytest.approx(YAW_RAD)


def test_an_orientation_that_is_not_set_is_no_heading() -> None:
    assert math.isnan(heading_conversion(topics.IMU).build(0, 0, 0.0, 0.0, 0.0, 0.0).yaw_rad)


def link(parent: str, child: str, yaw_rad: float, t_ns: int) -> SimpleNamespace:
    x, y, z, w = quaternion_from_yaw(yaw_rad)
    stamp = SimpleNamespace(sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    transform = SimpleNamespace(
        translation=SimpleNamespace(x=1.0, y=2.0, z=0.0), rotation=SimpleNamespace(x=x, y=y, z=z, w=w)
    )
    header = SimpleNamespace(stamp=stamp, frame_id=parent)
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform)


def message(*links: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(transforms=list(links))


def test_the_heading_of_a_frame_follows_the_chain_of_transforms() -> None:
    frames = FrameHeading('map', 'base_link')
    assert frames.add(message(link('odom', 'base_link', 0.3, 10))) is None
    first = frames.add(message(link('map', 'odom', 0.5, 1000)))
    assert first is not None and first.yaw_rad == pytest.approx(0.8)
    assert first.t_ns == 10, 'corrections are stamped ahead'
    assert frames.add(message(link('base_link', 'wheel', 2.0, 25))) is None
    assert frames.add(message(link('odom', 'base_link', 0.4, 30))) is None, 'odometry is no reference'
    assert frames.add(message(link('map', 'odom', 0.5, 1010))) is None, 'only its stamp is new'
    second = frames.add(message(link('map', 'odom', 0.52, 1020)))
    assert second is not None and second.t_ns == 30 and second.yaw_rad == pytest.approx(0.92)


def test_a_frame_directly_below_the_other_is_a_heading_each_time() -> None:
    frames = FrameHeading('vicon', 'base_link')
    found = [frames.add(message(link('vicon', 'base_link', 0.3, t_ns))) for t_ns in (10, 20, 20, 30)]
    assert [None if item is None else item.t_ns for item in found] == [10, 20, None, 30]


def bag_with(path: Path, *, names: dict[str, str], tf: bool = False) -> Path:
    """Write a drive without a camera; the ground truth is recorded under other names.

    Args:
        path: folder.
        names: topic and message type, which is an Odometry or a TransformStamped.
        tf: True to record the frames odom to base_link.
    """
    with new_bag(path) as bag:
        bag.write_rig(RIG, START_NS, R_bi=np.eye(3))
        for sample in drive():
            if isinstance(sample, FeatureObservations):
                continue
            if not isinstance(sample, TruthSample):
                bag.write(sample)
                continue
            for name, type_name in names.items():
                write_as(bag, name, type_name, sample)
            if tf:
                write_as(bag, '/tf', topics.TRANSFORMS, sample)
    return path


def write_as(bag: BagWriter, name: str, type_name: str, sample: TruthSample) -> None:
    odometry = to_ros.truth(MAKE, sample)
    if type_name == topics.ODOMETRY:
        bag._write_message(name, type_name, odometry, sample.t_ns)
        return
    x, y, z, w = quaternion_from_yaw(sample.yaw_rad)
    transform = MAKE(
        'geometry_msgs/msg/TransformStamped',
        header=MAKE.header(sample.t_ns, 'odom'),
        child_frame_id='base_link',
        transform=MAKE(
            'geometry_msgs/msg/Transform',
            translation=MAKE('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0),
            rotation=MAKE('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        ),
    )
    if type_name == topics.TRANSFORMS:
        transform = MAKE(type_name, transforms=[transform])
    bag._write_message(name, type_name, transform, sample.t_ns)


TRUE_YAWS = [item.yaw_rad for item in drive() if isinstance(item, TruthSample)]
TRANSFORM = 'geometry_msgs/msg/TransformStamped'


@pytest.mark.parametrize('reference', ['/vicon/robot', 'tf:odom:base_link'])
def test_headings_of_a_bag(tmp_path: Path, reference: str) -> None:
    path = bag_with(tmp_path / 'bag', names={'/vicon/robot': TRANSFORM}, tf=True)
    source = open_bag(path, Config(), heading_reference=reference)
    found = [item.yaw_rad for item in source.measurements() if isinstance(item, HeadingSample)]
    assert found == pytest.approx(TRUE_YAWS)


def test_the_only_obvious_reference_is_used_and_named(tmp_path: Path) -> None:
    path = bag_with(tmp_path / 'bag', names={'/pf/pose': topics.ODOMETRY})
    source = open_bag(path, Config())
    assert source.rig.camera is None
    assert 'chosen_reference' in [item.kind for item in source.warnings]
    assert sum(isinstance(item, HeadingSample) for item in source.measurements()) == len(TRUE_YAWS)
    report = check_bag(path, Config())
    assert '/pf/pose is used as the heading reference' in ' '.join(map(str, report.issues))


@pytest.mark.parametrize('others', [['/amcl_pose'], []])
def test_without_an_obvious_reference_the_possible_ones_are_listed(tmp_path: Path, others: list[str]) -> None:
    """Two poses, or an odometry that is probably that of the wheels."""
    names = [*others, '/pf/pose'] if others else ['/odom']
    path = bag_with(tmp_path / 'bag', names=dict.fromkeys(names, topics.ODOMETRY))
    with pytest.raises(RecordingError, match=f'--heading-reference {" or ".join(names)}'):
        open_bag(path, Config())


@pytest.mark.parametrize(('name', 'is_suggested'), [('/pf/pose', False), ('/base/odom', True)])
def test_a_pose_is_not_suggested_as_wheel_odometry(name: str, is_suggested: bool) -> None:
    recorded = {
        '/imu/data_raw': Topic('/imu/data_raw', topics.IMU, 10, ()),
        name: Topic(name, topics.ODOMETRY, 10, ()),
    }
    text = ' '.join(str(issue) for issue in select_topics(recorded, TopicOptions()).issues)
    assert (f'wheel/odometry:={name}' in text) == is_suggested
