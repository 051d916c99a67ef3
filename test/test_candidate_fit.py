"""Fits to score statistics: least squares, and covariances that hold when the noise settings do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import score_statistics_of

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidate_fit import (
    LAGS,
    MAX_LEVERAGE,
    NOT_EXCITED,
    Fit,
    correlation,
    fit,
    preference,
)
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.statistics import sigma_of

BLOCKS, EACH = 30, 20
TRUE = np.array([3.0, -1.0, 0.5])


def drawn(seed: int, noise: float = 1.0, blocks: int = BLOCKS) -> tuple[Array, Array]:
    """Return correlated columns (B, n, 3), and measurements (B, n) of the coefficients `TRUE`."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(blocks, EACH, 3)) @ [[1.0, 0.4, 0.0], [0.0, 1.0, 0.0], [0.2, 0.0, 1.0]]
    return columns, columns @ TRUE + noise * rng.normal(size=(blocks, EACH))


def fitted(scores: ScoreStatistics, *columns: int, given: tuple[int, ...] | None = None) -> Fit:
    found = fit(scores, np.array(columns), None if given is None else np.array(given))
    assert found is not None
    return found


def made(values: list[float], covariance: Array, block_gains: Array) -> Fit:
    gain, blocks = float(block_gains.sum()), len(block_gains)
    return Fit(np.arange(len(values)), np.array(values), covariance, gain, block_gains, blocks)


class TestFit:
    def test_a_fit_is_least_squares(self) -> None:
        columns, measured = drawn(0)
        found = fitted(score_statistics_of(columns, measured), 0, 1, 2)
        flat = columns.reshape(-1, 3)
        expected, rest = np.linalg.lstsq(flat, measured.ravel(), rcond=None)[:2]
        np.testing.assert_allclose(found.values, expected, rtol=1e-10)
        assert found.gain == pytest.approx(0.5 * (np.sum(measured**2) - rest[0]), rel=1e-10)
        left = measured - columns @ expected
        np.testing.assert_allclose(found.block_gains, 0.5 * (measured**2 - left**2).sum(axis=1), atol=1e-9)

    def test_the_scale_of_a_column_changes_only_units(self) -> None:
        columns, measured = drawn(0)
        units = np.array([1e-4, 1.0, 1e3])
        plain, other = (
            fitted(score_statistics_of(columns * unit, measured), 0, 1, 2) for unit in (np.ones(3), units)
        )
        np.testing.assert_allclose(other.values * units, plain.values, rtol=1e-9)
        np.testing.assert_allclose(other.covariance * np.outer(units, units), plain.covariance, rtol=1e-9)
        assert other.sigma == pytest.approx(plain.sigma) and other.gain == pytest.approx(plain.gain)

    def test_the_gain_of_given_columns_does_not_count(self) -> None:
        scores = score_statistics_of(*drawn(1))
        every, alone = fitted(scores, 0, 1, 2), fitted(scores, 2)
        beside = fitted(scores, 0, 1, given=(2,))
        np.testing.assert_allclose(beside.values, every.values[:2], rtol=1e-10)
        np.testing.assert_allclose(beside.covariance, every.covariance[:2, :2], rtol=1e-10)
        assert beside.gain == pytest.approx(every.gain - alone.gain)
        np.testing.assert_allclose(beside.block_gains, every.block_gains - alone.block_gains, atol=1e-9)

    def test_a_given_column_leaves_nothing_to_a_column_that_follows_it(self) -> None:
        rng = np.random.default_rng(2)
        cause = rng.normal(size=(BLOCKS, EACH))
        columns = np.stack([cause, cause + 0.3 * rng.normal(size=cause.shape)], axis=2)
        scores = score_statistics_of(columns, 2.0 * cause + rng.normal(size=cause.shape))
        assert fitted(scores, 1).sigma > 10.0
        assert fitted(scores, 1, given=(0,)).sigma < 3.0 and fitted(scores, 0, given=(1,)).sigma > 5.0

    def test_columns_that_are_not_excited_are_left_out(self) -> None:
        columns, measured = drawn(3)
        columns[:, :, 1] = 0.0
        scores = score_statistics_of(columns, measured)
        found, rest = fitted(scores, 0, 1, 2), fitted(scores, 0, 2)
        assert found.columns.tolist() == [0, 2]
        np.testing.assert_allclose(found.values, rest.values)
        np.testing.assert_allclose(found.covariance, rest.covariance)
        assert fit(scores, np.array([1])) is None
        assert fitted(scores, 0, given=(1,)).gain == pytest.approx(fitted(scores, 0).gain)

    def test_the_threshold_of_excitation(self) -> None:
        columns, measured = drawn(3)
        size = math.sqrt(float(np.sum(columns[:, :, 0] ** 2)))
        for part, is_fitted in ((10.0, True), (0.1, False)):
            columns[:, :, 0] *= math.sqrt(part * NOT_EXCITED) / size
            size = math.sqrt(part * NOT_EXCITED)
            assert (fit(score_statistics_of(columns, measured), np.array([0])) is not None) == is_fitted

    def test_the_same_column_twice_cannot_be_fitted(self) -> None:
        columns, measured = drawn(4)
        columns[:, :, 1] = -2.0 * columns[:, :, 0]
        scores = score_statistics_of(columns, measured)
        assert fit(scores, np.array([0, 1])) is None
        assert fit(scores, np.array([0]), given=np.array([1])) is None

    def test_the_first_half_holds_the_first_blocks(self) -> None:
        columns, measured = drawn(5, blocks=7)
        half = score_statistics_of(columns, measured).first_half()
        np.testing.assert_allclose(
            fitted(half, 0, 1, 2).values,
            fitted(score_statistics_of(columns[:4], measured[:4]), 0, 1, 2).values,
        )


