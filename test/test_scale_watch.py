"""A scale factor that changes: a stored calibration that is wrong, a drift, a jump."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ImuSample, Measurement, Source, seconds
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, State
from gyrocal_ros.ekf.state.start import Start, initial_state
from gyrocal_ros.ekf.watches.drift_suspicion import (
    CHANCE_SIGMA,
    DRIFT_STD,
    RAMP_S,
    USUAL_DRIFT_STD,
    HeadingErrors,
)
from gyrocal_ros.ekf.watches.scale_watch import (
    CHANGE_SIGMA,
    COLUMNS,
    LARGEST_WALK,
    NOT_LINEAR,
    NOTICED_S,
    RAMP,
    SCALE_CHANGED,
    SETTLE_S,
    TURNING_RAD_S,
    WINDOWS_S,
    ScaleWatch,
)
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import START_NS

STORED_STD = 4e-5
"""Standard deviation of a calibration after five minutes."""


def with_gain(source: Source, gain: Callable[[float], float]) -> ModifiedSource:
    """Multiply the readings of the yaw rate by a function of time."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for item in measurements:
            if isinstance(item, ImuSample):
                x, y, z = item.rate_rad_s
                yield replace(item, rate_rad_s=(x, y, z * gain(seconds(item.t_ns - START_NS))))
            else:
                yield item

    return ModifiedSource(source, change)


def is_right(found: Calibration, true: float) -> bool:
    """Return True for a result that is within 3 sigma, or does not claim to be one."""
    return not found.converged or abs(found.scale_factor - true) < 3.0 * found.scale_factor_std


@pytest.mark.parametrize('wrong_by', [-0.25, -0.05, -0.002, 0.0005, 0.01, 0.25])
def test_a_wrong_stored_calibration_is_dropped(wrong_by: float) -> None:
    """Within 30 s, which is two turns each way."""
    source = recording('cleaning', 3, 30.0)
    true = source.truth.scale_factor
    start = Start(('scale_factor',), np.array([true - 1.0 + wrong_by]), np.array([[STORED_STD**2]]), START_NS)
    run = calibrate(source, Config(), default_model(), start, follows_changes=True)
    found = conclude(run)
    assert abs(found.scale_factor - true) < 3.0 * found.scale_factor_std
    assert found.scale_factor_std < 5e-4
    if abs(wrong_by) > 0.001:
        assert run.history.scale_followed.sum() == 1
        assert any('off what was calibrated before' in event.text for event in run.events)


@pytest.mark.slow
def test_all_coefficients_of_a_stored_calibration_are_dropped_together() -> None:
    """One of another gyro knows nothing of any of them."""
    source, default = recording('cleaning', 3, 60.0), default_model()
    model = replace(default, effects=(*default.effects, find_effect('scale_cubic')))
    true, cubic, std = source.truth.scale_factor, 0.02, 1e-4
    names, covariance = ('scale_factor', 'scale_cubic'), std**2 * np.eye(2)
    start = Start(names, np.array([true - 1.0 + 0.05, cubic]), covariance, START_NS)
    state = calibrate(source, Config(), model, start, follows_changes=True).state
    places = slice(COEFFICIENTS_START, COEFFICIENTS_START + 2)
    errors, stds = state.mean[places] - [true - 1.0, 0.0], np.sqrt(state.covariance.diagonal()[places])
    assert (np.abs(errors) < 3.0 * stds).all() and stds[1] > std


@pytest.mark.slow
@pytest.mark.parametrize('wrong_by', [-0.01, 0.01])
def test_a_change_is_not_followed_within_a_turn(wrong_by: float) -> None:
    """The change is significant for long enough as the second turn begins. Followed then, it was doubled."""
    source = recording('cleaning', 1, 60.0)
    true = source.truth.scale_factor
    start = Start(('scale_factor',), np.array([true - 1.0 + wrong_by]), np.array([[STORED_STD**2]]), START_NS)
    history = calibrate(source, Config(), default_model(), start, follows_changes=True).history
    (step,) = np.flatnonzero(history.scale_followed)
    assert abs(history.turn_rad[step]) < TURNING_RAD_S * history.dt_s[step]
    assert np.abs(history.turn_rad / history.dt_s)[step - 8 : step].max() > 10.0 * TURNING_RAD_S, 'it waits'
    error, std = 1.0 + history.mean[-1, COEFFICIENTS_START] - true, history.std[-1, COEFFICIENTS_START]
    assert abs(error) < 3.0 * std and std < 1e-4


