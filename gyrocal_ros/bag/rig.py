"""Geometry of the robot, read from a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, repeat
from typing import TypeVar

import numpy as np

from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.bag.topic_stats import TurnStats, compare_turns
from gyrocal_ros.config.sections import CameraConfig
from gyrocal_ros.data import NS_PER_S, Array, CameraIntrinsics, HeadingSample, IntArray, Mount, Rig
from gyrocal_ros.errors import MessageError, RecordingError
from gyrocal_ros.msgs import clouds
from gyrocal_ros.msgs.headings import FrameHeading, HeadingName, heading_conversion
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.mounts import (
    REST_NS,
    imu_rotation,
    missing_camera_transform,
    mount_from_settings,
    mount_from_transforms,
)
from gyrocal_ros.msgs.plausible import MAX_READING, plausible
from gyrocal_ros.msgs.topics import (
    BODY_FRAME,
    IMU_SAMPLE,
    STAMP_FIELDS,
    FieldConversion,
    Role,
    camera_intrinsics,
    transforms,
)
from gyrocal_ros.msgs.transforms import Transform

TURN_COMPARISON_NS = 300 * NS_PER_S
"""Time at the start over which the turns of gyro and heading reference are compared."""
MIN_OPPOSITE_CORRELATION = 0.8
"""Minimum size of a negative correlation of their turns for them to count as opposite."""

MAX_OFF_CENTRE = 0.2
"""Distance of the principal point from the centre, as a part of the image, that is reported."""
MAX_REACH, REACHED, LISTS = 1.1, 0.9, 50
"""Pixel below which this part of the features lies, relative to the image of camera_info, and number of
lists of features that are read for that."""

STAMP_END = 12
"""Length of a serialised message up to the end of its stamp, in ROS 1 and ROS 2."""

T = TypeVar('T')


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Mounting of the sensors."""

    rig: Rig
    R_bi: Array
    """(3, 3) from the IMU's axes to body axes."""
    issues: tuple[BagIssue, ...]
    """Assumptions that had to be made."""


def read_geometry(storage: Storage, selection: Selection, config: CameraConfig) -> Geometry:
    """Read camera calibration and mounts.

    A mount without a transform is taken from the settings (camera), or from gravity and turns (IMU).

    Args:
        storage: the open recording.
        selection: its topics.
        config: mounting of the camera if the recording does not contain it.

    Raises:
        RecordingError: the camera is not calibrated, or a message is damaged.
    """
    links = read_static_transforms(storage, selection)
    issues: list[BagIssue] = []
    rig = read_rig(storage, selection, links, config, issues)
    R_bi = read_imu_rotation(storage, selection.topics[Role.IMU], links, selection, issues)
    return Geometry(rig, R_bi, tuple(issues))


def read_rig(
    storage: Storage,
    selection: Selection,
    links: Sequence[Transform],
    config: CameraConfig,
    issues: list[BagIssue],
) -> Rig:
    """Return the camera, if one is in use, and its mount on the robot.

    Args:
        storage: the open recording.
        selection: its topics.
        links: the static transforms.
        config: mounting of the camera if the recording does not contain it.
        issues: list to which assumptions that had to be made are appended.

    Raises:
        RecordingError: the camera is not calibrated, or a message is damaged.
    """
    camera, mount = None, mount_from_settings(config)
    camera_topic = selection.topics.get(Role.FEATURES) or selection.topics.get(Role.IMAGE)
    if camera_topic:
        mount = _camera_mount(storage, camera_topic, links, mount, issues)
        if Role.CAMERA_INFO in selection.topics:
            info = selection.topics[Role.CAMERA_INFO]
            camera = _intrinsics(storage, info, issues)
            issues += _centre_issues(camera, info)
            if Role.FEATURES in selection.topics:
                _require_resolution(storage, camera_topic, camera)
    return Rig(camera, mount)


