"""Updates: what a measurement teaches. The only room, with predict and landmarks, that writes P."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.state import EULER, YAW, State
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.features.base import Prediction


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """Measured minus expected of the features seen, with everything the update needs."""

    rows: IntArray
    """(m,) which features of the map."""
    residual: Array
    """(m, r)"""
    prediction: Prediction
    gain_numerator: Array
    """(m, r, n) H P: covariance of the innovation with the state."""
    covariance: Array
    """(m, r, m, r) S = H P H^T + R."""
    noise: Array
    """(m, r, r) R"""

    def __getitem__(self, chosen: np.ndarray) -> Innovation:
        p = self.prediction
        return Innovation(
            self.rows[chosen],
            self.residual[chosen],
            Prediction(p.expected[chosen], p.by_pose[chosen], p.by_feature[chosen], p.points_c[chosen]),
            self.gain_numerator[chosen],
            self.covariance[chosen][:, :, chosen],
            self.noise[chosen],
        )

    def own_covariances(self) -> Array:
        """(m, r, r) the blocks of S that belong to each feature alone."""
        each = np.arange(len(self.rows))
        return self.covariance[each, :, each, :]


def innovate(
    state: State, rows: IntArray, prediction: Prediction, measured: Array, noise: Array
) -> Innovation:
    """Compare measurements with the map.

    Args:
        state: predicted to the time of the measurement.
        rows: (m,) which features were seen.
        prediction: what the map says of them.
        measured: (m, r)
        noise: (m, r, r) R of each.
    """
    count, width = measured.shape
    by_pose, by_feature = prediction.by_pose, prediction.by_feature
    columns = state.feature_columns(rows)
    numerator = by_pose @ state.covariance[:6] + by_feature @ state.covariance[columns]
    flat = numerator.reshape(count * width, -1)
    covariance = flat[:, :6] @ by_pose.reshape(-1, 6).T
    own = flat[:, columns].reshape(count * width, count, 3).transpose(1, 0, 2)
    covariance += (own @ by_feature.transpose(0, 2, 1)).transpose(1, 0, 2).reshape(count * width, -1)
    covariance = covariance.reshape(count, width, count, width)
    each = np.arange(count)
    covariance[each, :, each, :] += noise
    return Innovation(rows, measured - prediction.expected, prediction, numerator, covariance, noise)


def mahalanobis(innovation: Innovation) -> Array:
    """Squared distance (m,) of each feature's innovation from zero, by its own covariance."""
    whitened = np.linalg.solve(innovation.own_covariances(), innovation.residual[:, :, None])[:, :, 0]
    return np.einsum('mr,mr->m', innovation.residual, whitened)


def update(state: State, innovation: Innovation) -> tuple[State, float]:
    """One stacked update with all features of an image.

    With L L^T = S and W = L^-1 H P, the covariance loses W^T W: symmetric by construction, and it
    cannot turn indefinite by more than rounding, which is what the Joseph form is used for.

    Returns:
        The state after, and the NIS `nu^T S^-1 nu`.

    Raises:
        FilterDivergedError: S is not positive definite, or the estimate is no longer finite.
    """
    rows = innovation.residual.size
    correction, lost, nis = _solve(
        innovation.residual.reshape(rows),
        innovation.gain_numerator.reshape(rows, -1),
        innovation.covariance.reshape(rows, rows),
    )
    return _corrected(state, correction, lost), nis


def zero_rate_update(
    before: State, after: State, matrix: Array, rotation_std_rad: float, gate: float
) -> State:
    """At rest the robot does not turn: between two moments the Euler angles change by nothing.

    The measurement `euler(after) - euler(before) = 0` shares the gyro noise with the prediction;
    the covariances with the state before, known from the transition, account for that.

    Args:
        before: the state that was predicted from.
        after: the predicted state, same features.
        matrix: (r, r) transition of the robot part.
        rotation_std_rad: how much it may turn and still count as standing.
        gate: chi-square bound (3 degrees of freedom) above which it does turn after all.
    """
    r = len(matrix)
    with_before = np.vstack([matrix @ before.covariance[:r, EULER], before.covariance[r:, EULER]])
    with_change = (after.covariance[:, EULER] - with_before).T
    cross = with_before[EULER]
    change_covariance = after.covariance[EULER, EULER] + before.covariance[EULER, EULER] - cross - cross.T
    change_covariance = change_covariance + rotation_std_rad**2 * np.eye(3)
    residual = before.euler_rad - after.euler_rad
    if residual @ np.linalg.solve(change_covariance, residual) > gate:
        return after
    correction, lost, _ = _solve(residual, with_change, change_covariance)
    return _corrected(after, correction, lost)


def heading_update(state: State, yaw_rad: float, std_rad: float) -> tuple[State, float, float]:
    """A heading by an outside reference, already in the map's frame.

    Returns:
        The state after, the innovation in rad and its standard deviation.
    """
    residual = yaw_rad - state.mean[YAW]
    residual -= 2.0 * math.pi * round(residual / (2.0 * math.pi))
    variance = state.covariance[YAW, YAW] + std_rad**2
    correction, lost, _ = _solve(
        np.array([residual]), state.covariance[YAW : YAW + 1], np.array([[variance]])
    )
    return _corrected(state, correction, lost), residual, math.sqrt(variance)


def _solve(residual: Array, numerator: Array, covariance: Array) -> tuple[Array, Array, float]:
    """Correction of the state (n,), covariance taken away (n, n), and the NIS."""
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as error:
        raise FilterDivergedError(
            'the covariance of the innovation is not positive definite', todo='check the noise settings'
        ) from error
    whitened = np.linalg.solve(factor, np.column_stack([numerator, residual]))
    gain, score = whitened[:, :-1], whitened[:, -1]
    return gain.T @ score, gain.T @ gain, float(score @ score)


def _corrected(state: State, correction: Array, lost: Array) -> State:
    mean = state.mean + correction
    if not np.isfinite(mean).all():
        raise FilterDivergedError('the estimate is no longer finite', todo='check the noise settings')
    return replace(state, mean=mean, covariance=state.covariance - lost)