def test_a_right_stored_calibration_is_kept() -> None:
    source = recording('cleaning', 3, 30.0)
    true = source.truth.scale_factor
    start = Start(('scale_factor',), np.array([true - 1.0]), np.array([[STORED_STD**2]]), START_NS)
    run = calibrate(source, Config(), default_model(), start, follows_changes=True)
    assert not run.history.scale_followed.any() and conclude(run).converged


@pytest.mark.parametrize('seed', [0, 14])
def test_images_at_rest_are_no_change_of_the_scale_factor(seed: int) -> None:
    """The position is kept there, so all images of a rest err alike; each counted as if it erred alone."""
    errors = replace(find_scenario('rest_and_go').errors, pixel_noise_px=0.3, scale_factor=1.03)
    robot = {'camera_hz': 15, 'features': 8, 'floor_tilt_deg': 0.4, 'errors': errors}
    source = recording('rest_and_go', seed, 120.0, **robot)
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    assert not run.history.scale_followed.any()
    assert is_right(conclude(run), 1.03) and conclude(run).converged


@pytest.mark.slow
@pytest.mark.parametrize('follows', [True, False])
@pytest.mark.parametrize(
    'gain',
    [lambda s: 1.05 if s > 40.0 else 1.0, lambda s: 1.0 + 1e-4 * s, lambda s: 1.0 + 1e-5 * s],
    ids=['jump', 'drift', 'slow drift'],
)
def test_a_scale_factor_that_changes_is_followed_or_reported(
    gain: Callable[[float], float], follows: bool
) -> None:
    source = recording('lanes', 5, 80.0)
    changed = with_gain(source, gain)
    run = calibrate(changed, Config(), default_model(), follows_changes=follows)
    found, true = conclude(run), source.truth.scale_factor / gain(80.0)
    assert is_right(found, true)
    if gain(80.0) > 1.005:
        assert run.history.scale_followed.any() == follows
        assert (run.history.scale_change[-1] != 0.0) == (not follows)
    if gain(80.0) == 1.05 and follows:
        assert found.converged


@pytest.mark.slow
def test_a_jump_within_a_turn_is_followed() -> None:
    """The shortest window ends before the change has settled, and the others have seen turns before it."""
    source = recording('cleaning', 0, 60.0)
    changed = with_gain(source, lambda s: 1.05 if s > 30.0 else 1.0)
    found = conclude(calibrate(changed, Config(), default_model(), follows_changes=True))
    true = source.truth.scale_factor / 1.05
    assert abs(found.scale_factor - true) < 3.0 * found.scale_factor_std
    assert found.scale_factor == pytest.approx(true, rel=3e-3)


@pytest.mark.slow
def test_a_drift_goes_on_after_it_was_followed() -> None:
    source = recording('lanes', 0, 60.0)
    changed = with_gain(source, lambda s: 1.0 / (1.0 + 5e-5 * s))
    run = calibrate(changed, Config(), default_model(), follows_changes=True)
    assert run.history.scale_followed.any()
    assert is_right(conclude(run), 1.003 * source.truth.scale_factor)


def some_watch(*, is_stored: bool = False) -> tuple[ScaleWatch, State]:
    state = initial_state(default_model(), Config(), None, COLUMNS)
    watch = ScaleWatch(state, is_stored=is_stored)
    return watch, watch.begin(state)


def stats(information: float, change: float, nis: float = 0.0, dof: int = 1) -> UpdateStats:
    """Make an update that all windows see alike."""
    each = np.full(COLUMNS, information)
    explained = information * change**2
    return UpdateStats(explained + nis, dof, information=np.diag(each), score=each * change)


def test_a_change_is_significant_by_its_standard_deviation() -> None:
    watch, _ = some_watch()
    assert watch.add(1.0, (stats(1e6, 0.99e-3 * CHANGE_SIGMA),)) is None
    watch, _ = some_watch()
    found = watch.add(1.0, (stats(1e6, 1.01e-3 * CHANGE_SIGMA),))
    assert found is not None
    assert found.value == pytest.approx(1.01e-3 * CHANGE_SIGMA)
    assert found.std == pytest.approx(1e-3)