class TestCovariance:
    @pytest.mark.parametrize('blocks', [5, 30])
    def test_it_is_the_least_significant_of_three_estimates(self, blocks: int) -> None:
        """For one coefficient, by hand: by the filter's own S, HC3, and HC3 with neighbouring blocks."""
        chosen = set()
        for seed in range(20):
            columns, measured = drawn(seed, blocks=blocks)
            found = fitted(score_statistics_of(columns, measured), 0)
            x, total = columns[:, :, 0], float(np.sum(columns[:, :, 0] ** 2))
            share = (x**2).sum(axis=1) / total
            scores = (x * (measured - x * found.values[0])).sum(axis=1) / (1.0 - MAX_LEVERAGE * share)
            pairs = [
                2.0 * (1.0 - lag / (LAGS + 1)) * float(scores[lag:] @ scores[:-lag])
                for lag in range(1, LAGS + 1)
            ]
            alone = float(scores @ scores)
            estimates = [1.0 / total, alone / total**2, (alone + sum(pairs)) / total**2]
            assert found.covariance[0, 0] == pytest.approx(max(estimates), rel=1e-9)
            chosen.add(int(np.argmax(estimates)))
        assert len(chosen) > 1, 'it is not always the same one'

    @pytest.mark.parametrize('noise', [1.0, 3.0])
    def test_it_holds_when_the_noise_exceeds_the_settings(self, noise: float) -> None:
        off = []
        for seed in range(150):
            found = fitted(score_statistics_of(*drawn(seed, noise)), 0, 1, 2)
            off.append((found.values - TRUE) / np.sqrt(np.diagonal(found.covariance)))
        assert 0.6 < float(np.sqrt(np.mean(np.square(off)))) < 1.15

    def test_correlated_blocks_widen_it(self) -> None:
        """With a level that drifts slowly, as a bias does, shuffled blocks give too small a variance."""
        rng, wider = np.random.default_rng(0), []
        for _ in range(50):
            column, level = (np.convolve(rng.normal(size=BLOCKS + 2), np.ones(3), 'valid') for _ in range(2))
            order = rng.permutation(BLOCKS)
            in_time, shuffled = (
                fitted(score_statistics_of(column[o, None, None], 5.0 * level[o, None]), 0).covariance[0, 0]
                for o in (np.arange(BLOCKS), order)
            )
            wider.append(math.sqrt(in_time / shuffled))
        assert float(np.mean(wider)) > 1.05

    def test_a_column_in_one_block_alone_has_the_covariance_of_the_filter(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(50):
            columns = rng.normal(size=(5, 40, 2))
            columns[np.arange(5) != 2, :, 0] = 0.0
            scores = score_statistics_of(columns, columns @ [3.0, -1.0] + rng.normal(size=(5, 40)))
            found = fitted(scores, 0, 1)
            assert np.isfinite(found.sigma)
            np.testing.assert_allclose(found.values, [3.0, -1.0], atol=0.6)
            own = np.linalg.inv(scores.information.sum(axis=0))
            np.testing.assert_allclose(found.covariance, own, rtol=1e-6)


class TestSignificance:
    @pytest.mark.parametrize(
        ('t', 'dof', 'p_value'),
        [(2.228, 10, 0.05), (3.169, 10, 0.01), (2.045, 29, 0.05), (2.756, 29, 0.01), (3.659, 29, 0.001)],
    )
    def test_one_coefficient_has_students_t_distribution(self, t: float, dof: int, p_value: float) -> None:
        """Two-sided quantiles from a table."""
        found = made([2.0 * t], np.array([[4.0]]), np.zeros(dof + 1))
        assert found.wald == pytest.approx(t**2)
        assert found.sigma == pytest.approx(sigma_of(p_value), abs=0.1)

    @pytest.mark.parametrize(
        ('f', 'dof', 'p_value'), [(4.103, 10, 0.05), (7.559, 10, 0.01), (3.328, 29, 0.05)]
    )
    def test_two_coefficients_have_hotellings_test(self, f: float, dof: int, p_value: float) -> None:
        """Quantiles of F with 2 and `dof` degrees of freedom from a table."""
        covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
        direction = np.array([1.0, -2.0])
        length = math.sqrt(2.0 * f / float(direction @ np.linalg.solve(covariance, direction)))
        found = made((length * direction).tolist(), covariance, np.zeros(dof + 2))
        assert found.p_value == pytest.approx(p_value, rel=2e-3)

    def test_few_blocks_lower_the_significance(self) -> None:
        few, many = (made([5.0], np.eye(1), np.zeros(blocks)) for blocks in (4, 4000))
        assert few.sigma < 3.0 and many.sigma == pytest.approx(5.0, abs=0.02)

    @pytest.mark.parametrize('noise', [1.0, 3.0])
    def test_p_values_occur_as_often_as_they_say(self, noise: float) -> None:
        rng, p_values = np.random.default_rng(7), []
        for _ in range(400):
            columns = rng.normal(size=(BLOCKS, EACH, 2))
            p_values.append(
                fitted(score_statistics_of(columns, noise * rng.normal(size=(BLOCKS, EACH))), 0, 1).p_value
            )
        assert 0.01 < np.mean(np.array(p_values) < 0.1) < 0.15

    def test_correlation_of_two_effects(self) -> None:
        """The largest canonical correlation: with one column each, the cosine between them."""
        columns, measured = drawn(8)
        scores = score_statistics_of(columns, measured)
        first, second, third = columns.reshape(-1, 3).T
        cosine = abs(first @ second) / math.sqrt((first @ first) * (second @ second))
        assert correlation(scores, np.array([0]), np.array([1])) == pytest.approx(cosine)
        explained = np.linalg.lstsq(np.stack([second, third], axis=1), first, rcond=None)[1][0] / (
            first @ first
        )
        assert correlation(scores, np.array([0]), np.array([1, 2])) == pytest.approx(
            math.sqrt(1.0 - explained)
        )
        assert correlation(scores, np.array([1, 2]), np.array([2])) == pytest.approx(1.0)
        columns[:, :, 1] = 0.0
        assert correlation(score_statistics_of(columns, measured), np.array([0]), np.array([1])) == 0.0

    def test_preference_is_the_sum_over_its_standard_deviation(self) -> None:
        gains = np.array([1.0, 3.0, 2.0, 2.0])
        better, worse = made([1.0], np.eye(1), gains), made([1.0], np.eye(1), np.zeros(4))
        expected = 8.0 / (math.sqrt(2.0 / 3.0) * 2.0)
        assert preference(better, worse) == pytest.approx(expected)
        assert preference(worse, better) == pytest.approx(-expected)
        assert preference(better, better) == 0.0


@pytest.mark.parametrize('seed', range(20))
def test_coefficients_that_are_much_alike_are_not_judged_by_rounding(seed: int) -> None:
    """As of a few stretches of a short recording: the Wald statistic is at least that of each alone."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal((3, 40, 1)) * np.arange(1.0, 6.0)
    columns = common + 3e-4 * rng.standard_normal((3, 40, 5))
    information = columns.transpose(0, 2, 1) @ columns
    score = np.einsum('bni,bn->bi', columns, rng.standard_normal((3, 40)))
    found = fit(ScoreStatistics((), np.arange(3.0), information, score), np.arange(4), np.array([4]))
    assert found is not None
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    alone = found.values**2 / np.diagonal(found.covariance)
    assert found.wald > (1.0 - 1e-4) * alone.max()
    assert 0.0 <= found.p_value <= 1.0
