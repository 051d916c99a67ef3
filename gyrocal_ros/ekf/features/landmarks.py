"""The map: features are added at the first observation and removed when they are no longer useful."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.state.layout import POSE, Landmarks, State, unknown_noise
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.features.base import NewFeatures


def augment(
    state: State,
    ids: IntArray,
    pixels: Array,
    directions: Array,
    new: NewFeatures,
    by_values: Array | None,
    by_candidates: Array | None,
    by_stamp: Array | None = None,
) -> State:
    """Eq. (18): add m features; the new block of P is `Jx P Jx^T + Jz R Jz^T`, with cross terms.

    An error of the stamp puts all of them where they are seen from another pose.

    Features with an anchor share a new one, which follows them in the state.

    Args:
        state: the state before.
        ids: (m,)
        pixels: (m, 2) their observations.
        directions: (m, 2) the same as x/z, y/z in the optical frame.
        new: the features at their first observation.
        by_values: (m, 3, k) their derivative with respect to the coefficients; None for zero.
        by_candidates: (m, 3, c) the same for effects that the model lacks.
        by_stamp: (6,) change of the pose in a standard deviation of the stamp; None for zero.
    """
    count, r = len(ids), state.robot_size
    by_pose, parameters = new.by_pose.reshape(-1, 6), new.parameters.ravel()
    if new.anchor_by_pose is not None:
        by_pose = np.concatenate([by_pose, new.anchor_by_pose])
        parameters = np.concatenate([parameters, new.anchors.p_wc[0]])
    n, size = len(state.mean), len(parameters)
    by_robot = np.zeros((size, r))
    by_robot[:, POSE] = by_pose
    if by_values is not None:
        by_robot[: 3 * count, state.coefficient_columns] = by_values.reshape(3 * count, -1)
    cross = by_robot @ state.covariance[:r]
    own = cross[:, :r] @ by_robot.T
    blocks = own[: 3 * count, : 3 * count].reshape(count, 3, count, 3)
    blocks[np.arange(count), :, np.arange(count), :] += new.noise
    if by_stamp is not None:
        moved = by_pose @ by_stamp
        own += moved[:, None] * moved
    sensitivity = by_robot @ state.sensitivity[:r]
    if by_candidates is not None:
        sensitivity[: 3 * count] += by_candidates.reshape(3 * count, -1)
    # Behind the features, before the anchors.
    order = np.insert(np.arange(n), state.anchors_start, n + np.arange(3 * count))
    order = np.concatenate([order, np.arange(n + 3 * count, n + size)])
    return changed(
        state,
        mean=np.concatenate([state.mean, parameters])[order],
        covariance=np.block([[state.covariance, cross.T], [cross, own]])[np.ix_(order, order)],
        landmarks=_joined(state, ids, pixels, directions, new),
        sensitivity=np.concatenate([state.sensitivity, sensitivity])[order],
    )


def _joined(state: State, ids: IntArray, pixels: Array, directions: Array, new: NewFeatures) -> Landmarks:
    """Return the properties of the features of the map and of new ones; see `augment`."""
    old, count = state.landmarks, len(ids)
    anchor_row = -1 if new.anchor_by_pose is None else (len(state.mean) - state.anchors_start) // 3
    return Landmarks(
        ids=np.concatenate([old.ids, ids]),
        anchors=old.anchors.joined(new.anchors),
        anchor_rows=np.concatenate([old.anchor_rows, np.full(count, anchor_row)]),
        last_seen_ns=np.concatenate([old.last_seen_ns, np.full(count, state.t_ns)]),
        rejections=np.concatenate([old.rejections, np.zeros(count, np.int64)]),
        last_pixels=np.concatenate([old.last_pixels, pixels]),
        last_directions=np.concatenate([old.last_directions, directions]),
        noise=old.noise.joined(unknown_noise(count)),
    )


def with_shared_errors(state: State, places: IntArray, causes: IntArray, by_causes: Array) -> State:
    """Let q entries of the state err more with p others, see `shift`."""
    covariance, sensitivity = shift(state.covariance, state.sensitivity, places, causes, by_causes)
    return changed(state, covariance=covariance, sensitivity=sensitivity)


@compiled
def shift(
    covariance: Array, sensitivity: Array, places: IntArray, causes: IntArray, by_causes: Array
) -> tuple[Array, Array]:
    """Return covariance (n, n) and sensitivity (n, c) where some entries of the state err more with others.

    Args:
        covariance: P before, (n, n).
        sensitivity: X before, (n, c).
        places: (q,) indices of the entries.
        causes: (p,) indices of the others, none of which is among them.
        by_causes: (q, p) what is added to their derivative by these.
    """
    covariance, sensitivity = covariance.copy(), sensitivity.copy()
    covariance[places] += by_causes @ covariance[causes]
    covariance[:, places] += covariance[:, causes] @ by_causes.T
    sensitivity[places] += by_causes @ sensitivity[causes]
    return covariance, sensitivity


def with_walk(state: State, rows: IntArray, variances: Array) -> State:
    """Let the directions of features walk at random.

    Args:
        state: features are anchored inverse depths.
        rows: (m,) indices of the features.
        variances: (m,) added to that of each coordinate of the direction from the anchor.
    """
    covariance, columns = state.covariance.copy(), state.feature_columns(rows)[:, :2]
    covariance[columns, columns] += variances[:, None]
    return changed(state, covariance=covariance)


def keep(state: State, kept: np.ndarray) -> State:
    """Remove the features that are not kept, (m,) bool, with their rows and columns."""
    if np.count_nonzero(kept) == len(kept):
        return state
    return with_entries(state, np.repeat(kept, 3), state.landmarks[kept.nonzero()[0]])


def with_entries(state: State, features: np.ndarray, landmarks: Landmarks) -> State:
    """Return the state with some entries (3 m,) of the features, and the anchors of its landmarks."""
    is_free = landmarks.anchor_rows >= 0
    used, places = np.unique(landmarks.anchor_rows[is_free], return_inverse=True)
    anchor_rows = landmarks.anchor_rows.copy()
    anchor_rows[is_free] = places
    anchors = state.anchors_start + (3 * used[:, None] + np.arange(3)).ravel()
    entries = np.concatenate([np.arange(state.robot_size), state.robot_size + features.nonzero()[0], anchors])
    return changed(
        state,
        mean=state.mean[entries],
        covariance=state.covariance[np.ix_(entries, entries)],
        landmarks=changed(landmarks, anchor_rows=anchor_rows),
        sensitivity=state.sensitivity[entries],
    )


def forget(state: State, ids: IntArray) -> State:
    """Remove the features of the given ids, where they are in the map."""
    return keep(state, ~np.isin(state.landmarks.ids, ids))


def forget_all(state: State) -> State:
    """Remove the whole map."""
    return keep(state, np.zeros(len(state.landmarks.ids), bool))


def count_matches(
    state: State, rows: IntArray, accepted: np.ndarray, pixels: Array, directions: Array, drop_after: int
) -> State:
    """Count matches and consecutive outliers of the features used; remove those with too many outliers.

    Args:
        state: after the update.
        rows: (m,) indices of the features.
        accepted: (m,) bool, False for an outlier.
        pixels: (m, 2) their observations.
        directions: (m, 2) their expected x/z, y/z in the optical frame.
        drop_after: number of consecutive outliers at which a feature is removed.
    """
    old = state.landmarks
    last_seen_ns, rejections, last_pixels, last_directions = matches_counted(
        old.last_seen_ns,
        old.rejections,
        old.last_pixels,
        old.last_directions,
        state.t_ns,
        rows,
        accepted,
        pixels,
        directions,
    )
    landmarks = changed(
        old,
        last_seen_ns=last_seen_ns,
        rejections=rejections,
        last_pixels=last_pixels,
        last_directions=last_directions,
    )
    counted = changed(state, landmarks=landmarks)
    return counted if max(rejections.tolist()) < drop_after else keep(counted, rejections < drop_after)


@compiled
def matches_counted(
    last_seen_ns: IntArray,
    rejections: IntArray,
    last_pixels: Array,
    last_directions: Array,
    t_ns: int,
    rows: IntArray,
    accepted: np.ndarray,
    pixels: Array,
    directions: Array,
) -> tuple[IntArray, IntArray, Array, Array]:
    """Return the first four arrays, of all M features of the map, after the matches of an image.

    Args:
        last_seen_ns: (M,)
        rejections: (M,)
        last_pixels: (M, 2)
        last_directions: (M, 2)
        t_ns: stamp of the image.
        rows: (m,) indices of the features matched.
        accepted: (m,) bool, False for an outlier.
        pixels: (m, 2) observations.
        directions: (m, 2) expected directions.
    """
    last_seen_ns, rejections = last_seen_ns.copy(), rejections.copy()
    last_pixels, last_directions = last_pixels.copy(), last_directions.copy()
    last_seen_ns[rows[accepted]] = t_ns
    rejections[rows] = np.where(accepted, 0, rejections[rows] + 1)
    last_pixels[rows], last_directions[rows] = pixels, directions
    return last_seen_ns, rejections, last_pixels, last_directions


def mark_seen(state: State, rows: IntArray) -> State:
    """Note that features of the given indices are in view."""
    if len(rows) == 0:
        return state
    last_seen_ns = state.landmarks.last_seen_ns.copy()
    last_seen_ns[rows] = state.t_ns
    return changed(state, landmarks=changed(state.landmarks, last_seen_ns=last_seen_ns))


def evict_oldest(state: State, wanted: int, map_size: int) -> State:
    """Remove features until `wanted` new ones fit into the map.

    Those never found again go first, so that the corners of images in the dark do not drive out the map, then
    those unseen for longest.
    """
    surplus = len(state.landmarks.ids) + wanted - map_size
    if surplus <= 0:
        return state
    last_seen_ns, is_found_again = state.landmarks.last_seen_ns, state.landmarks.noise.weights > 0.0
    oldest = np.lexsort((last_seen_ns, is_found_again | (last_seen_ns == state.t_ns)))[:surplus]
    kept = np.ones(len(state.landmarks.ids), bool)
    kept[oldest] = False
    return keep(state, kept)


@compiled
def match_ids(ids: IntArray, wanted: IntArray) -> tuple[IntArray, IntArray]:
    """Return which of the wanted ids (m,) are among ids (M,), as indices, and the indices of those there."""
    place_of = {feature: place for place, feature in enumerate(ids.tolist())}
    places = np.array([place_of.get(feature, -1) for feature in wanted.tolist()], np.int64)
    known = (places >= 0).nonzero()[0]
    return known, places[known]
