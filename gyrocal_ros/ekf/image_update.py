"""One image: predict, gate, update, and initialise new landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, FeatureObservations, IntArray, SearchRegions, changed, quickly_filled
from gyrocal_ros.ekf.equations.effects_by_place import first_sight_by_values
from gyrocal_ros.ekf.equations.feature_scores import feature_scores
from gyrocal_ros.ekf.equations.update import (
    NO_DIFFERENCES,
    NO_FEATURES,
    NONE,
    Innovation,
    MeasurementUpdate,
    UpdateStats,
    innovate,
    update,
)
from gyrocal_ros.ekf.features.anchors import settled, with_moved_anchors, with_moving_anchors
from gyrocal_ros.ekf.features.certain_way import at_certain_way
from gyrocal_ros.ekf.features.considered import (
    combinations_not_told,
    not_told_at_rest,
    wait_for_motion,
    with_considered,
    with_kept,
)
from gyrocal_ros.ekf.features.feature_noise import learn_noise, own_noise
from gyrocal_ros.ekf.features.gating import inliers
from gyrocal_ros.ekf.features.image_heading import as_heading
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.features.judged import each_alone
from gyrocal_ros.ekf.features.known_depth import weighted_scores, with_known_depths
from gyrocal_ros.ekf.features.landmarks import (
    augment,
    count_matches,
    evict_oldest,
    forget,
    mark_seen,
    match_ids,
)
from gyrocal_ros.ekf.features.near_features import with_near_features
from gyrocal_ros.ekf.features.repeated_errors import MIN_DEPTH, motion
from gyrocal_ros.ekf.features.robust import Consensus, Freed, consensus
from gyrocal_ros.ekf.features.slow_errors import differences, with_slow_errors
from gyrocal_ros.ekf.features.turning_view import TURNS_WITH_CAMERA, fixed_to_camera
from gyrocal_ros.ekf.history.feature_likelihoods import given_others
from gyrocal_ros.ekf.noise.stamp_noise import stamp_error, with_stamp_noise
from gyrocal_ros.ekf.noise.wheel_noise import PositionScore
from gyrocal_ros.ekf.state.layout import POSE, YAW, State, features_seen, with_further_errors
from gyrocal_ros.ekf.watches.camera_watch import LENS_AND_TILT, PRIOR_STD
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.camera import bearing, project_with_jacobian
from gyrocal_ros.model.features.base import Anchors, NewFeatures, Prediction

NOISE_SHARE, REJECTED_SHARE = 2.0 / 3.0, 0.4
"""Part of pixel noise in the variance of a feature from which that is learned. Where an image is rejected as
a whole, features seen once before count, too: half of their variance is the noise of then. If the noise is
far above the settings, no feature becomes known, and there are no others."""
SHUTTER_ITERATIONS = 2
"""Iterations for where a new feature was at the stamp of an image with a rolling shutter."""
DOF_PER_FEATURE = 2
"""Degrees of freedom of one observation, also where the measurement is a point of unknown range."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Features of the map that an image shows, m of them."""

    rows: IntArray
    """(m,) indices in the map."""
    observed: FeatureObservations
    prediction: Prediction
    directions: Array
    """(m, 2) expected x/z, y/z in the optical frame."""
    unmoved: np.ndarray
    """(m,) True for features that are expected where they were seen last."""
    moved_px: Array
    """(m,) motion in the image since then."""
    changes_px2: Array
    """(m,) see `repeated_errors.Motion`."""

    def __getitem__(self, each: IntArray) -> _Matches:
        return _Matches(
            self.rows[each],
            self.observed[each],
            self.prediction[each],
            self.directions[each],
            self.unmoved[each],
            self.moved_px[each],
            self.changes_px2[each],
        )


