"""Eqs. (5), (6): what the gyro puts out, and what of it is left to estimate.

The paper writes the sensor's voltage as

    u = S(wz) + Mx wx + My wy + Bg(ax, ay, az) + Bz + nz        (5)

and then neglects M and Bg. Recorded samples already carry the nominal scale factor and bias (6),
so everything here is a correction, in rad/s, to the nominal rate:

    wz = wz_nom + dwz                                           (6)

Each term of dwz, the paper's powers of u as well as the terms that it neglects, is an effect of the
library; `sensor` says what an effect is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import GyroEffect, Memory


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What all gyro effects together add to the yaw rate of a block, the bias not counted."""

    rate_rad_s: Array
    """(N,)"""
    by_values: Array
    """(N, K) derivative with respect to all coefficients of the model; zero for other effects'."""
    noise_rad_s: Array | float
    """(N,) standard deviation of what an effect cannot tell, as where the sensor saturates."""
    memories: tuple[Memory, ...]
    """What each effect remembers for the next block."""


def correct(
    effects: Sequence[tuple[GyroEffect, slice]],
    block: MotionBlock,
    values: Array,
    memories: Sequence[Memory],
) -> Correction:
    """Eq. (7): the correction dwz, sum of all terms.

    Args:
        effects: gyro effects with the place of their coefficients among all K.
        block: N intervals.
        values: (K,) coefficients.
        memories: what each effect remembers of the blocks before.
    """
    rate = np.zeros(len(block.dt_s))
    by_values = np.zeros((len(block.dt_s), len(values)))
    variance: Array | float = 0.0
    kept = []
    for (effect, place), memory in zip(effects, memories, strict=True):
        term = effect.contribute(block, values[place], memory)
        rate += term.rate_rad_s
        by_values[:, place] = term.by_values
        kept.append(term.memory)
        if term.noise_rad_s is not None:
            variance = variance + term.noise_rad_s**2
    return Correction(rate, by_values, np.sqrt(variance), tuple(kept))


def body_rates(block: MotionBlock, correction_rad_s: Array, bias_rad_s: Array) -> Array:
    """Eq. (9): true body rates (N, 3): nominal roll and pitch rates, corrected yaw rate.

    The paper leaves roll and pitch rates as they are; here their biases (of `bias_rad_s`, (3,))
    are taken off too, for without that the camera would have to fight them.
    """
    rate = block.rate_rad_s + bias_rad_s
    rate[:, 2] += correction_rad_s
    return rate
