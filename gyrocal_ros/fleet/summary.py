"""Dictionaries that the commands on fleets print as JSON."""

from __future__ import annotations

from typing import Any

from gyrocal_ros.fleet.comparison import Difference
from gyrocal_ros.fleet.findings import Findings, advice
from gyrocal_ros.fleet.hierarchy import Estimate, FleetEstimate
from gyrocal_ros.fleet.pooling import PooledEffect
from gyrocal_ros.fleet.result import FAILED


def summarise_fleet(found: Findings) -> dict[str, Any]:
    """Return what `fleet report --json` prints."""
    columns = found.table.columns
    return {
        'bags': len(found.table),
        'calibrated': int(found.table.calibrated.sum()),
        'not_counted': found.left_out,
        'robots': len(found.robots),
        'coefficients': {
            name: _fitted(item, found.units[name], found.robots) for name, item in found.coefficients.items()
        },
        'missing': [_missing(item, found) for item in found.pooled.found],
        'strongest': None if found.pooled.strongest is None else _pooled(found.pooled.strongest),
        'out_of_family': found.out_of_family,
        'robot_effects': [
            {
                'robot': item.robot,
                'effect': item.effect,
                'coefficient': item.name,
                'value': item.value,
                'unit': item.unit,
                'significance_sigma': item.sigma,
                'also': item.also,
            }
            for item in found.robot_effects
        ],
        'failed': [
            {'bag': bag, 'reason': reason}
            for bag, status, reason in zip(columns['bag'], columns['status'], columns['reason'], strict=True)
            if status == FAILED
        ],
        'advice': advice(found),
    }


def summarise_difference(item: Difference) -> dict[str, Any]:
    """Return one difference of `fleet compare --json`."""
    return {
        'coefficient': item.name,
        'unit': item.unit,
        'first': item.first.mean.value,
        'second': item.second.mean.value,
        'difference': _estimate(item.mean),
        'spread_ratio': _estimate(item.spread_ratio),
    }


def _fitted(item: FleetEstimate, unit: str, robots: tuple[str, ...]) -> dict[str, Any]:
    return {
        'unit': unit,
        'mean': _estimate(item.mean),
        'spread': _estimate(item.spread),
        'bag_spread': item.bag_spread,
        'slopes': {name: _estimate(slope) for name, slope in item.slopes.items()},
        'bags': item.bags,
        'robots': {
            robot: {'value': value, 'std': std, 'z': z}
            for robot, value, std, z in zip(
                robots,
                item.robot_value.tolist(),
                item.robot_std.tolist(),
                item.robot_z.tolist(),
                strict=False,
            )
        },
    }


def _estimate(item: Estimate) -> dict[str, float]:
    return {'value': item.value, 'std': item.std, 'low': item.low, 'high': item.high}


def _pooled(item: PooledEffect) -> dict[str, Any]:
    columns = zip(item.names, item.values.tolist(), item.stds.tolist(), item.units, strict=True)
    return {
        'effect': item.effect,
        'coefficients': {
            name: {'value': value, 'std': std, 'unit': unit} for name, value, std, unit in columns
        },
        'log_likelihood_gain': item.gain,
        'significance_sigma': item.sigma,
        'per_bag_sigma': item.per_bag_sigma,
        'confused_with': item.confused_with,
        'separated_from': item.separated_from,
    }


def _missing(item: PooledEffect, found: Findings) -> dict[str, Any]:
    spreads = {
        name: {
            'spread': _estimate(found.effects[name].spread),
            'out_of_family': [found.robots[robot] for robot in found.effects[name].out_of_family.tolist()],
        }
        for name in item.names
        if name in found.effects
    }
    return _pooled(item) | {'heterogeneity': spreads}