def update_from_image(
    state: State, model: ImageModel, observations: FeatureObservations
) -> tuple[State, MeasurementUpdate]:
    """Correct the state by the observed features that are in the map.

    Args:
        state: predicted to the time of the image.
        model: measurement model of the image.
        observations: features by the tracker.
    """
    matches = _match(state, model, observations)
    unmoved = matches.unmoved.nonzero()[0]
    changes_px2, repeated = matches.changes_px2.take(unmoved), 0
    if model.errors_repeat or model.is_known:
        repeated = len(unmoved)
    if repeated:
        state, matches = mark_seen(state, matches.rows[unmoved]), matches[(~matches.unmoved).nonzero()[0]]
    if len(matches.rows) == 0:
        return state, MeasurementUpdate(unmoved=repeated, changes_px2=changes_px2)
    if model.slow_variance_px:
        focal_px = model.view.camera.fx_px
        state = with_slow_errors(state, matches.rows, matches.moved_px, model.slow_variance_px, focal_px)
    innovation = _innovation(state, model, matches)
    if model.form.is_robust and not model.stays:
        nearer = with_near_features(state, innovation, model.config.features)
        if nearer is not state:
            state, innovation = nearer, _innovation(nearer, model, matches)
    found = _consensus(state, innovation, model)
    if found.contradicts_pose and model.form.is_anchored and not model.stays:
        is_fixed, fixed = fixed_to_camera(state, model, matches.rows, matches.observed.pixels)
        if is_fixed:
            return forget(state, fixed), MeasurementUpdate(
                unmoved=repeated, rejected=len(matches.rows), dropped_ids=fixed, event=TURNS_WITH_CAMERA
            )
    judged, good = found.judged, found.good & (matches.prediction.points_c[:, 2] > MIN_DEPTH)
    learns = model.form.is_robust and model.config.camera.estimate_pixel_noise
    if learns:
        state = learn_noise(state, matches.rows, judged, DOF_PER_FEATURE)
    moved = ~matches.unmoved[good] if learns else None
    all_good = np.count_nonzero(good) == len(good)
    used, freed = found.innovation, found.freed
    if not all_good:
        used = used[good.nonzero()[0]]
        freed = freed and changed(freed, innovation=freed.innovation[good.nonzero()[0]])
    if found.slip_std is not None:
        state = with_further_errors(state, np.arange(POSE.stop), found.slip_std)
    may_tell_wheels = found.slip_std is None and freed is None
    state, told = _updated(state, model, used, freed, moved, may_tell_wheels=may_tell_wheels)
    kept, dropped_ids = state, told.dropped_ids
    if not found.rejects_image:
        drop_after, pixels = model.config.features.drop_after_rejections, matches.observed.pixels
        kept = count_matches(state, matches.rows, good, pixels, matches.directions, drop_after)
    if len(kept.landmarks.ids) < len(state.landmarks.ids):
        dropped_ids = np.setdiff1d(state.landmarks.ids, kept.landmarks.ids)
    is_tracked = learns and observations.covariances_px2 is not None
    is_in_pixels, least = model.form.rows == 2, REJECTED_SHARE if found.rejects_image else NOISE_SHARE
    return kept if model.keeps_anchors else settled(kept), changed(
        told,
        unmoved=repeated,
        changes_px2=changes_px2,
        slip_std=found.slip_std,
        contradicts_turn=found.contradicts_turn,
        freed_turn_rad=0.0 if found.freed is None else found.freed.turn_rad,
        rejected=len(good) - told.used,
        noise_distances=(
            noise_dominated(judged.distances, judged.noise_share, matches.unmoved, least)
            if is_in_pixels
            else NONE
        ),
        dropped_ids=dropped_ids,
        compared=_compared(state, model, matches, innovation) if is_tracked else (NO_FEATURES, NONE),
    )


def _compared(
    state: State, model: ImageModel, matches: _Matches, innovation: Innovation
) -> tuple[IntArray, Array]:
    """Return the numbers of moved features, and their squared distances per degree of freedom.

    An error of the lens or of the mount, which all features have in common, is none of a single one.
    """
    watched = innovation.sensitivity[:, :, model.scored : model.scored + LENS_AND_TILT]
    by_camera = watched.reshape(-1, LENS_AND_TILT) * PRIOR_STD[:LENS_AND_TILT]
    covariance = innovation.covariance + (by_camera @ by_camera.T).reshape(innovation.covariance.shape)
    judged = _consensus(state, changed(innovation, covariance=covariance), model).judged
    moved = (~matches.unmoved).nonzero()[0]
    return state.landmarks.ids[matches.rows[moved]], judged.distances[moved] / DOF_PER_FEATURE


def _match(state: State, model: ImageModel, observations: FeatureObservations) -> _Matches:
    """Find the features of the map that an image shows, and predict them."""
    known, rows = match_ids(state.landmarks.ids, observations.ids)
    parameters, *anchors = features_seen(state, rows)
    prediction = model.predict(state, parameters, Anchors(*anchors))
    if model.way_noise_m is not None and model.form.is_anchored:
        prediction = at_certain_way(state, model.view, rows, prediction, model.way_noise_m)
    observed = observations if len(known) == len(observations.ids) else observations[known]
    moved = motion(prediction.points_c, observed.pixels, state.landmarks, rows, model.view.camera.fx_px)
    unmoved = moved.unmoved | model.is_known
    return _Matches(rows, observed, prediction, moved.directions, unmoved, moved.moved_px, moved.changes_px2)


