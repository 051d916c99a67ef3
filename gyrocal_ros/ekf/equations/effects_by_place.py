"""The effects of a sensor model, sorted by the place where they act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount, changed, quickly_filled
from gyrocal_ros.effects.base import is_linear
from gyrocal_ros.ekf.state.columns import gained, side_by_side
from gyrocal_ros.ekf.state.layout import YAW
from gyrocal_ros.kernels import compiled
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
    RotatesCamera,
    SeenPoints,
    ShutterEffect,
    WheelEffect,
    placed,
)

TURN_CHANGE_S = 0.02
"""Time before an image over which the yaw acceleration is averaged: about that of a readout."""
BY_DEPTH_OR_WAY = ('camera', 'wheels', 'ground')
"""Places of effects that shift features by their depth, or with the way."""
DELAY_STEPS = 2
"""Newton's steps for the time at which a row meets a feature; the first one is exact at constant speed."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class PoseMotion:
    """How the pose of the robot changes about the moment of an image."""

    rate: Array
    """(6,)"""
    acceleration: Array
    """(6,)"""


@dataclass(frozen=True, slots=True, eq=False)
class EffectsByPlace:
    """Effects by place, each with the slice of its coefficients among all K."""

    count: int
    """K"""
    prior_means: Array
    walks: Array
    """(K,) prior means and random walks of the coefficients."""
    shown_by_moves: np.ndarray
    """(K,) True for coefficients that images show while the camera moves: they shift features by their depth,
    or with the way."""
    shown_by_turns: np.ndarray
    """(K,) the same while the robot turns: rotations of the camera, and delays from row to row. Coefficients
    in neither always show."""
    gyro: Sequence[tuple[GyroEffect, slice]]
    wheels: Sequence[tuple[WheelEffect, slice]]
    ground: Sequence[tuple[GroundEffect, slice]]
    camera: Sequence[tuple[CameraEffect, slice]]
    time: Sequence[tuple[Effect, slice]]
    shutter: Sequence[tuple[ShutterEffect, slice]]
    noise: Sequence[tuple[NoiseEffect, slice]]

    @property
    def act_on_motion(self) -> bool:
        """True if any effect changes the motion of the robot."""
        return bool(self.gyro or self.wheels or self.ground)

    @property
    def act_on_images(self) -> bool:
        """True if any effect changes images."""
        return bool(self.camera or self.time or self.shutter)

    @property
    def act_on_view(self) -> bool:
        """True if any effect shifts features by their depth, or with the way."""
        return bool(self.camera or self.time or self.shutter or self.wheels or self.ground)

    def shown(self, *, moves: bool, turns: bool) -> Array:
        """Return (K,) 1 for coefficients that images show, 0 for others.

        Args:
            moves: True if the camera moves, and has moved enough to tell the depths.
            turns: True if the robot turns.
        """
        shown = ~(self.shown_by_moves | self.shown_by_turns)
        if moves:
            shown |= self.shown_by_moves
        if turns:
            shown |= self.shown_by_turns
        return shown.astype(float)

    def no_memories(self) -> tuple[Memory, ...]:
        """Return the memories of the gyro effects before the first block."""
        return (None,) * len(self.gyro)


def sort_effects(effects: tuple[Effect, ...], more: int = 0) -> EffectsByPlace:
    """Sort effects by place, with a number of further coefficients behind theirs, which act nowhere."""
    coefficients = [item for effect in effects for item in effect.coefficients]
    none = [False] * more
    by_moves = [effect.acts_on in BY_DEPTH_OR_WAY for effect in effects for _ in effect.coefficients]
    by_turns = [_shown_by_turns(effect) for effect in effects for _ in effect.coefficients]
    return EffectsByPlace(
        count=len(coefficients) + more,
        prior_means=np.array([item.prior_mean for item in coefficients] + [0.0] * more, float),
        walks=np.array([item.walk for item in coefficients] + [0.0] * more, float),
        shown_by_moves=np.array(by_moves + none, bool),
        shown_by_turns=np.array(by_turns + none, bool),
        gyro=placed(effects, 'gyro'),
        wheels=placed(effects, 'wheels'),
        ground=placed(effects, 'ground'),
        camera=placed(effects, 'camera'),
        time=placed(effects, 'time'),
        shutter=placed(effects, 'shutter'),
        noise=placed(effects, 'noise'),
    )


