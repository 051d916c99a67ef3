"""From score statistics to a ranked list: prices, pairs, effects that look alike, priors, time constants."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import score_statistics_of

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit, fit
from gyrocal_ros.diagnose.analysis.profile import WIDEST, Profile, profile
from gyrocal_ros.diagnose.analysis.ranking import (
    RankedEffect,
    best_explanation,
    estimate,
    estimate_stds,
    indistinguishable,
    rank,
    with_estimate,
)
from gyrocal_ros.diagnose.search.uneven import (
    uneven_explanation,
    uneven_first_effect,
    uneven_gyro_effect,
    uneven_sign,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS as SETTINGS
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bias
from gyrocal_ros.effects.scale_asymmetry import ScaleAsymmetry
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.model.sensor import Coefficient, with_means

BLOCKS, EACH = 30, 20
ONES = tuple(map(find_effect, ('scale_asymmetry', 'scale_quadratic', 'scale_cubic', 'gyro_lag')))
"""Effects of one coefficient each."""
NOTHING = np.empty(0, np.int64)


def independent(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return independent columns (B, n, c), and noise (B, n)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(BLOCKS, EACH, count)), rng.normal(size=(BLOCKS, EACH))


def names(ranked: list[RankedEffect]) -> list[str]:
    return [item.effect.name for item in ranked]


def named(ranked: list[RankedEffect], name: str) -> RankedEffect:
    return next(item for item in ranked if item.effect.name == name)


def scattered(item: RankedEffect, sigma: float, merit: float) -> RankedEffect:
    """Return an effect of one coefficient that is not significant: with another scatter and another merit."""
    dof = item.fit.clusters - 1
    wald = dof * math.expm1(sigma**2 / dof)
    covariance = np.array([[item.fit.values[0] ** 2 / wald]])
    fitted = replace(item.fit, covariance=covariance, gain=merit + SETTINGS.coefficient_price)
    assert fitted.sigma == pytest.approx(sigma)
    return replace(item, fit=fitted, merit=merit, is_significant=False)


class TestRank:
    def test_the_effect_that_explains_most_comes_first(self) -> None:
        columns, noise = independent(3)
        ranked = rank(score_statistics_of(columns, columns @ [0.5, -2.0, 1.0] + noise, ONES[:3]), SETTINGS)
        assert names(ranked) == ['scale_quadratic', 'scale_cubic', 'scale_asymmetry']
        assert all(item.is_significant for item in ranked)
        np.testing.assert_allclose([item.fit.values[0] for item in ranked], [-2.0, 1.0, 0.5], atol=0.2)

    def test_a_significant_effect_comes_before_one_that_gains_more_by_chance(self) -> None:
        """One block that is off gains much, but the scatter shows that it is one block."""
        columns, noise = independent(2)
        measured = columns @ [0.5, 0.0] + 0.1 * noise
        measured[3] += 30.0 * columns[3, :, 1]
        first, second = rank(score_statistics_of(columns, measured, ONES[:2]), SETTINGS)
        assert names([first, second]) == ['scale_asymmetry', 'scale_quadratic']
        assert second.merit > first.merit and not second.is_significant
        assert uneven_explanation([first, second], (), SETTINGS) is second
        assert uneven_explanation([first, second], {'scale_quadratic'}, SETTINGS) is None
        costly = replace(SETTINGS, significant_sigma=1.01 * math.sqrt(2.0 * second.merit))
        assert uneven_explanation([first, second], (), costly) is None
        lenient = replace(SETTINGS, significant_sigma=1.9 * second.fit.sigma)
        found = uneven_gyro_effect([first, second], (), SETTINGS)
        assert found is None, 'less than half of a significant one'
        assert uneven_gyro_effect([second], (), lenient) is second
        of_camera = replace(second, effect=find_effect('focal_length'))
        assert uneven_gyro_effect([of_camera], (), lenient) is None
        assert uneven_sign([second, of_camera], (), lenient) is second
        sliding = replace(of_camera, merit=2.1 * second.merit)
        assert uneven_sign([second, sliding], (), lenient) is None, 'tracks slide'
        part, fitted = 1e-4, second.fit
        small = replace(fitted, values=part * fitted.values, covariance=part**2 * fitted.covariance)
        assert uneven_gyro_effect([replace(second, fit=small)], (), lenient) is None, 'smaller than is usual'

    def test_an_effect_of_the_camera_is_tried_first_where_it_gains_far_more_than_images_err(
        self,
    ) -> None:
        columns, noise = independent(2)
        best, _ = rank(score_statistics_of(columns, columns @ [0.5, 0.1] + noise, ONES[:2]), SETTINGS)
        best = replace(best, effect=find_effect('focal_length'))
        lens = scattered(best, 3.5, 150.0)
        assert uneven_first_effect([lens], (), SETTINGS) is lens
        assert uneven_first_effect([lens], {'focal_length'}, SETTINGS) is None
        assert uneven_first_effect([scattered(best, 3.5, 90.0)], (), SETTINGS) is None
        assert uneven_first_effect([scattered(best, 2.9, 150.0)], (), SETTINGS) is None
        gyro = replace(scattered(best, 2.5, 20.0), effect=find_effect('gyro_lag'))
        assert uneven_first_effect([lens, gyro], (), SETTINGS) is gyro

    def test_an_effect_that_is_not_excited_is_not_ranked(self) -> None:
        columns, noise = independent(2)
        columns[:, :, 1] = 0.0
        scores = score_statistics_of(columns, columns @ [0.5, 0.0] + noise, ONES[:2])
        assert names(rank(scores, SETTINGS)) == ['scale_asymmetry']

    def test_each_coefficient_has_its_price(self) -> None:
        columns, noise = independent(3)
        effects = (find_effect('scale_asymmetry'), find_effect('cross_axis'))
        columns[:, :, 1] = columns[:, :, 0]
        one, two = rank(score_statistics_of(columns, columns @ [1.0, 0.0, 0.0] + noise, effects), SETTINGS)
        assert names([one, two]) == ['scale_asymmetry', 'cross_axis']
        assert two.fit.gain > one.fit.gain, 'a further coefficient explains some of the noise'
        assert two.merit == pytest.approx(two.fit.gain - 2.0 * SETTINGS.coefficient_price)
        assert one.merit == pytest.approx(one.fit.gain - SETTINGS.coefficient_price)

    def test_thresholds_are_those_of_the_settings(self) -> None:
        columns, noise = independent(1)
        scores = score_statistics_of(columns, columns @ [0.5] + noise, ONES[:1])
        (usual,) = rank(scores, SETTINGS)
        assert usual.is_significant
        costly = replace(SETTINGS, coefficient_price=usual.fit.gain + 1.0)
        strict = replace(SETTINGS, significant_sigma=usual.fit.sigma + 1.0)
        assert [rank(scores, settings)[0].is_significant for settings in (costly, strict)] == [False, False]

    @pytest.mark.parametrize(('size', 'could'), [(1.0, False), (1e4, True)])
    def test_whether_an_effect_of_usual_size_could_show(self, size: float, could: bool) -> None:
        columns, noise = independent(1)
        usual = ONES[0].coefficients[0].prior_std
        columns *= size * 0.01 / usual
        (found,) = rank(score_statistics_of(columns, noise, ONES[:1]), SETTINGS)
        assert found.could_show == could

    def test_the_variants_of_a_name_give_the_time_constant(self) -> None:
        times_s, true_s, rng = (40.0, 80.0, 160.0, 320.0), 130.0, np.random.default_rng(0)
        moments = np.linspace(0.0, 600.0, BLOCKS * EACH).reshape(BLOCKS, EACH)
        columns = np.zeros((BLOCKS, EACH, 2 * len(times_s)))
        columns[:, :, ::2] = -np.exp(-moments[:, :, None] / np.array(times_s))
        measured = -8.0 * np.exp(-moments / true_s) + rng.normal(size=moments.shape)
        effects = tuple(with_means(BiasWarmup(), (0.0, time_s)) for time_s in times_s)
        scores = score_statistics_of(columns, measured, effects)
        (found,) = rank(scores, SETTINGS)
        assert found.effect.coefficients[1].prior_mean == 160.0 and found.profile is not None
        amplitude, time_s = estimate(found)
        amplitude_std, time_std = estimate_stds(found)
        assert abs(amplitude - 8.0) < 3.0 * amplitude_std < 4.0
        assert abs(time_s - true_s) < 3.0 * time_std < 200.0
        price = 2.0 * SETTINGS.coefficient_price
        assert found.merit == pytest.approx(found.fit.gain - price), 'the time constant has its price, too'
        alone = fit(scores, found.columns[:1])
        assert alone is not None and found.fit.gain > alone.gain, 'the true one lies between two of the scan'
        assert found.places.tolist() == [0]

    @pytest.mark.parametrize('count', [1, 2])
    def test_of_a_scan_with_few_values_the_better_is_taken(self, count: int) -> None:
        columns, noise = independent(2 * count)
        columns[:, :, 1::2] = 0.0
        effects = tuple(with_means(BiasWarmup(), (0.0, time_s)) for time_s in (100.0, 200.0)[:count])
        (found,) = rank(score_statistics_of(columns, 2.0 * columns[:, :, 0] + noise, effects), SETTINGS)
        assert found.effect == effects[0]
        assert estimate(found)[0] == pytest.approx(2.0, abs=0.2) and found.is_significant


class TestBestExplanation:
    def mixture(self, *sizes: float) -> ScoreStatistics:
        """Two causes, and a third column that looks like both together."""
        columns, noise = independent(3)
        columns[:, :, 2] = columns[:, :, 0] + columns[:, :, 1] + 0.2 * columns[:, :, 2]
        return score_statistics_of(columns, columns[:, :, :2] @ sizes + noise, ONES[:3])

    @pytest.mark.parametrize(
        ('sizes', 'stronger'), [((3.0, 2.0), 'scale_asymmetry'), ((2.0, 3.0), 'scale_quadratic')]
    )
    def test_two_effects_that_look_like_a_third(self, sizes: tuple[float, float], stronger: str) -> None:
        scores = self.mixture(*sizes)
        ranked = rank(scores, SETTINGS)
        assert names(ranked)[0] == 'scale_cubic'
        best = best_explanation(ranked, scores, (), SETTINGS)
        assert best is not None and best.effect.name == stronger

    def test_one_effect_that_explains_everything_is_the_best(self) -> None:
        columns, noise = independent(3)
        columns[:, :, 2] = columns[:, :, 0] + columns[:, :, 1] + 0.2 * columns[:, :, 2]
        scores = score_statistics_of(columns, 2.0 * columns[:, :, 2] + noise, ONES[:3])
        best = best_explanation(rank(scores, SETTINGS), scores, (), SETTINGS)
        assert best is not None and best.effect.name == 'scale_cubic'

    @pytest.mark.parametrize(('more', 'expected'), [(2.5, 'scale_quadratic'), (1.5, 'scale_asymmetry')])
    def test_a_much_larger_gain_tells_what_is_missing_also_where_it_is_less_even(
        self, more: float, expected: str
    ) -> None:
        columns, noise = independent(2)
        scores = score_statistics_of(columns, columns @ [1.0, 0.8] + noise, ONES[:2])
        even, second = rank(scores, SETTINGS)
        uneven = scattered(second, 3.5, more * even.merit)
        best = best_explanation([even, uneven], scores, (), SETTINGS)
        assert best is not None and best.effect.name == expected
        hardly = scattered(second, 0.9 * SETTINGS.uneven_sigma, more * even.merit)
        best = best_explanation([even, hardly], scores, (), SETTINGS)
        assert best is not None and best.effect.name == 'scale_asymmetry'
        assert best_explanation([uneven], scores, (), SETTINGS) is None, 'nothing is certain to be missing'

    @pytest.mark.parametrize(
        ('signals', 'expected'), [(('fan', 'speed'), 'scale_cubic'), (('fan', ''), 'scale_asymmetry')]
    )
    def test_two_signals_must_explain_far_more_than_one_law(
        self, signals: tuple[str, str], expected: str
    ) -> None:
        """The law is fitted to a noisy measure: a tenth of its column is noise."""
        columns, noise = independent(3)
        law = columns[:, :, 0] + 0.7 * columns[:, :, 1]
        columns[:, :, 2] = law + 0.25 * columns[:, :, 2]
        followers = [
            covariate_bias(name, 0.0, 1.0) if name else effect
            for name, effect in zip(signals, ONES[:2], strict=True)
        ]
        scores = score_statistics_of(columns, 2.0 * law + noise, (*followers, ONES[2]))
        ranked = rank(scores, SETTINGS)
        assert names(ranked)[0] == 'scale_cubic'
        best = best_explanation(ranked, scores, (), SETTINGS)
        named_first = followers[0].name if expected == 'scale_asymmetry' else expected
        assert best is not None and best.effect.name == named_first

    def test_effects_that_were_tried_are_left_out(self) -> None:
        scores = self.mixture(3.0, 0.0)
        ranked = rank(scores, SETTINGS)
        best = best_explanation(ranked, scores, {'scale_asymmetry'}, SETTINGS)
        assert best is not None and best.effect.name == 'scale_cubic'
        assert best_explanation(ranked, scores, {effect.name for effect in ONES}, SETTINGS) is None

    def test_noise_is_explained_by_nothing(self) -> None:
        for seed in range(20):
            columns, noise = independent(4, seed)
            scores = score_statistics_of(columns, noise, ONES)
            assert best_explanation(rank(scores, SETTINGS), scores, (), SETTINGS) is None


class TestIndistinguishable:
    def alike(self, *sizes: float, difference: float) -> ScoreStatistics:
        """The second column is the first but for a part; the third is independent."""
        columns, noise = independent(3)
        columns[:, :, 1] = columns[:, :, 0] + difference * columns[:, :, 1]
        return score_statistics_of(columns, columns @ sizes + noise, ONES[:3])

    def test_an_effect_that_explains_nearly_as_much(self) -> None:
        scores = self.alike(2.0, 0.0, 0.0, difference=0.01)
        ranked = rank(scores, SETTINGS)
        found = named(ranked, 'scale_asymmetry')
        others = [item for item in ranked if item is not found]
        assert indistinguishable(found, others, scores, NOTHING, SETTINGS) == ['scale_quadratic']

    @pytest.mark.parametrize('difference', [0.3, 2.0])
    def test_an_effect_that_explains_clearly_less_is_distinguished(self, difference: float) -> None:
        scores = self.alike(2.0, 0.0, 0.0, difference=difference)
        ranked = rank(scores, SETTINGS)
        found = named(ranked, 'scale_asymmetry')
        assert indistinguishable(found, ranked[1:], scores, NOTHING, SETTINGS) == []

    def test_effects_are_compared_beside_the_others_that_were_found(self) -> None:
        """An effect that was found is no alternative, and what it explains does not count."""
        columns, noise = independent(3)
        first, second = columns[:, :, 0].copy(), columns[:, :, 2].copy()
        columns[:, :, 1] = second + 0.01 * columns[:, :, 1]
        columns[:, :, 2] = second
        scores = score_statistics_of(columns, 8.0 * first + second + noise, ONES[:3])
        ranked = rank(scores, SETTINGS)
        weak, alike = named(ranked, 'scale_cubic'), named(ranked, 'scale_quadratic')
        beside = named(ranked, 'scale_asymmetry').columns
        assert indistinguishable(weak, [alike], scores, beside, SETTINGS) == ['scale_quadratic']
        with_alike = np.concatenate([beside, alike.columns])
        assert indistinguishable(weak, [alike], scores, with_alike, SETTINGS) == []

    def test_an_effect_that_the_others_explain_looks_like_nothing(self) -> None:
        columns, noise = independent(3)
        columns[:, :, 1] = columns[:, :, 0]
        scores = score_statistics_of(columns, columns @ [1.0, 0.0, 0.0] + noise, ONES[:3])
        ranked = rank(scores, SETTINGS)
        found, beside = named(ranked, 'scale_asymmetry'), named(ranked, 'scale_quadratic').columns
        assert indistinguishable(found, ranked, scores, beside, SETTINGS) == []


class TestWithEstimate:
    def test_the_prior_is_the_first_half_and_as_wide_as_both_differ(self) -> None:
        columns, noise = independent(1)
        columns *= 1000.0
        usual = ONES[0].coefficients[0].prior_std
        scores = score_statistics_of(columns, 0.2 * usual * columns[:, :, 0] + noise, ONES[:1])
        (ranked,) = rank(scores, SETTINGS)
        half = fit(scores.first_half(), np.array([0]))
        assert half is not None
        (item,) = with_estimate(ranked, scores, SETTINGS).coefficients
        assert item.prior_mean == half.values[0] != ranked.fit.values[0]
        assert item.prior_std == pytest.approx(
            max(
                SETTINGS.start_sigma * math.sqrt(half.covariance[0, 0]),
                abs(half.values[0] - ranked.fit.values[0]),
                SETTINGS.start_part * abs(ranked.fit.values[0]),
            )
        )
        assert item.prior_std < usual

    def test_halves_that_differ_widen_the_prior(self) -> None:
        columns, noise = independent(1)
        size = np.where(np.arange(BLOCKS) < BLOCKS // 2, 2.0, 0.5)[:, None]
        wide = ScaleAsymmetry(coefficients=(Coefficient('c', '1', prior_std=100.0),))
        scores = score_statistics_of(columns, columns[:, :, 0] * size + 0.01 * noise, (wide,))
        (ranked,) = rank(scores, SETTINGS)
        (item,) = with_estimate(ranked, scores, SETTINGS).coefficients
        assert item.prior_mean == pytest.approx(2.0, abs=0.05)
        assert item.prior_std >= 2.0 - ranked.fit.values[0] - 0.05 > 0.5

    def test_the_prior_is_never_wider_than_the_usual_one(self) -> None:
        columns, noise = independent(1)
        scores = score_statistics_of(columns, 2.0 * columns[:, :, 0] + noise, ONES[:1])
        (ranked,) = rank(scores, SETTINGS)
        (item,) = with_estimate(ranked, scores, SETTINGS).coefficients
        assert item.prior_std == ONES[0].coefficients[0].prior_std

    def test_an_effect_that_the_first_half_does_not_show_keeps_its_prior(self) -> None:
        columns, noise = independent(1)
        columns[: BLOCKS // 2] = 0.0
        scores = score_statistics_of(columns, columns[:, :, 0] + noise, ONES[:1])
        (ranked,) = rank(scores, SETTINGS)
        assert ranked.is_significant
        assert with_estimate(ranked, scores, SETTINGS) == ONES[0]

    def test_an_effect_that_the_first_half_hardly_shows_starts_at_its_prior(self) -> None:
        """Chance in the half may have the wrong sign, and be many standard deviations of the prior away."""
        columns, noise = independent(1)
        columns[: BLOCKS // 2] *= 1e-3
        scores = score_statistics_of(columns, columns[:, :, 0] + noise, ONES[:1])
        (ranked,) = rank(scores, SETTINGS)
        half = fit(scores.first_half(), np.array([0]))
        assert ranked.is_significant and half is not None and abs(half.values[0]) > 3.0
        (item,) = with_estimate(ranked, scores, SETTINGS).coefficients
        assert item.prior_mean == 0.0 and item.prior_std == ONES[0].coefficients[0].prior_std

    def test_a_time_constant_is_estimated_from_the_whole(self) -> None:
        columns, noise = independent(4)
        columns[:, :, 1::2] = 0.0
        effects = tuple(with_means(BiasWarmup(), (0.0, time_s)) for time_s in (100.0, 200.0))
        scores = score_statistics_of(columns, columns @ [2.0, 0.0, 0.0, 0.0] + noise, effects)
        (ranked,) = rank(scores, SETTINGS)
        assert ranked.profile is not None
        amplitude, time_constant = with_estimate(ranked, scores, SETTINGS).coefficients
        assert [amplitude.prior_mean, time_constant.prior_mean] == estimate(ranked).tolist()
        assert time_constant.prior_std == SETTINGS.scan_start_part * time_constant.prior_mean
        assert amplitude.prior_std >= abs(amplitude.prior_mean)


class TestProfile:
    VALUES = (10.0, 20.0, 40.0, 80.0, 160.0)

    def fits(self, gains: list[float], amplitudes: list[float] | None = None) -> list[Fit]:
        return [
            Fit(np.array([0]), np.array([amplitude]), np.array([[0.25]]), gain, np.array([gain]), 1)
            for gain, amplitude in zip(gains, amplitudes or [5.0] * len(gains), strict=True)
        ]

    def parabola(self, top: float, curvature: float) -> list[float]:
        """Gains of a likelihood that is normal in the logarithm of the value, with that curvature."""
        return [60.0 - 0.5 * curvature * math.log(value / top) ** 2 for value in self.VALUES]

    @staticmethod
    def amplitude(found: Profile) -> tuple[float, float]:
        """Return the only linear coefficient and its standard deviation."""
        assert found.linear.shape == found.linear_stds.shape == (1,)
        return float(found.linear[0]), float(found.linear_stds[0])

    @pytest.mark.parametrize('top', [33.0, 40.0, 49.0])
    def test_the_maximum_of_a_parabola_over_the_logarithm(self, top: float) -> None:
        found = profile(self.VALUES, self.fits(self.parabola(top, 30.0)))
        assert found.value == pytest.approx(top)
        amplitude, amplitude_std = self.amplitude(found)
        assert amplitude == 5.0 and amplitude_std == pytest.approx(0.5)

    def test_a_sharper_likelihood_gives_a_smaller_standard_deviation(self) -> None:
        sharp, flat = (
            profile(self.VALUES, self.fits(self.parabola(40.0, curvature))) for curvature in (40.0, 10.0)
        )
        assert flat.std == pytest.approx(2.0 * sharp.std)
        # The amplitude's scatter, 0.5, against 5 / sqrt(2 * 60) by the filter's own noise.
        assert sharp.std == pytest.approx(40.0 * 0.5 / (5.0 / math.sqrt(120.0)) / math.sqrt(40.0))

    def test_a_flat_likelihood_gives_the_widest(self) -> None:
        found = profile(self.VALUES, self.fits([59.9, 59.9, 60.0, 59.9, 59.9]))
        assert found.value == pytest.approx(40.0) and found.std == pytest.approx(WIDEST * 40.0)

    def test_the_amplitude_follows_the_value(self) -> None:
        """Where a longer time constant needs more amplitude, both are uncertain together."""
        amplitudes = [5.0 + 2.0 * math.log(value / 40.0) for value in self.VALUES]
        found = profile(self.VALUES, self.fits(self.parabola(45.0, 30.0), amplitudes))
        amplitude, amplitude_std = self.amplitude(found)
        assert amplitude == pytest.approx(5.0 + 2.0 * math.log(45.0 / 40.0))
        assert amplitude_std == pytest.approx(math.hypot(0.5, 2.0 * found.std / 40.0))

    @pytest.mark.parametrize(('top', 'end'), [(2.0, 10.0), (900.0, 160.0)])
    def test_a_maximum_at_an_end_leaves_the_value_open(self, top: float, end: float) -> None:
        found = profile(self.VALUES, self.fits(self.parabola(top, 10.0)))
        assert found.value == end and found.std == WIDEST * end
        assert self.amplitude(found)[1] == pytest.approx(math.hypot(5.0, 0.5))

    def test_two_linear_coefficients_beside_the_value(self) -> None:
        slopes = np.array([2.0, -3.0])
        covariance = np.array([[0.25, 0.1], [0.1, 0.5]])
        fits = []
        for value, gain in zip(self.VALUES, self.parabola(45.0, 30.0), strict=True):
            values = np.array([5.0, 1.0]) + slopes * math.log(value / 40.0)
            fits.append(Fit(np.arange(2), values, covariance, gain, np.array([gain]), 1))
        found = profile(self.VALUES, fits)
        assert found.value == pytest.approx(45.0)
        np.testing.assert_allclose(found.linear, np.array([5.0, 1.0]) + slopes * math.log(45.0 / 40.0))
        by_value = slopes * found.std / 40.0
        np.testing.assert_allclose(found.linear_stds, np.sqrt(np.diagonal(covariance) + by_value**2))
