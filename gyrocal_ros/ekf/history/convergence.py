"""Convergence: the scale factor is known well enough, and the filter is consistent."""

from __future__ import annotations

import math
from collections import deque

from gyrocal_ros.config.sections import ConvergenceConfig

PLAUSIBLE_SCALE = (0.5, 1.5)
"""Bounds of the scale factor of a gyro; outside, an axis is mirrored or swapped, or a unit is wrong."""
CONSISTENCY_STEPS = 300
"""Number of last steps whose NIS decides on consistency."""
STEPS_AFTER_CHANGE = 100
"""Number of steps after a changed scale factor from which their NIS decides."""


def is_plausible(scale_factor: float) -> bool:
    """Return True if a gyro can have this scale factor."""
    return PLAUSIBLE_SCALE[0] <= scale_factor <= PLAUSIBLE_SCALE[1]


class Convergence:
    """Monitors the steps of a filter in constant memory.

    Args:
        after_change: True if the filter has just followed a changed scale factor. It then counts as
            consistent only after enough steps: where the model lacks something, the scale factor seems to
            change.
    """

    def __init__(self, after_change: bool = False) -> None:
        self._after_change = after_change
        self.since_s: float | None = None
        """Time since which the standard deviation of the scale factor has been below its threshold."""
        self._recent: deque[tuple[float, int]] = deque(maxlen=CONSISTENCY_STEPS)
        self._nis, self._dof = 0.0, 0
        self._recent_nis: float | None = math.nan
        """NIS per degree of freedom of the last steps, as long as they are the same; None where it is due."""

    def add(self, time_s: float, scale_std: float, nis: float, dof: int, config: ConvergenceConfig) -> None:
        """Add one step.

        Args:
            time_s: time of the step.
            scale_std: standard deviation of the scale factor after it.
            nis: normalised innovation squared.
            dof: degrees of freedom; zero where nothing was measured.
            config: the threshold.
        """
        if scale_std > config.scale_std:
            self.since_s = None
        elif self.since_s is None:
            self.since_s = time_s
        if dof > 0:
            self._recent.append((nis, dof))
            self._recent_nis = None
            self._nis, self._dof = self._nis + nis, self._dof + dof

    @property
    def has_measured(self) -> bool:
        """True if anything was measured."""
        return self._dof > 0

    @property
    def is_settled(self) -> bool:
        """True if there are enough steps for a stable decision."""
        return len(self._recent) == CONSISTENCY_STEPS

    @property
    def recent_nis(self) -> float:
        """NIS per degree of freedom of the last steps; 1 for a consistent filter. NaN before the first."""
        if self._recent_nis is None:
            self._recent_nis = sum(nis for nis, _ in self._recent) / sum(dof for _, dof in self._recent)
        return self._recent_nis

    @property
    def overall_nis(self) -> float:
        """NIS per degree of freedom since the start."""
        return self._nis / self._dof if self._dof else float('nan')

    @property
    def inflation(self) -> float:
        """Factor, 1 or more, on standard deviations by the size of the innovations (Birge 1932)."""
        return math.sqrt(max(1.0, self.recent_nis, self.overall_nis)) if self.has_measured else 1.0

    def is_consistent(self, config: ConvergenceConfig) -> bool:
        """Return True if the innovations are as large as expected, recently and overall.

        The last steps show the present consistency. The whole run shows errors that the noise estimate has
        absorbed since, as where the camera calibration is wrong. Innovations that stay small are those of
        features better than the filter assumes.
        """
        return self.has_measured and not self.doubt(config) and not self.is_contradicted(config)

    def doubt(self, config: ConvergenceConfig) -> str:
        """Return why it is too early to call the innovations consistent, as a clause; empty where not."""
        if self._after_change and len(self._recent) < STEPS_AFTER_CHANGE:
            return 'too little has been measured since the scale factor changed'
        if self.is_too_calm(config):
            return f'the filter has not yet learned how little the images err (NIS {self.recent_nis:.1f})'
        return ''

    def is_too_calm(self, config: ConvergenceConfig) -> bool:
        """Return True while innovations are small because the noise is not estimated yet."""
        return self.has_measured and not self.is_settled and self.recent_nis < config.nis_low

    def is_contradicted(self, config: ConvergenceConfig) -> bool:
        """Return True if the innovations are larger than expected; smaller ones are only conservative."""
        return self.has_measured and max(self.recent_nis, self.overall_nis) > config.nis_high