def _shown_by_turns(effect: Effect) -> bool:
    rotates = isinstance(effect, RotatesCamera) and effect.rotates_camera
    return effect.acts_on == 'shutter' or rotates


@quickly_filled
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


def pose_by_lacking(
    effects: EffectsByPlace,
    block: MotionBlock,
    motion: PoseStep,
    yaw_gain: Array,
    rate_rad_s: Array,
    memories: Sequence[Memory],
) -> tuple[Array, tuple[Memory, ...]]:
    """Return the same derivative (6, K) by effects that the motion lacks, and their new memories.

    Their coefficients stay at the prior means, so nothing but the derivatives of the contributions counts.

    Args:
        effects: effects by place.
        block: N intervals.
        motion: motion of the block.
        yaw_gain: (6, N) derivative of the pose with respect to the corrected yaw rate of each interval.
        rate_rad_s: (N, 3) corrected body rates.
        memories: memories of the effects on the gyro.
    """
    means, parts, kept = effects.prior_means, [], []
    for (effect, place), memory in zip(effects.gyro, memories, strict=True):
        if is_linear(effect):
            parts.append(effect.columns(block))
            kept.append(memory)
            continue
        term = effect.contribute(block, means[place], memory)
        parts.append(term.by_values)
        kept.append(term.memory)
        if term.blind is not None:  # there no effect acts
            yaw_gain = np.where(term.blind, 0.0, yaw_gain)
    starts = [place.start for _, place in effects.gyro]
    by_values = gained(yaw_gain, parts, starts, effects.count)
    if effects.wheels or effects.ground:
        block = changed(block, rate_rad_s=rate_rad_s)
    for wheel_effect, place in effects.wheels:
        by_values[:3, place] = motion.forward @ wheel_effect.contribute(block, means[place])[1]
    for ground_effect, place in effects.ground:
        by_values[:3, place] = ground_effect.contribute(block, means[place])[1]
    return by_values, tuple(kept)


def pose_motion(motion: PoseStep, block: MotionBlock) -> PoseMotion:
    """Return the motion at the end of a block; of the accelerations only that of the heading counts.

    It is the nominal one: an error of the scale factor by a tenth changes little.
    """
    acceleration = np.zeros(6)
    acceleration[YAW] = mean_at_end(block.yaw_acceleration_rad_s2, block.dt_s, TURN_CHANGE_S)
    return PoseMotion(motion.pose_rate, acceleration)


@compiled
def mean_at_end(values: Array, dt_s: Array, length_s: float) -> float:
    """Return the mean of values (N,) over the end of their intervals (N,), at least over the last one."""
    until_end_s = dt_s[::-1].cumsum()[::-1] - dt_s
    within_s = np.clip(max(length_s, dt_s[-1]) - until_end_s, 0.0, dt_s)
    return float(within_s @ values / within_s.sum())


def true_camera(
    effects: EffectsByPlace, camera: CameraIntrinsics, mount: Mount, values: Array
) -> tuple[CameraIntrinsics, Mount]:
    """Return the assumed camera, corrected by all effects on it."""
    for effect, place in effects.camera:
        camera, mount = effect.corrected(camera, mount, values[place])
    return camera, mount


def as_exposed(
    effects: EffectsByPlace, view: PosedCamera, prediction: Prediction, motion: PoseMotion, values: Array
) -> Prediction:
    """Move predicted pixels to where they are when their rows are exposed.

    A turn begins and ends within a few images. With a constant rate during the readout its images would seem
    ahead as it begins and behind as it ends, and the scale factor would be too small.

    Args:
        effects: effects; those on the shutter act here.
        view: the camera at the stamp of the image.
        prediction: m features as seen by it at one moment.
        motion: of the robot at that moment.
        values: (K,)
    """
    if not effects.shutter:
        return prediction
    velocity, acceleration = prediction.by_pose @ motion.rate, prediction.by_pose @ motion.acceleration
    readout_s, height_px, seen = _readout_s(effects, values), view.camera.height_px, prediction.expected
    delay_s = np.zeros((len(seen), 1))
    for _ in range(DELAY_STEPS):
        behind_s = readout_s * _rows(seen, height_px) - delay_s[:, 0]
        delay_s[:, 0] += behind_s / _pace(velocity + acceleration * delay_s, readout_s, height_px)
        seen = prediction.expected + (velocity + 0.5 * acceleration * delay_s) * delay_s
    return changed(prediction, expected=seen)


