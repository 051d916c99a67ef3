"""EKF SLAM with self-calibration: the algorithm on one page.

Lee, Choi, Park, Myung 2012, section 2.3. IMU and wheel samples are gathered; whenever the camera
(or another heading reference) speaks, the state is predicted up to that moment (eqs. (10), (11)),
corrected by what was seen, and new features join the map at first sight (eqs. (15) to (22)).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    Array,
    ClockStep,
    FeatureObservations,
    Frame,
    HeadingSample,
    Measurement,
    MotionBlock,
    Rig,
    SearchRegions,
    TruthSample,
    nanoseconds,
    seconds,
)
from gyrocal_ros.ekf.effects_by_place import sort_effects, true_camera
from gyrocal_ros.ekf.gating import AdaptiveNoise, chi_square_quantile
from gyrocal_ros.ekf.image_update import (
    ImageModel,
    ImageUpdate,
    add_landmarks,
    search_regions,
    unmapped,
    update_from_image,
)
from gyrocal_ros.ekf.landmarks import forget_all
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.predict import Transition, predict, predict_sensitivity
from gyrocal_ros.ekf.start import Start, inflate_after_gap, initial_state
from gyrocal_ros.ekf.state import POSE, YAW, State
from gyrocal_ros.ekf.update import UpdateStats, heading_update, zero_rate_update
from gyrocal_ros.errors import ConfigError, FilterDivergedError
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import PosedCamera, posed_camera
from gyrocal_ros.model.sensor import Effect, SensorModel

MAX_BLOCK_NS = 250_000_000
"""Longest block that is predicted at once, where the camera is slow or covered."""
LOST_FRAMES = 15
"""Images in a row that contradict the map before it is given up and begun anew."""
MAX_RESTARTS = 10
LOWEST_PIXEL_NOISE_PX, HIGHEST_PIXEL_NOISE_PX = 0.02, 5.0
"""What the noise of the pixels is followed within; no tracker is so bad, the images fit nothing."""
CHECK_THE_CAMERA = 'check the camera calibration, its mounting and the time stamps with `gyrocal check`'

Sight = FeatureObservations | HeadingSample


@dataclass(frozen=True, slots=True, eq=False)
class StepRecord:
    """One step of the filter: what it believed afterwards, and what the measurement said."""

    t_ns: int
    mean: Array
    """(9 + k,) robot part of the state."""
    std: Array
    """(9 + k,)"""
    image: ImageUpdate
    resting: UpdateStats
    """What standing still taught."""
    block: MotionBlock
    """The motion that led here."""
    correction_rad: float
    """How far the coefficients, as they are now, correct the turn in this block; to first order,
    the bias not counted."""
    tilt_rad: float
    """By how much more the heading turned than the body about its own z axis, which is not upright."""
    columns: Array
    """(k,) its derivative with respect to the coefficients, rad per unit."""
    gyro_valid_s: float
    """How long the gyro was not blind in this block: only there the bias counts."""
    unobserved_turn_std_rad: float
    """Standard deviation of the turn that an effect could not tell, as beyond the range of the gyro."""
    pixel_noise_px: float
    """Present estimate."""
    event: str = ''
    """What happened that a person should know."""


class EkfSlam:
    """The estimator: takes one measurement at a time, in the order of their stamps.

    Args:
        model: the sensor model whose coefficients are estimated.
        config: settings.
        rig: camera and its mounting, as believed.
        start: what an earlier run knows.
        candidates: effects that the model lacks and that are on trial: the sensitivity of all
            innovations to them is carried along, the estimate does not depend on them.
        running_s: how long the gyro has been running when the first sample comes.
    """

    def __init__(
        self,
        model: SensorModel,
        config: Config,
        rig: Rig,
        start: Start | None = None,
        candidates: tuple[Effect, ...] = (),
        running_s: float = 0.0,
    ) -> None:
        self.model, self.config, self.rig = model, config, rig
        self.parametrisation = PARAMETRISATIONS[config.features.parametrisation]
        self.expect_pixel_noise(config.camera.pixel_noise_px)
        reference_std = math.radians(config.reference.heading_noise_deg)
        self.reference_noise = AdaptiveNoise(reference_std, 1e-3 * reference_std, 1e3 * reference_std)
        self.has_started = False
        self._parts, self._candidates = sort_effects(model.effects), sort_effects(candidates)
        if self.parametrisation.rows != 2 and (self._parts.act_on_images or self._candidates.act_on_images):
            raise ConfigError(
                'effects on the camera need features measured in pixels',
                where='features.parametrisation',
                todo='use inverse_depth',
            )
        self.state: State = initial_state(model, config, start, self._candidates.count)
        self.memories = self._parts.no_memories()
        """What the gyro effects remember at the present state."""
        self._candidate_memories = self._candidates.no_memories()
        self._buffer = MotionBuffer(running_s)
        self._waiting: deque[Sight] = deque()
        self._pose_rate: Array = np.zeros(6)
        self._resting_since_ns: int | None = None
        self._updated_at: Array | None = None
        self._reference_offset: float | None = None
        self._lost_frames = 0
        self._restarts = 0

    def expect_pixel_noise(self, std_px: float) -> None:
        """Begin the estimation of the pixels' noise (anew) with this standard deviation."""
        highest_px = max(HIGHEST_PIXEL_NOISE_PX, 5.0 * std_px)
        self.pixel_noise = AdaptiveNoise(std_px, LOWEST_PIXEL_NOISE_PX, highest_px)

    def step(self, measurement: Measurement) -> list[StepRecord]:
        """Take one measurement; return the steps that have become possible by it (often none).

        Raises:
            FilterDivergedError: the measurements contradict the estimate beyond repair.
        """
        match measurement:
            case FeatureObservations() | HeadingSample():
                self._waiting.append(measurement)
            case ClockStep():
                return self._start_new_time_base(measurement)
            case TruthSample():
                return []
            case Frame():
                raise TypeError('images are for a filter with eyes, see `seeing`')
            case _:
                self._buffer.add(measurement)
                if not self._waiting and measurement.t_ns - self.state.t_ns <= MAX_BLOCK_NS:
                    return []  # most samples: nothing to do until the next image
        return self._catch_up(self._buffer.covered_until_ns())

    def finish(self) -> list[StepRecord]:
        """Use what still waits, at the end of the stream."""
        return self._catch_up(self._true_time_ns(self._waiting[-1]) if self._waiting else None)

    @property
    def running_s(self) -> float:
        """How long the gyro has been running, as far as is known."""
        return self._buffer.running_s(self.state.t_ns)

    def view(self) -> PosedCamera:
        """The camera at the present estimate."""
        assert self.rig.camera is not None
        state = self.state
        camera, mount = true_camera(self._parts, self.rig.camera, self.rig.camera_mount, state.coefficients)
        return posed_camera(camera, mount, state.position_m, state.euler_rad)

    def regions(self) -> SearchRegions:
        """Where the mapped features are expected in an image taken now."""
        return search_regions(self.state, self.view(), self.parametrisation, self.pixel_noise.std)

    def _catch_up(self, covered_ns: int | None) -> list[StepRecord]:
        records: list[StepRecord] = []
        if covered_ns is None or self._buffer.start_ns is None:
            return records
        if not self.has_started:
            self.state = replace(self.state, t_ns=self._buffer.start_ns)
            self.has_started = True
        while self._waiting and (moment_ns := self._true_time_ns(self._waiting[0])) <= covered_ns:
            seen = self._waiting.popleft()
            while moment_ns - self.state.t_ns > MAX_BLOCK_NS:
                records.append(self._predict_to(self.state.t_ns + MAX_BLOCK_NS))
            if moment_ns > self.state.t_ns:
                records.append(self._predict_to(moment_ns, seen))
        while covered_ns - self.state.t_ns > MAX_BLOCK_NS:
            records.append(self._predict_to(self.state.t_ns + MAX_BLOCK_NS))
        return records

    def _true_time_ns(self, seen: Sight) -> int:
        """The stamp, put right by the model's time offset."""
        offset_s = sum(float(self.state.coefficients[place][0]) for _, place in self._parts.time)
        return seen.t_ns - nanoseconds(offset_s)

    def _predict_to(self, t_ns: int, seen: Sight | None = None) -> StepRecord:
        """One cycle of the filter: predict, stand still if it does, correct."""
        block = self._buffer.cut(self.state.t_ns, t_ns)
        before, config = self.state, self.config
        walk = math.radians(config.reference.heading_walk_deg) if self._reference_offset is not None else 0.0
        self.state, transition = predict(
            before, block, self.model, self._parts, self.memories, config.gyro, config.wheels, walk
        )
        correction = transition.contribution.correction
        self.memories, self._pose_rate = correction.memories, transition.motion.pose_rate
        if self._candidates.count:
            self.state, self._candidate_memories = predict_sensitivity(
                self.state, transition, block, self._candidates, self._candidate_memories
            )
        resting = UpdateStats()
        if self._is_resting(block):
            std = math.radians(config.rest.rotation_noise_deg)
            gate = chi_square_quantile(1.0 - config.features.outlier_probability, 3)
            self.state, resting = zero_rate_update(before, self.state, transition.matrix, std, gate)

        image, event = ImageUpdate(), ''
        if isinstance(seen, HeadingSample):
            image = self._compare_heading(seen)
        elif seen is not None:
            image = self._see(seen)
            event = self._watch(image)
        r, columns = self.state.robot_size, block.dt_s @ correction.by_values
        learned = self.state.coefficients - before.coefficients
        return StepRecord(
            t_ns=t_ns,
            mean=self.state.mean[:r],
            std=np.sqrt(np.diagonal(self.state.covariance)[:r]),
            image=image,
            resting=resting,
            block=block,
            correction_rad=float(block.dt_s @ correction.rate_rad_s + columns @ learned),
            tilt_rad=_turned_by_tilt(before, transition, block),
            columns=columns,
            gyro_valid_s=float(np.sum(block.dt_s * correction.sees)),
            unobserved_turn_std_rad=float(np.sum(block.dt_s * correction.noise_rad_s)),
            pixel_noise_px=self.pixel_noise.std,
            event=event,
        )

    def _is_resting(self, block: MotionBlock) -> bool:
        """Whether the robot stands still; a gap in the IMU is not standing still."""
        if not block.wheels_at_rest or block.gap_s > 0.0:
            self._resting_since_ns = None
            return False
        if self._resting_since_ns is None:
            self._resting_since_ns = block.start_ns
        return seconds(block.end_ns - self._resting_since_ns) > self.config.rest.settle_s

    def _eye(self) -> ImageModel:
        return ImageModel(
            view=self.view(),
            form=self.parametrisation,
            config=self.config,
            noise_px=self.pixel_noise.std,
            parts=self._parts,
            candidates=self._candidates,
            pose_rate=self._pose_rate,
        )

    def _see(self, observations: FeatureObservations) -> ImageUpdate:
        if self.parametrisation.needs_motion_gate and not self._has_moved():
            return ImageUpdate()
        self._updated_at = self.state.mean[POSE].copy()
        self.state, image = update_from_image(self.state, self._eye(), observations)
        fresh = unmapped(self.state, observations, self.config.features.map_size)
        if fresh:
            self.state = add_landmarks(self.state, self._eye(), observations, fresh)
        if self.config.camera.estimate_pixel_noise:
            self.pixel_noise.follow(image.noise_distances, 2)
        return replace(image, added=len(fresh))

    def _has_moved(self) -> bool:
        """The motion gate of the paper's parametrisation: some parallax or turn since the last update."""
        if self._updated_at is None:
            return True
        moved = self.state.mean[POSE] - self._updated_at
        features = self.config.features
        far = float(np.linalg.norm(moved[:3])) >= features.motion_gate_m
        return far or abs(moved[YAW]) >= math.radians(features.motion_gate_deg)

    def _watch(self, image: ImageUpdate) -> str:
        """Give the map up when image after image contradicts it; give up altogether in the end."""
        if self.pixel_noise.is_at_the_top:
            raise FilterDivergedError(
                f'the images miss what is expected of them by {self.pixel_noise.std:.0f} px and more',
                todo=CHECK_THE_CAMERA,
            )
        contradicted = image.rejected > 2 * image.used and image.rejected >= 3
        self._lost_frames = self._lost_frames + 1 if contradicted else 0
        if self._lost_frames < LOST_FRAMES:
            return ''
        self._lost_frames = 0
        self._restarts += 1
        if self._restarts > MAX_RESTARTS:
            raise FilterDivergedError(
                f'the images contradict the estimate again and again ({self._restarts} new maps)',
                todo=CHECK_THE_CAMERA,
            )
        self.state = forget_all(self.state)
        return 'the images contradicted the map; a new map was begun'

    def _compare_heading(self, sample: HeadingSample) -> ImageUpdate:
        """Correct by another heading reference, aligned to the map when it first speaks."""
        state, noise = self.state, self.reference_noise
        if self._reference_offset is None:
            self._reference_offset = sample.yaw_rad - float(state.mean[YAW])
            covariance = state.covariance.copy()
            covariance[YAW, YAW] += noise.std**2
            self.state = replace(state, covariance=covariance)
            return ImageUpdate()
        by_values, by_candidates = np.zeros(self._parts.count), np.zeros(self._candidates.count)
        for derivative, parts in ((by_values, self._parts), (by_candidates, self._candidates)):
            for _, place in parts.time:
                derivative[place] = -self._pose_rate[YAW]
        yaw_rad = sample.yaw_rad - self._reference_offset
        self.state, lesson, residual, std = heading_update(
            state, yaw_rad, noise.std, by_values, by_candidates
        )
        if std < 2.0 * noise.std:
            noise.follow(np.array([lesson.nis]), 1)
        return ImageUpdate(lesson=lesson, heading_rad=residual, heading_std_rad=std)

    def _start_new_time_base(self, step: ClockStep) -> list[StepRecord]:
        """Keep the calibration; forget where the robot is, for nobody saw it move meanwhile."""
        records = self.finish()
        self._waiting.clear()
        self._buffer = MotionBuffer(self.running_s)
        self._resting_since_ns = self._reference_offset = None
        self.state = inflate_after_gap(forget_all(self.state), step.t_ns)
        self.has_started = False
        return records


def _turned_by_tilt(before: State, transition: Transition, block: MotionBlock) -> float:
    turned_rad = transition.motion.euler_rad[2] - before.mean[YAW]
    return float(turned_rad - block.dt_s @ transition.rate_rad_s[:, 2])
