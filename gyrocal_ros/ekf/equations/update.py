"""Measurement updates. Only this module, considered, predict and landmarks change the covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed, quickly_filled
from gyrocal_ros.ekf.equations.feature_scores import FeatureScores
from gyrocal_ros.ekf.noise.stamp_noise import StampError
from gyrocal_ros.ekf.noise.wheel_noise import PositionScore
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, EULER, YAW, State
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.errors import CHECK_THE_SENSORS, FilterDivergedError, IndefiniteCovarianceError
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.features.base import Prediction


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """Innovation of the observed features: measured minus expected, with the matrices for the update."""

    rows: IntArray
    """(m,) indices of the features in the map."""
    residual: Array
    """(m, r)"""
    prediction: Prediction
    stacked: Array
    """(m, r, n + 1 + c) `gain_numerator`, `residual` and `sensitivity` side by side."""
    covariance: Array
    """(m, r, m, r) S = H P H^T + R."""
    noise: Array
    """(m, r, r) R"""
    state_size: int
    """n"""
    whitening: Array | None = None
    """(m r, m r) L^-1 with `L L^T = S`, where that is known already."""

    def __getitem__(self, chosen: IntArray) -> Innovation:
        return Innovation(
            self.rows.take(chosen, 0),
            self.residual.take(chosen, 0),
            self.prediction[chosen],
            self.stacked.take(chosen, 0),
            self.covariance[chosen][:, :, chosen],
            self.noise.take(chosen, 0),
            self.state_size,
        )

    @property
    def gain_numerator(self) -> Array:
        """(m, r, n) H P: cross-covariance of the innovation with the state."""
        return self.stacked[:, :, : self.state_size]

    @property
    def sensitivity(self) -> Array:
        """(m, r, c) G = H X + dh/dtheta of effects that the model lacks.

        It is minus the derivative of the innovation with respect to their coefficients.
        """
        return self.stacked[:, :, self.state_size + 1 :]

    def find_whitening(self) -> Array:
        """Return L^-1, computed where it is not known yet."""
        rows = self.residual.size
        return whitener(self.covariance.reshape(rows, rows)) if self.whitening is None else self.whitening

    def own_covariances(self) -> Array:
        """Return the diagonal blocks (m, r, r) of S: the covariance of each feature alone."""
        each = np.arange(len(self.rows))
        return self.covariance[each, :, each, :]


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class UpdateStats:
    """Statistics of an update."""

    nis: float = 0.0
    """Normalised innovation squared, `nu^T S^-1 nu`."""
    dof: int = 0
    """Degrees of freedom: numbers measured."""
    log_determinant: float = 0.0
    """log det S."""
    information: Array | None = None
    """(c, c) `G^T S^-1 G`; None without candidates."""
    score: Array | None = None
    """(c,) `G^T S^-1 nu`."""

    def of_first(self, count: int) -> UpdateStats:
        """Return the statistics of the first candidates alone."""
        if self.information is None or self.score is None or count == 0:
            return UpdateStats(self.nis, self.dof, self.log_determinant)
        return changed(self, information=self.information[:count, :count], score=self.score[:count])

    @property
    def log_likelihood(self) -> float:
        """Predictive log-likelihood of the measurement: as expected before it was used."""
        return -0.5 * (self.nis + self.log_determinant + self.dof * math.log(2.0 * math.pi))


NONE, NO_FEATURES, NO_DIFFERENCES = np.empty(0), np.empty(0, np.int64), np.empty((0, 2))


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class MeasurementUpdate:
    """Result of one image or heading; empty without a measurement."""

    used: int = 0
    rejected: int = 0
    unmoved: int = 0
    added: int = 0
    on_lens: int = 0
    """Numbers of features used, rejected, not used as unmoved, added, and dropped by the tracker."""
    dropped_ids: IntArray = field(default_factory=lambda: NO_FEATURES)
    """Features removed because they were outliers in several images: points that are not fixed in space."""
    stats: UpdateStats = UpdateStats()
    by_feature: FeatureScores | None = None
    """Scores of the candidates by feature, where there are candidates."""
    compared: tuple[IntArray, Array] = NO_FEATURES, NONE
    """Numbers (m,) of moved features, and their squared distances (m,), see `contradictions`."""
    used_ids: IntArray = field(default_factory=lambda: NO_FEATURES)
    given_others: Array = field(default_factory=lambda: NONE)
    differences: Array = field(default_factory=lambda: NO_DIFFERENCES)
    """Numbers of the features used, the log-likelihood (m,) of each given the others, and its difference
    (m, 2) from these, see `slow_errors`; NaN for one that has not moved in the image, empty if not known."""
    stamp_error: StampError | None = None
    by_position: PositionScore | None = None
    """What the image tells of its stamp, and of the noise of the wheels; None where it tells nothing."""
    heading_rad: float = 0.0
    heading_std_rad: float = float('nan')
    """The innovation as a heading, by the rotation that fits it best, and its std by measurement noise."""
    noise_distances: Array = field(default_factory=lambda: NONE)
    """Squared distances of the features that the pixel noise dominates, see `judged.Judged`."""
    changes_px2: Array = field(default_factory=lambda: NONE)
    """Changes of unmoved features, see `repeated_errors.Motion`."""
    waits: bool = False
    """True while coefficients wait for the camera to move, see `considered`."""
    slip_std: Array | None = None
    """(6,) errors of the pose where the image contradicts only the way by the wheels, see `robust`."""
    contradicts_turn: bool = False
    freed_turn_rad: float = 0.0
    """Correction of the heading where it contradicts the turn by the gyro, and no gyro errs so much, see
    `robust.Freed`; zero elsewhere."""
    event: str = ''
    """Event to report to the user."""


def innovate(
    state: State,
    rows: IntArray,
    prediction: Prediction,
    measured: Array,
    noise: Array,
    by_values: Array | None = None,
    by_candidates: Array | None = None,
) -> Innovation:
    """Compute the innovation of measured features.

    Args:
        state: predicted to the time of the measurement.
        rows: (m,) indices of the observed features.
        prediction: prediction of them by the map.
        measured: (m, r)
        noise: (m, r, r) R of each.
        by_values: (m, r, k) derivative of the prediction by the coefficients, with the anchors where they
            are; None for zero.
        by_candidates: (m, r, c) the same by effects that the model lacks.
    """
    residual, stacked, covariance = innovation_matrices(
        state, rows, prediction, measured, noise, by_values, by_candidates
    )
    return Innovation(rows, residual, prediction, stacked, covariance, noise, len(state.mean))


@compiled
def innovation_matrices(
    state: State,
    rows: IntArray,
    prediction: Prediction,
    measured: Array,
    noise: Array,
    by_values: Array | None,
    by_candidates: Array | None,
) -> tuple[Array, Array, Array]:
    """Return the innovation (m, r), then H P, it and G side by side (m, r, n + 1 + c), and S (m, r, m, r).

    The arguments are those of `innovate`.
    """
    by_pose, by_feature, covariance = prediction.by_pose, prediction.by_feature, state.covariance
    residual, sensitivity = measured - prediction.expected, state.sensitivity
    anchors = state.landmarks.anchors
    (count, width), each = residual.shape, np.arange(len(residual))
    places = state.feature_columns(rows)
    numerator = by_pose @ covariance[:6] + by_feature @ covariance[places]
    G = by_pose @ sensitivity[:6] + by_feature @ sensitivity[places]
    if by_values is not None:
        coefficients = slice(COEFFICIENTS_START, COEFFICIENTS_START + by_values.shape[2])
        by_values = _with_moved(state, by_values, prediction, anchors.by_values[rows])
        numerator += by_values @ covariance[coefficients]
        G += by_values @ sensitivity[coefficients]
    if by_candidates is not None:
        G += _with_moved(state, by_candidates, prediction, anchors.by_candidates[rows])
    columns = state.anchor_columns(rows)
    free = (columns >= 0).nonzero()[0]
    by_anchor, of_anchors = -by_pose[free, :, :3], columns[free, None] + np.arange(3)
    numerator[free] += by_anchor @ covariance[of_anchors]
    G[free] += by_anchor @ sensitivity[of_anchors]
    flat = numerator.reshape(count * width, len(covariance))
    S = flat[:, :6] @ by_pose.reshape(-1, 6).T
    own = flat[:, places].reshape(count * width, count, 3).transpose(1, 0, 2)
    own = (own @ by_feature.transpose(0, 2, 1)).transpose(1, 0, 2)
    S += own.reshape(S.shape)
    if by_values is not None:
        S += flat[:, coefficients] @ by_values.reshape(count * width, -1).T
    S = S.reshape(count, width, count, width)
    S[:, :, free] += np.einsum('prfi,fsi->prfs', numerator[:, :, of_anchors], by_anchor)
    S[each, :, each, :] += noise
    return residual, np.concatenate([numerator, residual[:, :, None], G], axis=2), S


def _with_moved(state: State, by_effects: Array, prediction: Prediction, by_anchors: Array) -> Array:
    """Return the derivative (m, r, k) of a prediction by effects that move the anchors by (m, 3, k), too."""
    if not state.has_anchors or not by_anchors.shape[2]:
        return by_effects
    return by_effects - prediction.by_pose[:, :, :3] @ by_anchors


def own_precisions(innovation: Innovation) -> Array:
    """Return the inverse (m, r, r) of the covariance of each feature alone.

    Raises:
        FilterDivergedError: one is singular.
    """
    try:
        return np.linalg.inv(innovation.own_covariances())
    except np.linalg.LinAlgError as error:
        raise IndefiniteCovarianceError from error


def update(state: State, innovation: Innovation) -> tuple[State, UpdateStats]:
    """Update the state with all features of an image at once.

    With L L^T = S and W = L^-1 H P, the covariance decreases by W^T W. It stays symmetric by construction
    and cannot become indefinite by more than rounding, which is the purpose of the Joseph form.

    Raises:
        FilterDivergedError: S is not positive definite, or the estimate is no longer finite.
    """
    stacked = innovation.stacked.reshape(innovation.residual.size, -1)
    return _corrected(state, stacked, innovation.find_whitening())


def zero_rate_update(
    before: State, after: State, matrix: Array, rotation_std_rad: Array | float, gate: float
) -> tuple[State, UpdateStats]:
    """Update with zero rotation: the Euler angles of a robot at rest do not change.

    The measurement `euler(after) - euler(before) = 0` shares the gyro noise with the prediction;
    the covariances with the state before, known from the transition, account for that.

    Args:
        before: the state that was predicted from.
        after: the predicted state, same features.
        matrix: (r, r) transition of the robot part.
        rotation_std_rad: (3,) or for all three, standard deviations of the changes of the Euler angles at
            rest.
        gate: chi-square bound (3 degrees of freedom) above which the robot is not at rest.
    """
    r = len(matrix)
    with_before = np.vstack([matrix @ before.covariance[:r, EULER], before.covariance[r:, EULER]])
    with_change = (after.covariance[:, EULER] - with_before).T
    cross = with_before[EULER]
    change_covariance = after.covariance[EULER, EULER] + before.covariance[EULER, EULER] - cross - cross.T
    change_covariance = change_covariance + np.square(rotation_std_rad) * np.eye(3)
    residual = before.euler_rad - after.euler_rad
    if residual @ np.linalg.solve(change_covariance, residual) > gate:
        return after, UpdateStats()
    sensitivity = after.sensitivity[EULER] - before.sensitivity[EULER]
    return _correct(after, residual, with_change, change_covariance, sensitivity)


def heading_innovation(state: State, yaw_rad: float, by_values: Array) -> tuple[float, float]:
    """Return the innovation (rad) of a heading and its variance without the noise of the heading.

    Args:
        state: predicted to the time of the heading.
        yaw_rad: measured.
        by_values: (k,) derivative of the expected heading by the coefficients.
    """
    k = state.coefficient_columns
    numerator = state.covariance[YAW] + by_values @ state.covariance[k]
    residual = math.remainder(yaw_rad - float(state.mean[YAW]), 2.0 * math.pi)
    return residual, float(numerator[YAW] + numerator[k] @ by_values)


def heading_update(
    state: State, yaw_rad: float, std_rad: float, by_values: Array, by_candidates: Array
) -> tuple[State, UpdateStats, float]:
    """Update with a heading by another reference; return the state, the statistics and the innovation in rad.

    Args:
        state: predicted to the time of the heading.
        yaw_rad: measured.
        std_rad: its noise.
        by_values: (k,) derivative of the expected heading by the coefficients.
        by_candidates: (c,) the same by effects that the model lacks.
    """
    residual, variance = heading_innovation(state, yaw_rad, by_values)
    variance += std_rad**2
    k = state.coefficient_columns
    numerator = state.covariance[YAW] + by_values @ state.covariance[k]
    sensitivity = state.sensitivity[YAW] + by_values @ state.sensitivity[k] + by_candidates
    corrected, stats = _correct(
        state, np.array([residual]), numerator[None], np.array([[variance]]), sensitivity[None]
    )
    return corrected, stats, residual


def tilt_update(state: State, roll_pitch_rad: Array, std_rad: Array) -> State:
    """Update with roll and pitch by gravity.

    Args:
        state: predicted.
        roll_pitch_rad: (2,) measured.
        std_rad: (2,) their noise.
    """
    tilt = slice(EULER.start, EULER.start + 2)
    covariance = state.covariance[tilt, tilt] + np.diag(std_rad**2)
    residual = roll_pitch_rad - state.mean[tilt]
    return _correct(state, residual, state.covariance[tilt], covariance, state.sensitivity[tilt])[0]


def add_lacking(state: State, column: int, value: float, std: float) -> State:
    """Add what the filter has lacked: `x + X theta`, `P + X var(theta) X^T` (Friedland 1969).

    Args:
        state: the estimate without it.
        column: its column of the sensitivity X.
        value: theta, estimated from the innovations.
        std: its standard deviation.
    """
    lacking = state.sensitivity[:, column]
    covariance = state.covariance + std**2 * np.outer(lacking, lacking)
    return changed(state, mean=state.mean + value * lacking, covariance=covariance)


def _correct(
    state: State, residual: Array, numerator: Array, covariance: Array, sensitivity: Array
) -> tuple[State, UpdateStats]:
    """Apply the update for q measured numbers, by nu (q,), H P (q, n), S (q, q) and G (q, c)."""
    return _corrected(state, np.column_stack([numerator, residual, sensitivity]), whitener(covariance))


def _corrected(state: State, stacked: Array, whitening: Array) -> tuple[State, UpdateStats]:
    """Apply the update for q measured numbers.

    Args:
        state: before.
        stacked: (q, n + 1 + c) side by side H P, nu and G.
        whitening: L^-1 (q, q) with `L L^T = S`.
    """
    n, whitened = len(state.mean), whitening @ stacked
    # BLAS takes twice as long for a product that it knows to be symmetric: each of these has a column more.
    products, scores = whitened[:, :n].T @ whitened, whitened[:, n:].T @ whitened[:, n + 1 :]
    mean, covariance, sensitivity, nis, log_determinant, size = corrected(
        state.mean, state.covariance, state.sensitivity, whitened, products, whitening
    )
    if not math.isfinite(size):
        raise FilterDivergedError('the estimate is no longer finite', todo=CHECK_THE_SENSORS)
    after = changed(state, mean=mean, covariance=covariance, sensitivity=sensitivity)
    if not sensitivity.shape[1]:
        return after, UpdateStats(nis, len(stacked), log_determinant)
    return after, UpdateStats(nis, len(stacked), log_determinant, scores[1:], scores[0])


@compiled
def corrected(
    mean: Array, covariance: Array, sensitivity: Array, whitened: Array, products: Array, whitening: Array
) -> tuple[Array, Array, Array, float, float, float]:
    """Return mean x (n,), covariance (n, n) and sensitivity (n, c) after an update, NIS, log det S and x^T x.

    Args:
        mean: before, (n,).
        covariance: P before, (n, n).
        sensitivity: X before, (n, c).
        whitened: (q, n + 1 + c) `H P`, nu and G, whitened.
        products: (n, n + 1 + c) products of the whitened `H P` with these.
        whitening: L^-1 (q, q) with `L L^T = S`.
    """
    n = len(mean)
    x, below, nu = mean + products[:, n], np.tril(covariance - products[:, :n]), whitened[:, n]
    log_determinant = -2.0 * float(np.log(whitening.diagonal()).sum())
    P, X = below + np.tril(below, -1).T, sensitivity - products[:, n + 1 :]
    return x, P, X, float(nu @ nu), log_determinant, float(x @ x)
