"""Distributions and tests of significance, against tables and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special

from gyrocal_ros.statistics import (
    NORMAL_MAD,
    SMALLEST_P_VALUE,
    chi_square_quantile,
    chi_square_tail,
    nis_per_dof,
    normal_quantile,
    robust_std,
    sigma_of,
    trigamma,
    vuong_sigma,
)


class TestChiSquare:
    @pytest.mark.parametrize(
        ('value', 'dof', 'tail'),
        [
            (3.841, 1, 0.05),
            (10.828, 1, 0.001),
            (5.991, 2, 0.05),
            (13.816, 2, 0.001),
            (7.815, 3, 0.05),
            (11.070, 5, 0.05),
            (20.515, 5, 0.001),
        ],
    )
    def test_tails_from_a_table(self, value: float, dof: int, tail: float) -> None:
        assert chi_square_tail(value, dof) == pytest.approx(tail, rel=1e-3)

    @pytest.mark.parametrize('value', [0.1, 5.0, 60.0, 100.0, 1000.0])
    def test_closed_forms_far_out(self, value: float) -> None:
        """With two degrees of freedom exp(-x/2), with one erfc(sqrt(x/2)), with three both."""
        one, two = math.erfc(math.sqrt(0.5 * value)), math.exp(-0.5 * value)
        three = one + math.sqrt(2.0 * value / math.pi) * two
        assert chi_square_tail(value, 1) == pytest.approx(one, rel=1e-9)
        assert chi_square_tail(value, 2) == pytest.approx(two, rel=1e-9)
        assert chi_square_tail(value, 3) == pytest.approx(three, rel=1e-9)

    def test_known_values(self) -> None:
        assert chi_square_tail(60.0, 3) == pytest.approx(5.878e-13, rel=1e-3)
        assert chi_square_tail(100.0, 3) > 0.0
        assert chi_square_tail(-1.0, 3) == chi_square_tail(0.0, 3) == 1.0

    @pytest.mark.parametrize('dof', [1, 2, 3, 2.7, 40, 1000])
    @pytest.mark.parametrize('probability', [0.001, 0.05, 0.5, 0.9, 0.95, 0.999])
    def test_the_quantile_is_the_inverse_of_the_tail(self, dof: float, probability: float) -> None:
        value = chi_square_quantile(probability, dof)
        assert 1.0 - chi_square_tail(value, dof) == pytest.approx(probability, rel=1e-9)


class TestNormal:
    def test_quantiles_from_a_table(self) -> None:
        for probability, value in ((0.5, 0.0), (0.95, 1.644854), (0.975, 1.959964), (0.005, -2.575829)):
            assert normal_quantile(probability) == pytest.approx(value, abs=1e-6)

    def test_a_p_value_in_standard_deviations(self) -> None:
        for sigma in (0.5, 1.0, 4.0, 5.0, 8.0, 30.0):
            assert sigma_of(2.0 * float(special.ndtr(-sigma))) == pytest.approx(sigma, rel=1e-9)
            assert sigma_of(math.erfc(sigma / math.sqrt(2.0))) == pytest.approx(sigma, rel=1e-6)
        assert sigma_of(1.0) == 0.0

    def test_p_values_that_underflow_stay_finite(self) -> None:
        assert math.inf > sigma_of(0.0) > sigma_of(1e-299) > 36.0
        assert sigma_of(0.0) == sigma_of(SMALLEST_P_VALUE) == sigma_of(chi_square_tail(1e5, 5))


def test_trigamma() -> None:
    assert trigamma(0.5) == pytest.approx(math.pi**2 / 2.0)
    assert trigamma(1.0) == pytest.approx(math.pi**2 / 6.0)
    for x in (0.5, 1.3, 20.0):
        assert trigamma(x) - trigamma(x + 1.0) == pytest.approx(1.0 / x**2)


def test_trigamma_is_the_variance_of_the_logarithm_of_a_mean_of_squares() -> None:
    rng = np.random.default_rng(0)
    squares = (rng.normal(size=(20_000, 6)) ** 2).mean(axis=1)
    assert float(np.var(np.log(squares))) == pytest.approx(trigamma(3.0), rel=0.05)


def test_vuong_is_the_sum_over_its_standard_deviation() -> None:
    gains = np.array([1.0, 3.0, 2.0, 2.0])
    assert vuong_sigma(gains) == pytest.approx(8.0 / (2.0 * math.sqrt(2.0 / 3.0)))
    assert vuong_sigma(-gains) == -vuong_sigma(gains)
    assert vuong_sigma(gains[:1]) == vuong_sigma(gains[:0]) == vuong_sigma(np.ones(5)) == 0.0


def test_a_few_blocks_that_gain_thousands_do_not_hide_what_they_prove() -> None:
    gains = np.array([-4.0, -7.0, -3.0, 1.0, 10.0, 128.0, 498.0, 185.0, 1935.0, 7596.0])
    assert vuong_sigma(gains) < 1.5 < 2.0 < vuong_sigma(gains, 100.0)
    assert vuong_sigma(-gains, 100.0) == -vuong_sigma(gains, 100.0)
    outlier = np.array([-4.0, -7.0, -3.0, 1.0, -10.0, 3.0, 5.0, -2.0, -6.0, 7596.0])
    assert vuong_sigma(outlier, 100.0) < 1.0, 'one block alone is no proof'
    assert vuong_sigma(np.array([300.0, 900.0, 200.0]), 100.0) == math.inf, 'all of them are'
    assert vuong_sigma(np.array([-300.0, -900.0]), 100.0) == -math.inf
    assert vuong_sigma(outlier[-1:], 100.0) == 0.0


def test_the_robust_standard_deviation_ignores_outliers() -> None:
    values = 3.0 * np.random.default_rng(0).normal(size=10_000)
    assert robust_std(values) == pytest.approx(3.0, rel=0.03)
    values[:100] = 1e6
    assert robust_std(values) == pytest.approx(3.0, rel=0.05)
    assert robust_std(np.array([-2.0])) == 2.0 * NORMAL_MAD
    assert pytest.approx(1.0 / normal_quantile(0.75), rel=1e-4) == NORMAL_MAD
    assert robust_std(np.empty(0)) == 0.0


def test_nis_per_degree_of_freedom() -> None:
    assert nis_per_dof(np.array([2.0, 0.0, 7.0]), np.array([2.0, 0.0, 4.0])) == 1.5
    assert nis_per_dof(np.zeros(3), np.zeros(3)) is None
