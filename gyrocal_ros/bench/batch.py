"""Full-information bound: maximum a posteriori estimate of trajectory, map and gyro by batch least squares.

All measurements of the filter enter one problem: all poses and biases at once, the features in anchored
inverse depth, and the scale factor, with the motion model, noise and priors of the filter. The filter differs
only by its recursion; no estimator has more information on the scale factor than this.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, IntArray, Measurement, MotionBlock, Rig, changed
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.predict import FilterModel, predict
from gyrocal_ros.ekf.equations.steady_rate import SteadyRate
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, EULER, POSE, State, no_landmarks
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import Anchors, posed_camera

POSE_AND_BIAS = COEFFICIENTS_START
FORM = PARAMETRISATIONS['inverse_depth']
MAP_SIZE = 1000
"""Size of the map; so large that no feature is dropped."""
FLOOR_STD = 1e-6
"""Lower bound of the process noise of a pose, m and rad: above rounding, where the model has no noise."""
MAX_ROUNDS, CONVERGED_SIGMA = 10, 1e-2
"""Limits of the iteration: number of rounds, and step of the scale factor in its standard deviations."""


@dataclass(frozen=True, slots=True)
class Solution:
    """Estimate of the gyro from all measurements together."""

    scale_factor: float
    scale_factor_std: float
    bias_rad_s: float
    """Yaw bias at the end."""
    rounds: int


@dataclass(frozen=True, slots=True, eq=False)
class _BatchStep:
    """One step of the recording."""

    block: MotionBlock
    rate_change_rad_s: float
    """As for the filter, see `FilterModel`."""
    is_resting: bool
    features: IntArray
    """(m,) indices of the features that were observed at its end."""
    pixels: Array
    """(m, 2)"""


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The recording as a least squares problem. Unknowns: n poses with biases (9 each), a1, the features."""

    steps: list[_BatchStep]
    anchors: Anchors
    rig: Rig
    config: Config
    model: FilterModel
    prior_scale_std: float

    @property
    def coefficient(self) -> int:
        """Index of a1 among the unknowns."""
        return POSE_AND_BIAS * (len(self.steps) + 1)


def solve(measurements: Iterable[Measurement], rig: Rig, config: Config) -> Solution:
    """Compute the maximum a posteriori estimate by Gauss-Newton, starting at the result of a filter.

    Args:
        measurements: features, not images; without outliers, because all of them are used.
        rig: camera and mounting.
        config: settings; their pixel noise is not estimated.

    Raises:
        GyrocalError: SciPy is not installed.
    """
    linalg, sparse = _scipy()
    problem, unknowns = _set_up(measurements, rig, config)
    place = problem.coefficient
    rounds, moved_sigma, std = 0, math.inf, math.nan
    while rounds < MAX_ROUNDS and moved_sigma > CONVERGED_SIGMA:
        residuals, rows, columns, values = _linearised(problem, unknowns)
        shape = (len(residuals), len(unknowns))
        jacobian = sparse.coo_matrix((values, (rows, columns)), shape=shape).tocsr()
        # In this order, poses first and by time, elimination has hardly any fill-in.
        factor = linalg.splu(
            (jacobian.T @ jacobian).tocsc(), permc_spec='NATURAL', options={'SymmetricMode': True}
        )
        step = factor.solve(-(jacobian.T @ residuals))
        unit = np.zeros(len(unknowns))
        unit[place] = 1.0
        std = math.sqrt(float(factor.solve(unit)[place]))
        unknowns = unknowns + step
        rounds, moved_sigma = rounds + 1, abs(float(step[place])) / std
    return Solution(1.0 + float(unknowns[place]), std, float(unknowns[place - 1]), rounds)


def _set_up(measurements: Iterable[Measurement], rig: Rig, config: Config) -> tuple[_Problem, Array]:
    """Return the problem, and an initial solution by a filter with a map of all features."""
    model = default_model()
    features = replace(config.features, map_size=MAP_SIZE)
    camera = replace(config.camera, estimate_pixel_noise=False)
    config = replace(config, features=features, camera=camera)
    slam = EkfSlam(model, config, rig)
    stream = SlamStream(slam)
    seen: dict[int, FeatureObservations] = {}
    records: list[StepRecord] = []
    for measurement in measurements:
        if isinstance(measurement, FeatureObservations):
            seen[measurement.t_ns] = measurement
        records += stream.step(measurement)
    records += stream.finish()
    landmarks = slam.state.landmarks
    row_of = {feature: row for row, feature in enumerate(landmarks.ids.tolist())}
    steps, steady = [], SteadyRate()
    for record in records:
        is_resting = record.resting.dof > 0
        steady.without_noise(record.block, config.gyro, is_at_rest=is_resting)
        observed = seen.get(record.t_ns)
        ids = [] if observed is None else observed.ids.tolist()
        known = [i for i, feature in enumerate(ids) if feature in row_of]
        rows = np.array([row_of[ids[i]] for i in known], np.int64)
        pixels = np.empty((0, 2)) if observed is None else observed.pixels[known]
        steps.append(_BatchStep(record.block, steady.change_rad_s, is_resting, rows, pixels))
    start = np.zeros(POSE_AND_BIAS)
    start[BIAS] = records[0].mean[BIAS]
    poses = [start, *(record.mean[:POSE_AND_BIAS] for record in records)]
    unknowns = np.concatenate([*poses, slam.state.coefficients, slam.state.features.ravel()])
    prior_std = model.coefficients[0].prior_std
    filter_model = FilterModel(model, sort_effects(model.effects), config.gyro, config.wheels)
    anchors = slam.state.anchors_of(np.arange(len(landmarks.ids)))
    problem = _Problem(steps, anchors, rig, config, filter_model, prior_std)
    return problem, unknowns


