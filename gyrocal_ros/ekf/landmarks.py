"""The map: features join at first sight and leave when they are of no more use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.ekf.state import POSE, Landmarks, State, no_landmarks
from gyrocal_ros.model.features.base import NewFeatures


def augment(state: State, ids: IntArray, new: NewFeatures) -> State:
    """Eq. (18): add m features; the new block of P is `Jx P Jx^T + Jz R Jz^T`, with cross terms."""
    count = len(ids)
    n, size = len(state.mean), 3 * count
    by_pose = new.by_pose.reshape(size, 6)
    cross = by_pose @ state.covariance[POSE]
    covariance = np.empty((n + size, n + size))
    covariance[:n, :n] = state.covariance
    covariance[n:, :n] = cross
    covariance[:n, n:] = cross.T
    own = cross[:, POSE] @ by_pose.T
    blocks = own.reshape(count, 3, count, 3)
    blocks[np.arange(count), :, np.arange(count), :] += new.noise
    covariance[n:, n:] = own
    old = state.landmarks
    landmarks = Landmarks(
        ids=np.concatenate([old.ids, ids]),
        anchors=old.anchors.joined(new.anchors),
        last_seen_ns=np.concatenate([old.last_seen_ns, np.full(count, state.t_ns)]),
        rejections=np.concatenate([old.rejections, np.zeros(count, np.int64)]),
    )
    mean = np.concatenate([state.mean, new.parameters.ravel()])
    return replace(state, mean=mean, covariance=covariance, landmarks=landmarks)


def keep(state: State, kept: np.ndarray) -> State:
    """Forget the features that are not kept, (m,) bool: their rows and columns go, nothing else."""
    if kept.all():
        return state
    entries = np.concatenate([np.ones(state.robot_size, bool), np.repeat(kept, 3)])
    return replace(
        state,
        mean=state.mean[entries],
        covariance=state.covariance[np.ix_(entries, entries)],
        landmarks=state.landmarks[kept],
    )


def forget_all(state: State) -> State:
    """Drop the whole map."""
    r = state.robot_size
    return replace(state, mean=state.mean[:r], covariance=state.covariance[:r, :r], landmarks=no_landmarks())


def note_sighting(state: State, accepted: IntArray, rejected: IntArray, drop_after: int) -> State:
    """Count who was seen and who was an outlier; drop those that were outliers too often in a row."""
    landmarks = state.landmarks
    last_seen_ns, rejections = landmarks.last_seen_ns.copy(), landmarks.rejections.copy()
    last_seen_ns[accepted] = state.t_ns
    rejections[accepted] = 0
    rejections[rejected] += 1
    state = replace(state, landmarks=replace(landmarks, last_seen_ns=last_seen_ns, rejections=rejections))
    return keep(state, rejections < drop_after)


def make_room(state: State, wanted: int, map_size: int) -> State:
    """Drop the features unseen for longest until `wanted` new ones fit into the map."""
    surplus = len(state.landmarks.ids) + wanted - map_size
    if surplus <= 0:
        return state
    oldest = np.argsort(state.landmarks.last_seen_ns, kind='stable')[:surplus]
    kept = np.ones(len(state.landmarks.ids), bool)
    kept[oldest] = False
    return keep(state, kept)
