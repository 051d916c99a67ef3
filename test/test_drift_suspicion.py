"""A drift of the scale factor that is not sure, beside headings that err slowly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.features.track_noise import TURN_PX_BY_SLOW, TrackNoise
from gyrocal_ros.ekf.history.scatter import scatter_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.ekf.watches.drift_suspicion import (
    CONFIRMED_RAD,
    DRIFT_MEMORY_S,
    DRIFT_STD,
    EXACT,
    RAMP_S,
    FollowedChanges,
    HeadingErrors,
    Ramp,
    suspected_drift,
)
from gyrocal_ros.ekf.watches.scale_watch import COLUMNS, ScaleWatch
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect

TRACKS = HeadingErrors(are_by_tracks=True)


def test_the_variance_of_a_ramp_is_that_of_the_slope_of_a_line() -> None:
    """A scale factor is measured in each turn by pi, evenly in time."""
    slow_rad, age_s, turns = 1e-3, 150.0, 40
    times = np.linspace(0.0, age_s, turns)
    errors = np.random.default_rng(0).normal(0.0, slow_rad / math.pi, (20_000, turns))
    slopes = RAMP_S * np.polyfit(times, errors.T, 1)[0]
    ramp = Ramp(0.0, 0.0, 0.0, age_s, turns * math.pi)
    assert ramp.variance_by(HeadingErrors(slow_rad=slow_rad)) == pytest.approx(slopes.var(), rel=0.1)
    assert ramp.variance_by(EXACT) == 0.0


@pytest.mark.parametrize(
    ('sigma', 'errors', 'is_suspected'),
    [
        (1.2, EXACT, False),
        (2.0, EXACT, True),
        (2.0, TRACKS, False),
        (4.0, TRACKS, True),
        (4.0, HeadingErrors(slow_rad=2e-3, are_by_tracks=True), False),
    ],
)
def test_by_tracks_only_a_ramp_that_chance_does_not_explain_counts(
    sigma: float, errors: HeadingErrors, is_suspected: bool
) -> None:
    std = 5e-4
    ramp = Ramp(sigma * std, std**2, sigma, 100.0, 6.0 * math.pi)
    drift = suspected_drift(ramp, errors, DRIFT_STD, 0.0)
    assert (drift > 0.0) == is_suspected
    if is_suspected:
        assert drift == pytest.approx(sigma * std, rel=0.5)


def test_what_went_on_counts_in_any_case() -> None:
    ramp = Ramp(1e-3, 1e-8, 0.0, 1.0, 0.0)
    assert suspected_drift(ramp, TRACKS, DRIFT_STD, 2e-3) == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize(('is_stored', 'expected'), [(False, 1e-3 / 4.0), (True, 0.0)])
def test_slow_errors_count_over_the_turn_that_the_scale_factor_is_from(
    is_stored: bool, expected: float
) -> None:
    """An earlier calibration does not come from these turns."""
    state = initial_state(default_model(), Config(), None, COLUMNS)
    watch = ScaleWatch(state, is_stored=is_stored)
    state = watch.begin(state)
    for _ in range(4):
        watch.add(1.0, (), (), 1.0, HeadingErrors(slow_rad=1e-3, are_by_tracks=True))
    assert watch.suspected_std(state) == pytest.approx(expected)


def test_tracks_without_slow_errors_do_not_err_in_a_turn() -> None:
    noise = TrackNoise(0.1, is_robust=True, is_known=False)
    assert not noise.are_tracked and noise.turn_px == 0.0
    noise.see(np.tile(0.01 * np.eye(2), (5, 1, 1)))
    assert noise.are_tracked and noise.turn_px == 0.0
    alike = np.ones((20, 2))
    for _ in range(40):
        noise._slow.learn(np.arange(20), alike)
    assert noise.slow_variance_px > 1e-5
    assert noise.turn_px == pytest.approx(TURN_PX_BY_SLOW * math.sqrt(noise.slow_variance_px))


def test_what_has_changed_twice_will_change_again() -> None:
    once = to_both_sides(FollowedChanges().with_one(0.01))
    assert once.std == 0.0, 'a gyro may be exchanged'
    twice = to_both_sides(once.after(30.0).with_one(-0.005))
    assert twice.std == pytest.approx(np.hypot(0.01, 0.005) / np.sqrt(2.0))
    stds = [twice.after(duration_s).std for duration_s in (10.0, 40.0, 5.0 * DRIFT_MEMORY_S)]
    assert twice.std > stds[0] > stds[1] > 0.5 * twice.std > 100.0 * stds[2]
    loose = to_both_sides(once.after(3.0).with_one(0.01)).after(DRIFT_MEMORY_S)
    assert loose.std < 0.01 * once.with_one(0.01).std, 'it is over sooner where changes were frequent'


def test_a_change_that_turns_to_one_side_show_may_be_of_that_side_only() -> None:
    changed = FollowedChanges().with_one(-0.026)
    one_side = changed.after(60.0, -20.0)
    assert changed.std == one_side.std == pytest.approx(0.026)
    assert one_side.after(1.0, 0.5 * CONFIRMED_RAD).std == changed.std
    assert one_side.after(1.0, CONFIRMED_RAD).std == 0.0
    assert FollowedChanges().with_one(0.08, is_stored=True).std == 0.0, 'the gyro was never like that'


def to_both_sides(changes: FollowedChanges) -> FollowedChanges:
    """Return the changes after turns to both sides."""
    return changes.after(0.0, CONFIRMED_RAD).after(0.0, -CONFIRMED_RAD)


def test_a_scale_factor_that_goes_with_the_rate_is_not_known_better_than_it_changes() -> None:
    source = recording('cleaning', 1, 90.0, hidden=(HiddenEffect(find_effect('scale_asymmetry'), (0.006,)),))
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    assert np.count_nonzero(run.history.scale_followed) > 1
    error = run.history.mean[:, COEFFICIENTS_START] - (source.truth.scale_factor - 1.0)
    _, inflations = scatter_of(run)
    z = (error / (run.history.std[:, COEFFICIENTS_START] * inflations[:, SCALE]))[run.history.time_s > 60.0]
    assert np.sqrt(np.mean(z**2)) < 2.0