def _updated(
    state: State,
    model: ImageModel,
    used: Innovation,
    freed: Freed | None,
    moved: np.ndarray | None,
    *,
    may_tell_wheels: bool,
) -> tuple[State, MeasurementUpdate]:
    """Return the state after the update by the features used, and what these tell.

    Which of them have moved in the image matters to slow errors of the tracks, see `slow_errors`; None where
    these are not learned.
    """
    heading_rad, heading_std_rad = as_heading(used)
    told = MeasurementUpdate(used=len(used.rows), heading_rad=heading_rad, heading_std_rad=heading_std_rad)
    if not told.used:
        return state, told
    whitening, ids = used.find_whitening(), state.landmarks.ids[used.rows]
    weights = by_feature = by_position = None
    if model.scored:
        weights = model.candidates.shown(moves=model.moves, turns=model.turns)
        scored = used.sensitivity[:, :, : model.scored] * weights[: model.scored]
        by_feature = feature_scores(ids, used.residual, whitening, scored)
    by_pose = used.prediction.by_pose
    if model.moves and may_tell_wheels:
        by_position = PositionScore(*position_score(by_pose, used.residual, whitening, YAW))
    state, stats = _corrected(state, model, changed(used, whitening=whitening), freed)
    stats = stats if weights is None else weighted_scores(stats, weights)
    return state, changed(
        told,
        stats=changed(stats, dof=DOF_PER_FEATURE * told.used),
        used_ids=ids,
        given_others=given_others(used.residual, whitening),
        differences=NO_DIFFERENCES if moved is None else _differences(model, used, whitening, moved),
        stamp_error=stamp_error(by_pose, model.motion.rate, used.residual, whitening),
        by_position=by_position,
        by_feature=by_feature,
        waits=wait_for_motion(model),
    )


def _corrected(
    state: State, model: ImageModel, used: Innovation, freed: Freed | None
) -> tuple[State, UpdateStats]:
    """Return the state after the update by the features used, with a free pose if any, and what they tell."""
    after, stats = update(state, used)
    if freed is not None:
        after, _ = update(with_further_errors(state, np.arange(POSE.stop), freed.std), freed.innovation)
    if model.stays:
        after = with_kept(state, after, not_told_at_rest(state, model))
    else:
        after = with_considered(state, after, combinations_not_told(state, model))
    after = with_moved_anchors(state, after)
    return with_known_depths(after, model, used), stats


def _differences(model: ImageModel, used: Innovation, whitening: Array, moved: np.ndarray) -> Array:
    """Return how moved features differ from each other, whatever pose and camera are; NaN for others."""
    watched = used.sensitivity[:, :, model.scored : model.scored + LENS_AND_TILT]
    common = np.concatenate([used.prediction.by_pose, watched], axis=2)
    found = differences(used.residual, whitening, common)
    if len(found) and not moved.all():
        found[~moved] = np.nan
    return found


@compiled
def position_score(by_pose: Array, residual: Array, whitening: Array, yaw: int) -> tuple[Array, Array]:
    """Return what an innovation tells of the position whatever the heading is: the fields of `PositionScore`.

    An effect that the gyro model lacks turns the robot, and must not seem to be noise of the wheels.

    Args:
        by_pose: (m, r, 6) derivative of the prediction by the pose.
        residual: (m, r) innovation.
        whitening: L^-1 (m r, m r) with `L L^T = S`.
        yaw: index of the heading in the pose.
    """
    whitened = whitening @ residual.reshape(residual.size)
    whitened_by_pose = whitening @ by_pose.reshape(residual.size, -1)
    by_position, by_yaw = whitened_by_pose[:, :2], whitened_by_pose[:, yaw]
    by_position = by_position - np.outer(by_yaw, by_yaw @ by_position / (by_yaw @ by_yaw))
    return by_position.T @ whitened, by_position.T @ by_position


def _innovation(state: State, model: ImageModel, matches: _Matches) -> Innovation:
    rows, prediction, observed = matches.rows, matches.prediction, matches.observed
    measured, noise = model.form.measure(model.view, observed.pixels, model.noise_px, model.config.features)
    if model.form.is_robust:
        if observed.covariances_px2 is not None:
            noise = (model.noise_px / model.match_px) ** 2 * observed.covariances_px2
        noise = own_noise(noise, state.landmarks.noise, rows)
    by_values = model.by_values(prediction, state.coefficients)
    by_candidates = model.by_candidates(prediction)
    innovation = innovate(state, rows, prediction, measured, noise, by_values, by_candidates)
    return _with_stamp_noise(innovation, model)