def measurement_by_values(
    effects: EffectsByPlace, view: PosedCamera, prediction: Prediction, motion: PoseMotion, values: Array
) -> Array:
    """Return the derivative (m, 2, K) of predicted pixels with respect to the coefficients.

    Args:
        effects: effects; those on gyro, wheels and ground do not act here.
        view: the camera.
        prediction: m features as seen by it, as exposed.
        motion: of the robot at that moment.
        values: (K,)
    """
    seen = SeenPoints(
        view.camera,
        view.R_bc,
        view.p_bc,
        view.shift,
        prediction.points_c,
        prediction.scale,
        prediction.expected,
        prediction.by_point,
    )
    parts = [effect.pixels_by_values(seen, values[place]) for effect, place in effects.camera]
    places = [*effects.camera, *effects.time, *effects.shutter]
    starts = [place.start for _, place in places]
    if not effects.time and not effects.shutter:
        return side_by_side(parts, starts, effects.count)
    by_offset, by_readout = pixels_by_delay(
        prediction.by_pose,
        prediction.expected,
        motion.rate,
        motion.acceleration,
        _readout_s(effects, values),
        view.camera.height_px,
    )
    parts += [by_offset[:, :, None] for _ in effects.time]
    for shutter_effect, place in effects.shutter:
        parts.append(by_readout[:, :, None] * shutter_effect.readout_s(values[place])[1])
    return side_by_side(parts, starts, effects.count)


@compiled
def pixels_by_delay(
    by_pose: Array, pixels: Array, rate: Array, acceleration: Array, readout_s: float, height_px: int
) -> tuple[Array, Array]:
    """Return the derivatives (m, 2) of predicted pixels by the error of the stamp, and by the readout time.

    Args:
        by_pose: (m, 2, 6) derivative of the pixels by the pose.
        pixels: (m, 2) as exposed.
        rate: (6,) of the pose.
        acceleration: (6,) of the pose.
        readout_s: time from the first row to the last one.
        height_px: number of rows.
    """
    velocity, rows = by_pose @ rate, _rows(pixels, height_px)
    at_exposure = velocity + by_pose @ acceleration * (readout_s * rows)[:, None]
    return -velocity, at_exposure * (rows / _pace(at_exposure, readout_s, height_px))[:, None]


def _readout_s(effects: EffectsByPlace, values: Array) -> float:
    """Return the time from the first row of an image to the last one."""
    return sum(effect.readout_s(values[place])[0] for effect, place in effects.shutter)


def _pace(velocity: Array, readout_s: float, height_px: int) -> Array:
    """Return the pace (m,) at which the shutter overtakes features of a velocity (m, 2) in the image.

    It is 1 for a feature that stays in its row, and less for one that moves along with the shutter.
    """
    pace: Array = 1.0 - velocity[:, 1] * readout_s / height_px
    return pace


def _rows(pixels: Array, height_px: int) -> Array:
    """Return the rows (m,) of pixels (m, 2), from -1/2 at the upper edge of the image to 1/2 at the lower."""
    rows: Array = (pixels[:, 1] + 0.5) / height_px - 0.5
    return rows


def first_sight_by_values(prediction: Prediction, by_values: Array) -> Array:
    """Return the derivative (m, 3, K) of new features with respect to the coefficients.

    A new feature is initialised at its observed pixel for any values of the coefficients, so its parameters
    compensate the change of the pixel by the coefficients. The depth, which no pixel determines, stays.
    """
    by_feature: Array = -np.linalg.pinv(prediction.by_feature) @ by_values
    return by_feature
