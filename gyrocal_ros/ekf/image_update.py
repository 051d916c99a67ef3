"""One image of features: compared with the map, gated, learned from; newcomers join the map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, SearchRegions
from gyrocal_ros.ekf.effects_by_place import EffectsByPlace, first_sight_by_values, measurement_by_values
from gyrocal_ros.ekf.gating import inliers
from gyrocal_ros.ekf.landmarks import augment, count_matches, evict_oldest
from gyrocal_ros.ekf.state import YAW, State
from gyrocal_ros.ekf.update import Innovation, UpdateStats, innovate, mahalanobis, own_precisions, update
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import Parametrisation, PosedCamera, Prediction

MIN_SIGHTING_DEPTH = 1e-3
SEEN_NUMBERS = 2
"""What one look at a feature tells, also where it is written as a point of unknown range."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageUpdate:
    """What one measurement said. Empty where nothing was seen."""

    used: int = 0
    rejected: int = 0
    added: int = 0
    lesson: UpdateStats = UpdateStats()
    """What the update taught."""
    heading_rad: float = 0.0
    """The innovation as a heading: the rotation about the vertical that fits it best."""
    heading_std_rad: float = float('nan')
    noise_distances: Array = field(default_factory=lambda: np.empty(0))
    """Squared distances of innovations in which the pixel noise dominates."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageModel:
    """Everything a look at an image needs beside state and image."""

    view: PosedCamera
    """The camera at the state, corrected by the model's effects on it."""
    form: Parametrisation
    config: Config
    noise_px: float
    """Present standard deviation of the pixels."""
    parts: EffectsByPlace
    """Effects in the model."""
    candidates: EffectsByPlace
    """Effects that the model lacks."""
    pose_rate: Array
    """(6,) rate of the robot's pose."""

    def by_values(self, prediction: Prediction, values: Array) -> Array | None:
        """Derivative (m, r, k) of a prediction by the coefficients (k,)."""
        return _image_derivative(self.parts, self, prediction, values)

    def by_candidates(self, prediction: Prediction) -> Array | None:
        """Derivative (m, r, c) of a prediction by effects that the model lacks."""
        return _image_derivative(self.candidates, self, prediction, self.candidates.prior_means)


def update_from_image(
    state: State, eye: ImageModel, observations: FeatureObservations
) -> tuple[State, ImageUpdate]:
    """Correct the state by those of the features seen that the map knows.

    Args:
        state: predicted to the time of the image.
        eye: how it is looked at.
        observations: what the tracker saw.
    """
    form, features = eye.form, eye.config.features
    row_of = {feature: row for row, feature in enumerate(state.landmarks.ids.tolist())}
    known = [i for i, feature in enumerate(observations.ids.tolist()) if feature in row_of]
    if not known:
        return state, ImageUpdate()
    rows = np.array([row_of[int(observations.ids[i])] for i in known])
    prediction = form.predict(eye.view, state.features[rows], state.landmarks.anchors[rows])
    measured, noise = form.measure(eye.view, observations.pixels[known], eye.noise_px, features)
    by_values, by_candidates = eye.by_values(prediction, state.coefficients), eye.by_candidates(prediction)
    innovation = innovate(state, rows, prediction, measured, noise, by_values, by_candidates)

    precisions = own_precisions(innovation)
    distances = mahalanobis(innovation.residual, precisions)
    good = inliers(distances, SEEN_NUMBERS, features.outlier_probability)
    good &= prediction.points_c[:, 2] > MIN_SIGHTING_DEPTH
    used = innovation if good.all() else innovation[np.flatnonzero(good)]
    heading_rad, heading_std_rad = _as_heading(used, precisions[good])
    lesson = UpdateStats()
    if good.any():
        state, lesson = update(state, used)
        lesson = replace(lesson, dof=SEEN_NUMBERS * len(used.rows))
    state = count_matches(state, rows[good], rows[~good], features.drop_after_rejections)
    return state, ImageUpdate(
        used=int(good.sum()),
        rejected=int((~good).sum()),
        lesson=lesson,
        heading_rad=heading_rad,
        heading_std_rad=heading_std_rad,
        noise_distances=distances[_noise_dominates(innovation)] if form.rows == 2 else np.empty(0),
    )


