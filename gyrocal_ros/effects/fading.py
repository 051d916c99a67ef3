"""Exponential memory of a signal."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled


@compiled
def fading_memory(drive: Array, dt_s: Array, tau_s: Array, start: Array) -> tuple[Array, Array]:
    """Solve `dh/dt = (u - h) / tau` for a drive that is constant in each interval.

    The product h exp(t / tau) changes by the drive alone, so it is a cumulative sum.

    Args:
        drive: u (N,).
        dt_s: (N,) lengths of the intervals.
        tau_s: (q,) time constants.
        start: (q,) h at the beginning.

    Returns:
        h (N + 1, q) at the ends of the intervals and at the beginning, and exp(t / tau) there.
    """
    ends_s = np.cumsum(dt_s)[:, None]
    growth = np.concatenate([np.ones((1, len(tau_s))), np.exp(ends_s / tau_s)])
    added = np.cumsum(drive[:, None] * (growth[1:] - growth[:-1]), axis=0)
    return np.concatenate([start[None], (start + added) / growth[1:]]), growth
