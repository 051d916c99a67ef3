"""Eqs. (5), (6): what the gyro puts out, and what of it is left to estimate.

The paper writes the sensor's voltage as

    u = S(wz) + Mx wx + My wy + Bg(ax, ay, az) + Bz + nz        (5)

and then neglects M and Bg. Recorded samples already carry the nominal scale factor and bias (6),
so everything here is a correction, in rad/s, to the nominal rate:

    wz = wz_nom + dwz                                           (6)

Each term of dwz, the paper's powers of u as well as the terms that it neglects, is a `GyroTerm`;
the effect library holds them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gyrocal_ros.data import Array, MotionBlock


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One number of an effect, with what is known of it before any measurement."""

    name: str
    unit: str
    prior_std: float
    prior_mean: float = 0.0
    walk: float = 0.0
    """Random walk, unit / sqrt(s); zero for a constant of the motion."""


class GyroTerm(Protocol):
    """One term of the correction dwz."""

    @property
    def name(self) -> str: ...

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """k coefficients."""

    def correction(self, block: MotionBlock, values: Array) -> Array:
        """Contribution (N,) in rad/s at the given coefficient values (k,)."""

    def jacobian(self, block: MotionBlock, values: Array) -> Array:
        """Derivative (N, k) of the contribution with respect to the coefficients."""


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


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The sensor model in use: a name, the bias, and the ordered terms of the gyro's correction."""

    name: str
    bias: BiasModel
    terms: tuple[GyroTerm, ...]
    version: int = 1

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Every coefficient in the order of the filter's state."""
        return tuple(item for term in self.terms for item in term.coefficients)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names as reported: the term's own, with the coefficient's behind it where it has several."""
        return tuple(
            term.name if len(term.coefficients) == 1 else f'{term.name}.{item.name}'
            for term in self.terms
            for item in term.coefficients
        )

    def correction(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Eq. (7): the correction dwz, without the bias, and its derivative.

        Args:
            block: N intervals.
            values: (k,) coefficients, in order.

        Returns:
            (N,) rad/s and (N, k).
        """
        total = np.zeros(len(block.dt_s))
        columns = np.empty((len(block.dt_s), len(values)))
        start = 0
        for term in self.terms:
            end = start + len(term.coefficients)
            total += term.correction(block, values[start:end])
            columns[:, start:end] = term.jacobian(block, values[start:end])
            start = end
        return total, columns


def body_rates(block: MotionBlock, correction_rad_s: Array, bias_rad_s: Array) -> Array:
    """Eq. (9): true body rates (N, 3): nominal roll and pitch rates, corrected yaw rate.

    The paper leaves roll and pitch rates as they are; here their biases (of `bias_rad_s`, (3,))
    are taken off too, for without that the camera would have to fight them.
    """
    rate = block.rate_rad_s + bias_rad_s
    rate[:, 2] += correction_rad_s
    return rate
