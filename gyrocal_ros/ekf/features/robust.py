"""Robust update: each feature is judged by the other features of its image.

The prediction of a feature by the map is uncertain by the pose of the robot, which all features share. Given
the other features of the same image that uncertainty is small, so that a wrong match, or a point that is not
fixed in space, shows far more clearly than by its own innovation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed, quickly_filled
from gyrocal_ros.ekf.equations.update import Innovation
from gyrocal_ros.ekf.features.gating import inliers
from gyrocal_ros.ekf.features.judged import Judged, each_alone, inflated, leave_one_out
from gyrocal_ros.ekf.state.layout import POSE, YAW
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.kernels import compiled
from gyrocal_ros.statistics import chi_square_quantile

HUBER_BOUND = 3.0
"""Mahalanobis distance above which a feature counts less (Huber 1964). Of normally distributed features,
1 % are farther."""
MAX_INFLATION = 1e6
"""Largest inflation, so that rounding remains small; beyond it a feature has no weight anyway."""
MAX_ITERATIONS = 3
CONVERGED = 0.05
"""Relative change of the weights at which the iteration ends."""
WEIGHING = HUBER_BOUND, MAX_INFLATION, MAX_ITERATIONS, CONVERGED
"""These settings, as `weigh` takes them."""
LOOSE_POSE_RATE = np.array([0.3, 0.3, 0.3, 1.0, 1.0, 1.0])
"""Standard deviations of the errors of the motion (m/s, rad/s) of a model that lacks an effect."""
SLIP_RATE = np.array([0.3, 0.3, 0.0, 0.0, 0.0, 0.0])
"""The same where the wheels slip or stand still in the air, or where all that the camera sees moves."""
LIFT_RATE = np.array([0.3, 0.3, 0.3, 0.0, 0.0, 0.0])
"""The same where somebody lifts the robot; the gyros follow how it tilts."""
BENT = 0.1
"""Share of a contradiction below which the pose explains it; the rest is the map, bent by earlier images."""
MOST_LEFT_PX = 3.0
"""The same as an error in the image, of the better half of the features: no map is bent more."""
TURNED = 0.2
"""Share of a contradiction that a slip leaves, above which another turn is needed to explain it."""
POSE_DOF = 6
MIN_WITNESSES = 3
"""Features that agree with the predicted pose and contradict another one, from which it is not that one."""
Weighed: TypeAlias = tuple[Array, Array, Array, float, float, float]
"""What `weigh_loosely` returns."""
MIN_FEATURES = 5
"""Fewest features that may contradict the pose: the better half of them determines one."""


class Slip(Enum):
    """Whether the wheels may be to blame for what contradicts the pose."""

    EXCLUDED = 'excluded'
    """Turns are contradicted as well."""
    ON_FLOOR = 'on the floor'
    """They drive: below a camera that leans forwards a robot seems to rise as it drives."""
    POSSIBLE = 'possible'
    GOES_ON = 'goes on'
    """They were to blame for the last images."""


SLIP_MAY_LEAVE = {
    Slip.EXCLUDED: (0.0, 0.0),
    Slip.ON_FLOOR: (BENT, 0.0),
    Slip.POSSIBLE: (BENT, BENT),
    Slip.GOES_ON: (BENT, 1.0),
}
"""Share of a contradiction below which a slip explains it, and a lift."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Freed:
    """An innovation as if the predicted pose had further errors: it says nothing of the gyro."""

    innovation: Innovation
    """With inflated noise in its covariance."""
    std: Array
    """(6,) standard deviations of these errors."""

    @property
    def turn_rad(self) -> float:
        """By how much the features correct the heading."""
        by_yaw = self.innovation.stacked[:, :, YAW].ravel()
        size, residual = len(by_yaw), self.innovation.residual.ravel()
        return float(by_yaw @ np.linalg.solve(self.innovation.covariance.reshape(size, size), residual))


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """What the features of an image say of each other and of the predicted pose."""

    innovation: Innovation
    """With inflated noise in its covariance."""
    judged: Judged
    good: np.ndarray
    """(m,) bool, features to use."""
    slip_std: Array | None = None
    """(6,) standard deviations of the pose by a slip, or a lift, that explains what the features show; None
    without."""
    freed: Freed | None = None
    """For the state alone, where no gyro errs as much as the turn is contradicted; None elsewhere."""
    contradicts_pose: bool = False
    """True if the features contradict the predicted pose, so that they were judged by another one."""
    contradicts_turn: bool = False
    """True if only another turn than that by the gyro explains what the features show."""

    @property
    def rejects_image(self) -> bool:
        """True if the image is rejected as a whole, so that no feature is at fault."""
        return len(self.good) >= MIN_FEATURES and not np.count_nonzero(self.good)


