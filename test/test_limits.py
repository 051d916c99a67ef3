"""Limits of the rate: detected in the readings, and proposed only where the headings agree."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import DT_S, TOP_DEG_S, Drive, banded, drive, readings, readings_of, turning_rad_s

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.diagnose.analysis.limits import (
    Competition,
    LimitProposal,
    detected_limits,
    propose_limits,
    proven_limits,
)
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.limit_sizes import possible_sizes
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.rate_deadband import RateDeadband
from gyrocal_ros.effects.rate_saturation import MIN_TOP_S, OUTLIERS, RateSaturation
from gyrocal_ros.model.recording import GyroReadings
from gyrocal_ros.model.sensor import LimitEffect, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

HZ = 100.0
TOP = math.radians(85.0)
WIDTHS_RAD_S = RateDeadband().coefficients[0].scan


def deg(value: float) -> float:
    return math.radians(value)


def proposed(
    made: Drive, lacks_something: bool = False, contradicts: bool = False, has_jumped: bool = False
) -> list[LimitProposal]:
    others = Competition(lacks_something, contradicts, has_jumped)
    return list(propose_limits(made.run, made.seen, readings_of(made), others, DEFAULT_SETTINGS))


def top_of(read: GyroReadings) -> float | None:
    """Return the limit of a saturation that the readings show."""
    found = RateSaturation().detect(read)
    return None if found is None else found.value


def dead_width(read: GyroReadings) -> float | None:
    """Return the width of a dead band that the readings show."""
    found = RateDeadband().detect(read)
    assert found is None or found.is_certain, 'nothing but a dead band leaves such a gap'
    return None if found is None else found.value


def noise(count: int, std_deg_s: float, seed: int = 0) -> Array:
    drawn: Array = deg(std_deg_s) * np.random.default_rng(seed).normal(size=count)
    return drawn


class TestSaturationInReadings:
    @pytest.mark.parametrize('side', [1.0, -1.0])
    def test_readings_pile_up_at_a_limit(self, side: float) -> None:
        rate = deg(120.0) * np.sin(2.0 * np.pi * np.arange(6000) / HZ / 20.0)
        found = top_of(readings(side * np.clip(rate, -deg(200.0), TOP) + noise(6000, 0.05), HZ))
        assert found is None, 'the other side reaches further, and no limit stops it'
        both = top_of(readings(side * np.clip(rate, -TOP, TOP) + noise(6000, 0.05), HZ))
        assert both == pytest.approx(TOP, rel=1e-3)

    def test_a_usual_speed_of_turning_piles_up_too(self) -> None:
        found = top_of(readings(turning_rad_s(200.0)))
        assert found == pytest.approx(deg(TOP_DEG_S))

    def test_readings_that_only_pass_the_largest_rate_do_not(self) -> None:
        assert top_of(readings(noise(6000, 30.0), HZ)) is None

    @pytest.mark.parametrize(('part', 'is_limit'), [(0.9, False), (1.2, True)])
    def test_readings_have_to_stay_at_the_limit(self, part: float, is_limit: bool) -> None:
        rate = noise(6000, 5.0)
        rate[: OUTLIERS + int(part * MIN_TOP_S * HZ)] = TOP
        assert (top_of(readings(rate, HZ)) is not None) == is_limit

    @pytest.mark.parametrize(('wander_deg_s', 'is_limit'), [(0.0, True), (1.0, False)])
    def test_a_limit_lets_no_reading_pass(self, wander_deg_s: float, is_limit: bool) -> None:
        """A robot that likes one rate holds it less exactly than a limit holds its readings."""
        wander = deg(wander_deg_s) * np.sin(np.arange(1500) / HZ)
        rate = np.concatenate([noise(6000, 5.0), TOP + wander + noise(1500, 0.1, seed=3)])
        assert (top_of(readings(rate, HZ)) is not None) == is_limit

    def test_outliers_beyond_the_limit_are_ignored(self) -> None:
        rate = np.clip(deg(120.0) * np.sin(np.arange(6000) / HZ), -TOP, TOP)
        rate[: OUTLIERS - 1] = deg(500.0)
        assert top_of(readings(rate, HZ)) == pytest.approx(TOP)
        assert top_of(readings(rate[: OUTLIERS // 2], HZ)) is None


class TestSaturationOfEachSide:
    SWING = deg(120.0) * np.sin(2.0 * np.pi * np.arange(6000) / HZ / 20.0)

    @pytest.mark.parametrize(
        ('low_deg_s', 'high_deg_s', 'expected'),
        [
            (-62.0, 75.0, (68.5, 6.5)),
            (-75.0, 62.0, (68.5, -6.5)),
            (-62.0, 200.0, (94.0, 32.0)),
            (-62.0, 62.5, None),
            (-62.0, 62.0, None),
            (-200.0, 200.0, None),
        ],
    )
    def test_each_side_has_a_limit_of_its_own(
        self, low_deg_s: float, high_deg_s: float, expected: tuple[float, float] | None
    ) -> None:
        """A side that reaches 120 deg/s has one at 126 deg/s, which no reading passes."""
        read = np.clip(self.SWING, deg(low_deg_s), deg(high_deg_s)) + noise(6000, 0.05)
        found = RateSaturation().of_each_side(readings(read, HZ))
        if expected is None:
            assert found is None
            return
        assert found is not None
        limit, offset = (math.degrees(x) for x in (found.coefficients[0].prior_mean, found.offset_rad_s))
        assert (limit, offset) == pytest.approx(expected, abs=0.5)

    def test_a_side_that_turns_slower_has_no_limit(self) -> None:
        read = np.clip(np.where(self.SWING > 0.0, self.SWING, 0.4 * self.SWING), -TOP, TOP)
        assert RateSaturation().of_each_side(readings(read + noise(6000, 0.05), HZ)) is None
        assert RateSaturation().of_each_side(readings(np.zeros(5), HZ)) is None

    def test_readings_beyond_either_limit_are_replaced(self) -> None:
        found = RateSaturation(offset_rad_s=deg(6.5))
        rates = np.radians([-62.0, -50.0, 65.0, 75.0])
        side, bias_part = found.rate_error(rates, deg(68.5))
        assert side.tolist() == [-1.0, 0.0, 0.0, 1.0] and not bias_part.any()
        clipped = found.readings(np.radians([-90.0, 90.0]), np.ones(2), np.array([deg(68.5)]), 1.0)
        np.testing.assert_allclose(clipped, [deg(-62.0), deg(75.0)])


class TestDeadBandInReadings:
    def slow(self, width_deg_s: float) -> Array:
        """Readings at rest and in slow turns, those inside a band read as zero."""
        rate = noise(6000, 0.4) + np.repeat([0.0, deg(1.0), deg(-1.0)], 2000)
        return np.where(np.abs(rate) < deg(width_deg_s), 0.0, rate)

    @pytest.mark.parametrize('width_deg_s', [0.15, 0.3])
    def test_the_width_of_a_dead_band(self, width_deg_s: float) -> None:
        assert dead_width(readings(self.slow(width_deg_s), HZ)) == pytest.approx(deg(width_deg_s), rel=0.05)

    def test_it_is_proven_by_the_readings_alone(self) -> None:
        """A robot whose bias is small hardly drifts more for it, and no run predicts better with it."""
        (limit,) = proven_limits(default_model(), readings(self.slow(0.3), HZ))
        assert limit.name == 'rate_deadband'
        assert limit.coefficients[0].prior_mean == pytest.approx(deg(0.3), rel=0.05)
        assert proven_limits(with_effect(default_model(), limit), readings(self.slow(0.3), HZ)) == []
        assert proven_limits(default_model(), readings(self.slow(0.0), HZ)) == []

    def test_a_band_about_a_zero_that_is_off(self) -> None:
        found = dead_width(readings(self.slow(0.3) + deg(0.5), HZ))
        assert found == pytest.approx(deg(0.3), rel=0.05)

    def test_readings_that_are_all_different(self) -> None:
        assert dead_width(readings(self.slow(0.0), HZ)) is None

    def test_a_coarse_converter_has_no_dead_band(self) -> None:
        step = deg(0.2)
        assert dead_width(readings(step * np.round(self.slow(0.0) / step), HZ)) is None

    def test_readings_of_one_value(self) -> None:
        assert dead_width(readings(np.zeros(1000), HZ)) is None
        assert dead_width(readings(np.full(1000, deg(50.0)), HZ)) is None


class TestProposals:
    def saturated(self) -> Drive:
        return drive(read_rad_s=np.clip(turning_rad_s(300.0), -TOP, TOP))

    def test_a_limit_of_each_side_is_proposed(self) -> None:
        made = drive(read_rad_s=np.clip(turning_rad_s(300.0), -0.8 * TOP, TOP))
        (uneven,) = (proposal.effect for proposal in proposed(made))
        assert isinstance(uneven, RateSaturation)
        assert uneven.coefficients[0].prior_mean == pytest.approx(0.9 * TOP, rel=0.01)
        assert uneven.offset_rad_s == pytest.approx(0.1 * TOP, rel=0.05)

    def test_readings_that_stop_where_the_robot_turns_faster(self) -> None:
        (proposal,) = proposed(self.saturated())
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_certain
        assert proposal.effect.coefficients[0].prior_mean == pytest.approx(TOP, rel=1e-3)

    def test_a_limit_is_tried_whatever_else_explains(self) -> None:
        """A run of the filter with each decides."""
        (proposal,) = proposed(self.saturated(), lacks_something=True)
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_certain

    def test_headings_are_no_test_where_the_map_is_spoilt(self) -> None:
        """They agree with the gyro then, but the wheels turn further."""
        made = self.saturated()
        spoilt = replace(made, seen=replace(made.seen, seen_rad=np.cumsum(made.seen.turn_rad)))
        assert proposed(spoilt) == []
        (proposal,) = proposed(spoilt, lacks_something=True, contradicts=True)
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_certain
        assert proposed(drive(), lacks_something=True, contradicts=True) == [], (
            'the wheels agree with the gyro'
        )

    def test_beside_a_heading_reference_a_run_decides(self) -> None:
        """What the gyro loses passes for jumps of the reference, and there may be no wheels."""
        made = self.saturated()
        still = np.zeros_like(made.run.history.wheel_turn_rad)
        history = replace(made.run.history, wheel_turn_rad=still)
        run = replace(made.run, history=history, rig=replace(made.run.rig, camera=None))
        agreeing = replace(made.seen, seen_rad=np.cumsum(made.seen.turn_rad))
        (proposal,) = proposed(replace(made, run=run, seen=agreeing))
        assert proposal.effect.name == 'rate_saturation' and not proposal.is_certain

    def test_a_robot_with_one_speed_of_turning_is_not_saturated(self) -> None:
        made = drive()
        assert top_of(readings_of(made)) is not None
        assert proposed(made) == []

    def test_nor_is_one_whose_fast_turns_read_too_large(self) -> None:
        fast = np.abs(turning_rad_s(300.0)) > TOP
        assert proposed(drive(-0.02 * turning_rad_s(300.0) * fast)) == []

    def test_nor_is_one_with_a_wrong_scale_factor(self) -> None:
        """The scale factor is fitted beside the limit, and explains it."""
        assert proposed(drive(0.01 * turning_rad_s(300.0))) == []

    def test_a_limit_of_the_model_is_not_proposed_again(self) -> None:
        made = self.saturated()
        model = with_effect(made.run.model, with_means(find_effect('rate_saturation'), (1.5,)))
        assert proposed(replace(made, run=replace(made.run, model=model))) == []

    def test_a_dead_band_in_the_readings_is_certain(self) -> None:
        rest = noise(3000, 0.4, seed=1)
        read = np.where(np.abs(rest) < deg(0.2), 0.0, rest) * (turning_rad_s(300.0) == 0.0)
        recorded = readings(read + turning_rad_s(300.0), start_s=0.5 * DT_S)
        made = drive()
        alone = Competition(lacks_something=False)
        (proposal,) = propose_limits(made.run, made.seen, recorded, alone, DEFAULT_SETTINGS)
        assert proposal.effect.name == 'rate_deadband' and proposal.is_certain
        assert proposal.effect.coefficients[0].prior_mean == pytest.approx(deg(0.2), rel=0.1)

    def test_a_dead_band_hidden_by_noise_is_found_by_the_headings(self) -> None:
        """At rest nothing is wrong, and in turns the bias is there."""
        made = banded(WIDTHS_RAD_S[2])
        assert proposed(made) == [], 'it is tried only where there is unexplained structure'
        (proposal,) = proposed(made, lacks_something=True, contradicts=True)
        assert proposal.effect.name == 'rate_deadband' and not proposal.is_certain
        assert proposal.effect.coefficients[0].prior_mean in WIDTHS_RAD_S
        assert proposed(made, lacks_something=True, has_jumped=True) == [], 'no dead band makes the bias jump'

    def test_a_bias_that_shows_in_turns_alone_suggests_one(self) -> None:
        """The filter takes it for zero, as the readings of straight drives say."""
        made = drive(np.where(turning_rad_s(300.0) == 0.0, 0.0, 0.2 * WIDTHS_RAD_S[2]))
        (proposal,) = proposed(made, lacks_something=True)
        assert proposal.effect.name == 'rate_deadband' and not proposal.is_certain

    def test_readings_that_are_hardly_inside_suggest_none(self) -> None:
        """A robot that rests or drives straight on for 3 s of 300."""
        rate = turning_rad_s(300.0)
        seconds = np.arange(len(rate)) * DT_S
        turned = np.where((rate == 0.0) & (seconds > 8.0), 0.2, rate)
        bias = 0.2 * WIDTHS_RAD_S[2]
        made = drive(np.where(turned == 0.0, 0.0, bias), read_rad_s=turned)
        assert proposed(made, lacks_something=True) == []

    @pytest.mark.parametrize(('swing_deg_s', 'count'), [(0.005, 1), (0.05, 0)])
    def test_readings_that_follow_something_are_not_dead(self, swing_deg_s: float, count: int) -> None:
        made = banded(WIDTHS_RAD_S[2])
        history = made.run.history
        swing_rad = deg(swing_deg_s) * np.sin(history.time_s / 5.0) * history.dt_s
        followed = replace(history, turn_rad=history.turn_rad + swing_rad)
        made = replace(made, run=replace(made.run, history=followed))
        assert len(proposed(made, lacks_something=True, contradicts=True)) == count

    @pytest.mark.parametrize(('bias_deg_s', 'count'), [(0.001, 1), (0.05, 0)])
    def test_readings_that_hold_a_bias_are_not_dead(self, bias_deg_s: float, count: int) -> None:
        """However much better the headings fit if a robot that turns slowly is taken not to turn."""
        made = banded(WIDTHS_RAD_S[2])
        history = made.run.history
        biased = replace(history, turn_rad=history.turn_rad + deg(bias_deg_s) * history.dt_s)
        made = replace(made, run=replace(made.run, history=biased))
        assert len(proposed(made, lacks_something=True, contradicts=True)) == count

    @pytest.mark.parametrize(('bias_part', 'is_plausible'), [(0.98, False), (0.0, True)])
    def test_a_bias_near_the_edge_is_none(self, bias_part: float, is_plausible: bool) -> None:
        """With its noise it is inside now and then, but never for long."""
        width = WIDTHS_RAD_S[2]
        noise = np.random.default_rng(2).normal(0.0, 0.1 * width, 60 * 100)
        readings = GyroReadings(np.arange(len(noise)) * 10**7, bias_part * width + noise)
        assert RateDeadband().is_plausible(readings, width) == is_plausible

    @pytest.mark.parametrize(('swing_deg_s', 'is_plausible'), [(0.45, False), (0.0, True)])
    def test_a_swing_of_the_readings_is_no_dead_band(self, swing_deg_s: float, is_plausible: bool) -> None:
        """Of a robot that hardly stands, the readings in the band are few, and their mean is zero."""
        time_s = np.arange(60 * 100) / 100.0
        turning = np.where(
            time_s % 2.0 < 1.5, deg(30.0), deg(swing_deg_s) * np.sin(2.0 * np.pi * 0.8 * time_s)
        )
        read = turning + noise(len(time_s), 0.05)
        recorded = GyroReadings(np.arange(len(time_s)) * 10**7, read)
        assert RateDeadband().is_plausible(recorded, WIDTHS_RAD_S[4]) == is_plausible

    def test_a_run_tries_the_widths_that_the_readings_allow(self) -> None:
        """Readings of slow turns beyond the true width are no zeros."""
        made = banded(WIDTHS_RAD_S[2])
        history = made.run.history
        seconds = np.arange(len(history.time_s)) * history.dt_s // 1.0
        slow = np.isin(seconds % 40.0, [1.0, 2.0]) * 0.5 * (WIDTHS_RAD_S[1] + WIDTHS_RAD_S[2]) * history.dt_s
        turned = replace(history, turn_rad=history.turn_rad + slow)
        slowly = replace(made, run=replace(made.run, history=turned))
        band = find_effect('rate_deadband')
        assert possible_sizes(band, readings_of(made)) == list(WIDTHS_RAD_S)
        assert possible_sizes(band, readings_of(slowly)) == list(WIDTHS_RAD_S[:2])
        assert possible_sizes(with_means(find_effect('rate_saturation'), (TOP,)), readings_of(made)) == [TOP]

    def test_a_clean_drive_has_no_dead_band(self) -> None:
        assert [item.effect.name for item in proposed(drive(), lacks_something=True, contradicts=True)] == []


def test_limits_that_may_break_the_filter_are_detected_without_a_run() -> None:
    read = readings_of(drive(read_rad_s=np.clip(turning_rad_s(300.0), -TOP, TOP)))
    (limit,) = detected_limits(default_model(), read)
    assert limit.name == 'rate_saturation'
    assert limit.coefficients[0].prior_mean == pytest.approx(TOP, rel=1e-3)
    assert detected_limits(with_effect(default_model(), limit), read) == []
    assert detected_limits(default_model(), readings(noise(6000, 30.0), HZ)) == []


@pytest.mark.parametrize('name', [name for name, item in EFFECTS.items() if isinstance(item, LimitEffect)])
def test_a_limit_is_known_not_estimated(name: str) -> None:
    (item,) = with_means(find_effect(name), (1.5,)).coefficients
    assert item.prior_mean == 1.5 and item.prior_std == 0.0


def test_readings_that_are_all_the_same_at_the_top_prove_a_limit() -> None:
    rate = deg(120.0) * np.sin(2.0 * np.pi * np.arange(6000) / HZ / 20.0)
    found = RateSaturation().detect(readings(np.clip(rate + noise(6000, 0.05), -TOP, TOP), HZ))
    assert found is not None and found.is_certain


@pytest.mark.parametrize('step_deg_s', [1e-6, 0.5])
def test_a_robot_that_likes_one_speed_of_turning_proves_none(step_deg_s: float) -> None:
    """Nor if the converter is so coarse that most readings there are the same."""
    rate, step = turning_rad_s(200.0), deg(step_deg_s)
    found = RateSaturation().detect(readings(step * np.round((rate + noise(len(rate), 0.05)) / step)))
    assert found is not None and not found.is_certain


@pytest.mark.slow
def test_a_limit_is_found_beside_motion_capture() -> None:
    """What the gyro loses there passes for jumps of the reference, with which nothing seems to be missing."""
    scenario = replace(find_scenario('cleaning'), duration_s=70.0, imu_hz=100, camera_hz=5)
    hidden = (HiddenEffect(find_effect('rate_saturation'), (1.1,)),)
    source, config = preload(
        ReferenceSource(SimSource(scenario, 5, hidden=hidden), 'mocap'), Config(), default_model()
    )
    recorded = summarise_recording(source)
    searched = find_missing(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    (found,) = diagnose(searched, recorded).missing
    assert found.effect.name == 'rate_saturation' and found.values[0] == pytest.approx(1.1, rel=1e-3)


@pytest.mark.slow
def test_a_limit_wins_against_an_effect_that_explains_nearly_as_much() -> None:
    """A minute at five images a second, with eight steps at the limit."""
    limit = 1.4825
    scenario = replace(find_scenario('cleaning'), duration_s=60.0, imu_hz=100, camera_hz=5)
    hidden = (HiddenEffect(find_effect('rate_saturation'), (limit,)),)
    source, config = preload(SimSource(scenario, 5, hidden=hidden), Config(), default_model())
    recorded = summarise_recording(source)
    searched = find_missing(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    (found,) = diagnose(searched, recorded).missing
    assert found.effect.name == 'rate_saturation' and found.values[0] == pytest.approx(limit, rel=1e-3)
