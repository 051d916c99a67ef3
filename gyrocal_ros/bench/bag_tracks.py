"""Errors of the tracks of a recording of images that contains the true poses of the robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from gyrocal_ros.bag.selection import select_topics
from gyrocal_ros.bag.source import BagSource, open_bag, topic_options
from gyrocal_ros.bag.storage import Storage, open_storage
from gyrocal_ros.bench.track_errors import TrackErrors, track_errors, track_row
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, IntArray, TruthSample, seconds
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs.topics import POSES, Role, stamp_ns
from gyrocal_ros.pipeline.visual_slam import VisualSlam


@dataclass(frozen=True, slots=True, eq=False)
class TruePoses:
    """Poses of the body from a recording; unlike `TruthSample` with roll and pitch."""

    t_ns: IntArray
    """(n,) increasing."""
    positions_m: Array
    """(n, 3)"""
    quaternions: Array
    """(n, 4) x, y, z, w, from the body to the world."""

    def at(self, t_ns: IntArray) -> tuple[Array, Array]:
        """Return attitudes R_wb (k, 3, 3) and positions (k, 3) at times (k,), by cubic splines."""
        time_s, known_s = seconds(t_ns - self.t_ns[0]), seconds(self.t_ns - self.t_ns[0])
        attitude = RotationSpline(known_s, Rotation.from_quat(self.quaternions))
        return attitude(time_s).as_matrix(), CubicSpline(known_s, self.positions_m)(time_s)


def bag_rows(paths: Iterable[Path]) -> Iterator[dict[str, Any]]:
    """Yield the figures of the tracks of each recording, with the default settings; see `track_errors`."""
    for path in paths:
        yield {'bag': path.name} | track_row([bag_track_errors(path, Config())])


def bag_track_errors(path: Path, config: Config) -> TrackErrors:
    """Track the features of a recording, aided by the filter as in `replay`, and return their errors.

    Raises:
        RecordingError: the recording has no images, or no true poses of the robot.
    """
    source = open_bag(path, config)
    with open_storage(path) as storage:
        poses = true_poses(storage, config)
    camera, mount = source.rig.camera, source.rig.camera_mount
    seen = [item for item in tracked(source, config) if poses.t_ns[0] <= item.t_ns <= poses.t_ns[-1]]
    if camera is None or not seen:
        raise RecordingError('has no images of the ceiling', where=str(path), todo='record the camera')
    R_wb, p_wb = poses.at(np.array([item.t_ns for item in seen]))
    return track_errors(camera, seen, R_wb @ mount.R_bs, p_wb + R_wb @ mount.p_bs)


def tracked(source: BagSource, config: Config) -> list[FeatureObservations]:
    """Return the features of all images of a recording."""
    seen: list[FeatureObservations] = []
    stream = VisualSlam(EkfSlam(default_model(), config, source.rig), seen.append)
    for measurement in source.measurements():
        if not isinstance(measurement, TruthSample):
            stream.step(measurement)
    stream.finish()
    return seen


def true_poses(storage: Storage, config: Config) -> TruePoses:
    """Read the true poses of a recording.

    Raises:
        RecordingError: there are none.
    """
    selection = select_topics(storage.topics, topic_options(config.recording, None, None, None))
    topic = selection.topics.get(Role.TRUTH)
    if topic is None:
        raise RecordingError('has no true poses', where=str(storage.path), todo='record the ground truth')
    pose_of = attrgetter(POSES[topic.type_name])
    rows = [_pose(stamp_ns(message), pose_of(message)) for message in storage.messages(topic)]
    return TruePoses(*(np.array(column) for column in zip(*rows, strict=True)))


def _pose(t_ns: int, pose: Any) -> tuple[int, list[float], list[float]]:
    position, orientation = pose.position, pose.orientation
    return (
        t_ns,
        [position.x, position.y, position.z],
        [orientation.x, orientation.y, orientation.z, orientation.w],
    )
