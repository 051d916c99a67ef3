"""Difference between two fleets: two suppliers, or before and after a change of firmware."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import special

from gyrocal_ros.fleet.findings import Findings
from gyrocal_ros.fleet.hierarchy import CONFIDENCE, Estimate, FleetEstimate


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """Difference of one coefficient, the second fleet less the first."""

    name: str
    unit: str
    first: FleetEstimate
    second: FleetEstimate
    mean: Estimate
    spread_ratio: Estimate
    """Part-to-part standard deviation of the second over the first; its `std` is NaN."""


def compare(first: Findings, second: Findings) -> list[Difference]:
    """Return the difference of every coefficient that both fleets have."""
    both = first.coefficients | first.effects
    other = second.coefficients | second.effects
    return [
        Difference(
            name=name,
            unit=first.units[name],
            first=both[name],
            second=other[name],
            mean=_mean_difference(both[name], other[name]),
            spread_ratio=_spread_ratio(both[name], other[name]),
        )
        for name in both
        if name in other
    ]


def _mean_difference(a: FleetEstimate, b: FleetEstimate) -> Estimate:
    """Return the difference of the means with the interval of Welch 1947 (degrees of Satterthwaite 1946).

    Both fleets count as independent, also where robots are in both; the interval is then too wide, never
    too narrow, if the parts have not changed.
    """
    variance_a, variance_b = a.mean.std**2, b.mean.std**2
    variance = variance_a + variance_b
    dof_a, dof_b = (max(item.robots - 1 - len(item.slopes), 1) for item in (a, b))
    dof = variance**2 / (variance_a**2 / dof_a + variance_b**2 / dof_b) if variance > 0.0 else 1.0
    value, std = b.mean.value - a.mean.value, math.sqrt(variance)
    reach = float(special.stdtrit(dof, 0.5 + 0.5 * CONFIDENCE)) * std
    return Estimate(value, std, value - reach, value + reach)


def _spread_ratio(a: FleetEstimate, b: FleetEstimate) -> Estimate:
    """Return the ratio of the spreads with the interval of the F distribution of two sample variances."""
    if a.spread.value == 0.0:
        return Estimate(math.nan, math.nan, math.nan, math.nan)
    ratio = b.spread.value / a.spread.value
    dof_a, dof_b = (max(item.robots - 1 - len(item.slopes), 1) for item in (a, b))
    low, high = (float(special.fdtri(dof_b, dof_a, 0.5 + sign * 0.5 * CONFIDENCE)) for sign in (-1.0, 1.0))
    return Estimate(ratio, math.nan, ratio / math.sqrt(high), ratio / math.sqrt(low))