def read_static_transforms(storage: Storage, selection: Selection) -> list[Transform]:
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
    selection: Selection,
    issues: list[BagIssue],
) -> Array:
    """Return the rotation (3, 3) from an IMU's axes to body axes.

    The rotation is that of the static transform. If there is none, gravity reveals an IMU that is upside
    down or on its side, and a heading reference one that is upside down in contradiction to its
    accelerometer.

    Args:
        storage: the open recording.
        topic: the IMU.
        links: the static transforms.
        selection: the topics, with the heading reference, if any.
        issues: list to which assumptions and contradictions are appended.

    Raises:
        RecordingError: a message is damaged.
    """
    frame = storage.first_message(topic).header.frame_id.lstrip('/')

    def opposite_topic(R_bi: Array) -> str:
        heading, name = selection.topics.get(Role.HEADING), selection.heading
        if heading is None or name is None:
            return ''
        poses = _first_headings(storage, heading, name)
        return heading.name if _turn_opposite(storage, topic, R_bi, poses) else ''

    force = _initial_force(storage, topic)
    R_bi, imu_issues = imu_rotation(topic.name, frame, links, force, opposite_topic)
    issues += imu_issues or _other_imu_frame(topic.name, frame, links)
    return R_bi


def _other_imu_frame(topic: str, frame: str, links: Sequence[Transform]) -> list[BagIssue]:
    """Return an issue if no transform leads to the frame of an IMU, but one to another IMU's."""
    others = [link.child for link in links if 'imu' in link.child.lower()]
    if not others or frame.endswith(BODY_FRAME) or mount_from_transforms(links, frame) is not None:
        return []
    text = f"no transform to its frame {frame!r}, but one to {others[0]!r}; its axes are taken as the robot's"
    todo = 'correct frame_id, or the transform'
    return [BagIssue(Severity.WARNING, 'imu_frame', topic, text, todo)]


def _intrinsics(storage: Storage, topic: Topic, issues: list[BagIssue]) -> CameraIntrinsics:
    """Return the first valid calibration of the camera; an issue is appended if another one follows."""
    found: list[CameraIntrinsics] = []
    problem: RecordingError | None = None
    last = b''
    for _, _, raw in storage.raw_messages([topic]):
        if raw[STAMP_END:] == last:
            continue
        last = raw[STAMP_END:]
        try:
            found.append(camera_intrinsics(storage.message(topic, raw)))
        except MessageError as error:
            place = error.where or f'{storage.path}, {topic.name}'
            problem = problem or RecordingError(error.what, where=place, todo=error.todo)
    if not found:
        raise problem or RecordingError(
            'has no readable messages', where=f'{storage.path}, {topic.name}', todo='record it again'
        )
    if problem or any(camera != found[0] for camera in found):
        text = 'changes during the recording; its first valid calibration is used throughout'
        todo = 'record one camera at one resolution, and calibrate it before'
        issues.append(BagIssue(Severity.WARNING, 'camera_changes', topic.name, text, todo))
    return found[0]


def _centre_issues(camera: CameraIntrinsics, topic: Topic) -> Iterator[BagIssue]:
    """Yield an issue where the principal point is far from the centre of the image."""
    sizes = _sizes(camera)
    off_px = np.array([camera.cx_px, camera.cy_px]) - 0.5 * (sizes - 1)
    if (sizes > 0).all() and (np.abs(off_px) > MAX_OFF_CENTRE * sizes).any():
        centre, size = f'({camera.cx_px:.0f}, {camera.cy_px:.0f})', f'{sizes[0]}x{sizes[1]}'
        text = f'its principal point {centre} is far from the centre of an image of {size} pixels'
        todo = 'if the camera does not read out a part of its sensor, calibrate it at this resolution'
        yield BagIssue(Severity.WARNING, 'off_centre', topic.name, text, todo)


def _sizes(camera: CameraIntrinsics) -> IntArray:
    return np.array([camera.width_px, camera.height_px])


