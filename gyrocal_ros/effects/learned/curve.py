"""Bias or scale as a smooth function of one signal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.effects.learned.forms import Over
from gyrocal_ros.effects.learned.signals import HEADING, RATE, shown_against, to_record, values_of
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory

Of: TypeAlias = Literal['bias', 'scale']
UNIT: dict[Of, str] = {'bias': 'rad/s', 'scale': '1'}
TYPICAL: dict[Of, float] = {'bias': math.radians(0.1), 'scale': 0.01}
"""Standard deviation of a learned function before anything is known of it."""
COUNT, COUNTS = 8, {RATE: 12, HEADING: 12}
"""Number of functions of a curve: a sine takes at least two for each of its periods over the range."""
LENGTHS = (0.08, 0.15, 0.3, 0.6)
"""Lengths over which a curve may change, as parts of its range."""
GRID = 401
"""Points over the range at which the functions are made orthogonal to what the model has already."""


@dataclass(frozen=True)
class Curve(LinearGyroEffect):
    """`sum_j c_j cos(pi j x)` over the part x of the range, without what bias and scale factor explain.

    A reduced-rank Gaussian process (Solin and Sarkka 2020). Outside of the range the curve keeps its last
    value, with a noise as large as the curve.
    """

    name: str
    coefficients: tuple[Coefficient, ...]
    low: float = 0.0
    high: float = 1.0
    """Range of the signal in which the curve was learned."""

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics=f'A smooth function of {self.follows}, learned from a recording. It names no cause: look '
            'for the physics that has this shape.',
            equation=f'w = w_n + f({self.follows})' + (' w_n' if self.of == 'scale' else ''),
            usual_size='as found',
            best_motion=f'what changes {self.follows} over all of its range, again and again',
            source='Solin and Sarkka 2020, Hilbert space methods for reduced-rank Gaussian process '
            'regression, Statistics and Computing 30',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against=shown_against(self.follows),
        )

    @cached_property
    def follows(self) -> str:
        """Name of the signal."""
        return self.name.partition(':')[2]

    @property
    def over(self) -> Over:
        """What it is a function of."""
        return 'heading' if self.follows == HEADING else 'signal'

    @property
    def signal(self) -> str:
        """Name of the signal where a recording may lack it, else empty."""
        return to_record(self.follows)

    @property
    def of(self) -> Of:
        """What is a function of the signal."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    def basis(self, values: Array) -> Array:
        """Return the functions (n, k) at values (n,) of the signal; zero where the signal is not known."""
        if self.follows != HEADING:
            return cosines(values, self.low, self.high, self._explained)
        return np.where(np.isnan(values)[:, None], 0.0, _waves(values))

    def columns(self, block: MotionBlock) -> Array:
        """Return the functions (N, k), times the rate for a scale."""
        return self._columns(values_of(self.follows, block), block)

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution, with noise outside of the range."""
        signal = values_of(self.follows, block)
        columns = self._columns(signal, block)
        return GyroTerm(columns.dot(values), columns, noise_rad_s=self._noise(signal, block))

    def _columns(self, signal: Array, block: MotionBlock) -> Array:
        functions = self.basis(signal)
        return functions * block.rate_rad_s[:, 2:] if self.of == 'scale' else functions

    @cached_property
    def _explained(self) -> Array:
        """(1 or 2, k) what the model has already in each function, the same for every block."""
        grid, nothing = np.linspace(self.low, self.high, GRID), np.zeros((1, len(_orders(self.follows))))
        functions = cosines(grid, self.low, self.high, nothing)
        weights: Array = np.linalg.lstsq(self.present(grid), functions, rcond=None)[0]
        return weights

    def present(self, values: Array) -> Array:
        """Return what the model has already (n, 1 or 2): a constant, and a scale factor of the rate."""
        constant = np.ones_like(values)
        return np.stack([constant, values] if self.follows == RATE else [constant], axis=1)

    def _noise(self, signal: Array, block: MotionBlock) -> Array | None:
        if self.follows == HEADING or not ((signal < self.low) | (signal > self.high)).any():
            return None
        beyond = np.maximum(np.maximum(self.low - signal, signal - self.high), 0.0) / (self.high - self.low)
        std = math.sqrt(0.5 * sum(item.prior_std**2 for item in self.coefficients))
        noise: Array = std * np.sqrt(-np.expm1(-np.square(np.nan_to_num(beyond) / LENGTHS[0])))
        return noise * np.abs(block.rate_rad_s[:, 2]) if self.of == 'scale' else noise


@compiled
def cosines(values: Array, low: float, high: float, explained: Array) -> Array:
    """Return the functions (n, k) of a curve without what the model has already; zero where a value is NaN.

    Args:
        values: (n,) of the signal.
        low: lower end of the range.
        high: upper end.
        explained: (1 or 2, k) weights of a constant, and of the signal, in each function.
    """
    within = np.clip(np.where(np.isnan(values), low, values), low, high)
    part = (within - low) / (high - low)
    functions = np.cos(np.pi * np.arange(1.0, explained.shape[1] + 1.0) * part[:, None])
    present = np.stack([np.ones_like(within), within], axis=1)[:, : len(explained)]
    return np.where(np.isnan(values)[:, None], 0.0, functions - present @ explained)


def _waves(heading_rad: Array) -> Array:
    """Return the cosines, then the sines (n, k) of multiples of headings (n,)."""
    order = _orders(HEADING)
    half = order[: len(order) // 2] * heading_rad[:, None]
    return np.concatenate([np.cos(half), np.sin(half)], axis=1)


def curve(of: Of, signal: str, low: float = 0.0, high: float = 1.0) -> Curve:
    """Make a curve over a range, with a prior of usual size.

    Args:
        of: what follows the signal.
        signal: one of `learned.signals.UNITS`, or topic and field of a recorded one.
        low: lower end of the range.
        high: upper end, above the lower one.
    """
    stds = prior_stds(signal, TYPICAL[of], LENGTHS[1]).tolist()
    items = tuple(Coefficient(f'c{number}', UNIT[of], std) for number, std in enumerate(stds, start=1))
    return Curve(f'{of}_curve:{signal}', items, low, high)


def prior_stds(signal: str, amplitude: float, length: float) -> Array:
    """Return the prior standard deviations (k,) of a curve by a squared-exponential kernel.

    Args:
        signal: name of the signal.
        amplitude: standard deviation of the curve.
        length: length over which it changes, as a part of the range.
    """
    order = _orders(signal)
    if signal == HEADING:
        half = order[: len(order) // 2]
        order = 2.0 * np.concatenate([half, half])
    density = np.exp(-0.5 * np.square(np.pi * order * length))
    stds: Array = amplitude * np.sqrt(2.0 * density / density.sum())
    return stds


def _orders(signal: str) -> Array:
    """Return the numbers (k,) of the functions."""
    return np.arange(1.0, COUNTS.get(signal, COUNT) + 1.0)