@pytest.mark.parametrize(('turned_rad', 'is_change'), [(0.1, False), (1.0, True)])
def test_an_error_that_headings_have_in_common_is_no_change(turned_rad: float, is_change: bool) -> None:
    """Its standard deviation, over the turn, is one of the change besides that by the innovations."""
    watch, _ = some_watch()
    change, repeated_rad = 0.005, 2e-4
    found = watch.add(1.0, (stats(1e6, change),), (), turned_rad, HeadingErrors(repeated_rad))
    assert (found is not None) == is_change
    if found is not None:
        assert found.std == pytest.approx(math.hypot(1e-3, repeated_rad / turned_rad))
        assert found.sigma == pytest.approx(change / found.std)


def test_a_change_counts_once_it_has_been_significant_for_some_images() -> None:
    watch, _ = some_watch()
    first, others = (stats(1e6, 0.02),), (stats(1.0, 0.02),)
    assert watch.add(0.6 * NOTICED_S, first) is None
    assert watch.add(0.6 * NOTICED_S, others) is not None
    watch, _ = some_watch()
    assert watch.add(0.6 * NOTICED_S, first) is None
    assert watch.add(0.6 * NOTICED_S, (stats(1e6, -0.02),)) is None, 'the next image contradicts it'
    assert watch.add(0.6 * NOTICED_S, first) is None


@pytest.mark.parametrize('updates', [(), (UpdateStats(0.0, 3), UpdateStats())])
def test_a_change_is_not_followed_in_the_dark(updates: tuple[UpdateStats, ...]) -> None:
    """Nor where the robot only rests there."""
    watch, state = some_watch()
    assert watch.add(1.0, (stats(1e6, 0.02),)) is not None
    assert watch.add(60.0, updates) is not None
    assert not watch.is_settled
    state = watch.renew(state, 60.0)
    assert watch.add(SETTLE_S, (stats(1e6, 0.02),)) is not None, 'its window lasts'
    assert watch.is_settled


def test_innovations_that_no_change_explains_are_noise() -> None:
    watch, _ = some_watch()
    assert watch.add(1.0, (stats(1e6, 5e-3 * CHANGE_SIGMA, nis=100.0, dof=1),)) is None


@pytest.mark.parametrize(('change', 'cause'), [(0.02, 'another gyro'), (-0.4, 'stamps may be wrong')])
def test_the_event_names_causes_that_are_possible(change: float, cause: str) -> None:
    watch, _ = some_watch()
    text = str(watch.add(1.0, (stats(1e6, change),)))
    assert cause in text and SCALE_CHANGED in text and 'gyrocal diagnose' in text


def test_the_state_follows_as_if_the_scale_factor_had_been_unknown() -> None:
    """At once, this is the update of an unknown number by its measurement, which is linear in part."""
    watch, state = some_watch()
    found = watch.add(1.0, (stats(1e6, 0.02),))
    assert found is not None
    after = watch.follow(state, found)
    scale, before = COEFFICIENTS_START, state.covariance[COEFFICIENTS_START, COEFFICIENTS_START]
    assert after.mean[scale] == pytest.approx(state.mean[scale] + 0.02)
    assert after.covariance[scale, scale] == pytest.approx(before + 1e-6 + (NOT_LINEAR * 0.02) ** 2)
    assert watch.add(1.0, ()) is None, 'all windows start again'


def test_only_repeated_changes_are_a_drift() -> None:
    watch, state = some_watch()
    gyro = Config().gyro
    for change, expected in ((0.002, gyro.scale_walk), (0.002, 0.002 / np.sqrt(10.0)), (0.1, LARGEST_WALK)):
        found = watch.add(10.0, (stats(1e8, change),))
        assert found is not None
        state = watch.follow(state, replace(found, was_calibrated=True))
        assert watch.walk(gyro).scale_walk == pytest.approx(expected)


def test_a_first_estimate_that_was_wrong_is_no_drift() -> None:
    watch, state = some_watch()
    gyro = Config().gyro
    for change in (0.002, 0.002):
        found = watch.add(10.0, (stats(1e8, change),))
        assert found is not None and not found.was_calibrated
        state = watch.follow(state, found)
        assert watch.walk(gyro).scale_walk == gyro.scale_walk