def _require_resolution(storage: Storage, topic: Topic, camera: CameraIntrinsics) -> None:
    """Raise an error where tracked features lie far beyond the image that the camera was calibrated for.

    Raises:
        RecordingError: they do.
    """
    found: list[Array] = [np.zeros((1, 2))]
    for _, _, raw in islice(storage.raw_messages([topic]), LISTS):
        with suppress(MessageError):
            found.append(clouds.features(storage.message(topic, raw)).pixels)
    reach_px, sizes = np.quantile(np.concatenate(found), REACHED, axis=0), _sizes(camera)
    if (sizes > 0).all() and (reach_px > MAX_REACH * sizes).any():
        raise RecordingError(
            f'features lie at ({reach_px[0]:.0f}, {reach_px[1]:.0f}) pixels, '
            f'camera_info is that of {sizes[0]}x{sizes[1]}',
            where=f'{storage.path}, {topic.name}',
            todo='record the camera_info of this camera at the resolution of its images',
        )


def _camera_mount(
    storage: Storage, topic: Topic, links: Sequence[Transform], assumed: Mount, issues: list[BagIssue]
) -> Mount:
    frame = storage.first_message(topic).header.frame_id.lstrip('/')
    mount = mount_from_transforms(links, frame)
    if mount is None:
        issues.append(missing_camera_transform(topic.name, frame))
    return mount or assumed


def _initial_force(storage: Storage, topic: Topic) -> Array:
    """Return the mean accelerometer reading (3,) at the start of the recording; zeros if there is none."""
    forces = [sample.specific_force_m_s2 for sample in _first_samples(storage, topic, IMU_SAMPLE, REST_NS)]
    return np.mean(forces, axis=0) if forces else np.zeros(3)


def _turn_opposite(storage: Storage, imu: Topic, R_bi: Array, poses: list[HeadingSample]) -> bool:
    """Return True if an IMU and a heading reference turn in opposite directions."""
    by_gyro, by_heading = TurnStats(), TurnStats()
    samples = _first_samples(storage, imu, IMU_SAMPLE, TURN_COMPARISON_NS)
    rates = np.array([sample.rate_rad_s for sample in samples]).reshape(-1, 3)
    by_gyro.add(np.array([sample.t_ns for sample in samples]), rates @ R_bi[2])
    yaws = np.array([pose.yaw_rad for pose in poses])
    by_heading.add_headings(np.array([pose.t_ns for pose in poses]), yaws)
    compared = compare_turns(by_gyro, by_heading)
    return compared is not None and compared.correlation < -MIN_OPPOSITE_CORRELATION


def _first_headings(storage: Storage, topic: Topic, name: HeadingName) -> list[HeadingSample]:
    """Return the headings of a reference over the first `TURN_COMPARISON_NS`."""
    if name.frames is None:
        conversion = heading_conversion(topic.type_name, name)
        found = _first_samples(storage, topic, conversion, TURN_COMPARISON_NS)
        return [sample for sample in found if math.isfinite(sample.yaw_rad)]
    frames, samples = FrameHeading(*name.frames), list[HeadingSample]()
    for message in storage.messages(topic):
        sample = frames.add(message)
        if sample:
            samples.append(sample)
            if sample.t_ns > samples[0].t_ns + TURN_COMPARISON_NS:
                break
    return samples


def _first_samples(storage: Storage, topic: Topic, conversion: FieldConversion[T], length_ns: int) -> list[T]:
    """Return the samples of a topic over its first `length_ns`, without invalid ones."""
    read = storage.reader_of(topic, conversion.fields)
    samples: list[T] = []
    start_ns: int | None = None
    for _, recorded_ns, raw in storage.raw_messages([topic]):
        start_ns = recorded_ns if start_ns is None else start_ns
        if recorded_ns > start_ns + length_ns:
            break
        try:
            values = read(raw)
        except MessageError:
            continue
        if plausible(values[len(STAMP_FIELDS) :], repeat(MAX_READING)):
            samples.append(conversion.build(*values))
    return samples