def _with_stamp_noise(innovation: Innovation, model: ImageModel) -> Innovation:
    if not model.stamp_std_s:
        return innovation
    velocity = innovation.prediction.by_pose @ model.motion.rate
    covariance = with_stamp_noise(innovation.covariance, velocity, model.stamp_std_s)
    return changed(innovation, covariance=covariance)


def _consensus(state: State, innovation: Innovation, model: ImageModel) -> Consensus:
    outlier_probability = model.config.features.outlier_probability
    if model.form.is_robust:
        return consensus(
            innovation,
            outlier_probability,
            model.interval_s,
            model.slip,
            model.largest_turn_error_rad(state),
        )
    judged = each_alone(innovation)
    return Consensus(innovation, judged, inliers(judged.distances, DOF_PER_FEATURE, outlier_probability))


def add_landmarks(
    state: State, model: ImageModel, observations: FeatureObservations, new: list[int]
) -> State:
    """Add the observed features of the given indices to the map."""
    state = evict_oldest(state, len(new), model.config.features.map_size)
    ids, pixels = observations.ids[new], observations.pixels[new]
    at_stamp, first = _first_sight(state, model, pixels)
    by_values = by_candidates = None
    if model.effects.act_on_images or model.candidates.act_on_images:
        prediction = model.predict(state, first.parameters, first.anchors)
        if model.depth_matters and model.form.is_anchored:
            first = with_moving_anchors(state, model, first)
        by_values = _at_first_sight(
            first, prediction, model.by_values(prediction, state.coefficients), first.anchors.by_values
        )
        by_candidates = _at_first_sight(
            first, prediction, model.by_candidates(prediction), first.anchors.by_candidates
        )
    directions = bearing(model.view.camera, at_stamp)
    return augment(state, ids, pixels, directions, first, by_values, by_candidates, model.by_stamp)


def _first_sight(state: State, model: ImageModel, pixels: Array) -> tuple[Array, NewFeatures]:
    """Return where new features (m, 2) were at the stamp of the image, and what they are in the map."""
    features, at_stamp = model.config.features, pixels
    first = model.form.initialise(model.view, pixels, model.noise_px, features)
    for _ in range(SHUTTER_ITERATIONS if model.effects.shutter else 0):
        at_stamp = at_stamp + pixels - model.predict(state, first.parameters, first.anchors).expected
        first = model.form.initialise(model.view, at_stamp, model.noise_px, features)
    return at_stamp, first


def search_regions(state: State, model: ImageModel) -> SearchRegions:
    """Predict where the mapped features appear, with the covariance of the innovation."""
    prediction = model.predict(state, state.features, state.anchors_of(np.arange(len(state.features))))
    if model.form.rows == 3:
        pixels, by_point = project_with_jacobian(model.view.camera, prediction.points_c)
        by_pose, by_feature = by_point @ prediction.by_pose, by_point @ prediction.by_feature
        prediction = changed(
            prediction, expected=pixels, by_pose=by_pose, by_feature=by_feature, by_point=by_point
        )
    visible = np.flatnonzero(prediction.points_c[:, 2] > MIN_DEPTH)
    count = len(visible)
    seen = prediction[visible]
    noise = np.broadcast_to(model.noise_px**2 * np.eye(2), (count, 2, 2))
    innovation = _with_stamp_noise(innovate(state, visible, seen, seen.expected, noise), model)
    ids, covariances = state.landmarks.ids[visible], innovation.own_covariances()
    return SearchRegions(state.t_ns, ids, seen.expected, covariances)


def _at_first_sight(
    first: NewFeatures, prediction: Prediction, by_effects: Array | None, anchors_by_effects: Array
) -> Array | None:
    """Return the derivative (m, 3, k) of new features by coefficients; None for zero.

    What moves their anchors does not change their directions from there.
    """
    if by_effects is None:
        return None
    by_feature = first_sight_by_values(prediction, by_effects)
    if anchors_by_effects.shape[2]:
        along = first.anchors.R_wc.transpose(0, 2, 1) @ anchors_by_effects
        rays, inverse_depths = first.parameters[:, :2, None], first.parameters[:, 2, None, None]
        by_feature[:, :2] -= inverse_depths * (along[:, :2] - rays * along[:, 2:])
    return by_feature


@compiled
def noise_dominated(distances: Array, noise_share: Array, unmoved: np.ndarray, least: float) -> Array:
    """Return the distances of moved features of whose variance more than a part is pixel noise.

    Args:
        distances: (m,) see `judged.Judged`.
        noise_share: (m,)
        unmoved: (m,) True for features that have not moved in the image.
        least: that part.
    """
    return distances[(noise_share > least) & ~unmoved]
