"""Headings by gyro and camera: errors of the rate, unexplained structure, and where the model fails."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recordings import recording
from scipy.signal import lfilter
from synthetic import DT_S, TOP_DEG_S, Drive, drive, turning_rad_s

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidate_fit import fit
from gyrocal_ros.diagnose.analysis.heading_filter import heading_scores, headings, misfits
from gyrocal_ros.diagnose.analysis.paths import truth_path
from gyrocal_ros.diagnose.analysis.regimes import Failure, failures
from gyrocal_ros.diagnose.analysis.shapes import (
    HEADING,
    JUMP_STEP_S,
    RATE,
    TIME,
    UnexplainedStructure,
    find_jump,
    find_oscillation,
    find_oscillations,
    shapes,
    turns_enough,
    unexplained_structure,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.pipeline.calibrate import calibrate

SIGNAL = 'motor.current'
KNOCK_S = 163.0


def deg(value: float) -> float:
    return math.radians(value)


def times_s(duration_s: float = 300.0) -> Array:
    return DT_S * np.arange(1, round(duration_s / DT_S) + 1)


def switched(duration_s: float = 300.0) -> Array:
    """Return the current of a motor that goes up and down every 25 s, with noise."""
    rng = np.random.default_rng(9)
    return np.sin(2.0 * np.pi * times_s(duration_s) / 50.0) + 0.05 * rng.normal(size=round(duration_s / DT_S))


def size_of(failure: Failure) -> float:
    """Return the size of the error in the description, in deg/s or per cent."""
    return float(re.findall(r'[+-]\d+\.\d+', failure.what)[-1])


@cache
def clean(seed: int = 0) -> Drive:
    return drive(seed=seed, signals={SIGNAL: switched()})


@cache
def knocked() -> Drive:
    return drive(deg(0.2) * (times_s() > KNOCK_S), signals={SIGNAL: switched()})


class TestHeadingScores:
    """Errors of the rate are estimated from headings."""

    def columns(self) -> tuple[Array, Array]:
        rate = turning_rad_s(300.0)
        return rate, np.abs(rate)

    @pytest.mark.parametrize('errors', [(0.01, 0.0), (0.0, 0.01), (-0.005, 0.01)])
    def test_errors_are_found_with_the_right_sign(self, errors: tuple[float, float]) -> None:
        columns = np.stack(self.columns(), axis=1)
        found = fit(heading_scores(drive(columns @ errors).seen, columns), np.arange(2))
        assert found is not None
        std = np.sqrt(np.diagonal(found.covariance))
        np.testing.assert_array_less(np.abs(found.values - errors), 4.0 * std)
        assert np.all(std < 5e-4)

    @pytest.mark.slow
    def test_the_standard_deviation_is_right(self) -> None:
        rate, size = self.columns()
        off = []
        for seed in range(25):
            found = fit(heading_scores(drive(0.001 * size, seed=seed).seen, size[:, None]), np.array([0]))
            assert found is not None
            off.append((found.values[0] - 0.001) / math.sqrt(found.covariance[0, 0]))
        assert 0.5 < float(np.sqrt(np.mean(np.square(off)))) < 1.4

    def test_a_constant_bias_changes_nothing(self) -> None:
        """The filter estimates the bias anyway."""
        plain, off = drive(), drive(deg(0.3))
        size = self.columns()[1][:, None]
        values = []
        for seen in (plain.seen, off.seen):
            found = fit(heading_scores(seen, size), np.array([0]))
            assert found is not None
            values.append(found.values[0])
        assert values[1] == pytest.approx(values[0], abs=2e-4)

    def test_outliers_of_the_heading_count_little(self) -> None:
        made = drive(0.01 * self.columns()[1])
        wrong = made.seen.seen_rad.copy()
        wrong[1000::97] += 1000.0 * made.seen.outlier_sigma * made.seen.std_rad[1000::97]
        found = fit(
            heading_scores(replace(made.seen, seen_rad=wrong), self.columns()[1][:, None]), np.array([0])
        )
        assert found is not None and found.values[0] == pytest.approx(
            0.01, abs=5.0 * np.sqrt(found.covariance[0, 0])
        )
        assert abs(found.values[0] - 0.01) < 0.005

    def test_scores_are_kept_by_block_of_time(self) -> None:
        size = self.columns()[1][:, None]
        scores = heading_scores(clean().seen, size)
        np.testing.assert_array_equal(scores.start_s, BLOCK_S * np.arange(30))
        assert scores.information.shape == (30, 1, 1) and np.all(scores.information[1:] > 0.0)

    def test_without_headings_there_is_no_information(self) -> None:
        made = drive(0.05 * self.columns()[1])
        blind = replace(made.seen, seen_rad=np.full(len(made.seen.time_s), np.nan))
        scores = heading_scores(blind, self.columns()[1][:, None])
        assert not np.any(scores.information) and not np.any(scores.score)
        assert fit(scores, np.array([0])) is None

    def test_turns_that_no_sensor_observed_hold_no_information(self) -> None:
        """Where the gyro reads nothing valid in any turn, no turn shows an error."""
        rate, size = self.columns()
        made = drive(0.01 * size)
        lost = replace(made.seen, unobserved_turn_std_rad=np.where(size > 0.0, 1.0, 0.0))
        sure, unsure = (heading_scores(seen, size[:, None]).information.sum() for seen in (made.seen, lost))
        assert unsure < 0.01 * sure


class TestMisfits:
    def test_they_have_variance_one_where_the_noise_is_that_of_the_settings(self) -> None:
        left = np.concatenate([misfits(clean(seed).seen, np.zeros((3000, 1))) for seed in range(5)])
        assert len(left) > 100
        assert 0.7 < float(np.sqrt(np.mean(left**2))) < 1.3

    def test_they_grow_with_noise_beyond_the_settings(self) -> None:
        quiet, noisy = (misfits(drive(gyro_noise=factor).seen, np.zeros((3000, 1))) for factor in (1.0, 5.0))
        assert np.std(noisy) > 3.0 * np.std(quiet)

    def test_fitted_columns_leave_no_misfit(self) -> None:
        size = np.abs(turning_rad_s(300.0))[:, None]
        seen = drive(0.01 * size[:, 0]).seen
        assert np.std(misfits(seen, size)) < 1.3 < 3.0 < np.std(misfits(seen, np.zeros_like(size)))


@pytest.fixture(scope='module')
def run() -> Run:
    """A short run of the whole filter."""
    return calibrate(recording(), Config(), default_model())


class TestOfARun:
    @pytest.mark.slow
    def test_the_camera_sees_the_true_heading(self, run: Run) -> None:
        seen, truth = headings(run), truth_path(run)
        assert truth is not None
        true = np.interp(seen.time_s, truth.time_s, truth.yaw_rad)
        off = seen.seen_rad - true
        known = np.isfinite(off)
        assert 0.5 < known.mean() < 1.0
        assert np.degrees(np.std(off[known])) < 0.3

    @pytest.mark.slow
    def test_turns_by_the_gyro_use_the_final_coefficients(self, run: Run) -> None:
        seen, history = headings(run), run.history
        expected = (1.0 + run.state.coefficients[0]) * history.turn_rad + history.tilt_rad
        np.testing.assert_allclose(seen.turn_rad, expected, atol=1e-12)
        np.testing.assert_array_equal(seen.time_s, history.time_s)

    @pytest.mark.slow
    def test_a_rough_floor_is_no_error_of_the_gyro(self) -> None:
        rough = calibrate(recording(bumps=40, floor_tilt_deg=1.5), Config(), default_model())
        seen, truth = headings(rough), truth_path(rough)
        assert truth is not None
        turned = np.cumsum(seen.turn_rad + float(rough.history.mean[-1, YAW_BIAS]) * seen.gyro_valid_s)
        off = turned - np.interp(seen.time_s, truth.time_s, truth.yaw_rad)
        tilted = np.cumsum(rough.history.tilt_rad)
        assert np.std(off) < 0.5 * np.std(off - tilted)

    @pytest.mark.slow
    def test_a_clean_run_has_no_structure_and_no_failure(self, run: Run) -> None:
        seen = headings(run)
        assert unexplained_structure(run, seen, DEFAULT_SETTINGS) is None and failures(run, seen) == []


def structure_of(made: Drive) -> UnexplainedStructure | None:
    return unexplained_structure(made.run, made.seen, DEFAULT_SETTINGS)


class TestStructure:
    @pytest.mark.slow
    def test_a_clean_drive_has_none(self) -> None:
        for seed in range(4):
            assert structure_of(clean(seed)) is None

    def test_a_jump_is_found_where_it_is(self) -> None:
        found = find_jump(knocked().seen)
        assert found is not None
        at_s, fitted = found
        assert at_s == pytest.approx(KNOCK_S, abs=2.0 * JUMP_STEP_S)
        assert fitted.values[0] == pytest.approx(deg(0.2), rel=0.15)
        structure = self.structure(knocked())
        assert structure.at_s == at_s and structure.sigma > DEFAULT_SETTINGS.structure_sigma
        assert structure.what.startswith('the bias jumped by +0.')
        assert structure.what.endswith(f'at {at_s:.0f} s')

    def test_a_jump_in_a_long_drive(self) -> None:
        found = find_jump(drive(deg(0.1) * (times_s(1200.0) > 777.0), duration_s=1200.0).seen)
        assert found is not None and found[0] == pytest.approx(777.0, abs=2.0 * JUMP_STEP_S)

    def test_a_drive_too_short_for_a_jump_or_an_oscillation(self) -> None:
        short = drive(duration_s=4.0 * JUMP_STEP_S - 1.0).seen
        assert find_jump(short) is None and find_oscillation(short) is None

    @pytest.mark.parametrize('period_s', [14.3, 37.0, 90.0])
    @pytest.mark.parametrize('of', ['bias', 'scale'])
    def test_the_period_of_a_wave(self, of: Of, period_s: float) -> None:
        time_s = times_s()
        size = 0.02 * turning_rad_s(300.0) if of == 'scale' else deg(0.2)
        seen = drive(size * np.sin(2.0 * np.pi * time_s / period_s)).seen
        (found_s, fitted), *_ = find_oscillations(seen, of, 150.0, most=3)
        assert found_s == pytest.approx(period_s, rel=0.02)
        size_found = float(np.hypot(*fitted.values))
        assert size_found == pytest.approx(0.02 if of == 'scale' else deg(0.2), rel=0.15)

    def test_the_periods_of_two_waves(self) -> None:
        """Of equal size; a fast one turns the robot less."""
        phase = 2.0 * np.pi * times_s()
        both = deg(0.2) * (np.sin(phase / 31.0) + np.sin(phase / 13.0))
        found = find_oscillations(drive(both).seen, 'bias', 150.0, most=3)
        gains = [fitted.gain for _, fitted in found]
        assert gains == sorted(gains, reverse=True)
        assert found[0][0] == pytest.approx(31.0, rel=0.03)
        assert any(period_s == pytest.approx(13.0, rel=0.03) for period_s, _ in found)

    def structure(self, made: Drive) -> UnexplainedStructure:
        found = structure_of(made)
        assert found is not None
        return found

    def test_a_bias_that_follows_a_signal(self) -> None:
        current = switched()
        structure = self.structure(
            drive(deg(0.1) * current, signals={'battery.voltage': times_s(), SIGNAL: current})
        )
        assert structure.what == f'the bias goes with {SIGNAL}' and structure.at_s is None
        assert structure.shape.signal == SIGNAL and not structure.shape.of_scale
        slope = np.polyfit(structure.shape.knots, structure.shape.values, 1)[0]
        assert slope == pytest.approx(deg(0.1), rel=0.15)
        assert structure.gain > 100.0

    @pytest.mark.parametrize('period_s', [13.3, 31.0, 55.0])
    def test_a_bias_that_oscillates(self, period_s: float) -> None:
        structure = self.structure(drive(deg(0.1) * np.sin(2.0 * np.pi * times_s() / period_s)))
        sentence = r'the bias oscillates with an amplitude of (\S+) deg/s and a period of (\S+) s'
        match = re.fullmatch(sentence, structure.what)
        assert match is not None
        assert [float(text) for text in match.groups()] == pytest.approx([0.1, period_s], rel=0.15)
        assert structure.at_s is None and structure.shape.signal == TIME

    @pytest.mark.parametrize('phase_deg', [0.0, 77.0, 200.0])
    def test_a_bias_that_goes_with_the_heading(self, phase_deg: float) -> None:
        heading_rad = np.cumsum(turning_rad_s(300.0)) * DT_S
        structure = self.structure(drive(deg(0.1) * np.cos(heading_rad - deg(phase_deg))))
        assert structure.what == f'the bias goes with {HEADING}' and not structure.shape.of_scale
        assert np.degrees(np.ptp(structure.shape.values)) == pytest.approx(0.2, rel=0.3)

    def test_a_scale_that_follows_a_signal(self) -> None:
        rng = np.random.default_rng(3)
        load = np.repeat(rng.uniform(0.0, 1.0, 30), 100)
        structure = self.structure(drive(0.02 * load * turning_rad_s(300.0), signals={SIGNAL: load}))
        assert structure.what == f'the scale goes with {SIGNAL}' and structure.shape.of_scale
        slope = np.polyfit(structure.shape.knots, structure.shape.values, 1)[0]
        assert slope == pytest.approx(0.02, rel=0.2)

    def test_an_error_that_goes_with_the_rate(self) -> None:
        """Fast turns to the left read too small; all other rates are right."""
        structure = self.structure(drive(0.01 * np.maximum(turning_rad_s(300.0) - deg(45.0), 0.0)))
        assert structure.what == f'the bias goes with {RATE}' and not structure.shape.of_scale
        *others, fastest = np.degrees(structure.shape.values).tolist()
        assert fastest == pytest.approx(0.45, rel=0.2) and np.ptp(others) < 0.1

    @pytest.mark.slow
    def test_a_gyro_too_noisy_has_none(self) -> None:
        for seed in range(3):
            made = drive(gyro_noise=4.0, seed=seed, signals={SIGNAL: switched()})
            assert structure_of(made) is None

    @pytest.mark.parametrize('turned_deg', [180.0, 540.0])
    def test_one_turn_says_nothing_of_the_scale_and_the_rate(self, turned_deg: float) -> None:
        """The scale factor has taken in what a turn says; between turns the rate is noise of the heading."""
        made = knocked()
        history = made.run.history
        turned_rad = np.abs(history.turn_rad)
        stops = np.cumsum(turned_rad) > math.radians(turned_deg)
        few = replace(history, turn_rad=np.where(stops, 0.0, history.turn_rad))
        run = replace(made.run, history=few)
        found = shapes(run, headings(run, DEFAULT_SETTINGS))
        assert turns_enough(run) == (turned_deg > 360.0)
        assert any(shape.of_scale for shape in found) == turns_enough(run)
        assert any(shape.signal == RATE for shape in found) == turns_enough(run)
        assert any(shape.signal == TIME and not shape.of_scale for shape in found)

    def test_signals_that_do_not_vary_or_are_unknown_have_no_shape(self) -> None:
        count = len(times_s())
        gappy = np.where(times_s() < 100.0, np.nan, switched())
        still, unknown = np.full(count, 7.0), np.full(count, np.nan)
        made = drive(signals={'still': still, 'unknown': unknown, 'gappy': gappy})
        found = {shape.signal for shape in shapes(made.run, made.seen)}
        assert found == {TIME, RATE, HEADING, 'gappy'}

    def test_the_best_shape_comes_first_and_starts_at_zero(self) -> None:
        found = shapes(knocked().run, knocked().seen)
        merits = [shape.fit.gain - len(shape.fit.values) for shape in found]
        assert merits == sorted(merits, reverse=True)
        assert all(shape.values[0] == shape.stds[0] == 0.0 for shape in found)
        assert not any(shape.of_scale for shape in found if shape.signal in (RATE, HEADING))


class TestFailures:
    def places(self, made: Drive) -> list[Failure]:
        found = failures(made.run, made.seen)
        assert [failure.sigma for failure in found] == sorted((item.sigma for item in found), reverse=True)
        assert all(failure.sigma >= DEFAULT_SETTINGS.failure_sigma for failure in found)
        return found

    def worst_regime(self, made: Drive) -> Failure:
        return next(failure for failure in self.places(made) if failure.regime is not None)

    def in_regime(self, made: Drive, regime: str) -> Failure:
        return next(failure for failure in self.places(made) if failure.regime == regime)

    def test_a_clean_drive_fails_nowhere(self) -> None:
        for seed in range(4):
            assert self.places(clean(seed)) == []

    def test_a_gyro_too_noisy_fails_nowhere(self) -> None:
        for seed in range(3):
            assert self.places(drive(gyro_noise=4.0, seed=seed)) == []

    @pytest.mark.parametrize(('side', 'sign'), [('left', 1.0), ('right', -1.0)])
    @pytest.mark.parametrize('error_deg_s', [0.3, -0.3])
    def test_turns_to_one_side(self, side: str, sign: float, error_deg_s: float) -> None:
        made = drive(deg(error_deg_s) * (sign * turning_rad_s(300.0) > 0.0))
        assert size_of(self.in_regime(made, f'turning {side}')) == pytest.approx(error_deg_s, rel=0.35)
        assert (self.worst_regime(made).regime or '').startswith(f'turning {side}')

    def test_fast_turns_alone(self) -> None:
        rate = turning_rad_s(300.0)
        made = drive(deg(1.0) * (rate > deg(TOP_DEG_S - 5.0)))
        assert self.worst_regime(made).regime == 'turning left faster than 80 deg/s'

    def test_some_seconds_after_a_turn(self) -> None:
        rate, error = turning_rad_s(300.0), np.zeros(3000)
        ends = np.flatnonzero((rate[:-1] > 0.0) & (rate[1:] == 0.0)) + 1
        for end in ends:
            error[end : end + 20] = deg(0.5)
        worst = self.worst_regime(drive(error))
        assert worst.regime == '0 to 2 s after a turn to the left'
        assert size_of(worst) == pytest.approx(0.5, rel=0.35)

    def test_a_stretch_of_time(self) -> None:
        """A jump of the bias shows where it happened, not in all blocks after it."""
        stretches = [failure for failure in self.places(knocked()) if failure.from_s is not None]
        assert stretches
        worst = stretches[0]
        assert worst.from_s is not None and worst.to_s is not None and worst.regime is None
        assert worst.from_s == BLOCK_S * (KNOCK_S // BLOCK_S) < worst.to_s <= knocked().seen.time_s[-1]
        assert worst.what.startswith(f'{worst.from_s:.0f} to {worst.to_s:.0f} s: ') and size_of(worst) > 0.15

    def test_a_signal_that_the_scale_goes_with(self) -> None:
        load = np.repeat(np.random.default_rng(3).uniform(0.0, 1.0, 30), 100)
        made = drive(0.03 * (load - 0.5) * turning_rad_s(300.0), signals={SIGNAL: load})
        by_signal = [item for item in self.places(made) if (item.regime or '').startswith(SIGNAL)]
        scales = [size_of(item) for item in by_signal if item.what.endswith(' %')]
        assert -1.5 < min(scales) < -0.5 and 0.5 < max(scales) < 1.5

    def test_without_odometry_there_is_no_regime_of_distance(self) -> None:
        rate, error = turning_rad_s(300.0), np.zeros(3000)
        for end in np.flatnonzero((rate[:-1] != 0.0) & (rate[1:] == 0.0)) + 1:
            error[end : end + 20] = deg(0.5)
        made = drive(error)
        still = replace(made.run, history=replace(made.run.history, distance_m=np.zeros(3000)))
        assert any(' m after a turn' in failure.what for failure in failures(made.run, made.seen))
        assert not any(' m after a turn' in failure.what for failure in failures(still, made.seen))

    def test_slow_errors_of_the_headings_are_no_failure_of_a_model_that_lacks_nothing(self) -> None:
        """In a short recording the difference of blocks tells little of them."""

        def slow_errors(seed: int) -> Array:
            rng, kept = np.random.default_rng(seed), math.exp(-DT_S / 5.0)
            steps_rad = math.sqrt(1.0 - kept**2) * math.radians(0.1) * rng.normal(size=900)
            heading_rad: Array = lfilter([1.0], [1.0, -kept], steps_rad)
            return np.diff(heading_rad, prepend=0.0) / DT_S

        drives = [drive(slow_errors(seed), duration_s=90.0, seed=seed) for seed in range(24)]
        assert sum(bool(failures(made.run, made.seen)) for made in drives) >= 6
        assert sum(bool(failures(made.run, made.seen, is_complete=True)) for made in drives) <= 2

    def test_a_large_error_is_a_failure_though_no_effect_explains_it(self) -> None:
        rate, error = turning_rad_s(300.0), np.zeros(3000)
        for end in np.flatnonzero((rate[:-1] != 0.0) & (rate[1:] == 0.0)) + 1:
            error[end : end + 20] = deg(0.5)
        made = drive(error)
        places = {failure.regime for failure in failures(made.run, made.seen, is_complete=True)}
        assert {f'0 to 2 s after a turn to the {side}' for side in ('left', 'right')} <= places
