"""How the yaw bias moves by itself."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BiasModel:
    """How the yaw bias moves by itself.

    `drift` is a random walk. `settling` is the paper's first-order approach to a final value; it
    pulls every gyro towards that value, so a turn-on offset that it does not know makes it lag
    (the departure from the paper that the default takes).
    """

    form: str = 'drift'
    time_constant_s: float = 500.0
    settled_rad_s: float = 0.0

    def step(self, bias_rad_s: float, dt_s: float) -> tuple[float, float]:
        """Eq. (8): the bias after `dt_s`, and its derivative with respect to the bias before.

        For `drift` T is infinite. The paper's quotient T / (T + dt) is the first order of the
        exponential used here, which does not depend on the length of the step.
        """
        if self.form == 'drift':
            return bias_rad_s, 1.0
        keep = math.exp(-dt_s / self.time_constant_s)
        return keep * bias_rad_s + (1.0 - keep) * self.settled_rad_s, keep
