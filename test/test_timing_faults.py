"""Faults of the time stamps, told from effects that look like them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import drive, turning_rad_s

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, with_effect
from gyrocal_ros.diagnose.analysis.heading_filter import headings
from gyrocal_ros.diagnose.analysis.ranking import rank
from gyrocal_ros.diagnose.analysis.shapes import RATE, ErrorShape, UnexplainedStructure
from gyrocal_ros.diagnose.search.timing import (
    CHANGES_NIS_RATIO,
    JITTERS_NIS_RATIO,
    TURNING_RAD_S,
    TimingFault,
    timing_fault,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S, ScoreStatistics
from gyrocal_ros.ekf.state.layout import YAW

DURATION_S, INFORMATION = 200.0, 1e8
BLOCKS = round(DURATION_S / BLOCK_S)
FAST_RAD_S = math.radians(90.0)
LIKE_AN_OFFSET = 0.99
"""Correlation of lag and offset."""


def examined_with(offsets_s: Array, jitter_s: float, effects: tuple[str, ...]) -> ExaminedModel:
    """Return a model on a recording with an offset in each block and one from image to image.

    Args:
        offsets_s: (B,) offset in each block.
        jitter_s: standard deviation of the offset from image to image.
        effects: candidate effects; all look like an offset.
    """
    made = drive(duration_s=DURATION_S)
    history = made.run.history
    rng = np.random.default_rng(7)
    alike = np.full((len(effects), len(effects)), LIKE_AN_OFFSET)
    np.fill_diagonal(alike, 1.0)
    size = np.linspace(0.5, 1.5, BLOCKS) * INFORMATION
    noise = rng.normal(size=(BLOCKS, 1)) * np.sqrt(size)[:, None]
    score = (size * offsets_s)[:, None] * alike[:, :1].T + noise
    scores = ScoreStatistics(
        tuple(find_effect(name) for name in effects),
        BLOCK_S * np.arange(BLOCKS),
        size[:, None, None] * alike,
        score,
    )
    turning = np.abs(history.turn_rad / history.dt_s) > TURNING_RAD_S
    excess = float(np.sum(size * (offsets_s**2 + jitter_s**2)))
    dof = np.full(len(turning), 20)
    nis = dof + np.where(turning, excess / turning.sum(), 0.0)
    run = replace(made.run, history=replace(history, nis=nis, dof=dof))
    seen = headings(run, DEFAULT_SETTINGS)
    late_rad = jitter_s * rng.normal(size=len(turning)) * history.turn_rad / history.dt_s
    return ExaminedModel(
        model=default_model(),
        run=run,
        scores=scores,
        ranked=tuple(rank(scores, DEFAULT_SETTINGS)),
        disturbed={},
        seen=replace(seen, seen_rad=seen.seen_rad + late_rad),
        unexplained_structure=None,
        settings=DEFAULT_SETTINGS,
    )


BOTH = ('camera_time_offset', 'gyro_lag')
SAWTOOTH_S = 0.08 * (np.arange(BLOCKS) / 4.0 % 1.0)
CONSTANT_S = np.full(BLOCKS, 0.04)


def test_the_synthetic_robot_turns() -> None:
    assert np.mean(np.abs(turning_rad_s(DURATION_S)) > TURNING_RAD_S) > 0.1


def test_a_clock_that_drifts_and_is_set_again_is_a_changing_offset() -> None:
    fault = timing_fault(examined_with(SAWTOOTH_S, 0.0, BOTH))
    assert isinstance(fault, TimingFault) and fault.kind == 'changes'
    assert fault.low_s == pytest.approx(0.0, abs=0.002) and fault.high_s == pytest.approx(0.06, abs=0.002)
    assert '0 to 60 ms' in str(fault).replace('-0', '0')


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_two_clocks_that_run_apart(sign: float) -> None:
    """The line tells it, also where innovations are large everywhere, as of turns without pause."""
    drift_s = sign * 150e-6 * BLOCK_S * np.arange(BLOCKS)
    examined = examined_with(drift_s, 0.0, BOTH)
    history = examined.run.history
    everywhere = replace(history, nis=np.full(len(history.nis), history.nis.mean()))
    for case in (examined, replace(examined, run=replace(examined.run, history=everywhere))):
        fault = timing_fault(case)
        assert fault is not None and fault.kind == 'changes'
        assert fault.drift_ppm == pytest.approx(sign * 150.0, rel=0.02)
        assert (fault.low_s, fault.high_s) == pytest.approx(sorted([0.0, drift_s[-1]]), abs=0.001)
        assert 'their clocks run apart by 150 ppm' in str(fault)


def test_an_offset_that_does_not_grow_steadily_is_no_drift() -> None:
    drift_s = 150e-6 * BLOCK_S * np.arange(BLOCKS)
    for offsets_s in (SAWTOOTH_S, drift_s[::-1] * np.tile([1.0, 0.0], BLOCKS)[:BLOCKS]):
        fault = timing_fault(examined_with(offsets_s, 0.0, BOTH))
        assert fault is not None and fault.drift_ppm == 0.0 and 'ppm' not in str(fault)
    small = timing_fault(examined_with(0.1 * drift_s, 0.0, BOTH))
    assert small is None, 'a change of 3 ms costs little'


@pytest.mark.parametrize(('many', 'is_fault'), [(1, False), (5, True)])
def test_a_single_turn_that_errs_is_no_change_of_the_offset(many: int, is_fault: bool) -> None:
    """Clocks of usual quality run apart by two milliseconds in some minutes, and one turn may err besides."""
    offsets_s = np.linspace(-0.001, 0.001, BLOCKS)
    offsets_s[3 : 3 + many] = 0.007
    assert (timing_fault(examined_with(offsets_s, 0.0, BOTH)) is not None) == is_fault


def test_stamps_that_jitter() -> None:
    fault = timing_fault(examined_with(np.zeros(BLOCKS), 0.02, BOTH))
    assert fault is not None and fault.kind == 'jitters'
    assert fault.std_s == pytest.approx(0.02, rel=0.1) and 'jitter by about 20 ms' in str(fault)


@pytest.mark.parametrize(('factor', 'is_fault'), [(1.2, True), (1.5, False)])
def test_an_offset_that_changes_explains_most_of_the_innovations(factor: float, is_fault: bool) -> None:
    """A camera that is loose in its mount leaves a third of them, or more."""
    examined = examined_with(SAWTOOTH_S, 0.0, BOTH)
    history = examined.run.history
    larger = replace(history, nis=history.dof + factor * (history.nis - history.dof))
    examined = replace(examined, run=replace(examined.run, history=larger))
    assert (timing_fault(examined) is not None) == is_fault


def test_a_small_excess_in_turns_tells_of_a_change() -> None:
    examined = examined_with(0.1 * SAWTOOTH_S, 0.0, BOTH)
    history = examined.run.history
    turning = np.abs(history.turn_rad / history.dt_s) > TURNING_RAD_S
    assert CHANGES_NIS_RATIO < history.nis[turning].sum() / history.dof[turning].sum() < JITTERS_NIS_RATIO
    assert timing_fault(examined) is not None


def test_noise_that_grows_with_the_rate_is_no_jitter() -> None:
    """It is as large in turns, and as white, but it stays in the heading."""
    examined = examined_with(np.zeros(BLOCKS), 0.02, BOTH)
    seen = headings(examined.run, DEFAULT_SETTINGS)
    noise_rad = 0.02 * np.random.default_rng(3).normal(size=len(seen.dt_s)) * seen.turn_rad / seen.dt_s
    noisy = replace(seen, seen_rad=seen.seen_rad + np.cumsum(noise_rad))
    assert timing_fault(replace(examined, seen=noisy)) is None


@pytest.mark.parametrize('offsets_s', [CONSTANT_S, np.zeros(BLOCKS)])
def test_a_constant_offset_or_lag_is_an_effect_and_nothing_is_nothing(offsets_s: Array) -> None:
    assert timing_fault(examined_with(offsets_s, 0.0, BOTH)) is None


def with_offset(jitter_s: float) -> ExaminedModel:
    """Return a model that has the mean offset of stamps that jitter; no candidate is left for it."""
    examined = examined_with(np.zeros(BLOCKS), jitter_s, BOTH[1:])
    history, seen = examined.run.history, examined.seen
    per_second = np.where(np.isfinite(seen.seen_rad), history.turn_rad / history.dt_s / seen.std_rad, 0.0)
    nis = history.dof + (jitter_s * per_second) ** 2
    run = replace(examined.run, history=replace(history, nis=nis))
    return replace(examined, run=run, model=with_effect(default_model(), find_effect('camera_time_offset')))


def test_stamps_that_jitter_about_an_offset() -> None:
    """The stamp of arrival is late by a mean, which is found as an effect, and jitters about that."""
    fault = timing_fault(with_offset(0.02))
    assert fault is not None and fault.kind == 'jitters' and fault.std_s == pytest.approx(0.02, rel=0.1)
    assert timing_fault(with_offset(0.001)) is None


def test_noise_that_grows_with_the_rate_beside_an_offset_is_no_jitter() -> None:
    examined = with_offset(0.02)
    seen = headings(examined.run, DEFAULT_SETTINGS)
    noise_rad = 0.02 * np.random.default_rng(3).normal(size=len(seen.dt_s)) * seen.turn_rad / seen.dt_s
    noisy = replace(seen, seen_rad=seen.seen_rad + np.cumsum(noise_rad))
    assert timing_fault(replace(examined, seen=noisy)) is None


def test_without_an_effect_on_the_time_there_is_no_answer() -> None:
    assert timing_fault(examined_with(SAWTOOTH_S, 0.0, BOTH[1:])) is None


def test_innovations_that_are_large_everywhere_are_no_fault_of_the_stamps() -> None:
    examined = examined_with(SAWTOOTH_S, 0.0, BOTH)
    history = examined.run.history
    everywhere = replace(history, nis=np.full(len(history.nis), history.nis.mean()))
    assert timing_fault(replace(examined, run=replace(examined.run, history=everywhere))) is None


def with_heading(mean: Array, heading_rad: Array) -> Array:
    """Return states (s, n) with other headings (s,)."""
    turned = mean.copy()
    turned[:, YAW] = heading_rad
    return turned


@pytest.mark.parametrize(('drift_deg_s', 'is_fault'), [(0.002, True), (0.2, False)])
def test_an_offset_of_the_stamps_makes_no_heading_drift(drift_deg_s: float, is_fault: bool) -> None:
    examined = examined_with(SAWTOOTH_S, 0.0, BOTH)
    history = examined.run.history
    heading_rad = history.mean[:, YAW] + math.radians(drift_deg_s) * np.cumsum(history.dt_s)
    drifting = replace(history, mean=with_heading(history.mean, heading_rad))
    fault = timing_fault(replace(examined, run=replace(examined.run, history=drifting)))
    assert (fault is not None) == is_fault


@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize('noise_s', [0.0, 0.006])
def test_an_offset_that_follows_the_rate_is_none_of_the_stamps(sign: float, noise_s: float) -> None:
    """A gyro whose slew is limited lags by more in fast turns; that tells it, not the time."""
    level = np.tile([0.3, 1.0, 0.6, 0.8], BLOCKS)[:BLOCKS]
    left_s = noise_s * np.random.default_rng(5).normal(size=BLOCKS)
    examined = examined_with(0.02 * sign * level + left_s, 0.0, BOTH)
    history = examined.run.history
    in_blocks = level[np.minimum(history.time_s // BLOCK_S, BLOCKS - 1).astype(int)]
    turning = np.abs(history.turn_rad / history.dt_s) > TURNING_RAD_S
    turn_rad = np.where(turning, in_blocks * FAST_RAD_S, 0.0) * history.dt_s
    turned = replace(history, turn_rad=turn_rad, mean=with_heading(history.mean, np.cumsum(turn_rad)))
    fault = timing_fault(replace(examined, run=replace(examined.run, history=turned)))
    assert (fault is None) == (noise_s == 0.0), 'with noise the rate explains two thirds'


def test_an_offset_that_jumps_between_turns_of_one_rate_does_not_follow_it() -> None:
    fault = timing_fault(examined_with(0.02 * np.tile([0.0, 1.0], BLOCKS)[:BLOCKS], 0.0, BOTH))
    assert fault is not None and fault.kind == 'changes'


@pytest.mark.parametrize(('part', 'is_fault'), [(0.5, True), (1.5, False)])
def test_a_law_that_the_headings_show_is_no_fault_of_the_stamps(part: float, is_fault: bool) -> None:
    """A ripple of the scale over the rate looked like an offset that jumps; wrong stamps bend no heading."""
    examined = examined_with(SAWTOOTH_S, 0.0, BOTH)
    fault = timing_fault(examined)
    assert fault is not None
    shape = ErrorShape(RATE, False, *np.empty((3, 0)))
    law = UnexplainedStructure('the bias goes with rate (deg/s)', part * fault.gain, 30.0, shape)
    assert (timing_fault(replace(examined, unexplained_structure=law)) is not None) == is_fault
