"""Bags of every kind yield the written measurements, sorted and in body axes, or raise one clear error."""

from __future__ import annotations

import math
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_bags import CAMERA, GRAVITY, RIG, START_NS, changed, drive, turned_imu, write

from gyrocal_ros.bag.source import BagSource, open_bag
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.config.declare import with_settings
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    ClockStep,
    CovariateSample,
    FeatureObservations,
    Frame,
    HeadingSample,
    ImuSample,
    Measurement,
    TemperatureSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import ConfigError, GyrocalError, MessageError, RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.to_ros import MessageMaker
from gyrocal_ros.msgs.transforms import rotation_from_quaternion

SHARED = Path(__file__).resolve().parent.parent.parent / 'shared' / 'data' / 'robot-localization-bags'
STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageMaker(STORE.types.__getitem__)
CONFIG = Config()
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
Storage = Literal['mcap', 'sqlite3']


def read(path: Path, config: Config = CONFIG, **options: Any) -> list[Measurement]:
    return list(open_bag(path, config, **options).measurements())


def of(samples: list[Measurement], kind: type[Any]) -> list[Any]:
    return [sample for sample in samples if isinstance(sample, kind)]


def kinds(source: BagSource) -> list[str]:
    return [warning.kind for warning in source.warnings]


def data_file(path: Path) -> Path:
    (file,) = (file for file in path.iterdir() if file.suffix in ('.mcap', '.db3'))
    return file


def is_state(sample: Measurement) -> bool:
    """Return True for a covariate that is a constant in a BatteryState."""
    name = sample.name if isinstance(sample, CovariateSample) else ''
    return 'power_supply' in name or name.endswith('.present')


def assert_same(read_back: list[Measurement], written: list[Measurement]) -> None:
    """Compare measurements, except for the order of equal stamps and the constants in a BatteryState."""
    read_back = [
        sample for sample in read_back if not (isinstance(sample, CovariateSample) and is_state(sample))
    ]
    for kind in {type(sample) for sample in written}:
        back, there = of(read_back, kind), of(written, kind)
        assert len(back) == len(there)
        for one, other in zip(back, there, strict=True):
            if kind is FeatureObservations:
                assert one.t_ns == other.t_ns
                np.testing.assert_array_equal(one.ids, other.ids)
                np.testing.assert_array_equal(one.pixels, other.pixels)
            elif kind is TruthSample:
                assert (one.t_ns, one.position_m) == (other.t_ns, other.position_m)
                assert one.yaw_rad == pytest.approx(other.yaw_rad)
            else:
                assert one == other
    assert [sample.t_ns for sample in read_back] == sorted(sample.t_ns for sample in written)


# --- every kind of bag ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_measurements_survive_writing_and_reading(tmp_path: Path, storage: Storage) -> None:
    source = open_bag(write(tmp_path / 'bag', storage=storage), CONFIG, with_covariates=True)
    assert_same(list(source.measurements()), drive())
    assert_same(list(source.measurements()), drive())
    assert source.warnings == []
    assert source.rig.camera == CAMERA
    np.testing.assert_allclose(source.rig.camera_mount.R_bs, RIG.camera_mount.R_bs, atol=1e-12)
    np.testing.assert_array_equal(source.rig.camera_mount.p_bs, RIG.camera_mount.p_bs)
    assert source.span.start_ns == START_NS
    assert source.span.duration_s == pytest.approx(10.0, abs=0.1)


