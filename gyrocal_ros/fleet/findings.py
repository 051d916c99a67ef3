"""Conclusions on a fleet: coefficients with spread and drift, faulty robots, missing effects, next steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.fleet.hierarchy import MIN_ROBOTS, FleetEstimate, Observations, fit_fleet, indexed
from gyrocal_ros.fleet.pooling import (
    MIN_BAGS,
    Pooled,
    candidate_of,
    effect_of,
    expected_std,
    pool,
)
from gyrocal_ros.fleet.table import FleetTable, ScoreTable, read_information, read_scores
from gyrocal_ros.statistics import NORMAL_MAD, normal_quantile

REFERENCE_C = 25.0
"""Temperature at which fleet means hold, as all coefficients do."""
AGE, TEMPERATURE = 'age (1000 h)', 'temperature (K)'
AGE_COLUMN = 'age_h'
HOURS_PER_UNIT = 1000.0
MIN_SPREAD_H, MIN_SPREAD_K = 24.0, 1.0
"""Least standard deviation of age and temperature over the bags from which a drift is estimated."""
FEW_ALPHA = 0.01
"""Probability of any false robot among those with an effect of their own."""
LEAST_INFORMATION = 1e-3
"""Least information of a bag on a coefficient, relative to that of its prior."""
LEAST_CONVERGED = 0.5
"""Share of the calibrated bags that must have converged for the others to be left out."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotEffect:
    """An effect that one robot has, other than the rest of the fleet."""

    robot: str
    effect: str
    name: str
    value: float
    unit: str
    sigma: float
    also: tuple[str, ...]
    """Other effects by which the same robot stands out, less."""


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """All conclusions on a fleet."""

    table: FleetTable
    robots: tuple[str, ...]
    coefficients: dict[str, FleetEstimate]
    """Every coefficient of the model that could be fitted, by its column."""
    effects: dict[str, FleetEstimate]
    """Every coefficient of the missing effects."""
    units: dict[str, str]
    pooled: Pooled
    robot_effects: tuple[RobotEffect, ...]
    left_out: int
    """Calibrated bags that do not count in the coefficients: not converged, or the model does not fit."""
    all_unsure: bool
    """True if most bags have not converged, so that all of them count."""

    @property
    def out_of_family(self) -> dict[str, dict[str, float]]:
        """Robots that stand out by a coefficient of the model, with the number of standard deviations."""
        found: dict[str, dict[str, float]] = {}
        for name, estimate in self.coefficients.items():
            for robot in estimate.out_of_family.tolist():
                found.setdefault(self.robots[robot], {})[name] = float(estimate.robot_z[robot])
        return dict(sorted(found.items(), key=lambda item: -max(map(abs, item[1].values()))))


def find(table: FleetTable) -> Findings:
    """Draw the conclusions from the tables of a fleet."""
    robots, index = indexed([str(robot) for robot in table.columns['robot']])
    sure = table.calibrated & table.flags('converged')
    all_unsure = sure.sum() < LEAST_CONVERGED * table.calibrated.sum()
    counted = table.calibrated if all_unsure else sure
    regressors, names = _regressors(table, counted)
    coefficients = {}
    for name in table.coefficients:
        value, std = by_data_alone(table, name)
        observed = Observations(value[counted], std[counted], index[counted], regressors[counted], names)
        fitted = fit_fleet(observed, looks=len(table.coefficients))
        if fitted is not None:
            coefficients[name] = fitted
    scores = read_scores(table.folders)
    pooled = pool(scores, lambda columns: read_information(table.folders, scores, columns))
    units = {name: 'rad/s' if name == 'bias' else '1' for name in coefficients}
    effects = {}
    for item in pooled.found:
        for name, unit, column in zip(item.names, item.units, item.columns.tolist(), strict=True):
            fitted = _fit_effect(scores, column, robots)
            if fitted is not None:
                effects[name], units[name] = fitted, unit
    return Findings(
        table=table,
        robots=robots,
        coefficients=coefficients,
        effects=effects,
        units=units,
        pooled=pooled,
        robot_effects=tuple(_robot_effects(scores)),
        left_out=int(table.calibrated.sum() - counted.sum()),
        all_unsure=bool(all_unsure),
    )


def by_data_alone(table: FleetTable, name: str) -> tuple[Array, Array]:
    """Return value and standard deviation (n,) of a coefficient by the data of each bag alone.

    The estimate x +- s of a bag combines its data with the prior m0 +- s0 of the model, which is the same in
    every bag: over many bags it would pass for knowledge. The data alone have the information
    1 / s^2 - 1 / s0^2 (Gelman et al. 2013, section 2.5). Bags whose data tell next to nothing are NaN.
    """
    value, std = table.numbers(name), table.numbers(f'{name}_std')
    mean, prior_std = table.priors.get(name, (0.0, math.inf))
    with np.errstate(divide='ignore', invalid='ignore'):
        information = std**-2.0 - prior_std**-2.0
        information[information < LEAST_INFORMATION * prior_std**-2.0] = math.nan
        alone = (value * std**-2.0 - mean * prior_std**-2.0) / information
        return alone, information**-0.5


