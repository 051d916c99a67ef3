"""Updates by another heading reference than the ceiling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import GyroConfig, ReferenceConfig
from gyrocal_ros.data import Array, HeadingSample, MotionBlock, changed, seconds
from gyrocal_ros.ekf.equations.effects_by_place import EffectsByPlace
from gyrocal_ros.ekf.equations.update import (
    MeasurementUpdate,
    UpdateStats,
    heading_innovation,
    heading_update,
)
from gyrocal_ros.ekf.noise.reference_learner import ReferenceLearner
from gyrocal_ros.ekf.noise.reference_noise import OUTLIER_SIGMA, JumpDetector, JumpsWithTurns, ReferenceNoise
from gyrocal_ros.ekf.noise.shared_noise import SharedNoise
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW, YAW_BIAS, State
from gyrocal_ros.model.sensor import SensorModel

CONTAINS_GYRO = (
    'the heading reference follows the noise of the gyro, so it is computed from this gyro and cannot '
    'calibrate it; name a reference that does not use the gyro'
)
JUMPS_WITH_TURNS = (
    'the heading reference jumps with every turn, so it smooths the heading, or its stamps are not those of '
    'its headings; name another one, or let it publish the heading as measured'
)
"""What may be wrong with a reference."""
SLOW_RAD_S = math.radians(10.0)
"""Rate up to which a reference that was just learned is aligned."""
GYRO_LAG = 'gyro_lag'
"""Name of the effect of the gyro that looks like a time offset of the reference."""


@dataclass(frozen=True, slots=True)
class ModelLag:
    """The lag of the gyro as a model has it at the start of a run.

    A reference whose time offset is learned hardly shows it: the offset is what is left beside this lag.
    """

    index: int
    """Its place among the coefficients."""
    mean_s: float
    std_s: float

    @classmethod
    def of(cls, model: SensorModel, start: State) -> ModelLag | None:
        """Return it at a state; None where the model has none."""
        if GYRO_LAG not in model.coefficient_names:
            return None
        index = model.coefficient_names.index(GYRO_LAG)
        place = COEFFICIENTS_START + index
        return cls(index, float(start.mean[place]), math.sqrt(start.covariance[place, place]))


class HeadingReference:
    """Aligns a heading reference to the map at its first sample, then updates the filter with it.

    Its random walk is part of the heading in the state: that is the heading in the frame of the reference.

    Args:
        config: its noise, or that this is learned: then the filter ignores it at first.
        gyro: noise of the gyro.
        lag: lag of the gyro that the model has.
    """

    def __init__(self, config: ReferenceConfig, gyro: GyroConfig, lag: ModelLag | None = None) -> None:
        self.noise = reference_noise(config)
        self._learner = ReferenceLearner(gyro) if config.estimate_noise else None
        self._lag = lag if config.estimate_noise else None
        self._gyro_walk = math.radians(gyro.rate_noise_deg_s)
        self._usual_walk_deg_s = gyro.bias_walk_deg_s
        self._offset_rad: float | None = None
        self._jumps, self._jumps_with_turns = JumpDetector(), JumpsWithTurns()
        self._last: HeadingSample | None = None
        self._shared, self._contains_gyro = SharedNoise(), False

    def wander(self, state: State, duration_s: float) -> State:
        """Add random walks over a time: of the reference, and that of the bias beyond the settings.

        There are none before the first sample.
        """
        if self._offset_rad is None:
            return state
        covariance = state.covariance.copy()
        covariance[YAW, YAW] += float(self.noise.walk_rad) ** 2 * duration_s
        covariance[YAW_BIAS, YAW_BIAS] += self._added_bias_walk() * duration_s
        return changed(state, covariance=covariance)

    @property
    def bias_walk_deg_s(self) -> float:
        """Random walk of the bias of the gyro, deg/s/sqrt(s), as far as it is known."""
        return self._usual_walk_deg_s if self._learner is None else self._learner.bias_walk_deg_s

    def _added_bias_walk(self) -> float:
        """Return the variance per second by which the bias walks more than the settings say."""
        return math.radians(self.bias_walk_deg_s) ** 2 - math.radians(self._usual_walk_deg_s) ** 2

    @property
    def time_offset_s(self) -> float:
        """Stamp minus true time, by which stamps are to be corrected."""
        return 0.0 if self._learner is None else self._learner.time_offset_s

    @property
    def _offset_std_s(self) -> float:
        return 0.0 if self._learner is None else self._learner.time_offset_std_s

    def move(self, block: MotionBlock, rest_noise_rad_s: float | None) -> None:
        """Follow one block of the gyro.

        Args:
            block: samples of the gyro.
            rest_noise_rad_s: density of its noise where the robot is at rest in the block.
        """
        self._shared.move(block)
        self._jumps_with_turns.move(block)
        if self._learner is not None:
            self._learner.move(block, rest_noise_rad_s)

    def numbers(self) -> dict[str, float]:
        """Return noise and time offset, by the names of /diagnostics; empty while they are unknown."""
        if self._learner is not None and self._learner.noise is None:
            return {}
        return {
            'reference_noise_deg': round(math.degrees(float(self.noise.white_rad)), 4),
            'reference_walk_deg': round(math.degrees(float(self.noise.walk_rad)), 4),
            'reference_stamp_noise_s': round(float(self.noise.stamp_s), 4),
            'reference_time_offset_s': round(self.time_offset_s, 4),
            'gyro_bias_walk_deg_s': self.bias_walk_deg_s,
        }

    @property
    def finding(self) -> str:
        """What is wrong with the reference; empty where nothing is."""
        if self._contains_gyro:
            return CONTAINS_GYRO
        return JUMPS_WITH_TURNS if self._jumps_with_turns.scale_error else ''

    def suspected_std(self, unknown_std: Array) -> Array:
        """Return the standard deviations (1 + k,) of yaw bias and coefficients by what is wrong.

        Args:
            unknown_std: (1 + k,) standard deviations of all of them where nothing is known.
        """
        if self._contains_gyro:
            return unknown_std
        std = np.zeros_like(unknown_std)
        std[SCALE : SCALE + 1] = self._jumps_with_turns.scale_error
        if self._lag is not None:
            std[1 + self._lag.index] = self._lag.std_s
        return std

    def forget_alignment(self) -> None:
        """Align again at the next sample."""
        self._offset_rad = None

    def update(
        self,
        state: State,
        sample: HeadingSample,
        effects: EffectsByPlace,
        candidates: EffectsByPlace,
        pose_rate: Array,
    ) -> tuple[State, MeasurementUpdate]:
        """Correct the state by one sample.

        Args:
            state: predicted to the time of the sample.
            sample: heading by the reference.
            effects: effects of the model; a time offset changes the expected heading.
            candidates: effects that the model lacks.
            pose_rate: (6,) rate of the pose.
        """
        if self._last is not None and sample.yaw_rad == self._last.yaw_rad:
            return state, MeasurementUpdate()  # at rest, frozen, or within one step of the digits
        dt_s = 0.0 if self._last is None else seconds(sample.t_ns - self._last.t_ns)
        self._last = sample
        if not self._learn(sample.yaw_rad, float(pose_rate[YAW]), self._delay_s(state)):
            return state, MeasurementUpdate()
        stamp_s = math.hypot(self._offset_std_s, float(self.noise.stamp_s))
        white_rad = math.hypot(float(self.noise.white_rad), stamp_s * float(pose_rate[YAW]))
        if self._offset_rad is None:
            return self._align(state, sample, white_rad), MeasurementUpdate()
        by_values, by_candidates = np.zeros(effects.count), np.zeros(candidates.count)
        for derivative, group in ((by_values, effects), (by_candidates, candidates)):
            for _, place in group.time:
                derivative[place] = -pose_rate[YAW]
        yaw_rad = sample.yaw_rad - self._offset_rad
        residual, known = heading_innovation(state, yaw_rad, by_values)
        variance = known + white_rad**2
        may_have_jumped, has_jumped = self._jumps.update(np.array([residual / math.sqrt(variance)]), dt_s)
        if has_jumped[0]:
            self._jumps_with_turns.add(residual)
            event = f'the heading reference jumped by {math.degrees(residual):+.1f} deg'
            return self._align(state, sample, white_rad), MeasurementUpdate(event=event)
        if may_have_jumped[0]:
            return state, MeasurementUpdate(rejected=1)
        distance = residual**2 / variance
        std = math.sqrt(variance / float(self.noise.weight(distance)) - known)
        state, stats, residual = heading_update(state, yaw_rad, std, by_values, by_candidates)
        log_likelihood = float(self.noise.log_likelihood(variance, distance))
        return state, MeasurementUpdate(
            stats=with_log_likelihood(stats, log_likelihood),
            rejected=int(distance > OUTLIER_SIGMA**2),
            heading_rad=residual,
            heading_std_rad=std,
        )

    def _delay_s(self, state: State) -> float:
        """Return the time by which the nominal gyro lags, according to the model at its start."""
        if self._lag is None:
            return 0.0
        return self._lag.mean_s / (1.0 + float(state.mean[COEFFICIENTS_START]))

    def _learn(self, yaw_rad: float, rate_rad_s: float, delay_s: float) -> bool:
        """Learn from a heading what the reference is like; return True if it may be used."""
        self._shared.add(yaw_rad)
        self._contains_gyro |= self._shared.is_shared
        if self._learner is None:
            return True
        self._learner.add(yaw_rad - delay_s * rate_rad_s, rate_rad_s)
        if self._learner.noise is None:
            return False
        self.noise = self._without_gyro(self._learner.noise)
        # Stamps that were just corrected are not exact yet.
        return self._offset_rad is not None or abs(rate_rad_s) <= SLOW_RAD_S

    def _without_gyro(self, noise: ReferenceNoise) -> ReferenceNoise:
        """Return the noise of the reference alone, given its random walk together with that of the gyro."""
        walk_rad = math.sqrt(max(float(noise.walk_rad) ** 2 - self._gyro_walk**2, 0.0))
        return ReferenceNoise(noise.white_rad, walk_rad, noise.tail_dof, noise.stamp_s)

    def _align(self, state: State, sample: HeadingSample, white_rad: float) -> State:
        """Align the frame of the reference to the map, so that the heading in it is that of the sample.

        What the heading had to do with bias and scale factor before says nothing about the new frame.
        """
        self._offset_rad = sample.yaw_rad - float(state.mean[YAW])
        covariance, sensitivity = state.covariance.copy(), state.sensitivity.copy()
        covariance[YAW], covariance[:, YAW], sensitivity[YAW] = 0.0, 0.0, 0.0
        covariance[YAW, YAW] = white_rad**2
        return changed(state, covariance=covariance, sensitivity=sensitivity)


def reference_noise(config: ReferenceConfig) -> ReferenceNoise:
    """Return the noise of the settings."""
    return ReferenceNoise(
        math.radians(config.heading_noise_deg),
        math.radians(config.heading_walk_deg),
        config.tail_dof,
        config.stamp_noise_s,
    )


def with_log_likelihood(stats: UpdateStats, log_likelihood: float) -> UpdateStats:
    """Return the statistics of one number with the log-likelihood by its own distribution."""
    log_determinant = -2.0 * log_likelihood - stats.nis - math.log(2.0 * math.pi)
    return changed(stats, log_determinant=log_determinant)
