"""Updates by another heading reference."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block
from filter_states import CANDIDATES, EFFECTS, some_state
from scipy.stats import t as student_t

from gyrocal_ros.config.sections import GyroConfig, ReferenceConfig
from gyrocal_ros.data import HeadingSample, nanoseconds
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.heading import HeadingReference
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, heading_innovation, heading_update
from gyrocal_ros.ekf.noise.reference_noise import JUMP_HEADINGS, JUMP_S, JumpDetector, JumpsWithTurns
from gyrocal_ros.ekf.state.layout import YAW, State

CONFIG = replace(ReferenceConfig(), heading_noise_deg=0.5, heading_walk_deg=0.1, tail_dof=4.0)
STD = math.radians(0.5)
MODEL_EFFECTS = sort_effects(EFFECTS)
OTHERS = sort_effects(CANDIDATES)
POSE_RATE = np.array([0.2, 0.1, 0.0, 0.01, -0.02, 1.3])
OFFSET_RAD = 1.7


def updated(reference: HeadingReference, state: State, error_rad: float) -> tuple[State, MeasurementUpdate]:
    """Give a heading in the frame of the reference that differs by `error_rad` from the state."""
    sample = HeadingSample(state.t_ns, float(state.mean[YAW]) + OFFSET_RAD + error_rad)
    return reference.update(state, sample, MODEL_EFFECTS, OTHERS, POSE_RATE)


def at(state: State, late_s: float) -> State:
    """Return the state at a later time."""
    return replace(state, t_ns=state.t_ns + nanoseconds(late_s))


def aligned() -> HeadingReference:
    reference = HeadingReference(CONFIG, GyroConfig())
    updated(reference, some_state(), 0.0)
    return reference


def test_the_first_sample_aligns_the_frames() -> None:
    reference, state = HeadingReference(CONFIG, GyroConfig()), some_state()
    after, update = updated(reference, state, 0.0)
    np.testing.assert_array_equal(after.mean, state.mean)
    others = np.arange(len(state.mean)) != YAW
    assert after.covariance[YAW, YAW] == pytest.approx(STD**2)
    assert not after.covariance[YAW, others].any() and not after.covariance[others, YAW].any()
    np.testing.assert_array_equal(
        after.covariance[np.ix_(others, others)], state.covariance[np.ix_(others, others)]
    )
    assert not after.sensitivity[YAW].any()
    assert update.stats.dof == 0


def test_the_random_walk_acts_from_the_first_sample_on() -> None:
    state = some_state()
    before, after = (
        reference.wander(state, 4.0) for reference in (HeadingReference(CONFIG, GyroConfig()), aligned())
    )
    np.testing.assert_array_equal(before.covariance, state.covariance)
    grown = after.covariance - state.covariance
    assert grown[YAW, YAW] == pytest.approx(4.0 * math.radians(0.1) ** 2)
    assert np.count_nonzero(grown) == 1


def test_later_samples_correct_the_heading() -> None:
    """The time offset of the model changes the expected heading by minus the yaw rate."""
    reference, state = aligned(), some_state()
    by_values = np.zeros(MODEL_EFFECTS.count)
    by_values[-1] = -POSE_RATE[YAW]
    yaw_rad = float(state.mean[YAW]) + 0.002
    expected, stats, residual = heading_update(state, yaw_rad, STD, by_values, np.zeros(OTHERS.count))
    after, update = updated(reference, state, 0.002)
    np.testing.assert_allclose(after.mean, expected.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(after.covariance, expected.covariance, rtol=1e-9, atol=1e-15)
    assert update.heading_rad == pytest.approx(residual) == pytest.approx(0.002)
    assert update.heading_std_rad == pytest.approx(STD)
    assert update.rejected == 0 and not update.event
    assert update.stats.nis == pytest.approx(stats.nis) and update.stats.dof == 1


def test_a_time_offset_among_the_candidates_has_a_sensitivity() -> None:
    late = sort_effects((find_effect('camera_time_offset'),))
    state = replace(some_state(), sensitivity=np.zeros((len(some_state().mean), 1)))
    reference, none = aligned(), sort_effects(())
    sample = HeadingSample(state.t_ns, float(state.mean[YAW]) + OFFSET_RAD + 0.002)
    effects = replace(MODEL_EFFECTS, time=none.time)
    _, update = reference.update(state, sample, effects, late, POSE_RATE)
    assert update.stats.information is not None and update.stats.score is not None
    variance = heading_innovation(state, 0.0, np.zeros(MODEL_EFFECTS.count))[1] + STD**2
    np.testing.assert_allclose(update.stats.information, [[POSE_RATE[YAW] ** 2 / variance]])
    np.testing.assert_allclose(update.stats.score, [-POSE_RATE[YAW] * update.heading_rad / variance])


def test_after_a_lost_alignment_the_next_sample_aligns() -> None:
    reference, state = aligned(), some_state()
    reference.forget_alignment()
    assert reference.wander(state, 4.0) is state
    after, update = updated(reference, state, 0.8)
    np.testing.assert_array_equal(after.mean, state.mean)
    assert update.stats.dof == 0
    assert updated(reference, state, 0.8)[1].heading_rad == pytest.approx(0.0, abs=1e-12)


def certain() -> State:
    return replace(some_state(), covariance=1e-12 * np.eye(len(some_state().mean)))


def test_an_outlier_counts_little() -> None:
    """Its weight is that of a Student t variable with 4 degrees of freedom that tells as much."""
    reference, state, error_rad = aligned(), certain(), 20.0 * STD
    after, update = updated(reference, state, error_rad)
    assert update.rejected == 1 and not update.event
    assert update.heading_std_rad**2 == pytest.approx(STD**2 * (4.0 + 1.4 * 400.0) / 7.0, rel=1e-6)
    moved, bound = after.mean[YAW] - state.mean[YAW], 1e-12 * error_rad / STD**2
    assert 0.0 < moved < 0.02 * bound


def test_outliers_to_both_sides_are_no_jump() -> None:
    reference, state = aligned(), certain()
    for side in (1.0, -1.0) * JUMP_HEADINGS:
        after, update = updated(reference, state, side * 20.0 * STD)
        assert update.rejected == 1 and abs(after.mean[YAW] - state.mean[YAW]) < 1e-6


def test_after_a_jump_the_reference_is_aligned_again() -> None:
    reference, state, jump_rad = aligned(), certain(), 20.0 * STD
    for late_s in np.arange(0.0, JUMP_S, 0.1).tolist():
        assert updated(reference, at(state, late_s), jump_rad + 1e-6 * late_s)[1].rejected == 1
    state = at(state, JUMP_S + 0.1)
    after, update = updated(reference, state, jump_rad)
    assert 'jumped by +10.0 deg' in update.event and update.rejected == 0
    np.testing.assert_array_equal(after.mean, state.mean)
    assert updated(reference, after, jump_rad + 1e-9)[1].heading_rad == pytest.approx(1e-9, abs=1e-12)


def test_while_the_reference_may_have_jumped_its_headings_are_not_used() -> None:
    """One that smooths lies apart while a turn begins or ends, and comes back: that is no jump."""
    reference, state, apart_rad = aligned(), certain(), 20.0 * STD
    for k in range(JUMP_HEADINGS + 3):
        after, update = updated(reference, at(state, 0.1 * k), apart_rad + 1e-6 * k)
        assert update.rejected == 1
        assert (after.mean[YAW] == state.mean[YAW]) == (k >= JUMP_HEADINGS - 1)
    update = updated(reference, at(state, 1.5), 0.5 * STD)[1]
    assert not update.event and update.rejected == 0 and update.stats.dof == 1


def test_a_repetition_is_no_measurement() -> None:
    reference, state = aligned(), some_state()
    sample = HeadingSample(state.t_ns, float(state.mean[YAW]) + OFFSET_RAD + 0.1 * STD)
    used, repeated = (reference.update(state, sample, MODEL_EFFECTS, OTHERS, POSE_RATE)[1] for _ in range(2))
    assert used.stats.dof == 1 and repeated.stats.dof == 0


def jumps_in(turn_deg_s: float, jumps_deg: list[float]) -> JumpsWithTurns:
    """Turn to and fro; the reference jumps in each turn."""
    found, block = JumpsWithTurns(), eventful_block()
    for number, jump_deg in enumerate(jumps_deg):
        rates = np.zeros_like(block.rate_rad_s)
        rates[:, 2] = math.radians(turn_deg_s) * (-1.0) ** number
        for _ in range(100):
            found.move(replace(block, rate_rad_s=rates))
        found.add(math.radians(jump_deg))
    return found


def test_jumps_that_go_with_the_turns_are_an_error_of_the_scale_factor() -> None:
    turned_deg = 8 * 100 * 30.0 * eventful_block().duration_s
    smooth = jumps_in(30.0, [2.0, -2.0] * 4)
    assert smooth.scale_error == pytest.approx(16.0 / turned_deg, rel=1e-2)
    assert jumps_in(30.0, [2.0, -2.0]).scale_error == 0.0
    assert jumps_in(30.0, [2.0, 3.0, -1.0, -2.0, 5.0, 2.0, -4.0, -1.0]).scale_error == 0.0


def test_the_log_likelihood_is_that_of_a_student_t_variable() -> None:
    _, update = updated(aligned(), certain(), 3.0 * STD)
    scale = STD / math.sqrt(7.0 / 5.0)  # of the one that tells as much as normal noise with STD
    expected = float(student_t.logpdf(3.0 * STD, df=4.0, scale=scale))
    assert update.stats.log_likelihood == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize('sigma', [6.0, -6.0, 8.0])
def test_a_jump_of_a_few_sigma_is_noticed_through_the_noise(sigma: float) -> None:
    """Some of its headings are no outliers; they stay on its side."""
    deviations = sigma + np.random.default_rng(1).normal(size=30)
    deviations[0] = sigma
    detector = JumpDetector()
    assert any(detector.update(np.array([value]), 0.1)[1][0] for value in deviations[:13])


def test_noise_and_outliers_are_no_jumps() -> None:
    rng, detector = np.random.default_rng(2), JumpDetector()
    wide = np.where(rng.random(20_000) < 0.1, 6.0, 1.0) * rng.normal(size=20_000)
    assert not any(detector.update(np.array([value]), 0.1)[1][0] for value in wide)
