"""Updates by another heading reference."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_states import CANDIDATES, EFFECTS, some_state

from gyrocal_ros.config.sections import ReferenceConfig
from gyrocal_ros.data import HeadingSample
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.effects_by_place import sort_effects
from gyrocal_ros.ekf.heading import HeadingReference
from gyrocal_ros.ekf.state import YAW, State
from gyrocal_ros.ekf.update import MeasurementUpdate, heading_update

CONFIG = replace(ReferenceConfig(), heading_noise_deg=0.5, heading_walk_deg=0.1)
STD = math.radians(0.5)
MODEL_EFFECTS = sort_effects(EFFECTS)
OTHERS = sort_effects(CANDIDATES)
POSE_RATE = np.array([0.2, 0.1, 0.0, 0.01, -0.02, 1.3])
OFFSET_RAD = 1.7


def updated(reference: HeadingReference, state: State, error_rad: float) -> tuple[State, MeasurementUpdate]:
    """Give a heading in the frame of the reference that differs by `error_rad` from the state."""
    sample = HeadingSample(state.t_ns, float(state.mean[YAW]) + OFFSET_RAD + error_rad)
    return reference.update(state, sample, MODEL_EFFECTS, OTHERS, POSE_RATE)


def aligned() -> HeadingReference:
    reference = HeadingReference(CONFIG)
    updated(reference, some_state(), 0.0)
    return reference


def test_the_first_sample_aligns_the_frames() -> None:
    reference, state = HeadingReference(CONFIG), some_state()
    after, update = updated(reference, state, 0.0)
    np.testing.assert_array_equal(after.mean, state.mean)
    grown = after.covariance - state.covariance
    assert grown[YAW, YAW] == pytest.approx(STD**2) and np.count_nonzero(grown) == 1
    assert update.stats.dof == 0


def test_the_random_walk_acts_from_the_first_sample_on() -> None:
    assert HeadingReference(CONFIG).walk_rad == 0.0
    assert aligned().walk_rad == pytest.approx(math.radians(0.1))


def test_later_samples_correct_the_heading() -> None:
    """The time offset of the model changes the expected heading by minus the yaw rate."""
    reference, state = aligned(), some_state()
    by_values = np.zeros(MODEL_EFFECTS.count)
    by_values[-1] = -POSE_RATE[YAW]
    yaw_rad = float(state.mean[YAW]) + 0.002
    expected, stats, residual, std = heading_update(state, yaw_rad, STD, by_values, np.zeros(OTHERS.count))
    after, update = updated(reference, state, 0.002)
    np.testing.assert_allclose(after.mean, expected.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(after.covariance, expected.covariance, rtol=1e-9, atol=1e-15)
    assert update.heading_rad == pytest.approx(residual) == pytest.approx(0.002)
    assert update.heading_std_rad == pytest.approx(std)
    assert update.stats.nis == pytest.approx(stats.nis) and update.stats.dof == 1


def test_a_time_offset_among_the_candidates_has_a_sensitivity() -> None:
    late = sort_effects((find_effect('camera_time_offset'),))
    state = replace(some_state(), sensitivity=np.zeros((len(some_state().mean), 1)))
    reference, none = aligned(), sort_effects(())
    sample = HeadingSample(state.t_ns, float(state.mean[YAW]) + OFFSET_RAD + 0.002)
    effects = replace(MODEL_EFFECTS, time=none.time)
    _, update = reference.update(state, sample, effects, late, POSE_RATE)
    assert update.stats.information is not None and update.stats.score is not None
    variance = update.heading_std_rad**2
    np.testing.assert_allclose(update.stats.information, [[POSE_RATE[YAW] ** 2 / variance]])
    np.testing.assert_allclose(update.stats.score, [-POSE_RATE[YAW] * update.heading_rad / variance])


def test_after_a_lost_alignment_the_next_sample_aligns() -> None:
    reference, state = aligned(), some_state()
    reference.forget_alignment()
    assert reference.walk_rad == 0.0
    after, update = updated(reference, state, 0.8)
    np.testing.assert_array_equal(after.mean, state.mean)
    assert update.stats.dof == 0
    assert updated(reference, state, 0.8)[1].heading_rad == pytest.approx(0.0, abs=1e-12)


def test_the_noise_is_estimated_where_it_dominates() -> None:
    certain = replace(some_state(), covariance=1e-12 * np.eye(len(some_state().mean)))
    uncertain = replace(certain, covariance=np.eye(len(certain.mean)))
    rng = np.random.default_rng(0)
    reference = aligned()
    for _ in range(500):
        updated(reference, uncertain, 0.3)
    assert reference.noise.std == STD, 'the state dominates these innovations'
    for error_rad in rng.normal(0.0, 3.0 * STD, 3000):
        updated(reference, certain, float(error_rad))
    assert reference.noise.std == pytest.approx(3.0 * STD, rel=0.1)
