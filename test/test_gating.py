"""Gates, and the adaptive estimation of the measurement noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_states import some_state
from scipy.stats import chi2  # type: ignore[import-untyped]

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.ekf.features.gating import MotionGate, inliers
from gyrocal_ros.ekf.noise.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.state.layout import YAW
from gyrocal_ros.statistics import chi_square_quantile


@pytest.mark.parametrize('probability', [0.5, 0.95, 0.99, 0.9999, 1.0 - 1e-6])
def test_chi_square_quantile(probability: float) -> None:
    assert chi_square_quantile(probability, 1) == pytest.approx(chi2.ppf(probability, 1))
    assert chi_square_quantile(probability, 2) == pytest.approx(chi2.ppf(probability, 2))
    assert chi_square_quantile(probability, 3) == pytest.approx(chi2.ppf(probability, 3))


def test_the_gate_rejects_as_many_inliers_as_it_should() -> None:
    distances = chi2.rvs(2, size=(5000, 15), random_state=0)
    rejected = np.mean([~inliers(row, 2, 0.01) for row in distances])
    assert 0.002 < rejected < 0.012


@pytest.mark.parametrize('count', [1, 2, 3, 4, 5, 6, 15])
def test_outliers_are_rejected_while_they_are_no_more_than_half(count: int) -> None:
    good = np.linspace(0.2, 3.0, count - count // 2)
    bad = np.full(count // 2, 1000.0)
    assert inliers(np.concatenate([bad, good]), 2, 1e-4).tolist() == [False] * len(bad) + [True] * len(good)


def test_the_gate_widens_with_the_median_of_the_image() -> None:
    """An effect that the model lacks shifts all features at once; they must not all be rejected."""
    shifted = chi2.rvs(2, size=15, random_state=0) + 60.0
    assert inliers(shifted, 2, 1e-4).all()
    assert inliers(np.append(shifted, 1e5), 2, 1e-4).tolist() == [True] * 15 + [False]


@pytest.mark.parametrize('outliers', [0.0, 0.05])
@pytest.mark.parametrize('true_px', [0.1, 0.4, 1.5])
def test_noise_converges_to_the_truth(true_px: float, outliers: float) -> None:
    noise, rng = AdaptiveNoise(0.4, 0.02, 10.0), np.random.default_rng(0)
    settled = []
    for frame in range(3000):
        distances = (true_px / noise.std) ** 2 * rng.chisquare(2, 15)
        distances[rng.random(15) < outliers] = 1e4
        noise.update(distances, 2)
        if frame > 600:
            settled.append(noise.std)
    # 5 % of outliers push the median of the others up to their 0.526 quantile
    median = chi_square_quantile(0.5 / (1.0 - outliers), 2) / chi_square_quantile(0.5, 2)
    assert np.mean(settled) == pytest.approx(true_px * math.sqrt(median), rel=0.02)
    assert np.std(settled) < 0.05 * true_px


def test_noise_stays_within_its_bounds() -> None:
    noise = AdaptiveNoise(0.4, 0.02, 10.0)
    noise.update(np.empty(0), 2)
    assert noise.std == 0.4
    for _ in range(3000):
        noise.update(np.full(15, 1e6), 2)
    assert noise.std == 10.0 and noise.is_at_limit
    for _ in range(3000):
        noise.update(np.zeros(15), 2)
    assert noise.std == 0.02 and not noise.is_at_limit


class TestMotionGate:
    CONFIG = replace(FeatureConfig(), motion_gate_m=0.05, motion_gate_deg=2.0)

    def passes(self, gate: MotionGate, x_m: float = 0.0, y_m: float = 0.0, yaw_deg: float = 0.0) -> bool:
        state = some_state()
        mean = state.mean.copy()
        mean[0], mean[1], mean[YAW] = x_m, y_m, math.radians(yaw_deg)
        return gate.passes(replace(state, mean=mean), self.CONFIG)

    def test_the_first_image_passes(self) -> None:
        assert self.passes(MotionGate())

    def test_an_image_without_motion_does_not(self) -> None:
        gate = MotionGate()
        assert self.passes(gate)
        assert not self.passes(gate)

    @pytest.mark.parametrize(
        ('moved', 'passes'),
        [
            ({'x_m': 0.049}, False),
            ({'x_m': 0.051}, True),
            ({'x_m': 0.04, 'y_m': 0.04}, True),
            ({'yaw_deg': 1.9}, False),
            ({'yaw_deg': 2.1}, True),
            ({'yaw_deg': -2.1}, True),
        ],
        ids=str,
    )
    def test_a_distance_or_a_turn_opens_it(self, moved: dict[str, float], passes: bool) -> None:
        gate = MotionGate()
        assert self.passes(gate)
        assert self.passes(gate, **moved) is passes

    def test_motion_counts_from_the_last_image_that_passed(self) -> None:
        gate = MotionGate()
        found = [self.passes(gate, x_m=0.02 * step) for step in range(7)]
        assert found == [True, False, False, True, False, False, True]
