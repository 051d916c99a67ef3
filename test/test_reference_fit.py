"""Maximum-likelihood noise of a heading reference."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.pipeline.reference_fit import HeadingTrack, fit_bias_walk, fit_noise

SCALE_FACTOR, BIAS_RAD_S = 0.93, math.radians(0.2)
DURATION_S = 120.0


def track(
    seed: int = 0,
    *,
    white_deg: float = 0.1,
    walk_deg: float = 0.2,
    hz: float = 10.0,
    outliers: float = 0.0,
    late_s: float = 0.0,
    stamp_s: float = 0.0,
    jump_deg: float = 0.0,
    bias_walk_deg_s: float = 0.0,
    gap: tuple[float, float] = (0.0, 0.0),
) -> HeadingTrack:
    """Return headings of a robot that turns to and fro; outliers are six times as wide."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, DURATION_S, 1.0 / hz)
    rate = np.where(time_s % 10.0 < 4.0, 1.0, 0.0) * np.where(time_s % 20.0 < 10.0, 1.0, -1.0)
    turned = np.cumsum(rate) / hz
    errors = np.cumsum(math.radians(walk_deg) / math.sqrt(hz) * rng.standard_normal(len(time_s)))
    wide = np.where(rng.random(len(time_s)) < outliers, 6.0, 1.0)
    errors += math.radians(white_deg) * wide * rng.standard_normal(len(time_s))
    errors -= stamp_s * rate * rng.standard_normal(len(time_s))
    errors += math.radians(jump_deg) * (time_s > 0.5 * DURATION_S)
    yaw = SCALE_FACTOR * turned + BIAS_RAD_S * time_s - late_s * rate + errors
    bias = np.cumsum(math.radians(bias_walk_deg_s) / math.sqrt(hz) * rng.standard_normal(len(time_s)))
    yaw += np.cumsum(bias) / hz
    present = (time_s < gap[0]) | (time_s >= gap[1])
    time_s, yaw, turned, rate = (column[present] for column in (time_s, yaw, turned, rate))
    none = np.zeros(len(time_s))
    return HeadingTrack(time_s, yaw, turned, rate, none, none, none, rest_noise_rad_s=0.0)


@pytest.mark.parametrize(
    ('white_deg', 'walk_deg', 'outliers'), [(0.05, 0.05, 0.0), (0.5, 0.2, 0.0), (0.5, 0.2, 0.1)]
)
def test_white_noise_and_walk_are_found(white_deg: float, walk_deg: float, outliers: float) -> None:
    found = fit_noise(track(white_deg=white_deg, walk_deg=walk_deg, outliers=outliers), Config().gyro)
    assert math.degrees(float(found.noise.white_rad)) == pytest.approx(white_deg, rel=0.35)
    assert math.degrees(float(found.noise.walk_rad)) == pytest.approx(walk_deg, rel=0.6)
    assert (float(found.noise.tail_dof) < 6.0) == (outliers > 0.0)


def test_outliers_are_not_taken_for_walk() -> None:
    gyro, walk_deg = Config().gyro, 0.2
    fits = [
        fit_noise(track(seed, white_deg=0.5, walk_deg=walk_deg, outliers=0.08), gyro) for seed in range(10)
    ]
    logs = [math.log(math.degrees(float(fit.noise.walk_rad)) / walk_deg) for fit in fits]
    assert np.mean(logs) == pytest.approx(0.0, abs=0.1)


def test_a_white_noise_below_the_step_of_the_walk_is_found() -> None:
    """With heavy tails none is likeliest."""
    found = fit_noise(track(white_deg=0.03, walk_deg=0.36, hz=38.0), Config().gyro)
    assert math.degrees(float(found.noise.white_rad)) == pytest.approx(0.03, rel=0.35)
    assert float(found.noise.tail_dof) == 30.0