def consensus(
    innovation: Innovation,
    outlier_probability: float,
    interval_s: float,
    slip: Slip = Slip.POSSIBLE,
    largest_turn_error_rad: float = math.inf,
) -> Consensus:
    """Judge the features of an image by each other and by the pose: Huber's weights, and a gate.

    Where another way than that by the wheels explains a contradiction of the predicted pose, along the floor
    or in the hands of somebody, the position is as uncertain as that: it says nothing of the yaw gyro.
    Otherwise, where most features contradict the pose, an effect that the model lacks may have turned it, and
    those that show the effect best would be rejected first. They are then judged with a looser pose: by a
    wider gate if that explains what they show. If not, and most of them contradict each other, none is used:
    an image in the dark or of a hand still has corners. Where they agree upon a turn that no gyro misses, the
    state follows them with a free pose: that may be something else than the gyro, and must not spoil what is
    known of it. Few features do not contradict the pose, for they do not determine one. Features that agree
    with the predicted pose are witnesses against any other one that contradicts them: a wrong pose has none.

    Args:
        innovation: of the m features.
        outlier_probability: probability of the rejection of a good feature.
        interval_s: time since the last image.
        slip: whether the wheels may be to blame; while that goes on, a lift explains a part.
        largest_turn_error_rad: error of the turn since the last image beyond which it is none of the gyro.

    Raises:
        FilterDivergedError: the covariance of the innovation is not positive definite.
    """
    m, r = innovation.residual.shape
    gate = chi_square_quantile(1.0 - outlier_probability, r)
    pose_gate = chi_square_quantile(1.0 - outlier_probability, POSE_DOF)
    inflation, distances, noise_share, nis, whitening = weigh(innovation, *WEIGHING)
    by_pose, good = Judged(distances, noise_share, nis), distances <= gate
    # Even all features together may be closer to the prediction than a contradicted pose.
    predicted = Consensus(_with_noise(innovation, inflation, whitening), by_pose, good)
    if m < MIN_FEATURES or nis <= pose_gate:
        return predicted
    loose_std = LOOSE_POSE_RATE * interval_s
    if np.count_nonzero(good) == m and looser_pose_gain(innovation, loose_std, distances) <= pose_gate:
        return predicted  # no agreement is larger
    agreeing = _by_largest_agreement(innovation, gate)
    if np.count_nonzero(agreeing.good) > np.count_nonzero(good):
        predicted = agreeing
    half_agrees = 2 * np.count_nonzero(predicted.good) >= m
    if half_agrees and looser_pose_gain(innovation, loose_std, predicted.judged.distances) <= pose_gate:
        return predicted
    found = _by_another_pose(innovation, whitening, agreeing, outlier_probability, interval_s, slip)
    is_turned = found.freed is not None and abs(found.freed.turn_rad) > largest_turn_error_rad
    return changed(found, contradicts_pose=True, freed=found.freed if is_turned else None)


def _by_another_pose(
    innovation: Innovation,
    whitening: Array,
    agreeing: Consensus,
    outlier_probability: float,
    interval_s: float,
    slip: Slip,
) -> Consensus:
    """Return what features that contradict the predicted pose say: of a slip, a lift, a turn, or of nothing.

    Args:
        innovation: of the features.
        whitening: L^-1 of its covariance.
        agreeing: judgement by those that agree with the predicted pose and with each other.
        outlier_probability: as the further arguments, see `consensus`.
        interval_s: the same.
        slip: the same.
    """
    m, r = innovation.residual.shape
    gate = chi_square_quantile(1.0 - outlier_probability, r)
    pose_gate = chi_square_quantile(1.0 - outlier_probability, POSE_DOF)
    by_slip, by_lift = SLIP_MAY_LEAVE[slip]
    for largest, std in ((by_slip, SLIP_RATE * interval_s), (by_lift, LIFT_RATE * interval_s)):
        weighed = weigh_loosely(innovation, std, *WEIGHING)
        *_, tight_nis, loose_nis = weighed
        left = loose_nis / tight_nis if tight_nis - loose_nis > pose_gate else 1.0
        if left < largest and _witnesses(agreeing, weighed[1], gate) < MIN_WITNESSES:
            return _slipping(innovation, std, weighed, gate)
    std = LOOSE_POSE_RATE * interval_s
    loose = weigh_loosely(innovation, std, *WEIGHING)
    if _witnesses(agreeing, loose[1], gate) >= MIN_WITNESSES:
        outvoted = 2 * np.count_nonzero(agreeing.good) < np.count_nonzero(loose[1] <= gate)
        return changed(agreeing, good=np.zeros(m, bool)) if outvoted else agreeing
    found = _by_looser_pose(innovation, whitening, loose, outlier_probability)
    is_turned = loose[-1] < BENT * loose[-2] or found.rejects_image
    freed = None if found.rejects_image else Freed(_freed(innovation, std, loose[0]), std)
    return changed(found, contradicts_turn=left > TURNED and is_turned, freed=freed)