def _linearised(problem: _Problem, unknowns: Array) -> tuple[Array, Array, Array, Array]:
    """Return whitened residuals, and their Jacobian as rows, columns and values."""
    residuals, rows, columns, values = [], [], [], []
    count = 0
    for residual, places, jacobian in _terms(problem, unknowns):
        residuals.append(residual)
        q, p = jacobian.shape
        rows.append(np.repeat(np.arange(count, count + q), p))
        columns.append(np.tile(places, q))
        values.append(jacobian.ravel())
        count += q
    return tuple(map(np.concatenate, (residuals, rows, columns, values)))  # type: ignore[return-value]


_Term = tuple[Array, IntArray, Array]
"""Residual (q,), indices of the unknowns that it depends on (p,), and its derivative by them (q, p)."""


def _terms(problem: _Problem, unknowns: Array) -> Iterator[_Term]:
    yield from _priors(problem, unknowns)
    for number, step in enumerate(problem.steps):
        yield _motion(problem, unknowns, number, step)
        if step.is_resting:
            yield _rest(problem, unknowns, number)
        if len(step.features):
            yield from _observations(problem, unknowns, number, step)


def _priors(problem: _Problem, unknowns: Array) -> Iterator[_Term]:
    """Yield the priors of the first pose, which is zero by definition, of bias, scale and inverse depths."""
    bias_std = math.radians(problem.config.gyro.bias_prior_std_deg_s)
    stds = np.array([*[FLOOR_STD] * 6, *[bias_std] * 3])
    first = _indices(0, POSE_AND_BIAS)
    yield unknowns[first] / stds, first, np.diag(1.0 / stds)
    place, features = problem.coefficient, problem.config.features
    scale = _indices(place, 1)
    yield unknowns[scale] / problem.prior_scale_std, scale, np.array([[1.0 / problem.prior_scale_std]])
    depths = _indices(place + 1, len(unknowns) - place - 1)[2::3]
    std = features.prior_inverse_depth_std
    yield (unknowns[depths] - 1.0 / features.prior_depth_m) / std, depths, np.eye(len(depths)) / std


def _motion(problem: _Problem, unknowns: Array, number: int, step: _BatchStep) -> _Term:
    """Return the prediction of the filter; from a state without covariance its P is the process noise."""
    before = _indices(POSE_AND_BIAS * number, POSE_AND_BIAS)
    after, place = before + POSE_AND_BIAS, problem.coefficient
    r = POSE_AND_BIAS + 1
    mean = np.append(unknowns[before], unknowns[place])
    state = State(step.block.start_ns, mean, np.zeros((r, r)), 1, no_landmarks(), np.zeros((r, 0)))
    memories = problem.model.effects.no_memories()
    model = changed(problem.model, rate_change_rad_s=step.rate_change_rad_s)
    predicted, transition = predict(state, step.block, model, memories)
    noise = predicted.covariance[:POSE_AND_BIAS, :POSE_AND_BIAS] + FLOOR_STD**2 * np.diag(
        [1.0] * 6 + [FLOOR_STD**2] * 3
    )
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    residual = unknowns[after] - predicted.mean[:POSE_AND_BIAS]
    jacobian = np.concatenate([np.eye(POSE_AND_BIAS), -transition.matrix[:POSE_AND_BIAS]], axis=1)
    return whitening @ residual, np.concatenate([after, before, [place]]), whitening @ jacobian


def _rest(problem: _Problem, unknowns: Array, number: int) -> _Term:
    """Return the constraint that the robot does not turn at rest."""
    before = _indices(POSE_AND_BIAS * number + EULER.start, 3)
    after = before + POSE_AND_BIAS
    std = math.radians(problem.config.rest.rotation_noise_deg)
    jacobian = np.concatenate([np.eye(3), -np.eye(3)], axis=1) / std
    return (unknowns[after] - unknowns[before]) / std, np.concatenate([after, before]), jacobian


def _observations(problem: _Problem, unknowns: Array, number: int, step: _BatchStep) -> Iterator[_Term]:
    """Yield the pixels of one image."""
    assert problem.rig.camera is not None
    pose = _indices(POSE_AND_BIAS * (number + 1) + POSE.start, 6)
    first = problem.coefficient + 1 + 3 * step.features
    places = first[:, None] + np.arange(3)
    view = posed_camera(problem.rig.camera, problem.rig.camera_mount, unknowns[pose[:3]], unknowns[pose[3:]])
    prediction = FORM.predict(view, unknowns[places], problem.anchors[step.features])
    std = problem.config.camera.pixel_noise_px
    residuals = (prediction.expected - step.pixels) / std
    for residual, by_pose, by_feature, place in zip(
        residuals, prediction.by_pose, prediction.by_feature, places, strict=True
    ):
        jacobian = np.concatenate([by_pose, by_feature], axis=1) / std
        yield residual, np.concatenate([pose, place]), jacobian


def _indices(first: int, count: int) -> IntArray:
    """Return the indices of `count` unknowns from `first` on."""
    return np.arange(first, first + count, dtype=np.int64)


def _scipy() -> tuple[Any, Any]:
    try:
        from scipy import sparse
        from scipy.sparse import linalg
    except ImportError as error:
        raise GyrocalError(
            'is not installed', where='SciPy', todo='pip install scipy; only the batch bound needs it'
        ) from error
    return linalg, sparse