def advice(found: Findings) -> list[str]:
    """Return what to do next, and on which robots."""
    steps = []
    for robot, by in found.out_of_family.items():
        steps.append(f'Inspect the gyro of {robot}: its {" and ".join(by)} is out of family.')
    for item in found.pooled.found:
        if item.confused_with:
            least = ', '.join(_least_informed(found))
            others = ', '.join(item.confused_with)
            steps.append(
                f'Record {least} again, at another temperature and with other motions: all bags together '
                f'cannot tell {item.effect} from {others}.'
            )
        else:
            steps.append(
                f'Add {item.effect} to the model of all robots, then run the fleet again with --model.'
            )
    if len(found.robots) >= MIN_ROBOTS:
        for name in found.table.coefficients:
            if name not in found.coefficients:
                steps.append(f'No bag tells {name}: record other motions, or take it out of the model.')
    if found.pooled.bags < MIN_BAGS:
        steps.append(f'Record more: effects of the fleet are judged from {MIN_BAGS} bags on.')
    single = [name for name, estimate in found.coefficients.items() if estimate.bags == estimate.robots]
    if single:
        steps.append(
            'Record each robot twice: from single bags, parts that differ look like bags that differ.'
        )
    if found.all_unsure:
        steps.append(
            'Most bags have not converged: record longer, with more turns, or look for a missing effect.'
        )
    return steps


def age_h(table: FleetTable) -> Array:
    """Return the age of each bag in hours (n,): running hours where recorded, or time since the first bag."""
    if AGE_COLUMN in table.columns:
        return table.numbers(AGE_COLUMN)
    times = [_hours(text) for text in table.columns['time']]
    first = min((time for time in times if math.isfinite(time)), default=0.0)
    return np.array(times) - first


def _hours(text: Any) -> float:
    try:
        return datetime.fromisoformat(str(text).replace('Z', '+00:00')).timestamp() / 3600.0
    except ValueError:
        return math.nan


def _regressors(table: FleetTable, counted: np.ndarray) -> tuple[Array, tuple[str, ...]]:
    """Return age and temperature (n, q), each where enough bags have it and it varies."""
    columns, names = [], []
    known = (
        (AGE, age_h(table) / HOURS_PER_UNIT, MIN_SPREAD_H / HOURS_PER_UNIT),
        (TEMPERATURE, table.numbers('temperature_c') - REFERENCE_C, MIN_SPREAD_K),
    )
    for name, values, least in known:
        used = values[counted]
        if len(used) and np.isfinite(used).all() and used.std() > least:
            columns.append(values)
            names.append(name)
    stacked = np.stack(columns, axis=1) if columns else np.empty((len(table), 0))
    return stacked, tuple(names)


def _fit_effect(scores: ScoreTable, column: int, robots: Sequence[str]) -> FleetEstimate | None:
    """Fit the hierarchical model of one coefficient of an effect that the sensor model lacks."""
    index = {robot: number for number, robot in enumerate(robots)}
    with np.errstate(invalid='ignore', divide='ignore'):
        value = scores.score[:, column] / scores.information[:, column]
    observed = Observations(
        value,
        expected_std(scores, [column])[:, 0],
        np.array([index[robot] for robot in scores.robots], np.int64),
        np.empty((len(value), 0)),
        (),
    )
    return fit_fleet(observed)


def _robot_effects(scores: ScoreTable) -> Iterator[RobotEffect]:
    """Yield robots with an effect that the rest of the fleet does not have, the most certain first.

    The estimates of a robot's bags are averaged by their information. What counts is the distance from the
    median robot, in the larger of its own standard deviation and the scatter of the robots (median absolute
    deviation), beyond a threshold for all robots and all columns together (Bonferroni).
    """
    if len(scores.bags) < MIN_BAGS or not scores.names:
        return
    robots, index = indexed(scores.robots)
    weight = np.nan_to_num(expected_std(scores, range(len(scores.names))) ** -2.0)
    with np.errstate(invalid='ignore', divide='ignore'):
        value = np.nan_to_num(scores.score / scores.information)
        total = np.stack([np.bincount(index, column, len(robots)) for column in weight.T], axis=1)
        summed = (weight * value).T
        mean = np.stack([np.bincount(index, column, len(robots)) for column in summed], axis=1) / total
        deviation = mean - np.nanmedian(mean, axis=0)
        z = deviation * np.sqrt(total)
    excess = np.maximum(NORMAL_MAD * np.nanmedian(np.abs(z), axis=0), 1.0)
    z = np.nan_to_num(z / excess)
    threshold = normal_quantile(1.0 - 0.5 * FEW_ALPHA / max(z.size, 1))
    few = np.flatnonzero(np.abs(z).max(axis=1) > threshold)
    for robot in sorted(few.tolist(), key=lambda row: -np.abs(z[row]).max()):
        order = np.argsort(-np.abs(z[robot]))
        best = int(order[0])
        effect = effect_of(candidate_of(scores.names[best]))
        beyond = (scores.names[column] for column in order if abs(z[robot, column]) > threshold)
        also = dict.fromkeys(effect_of(candidate_of(name)) for name in beyond)
        yield RobotEffect(
            robot=robots[robot],
            effect=effect,
            name=scores.names[best],
            value=float(mean[robot, best]),
            unit=scores.units[best],
            sigma=float(abs(z[robot, best])),
            also=tuple(name for name in also if name != effect),
        )


def _least_informed(found: Findings, count: int = 3) -> list[str]:
    """Return the robots with the fewest calibrated bags."""
    robots = [str(robot) for robot in found.table.columns['robot']]
    bags = dict.fromkeys(found.robots, 0)
    for robot, good in zip(robots, found.table.calibrated.tolist(), strict=True):
        bags[robot] += good
    return sorted(bags, key=lambda robot: (bags[robot], robot))[:count]
