"""Blind drift: comparison with direct sums, and independence of the frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recordings import recording
from synthetic import drive

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.drift import (
    SEEN_S,
    STRIDE_S,
    BlindDrift,
    better_sigma,
    blind_drift,
    dead_reckoning,
    heading_rms_deg,
    held_out_from_s,
    turns,
)
from gyrocal_ros.diagnose.analysis.paths import Heading, slam_path, truth_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import YAW, YAW_BIAS
from gyrocal_ros.pipeline.calibrate import calibrate


@pytest.fixture(scope='module')
def run() -> Run:
    return calibrate(recording('rest_and_go', camera_hz=10), Config(), default_model())


@pytest.mark.slow
def test_turns_follow_the_coefficients(run: Run) -> None:
    nominal = turns(run, np.zeros(1))
    np.testing.assert_allclose(nominal, run.history.turn_rad + run.history.tilt_rad, atol=1e-12)
    more = turns(run, np.array([0.1])) - nominal
    np.testing.assert_allclose(more, 0.1 * run.history.turn_rad, atol=1e-12)


@pytest.mark.slow
def test_dead_reckoning_is_accurate_with_the_calibrated_gyro_only(run: Run) -> None:
    truth, bias = truth_path(run), float(run.history.mean[-1, YAW_BIAS])
    assert truth is not None

    def errors(coefficients: list[float]) -> tuple[float, float]:
        path = dead_reckoning(run, np.array(coefficients), bias)
        yaw = np.interp(truth.time_s, path.time_s, path.yaw_rad)
        position = [np.interp(truth.time_s[-1], path.time_s, column) for column in path.position_m.T]
        worst = float(np.degrees(np.abs(yaw - truth.yaw_rad).max()))
        return worst, float(np.linalg.norm(position - truth.position_m[-1]))

    heading_deg, position_m = errors([float(run.state.coefficients[0])])
    assert heading_deg < 0.5 and position_m < 0.08
    heading_deg, _ = errors([0.0])
    assert heading_deg > 5.0


@pytest.mark.slow
def test_a_span_counts_only_where_something_tells_the_heading_at_its_end() -> None:
    """In the dark the heading by the filter is that of the gyro, with which it would agree."""
    source = recording('cleaning', 1, 90.0, camera_hz=5, camera_until_s=50.0)
    lit = calibrate(source, Config(), default_model())
    alone, with_truth = blind_drift(replace(lit, truth=None), span_s=20.0), blind_drift(lit, span_s=20.0)
    assert alone.unseen > 0 == with_truth.unseen
    assert alone.start_s.max() + 20.0 <= 50.0 + SEEN_S < with_truth.start_s.max() + 20.0
    assert held_out_from_s(replace(lit, truth=None)) < held_out_from_s(lit)


@pytest.mark.slow
def test_blind_drift_agrees_with_direct_sums(run: Run) -> None:
    history, drift = run.history, blind_drift(run, span_s=20.0)
    assert drift.reference == 'ground truth' and len(drift.start_s) >= 4
    truth = truth_path(run)
    assert truth is not None
    for start_s, error in zip(drift.start_s, drift.error_rad, strict=True):
        first = int(np.searchsorted(history.time_s, start_s))
        last = int(np.searchsorted(history.time_s, start_s + 20.0))
        turned = 0.0
        for step in range(first + 1, last + 1):
            if not history.resting[step]:
                scale = 1.0 + history.coefficients[first, 0]
                turned += scale * history.turn_rad[step] + history.tilt_rad[step]
                turned += history.mean[first, YAW_BIAS] * history.dt_s[step]
        truly = np.diff(np.interp(history.time_s[[first, last]], truth.time_s, truth.yaw_rad))[0]
        assert error == pytest.approx(turned - truly, abs=1e-9)
    settled = blind_drift(run, from_s=20.0, span_s=20.0)
    assert settled.rms_deg <= settled.max_deg < 0.2


def test_the_frame_of_the_truth_does_not_matter(run: Run) -> None:
    assert run.truth is not None
    turn = np.array([[math.cos(2.0), math.sin(2.0)], [-math.sin(2.0), math.cos(2.0)]])
    elsewhere = replace(
        run.truth, position_m=run.truth.position_m @ turn + [5.0, -2.0], yaw_rad=run.truth.yaw_rad + 2.0
    )
    moved, plain = truth_path(replace(run, truth=elsewhere)), truth_path(run)
    assert moved is not None and plain is not None
    np.testing.assert_allclose(moved.position_m, plain.position_m, atol=1e-9)
    np.testing.assert_allclose(moved.yaw_rad, plain.yaw_rad, atol=1e-9)
    slam = slam_path(run)
    nearest = [np.interp(plain.time_s, slam.time_s, column) for column in slam.position_m.T]
    assert np.abs(np.transpose(nearest) - plain.position_m).max() < 0.05


def test_without_truth_the_filter_is_the_reference(run: Run) -> None:
    alone = replace(run, truth=None)
    assert truth_path(alone) is None and heading_rms_deg(alone) is None
    drift = blind_drift(alone, span_s=20.0)
    assert drift.reference == 'slam'
    np.testing.assert_allclose(
        drift.error_rad, blind_drift(run, span_s=20.0).error_rad, atol=math.radians(0.2)
    )


def test_the_reference_can_be_given(run: Run) -> None:
    history = run.history
    wrong = Heading(history.time_s, history.mean[:, YAW] + 0.001 * history.time_s)
    drift = blind_drift(run, (wrong, 'drifting'), span_s=20.0)
    expected = blind_drift(replace(run, truth=None), span_s=20.0).error_rad - 0.001 * 20.0
    assert drift.reference == 'drifting'
    np.testing.assert_allclose(drift.error_rad, expected, atol=2e-4)


def test_a_run_that_is_too_short_has_no_drift(run: Run) -> None:
    drift = blind_drift(run, span_s=80.0)
    assert len(drift.start_s) == 0 and math.isnan(drift.rms_deg) and math.isnan(drift.max_deg)


def random_drift(rng: np.random.Generator, length_s: float, size_deg: float) -> BlindDrift:
    """Return spans of 60 s over a heading that drifts by the white noise of the gyro."""
    steps = int(length_s / STRIDE_S) + 12
    walk = np.cumsum(rng.normal(0.0, math.radians(size_deg) / math.sqrt(12.0), steps + 1))
    error = walk[12:] - walk[:-12]
    return BlindDrift(60.0, STRIDE_S * np.arange(len(error)), error, 'slam')


def test_the_interval_of_the_drift_covers_90_per_cent() -> None:
    rng = np.random.default_rng(1)
    drifts = [random_drift(rng, 240.0, 0.5) for _ in range(1000)]
    inside = np.mean([low < 0.5 < high for low, high in (drift.interval_deg for drift in drifts)])
    assert drifts[0].independent == pytest.approx(240.0 / 40.0, rel=0.2)
    assert 0.86 < inside < 0.94
    short = random_drift(rng, 10.0, 0.5)
    assert 1.0 < short.independent < 2.0 and short.interval_deg[1] == math.inf
    assert short.interval_deg[0] < short.rms_deg


def test_the_significance_of_a_smaller_drift() -> None:
    rng = np.random.default_rng(2)
    pairs = [[random_drift(rng, 120.0, 0.5) for _ in range(2)] for _ in range(500)]
    sigmas = np.array([better_sigma(*pair) for pair in pairs])
    assert np.mean(np.abs(sigmas) > 2.0) < 0.08 and abs(sigmas.mean()) < 0.15
    much = replace(pairs[0][0], error_rad=20.0 * pairs[0][0].error_rad)
    assert better_sigma(much, pairs[0][0]) == -better_sigma(pairs[0][0], much) > 3.0
    none = replace(much, start_s=np.empty(0), error_rad=np.empty(0))
    assert math.isnan(better_sigma(none, much)) and math.isnan(none.interval_deg[0])


def test_the_final_coefficients_fit_best(run: Run) -> None:
    final = run.history.coefficients[-1]
    held_out, fitted = (
        blind_drift(run, from_s=3.0, span_s=20.0, coefficients=known) for known in (None, final)
    )
    np.testing.assert_array_equal(held_out.start_s, fitted.start_s)
    assert fitted.rms_deg < held_out.rms_deg
    known = replace(run.history, mean=run.history.mean.copy())
    known.mean[:, YAW_BIAS + 1 :] = known.mean[-1, YAW_BIAS + 1 :]
    np.testing.assert_array_equal(
        blind_drift(replace(run, history=known), from_s=3.0, span_s=20.0).error_rad,
        blind_drift(replace(run, history=known), from_s=3.0, span_s=20.0, coefficients=final).error_rad,
    )


def test_with_other_coefficients_the_bias_is_another_one() -> None:
    """What a curve gives at rest was part of the bias as long as the curve was not known."""
    run = drive(duration_s=200.0, gyro_noise=0.0).run
    history = run.history
    learned = np.minimum(history.time_s / 100.0, 1.0) * math.radians(0.5)
    mean = np.column_stack([history.mean, learned])
    mean[:, YAW_BIAS] -= learned
    columns = np.column_stack([history.columns, history.gyro_valid_s])
    resting = (history.wheel_turn_rad == 0.0).astype(float)
    turn_rad = history.turn_rad + learned * history.gyro_valid_s
    changed = replace(history, mean=mean, columns=columns, resting=resting, turn_rad=turn_rad)
    wider = replace(run, history=changed)
    held_out, fitted = (
        blind_drift(wider, from_s=10.0, coefficients=known) for known in (None, mean[-1, YAW_BIAS + 1 :])
    )
    assert held_out.rms_deg < 0.1 and len(held_out.error_rad) > 10
    np.testing.assert_allclose(fitted.error_rad, held_out.error_rad, atol=math.radians(0.1))


def test_no_span_is_held_out_before_a_change_that_was_followed(run: Run) -> None:
    history = run.history
    followed = np.zeros(len(history.time_s))
    assert held_out_from_s(run) < history.time_s[-1] - 5.0
    followed[-20] = 1.0
    changed = replace(run, history=replace(history, scale_followed=followed))
    assert held_out_from_s(changed) == history.time_s[-20]


def test_held_out_spans_are_in_the_second_half_or_at_the_end(run: Run) -> None:
    def from_s(end_s: float) -> float:
        stretched = run.history.time_s * end_s / run.history.time_s[-1]
        return held_out_from_s(replace(run, history=replace(run.history, time_s=stretched)))

    assert from_s(300.0) == pytest.approx(150.0)
    assert from_s(100.0) == pytest.approx(25.0)
    assert from_s(60.0) == 10.0