@compiled
def looser_pose_gain(innovation: Innovation, std: Array, distances: Array) -> float:
    """Return by how much a looser pose explains the better half of the features better, in NIS.

    Args:
        innovation: of the m features.
        std: (6,) standard deviations of the further errors of the pose.
        distances: (m,) squared Mahalanobis distances that tell which features are better.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    m = len(innovation.rows)
    better, loose = np.argsort(distances)[: (m + 1) // 2], _with_looser_pose(innovation, std)
    tight_nis, loose_nis = (_squared_norm(each, np.ones(m), better) for each in (innovation, loose))
    return tight_nis - loose_nis


def _witnesses(agreeing: Consensus, distances: Array, gate: float) -> int:
    """Return how many features agree with the predicted pose and contradict another one by distances (m,)."""
    return int(np.count_nonzero(agreeing.good & (distances > gate)))


def _by_largest_agreement(innovation: Innovation, gate: float) -> Consensus:
    """Judge the features of an image by those of the largest agreement: Huber's weights, in one step.

    Weights by iteration do not get there from those of all features, where many contradict each other. From
    such a start one step is enough (Bickel 1975).
    """
    agrees = largest_agreement(innovation, gate)
    judged = leave_one_out(innovation, np.where(agrees, 1.0, MAX_INFLATION))
    inflation = np.clip(np.sqrt(judged.distances) / HUBER_BOUND, 1.0, MAX_INFLATION)
    weighed = changed(innovation, covariance=inflated(innovation, inflation))
    return Consensus(weighed, judged, judged.distances <= gate)


def largest_agreement(innovation: Innovation, gate: float) -> np.ndarray:
    """Return which features (m,), bool, agree with the predicted pose and with each other.

    The pose is corrected by one feature, and those that agree with it then are counted; the feature that most
    agree with wins (one-point RANSAC, Civera et al. 2010, with every feature instead of random ones).
    """
    m = len(innovation.rows)
    residual, each = innovation.residual, np.arange(m)
    cross = innovation.covariance.transpose(0, 2, 1, 3)  # (m, m, r, r)
    own = cross[each, each]
    gains = cross @ np.linalg.inv(own)[None]  # of feature j by feature i
    left = residual[:, None] - (gains @ residual[None, :, :, None])[..., 0]
    variance = own[:, None] - gains @ cross.transpose(0, 1, 3, 2)
    variance[each, each] = own
    left[each, each] = residual
    distances = np.einsum('jir,jirs,jis->ji', left, np.linalg.inv(variance), left)
    agree = distances <= gate
    best: np.ndarray = agree[:, np.argmax(np.count_nonzero(agree, axis=0))]
    return best


def _by_looser_pose(
    innovation: Innovation, whitening: Array, weighed: Weighed, outlier_probability: float
) -> Consensus:
    """Return what the features say of each other where the pose is uncertain, given their weights."""
    inflation, distances, noise_share, nis, tight_nis, loose_nis = weighed
    weighted = _with_noise(innovation, inflation, whitening)
    m, r = innovation.residual.shape
    left_px = np.sort(np.sqrt(distances * 0.5 * np.einsum('mii->m', innovation.noise)))[(m - 1) // 2]
    if loose_nis < BENT * tight_nis and left_px < MOST_LEFT_PX:  # the noise grows where this goes on
        return Consensus(weighted, each_alone(innovation), inliers(distances, r, outlier_probability))
    good = distances <= chi_square_quantile(1.0 - outlier_probability, r)
    good &= 2 * np.count_nonzero(good) >= m
    return Consensus(weighted, Judged(distances, noise_share, nis), good)


def _slipping(innovation: Innovation, std: Array, weighed: Weighed, gate: float) -> Consensus:
    """Return what the features say of each other with a slip of standard deviations (6,) of the pose."""
    inflation, distances, noise_share, nis, *_ = weighed
    slipping = _freed(innovation, std, inflation)
    return Consensus(slipping, Judged(distances, noise_share, nis), distances <= gate, std)


def _freed(innovation: Innovation, std: Array, inflation: Array) -> Innovation:
    """Return the innovation as if the pose had further errors, with inflated noise, for an update."""
    stacked = innovation.stacked.copy()  # H P begins with the pose
    stacked[:, :, POSE] += innovation.prediction.by_pose * np.square(std)
    loose = _with_looser_pose(innovation, std)
    return changed(loose, stacked=stacked, covariance=inflated(loose, inflation))


@compiled
def weigh(
    innovation: Innovation, bound: float, max_inflation: float, max_iterations: int, converged: float
) -> tuple[Array, Array, Array, float, Array]:
    """Inflate the noise of features that the others contradict: Huber's weights, by iteration.

    Args:
        innovation: of the m features.
        bound: Mahalanobis distance above which the noise is inflated.
        max_inflation: largest factor.
        max_iterations: number of iterations.
        converged: relative change of the factors at which the iteration ends.

    Returns:
        (m,) factors on the noise, then the fields of `Judged`; the NIS is that without inflation. L^-1 (m r,
        m r) with `L L^T = S`, S without inflation.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    inflation, judged = np.ones(len(innovation.rows)), []
    for _ in range(max_iterations):
        judged.append(leave_one_out(innovation, inflation))
        distances = np.sqrt(judged[-1].distances)
        before, inflation = inflation, np.clip(distances / bound, 1.0, max_inflation)
        if (np.abs(inflation - before) <= converged * before).all():
            break
    whitening = whitener(innovation.covariance.reshape((innovation.residual.size,) * 2))
    return inflation, judged[-1].distances, judged[-1].noise_share, judged[0].nis, whitening


