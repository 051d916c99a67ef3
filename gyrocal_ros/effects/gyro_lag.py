"""A low-pass filter inside the sensor delays what it reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class GyroLag(LinearGyroEffect):
    """`tau dw_n/dt` undoes a first-order low-pass filter of time constant tau over the scale factor."""

    about: ClassVar[Explanation] = Explanation(
        physics='A low-pass filter in the sensor suppresses noise and delays every change of the rate. '
        'Where a turn begins the sensor reads too little, and where it ends it still reads a rate. '
        'Over a whole turn the two cancel; in between the heading lags by rate times delay. '
        'The delay is tau divided by the scale factor.',
        equation='w = w_n + tau dw_n/dt',
        usual_size='5 to 60 ms',
        best_motion='turns that start and stop abruptly',
        twins=('camera_time_offset',),
        source='InvenSense, MPU-6000 and MPU-6050 register map: delay of the gyro against the setting '
        'of its digital low-pass filter',
        shows_in_any_turns=True,
        may_break_the_filter=True,
        example=(0.02,),
        shown_against='turn',
    )
    name: str = 'gyro_lag'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('tau', 's', prior_std=0.03, typical=TypicalRange(0.003, 0.06, signed=False)),
    )

    def unobservable(self, recording: RecordingSummary) -> str:
        """Return why a recording cannot show it; empty if it may."""
        if recording.rig.camera is None and self.name not in recording.certain:
            return 'the time offset of the heading reference, which is estimated, looks the same'
        return ''

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(block.yaw_acceleration_rad_s2)

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Apply the low-pass filter, whose input is `w_n + tau / scale dw_n/dt`, by the trapezoidal rule."""
        ratio = 2.0 * values[0] / scale_factor / dt_s
        share, kept = 1.0 / (1.0 + ratio), (ratio - 1.0) / (1.0 + ratio)
        pushed = share[1:] * (nominal_rad_s[1:] + nominal_rad_s[:-1])
        level = float(nominal_rad_s[0])
        levels = [level]
        for kept_share, push in zip(kept[1:].tolist(), pushed.tolist(), strict=True):
            level = kept_share * level + push
            levels.append(level)
        return np.array(levels)
