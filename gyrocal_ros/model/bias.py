"""Process model of the yaw bias."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BiasModel:
    """Process model of the yaw bias.

    `drift` is a random walk. `settling` is the paper's first-order approach to a final value. It pulls every
    gyro towards that value, so an unknown turn-on offset makes the estimate lag; the default departs from
    the paper here.
    """

    form: str = 'drift'
    time_constant_s: float = 500.0
    settled_rad_s: float = 0.0

    def step(self, bias_rad_s: float, dt_s: float) -> tuple[float, float]:
        """Eq. (8): return the bias after `dt_s`, and its derivative with respect to the bias before.

        For `drift` T is infinite. The paper's quotient T / (T + dt) is the first order of the exponential
        used here, whose result does not depend on the length of the step.
        """
        if self.form == 'drift':
            return bias_rad_s, 1.0
        keep = math.exp(-dt_s / self.time_constant_s)
        return keep * bias_rad_s + (1.0 - keep) * self.settled_rad_s, keep
