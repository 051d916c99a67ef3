"""Hierarchical model, pooled score statistics, comparison of two fleets: on values drawn from known laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrocal_ros.data import Array
from gyrocal_ros.fleet.comparison import compare
from gyrocal_ros.fleet.findings import AGE, Findings, by_data_alone
from gyrocal_ros.fleet.hierarchy import FleetEstimate, Observations, fit_fleet
from gyrocal_ros.fleet.pooling import Pooled, pool
from gyrocal_ros.fleet.table import FleetTable, ScoreTable

MEAN, TAU, OMEGA, SLOPE = 1.01, 0.004, 0.0003, -5e-4
ROBOTS, BAGS = 30, 3


def drawn(
    seed: int, faulty: int = 0, robots: int = ROBOTS, mean: float = MEAN, omega: float = OMEGA
) -> tuple[Observations, Array]:
    """Draw the bags of a fleet from the model, and the true values of the robots."""
    rng = np.random.default_rng(seed)
    robot = np.repeat(np.arange(robots), BAGS)
    true = mean + TAU * rng.standard_normal(robots)
    true[:faulty] = mean + 8.0 * TAU
    age = rng.uniform(0.0, 3.0, robots)[robot] + np.tile(0.3 * np.arange(BAGS), robots)
    std = rng.uniform(5e-5, 3e-4, len(robot))
    value = true[robot] + SLOPE * age + np.hypot(std, omega) * rng.standard_normal(len(robot))
    return Observations(value, std, robot, age[:, None], (AGE,)), true


def fitted(observed: Observations, *, has_bag_spread: bool = True) -> FleetEstimate:
    result = fit_fleet(observed, has_bag_spread=has_bag_spread)
    assert result is not None
    return result


def test_without_regressors_the_likelihood_is_that_of_the_full_covariance_matrix() -> None:
    """The estimate must be a maximum of the restricted likelihood, computed here with whole matrices."""
    observed, _ = drawn(1, robots=8)
    result = fitted(observed)
    design = np.column_stack([np.ones(len(observed.value)), observed.regressors])

    def loss(tau: float, omega: float) -> float:
        same = observed.robot[:, None] == observed.robot
        covariance = tau**2 * same + np.diag(observed.std**2 + omega**2)
        inverse = np.linalg.inv(covariance)
        normal = design.T @ inverse @ design
        left = observed.value - design @ np.linalg.solve(normal, design.T @ inverse @ observed.value)
        return float(np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1] + left @ inverse @ left)

    best = loss(result.spread.value, result.bag_spread)
    for factor in (0.9, 1.1):
        assert loss(factor * result.spread.value, result.bag_spread) > best
        assert loss(result.spread.value, factor * result.bag_spread) > best
    # The ends of the interval: there twice the log-likelihood has fallen by the 95 % point of chi-square.
    for end in (result.spread.low, result.spread.high):
        assert loss(end, result.bag_spread) - best == pytest.approx(3.84, abs=0.05)


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    fits = [fitted(drawn(seed)[0]) for seed in range(40)]
    inside = [
        [
            item.mean.low < MEAN < item.mean.high,
            item.spread.low < TAU < item.spread.high,
            item.slopes[AGE].low < SLOPE < item.slopes[AGE].high,
        ]
        for item in fits
    ]
    assert np.sum(inside, axis=0).min() >= 34  # 40 at 95 %: less is less likely than 1 in 200
    assert np.mean([item.bag_spread for item in fits]) == pytest.approx(OMEGA, rel=0.1)


def test_faulty_robots_are_set_aside_and_do_not_widen_the_spread() -> None:
    observed, true = drawn(3, faulty=3)
    result = fitted(observed)
    assert result.out_of_family.tolist() == [0, 1, 2]
    assert result.spread.high < 2.0 * TAU
    assert (result.robot_z[:3] > 5.0).all()
    # Their own estimates stay near their own bags, hardly shrunk.
    assert result.robot_value == pytest.approx(true, abs=0.003)


def test_estimates_of_robots_are_consistent() -> None:
    z = []
    for seed in range(40):
        observed, true = drawn(seed)
        result = fitted(observed)
        z += ((result.robot_value - true) / result.robot_std).tolist()
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.2)


def test_equal_robots_have_no_spread() -> None:
    rng = np.random.default_rng(0)
    robot = np.repeat(np.arange(20), 2)
    std = np.full(40, 0.1)
    observed = Observations(0.1 * rng.standard_normal(40), std, robot, np.empty((40, 0)), ())
    result = fitted(observed, has_bag_spread=False)
    assert result.spread.low == 0.0 and result.spread.value < 0.06
    assert len(result.out_of_family) == 0


def test_two_robots_are_too_few() -> None:
    observed = Observations(np.ones(4), np.ones(4), np.array([0, 0, 1, 1]), np.empty((4, 0)), ())
    assert fit_fleet(observed) is None


def score_table(rng: np.random.Generator, effect: int | None, bags: int = 40) -> tuple[ScoreTable, Array]:
    """Draw the statistics of six candidates, the first two alike in each bag, less so over all.

    The effect has a size of 1.5 sigma in a bag, as if the other candidates were absent.
    """
    roots = rng.standard_normal((bags, 6, 12))
    roots[:, 1] = roots[:, 0] * rng.uniform(0.6, 1.4, (bags, 1)) + 0.15 * rng.standard_normal((bags, 12))
    information = roots @ roots.transpose(0, 2, 1)
    theta = np.zeros(6)
    if effect is not None:
        theta[effect] = 1.5 / np.sqrt(np.median(information[:, effect, effect]))
    noise = np.einsum('bij,bj->bi', roots, rng.standard_normal((bags, 12)))
    names = tuple(f'effect_{i}.k' for i in range(6))
    diagonal = np.einsum('bii->bi', information)
    table = ScoreTable(
        bags=tuple(f'b{i}' for i in range(bags)),
        robots=tuple(f'r{i // 2}' for i in range(bags)),
        names=names,
        units=('1',) * 6,
        information=diagonal,
        score=information @ theta + noise,
        std=diagonal**-0.5,
    )
    return table, information


def pooled(seed: int, effect: int | None) -> Pooled:
    table, information = score_table(np.random.default_rng(seed), effect)
    return pool(table, lambda columns: information[:, columns[:, None], columns])


def test_an_effect_below_the_noise_of_a_bag_is_found_in_forty() -> None:
    for seed in range(5):
        found = pooled(seed, effect=3)
        assert [item.effect for item in found.found] == ['effect_3']
        assert found.found[0].per_bag_sigma == pytest.approx(1.5, abs=0.5)


def test_effects_alike_in_one_bag_are_told_apart_by_the_variety_of_bags() -> None:
    table, information = score_table(np.random.default_rng(2), 0, bags=200)
    found = pool(table, lambda columns: information[:, columns[:, None], columns]).found
    assert [item.effect for item in found] == ['effect_0']
    assert found[0].separated_from == ('effect_1',) and found[0].confused_with == ()


def test_clean_fleets_have_no_finding() -> None:
    assert sum(len(pooled(seed, effect=None).found) for seed in range(20)) == 0


def test_a_difference_of_means_has_its_interval() -> None:
    def findings(fit: FleetEstimate) -> Findings:
        table = FleetTable((), {'bag': []}, {})
        fits = {'scale_factor': fit}
        return Findings(table, (), fits, {}, {'scale_factor': '1'}, Pooled((), None, 0), (), 0, False)

    inside = 0
    for seed in range(20):
        a, b = (fitted(drawn(2 * seed + i, mean=MEAN + 0.002 * i)[0]) for i in (0, 1))
        (item,) = compare(findings(a), findings(b))
        inside += item.mean.low < 0.002 < item.mean.high
        assert item.spread_ratio.low < item.spread_ratio.value < item.spread_ratio.high
    assert inside >= 16


def test_the_prior_of_the_model_does_not_pass_for_knowledge_of_many_bags() -> None:
    """The filter's estimates contain the prior; an effect that no bag shows stays unknown."""
    rng = np.random.default_rng(0)
    bags, truth, std, prior_std = 60, 0.01, 0.004, 0.003
    measured = truth + std * rng.standard_normal(bags)
    posterior_std = (std**-2 + prior_std**-2) ** -0.5
    posterior = measured * (posterior_std / std) ** 2
    columns = {
        'robot': [f'r{bag // 2}' for bag in range(bags)],
        'k': list(posterior),
        'k_std': [posterior_std] * bags,
        'unseen': [0.0] * bags,
        'unseen_std': [prior_std] * bags,
    }
    priors = [
        {'name': name, 'prior_mean': {'c': 0.0}, 'prior_std': {'c': prior_std}} for name in ('k', 'unseen')
    ]
    table = FleetTable((), columns | {'bag': list(range(bags))}, {'effects': priors})
    value, alone_std = by_data_alone(table, 'k')
    assert value == pytest.approx(measured) and alone_std == pytest.approx([std] * bags)
    assert abs(value.mean() - truth) < 3.0 * std / math.sqrt(bags) < abs(posterior.mean() - truth)
    assert np.isnan(by_data_alone(table, 'unseen')[0]).all()
