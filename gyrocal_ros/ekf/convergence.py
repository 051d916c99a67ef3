"""When a calibration is done: known well enough, by a filter that measurements do not contradict."""

from __future__ import annotations

from collections import deque

from gyrocal_ros.config.sections import ConvergenceConfig

CONSISTENCY_STEPS = 300
"""The filter's consistency is judged by the NIS of so many last steps."""


class Convergence:
    """Watches the steps of a filter; its memory does not grow with their number."""

    def __init__(self) -> None:
        self.since_s: float | None = None
        """When the standard deviation of the scale factor went, and stayed, under its threshold."""
        self._recent: deque[tuple[float, int]] = deque(maxlen=CONSISTENCY_STEPS)
        self._nis, self._dof = 0.0, 0

    def add(self, time_s: float, scale_std: float, nis: float, dof: int, config: ConvergenceConfig) -> None:
        """Take in one step.

        Args:
            time_s: its time.
            scale_std: standard deviation of the scale factor after it.
            nis: of what it measured.
            dof: of that; zero where nothing was measured.
            config: the threshold.
        """
        if scale_std > config.scale_std:
            self.since_s = None
        elif self.since_s is None:
            self.since_s = time_s
        if dof > 0:
            self._recent.append((nis, dof))
            self._nis, self._dof = self._nis + nis, self._dof + dof

    @property
    def has_measured(self) -> bool:
        """Whether anything was measured at all."""
        return self._dof > 0

    @property
    def is_settled(self) -> bool:
        """Whether there are enough steps for a judgement that does not change with every one."""
        return len(self._recent) == CONSISTENCY_STEPS

    @property
    def recent_nis(self) -> float:
        """NIS per degree of freedom of late; 1 for a filter that is right. NaN before the first."""
        dof = sum(dof for _, dof in self._recent)
        return sum(nis for nis, _ in self._recent) / dof if dof else float('nan')

    @property
    def overall_nis(self) -> float:
        """The same since the start."""
        return self._nis / self._dof if self._dof else float('nan')

    def is_consistent(self, config: ConvergenceConfig) -> bool:
        """Whether the innovations are as large as the filter says they should be, of late and on the whole.

        The last steps tell what the filter is worth now. The whole run tells what the noise estimate
        has swallowed since, as it does where the camera is not what it is believed to be.
        """
        is_sure_enough = self.has_measured and self.recent_nis >= config.nis_low
        return is_sure_enough and not self.is_contradicted(config)

    def is_contradicted(self, config: ConvergenceConfig) -> bool:
        """Whether the innovations are larger than the filter says; where they are smaller, it only doubts."""
        return self.has_measured and max(self.recent_nis, self.overall_nis) > config.nis_high
