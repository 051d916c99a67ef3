"""Laws that the library lacks, of readings that follow the rate late: they are integrated over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place, TypicalRange


@dataclass(frozen=True)
class Resonance:
    """The reading follows the rate as a damped oscillator: `z'' = W^2 (w - z) - 2 D W z'`."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'stranger_resonance'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('period', 's', 0.0, 0.15, typical=TypicalRange(0.1, 0.3, signed=False)),
        Coefficient(
            'damping', '1', 0.0, 0.4, typical=TypicalRange(0.25, 0.5, signed=False, is_strength=False)
        ),
    )
    right: tuple[str, ...] = ('bias_memory:dynamics',)
    source: str = 'IEEE Std 1431-2004, Coriolis vibratory gyros, frequency response'
    forms: tuple[str, ...] = ('second-order lag',)
    holds_scale: bool = True

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return what the filter has to add to the reading: its derivatives, by the oscillator's equation."""
        angular, damping = 2.0 * np.pi / max(values[0], 1e-3), values[1]
        first, before = memory if memory is not None else (0.0, block.rate_rad_s[0, 2])
        slope = np.diff(block.rate_rad_s[:, 2], prepend=before) / block.dt_s
        curvature = np.diff(slope, prepend=first) / block.dt_s
        added = curvature / angular**2 + 2.0 * damping * slope / angular
        return GyroTerm(added, np.zeros((len(added), 2)), (slope[-1], block.rate_rad_s[-1, 2]))

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Integrate the oscillator over the readings of a sensor without it, by the implicit midpoint rule.

        An explicit rule would add a lag of the length of a step.
        """
        angular, damping = 2.0 * np.pi / values[0], values[1]
        before = read = float(nominal_rad_s[0])
        slope, readings = 0.0, []
        for rate, step_s in zip(nominal_rad_s.tolist(), dt_s.tolist(), strict=True):
            half = 0.5 * step_s * angular
            push = half * angular * (0.5 * (rate + before) - read)
            middle = (slope + push) / (1.0 + half**2 + 2.0 * damping * half)
            read, slope, before = read + step_s * middle, 2.0 * middle - slope, rate
            readings.append(read)
        return np.array(readings)


@dataclass(frozen=True)
class GrowingLag:
    """The reading lags by a time that grows with the rate: `w = r + s |r| dr/dt`."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'stranger_growing_lag'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('lag_per_rate', 's^2', 0.0, 0.02, typical=TypicalRange(0.005, 0.02, signed=False)),
    )
    right: tuple[str, ...] = ('bias_curve:rate_times_yaw_acceleration',)
    source: str = 'a low-pass whose time constant grows with the rate, as near the limit of a slew rate'
    forms: tuple[str, ...] = ('line',)
    holds_scale: bool = True

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return what the filter has to add to the reading."""
        rate = block.rate_rad_s[:, 2]
        added = np.abs(rate) * np.diff(rate, prepend=rate[0] if memory is None else memory) / block.dt_s
        return GyroTerm(values[0] * added, added[:, None], float(rate[-1]))

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Integrate the equation over the readings of a sensor without it, by the implicit Euler rule.

        Its lag behind a ramp is exact, whatever the length of a step.
        """
        per_rate = values[0] / scale_factor
        read, readings = float(nominal_rad_s[0]), []
        for rate, step_s in zip(nominal_rad_s.tolist(), dt_s.tolist(), strict=True):
            read += (rate - read) * step_s / (step_s + per_rate * abs(read))
            readings.append(read)
        return np.array(readings)
