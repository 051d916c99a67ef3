"""Measurement model of an image: where features are expected, by the state and by the coefficients."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, Rig, quickly_filled
from gyrocal_ros.ekf.equations.effects_by_place import (
    EffectsByPlace,
    PoseMotion,
    as_exposed,
    measurement_by_values,
)
from gyrocal_ros.ekf.features.robust import Slip
from gyrocal_ros.ekf.state.layout import YAW, State
from gyrocal_ros.model.features.base import Anchors, Parametrisation, PosedCamera, Prediction

LARGEST_SCALE_ERROR, LARGEST_BIAS_RAD_S, LARGEST_TURN_ERROR_RAD = 0.3, math.radians(3.0), math.radians(1.0)
"""Errors of scale factor and bias beyond which they are none of the gyro, and the same of a turn."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class ImageModel:
    """Measurement model of an image: camera, parametrisation, noise and effects."""

    view: PosedCamera
    """Camera at the pose of the state, corrected by the effects of the model."""
    rig: Rig
    """Camera and its mounting, as assumed."""
    form: Parametrisation
    config: Config
    noise_px: float
    """Standard deviation of the pixels of a typical feature."""
    match_px: float
    """Standard deviation that the tracker tells of a typical match."""
    effects: EffectsByPlace
    """Effects of the model."""
    candidates: EffectsByPlace
    """Effects that the model lacks."""
    scored: int
    """Number of their coefficients, the first ones, whose scores by feature are wanted."""
    motion: PoseMotion
    """Of the robot at the stamp of the image."""
    way_noise_m: Array | None
    """(3,) displacement since the last image that may be noise of the wheels; None without any."""
    stretch_by_values: Array | None
    """(k,) by how much coefficients lengthen the way, see `considered`; None without any, and at rest."""
    interval_s: float
    """Time since a feature of the map was seen last."""
    has_moved: bool
    """True if the way of the camera tells how far the features are, see `known_depth.TellingWay`."""
    slow_variance_px: float
    """Variance of the walk of features by slow errors, px^2 per px of motion, see `slow_errors`."""
    stamp_std_s: float
    """Noise of the stamp of the image, see `stamp_noise`."""
    errors_repeat: bool
    """True if a feature counts only after motion in the image."""
    is_known: bool
    """True if the image repeats what was seen before: of a robot that stays where it is."""
    stays: bool
    """True if the robot stands still."""
    slip: Slip
    """Whether a slip of the wheels may explain what contradicts the pose."""

    @property
    def by_stamp(self) -> Array | None:
        """Change of the pose (6,) in a standard deviation of the stamp; None for exact stamps."""
        return self.stamp_std_s * self.motion.rate if self.stamp_std_s else None

    def largest_turn_error_rad(self, state: State) -> float:
        """Return the error of the turn since the last image beyond which it is none of the gyro.

        A scale factor that is wrong itself is corrected, however large that is; a bare model has none.
        """
        if any(abs(scale_error) > LARGEST_SCALE_ERROR for scale_error in state.coefficients[:1].tolist()):
            return math.inf
        rate_rad_s = abs(float(self.motion.rate[YAW]))
        error_rad_s = LARGEST_SCALE_ERROR * rate_rad_s + LARGEST_BIAS_RAD_S
        return error_rad_s * self.interval_s + LARGEST_TURN_ERROR_RAD

    @property
    def moves(self) -> bool:
        """True if the image tells of depths and of the way."""
        return self.has_moved and not self.stays

    @property
    def turns(self) -> bool:
        """True if features move by the turn of the robot more than by its way."""
        x_m_s, y_m_s, *_, yaw_rad_s = self.motion.rate.tolist()
        way_m_s = math.hypot(x_m_s, y_m_s)
        return not self.stays and abs(yaw_rad_s) * self.config.features.prior_depth_m > way_m_s

    @property
    def depth_matters(self) -> bool:
        """True if some effect, or candidate, shifts features by their depth or with the way."""
        return self.effects.act_on_view or self.candidates.act_on_view

    @property
    def keeps_anchors(self) -> bool:
        """True if anchors remain states: the estimates of such effects need them."""
        return self.effects.act_on_view

    def predict(self, state: State, parameters: Array, anchors: Anchors) -> Prediction:
        """Predict the measurements of features (m, 3)."""
        prediction = self.form.predict(self.view, parameters, anchors)
        return as_exposed(self.effects, self.view, prediction, self.motion, state.coefficients)

    def by_values(self, prediction: Prediction, values: Array) -> Array | None:
        """Return the derivative (m, r, k) of a prediction by the coefficients (k,)."""
        return _image_derivative(self.effects, self, prediction, values)

    def by_candidates(self, prediction: Prediction) -> Array | None:
        """Return the derivative (m, r, c) of a prediction by the coefficients of the candidates."""
        return _image_derivative(self.candidates, self, prediction, self.candidates.prior_means)


def _image_derivative(
    effects: EffectsByPlace, model: ImageModel, prediction: Prediction, values: Array
) -> Array | None:
    if not effects.act_on_images:
        return None
    return measurement_by_values(effects, model.view, prediction, model.motion, values)