@compiled
def weigh_loosely(
    innovation: Innovation,
    std: Array,
    bound: float,
    max_inflation: float,
    max_iterations: int,
    converged: float,
) -> Weighed:
    """Weigh features as if the predicted pose had further errors.

    Args:
        innovation: of the m features.
        std: (6,) standard deviations of these errors.
        bound: as the further arguments, see `weigh`.
        max_inflation: the same.
        max_iterations: the same.
        converged: the same.

    Returns:
        (m,) factors on the noise and the fields of `Judged`, as of `weigh`, and the squared norms of the
        innovations of the better half of the features, with the pose as it is and with its errors.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    loose = _with_looser_pose(innovation, std)
    inflation, distances, noise_share, nis, _ = weigh(loose, bound, max_inflation, max_iterations, converged)
    closest = np.argsort(distances)[: (len(distances) + 1) // 2]
    tight_nis, loose_nis = (_squared_norm(each, inflation, closest) for each in (innovation, loose))
    return inflation, distances, noise_share, nis, tight_nis, loose_nis


def _with_noise(innovation: Innovation, inflation: Array, whitening: Array) -> Innovation:
    """Return the innovation with inflated noise in its covariance, else with what whitens it."""
    if max(inflation.tolist()) == 1.0:
        return changed(innovation, whitening=whitening)
    return changed(innovation, covariance=inflated(innovation, inflation))


def _with_looser_pose(innovation: Innovation, std: Array) -> Innovation:
    """Return the innovation as if the predicted pose had further errors of standard deviations (6,)."""
    m, r = innovation.residual.shape
    by_pose = (innovation.prediction.by_pose * std).reshape(m * r, POSE_DOF)
    covariance = innovation.covariance + (by_pose @ by_pose.T).reshape(m, r, m, r)
    return changed(innovation, covariance=covariance)


def _squared_norm(innovation: Innovation, inflation: Array, chosen: IntArray) -> float:
    """Return `nu^T S^-1 nu` of the features of the given indices, with inflated noise (factors (m,)).

    Raises:
        FilterDivergedError: their covariance is not positive definite.
    """
    residual = innovation.residual[chosen].ravel()
    covariance = inflated(innovation, inflation)[chosen][:, :, chosen].reshape((len(residual),) * 2)
    whitened = whitener(covariance) @ residual
    return float(whitened @ whitened)
