"""Updates by another heading reference than the ceiling."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import ReferenceConfig
from gyrocal_ros.data import Array, HeadingSample
from gyrocal_ros.ekf.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.effects_by_place import EffectsByPlace
from gyrocal_ros.ekf.state import YAW, State
from gyrocal_ros.ekf.update import MeasurementUpdate, heading_update

NOISE_RANGE = 1e3
"""Maximum factor between the estimated noise and its setting, to either side."""
DOMINATED = 2.0
"""Upper bound of the standard deviation of an innovation, relative to that of the reference, for estimating
the noise of the reference from it."""


class HeadingReference:
    """Aligns a heading reference to the map at its first sample, then updates the filter with it."""

    def __init__(self, config: ReferenceConfig) -> None:
        std = math.radians(config.heading_noise_deg)
        self.noise = AdaptiveNoise(std, std / NOISE_RANGE, std * NOISE_RANGE)
        self._walk = math.radians(config.heading_walk_deg)
        self._offset_rad: float | None = None

    @property
    def walk_rad(self) -> float:
        """Random walk (rad/sqrt(s)) of the reference; zero before its first sample."""
        return 0.0 if self._offset_rad is None else self._walk

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
        if self._offset_rad is None:
            self._offset_rad = sample.yaw_rad - float(state.mean[YAW])
            covariance = state.covariance.copy()
            covariance[YAW, YAW] += self.noise.std**2
            return replace(state, covariance=covariance), MeasurementUpdate()
        by_values, by_candidates = np.zeros(effects.count), np.zeros(candidates.count)
        for derivative, group in ((by_values, effects), (by_candidates, candidates)):
            for _, place in group.time:
                derivative[place] = -pose_rate[YAW]
        yaw_rad = sample.yaw_rad - self._offset_rad
        state, stats, residual, std = heading_update(state, yaw_rad, self.noise.std, by_values, by_candidates)
        if std < DOMINATED * self.noise.std:
            self.noise.update(np.array([stats.nis]), 1)
        return state, MeasurementUpdate(stats=stats, heading_rad=residual, heading_std_rad=std)
