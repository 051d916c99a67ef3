"""A map of the bias in its closed form: one place with a disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.effects.learned.curve import TYPICAL
from gyrocal_ros.effects.learned.place_map import PLACE
from gyrocal_ros.model.sensor import Coefficient

BUMP: Literal['bump'] = 'bump'


@dataclass(frozen=True)
class Bump(LinearGyroEffect):
    """`c exp(-d^2 / (2 width^2))` at the distance d from a place; valid with one map."""

    name: str = f'bias_map:{PLACE}'
    coefficients: tuple[Coefficient, ...] = (Coefficient('c1', 'rad/s', prior_std=TYPICAL['bias']),)
    form: Literal['bump'] = BUMP
    x_m: float = 0.0
    y_m: float = 0.0
    width_m: float = 0.5

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='The bias is disturbed at one place in the room, by a motor under a table, a magnet or a '
            'cable, and less far from it. It is valid in the map of this recording only.',
            equation='w = w_n + c exp(-((x - x0)^2 + (y - y0)^2) / (2 width^2)), '
            f'x0 = {self.x_m:.3g} m, y0 = {self.y_m:.3g} m, width = {self.width_m:.3g} m',
            usual_size='as found',
            best_motion='slow passes over the place and around it',
            source='IEEE Std 952-1997, magnetic sensitivity',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='place',
        )

    @property
    def parameters(self) -> tuple[float, ...]:
        """Place and width, in which it is not linear, m."""
        return self.x_m, self.y_m, self.width_m

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of a change of each of `parameters` that changes the form."""
        return (self.width_m,) * 3

    def at(self, parameters: tuple[float, ...]) -> Bump:
        """Return the effect with other `parameters`."""
        return Bump(self.name, self.coefficients, self.form, *parameters)

    def columns(self, block: MotionBlock) -> Array:
        """Return the bump (N, 1); zero where no filter tells the position."""
        if block.position_m is None:
            return np.zeros((len(block.dt_s), 1))
        return bumps(block.position_m, np.array([self.parameters]))


def bumps(position_m: Array, parameters: Array) -> Array:
    """Return bumps of unit height (n, q).

    Args:
        position_m: (n, 2) positions in the map.
        parameters: (q, 3) place and width of each bump, m.
    """
    away = position_m[:, None, :] - parameters[None, :, :2]
    height: Array = np.exp(-0.5 * np.square(away).sum(axis=2) / np.square(parameters[:, 2]))
    return height
