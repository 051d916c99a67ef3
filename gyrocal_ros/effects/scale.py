"""The scale-factor function: powers of the nominal rate, the paper's a1 ... an."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.model.sensor import Coefficient, TypicalRange

FULL_RATE_RAD_S = math.radians(100.0)
USUAL_NONLINEARITY = 0.01
"""Deviation from a straight line at 100 deg/s, the prior of every power above the first."""


@dataclass(frozen=True)
class ScalePower(LinearGyroEffect):
    """`a_n w^n`: the n-th power of the scale-factor function, first column of U for n = 1."""

    power: int
    name: str
    coefficients: tuple[Coefficient, ...]

    @property
    def about(self) -> Explanation:
        """Explanation of this power."""
        example = (0.05 if self.power == 1 else USUAL_NONLINEARITY / FULL_RATE_RAD_S ** (self.power - 1),)
        twins = ('scale_quadratic', 'scale_cubic', 'rate_saturation')
        return _EXPLANATIONS.get(self.power) or Explanation(
            physics='The reading bends away from a straight line against the rate, most of all towards the '
            f'largest rates. It remains when powers lower than {self.power} have been corrected.',
            equation=f'w = w_n + a{self.power} w_n^{self.power}',
            usual_size='to 1 % at 100 deg/s',
            best_motion='turns at many speeds up to the fastest, both ways',
            twins=twins,
            source='Lee et al. 2012, eq. (7)',
            example=example,
        )

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        rate_rad_s = block.rate_rad_s[:, 2:]
        return rate_rad_s if self.power == 1 else rate_rad_s**self.power


_EXPLANATIONS = {
    1: Explanation(
        physics='Every sensor leaves the factory with a sensitivity of its own, some per cent off that of '
        'the data sheet. Each turn is then read too long or too short by the same fraction: with 5 per cent, '
        'a full turn is read 18 degrees wrong. This is the first thing to calibrate, and in every model.',
        equation='w = w_n + a1 w_n = (1 + a1) w_n',
        usual_size='0.5 to 10 %',
        best_motion='any turns; one full turn to each side is enough to begin with',
        twins=('scale_cubic', 'rate_saturation'),
        source='Lee et al. 2012, eqs. (6), (7); IEEE Std 528, Inertial Sensor Terminology: scale factor',
        example=(0.05,),
    ),
    2: Explanation(
        physics='The sensor responds more strongly the faster it turns to one side, and more weakly the '
        'faster it turns to the other: its reading against the rate is part of a parabola. Turns to both '
        'sides at one speed look like an asymmetry; only several speeds distinguish the two.',
        equation='w = w_n + a2 w_n^2',
        usual_size='to 0.5 % at 100 deg/s',
        best_motion='turns at several speeds, both ways',
        twins=('scale_asymmetry',),
        source='Lee et al. 2012, eq. (7); IEEE Std 528, Inertial Sensor Terminology: nonlinearity',
        shows_in_any_turns=True,
        example=(0.002,),
    ),
    3: Explanation(
        physics='The sensor responds more weakly, or more strongly, the faster it turns, to both sides '
        'alike, because springs stiffen and amplifiers approach their limits. Turns at one speed hide it in '
        'the scale factor, which then is wrong at every other speed.',
        equation='w = w_n + a3 w_n^3',
        usual_size='to 1 % at 100 deg/s',
        best_motion='turns at several speeds: three each way at 30 and at 90 deg/s',
        twins=('scale_factor', 'rate_saturation'),
        source='Lee et al. 2012, eq. (7); IEEE Std 528, Inertial Sensor Terminology: nonlinearity',
        shows_in_any_turns=True,
        example=(0.002,),
    ),
}

_TYPICAL = {2: TypicalRange(5e-4, 3e-3), 3: TypicalRange(5e-4, 3.3e-3)}


def scale_power(power: int, prior_std: float | None = None) -> ScalePower:
    """Make the n-th power; the first three have names of their own, further ones are `scale_power_N`."""
    names = {1: 'scale_factor', 2: 'scale_quadratic', 3: 'scale_cubic'}
    units = {1: '1', 2: 's/rad'}
    if prior_std is None:
        prior_std = 0.1 if power == 1 else USUAL_NONLINEARITY / FULL_RATE_RAD_S ** (power - 1)
    name = names.get(power, f'scale_power_{power}')
    unit = units.get(power, f's^{power - 1}/rad^{power - 1}')
    item = Coefficient(f'a{power}', unit, prior_std, typical=_TYPICAL.get(power))
    return ScalePower(power, name, (item,))