@pytest.mark.slow
def test_a_loose_contact_does_not_leave_the_scale_factor_unknown() -> None:
    source = recording('lanes', 1, 200.0)
    changed = with_gain(source, lambda s: 0.9 if 30.0 < s < 33.0 or 45.0 < s < 53.0 else 1.0)
    found = conclude(calibrate(changed, Config(), default_model(), follows_changes=True))
    assert is_right(found, source.truth.scale_factor)
    assert found.scale_factor_std < 2e-3


def test_a_window_begins_again_when_it_has_ended() -> None:
    watch, state = some_watch()
    for _ in range(4):
        watch.add(1.0, (stats(1.0, 0.0),))
        state = watch.renew(replace(state, sensitivity=0.9 * state.sensitivity), 1.0)
    steps = state.sensitivity[COEFFICIENTS_START, :RAMP]
    np.testing.assert_allclose(steps, [0.9, *[0.9**4] * (len(WINDOWS_S) - 1)])


def test_a_window_begins_again_when_the_filter_has_absorbed_the_change() -> None:
    watch, state = some_watch()
    watch.add(0.1, (stats(1.0, 0.0),))
    state = watch.renew(replace(state, sensitivity=0.19 * state.sensitivity), 0.1)
    np.testing.assert_array_equal(state.sensitivity[COEFFICIENTS_START, :RAMP], 1.0)


def test_the_ramp_grows_at_a_constant_rate() -> None:
    watch, state = some_watch()
    for _ in range(3):
        watch.add(0.1 * RAMP_S, (stats(1.0, 0.0),))
        state = watch.renew(state, 0.1 * RAMP_S)
    assert state.sensitivity[COEFFICIENTS_START, RAMP] == pytest.approx(0.3)


def suspected_std(ramp: float, std: float, chance_drift_std: float = DRIFT_STD) -> float:
    """Return what a ramp adds at its end, where the filter has corrected nothing of it."""
    state = initial_state(default_model(), Config(), None, COLUMNS)
    watch = ScaleWatch(state, chance_drift_std=chance_drift_std)
    state = watch.begin(state)
    watch.add(RAMP_S - 2.0, ())
    state = watch.renew(state, RAMP_S)
    alone = np.zeros(COLUMNS)
    alone[RAMP] = std**-2.0
    watch.add(1.0, (UpdateStats((ramp / std) ** 2, 1, information=np.diag(alone), score=alone * ramp),))
    return watch.suspected_std(state)


def test_a_drift_that_is_not_sure_adds_what_the_ramp_shows_beyond_noise() -> None:
    std = 1e-4
    assert suspected_std(1.4 * std, std) == 0.0
    assert suspected_std(-4.0 * std, std) == pytest.approx(
        std * np.sqrt((4.0 * 14.0 / 15.0) ** 2 + 14.0 / 15.0)
    )
    ramps = std * np.random.default_rng(3).normal(size=2000)
    assert np.median([suspected_std(ramp, std) for ramp in ramps]) == 0.0, 'most clean recordings pay nothing'
    assert np.mean([suspected_std(ramp, std) ** 2 for ramp in ramps]) < 0.6 * std**2
    drifting = [suspected_std(2.0 * std + ramp, std) ** 2 for ramp in ramps]
    assert np.mean(drifting) == pytest.approx(4.0 * std**2, rel=0.2)


def test_a_ramp_that_is_hardly_known_adds_no_more_than_a_gyro_drifts() -> None:
    assert suspected_std(0.04, 0.01) <= 2.0 * DRIFT_STD
    assert suspected_std(0.04, 0.001) == pytest.approx(0.04, rel=0.05), 'a sure one adds all of it'


def test_a_ramp_by_chance_beside_a_heading_reference_adds_what_a_usual_gyro_drifts() -> None:
    """Of a hundred lidars fifteen have such a ramp."""
    usual, by_camera = suspected_std(0.0082, 0.0045, USUAL_DRIFT_STD), suspected_std(0.0082, 0.0045)
    assert usual < 1.2 * USUAL_DRIFT_STD < 0.25 * by_camera
    significant = 0.0045 * 1.01 * CHANCE_SIGMA
    assert suspected_std(significant, 0.0045, USUAL_DRIFT_STD) == suspected_std(significant, 0.0045)


