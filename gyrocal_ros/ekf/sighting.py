"""One image of features: compared with the map, gated, learned from; newcomers join the map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gyrocal_ros.config import Config
from gyrocal_ros.data import Array, FeatureObservations, SearchRegions
from gyrocal_ros.ekf.gate import inliers
from gyrocal_ros.ekf.landmarks import augment, make_room, note_sighting
from gyrocal_ros.ekf.state import YAW, State
from gyrocal_ros.ekf.update import Innovation, innovate, mahalanobis, update
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import Parametrisation, Prediction, View

MIN_SIGHTING_DEPTH = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What one measurement said. Empty where nothing was seen."""

    used: int = 0
    rejected: int = 0
    added: int = 0
    nis: float = 0.0
    """`nu^T S^-1 nu` of what was used."""
    dof: int = 0
    heading_rad: float = 0.0
    """The innovation as a heading: the rotation about the vertical that fits it best."""
    heading_std_rad: float = float('nan')
    noise_distances: Array = field(default_factory=lambda: np.empty(0))
    """Squared distances of innovations in which the pixel noise dominates."""


def see(
    state: State,
    view: View,
    observations: FeatureObservations,
    form: Parametrisation,
    config: Config,
    noise_px: float,
) -> tuple[State, Sighting]:
    """Correct the state by those of the features seen that the map knows.

    Args:
        state: predicted to the time of the image.
        view: the camera at that state.
        observations: what the tracker saw.
        form: parametrisation of the features.
        config: settings.
        noise_px: present standard deviation of the pixels.
    """
    row_of = {feature: row for row, feature in enumerate(state.landmarks.ids.tolist())}
    known = [i for i, feature in enumerate(observations.ids.tolist()) if feature in row_of]
    if not known:
        return state, Sighting()
    rows = np.array([row_of[int(observations.ids[i])] for i in known])
    prediction = form.predict(view, state.features[rows], state.landmarks.anchors[rows])
    measured, noise = form.measure(view, observations.pixels[known], noise_px, config.features)
    innovation = innovate(state, rows, prediction, measured, noise)

    distances = mahalanobis(innovation)
    good = inliers(distances, form.rows, config.features.outlier_probability)
    good &= prediction.points_c[:, 2] > MIN_SIGHTING_DEPTH
    used = innovation if good.all() else innovation[np.flatnonzero(good)]
    heading_rad, heading_std_rad = _as_heading(used)
    nis = 0.0
    if good.any():
        state, nis = update(state, used)
    state = note_sighting(state, rows[good], rows[~good], config.features.drop_after_rejections)
    return state, Sighting(
        used=int(good.sum()),
        rejected=int((~good).sum()),
        nis=nis,
        dof=used.residual.size,
        heading_rad=heading_rad,
        heading_std_rad=heading_std_rad,
        noise_distances=distances[_noise_dominates(innovation)] if form.rows == 2 else np.empty(0),
    )


def meet(
    state: State,
    view: View,
    observations: FeatureObservations,
    form: Parametrisation,
    config: Config,
    noise_px: float,
) -> tuple[State, int]:
    """Add the features of an image that the map does not know; returns how many were added."""
    known = set(state.landmarks.ids.tolist())
    fresh = [i for i, feature in enumerate(observations.ids.tolist()) if feature not in known]
    count = len(fresh)
    if count == 0:
        return state, 0
    state = make_room(state, count, config.features.map_size)
    features = form.initialise(view, observations.pixels[fresh], noise_px, config.features)
    return augment(state, observations.ids[fresh], features), count


def search_regions(state: State, view: View, form: Parametrisation, noise_px: float) -> SearchRegions:
    """Where the mapped features should appear, with the covariance of the innovation there."""
    prediction = form.predict(view, state.features, state.landmarks.anchors)
    pixels, by_point = project_with_jacobian(view.camera, prediction.points_c)
    if form.rows == 3:
        by_pose, by_feature = by_point @ prediction.by_pose, by_point @ prediction.by_feature
        prediction = Prediction(pixels, by_pose, by_feature, prediction.points_c)
    visible = np.flatnonzero(prediction.points_c[:, 2] > MIN_SIGHTING_DEPTH)
    count = len(visible)
    seen = Prediction(
        pixels[visible],
        prediction.by_pose[visible],
        prediction.by_feature[visible],
        prediction.points_c[visible],
    )
    noise = np.broadcast_to(noise_px**2 * np.eye(2), (count, 2, 2))
    innovation = innovate(state, visible, seen, seen.expected, noise)
    return SearchRegions(
        state.t_ns, state.landmarks.ids[visible], pixels[visible], innovation.own_covariances()
    )


def _noise_dominates(innovation: Innovation) -> np.ndarray:
    """Which innovations owe at least two thirds of their variance to the pixel noise, (m,) bool."""
    total = np.einsum('mii->m', innovation.own_covariances())
    return np.einsum('mii->m', innovation.noise) > total * 2.0 / 3.0


def _as_heading(innovation: Innovation) -> tuple[float, float]:
    """The innovation as a heading error, least squares over the image, and its standard deviation.

    Every pixel has the same noise, so it drops out of the estimate. Not told (NaN) where something
    else than pixels is measured.
    """
    if len(innovation.rows) == 0 or innovation.noise.shape[1] != 2:
        return 0.0, float('nan')
    by_yaw = innovation.prediction.by_pose[:, :, YAW]
    information = float(np.vdot(by_yaw, by_yaw))
    heading_rad = float(np.vdot(by_yaw, innovation.residual)) / information
    return heading_rad, math.sqrt(float(innovation.noise[0, 0, 0]) / information)