def copy_bag(path: Path, out: Path, plugin: StoragePlugin, compression: CompressionMode) -> Path:
    writer = rosbag2.Writer(out, version=9, storage_plugin=plugin)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with rosbag2.Reader(path) as reader, writer:
        connections = {
            item.id: writer.add_connection(item.topic, item.msgtype, typestore=STORE)
            for item in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            writer.write(connections[connection.id], recorded_ns, raw)
    return out


@pytest.mark.slow
@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('compression', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags(tmp_path: Path, plugin: StoragePlugin, compression: CompressionMode) -> None:
    path = copy_bag(write(tmp_path / 'bag'), tmp_path / 'compressed', plugin, compression)
    assert_same(read(path, with_covariates=True), drive())


def test_ros_1_bags(tmp_path: Path) -> None:
    old_types = get_typestore(Stores.ROS1_NOETIC)
    old_types.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', topics.TRANSFORMS))
    out = tmp_path / 'bag.bag'
    with rosbag2.Reader(write(tmp_path / 'bag')) as reader, rosbag1.Writer(out) as writer:
        connections = {
            item.id: writer.add_connection(item.topic, item.msgtype, typestore=old_types)
            for item in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            old = STORE.cdr_to_ros1(raw, connection.msgtype)
            writer.write(connections[connection.id], recorded_ns, old)
    source = open_bag(out, CONFIG, with_covariates=True)
    assert source.rig.camera == CAMERA
    assert_same(list(source.measurements()), drive())


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_single_files_of_a_bag(tmp_path: Path, storage: Storage) -> None:
    file = data_file(write(tmp_path / 'bag', storage=storage))
    assert_same(read(file, with_covariates=True), drive())


def test_bags_without_definitions(tmp_path: Path) -> None:
    """Older sqlite3 bags do not contain the definitions of their types."""
    path = write(tmp_path / 'bag', storage='sqlite3')
    database = sqlite3.connect(data_file(path))
    database.execute('DELETE FROM message_definitions')
    database.commit()
    database.close()
    assert_same(read(path, with_covariates=True), drive())


def test_definitions_without_the_types_of_ros(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', storage='sqlite3')
    database = sqlite3.connect(data_file(path))
    definition = 'std_msgs/Header header\nfloat64 temperature\nfloat64 variance'
    update = 'UPDATE message_definitions SET encoded_message_definition = ? WHERE topic_type = ?'
    database.execute(update, [definition, topics.TEMPERATURE])
    database.execute(update, ['no definition ]', topics.ODOMETRY])
    database.commit()
    database.close()
    assert_same(read(path, with_covariates=True), drive())


def test_a_time_of_recording_that_is_no_number_is_damage(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', storage='sqlite3')
    with closing(sqlite3.connect(data_file(path))) as database:
        database.execute("UPDATE messages SET timestamp = 'abc' WHERE id % 7 = 0")
        database.commit()
    with open_storage(path) as storage, pytest.raises(RecordingError, match="'abc' is not a time"):
        list(storage.raw_messages(storage.topics.values()))


def test_a_field_that_is_no_number_cannot_be_read(tmp_path: Path) -> None:
    with open_storage(write(tmp_path / 'bag')) as storage:
        topic = storage.topics['/imu/data_raw']
        read = storage.reader_of(topic, ['header.stamp.sec', 'angular_velocity'])
        _, _, raw = next(storage.raw_messages([topic]))
        with pytest.raises(MessageError, match='angular_velocity is not a number'):
            read(raw)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_same_input_gives_the_same_bytes(tmp_path: Path, storage: Storage) -> None:
    one, other = (write(tmp_path / folder / 'bag', storage=storage) for folder in ('one', 'other'))
    for file in one.iterdir():
        assert file.read_bytes() == (other / file.name).read_bytes()


def test_a_writer_that_fails_leaves_no_files(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), new_bag(tmp_path / 'bag') as bag:
        bag.write(drive()[0])
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_writer_keeps_existing_files(tmp_path: Path) -> None:
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'precious').touch()
    with pytest.raises(GyrocalError, match='not empty'), new_bag(tmp_path / 'bag'):
        pass
    with new_bag(tmp_path / 'bag', overwrite=True) as bag:
        bag.write(drive()[0])
    assert (tmp_path / 'bag' / 'precious').exists()


def test_a_covariate_without_a_message_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match='current_draw'):
        write(tmp_path / 'bag', [CovariateSample(START_NS, 'motor.current_draw', 1.0)])


def test_static_transforms_are_latched(tmp_path: Path) -> None:
    assert 'transient_local' in (write(tmp_path / 'bag') / 'metadata.yaml').read_text()


def test_wheel_odometry_has_a_pose(tmp_path: Path) -> None:
    samples = [WheelSample(START_NS + k * NS_PER_S // 10, 1.0, np.pi / 2) for k in range(21)]
    with open_storage(write(tmp_path / 'bag', samples)) as storage:
        *_, last = storage.messages(storage.topics['/wheel/odometry'])
    position = last.pose.pose.position
    assert (position.x, position.y) == pytest.approx((0.0, 4.0 / np.pi), abs=0.01)


# --- selection of topics -------------------------------------------------------------------------


def two_robots(path: Path) -> Path:
    """Write a bag of two robots, of which the second drives faster."""
    faster = (
        replace(sample, speed_m_s=1.0) if isinstance(sample, WheelSample) else sample for sample in drive()
    )
    one = write(path.with_name('one'), namespace='r1')
    return merge(path, one, write(path.with_name('other'), faster, namespace='r2'))


def merge(path: Path, *parts: Path) -> Path:
    with rosbag2.Writer(path, version=9) as writer:
        connections: dict[str, Connection] = {}
        for part in parts:
            with rosbag2.Reader(part) as reader:
                for connection, recorded_ns, raw in reader.messages():
                    name, kind = connection.topic, connection.msgtype
                    if name not in connections:
                        connections[name] = writer.add_connection(name, kind, typestore=STORE)
                    writer.write(connections[name], recorded_ns, raw)
    return path


@pytest.mark.slow
def test_the_robot_is_selected_by_its_namespace(tmp_path: Path) -> None:
    path = two_robots(tmp_path / 'bag')
    with pytest.raises(RecordingError, match='/r1, /r2; choose with --namespace'):
        open_bag(path, CONFIG)
    for namespace, speed in (('r1', 0.25), ('/r2/', 1.0)):
        samples = read(path, namespace=namespace, with_covariates=True)
        assert {sample.speed_m_s for sample in of(samples, WheelSample)} == {speed}
        names = {sample.name for sample in of(samples, CovariateSample) if not is_state(sample)}
        assert names == {'battery_state.voltage', 'battery_state.current'}
    with pytest.raises(RecordingError, match='/r3; known: /r1, /r2'):
        open_bag(path, CONFIG, namespace='r3')


def test_a_single_robot_needs_no_namespace(tmp_path: Path) -> None:
    assert_same(read(write(tmp_path / 'bag', namespace='fleet/r7'), with_covariates=True), drive())


def renamed(tmp_path: Path, names: dict[str, str]) -> Path:
    """Write the bag of `drive` with topics renamed, or left out if the new name is empty."""
    with rosbag2.Reader(write(tmp_path / 'original')) as reader:
        recorded = list(reader.messages())
    with rosbag2.Writer(tmp_path / 'bag', version=9) as writer:
        connections: dict[str, Connection] = {}
        for connection, recorded_ns, raw in recorded:
            name = names.get(connection.topic, connection.topic)
            if name and name not in connections:
                connections[name] = writer.add_connection(name, connection.msgtype, typestore=STORE)
            if name:
                writer.write(connections[name], recorded_ns, raw)
    return tmp_path / 'bag'


@pytest.mark.slow
def test_topics_under_other_names(tmp_path: Path) -> None:
    path = renamed(tmp_path, {'/imu/data_raw': '/sensors/imu', '/wheel/odometry': '/odom'})
    with pytest.raises(RecordingError, match='there is no IMU; give -r imu/data_raw:=/sensors/imu'):
        open_bag(path, CONFIG)
    remap = {'imu/data_raw': '/sensors/imu', 'wheel/odometry': 'odom'}
    assert_same(read(path, remap=remap, with_covariates=True), drive())
    settings = with_settings(
        CONFIG, {'recording': {'remap': 'imu/data_raw:=/sensors/imu wheel/odometry:=/odom'}}
    )
    assert_same(read(path, settings, with_covariates=True), drive())


@pytest.mark.parametrize(
    'remap, error, message',
    [
        ({'imu/data_raw': '/imu/dat_raw'}, RecordingError, 'did you mean /imu/data_raw'),
        ({'imu/data_raw': '/wheel/odometry'}, RecordingError, 'is a nav_msgs/msg/Odometry'),
        ({'imu/data_rw': '/imu/data_raw'}, ConfigError, 'known are imu/data_raw'),
    ],
)
def test_wrong_remaps(tmp_path: Path, remap: dict[str, str], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        open_bag(write(tmp_path / 'bag'), CONFIG, remap=remap)


@pytest.mark.parametrize(
    'topic, message',
    [
        ('/imu/data_raw', 'there is no IMU; record imu/data_raw'),
        ('/wheel/odometry', 'there is no wheel odometry'),
        ('/ceiling_camera/camera_info', 'the camera has no calibration'),
        ('/ceiling_camera/features', 'there is no ceiling camera.*--heading-reference'),
    ],
)
def test_missing_topics(tmp_path: Path, topic: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        open_bag(renamed(tmp_path, {topic: ''}), CONFIG)


def test_optional_topics_may_be_missing(tmp_path: Path) -> None:
    missing = ('/imu/temperature', '/ground_truth/odometry', '/battery_state')
    assert Counter(type(sample) for sample in read(renamed(tmp_path, dict.fromkeys(missing, '')))) == {
        ImuSample: 1000,
        WheelSample: 200,
        FeatureObservations: 100,
    }


def test_another_heading_reference_replaces_the_camera(tmp_path: Path) -> None:
    path = renamed(
        tmp_path, {'/ground_truth/odometry': '/visual_odometry', '/ceiling_camera/camera_info': ''}
    )
    source = open_bag(path, CONFIG, heading_reference='visual_odometry')
    samples = list(source.measurements())
    assert source.rig.camera is None
    assert not of(samples, FeatureObservations)
    assert [sample.yaw_rad for sample in of(samples, HeadingSample)] == pytest.approx(
        [sample.yaw_rad for sample in of(drive(), TruthSample)]
    )


def test_wheels_can_also_be_the_heading_reference(tmp_path: Path) -> None:
    counts = Counter(
        type(item) for item in read(write(tmp_path / 'bag'), heading_reference='/wheel/odometry')
    )
    assert counts[WheelSample] == counts[HeadingSample] == 200


def test_the_ground_truth_is_refused_as_heading_reference(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match='used for comparison only'):
        open_bag(write(tmp_path / 'bag'), CONFIG, heading_reference='/ground_truth/odometry')


# --- mounting of the sensors ---------------------------------------------------------------------


def imu_rates(source: BagSource) -> list[Any]:
    return [
        (item.rate_rad_s, item.specific_force_m_s2) for item in of(list(source.measurements()), ImuSample)
    ]


R_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@pytest.mark.parametrize('R_ib, words', [(UPSIDE_DOWN, '180 deg about x'), (R_Y_UP, '90 deg about x')])
def test_an_imu_that_is_not_upright_is_rotated_with_a_warning(
    tmp_path: Path, R_ib: np.ndarray, words: str
) -> None:
    source = open_bag(write(tmp_path / 'bag', turned_imu(drive(), R_ib)), CONFIG)
    expected = [(item.rate_rad_s, item.specific_force_m_s2) for item in of(drive(), ImuSample)]
    assert imu_rates(source) == expected
    assert kinds(source) == ['imu_mount']
    assert words in str(source.warnings[0])


def test_a_transform_of_the_imu_is_applied_without_a_warning(tmp_path: Path) -> None:
    R_bi = rotation_from_quaternion(0.1, 0.9, -0.3, 0.2)
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS, R_bi=R_bi)
        for sample in turned_imu(drive(), R_bi.T):
            bag.write(sample)
    source = open_bag(tmp_path / 'bag', CONFIG)
    rate, force = imu_rates(source)[0]
    np.testing.assert_allclose(rate, (0.01, -0.02, 0.0), atol=1e-12)
    np.testing.assert_allclose(force, (0.1, -0.2, GRAVITY), atol=1e-12)
    assert source.warnings == []


def test_a_transform_that_gravity_contradicts_is_applied_with_a_warning(tmp_path: Path) -> None:
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS, R_bi=UPSIDE_DOWN)
        for sample in drive():
            bag.write(sample)
    source = open_bag(tmp_path / 'bag', CONFIG)
    assert imu_rates(source)[0] == ((0.01, 0.02, 0.0), (0.1, 0.2, -GRAVITY))
    assert 'contradicts its transform' in str(source.warnings[0])


def test_an_imu_without_an_accelerometer_may_say_so_by_nan(tmp_path: Path) -> None:
    nothing, partly = (math.nan,) * 3, (math.nan, 0.0, GRAVITY)

    def drive_with(force_m_s2: tuple[float, float, float]) -> list[Measurement]:
        def felt(sample: Any) -> Measurement:
            return replace(sample, specific_force_m_s2=force_m_s2)  # type: ignore[no-any-return]

        return list(changed(drive(), ImuSample, felt))

    path = write(tmp_path / 'bag', drive_with(nothing))
    assert_same(read(path, with_covariates=True), drive_with((0.0, 0.0, 0.0)))
    with pytest.raises(RecordingError, match='not finite'):
        read(write(tmp_path / 'broken', drive_with(partly)))


@pytest.mark.parametrize('other', ['imu_two', 'imu'])
def test_messages_of_a_second_imu_on_the_topic_are_left_out(tmp_path: Path, other: str) -> None:
    first, out = write(tmp_path / 'first'), tmp_path / 'both'
    with rosbag2.Reader(first) as reader, rosbag2.Writer(out, version=9) as writer:
        connections = {
            item.id: writer.add_connection(item.topic, item.msgtype, typestore=STORE)
            for item in reader.connections
        }
        for connection, recorded_ns, raw in reader.messages():
            writer.write(connections[connection.id], recorded_ns, raw)
            if connection.topic.endswith('imu/data_raw'):
                message: Any = STORE.deserialize_cdr(raw, connection.msgtype)
                message.header.frame_id = other
                message.header.stamp.nanosec += 3_000_000
                message.angular_velocity.z *= 2.0
                second = STORE.serialize_cdr(message, connection.msgtype)
                writer.write(connections[connection.id], recorded_ns, second)
    source = open_bag(out, CONFIG, with_covariates=True)
    assert_same(list(source.measurements()), drive())
    (warning,) = source.warnings
    count = len(of(drive(), ImuSample))
    assert f'{count} messages are of another sensor' in str(warning)
    assert f'{count} of /imu/data_raw' in str(warning)


def test_without_a_transform_the_camera_mount_of_the_settings_is_used(tmp_path: Path) -> None:
    config = with_settings(CONFIG, {'camera': {'mount_x_m': 0.5, 'mount_yaw_deg': 90.0}})
    source = open_bag(renamed(tmp_path, {'/tf_static': ''}), config)
    np.testing.assert_allclose(source.rig.camera_mount.p_bs, [0.5, 0.0, 0.1])
    np.testing.assert_allclose(source.rig.camera_mount.R_bs @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    assert kinds(source) == ['camera_mount']


# --- covariates ----------------------------------------------------------------------------------


def bag_with_own_type(path: Path, type_name: str, definition: str, rows: list[list[Any]]) -> Path:
    """Write the bag of `drive` with one more topic, of a type that only this bag defines."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, type_name))
    with rosbag2.Writer(path, version=9) as writer, rosbag2.Reader(write(path.with_name('drive'))) as reader:
        foreign = writer.add_connection('/base/motor', type_name, typestore=store)
        connections: dict[str, Connection] = {}
        for connection, recorded_ns, raw in reader.messages():
            name, kind = connection.topic, connection.msgtype
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=STORE)
            writer.write(connections[name], recorded_ns, raw)
        for number, row in enumerate(rows):
            message = store.types[type_name](*row)
            writer.write(foreign, START_NS + number * NS_PER_S, store.serialize_cdr(message, type_name))
    return path


MOTOR = 'acme_msgs/msg/Motor'


def test_types_that_only_the_bag_defines(tmp_path: Path) -> None:
    definition = 'uint8 KIND=3\nstring name\nfloat32 current\nfloat64[] history\nint16 speed\nbool on'
    rows = [['left', 1.5, np.array([1.0, 2.0]), -7, True], ['l', float('nan'), np.zeros(0), 8, False]]
    path = bag_with_own_type(tmp_path / 'bag', MOTOR, definition, rows)
    samples = of(read(path, with_covariates=True), CovariateSample)
    assert [(item.t_ns, item.name, item.value) for item in samples if 'motor' in item.name] == [
        (START_NS, 'base.motor.current', 1.5),
        (START_NS, 'base.motor.speed', -7.0),
        (START_NS, 'base.motor.on', 1.0),
        (START_NS + NS_PER_S, 'base.motor.speed', 8.0),
        (START_NS + NS_PER_S, 'base.motor.on', 0.0),
    ]
    assert not of(read(path), CovariateSample)


def test_recordings_may_define_a_type_differently(tmp_path: Path) -> None:
    for folder, definition, row in (
        ('one', 'float64 current', [1.5]),
        ('two', 'int16 speed\nfloat64 current', [3, 2.5]),
        ('three', 'float64 current', [3.5]),
    ):
        (tmp_path / folder).mkdir()
        path = bag_with_own_type(tmp_path / folder / 'bag', MOTOR, definition, [row])
        samples = of(read(path, with_covariates=True), CovariateSample)
        currents = [item.value for item in samples if item.name == 'base.motor.current']
        assert currents == [row[-1]]


def test_an_unknown_type_is_left_out_with_a_warning(tmp_path: Path) -> None:
    path = bag_with_own_type(tmp_path / 'bag', MOTOR, 'float64 current', [[1.0], [2.0]])
    (file,) = path.glob('*.db3')
    database = sqlite3.connect(file)
    database.execute('DELETE FROM message_definitions WHERE topic_type = ?', [MOTOR])
    database.commit()
    database.close()
    source = open_bag(path, CONFIG, with_covariates=True)
    assert_same(list(source.measurements()), drive())
    assert kinds(source) == ['unknown_type']


def test_numbers_without_a_stamp_are_stamped_by_the_clock_of_the_others(tmp_path: Path) -> None:
    """Fan speed has no header, only a time of recording, which may be of another clock."""
    samples = [*drive(), *(CovariateSample(START_NS + k * NS_PER_S, 'fan.data', float(k)) for k in range(9))]
    samples.sort(key=lambda sample: sample.t_ns)
    ahead_ns = 1000 * NS_PER_S
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for sample in samples:
            bag.write(sample, recorded_ns=sample.t_ns + ahead_ns)
    fan = [
        item
        for item in read(tmp_path / 'bag', with_covariates=True)
        if getattr(item, 'name', '') == 'fan.data'
    ]
    assert [(item.t_ns - START_NS) / NS_PER_S for item in fan] == pytest.approx(range(9), abs=0.02)


# --- wrong stamps and numbers --------------------------------------------------------------------


def test_late_messages_are_sorted_in_and_those_beyond_the_window_counted(tmp_path: Path) -> None:
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for number, sample in enumerate(drive()):
            late_s = 0.0 if not isinstance(sample, FeatureObservations) else 3.0 if number > 800 else 0.5
            bag.write(sample, recorded_ns=sample.t_ns + round(late_s * NS_PER_S))
    source = open_bag(tmp_path / 'bag', CONFIG)
    samples = list(source.measurements())
    too_late = 100 - len(of(samples, FeatureObservations))
    assert [sample.t_ns for sample in samples] == sorted(sample.t_ns for sample in samples)
    assert too_late > 0
    assert kinds(source) == ['late']
    assert f'{too_late} of /ceiling_camera/features' in str(source.warnings[0])


def test_a_recording_that_begins_before_the_clock_is_set_is_refused(tmp_path: Path) -> None:
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for number, sample in enumerate(drive()):
            bag.write(sample, recorded_ns=sample.t_ns if number > 300 else 10 * NS_PER_S + number)
    with pytest.raises(RecordingError, match='lasts more than a year: the clock of the computer was set'):
        open_bag(tmp_path / 'bag', CONFIG)


@pytest.mark.parametrize('step_s', [50, -50])
def test_a_step_of_the_clock(tmp_path: Path, step_s: int) -> None:
    first, second = drive(), drive(start_ns=START_NS + (10 + step_s) * NS_PER_S)
    step = ClockStep(second[0].t_ns, step_s * NS_PER_S)
    samples = read(write(tmp_path / 'bag', [*first, step, *second]), with_covariates=True)
    (index,) = (number for number, sample in enumerate(samples) if isinstance(sample, ClockStep))
    assert samples[index].t_ns == second[0].t_ns
    assert_same(samples[:index], first)
    assert_same(samples[index + 1 :], second)


def test_a_pause_of_a_recording_is_no_step_of_the_clock(tmp_path: Path) -> None:
    first, second = drive(), drive(start_ns=START_NS + 36 * NS_PER_S)
    samples = read(write(tmp_path / 'bag', [*first, *second]), with_covariates=True)
    assert not any(isinstance(sample, ClockStep) for sample in samples)
    assert_same(samples, [*first, *second])


def test_a_recording_that_begins_anew_after_minutes_starts_a_new_time_base(tmp_path: Path) -> None:
    first, second = drive(), drive(start_ns=START_NS + 3600 * NS_PER_S)
    samples = read(write(tmp_path / 'bag', [*first, *second]), with_covariates=True)
    assert sum(isinstance(sample, ClockStep) for sample in samples) == 1


def test_a_step_shows_although_the_times_of_recording_mean_nothing(tmp_path: Path) -> None:
    second = drive(20.0, start_ns=START_NS - 40 * NS_PER_S)
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for sample in [*drive(), *second]:
            bag.write(sample, recorded_ns=START_NS)
    samples = read(tmp_path / 'bag')
    assert [sample.t_ns for sample in samples if isinstance(sample, ClockStep)] == [second[0].t_ns]


def test_single_outlying_stamps_are_left_out(tmp_path: Path) -> None:
    outlier_ns = drive()[500].t_ns
    samples = changed(
        drive(),
        ImuSample,
        lambda item: replace(item, t_ns=0) if abs(item.t_ns - outlier_ns) < 5_000_000 else item,
    )
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for original, sample in zip(drive(), samples, strict=True):
            bag.write(sample, recorded_ns=original.t_ns)
    source = open_bag(tmp_path / 'bag', CONFIG)
    assert len(of(list(source.measurements()), ImuSample)) == 999
    assert kinds(source) == ['odd_stamp']


def with_nan(every: int) -> Iterator[Measurement]:
    def with_nan_rate(sample: Any) -> ImuSample:
        number = round((sample.t_ns - START_NS) / 1e7)
        return replace(sample, rate_rad_s=(0.0, float('nan'), 0.0)) if number % every == 3 else sample

    return changed(drive(), ImuSample, with_nan_rate)


def test_nan_is_left_out_and_counted(tmp_path: Path) -> None:
    source = open_bag(write(tmp_path / 'bag', with_nan(100)), CONFIG)
    assert len(of(list(source.measurements()), ImuSample)) == 990
    assert kinds(source) == ['meaningless']
    assert '10 of /imu/data_raw' in str(source.warnings[0])


def test_too_many_nan_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match='/imu/data_raw: the numbers are not finite'):
        read(write(tmp_path / 'bag', with_nan(5)))


def test_optional_topics_may_be_faulty(tmp_path: Path) -> None:
    samples = [
        replace(sample, temperature_c=float('nan')) if isinstance(sample, TemperatureSample) else sample
        for sample in drive(20.0)
    ]
    source = open_bag(write(tmp_path / 'bag', samples), CONFIG)
    assert not of(list(source.measurements()), TemperatureSample)
    assert kinds(source) == ['meaningless']


# --- images --------------------------------------------------------------------------------------


def film(shape: tuple[int, int] = (48, 64)) -> list[Measurement]:
    """Return the drive with images in place of features."""
    grey = np.arange(shape[0] * shape[1], dtype=np.uint8).reshape(shape)
    return [
        Frame(sample.t_ns, np.roll(grey, number)) if isinstance(sample, FeatureObservations) else sample
        for number, sample in enumerate(drive())
    ]


def test_images_are_grey_and_in_order(tmp_path: Path) -> None:
    with new_bag(tmp_path / 'bag', jpeg_quality=None) as bag:
        bag.write_rig(RIG, START_NS)
        for sample in film():
            bag.write(sample)
    frames, written = of(read(tmp_path / 'bag'), Frame), of(film(), Frame)
    for frame, there in zip(frames, written, strict=True):
        assert frame.t_ns == there.t_ns
        np.testing.assert_array_equal(frame.image, there.image)


def test_features_are_preferred_to_images_by_default(tmp_path: Path) -> None:
    both = sorted([*film(), *of(drive(), FeatureObservations)], key=lambda sample: sample.t_ns)
    path = write(tmp_path / 'bag', both)
    assert {FeatureObservations} == {type(item) for item in read(path)} & {FeatureObservations, Frame}
    images = with_settings(CONFIG, {'recording': {'use_images': True}})
    assert {Frame} == {type(item) for item in read(path, images)} & {FeatureObservations, Frame}


def test_images_of_another_size_than_the_calibration_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match='an image has 32x24 pixels, its camera_info says 64x48'):
        read(write(tmp_path / 'bag', film((24, 32))))


# --- damaged files -------------------------------------------------------------------------------


def refused(path: Path) -> str:
    """Return the error message with which a recording is refused."""
    with pytest.raises(RecordingError) as caught:
        read(path)
    line = str(caught.value)
    assert '\n' not in line
    assert str(path) in line
    return line


def test_no_such_bag(tmp_path: Path) -> None:
    assert 'no such bag' in refused(tmp_path / 'nothing')


def test_not_a_bag(tmp_path: Path) -> None:
    (tmp_path / 'notes.txt').write_text('hello')
    assert 'is not a bag' in refused(tmp_path / 'notes.txt')
    assert 'is not a bag' in refused(tmp_path)
    for name in ('a.bag', 'a.mcap', 'a.db3'):
        (tmp_path / name).write_text('hello, this is no recording at all, whatever its name may say')
        assert 'damaged' in refused(tmp_path / name)
        (tmp_path / name).write_bytes(b'')
        assert 'damaged' in refused(tmp_path / name) or 'empty' in refused(tmp_path / name)


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_an_empty_bag(tmp_path: Path, plugin: StoragePlugin) -> None:
    with rosbag2.Writer(tmp_path / 'bag', version=9, storage_plugin=plugin) as writer:
        writer.add_connection('/imu/data_raw', topics.IMU, typestore=STORE)
    assert 'the bag is empty' in refused(tmp_path / 'bag')


def test_a_recording_that_was_not_closed(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag')
    (path / 'metadata.yaml').unlink()
    assert 'ros2 bag reindex' in refused(path)


def test_damaged_metadata(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag')
    for text in ('', 'a: [', 'rosbag2_bagfile_information: 3', 'rosbag2_bagfile_information: {version: 9}'):
        (path / 'metadata.yaml').write_text(text)
        assert 'damaged' in refused(path)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_file_that_the_metadata_list_twice(tmp_path: Path, storage: Storage) -> None:
    path = write(tmp_path / 'bag', storage=storage)
    name, metadata = data_file(path).name, path / 'metadata.yaml'
    once, twice = f'- {name}\n', f'- {name}\n  - {name}\n'
    text = metadata.read_text()
    assert text.count(once) == 1
    metadata.write_text(text.replace(once, twice))
    assert 'lists a file twice' in refused(path)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('kept', [0.02, 0.5, 0.99])
def test_a_truncated_file(tmp_path: Path, storage: Storage, kept: float) -> None:
    path = write(tmp_path / 'bag', storage=storage)
    content = data_file(path).read_bytes()
    data_file(path).write_bytes(content[: int(kept * len(content))])
    assert 'damaged or cut short' in refused(path)


@pytest.mark.slow
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_damage_in_the_middle_causes_no_crash(tmp_path: Path, storage: Storage) -> None:
    """Messages in the damaged part may be lost silently by the format, but never cause a crash."""
    path = write(tmp_path / 'bag', storage=storage)
    content = bytearray(data_file(path).read_bytes())
    for start in range(len(content) // 10, len(content), len(content) // 10):
        broken = content.copy()
        broken[start : start + 3000] = bytes(len(broken[start : start + 3000]))
        data_file(path).write_bytes(broken)
        try:
            read(path)
        except RecordingError as error:
            assert '\n' not in str(error)


# --- third-party recordings ----------------------------------------------------------------------


@pytest.mark.skipif(not SHARED.is_dir(), reason='the third-party recordings are missing')
class TestThirdPartyRecordings:
    @pytest.mark.slow
    def test_an_upside_down_imu_whose_accelerometer_contradicts_it(self) -> None:
        source = open_bag(
            SHARED / 'test1_2014_xsens_wheel_stereo.bag',
            CONFIG,
            remap={'imu/data_raw': '/xsens/imu_data', 'wheel/odometry': '/wheel_odometry'},
            heading_reference='/stereo_odometer/odometry',
        )
        samples = list(source.measurements())
        assert Counter(map(type, samples)) == {ImuSample: 13334, WheelSample: 1294, HeadingSample: 1313}
        assert [warning.kind for warning in source.warnings] == ['imu_mount']
        yaws = np.unwrap([sample.yaw_rad for sample in of(samples, HeadingSample)])
        turn = sum(sample.rate_rad_s[2] for sample in of(samples, ImuSample)) / 100.0
        assert turn == pytest.approx(yaws[-1] - yaws[0], rel=0.1)

    @pytest.mark.slow
    def test_an_imu_whose_vertical_axis_is_y(self) -> None:
        source = open_bag(
            SHARED / 'test1_husky.bag',
            CONFIG,
            remap={'imu/data_raw': '/imu/data', 'wheel/odometry': '/husky_velocity_controller/odom'},
            heading_reference='/husky_velocity_controller/odom',
        )
        forces = [sample.specific_force_m_s2 for sample in of(list(source.measurements()), ImuSample)]
        assert np.mean(forces, axis=0) == pytest.approx([0.0, 0.0, 9.8], abs=0.3)

    def test_an_upright_imu_is_not_rotated(self) -> None:
        source = open_bag(
            SHARED / 'test2_jackal.bag',
            CONFIG,
            remap={'imu/data_raw': '/imu/data'},
            heading_reference='/jackal_velocity_controller/odom',
        )
        assert [warning.kind for warning in source.warnings] == ['missing_topic']
        assert len(of(list(source.measurements()), ImuSample)) == 3061