@pytest.mark.parametrize('stamp_s', [0.0, 0.005, 0.03])
def test_the_noise_of_the_stamps_is_found(stamp_s: float) -> None:
    fits = [fit_noise(track(seed, white_deg=0.03, stamp_s=stamp_s), Config().gyro) for seed in range(3)]
    for fit in fits:
        assert float(fit.noise.stamp_s) == pytest.approx(stamp_s, rel=0.3, abs=3e-4)
        assert abs(fit.scale_factor - SCALE_FACTOR) < 3.5 * math.sqrt(fit.covariance[2, 2])
        assert not fit.jumps_s


@pytest.mark.parametrize(('relative', 'low', 'high'), [(1.0, 1.0, 2.0), (30.0, 8.0, 128.0)])
def test_a_bias_that_walks_more_than_the_settings_say_is_found(
    relative: float, low: float, high: float
) -> None:
    gyro = Config().gyro
    walks = []
    for seed in range(8):
        headings = track(seed, white_deg=0.05, walk_deg=0.05, bias_walk_deg_s=relative * gyro.bias_walk_deg_s)
        walks.append(fit_bias_walk(headings, fit_noise(headings, gyro), gyro) / gyro.bias_walk_deg_s)
    assert low <= np.median(walks) <= high
    assert np.mean(np.array(walks) == 1.0) == pytest.approx(1.0 if relative == 1.0 else 0.0, abs=0.25)


def test_the_states_are_honest() -> None:
    fits = [fit_noise(track(seed, outliers=0.05, late_s=0.03), Config().gyro) for seed in range(4)]
    z = [
        (fit.mean[place] - true) / math.sqrt(fit.covariance[place, place])
        for place, true in ((1, BIAS_RAD_S), (2, SCALE_FACTOR - 1.0), (3, 0.03))
        for fit in fits
    ]
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_a_jump_is_neither_walk_nor_scale() -> None:
    still, jumped = (fit_noise(track(jump_deg=jump), Config().gyro) for jump in (0.0, 20.0))
    assert float(jumped.noise.walk_rad) < 1.5 * float(still.noise.walk_rad)
    assert jumped.scale_factor == pytest.approx(SCALE_FACTOR, abs=3.0 * math.sqrt(jumped.covariance[2, 2]))


def test_a_gap_costs_only_what_it_hides() -> None:
    whole, gapped = (fit_noise(track(gap=gap), Config().gyro) for gap in ((0.0, 0.0), (40.0, 80.0)))
    assert math.sqrt(gapped.covariance[2, 2] / whole.covariance[2, 2]) < 1.6


def test_a_long_track_is_thinned_without_losing_its_gaps() -> None:
    full = track(hz=10.0)
    full.gap_s[7] = 0.5
    thin = full.thinned(400)
    assert len(thin.time_s) == 400 and thin.gap_s.sum() == pytest.approx(0.5)
    assert thin.time_s[1] - thin.time_s[0] == pytest.approx(0.3)


def test_rests_tell_of_a_walk_of_the_bias_that_the_noise_of_the_headings_hides() -> None:
    """Only the rests at the beginning and at the end, 100 s later, show that the bias has changed."""
    changed, gyro = math.radians(0.1), Config().gyro
    headings = track(white_deg=0.5, walk_deg=1.0)
    rests = (headings.time_s < 6.0) | (headings.time_s > 114.0)
    rng = np.random.default_rng(1)
    noise_rad = 1e-4 * math.sqrt(0.1) * rng.standard_normal(len(headings.time_s))
    bias = BIAS_RAD_S + changed * headings.time_s / DURATION_S

    def found_deg_s(bias_rad_s: Array | float) -> float:
        with_rests = replace(
            headings,
            rest_s=0.1 * rests,
            rest_turn_rad=(noise_rad - 0.1 * bias_rad_s / SCALE_FACTOR) * rests,
            rest_noise_rad_s=1e-4,
        )
        return fit_bias_walk(with_rests, fit_noise(with_rests, gyro), gyro)

    assert found_deg_s(BIAS_RAD_S) == gyro.bias_walk_deg_s
    assert found_deg_s(bias) > 4.0 * gyro.bias_walk_deg_s
