"""Limits of the rate: told by the readings, and proposed only where the headings agree."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import DT_S, TOP_DEG_S, Drive, drive, readings, turning_rad_s

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.limits import (
    BANDS_DEG_S,
    MIN_PILE_S,
    STRAYS,
    LimitProposal,
    pile,
    proposals,
    stuck,
    with_limit,
)
from gyrocal_ros.diagnose.search import with_effect
from gyrocal_ros.ekf.state import YAW_BIAS
from gyrocal_ros.model.recording import RecordingSummary

HZ = 100.0
TOP = math.radians(85.0)


def deg(value: float) -> float:
    return math.radians(value)


def read_by(made: Drive) -> RecordingSummary:
    """The readings that a drive was run on, one in the middle of each step."""
    history = made.run.history
    return readings(history.turn_rad / history.dt_s, start_s=0.5 * DT_S)


def proposed(
    made: Drive, odd_gain: float = 0.0, rival_gain: float = 0.0, has_jumped: bool = False
) -> list[LimitProposal]:
    return list(proposals(made.run, made.seen, read_by(made), odd_gain, rival_gain, has_jumped))


def noise(count: int, std_deg_s: float, seed: int = 0) -> Array:
    drawn: Array = deg(std_deg_s) * np.random.default_rng(seed).normal(size=count)
    return drawn


class TestPile:
    @pytest.mark.parametrize('side', [1.0, -1.0])
    def test_readings_stand_at_a_limit(self, side: float) -> None:
        rate = deg(120.0) * np.sin(2.0 * np.pi * np.arange(6000) / HZ / 20.0)
        found = pile(readings(side * np.clip(rate, -deg(200.0), TOP) + noise(6000, 0.05), HZ))
        assert found == pytest.approx(deg(120.0), rel=0.02), 'the other side reaches further'
        both = pile(readings(side * np.clip(rate, -TOP, TOP) + noise(6000, 0.05), HZ))
        assert both == pytest.approx(TOP, rel=1e-3)

    def test_a_habit_is_a_pile_too(self) -> None:
        found = pile(readings(turning_rad_s(200.0)))
        assert found == pytest.approx(deg(TOP_DEG_S))

    def test_readings_that_pass_by_do_not_stand(self) -> None:
        assert pile(readings(noise(6000, 30.0), HZ)) is None

    @pytest.mark.parametrize(('part', 'is_pile'), [(0.9, False), (1.2, True)])
    def test_it_has_to_last(self, part: float, is_pile: bool) -> None:
        rate = noise(6000, 5.0)
        rate[: STRAYS + int(part * MIN_PILE_S * HZ)] = TOP
        assert (pile(readings(rate, HZ)) is not None) == is_pile

    def test_stray_readings_beyond_the_limit_do_not_count(self) -> None:
        rate = np.clip(deg(120.0) * np.sin(np.arange(6000) / HZ), -TOP, TOP)
        rate[: STRAYS - 1] = deg(500.0)
        assert pile(readings(rate, HZ)) == pytest.approx(TOP)
        assert pile(readings(rate[: STRAYS // 2], HZ)) is None


class TestStuck:
    def slow(self, width_deg_s: float) -> Array:
        """Readings at rest and in slow turns, those inside a band read as zero."""
        rate = noise(6000, 0.4) + np.repeat([0.0, deg(1.0), deg(-1.0)], 2000)
        return np.where(np.abs(rate) < deg(width_deg_s), 0.0, rate)

    @pytest.mark.parametrize('width_deg_s', [0.15, 0.3])
    def test_the_width_of_a_dead_band(self, width_deg_s: float) -> None:
        assert stuck(readings(self.slow(width_deg_s), HZ)) == pytest.approx(deg(width_deg_s), rel=0.05)

    def test_about_a_zero_that_is_off(self) -> None:
        found = stuck(readings(self.slow(0.3) + deg(0.5), HZ))
        assert found == pytest.approx(deg(0.3), rel=0.05)

    def test_readings_that_are_all_different(self) -> None:
        assert stuck(readings(self.slow(0.0), HZ)) is None

    def test_a_coarse_converter_has_no_dead_band(self) -> None:
        step = deg(0.2)
        assert stuck(readings(step * np.round(self.slow(0.0) / step), HZ)) is None

    def test_nothing_but_one_number(self) -> None:
        assert stuck(readings(np.zeros(1000), HZ)) is None
        assert stuck(readings(np.full(1000, deg(50.0)), HZ)) is None


class TestProposals:
    def saturated(self) -> Drive:
        return drive(read_rad_s=np.clip(turning_rad_s(300.0), -TOP, TOP))

    def test_readings_that_stop_where_the_robot_turns_faster(self) -> None:
        (proposal,) = proposed(self.saturated())
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_read
        assert proposal.effect.coefficients[0].prior_mean == pytest.approx(TOP, rel=1e-3)

    def test_not_where_something_else_explains_far_more(self) -> None:
        assert proposed(self.saturated(), rival_gain=1e9) == []

    def test_where_headings_go_astray_and_nothing_explains_it_a_pile_may_be_a_limit(self) -> None:
        made = drive()
        assert proposed(made) == []
        (proposal,) = proposed(made, odd_gain=100.0)
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_read

    def test_a_robot_that_likes_one_turn_rate_is_not_saturated(self) -> None:
        made = drive()
        assert pile(read_by(made)) is not None
        assert proposed(made) == []

    def test_nor_is_one_whose_fast_turns_read_too_large(self) -> None:
        fast = np.abs(turning_rad_s(300.0)) > TOP
        assert proposed(drive(-0.02 * turning_rad_s(300.0) * fast)) == []

    def test_nor_one_with_a_wrong_scale_factor(self) -> None:
        """It gives way to what the readings at the limit would ask for."""
        assert proposed(drive(0.01 * turning_rad_s(300.0))) == []

    def test_what_the_model_has_is_not_proposed_again(self) -> None:
        made = self.saturated()
        has_it = replace(
            made, run=replace(made.run, model=with_effect(made.run.model, with_limit('rate_saturation', 1.5)))
        )
        assert proposed(has_it) == []

    def test_a_dead_band_that_the_readings_show_is_believed(self) -> None:
        rest = noise(3000, 0.4, seed=1)
        read = np.where(np.abs(rest) < deg(0.2), 0.0, rest) * (turning_rad_s(300.0) == 0.0)
        recorded = readings(read + turning_rad_s(300.0), start_s=0.5 * DT_S)
        made = drive()
        (proposal,) = proposals(made.run, made.seen, recorded, odd_gain=0.0, rival_gain=0.0)
        assert proposal.effect.name == 'rate_deadband' and proposal.is_read
        assert proposal.effect.coefficients[0].prior_mean == pytest.approx(deg(0.2), rel=0.1)

    def banded(self) -> tuple[Drive, float]:
        """A gyro with a bias of its own that reads nothing inside a band, under fresh noise."""
        width, bias = BANDS_DEG_S[2], 0.8 * BANDS_DEG_S[2]
        resting = turning_rad_s(300.0) == 0.0
        made = drive(np.where(resting, 0.0, deg(bias)))
        mean = made.run.history.mean.copy()
        mean[:, YAW_BIAS] = deg(bias)
        return replace(made, run=replace(made.run, history=replace(made.run.history, mean=mean))), deg(width)

    def test_one_whose_edge_is_hidden_is_told_by_the_headings(self) -> None:
        """Nothing is wrong at rest, and in turns the bias is there."""
        made, width = self.banded()
        assert proposed(made) == [], 'unless something is odd nobody asks'
        (proposal,) = proposed(made, odd_gain=100.0, rival_gain=1.0)
        assert proposal.effect.name == 'rate_deadband' and not proposal.is_read
        assert proposal.effect.coefficients[0].prior_mean in np.radians(BANDS_DEG_S)
        assert proposed(made, odd_gain=1e9, rival_gain=1.0) == [], 'it has to explain a good part of that'
        assert proposed(made, odd_gain=100.0, rival_gain=1.0, has_jumped=True) == [], (
            'no dead band makes the bias jump'
        )

    @pytest.mark.parametrize(('swing_deg_s', 'count'), [(0.005, 1), (0.05, 0)])
    def test_readings_that_follow_something_are_not_dead(self, swing_deg_s: float, count: int) -> None:
        made, _ = self.banded()
        history = made.run.history
        swing_rad = deg(swing_deg_s) * np.sin(history.time_s / 5.0) * history.dt_s
        followed = replace(history, turn_rad=history.turn_rad + swing_rad)
        made = replace(made, run=replace(made.run, history=followed))
        assert len(proposed(made, odd_gain=100.0, rival_gain=1.0)) == count

    def test_a_clean_drive_has_no_dead_band(self) -> None:
        assert [item.effect.name for item in proposed(drive(), odd_gain=100.0, rival_gain=1.0)] == []


def test_a_limit_is_known_not_estimated() -> None:
    (item,) = with_limit('rate_saturation', 1.5).coefficients
    assert item.prior_mean == 1.5 and item.prior_std == 0.0
