"""The effects of a sensor model, sorted by the place where they act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount, changed
from gyrocal_ros.model.features.base import PosedCamera, Prediction
from gyrocal_ros.model.gyro import Correction
from gyrocal_ros.model.kinematics import PoseStep
from gyrocal_ros.model.sensor import (
    CameraEffect,
    Effect,
    GroundEffect,
    GyroEffect,
    Memory,
    NoiseEffect,
    SeenPoints,
    ShutterEffect,
    WheelEffect,
    placed,
)


@dataclass(frozen=True, slots=True, eq=False)
class EffectsByPlace:
    """Effects by place, each with the slice of its coefficients among all K."""

    count: int
    """K"""
    prior_means: Array
    walks: Array
    """(K,) prior means and random walks of the coefficients."""
    gyro: Sequence[tuple[GyroEffect, slice]]
    wheels: Sequence[tuple[WheelEffect, slice]]
    ground: Sequence[tuple[GroundEffect, slice]]
    camera: Sequence[tuple[CameraEffect, slice]]
    time: Sequence[tuple[Effect, slice]]
    shutter: Sequence[tuple[ShutterEffect, slice]]
    noise: Sequence[tuple[NoiseEffect, slice]]

    @property
    def act_on_images(self) -> bool:
        """True if any effect changes images."""
        return bool(self.camera or self.time or self.shutter)

    def no_memories(self) -> tuple[Memory, ...]:
        """Return the memories of the gyro effects before the first block."""
        return (None,) * len(self.gyro)


def sort_effects(effects: tuple[Effect, ...]) -> EffectsByPlace:
    """Sort effects by place."""
    coefficients = [item for effect in effects for item in effect.coefficients]
    return EffectsByPlace(
        count=len(coefficients),
        prior_means=np.array([item.prior_mean for item in coefficients], float),
        walks=np.array([item.walk for item in coefficients], float),
        gyro=placed(effects, 'gyro'),
        wheels=placed(effects, 'wheels'),
        ground=placed(effects, 'ground'),
        camera=placed(effects, 'camera'),
        time=placed(effects, 'time'),
        shutter=placed(effects, 'shutter'),
        noise=placed(effects, 'noise'),
    )


@dataclass(frozen=True, slots=True, eq=False)
class MotionContribution:
    """Contributions of all effects to the motion of one block."""

    correction: Correction
    distance_m: Array | float
    """(N,) correction of the wheels' distance."""
    distance_by_values: Array | None
    """(N, K)"""
    drift_m: Array | float
    """(3,) displacement that no sensor measures."""
    drift_by_values: Array | None
    """(3, K)"""


def contribute(
    effects: EffectsByPlace, block: MotionBlock, correction: Correction, rate_rad_s: Array, values: Array
) -> MotionContribution:
    """Sum up the contributions of effects on wheels and ground; their dependence on the rate is neglected.

    Args:
        effects: effects by place.
        block: N intervals.
        correction: contributions of the effects on the gyro.
        rate_rad_s: (N, 3) corrected body rates.
        values: (K,) coefficients.
    """
    if effects.wheels or effects.ground:
        block = changed(block, rate_rad_s=rate_rad_s)
    distance: Array | float = 0.0
    drift: Array | float = 0.0
    distance_by = np.zeros((len(block.dt_s), effects.count)) if effects.wheels else None
    drift_by = np.zeros((3, effects.count)) if effects.ground else None
    for wheel_effect, place in effects.wheels:
        added, by_values = wheel_effect.contribute(block, values[place])
        distance = distance + added
        distance_by[:, place] = by_values  # type: ignore[index]
    for ground_effect, place in effects.ground:
        added, by_values = ground_effect.contribute(block, values[place])
        drift = drift + added
        drift_by[:, place] = by_values  # type: ignore[index]
    return MotionContribution(correction, distance, distance_by, drift, drift_by)


