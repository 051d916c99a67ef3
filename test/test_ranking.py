"""From evidence to a ranked list: prices, pairs, twins, where an effect begins, time constants."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import score_statistics_of

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.candidate_fit import Fit, fit
from gyrocal_ros.diagnose.candidates import (
    with_means,
)
from gyrocal_ros.diagnose.profile import WIDEST, profile
from gyrocal_ros.diagnose.ranking import (
    AT_LEAST_PART,
    AT_LEAST_SIGMA,
    NEARBY,
    PRICE,
    RankedEffect,
    best_explanation,
    doubts,
    estimate,
    rank,
    twins,
    with_estimate,
)
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.scale_asymmetry import ScaleAsymmetry
from gyrocal_ros.ekf.score_statistics import ScoreStatistics
from gyrocal_ros.model.sensor import Coefficient

BLOCKS, EACH = 30, 20
ONES = tuple(map(find_effect, ('scale_asymmetry', 'scale_quadratic', 'scale_cubic', 'gyro_lag')))
"""Effects of one coefficient each."""
NOTHING = np.empty(0, np.int64)


def independent(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Columns (B, n, c) that have nothing to do with each other, and noise (B, n)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(BLOCKS, EACH, count)), rng.normal(size=(BLOCKS, EACH))


def names(ranked: list[RankedEffect]) -> list[str]:
    return [ranked_effect.effect.name for ranked_effect in ranked]


def named(ranked: list[RankedEffect], name: str) -> RankedEffect:
    return next(ranked_effect for ranked_effect in ranked if ranked_effect.effect.name == name)


class TestRank:
    def test_the_one_that_explains_most_comes_first(self) -> None:
        columns, noise = independent(3)
        ranked = rank(score_statistics_of(columns, columns @ [0.5, -2.0, 1.0] + noise, ONES[:3]))
        assert names(ranked) == ['scale_quadratic', 'scale_cubic', 'scale_asymmetry']
        assert all(ranked_effect.is_significant for ranked_effect in ranked)
        np.testing.assert_allclose([item.fit.values[0] for item in ranked], [-2.0, 1.0, 0.5], atol=0.2)

    def test_what_is_certain_comes_before_what_gains_more_by_chance(self) -> None:
        """One block that is off gains much, but its scatter tells that it is one block."""
        columns, noise = independent(2)
        seen = columns @ [0.5, 0.0] + 0.1 * noise
        seen[3] += 30.0 * columns[3, :, 1]
        first, second = rank(score_statistics_of(columns, seen, ONES[:2]))
        assert names([first, second]) == ['scale_asymmetry', 'scale_quadratic']
        assert second.merit > first.merit and not second.is_significant

    def test_what_is_not_excited_is_no_suspect(self) -> None:
        columns, noise = independent(2)
        columns[:, :, 1] = 0.0
        assert names(rank(score_statistics_of(columns, columns @ [0.5, 0.0] + noise, ONES[:2]))) == [
            'scale_asymmetry'
        ]

    def test_a_coefficient_has_its_price(self) -> None:
        columns, noise = independent(3)
        effects = (find_effect('scale_asymmetry'), find_effect('cross_axis'))
        columns[:, :, 1] = columns[:, :, 0]
        one, two = rank(score_statistics_of(columns, columns @ [1.0, 0.0, 0.0] + noise, effects))
        assert names([one, two]) == ['scale_asymmetry', 'cross_axis']
        assert two.fit.gain > one.fit.gain, 'a further coefficient explains some of the noise'
        assert two.merit == pytest.approx(two.fit.gain - 2.0 * PRICE)
        assert one.merit == pytest.approx(one.fit.gain - PRICE)

    @pytest.mark.parametrize(('size', 'could'), [(1.0, False), (1e4, True)])
    def test_whether_an_effect_of_usual_size_could_show(self, size: float, could: bool) -> None:
        columns, noise = independent(1)
        usual = ONES[0].coefficients[0].prior_std
        columns *= size * 0.01 / usual
        (found,) = rank(score_statistics_of(columns, noise, ONES[:1]))
        assert found.could_show == could

    def test_the_best_variant_of_a_name_tells_the_time_constant(self) -> None:
        times_s, true_s, rng = (40.0, 80.0, 160.0, 320.0), 130.0, np.random.default_rng(0)
        moments = np.linspace(0.0, 600.0, BLOCKS * EACH).reshape(BLOCKS, EACH)
        columns = np.zeros((BLOCKS, EACH, 2 * len(times_s)))
        columns[:, :, ::2] = -np.exp(-moments[:, :, None] / np.array(times_s))
        seen = -8.0 * np.exp(-moments / true_s) + rng.normal(size=moments.shape)
        effects = tuple(with_means(BiasWarmup(), (0.0, time_s)) for time_s in times_s)
        scores = score_statistics_of(columns, seen, effects)
        (found,) = rank(scores)
        assert found.effect.coefficients[1].prior_mean == 160.0 and found.profile is not None
        amplitude, time_s = estimate(found)
        amplitude_std, time_std = doubts(found)
        assert abs(amplitude - 8.0) < 3.0 * amplitude_std < 4.0
        assert abs(time_s - true_s) < 3.0 * time_std < 200.0
        assert found.merit == pytest.approx(found.fit.gain - 2.0 * PRICE), 'its time constant costs as well'
        alone = fit(scores, found.columns[:1])
        assert alone is not None and found.fit.gain > alone.gain, 'the true one lies between two tried'
        assert found.places.tolist() == [0]


class TestBestExplanation:
    def mixture(self, *sizes: float) -> ScoreStatistics:
        """Two causes, and a third column that looks like both together."""
        columns, noise = independent(3)
        columns[:, :, 2] = columns[:, :, 0] + columns[:, :, 1] + 0.2 * columns[:, :, 2]
        return score_statistics_of(columns, columns[:, :, :2] @ sizes + noise, ONES[:3])

    @pytest.mark.parametrize(
        ('sizes', 'stronger'), [((3.0, 2.0), 'scale_asymmetry'), ((2.0, 3.0), 'scale_quadratic')]
    )
    def test_two_that_look_like_a_third(self, sizes: tuple[float, float], stronger: str) -> None:
        scores = self.mixture(*sizes)
        ranked = rank(scores)
        assert names(ranked)[0] == 'scale_cubic'
        best = best_explanation(ranked, scores, tried=())
        assert best is not None and best.effect.name == stronger

    def test_one_that_explains_all_stays(self) -> None:
        columns, noise = independent(3)
        columns[:, :, 2] = columns[:, :, 0] + columns[:, :, 1] + 0.2 * columns[:, :, 2]
        scores = score_statistics_of(columns, 2.0 * columns[:, :, 2] + noise, ONES[:3])
        best = best_explanation(rank(scores), scores, tried=())
        assert best is not None and best.effect.name == 'scale_cubic'

    def test_what_was_tried_is_out_of_the_question(self) -> None:
        scores = self.mixture(3.0, 0.0)
        best = best_explanation(rank(scores), scores, tried={'scale_asymmetry'})
        assert best is not None and best.effect.name == 'scale_cubic'
        assert best_explanation(rank(scores), scores, {effect.name for effect in ONES}) is None

    def test_chance_explains_nothing(self) -> None:
        for seed in range(20):
            columns, noise = independent(4, seed)
            scores = score_statistics_of(columns, noise, ONES)
            assert best_explanation(rank(scores), scores, tried=()) is None


class TestTwins:
    def alike(self, *sizes: float, closeness: float) -> ScoreStatistics:
        """The second column is the first but for a part; the third stands for itself."""
        columns, noise = independent(3)
        columns[:, :, 1] = columns[:, :, 0] + closeness * columns[:, :, 1]
        return score_statistics_of(columns, columns @ sizes + noise, ONES[:3])

    def test_what_explains_nearly_as_much_could_be_meant(self) -> None:
        scores = self.alike(2.0, 0.0, 0.0, closeness=0.01)
        ranked = rank(scores)
        found = named(ranked, 'scale_asymmetry')
        others = [ranked_effect for ranked_effect in ranked if ranked_effect is not found]
        assert twins(found, others, scores, NOTHING) == ['scale_quadratic']

    @pytest.mark.parametrize('closeness', [0.3, 2.0])
    def test_what_explains_clearly_less_could_not(self, closeness: float) -> None:
        scores = self.alike(2.0, 0.0, 0.0, closeness=closeness)
        ranked = rank(scores)
        assert twins(named(ranked, 'scale_asymmetry'), ranked[1:], scores, NOTHING) == []

    def test_they_are_told_beside_the_other_findings(self) -> None:
        """What is already found does not count as a rival, nor does what it explains."""
        columns, noise = independent(3)
        first, second = columns[:, :, 0].copy(), columns[:, :, 2].copy()
        columns[:, :, 1] = second + 0.01 * columns[:, :, 1]
        columns[:, :, 2] = second
        scores = score_statistics_of(columns, 8.0 * first + second + noise, ONES[:3])
        ranked = rank(scores)
        weak, twin = named(ranked, 'scale_cubic'), named(ranked, 'scale_quadratic')
        beside = named(ranked, 'scale_asymmetry').columns
        assert twins(weak, [twin], scores, beside) == ['scale_quadratic']
        assert twins(weak, [twin], scores, np.concatenate([beside, twin.columns])) == []

    def test_what_the_other_findings_explain_alone_has_no_twins(self) -> None:
        columns, noise = independent(3)
        columns[:, :, 1] = columns[:, :, 0]
        scores = score_statistics_of(columns, columns @ [1.0, 0.0, 0.0] + noise, ONES[:3])
        ranked = rank(scores)
        found = named(ranked, 'scale_asymmetry')
        assert twins(found, ranked, scores, named(ranked, 'scale_quadratic').columns) == []


class TestWithEstimate:
    def test_the_first_half_says_where_and_both_how_near(self) -> None:
        columns, noise = independent(1)
        columns *= 1000.0
        usual = ONES[0].coefficients[0].prior_std
        scores = score_statistics_of(columns, 0.2 * usual * columns[:, :, 0] + noise, ONES[:1])
        (ranked_effect,) = rank(scores)
        half = fit(scores.first_half(), np.array([0]))
        assert half is not None
        (item,) = with_estimate(ranked_effect, scores).coefficients
        assert item.prior_mean == half.values[0] != ranked_effect.fit.values[0]
        assert item.prior_std == pytest.approx(
            max(
                AT_LEAST_SIGMA * math.sqrt(half.covariance[0, 0]),
                abs(half.values[0] - ranked_effect.fit.values[0]),
                AT_LEAST_PART * abs(ranked_effect.fit.values[0]),
            )
        )
        assert item.prior_std < usual

    def test_halves_that_differ_leave_it_doubtful(self) -> None:
        columns, noise = independent(1)
        seen = columns[:, :, 0] * np.where(np.arange(BLOCKS) < BLOCKS // 2, 2.0, 0.5)[:, None] + 0.01 * noise
        wide = ScaleAsymmetry(coefficients=(Coefficient('c', '1', prior_std=100.0),))
        scores = score_statistics_of(columns, seen, (wide,))
        (ranked_effect,) = rank(scores)
        (item,) = with_estimate(ranked_effect, scores).coefficients
        assert item.prior_mean == pytest.approx(2.0, abs=0.05)
        assert item.prior_std >= 2.0 - ranked_effect.fit.values[0] - 0.05 > 0.5

    def test_it_is_never_more_doubtful_than_before(self) -> None:
        columns, noise = independent(1)
        scores = score_statistics_of(columns, 2.0 * columns[:, :, 0] + noise, ONES[:1])
        (ranked_effect,) = rank(scores)
        assert (
            with_estimate(ranked_effect, scores).coefficients[0].prior_std
            == ONES[0].coefficients[0].prior_std
        )

    def test_what_the_first_half_does_not_show_begins_where_it_stood(self) -> None:
        columns, noise = independent(1)
        columns[: BLOCKS // 2] = 0.0
        scores = score_statistics_of(columns, columns[:, :, 0] + noise, ONES[:1])
        (ranked_effect,) = rank(scores)
        assert ranked_effect.is_significant
        assert with_estimate(ranked_effect, scores) == ONES[0]

    def test_a_time_constant_is_told_by_the_whole(self) -> None:
        columns, noise = independent(4)
        columns[:, :, 1::2] = 0.0
        effects = tuple(with_means(BiasWarmup(), (0.0, time_s)) for time_s in (100.0, 200.0))
        scores = score_statistics_of(columns, columns @ [2.0, 0.0, 0.0, 0.0] + noise, effects)
        (ranked_effect,) = rank(scores)
        assert ranked_effect.profile is not None
        amplitude, time_constant = with_estimate(ranked_effect, scores).coefficients
        assert [amplitude.prior_mean, time_constant.prior_mean] == estimate(ranked_effect).tolist()
        assert time_constant.prior_std == NEARBY * time_constant.prior_mean
        assert amplitude.prior_std >= abs(amplitude.prior_mean)


class TestProfile:
    VALUES = (10.0, 20.0, 40.0, 80.0, 160.0)

    def fits(self, gains: list[float], amplitudes: list[float] | None = None) -> list[Fit]:
        return [
            Fit(np.array([0]), np.array([amplitude]), np.array([[0.25]]), gain, np.array([gain]))
            for gain, amplitude in zip(gains, amplitudes or [5.0] * len(gains), strict=True)
        ]

    def parabola(self, top: float, curvature: float) -> list[float]:
        """Gains whose logarithm of the value is known as one by `curvature`."""
        return [60.0 - 0.5 * curvature * math.log(value / top) ** 2 for value in self.VALUES]

    @pytest.mark.parametrize('top', [33.0, 40.0, 49.0])
    def test_the_top_of_a_parabola_on_a_log_axis(self, top: float) -> None:
        found = profile(self.VALUES, self.fits(self.parabola(top, 30.0)))
        assert found.value == pytest.approx(top)
        assert found.amplitude == 5.0 and found.amplitude_std == pytest.approx(0.5)

    def test_a_sharper_likelihood_leaves_less_doubt(self) -> None:
        sharp, flat = (
            profile(self.VALUES, self.fits(self.parabola(40.0, curvature))) for curvature in (40.0, 10.0)
        )
        assert flat.std == pytest.approx(2.0 * sharp.std)
        # The amplitude's scatter, 0.5, against 5 / sqrt(2 * 60) by the filter's own noise.
        assert sharp.std == pytest.approx(40.0 * 0.5 / (5.0 / math.sqrt(120.0)) / math.sqrt(40.0))

    def test_a_flat_one_leaves_it_open(self) -> None:
        found = profile(self.VALUES, self.fits([59.9, 59.9, 60.0, 59.9, 59.9]))
        assert found.value == pytest.approx(40.0) and found.std == pytest.approx(WIDEST * 40.0)

    def test_the_amplitude_follows_the_value(self) -> None:
        """Where a slower one needs more of it, doubt of one is doubt of the other."""
        amplitudes = [5.0 + 2.0 * math.log(value / 40.0) for value in self.VALUES]
        found = profile(self.VALUES, self.fits(self.parabola(45.0, 30.0), amplitudes))
        assert found.amplitude == pytest.approx(5.0 + 2.0 * math.log(45.0 / 40.0))
        assert found.amplitude_std == pytest.approx(math.hypot(0.5, 2.0 * found.std / 40.0))

    @pytest.mark.parametrize(('top', 'end'), [(2.0, 10.0), (900.0, 160.0)])
    def test_at_an_end_it_could_be_anywhere_beyond(self, top: float, end: float) -> None:
        found = profile(self.VALUES, self.fits(self.parabola(top, 10.0)))
        assert found.value == end and found.std == WIDEST * end
        assert found.amplitude_std == pytest.approx(math.hypot(5.0, 0.5))
