"""The bias as a smooth function of the place in the room."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.effects.learned.curve import TYPICAL
from gyrocal_ros.effects.learned.signals import required
from gyrocal_ros.model.sensor import Coefficient

PLACE = 'place'
MAX_ORDER = 8
ORDERS = [(i, j) for i, j in product(range(MAX_ORDER + 1), repeat=2) if 0 < i * i + j * j <= MAX_ORDER**2]
"""Orders of the cosines along x and y: half a wave to four waves over the room."""
LENGTHS = (0.08, 0.12, 0.2, 0.35)
"""Lengths over which the map may change, as parts of the room."""


@dataclass(frozen=True)
class PlaceMap(LinearGyroEffect):
    """`sum_ij c_ij cos(pi i x) cos(pi j y)` over the parts x, y of the room; valid with one map."""

    name: str
    coefficients: tuple[Coefficient, ...]
    x_low_m: float = 0.0
    x_high_m: float = 1.0
    y_low_m: float = 0.0
    y_high_m: float = 1.0
    """The part of the room in which it was learned; outside the map keeps its value at the edge."""

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='The bias depends on the place in the room: a magnetic disturbance, a motor under a '
            'table, a heating. It is valid in the map of this recording only.',
            equation='w = w_n + f(x, y)',
            usual_size='as found',
            best_motion='slow passes over all of the room, each place several times',
            source='Solin and Sarkka 2020, Hilbert space methods for reduced-rank Gaussian process '
            'regression, Statistics and Computing 30',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='place',
        )

    def basis(self, position_m: Array) -> Array:
        """Return the functions (n, k) at positions (n, 2)."""
        low = np.array([self.x_low_m, self.y_low_m])
        high = np.array([self.x_high_m, self.y_high_m])
        part = np.clip((position_m - low) / (high - low), 0.0, 1.0)
        waves = np.cos(np.pi * part[:, :, None] * np.arange(MAX_ORDER + 1.0))
        along_x, along_y = np.array(ORDERS).T
        return waves[:, 0, along_x] * waves[:, 1, along_y]

    def present(self, position_m: Array) -> Array:
        """Return what the model has already (n, 1): a constant."""
        return np.ones((len(position_m), 1))

    def columns(self, block: MotionBlock) -> Array:
        """Return the functions (N, k); zero where no filter tells the position."""
        if block.position_m is None:
            return np.zeros((len(block.dt_s), len(ORDERS)))
        return self.basis(block.position_m)


def place_map(
    signal: str = PLACE, low_m: tuple[float, float] = (0.0, 0.0), high_m: tuple[float, float] = (1.0, 1.0)
) -> PlaceMap:
    """Make a map with a prior of usual size.

    Raises:
        ConfigError: the signal is not the place.
    """
    required(signal, (PLACE,), 'bias_map')
    stds = prior_stds(TYPICAL['bias'], LENGTHS[1]).tolist()
    items = tuple(Coefficient(f'c{i}{j}', 'rad/s', std) for (i, j), std in zip(ORDERS, stds, strict=True))
    return PlaceMap(f'bias_map:{signal}', items, low_m[0], high_m[0], low_m[1], high_m[1])


def prior_stds(amplitude: float, length: float) -> Array:
    """Return the prior standard deviations (k,) of a map by a squared-exponential kernel.

    Args:
        amplitude: standard deviation of the map, rad/s.
        length: length over which it changes, as a part of the room.
    """
    orders = np.array(ORDERS, float)
    density = np.exp(-0.5 * np.square(np.pi * length * orders).sum(axis=1))
    # A cosine has the mean square 1/2, the constant one 1.
    weights = np.where(orders > 0.0, 2.0, 1.0).prod(axis=1)
    stds: Array = amplitude * np.sqrt(weights * density / density.sum())
    return stds