def unmapped(state: State, observations: FeatureObservations, map_size: int) -> list[int]:
    """Which of the features seen the map does not know and has room for.

    None that was just seen makes room for another: one known for longer is worth more.
    """
    known = set(state.landmarks.ids.tolist())
    fresh = [i for i, feature in enumerate(observations.ids.tolist()) if feature not in known]
    just_seen = int(np.count_nonzero(state.landmarks.last_seen_ns == state.t_ns))
    return fresh[: max(map_size - just_seen, 0)]


def add_landmarks(
    state: State, eye: ImageModel, observations: FeatureObservations, fresh: list[int]
) -> State:
    """Add new features of an image to the map, those at the places `fresh` of the observations."""
    features = eye.config.features
    state = evict_oldest(state, len(fresh), features.map_size)
    new = eye.form.initialise(eye.view, observations.pixels[fresh], eye.noise_px, features)
    by_values = by_candidates = None
    if eye.parts.act_on_images or eye.candidates.act_on_images:
        prediction = eye.form.predict(eye.view, new.parameters, new.anchors)
        by_values = _at_first_sight(prediction, eye.by_values(prediction, state.coefficients))
        by_candidates = _at_first_sight(prediction, eye.by_candidates(prediction))
    return augment(state, observations.ids[fresh], new, by_values, by_candidates)


def search_regions(state: State, view: PosedCamera, form: Parametrisation, noise_px: float) -> SearchRegions:
    """Where the mapped features should appear, with the covariance of the innovation there."""
    prediction = form.predict(view, state.features, state.landmarks.anchors)
    pixels, by_point = project_with_jacobian(view.camera, prediction.points_c)
    if form.rows == 3:
        by_pose, by_feature = by_point @ prediction.by_pose, by_point @ prediction.by_feature
        prediction = replace(
            prediction, expected=pixels, by_pose=by_pose, by_feature=by_feature, by_point=by_point
        )
    visible = np.flatnonzero(prediction.points_c[:, 2] > MIN_SIGHTING_DEPTH)
    count = len(visible)
    seen = prediction[visible]
    noise = np.broadcast_to(noise_px**2 * np.eye(2), (count, 2, 2))
    innovation = innovate(state, visible, seen, seen.expected, noise)
    return SearchRegions(
        state.t_ns, state.landmarks.ids[visible], pixels[visible], innovation.own_covariances()
    )


def _image_derivative(
    parts: EffectsByPlace, eye: ImageModel, prediction: Prediction, values: Array
) -> Array | None:
    if not parts.act_on_images:
        return None
    return measurement_by_values(parts, eye.view, prediction, eye.pose_rate, values)


def _at_first_sight(prediction: Prediction, by_values: Array | None) -> Array | None:
    return None if by_values is None else first_sight_by_values(prediction, by_values)


def _noise_dominates(innovation: Innovation) -> np.ndarray:
    """Which innovations owe at least two thirds of their variance to the pixel noise, (m,) bool."""
    total = np.einsum('mii->m', innovation.own_covariances())
    return np.einsum('mii->m', innovation.noise) > total * 2.0 / 3.0


def _as_heading(innovation: Innovation, precisions: Array) -> tuple[float, float]:
    """The innovation as a heading error, least squares over the image, and what pixel noise makes of it.

    A feature counts by its own covariance: one just met, of unknown depth, tells little of the heading.
    Not told (NaN) where something else than pixels is measured.
    """
    if len(innovation.rows) == 0 or innovation.noise.shape[1] != 2:
        return 0.0, float('nan')
    by_yaw = innovation.prediction.by_pose[:, :, YAW]
    weighted = (precisions @ by_yaw[:, :, None])[:, :, 0]
    information = float(np.vdot(weighted, by_yaw))
    heading_rad = float(np.vdot(weighted, innovation.residual)) / information
    variance = float(np.vdot(weighted, (innovation.noise @ weighted[:, :, None])[:, :, 0]))
    return heading_rad, math.sqrt(variance) / information