def pose_by_values(motion: PoseStep, yaw_gain: Array, contribution: MotionContribution) -> Array:
    """Return the derivative (6, K) of the pose at the end of a block with respect to the coefficients.

    Args:
        motion: motion of the block.
        yaw_gain: (6, N) derivative of the pose with respect to the corrected yaw rate of each interval.
        contribution: contributions of the effects.
    """
    by_values: Array = yaw_gain @ contribution.correction.by_values
    if contribution.distance_by_values is not None:
        by_values[:3] += motion.forward @ contribution.distance_by_values
    if contribution.drift_by_values is not None:
        by_values[:3] += contribution.drift_by_values
    return by_values


def true_camera(
    effects: EffectsByPlace, camera: CameraIntrinsics, mount: Mount, values: Array
) -> tuple[CameraIntrinsics, Mount]:
    """Return the assumed camera, corrected by all effects on it."""
    for effect, place in effects.camera:
        camera, mount = effect.corrected(camera, mount, values[place])
    return camera, mount


def as_exposed(
    effects: EffectsByPlace, view: PosedCamera, prediction: Prediction, pose_rate: Array, values: Array
) -> Prediction:
    """Move predicted pixels to where they are when their rows are exposed: by velocity times delay.

    Args:
        effects: effects; those on the shutter act here.
        view: the camera at the stamp of the image.
        prediction: m features as seen by it at one moment.
        pose_rate: (6,) rate of the robot's pose.
        values: (K,)
    """
    if not effects.shutter:
        return prediction
    velocity = prediction.by_pose @ pose_rate
    readout_s, pace = _readout(effects, view, velocity, values)
    delay_s = readout_s * _rows(view, prediction.expected) / pace
    return changed(prediction, expected=prediction.expected + velocity * delay_s[:, None])


def measurement_by_values(
    effects: EffectsByPlace, view: PosedCamera, prediction: Prediction, pose_rate: Array, values: Array
) -> Array:
    """Return the derivative (m, 2, K) of predicted pixels with respect to the coefficients.

    Args:
        effects: effects; those on gyro, wheels and ground do not act here.
        view: the camera.
        prediction: m features as seen by it, as exposed.
        pose_rate: (6,) rate of the robot's pose at that moment.
        values: (K,)
    """
    by_values = np.zeros((len(prediction.points_c), 2, effects.count))
    seen = SeenPoints(
        view.camera,
        view.R_bc,
        view.p_bc,
        prediction.points_c,
        prediction.scale,
        prediction.expected,
        prediction.by_point,
    )
    for effect, place in effects.camera:
        by_values[:, :, place] = effect.pixels_by_values(seen, values[place])
    velocity = prediction.by_pose @ pose_rate
    for _, place in effects.time:
        by_values[:, :, place] = -velocity[:, :, None]
    if effects.shutter:
        _, pace = _readout(effects, view, velocity, values)
        by_readout = velocity * (_rows(view, prediction.expected) / pace)[:, None]
        for shutter_effect, place in effects.shutter:
            by_values[:, :, place] = by_readout[:, :, None] * shutter_effect.readout_s(values[place])[1]
    return by_values


def _readout(
    effects: EffectsByPlace, view: PosedCamera, velocity: Array, values: Array
) -> tuple[float, Array]:
    """Return the time from the first row to the last, and the pace (m,) at which it overtakes each feature.

    The pace is 1 for a feature that stays in its row, and less for one that moves along with the shutter.
    """
    readout_s = sum(effect.readout_s(values[place])[0] for effect, place in effects.shutter)
    return readout_s, 1.0 - velocity[:, 1] * readout_s / view.camera.height_px


def _rows(view: PosedCamera, pixels: Array) -> Array:
    """Return the rows (m,) of pixels (m, 2), from -1/2 at the upper edge of the image to 1/2 at the lower."""
    rows: Array = (pixels[:, 1] + 0.5) / view.camera.height_px - 0.5
    return rows


def first_sight_by_values(prediction: Prediction, by_values: Array) -> Array:
    """Return the derivative (m, 3, K) of new features with respect to the coefficients.

    A new feature is initialised at its observed pixel for any values of the coefficients, so its parameters
    compensate the change of the pixel by the coefficients. The depth, which no pixel determines, stays.
    """
    by_feature: Array = -np.linalg.pinv(prediction.by_feature) @ by_values
    return by_feature
