"""The map: features are added at the first observation and removed when they are no longer useful."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.state import POSE, Landmarks, State, unknown_noise
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
) -> State:
    """Eq. (18): add m features; the new block of P is `Jx P Jx^T + Jz R Jz^T`, with cross terms.

    Args:
        state: the state before.
        ids: (m,)
        pixels: (m, 2) their observations.
        directions: (m, 2) the same as x/z, y/z in the optical frame.
        new: the features at their first observation.
        by_values: (m, 3, k) their derivative with respect to the coefficients; None for zero.
        by_candidates: (m, 3, c) the same for effects that the model lacks.
    """
    count, r = len(ids), state.robot_size
    n, size = len(state.mean), 3 * count
    by_robot = np.zeros((size, r))
    by_robot[:, POSE] = new.by_pose.reshape(size, 6)
    if by_values is not None:
        by_robot[:, state.coefficient_columns] = by_values.reshape(size, -1)
    cross = by_robot @ state.covariance[:r]
    covariance = np.empty((n + size, n + size))
    covariance[:n, :n] = state.covariance
    covariance[n:, :n] = cross
    covariance[:n, n:] = cross.T
    own = cross[:, :r] @ by_robot.T
    blocks = own.reshape(count, 3, count, 3)
    blocks[np.arange(count), :, np.arange(count), :] += new.noise
    covariance[n:, n:] = own
    old = state.landmarks
    landmarks = Landmarks(
        ids=np.concatenate([old.ids, ids]),
        anchors=old.anchors.joined(new.anchors),
        last_seen_ns=np.concatenate([old.last_seen_ns, np.full(count, state.t_ns)]),
        rejections=np.concatenate([old.rejections, np.zeros(count, np.int64)]),
        last_pixels=np.concatenate([old.last_pixels, pixels]),
        last_directions=np.concatenate([old.last_directions, directions]),
        noise=old.noise.joined(unknown_noise(count)),
        first_variance_m2=np.concatenate(
            [old.first_variance_m2, np.full(count, position_variance_m2(state))]
        ),
    )
    mean = np.concatenate([state.mean, new.parameters.ravel()])
    sensitivity = by_robot @ state.sensitivity[:r]
    if by_candidates is not None:
        sensitivity += by_candidates.reshape(size, -1)
    sensitivity = np.concatenate([state.sensitivity, sensitivity])
    return changed(state, mean=mean, covariance=covariance, landmarks=landmarks, sensitivity=sensitivity)


def position_variance_m2(state: State) -> float:
    """Return the variance of the position of the robot, summed over the axes."""
    P = state.covariance
    return float(P[0, 0] + P[1, 1] + P[2, 2])


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


def keep(state: State, kept: np.ndarray) -> State:
    """Remove the features that are not kept, (m,) bool, with their rows and columns."""
    if np.count_nonzero(kept) == len(kept):
        return state
    entries = np.concatenate([np.ones(state.robot_size, bool), np.repeat(kept, 3)])
    return changed(
        state,
        mean=state.mean[entries],
        covariance=state.covariance[np.ix_(entries, entries)],
        landmarks=state.landmarks[kept.nonzero()[0]],
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
    return keep(changed(state, landmarks=landmarks), rejections < drop_after)


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
