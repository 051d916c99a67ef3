"""Eqs. (5), (6): the output of the gyro, and the corrections that are estimated.

The paper writes the sensor's voltage as

    u = S(wz) + Mx wx + My wy + Bg(ax, ay, az) + Bz + nz        (5)

and then neglects M and Bg. Recorded samples already include the nominal scale factor and bias (6), so
everything here is a correction, in rad/s, to the nominal rate:

    wz = wz_nom + dwz                                           (6)

Each term of dwz, a power of u in the paper or a term that it neglects, is an effect of the library; `sensor`
defines effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock, quickly_filled
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.sensor import GyroEffect, GyroTerm, Memory


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Sum of the contributions of all gyro effects to the yaw rate of a block, without the bias."""

    rate_rad_s: Array
    """(N,)"""
    by_values: Array
    """(N, K) derivative with respect to all coefficients of the model; zero for other effects'."""
    noise_rad_s: Array | float
    """(N,) standard deviation of the rate where an effect leaves it unknown, as at saturation."""
    memories: tuple[Memory, ...]
    """Memory of each effect for the next block."""
    valid: Array | float = 1.0
    """(N,) 1 where the reading depends on the rate, else 0; the bias acts only where it is valid."""

    def unread_rad(self, dt_s: Array) -> float:
        """Return the standard deviation of the turn over intervals (N,) that the gyro could not read."""
        return float(dt_s @ self.noise_rad_s) if isinstance(self.noise_rad_s, np.ndarray) else 0.0

    def valid_s(self, dt_s: Array) -> float:
        """Return the time in intervals (N,) with valid readings."""
        return float(dt_s @ self.valid) if isinstance(self.valid, np.ndarray) else sum(dt_s.tolist())


def correct(
    effects: Sequence[tuple[GyroEffect, slice]],
    block: MotionBlock,
    values: Array,
    memories: Sequence[Memory],
) -> Correction:
    """Eq. (7): compute the correction dwz, the sum of all terms.

    Args:
        effects: gyro effects with the place of their coefficients among all K.
        block: N intervals.
        values: (K,) coefficients.
        memories: memory of each effect from the blocks before.
    """
    terms = [
        effect.contribute(block, values[place], memory)
        for (effect, place), memory in zip(effects, memories, strict=True)
    ]
    if len(terms) == 1 and _is_whole(terms[0], len(values)):
        return Correction(terms[0].rate_rad_s, terms[0].by_values, 0.0, (terms[0].memory,))
    rate = np.zeros(len(block.dt_s))
    by_values = np.zeros((len(block.dt_s), len(values)))
    variance: Array | float = 0.0
    kept = []
    blind_parts = []
    for (_, place), term in zip(effects, terms, strict=True):
        rate += term.rate_rad_s
        by_values[:, place] = term.by_values
        kept.append(term.memory)
        if term.noise_rad_s is not None:
            variance = variance + term.noise_rad_s**2
        if term.blind is not None and term.blind.any():
            blind_parts.append((term.blind, term.rate_rad_s))
    valid: Array | float = 1.0
    for blind, whole_rate in blind_parts:
        rate = np.where(blind, whole_rate, rate)
        valid = np.where(blind, 0.0, valid)
        by_values[blind] = 0.0
    noise = np.sqrt(variance) if isinstance(variance, np.ndarray) else 0.0
    return Correction(rate, by_values, noise, tuple(kept), valid)


def _is_whole(term: GyroTerm, count: int) -> bool:
    """Return True for the contribution of the only effect, which leaves nothing unknown."""
    return term.noise_rad_s is None and term.blind is None and term.by_values.shape[1] == count


def body_rates(block: MotionBlock, correction: Correction, bias_rad_s: Array) -> Array:
    """Eq. (9): return the true body rates (N, 3): nominal roll and pitch rates, corrected yaw rate.

    The paper leaves roll and pitch rates uncorrected. Here their biases (from `bias_rad_s`, (3,)) are
    corrected, too, because otherwise the camera would have to compensate for them.
    """
    return corrected_rates(block.rate_rad_s, correction.rate_rad_s, correction.valid, bias_rad_s)


@compiled
def corrected_rates(
    rate_rad_s: Array, correction_rad_s: Array, valid: Array | float, bias_rad_s: Array
) -> Array:
    """Return the true body rates (N, 3), see `body_rates`.

    Args:
        rate_rad_s: (N, 3) nominal.
        correction_rad_s: (N,) of the yaw rate.
        valid: (N,) 1 where the bias of the yaw rate acts, else 0, or one number for all.
        bias_rad_s: (3,)
    """
    rate = rate_rad_s + bias_rad_s
    rate[:, 2] += correction_rad_s + (valid - 1.0) * bias_rad_s[2]
    return rate
