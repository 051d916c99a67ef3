"""The geometry of the robot, as a recording tells it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import DAMAGED, Storage, Topic, damaged_message
from gyrocal_ros.bag.topic_stats import TurnStats, compare_turns
from gyrocal_ros.config.sections import CameraConfig
from gyrocal_ros.data import NS_PER_S, Array, CameraIntrinsics, Mount, Rig
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.msgs.mounts import (
    REST_NS,
    imu_rotation,
    mount_of_frame,
    mount_of_settings,
    no_camera_transform,
)
from gyrocal_ros.msgs.topics import (
    IMU_SAMPLE,
    FlatMessage,
    Role,
    camera_intrinsics,
    heading_sample,
    transforms,
)
from gyrocal_ros.msgs.transforms import Transform

TURNS_NS = 300 * NS_PER_S
"""So much of it tells whether gyro and heading reference turn the same way."""
CLEAR_CORRELATION = 0.8

T = TypeVar('T')


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Where the sensors sit."""

    rig: Rig
    R_bi: Array
    """(3, 3) from the IMU's axes to body axes."""
    findings: tuple[BagIssue, ...]
    """What had to be assumed."""


def read_geometry(storage: Storage, selection: Selection, config: CameraConfig) -> Geometry:
    """Read camera calibration and mounts; what no transform says comes from settings, gravity and turns.

    Args:
        storage: the open recording.
        selection: its topics.
        config: how the camera is mounted where the recording does not say it.

    Raises:
        RecordingError: the camera is not calibrated, or a message is damaged.
    """
    links = read_links(storage, selection)
    findings: list[BagIssue] = []
    rig = read_rig(storage, selection, links, config, findings)
    heading = selection.topics.get(Role.HEADING)
    R_bi = read_imu_rotation(storage, selection.topics[Role.IMU], links, heading, findings)
    return Geometry(rig, R_bi, tuple(findings))


def read_rig(
    storage: Storage,
    selection: Selection,
    links: Sequence[Transform],
    config: CameraConfig,
    findings: list[BagIssue],
) -> Rig:
    """Return the camera, if one is in use, and how it sits on the robot.

    Args:
        storage: the open recording.
        selection: its topics.
        links: the static transforms.
        config: how the camera is mounted where the recording does not say it.
        findings: what had to be assumed is added to them.

    Raises:
        RecordingError: the camera is not calibrated, or a message is damaged.
    """
    camera, mount = None, mount_of_settings(config)
    camera_topic = selection.topics.get(Role.FEATURES) or selection.topics.get(Role.IMAGE)
    if camera_topic:
        mount = _camera_mount(storage, camera_topic, links, mount, findings)
        if Role.CAMERA_INFO in selection.topics:
            camera = _intrinsics(storage, selection.topics[Role.CAMERA_INFO])
    return Rig(camera, mount)


def read_links(storage: Storage, selection: Selection) -> list[Transform]:
    """Return all static transforms.

    Raises:
        RecordingError: a message is damaged.
    """
    return [
        link
        for topic in selection.static_transforms
        for message in storage.messages(topic)
        for link in transforms(message)
    ]


def read_imu_rotation(
    storage: Storage,
    topic: Topic,
    links: Sequence[Transform],
    heading: Topic | None,
    findings: list[BagIssue],
) -> Array:
    """Return the rotation (3, 3) from an IMU's axes to body axes.

    A transform says it; without one, gravity tells an IMU that is upside down or on its side, and a
    heading reference one that is upside down though its accelerometer denies it.

    Args:
        storage: the open recording.
        topic: the IMU.
        links: the static transforms.
        heading: the heading reference, if any.
        findings: what had to be assumed, or is contradictory, is added to them.

    Raises:
        RecordingError: a message is damaged.
    """
    frame = storage.first_message(topic).header.frame_id.lstrip('/')

    def turned_against(R_bi: Array) -> str:
        return heading.name if heading and _turns_against(storage, topic, R_bi, heading) else ''

    force = _starting_force(storage, topic)
    R_bi, problems = imu_rotation(topic.name, frame, links, force, turned_against)
    findings += problems
    return R_bi


def _intrinsics(storage: Storage, topic: Topic) -> CameraIntrinsics:
    try:
        return camera_intrinsics(storage.first_message(topic))
    except RecordingError as error:
        place = error.where or f'{storage.path}, {topic.name}'
        raise RecordingError(error.what, where=place, todo=error.todo) from error


def _camera_mount(
    storage: Storage, topic: Topic, links: Sequence[Transform], assumed: Mount, findings: list[BagIssue]
) -> Mount:
    frame = storage.first_message(topic).header.frame_id.lstrip('/')
    mount = mount_of_frame(links, frame)
    if mount is None:
        findings.append(no_camera_transform(topic.name, frame))
    return mount or assumed


def _starting_force(storage: Storage, topic: Topic) -> Array:
    """Mean accelerometer reading (3,) over the start of the recording; zeros where there is none."""
    forces = [sample.specific_force_m_s2 for sample in _start(storage, topic, IMU_SAMPLE, REST_NS)]
    return np.mean(forces, axis=0) if forces else np.zeros(3)


def _turns_against(storage: Storage, imu: Topic, R_bi: Array, heading: Topic) -> bool:
    """Whether an IMU and a heading reference turn in opposite directions."""
    by_gyro, by_heading = TurnStats(), TurnStats()
    samples = _start(storage, imu, IMU_SAMPLE, TURNS_NS)
    rates = np.array([sample.rate_rad_s for sample in samples]).reshape(-1, 3)
    by_gyro.add(np.array([sample.t_ns for sample in samples]), rates @ R_bi[2])
    poses = _start(storage, heading, heading_sample(heading.type_name), TURNS_NS)
    yaws = np.array([pose.yaw_rad for pose in poses])
    by_heading.add_headings(np.array([pose.t_ns for pose in poses]), yaws)
    agreement = compare_turns(by_gyro, by_heading)
    return agreement is not None and agreement.correlation < -CLEAR_CORRELATION


def _start(storage: Storage, topic: Topic, conversion: FlatMessage[T], length_ns: int) -> list[T]:
    """Return what a topic holds over its first `length_ns`; NaN are left out."""
    read = storage.reader_of(topic, conversion.fields)
    samples: list[T] = []
    start_ns: int | None = None
    for _, recorded_ns, raw in storage.raw_messages([topic]):
        start_ns = recorded_ns if start_ns is None else start_ns
        if recorded_ns > start_ns + length_ns:
            break
        try:
            values = read(raw)
        except DAMAGED as error:
            raise damaged_message(storage.path, topic.name, error) from error
        if math.isfinite(sum(values)):
            samples.append(conversion.build(*values))
    return samples
