"""The scale factor follows the temperature of the part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column, recorded
from gyrocal_ros.model.sensor import Coefficient, TypicalRange

REFERENCE_C = 25.0


@dataclass(frozen=True)
class ScaleTemperature(LinearGyroEffect):
    """`k (T - T0) w`, T0 = 25 deg C."""

    about: ClassVar[Explanation] = Explanation(
        physics='Warmth changes how far the structure vibrates and how strongly its motion is '
        'amplified, so the same turn gives another signal when the part is warm. At rest nothing '
        'shows. The scale factor refers to 25 deg C.',
        equation='w = w_n + k (T - 25 deg C) w_n',
        usual_size='0.01 to 0.1 %/K',
        best_motion='turns at several temperatures: some right after switching on, some when warm',
        twins=('covariate_scale', 'scale_factor'),
        needs=('temperature',),
        source='Aggarwal, Syed, Niu, El-Sheimy 2008, A standard testing and calibration procedure for '
        'low cost MEMS inertial sensors and units, Journal of Navigation 61(2)',
        example=(5e-4,),
        shown_against='temperature',
    )
    name: str = 'scale_temperature'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', '1/K', prior_std=0.001, typical=TypicalRange(2e-4, 1e-3)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(recorded(block.temperature_c - REFERENCE_C) * block.rate_rad_s[:, 2])