@pytest.mark.parametrize('is_ramp', [False, True])
def test_a_change_that_a_ramp_explains_may_go_on(is_ramp: bool) -> None:
    """At the rate of the ramp, until turns show a constant scale factor."""
    watch, state = some_watch(is_stored=True)
    ramp, information, step = 0.015, np.full(COLUMNS, 1e7), np.full(COLUMNS, 0.002)
    step[RAMP], information[RAMP] = ramp, 1e7 * (0.002 / ramp) ** 2 * (0.9 if is_ramp else 0.1)
    update = UpdateStats(100.0, 100, information=np.diag(information), score=information * step)
    found = watch.add(40.0, (update,))
    assert found is not None
    state = watch.follow(state, replace(found, was_calibrated=True))
    watch.add(5.0, ())
    state = watch.renew(state, 5.0)
    assert watch.suspected_std(state) == pytest.approx(ramp * 5.0 / RAMP_S if is_ramp else 0.0)
    watch.add(5.0, (stats(1e8, 0.0),))
    assert watch.suspected_std(state) <= 1e-4 * 5.0 / RAMP_S


def test_no_window_ends_while_a_change_settles() -> None:
    """One that began within the change would show a part of it only."""
    watch, state = some_watch()
    for moment in range(8):
        turns = moment >= 4
        found = watch.add(0.5, (stats(1e6, 0.02),) if turns else ())
        assert (found is not None) == turns
        state = watch.renew(replace(state, sensitivity=0.9 * state.sensitivity), 0.5)
    np.testing.assert_allclose(state.sensitivity[COEFFICIENTS_START, :RAMP], 0.9**8)


def test_candidates_keep_their_statistics() -> None:
    whole = UpdateStats(1.0, 2, information=np.diag(np.arange(1.0, 5.0)), score=np.arange(4.0))
    kept = whole.of_first(2)
    assert kept.information is not None and kept.score is not None
    assert np.diagonal(kept.information).tolist() == [1.0, 2.0] and kept.score.tolist() == [0.0, 1.0]
    assert whole.of_first(0).information is None


KNOWN_STD = 5e-4


def told_after(std: float, known_s: float, *, is_stored: bool = False) -> bool:
    """Return whether a change was calibrated before it, by the std of the scale factor until then."""
    state = initial_state(default_model(), Config(), None, COLUMNS)
    watch = ScaleWatch(state, known_std=KNOWN_STD, is_stored=is_stored)
    state = watch.begin(state)
    covariance = state.covariance.copy()
    covariance[COEFFICIENTS_START, COEFFICIENTS_START] = std**2
    state = replace(state, covariance=covariance)
    for _ in range(10):
        watch.add(0.1 * known_s, ())
        state = watch.renew(state, 0.1 * known_s)
    state = watch.begin(state)
    change = watch.add(1.0, (stats(1e6, 0.02),))
    assert change is not None
    return change.was_calibrated


def test_a_change_is_news_where_the_scale_factor_was_known() -> None:
    """In a first turn it was not: its early images may contradict the late ones."""
    assert told_after(0.9 * KNOWN_STD, 1.1 * SETTLE_S)
    assert not told_after(1.1 * KNOWN_STD, 10.0 * SETTLE_S)
    assert not told_after(0.9 * KNOWN_STD, 0.9 * SETTLE_S)
    assert told_after(1.1 * KNOWN_STD, 1.0, is_stored=True)


def test_a_stored_calibration_that_was_dropped_is_none() -> None:
    state = initial_state(default_model(), Config(), None, COLUMNS)
    watch = ScaleWatch(state, known_std=KNOWN_STD, is_stored=True)
    state = watch.begin(state)
    first = watch.add(SETTLE_S, (stats(1e6, 0.02),))
    assert first is not None and first.was_calibrated
    watch.follow(state, first)
    again = watch.add(1.0, (stats(1e6, 0.02),))
    assert again is not None and not again.was_calibrated


def test_what_a_first_turn_contradicts_is_followed_and_not_told() -> None:
    """The readings of the first part of the first turn are 2 % too large."""
    source = recording('cleaning', 3, 30.0)
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    turned = np.cumsum(np.abs(run.history.turn_rad))
    middle_s = float(run.history.time_s[np.searchsorted(turned, 0.3)])
    first_part = with_gain(source, lambda s: 1.02 if s < middle_s else 1.0)
    run = calibrate(first_part, Config(), default_model(), follows_changes=True)
    assert run.history.scale_followed.any()
    assert not any(SCALE_CHANGED in event.text for event in run.events)
