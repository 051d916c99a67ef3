"""Writes measurements as a rosbag2 that ROS 2 Jazzy plays and `open_bag` reads."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from gyrocal_ros.bag.storage import ros_types
from gyrocal_ros.data import (
    Array,
    ClockStep,
    CovariateSample,
    FeatureObservations,
    Frame,
    HeadingSample,
    ImuSample,
    Measurement,
    Mount,
    Rig,
    TemperatureSample,
    TruthSample,
    WheelSample,
    seconds,
)
from gyrocal_ros.errors import GyrocalError, RecordingError
from gyrocal_ros.files import new_folder
from gyrocal_ros.msgs import images, to_ros, topics
from gyrocal_ros.msgs.topics import Role

_INFINITE = QosTime(2147483647, 4294967295)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _INFINITE,
    _INFINITE,
    QosLiveliness.AUTOMATIC,
    _INFINITE,
    False,
)
"""QoS that publishers of static transforms offer; `ros2 bag play` offers the recorded one."""


@dataclass(slots=True)
class _WheelPose:
    """Pose that a wheel odometry node integrates from its samples."""

    t_ns: int | None = None
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    travelled_m: float = 0.0
    turned_rad: float = 0.0
    """Sums of the absolute distances and turns."""

    def add(self, sample: WheelSample) -> None:
        """Integrate one sample."""
        dt_s = seconds(sample.t_ns - self.t_ns) if self.t_ns is not None else 0.0
        turn = sample.yaw_rate_rad_s * dt_s
        middle = self.yaw_rad + turn / 2.0
        self.x_m += sample.speed_m_s * dt_s * math.cos(middle)
        self.y_m += sample.speed_m_s * dt_s * math.sin(middle)
        self.yaw_rad += turn
        self.travelled_m += abs(sample.speed_m_s * dt_s)
        self.turned_rad += abs(turn)
        self.t_ns = sample.t_ns

    def message(self, make: to_ros.MessageMaker, sample: WheelSample) -> Any:
        """Return the Odometry of the sample added last."""
        return to_ros.wheels(
            make,
            sample,
            self.x_m,
            self.y_m,
            self.yaw_rad,
            travelled_m=self.travelled_m,
            turned_rad=self.turned_rad,
        )


@dataclass(slots=True)
class _PendingCovariates:
    """Covariates of one message that is not yet complete."""

    topic: str
    t_ns: int
    recorded_ns: int
    numbers: dict[str, float]


class BagWriter:
    """Writes the measurements of one robot; see `new_bag`."""

    def __init__(self, writer: Writer, namespace: str = '', jpeg_quality: int | None = 90) -> None:
        """Wrap an open writer of rosbags; use `new_bag` to create one."""
        self._writer, self._jpeg_quality = writer, jpeg_quality
        self._prefix = f'/{namespace.strip("/")}/' if namespace.strip('/') else '/'
        self._types = ros_types()
        self._make = to_ros.MessageMaker(self._types.types.__getitem__)
        self._connections: dict[str, Connection] = {}
        self._wheel_pose = _WheelPose()
        self._pending: _PendingCovariates | None = None
        self._stepped_ns = 0

    def write_rig(self, rig: Rig, t_ns: int, R_bi: Array | None = None) -> None:
        """Write the geometry of the robot: camera_info and the static transforms of the sensors.

        Args:
            rig: camera and its mount.
            t_ns: time of the messages.
            R_bi: (3, 3) from the IMU's axes to body axes, if they differ; `write` expects
                samples in the IMU's own axes.
        """
        mounts = {}
        if rig.camera:
            mounts[topics.CAMERA_FRAME] = rig.camera_mount
            message = to_ros.camera_info(self._make, rig.camera, t_ns)
            self._write_message(self._prefix + Role.CAMERA_INFO, topics.CAMERA_INFO, message, t_ns)
        if R_bi is not None:
            mounts[topics.IMU_FRAME] = Mount(R_bi, rig.camera_mount.p_bs * 0.0)
        if mounts:
            message = to_ros.static_transforms(self._make, mounts, t_ns)
            name = f'/{topics.STATIC_TRANSFORMS}'
            self._write_message(name, topics.TRANSFORMS, message, t_ns, _LATCHED)

    def write(self, measurement: Measurement, recorded_ns: int | None = None) -> None:
        """Write one measurement.

        Args:
            measurement: a `ClockStep` is not written itself: the times of recording continue evenly
                while the stamps jump. Covariates of one topic and stamp become one message.
            recorded_ns: time of recording; by default that of the measurement.

        Raises:
            RecordingError: no supported message has a field for a covariate.
        """
        if isinstance(measurement, ClockStep):
            self._stepped_ns += measurement.step_ns
            return
        recorded_ns = measurement.t_ns - self._stepped_ns if recorded_ns is None else recorded_ns
        if isinstance(measurement, CovariateSample):
            self._add_covariate(measurement, recorded_ns)
            return
        self.flush()
        name, type_name, message = self._message(measurement)
        self._write_message(self._prefix + name, type_name, message, recorded_ns)

    def flush(self) -> None:
        """Write the pending covariates."""
        if not self._pending:
            return
        pending, self._pending = self._pending, None
        if pending.numbers.keys() <= set(to_ros.BATTERY_NUMBERS):
            type_name, message = topics.BATTERY, to_ros.battery(self._make, pending.t_ns, pending.numbers)
        elif pending.numbers.keys() == {'data'}:
            type_name, message = topics.NUMBER, to_ros.number(self._make, pending.numbers['data'])
        else:
            raise RecordingError(
                f'no message holds {", ".join(pending.numbers)}',
                where=pending.topic,
                todo='use fields of BatteryState, or `data`',
            )
        self._write_message(self._prefix + pending.topic, type_name, message, pending.recorded_ns)

    def _add_covariate(self, sample: CovariateSample, recorded_ns: int) -> None:
        topic, _, field = sample.name.rpartition('.')
        topic = topic.replace('.', '/')
        pending = self._pending
        if pending and (pending.topic, pending.t_ns) == (topic, sample.t_ns):
            pending.numbers[field] = sample.value
            return
        self.flush()
        self._pending = _PendingCovariates(topic, sample.t_ns, recorded_ns, {field: sample.value})

    def _message(self, measurement: Measurement) -> tuple[str, str, Any]:
        """Return topic without namespace, type name and message of a measurement."""
        make = self._make
        match measurement:
            case ImuSample():
                return Role.IMU, topics.IMU, to_ros.imu(make, measurement)
            case WheelSample():
                self._wheel_pose.add(measurement)
                return Role.WHEELS, topics.ODOMETRY, self._wheel_pose.message(make, measurement)
            case FeatureObservations():
                return Role.FEATURES, topics.POINT_CLOUD, to_ros.features(make, measurement)
            case TruthSample():
                return Role.TRUTH, topics.ODOMETRY, to_ros.truth(make, measurement)
            case HeadingSample():
                return Role.HEADING, topics.POSE_STAMPED, to_ros.heading(make, measurement)
            case TemperatureSample():
                return Role.TEMPERATURE, topics.TEMPERATURE, to_ros.temperature(make, measurement)
            case Frame():
                message = images.compressed_image(make, measurement, self._jpeg_quality)
                return f'{Role.IMAGE}/compressed', topics.COMPRESSED_IMAGE, message
        raise TypeError(f'{measurement!r} has no message')

    def _write_message(self, topic: str, type_name: str, message: Any, recorded_ns: int, *qos: Qos) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, type_name, typestore=self._types, offered_qos_profiles=qos
            )
        data = self._types.serialize_cdr(message, type_name, little_endian=True)
        self._writer.write(self._connections[topic], recorded_ns, data)


@contextmanager
def new_bag(
    path: Path,
    storage: Literal['mcap', 'sqlite3'] = 'mcap',
    *,
    overwrite: bool = False,
    namespace: str = '',
    jpeg_quality: int | None = 90,
) -> Iterator[BagWriter]:
    """Create a bag and yield its writer.

    The bag appears under its name when it is complete, and not at all if the block raises an error. The
    same input gives the same bytes.

    Args:
        path: folder to create.
        storage: format of the file; mcap is compressed, sqlite3 is not.
        overwrite: True to write into a folder that is not empty.
        namespace: prefix of all topics except `/tf_static`.
        jpeg_quality: JPEG quality of the images, 1 to 100; None for PNG, which is lossless.

    Raises:
        GyrocalError: the folder cannot be written.
    """
    path = path.resolve()
    if not path.name:
        raise GyrocalError('is no name for a bag', where=str(path), todo='choose another name')
    with new_folder(path, overwrite=overwrite) as folder:
        inner = folder / path.name  # rosbags creates the folder itself and names the file after it
        plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
        writer = Writer(inner, version=9, storage_plugin=plugin)
        if plugin is StoragePlugin.MCAP:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            bag = BagWriter(writer, namespace, jpeg_quality)
            yield bag
            bag.flush()
        for file in inner.iterdir():
            file.replace(folder / file.name)
        inner.rmdir()
