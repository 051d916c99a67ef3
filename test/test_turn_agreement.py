"""What is mounted or wired wrongly, by the turns of gyro, wheels and images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, ImuSample, Measurement
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.turn_agreement import TurnAgreement, mounting_fault
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError, NotObservableError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

STEP_S = 0.1
BIAS_RAD_S = 0.2


def turned(ratio: float, turns: int = 2, into: TurnAgreement | None = None) -> TurnAgreement:
    """Turn to both sides at 1 rad/s, with stops between; the gyro has noise and a large bias."""
    agreement, rng = into or TurnAgreement(), np.random.default_rng(0)
    for _ in range(turns):
        for rate in [1.0] * 30 + [0.0] * 20 + [-1.0] * 30 + [0.0] * 20:
            gyro = ratio * rate + BIAS_RAD_S + 1e-3 * rng.standard_normal()
            agreement.add(gyro * STEP_S, rate * STEP_S, STEP_S)
    return agreement


@pytest.mark.parametrize(
    ('ratio', 'scale_factor', 'cause'),
    [
        (1.08, 0.926, ''),
        (0.6, 0.926, ''),
        (-1.08, -0.926, 'the gyro turns opposite to wheels and images'),
        (-1.08, 0.926, 'the gyro turns opposite to the wheels'),
        (1.08, -0.926, 'the images turn opposite to gyro and wheels: the image is mirrored'),
        (0.02, 0.926, 'the gyro does not follow the turns of the wheels'),
        (1.08, 6.0, 'no gyro has a scale factor of 6'),
    ],
)
def test_the_likely_cause_is_named(ratio: float, scale_factor: float, cause: str) -> None:
    found = turned(ratio).fault(scale_factor, 1e-4)
    assert found.startswith(cause) and bool(found) == bool(cause)


def test_wheels_in_degrees_are_named() -> None:
    found = turned(1.05 / 57.3).fault(0.926, 1e-4)
    assert found.startswith('the wheels turn 57 times as far as the gyro, as degrees would')


def test_wheels_that_turn_wherever_the_robot_drives_show_no_inverted_gyro() -> None:
    """With an encoder that stands they do, and turn against the gyro where the robot slows down to turn."""
    agreement, rng = TurnAgreement(), np.random.default_rng(3)
    ratios: list[float] = []
    for _ in range(200):
        rate, by_driving = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0)
        for _ in range(10):
            agreement.add(rate * STEP_S, (by_driving - 0.6 * rate) * STEP_S, STEP_S)
        is_loose = agreement.is_known and agreement.ratio < -0.5 and agreement.correlation > -0.8
        if is_loose:
            ratios.append(agreement.ratio)
            assert agreement.fault(0.97, 1e-4) == ''
    assert len(ratios) > 20, 'by the ratio alone it would be inverted'


def test_the_ratio_is_without_biases() -> None:
    assert turned(0.9).ratio == pytest.approx(0.9, abs=1e-3)


def test_a_gyro_that_gets_stuck_is_named_by_its_reading() -> None:
    agreement = turned(1.0)
    for step in range(25):
        if step < 15:
            assert not agreement.fault(1.0, 1e-4)
        agreement.add(5.2 * STEP_S, 1.0 * STEP_S, STEP_S)
    assert agreement.fault(1.0, 1e-4).startswith('the gyro reads 297.9 deg/s whatever the robot does')


def test_noisy_wheels_on_a_straight_lane_hide_no_turn() -> None:
    """In the time of an image their noise is larger than a turn; it adds up to no turn."""
    agreement, rng = turned(1.0), np.random.default_rng(1)
    for _ in range(6000):
        agreement.add(1e-4 * rng.standard_normal(), 0.005 * rng.standard_normal(), 0.02)
    assert agreement.fault(1.0, 1e-4) == ''
    assert agreement.ratio == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(
    ('ratio', 'cause'), [(1.0, ''), (0.0, 'the gyro does not follow the turns of the wheels')]
)
@pytest.mark.parametrize('rate_rad_s', [0.3, 1.0])
def test_a_long_turn_to_one_side(rate_rad_s: float, ratio: float, cause: str) -> None:
    """Gyro and wheels are then constant but for their noise, which tells nothing of each other."""
    agreement, rng = turned(ratio), np.random.default_rng(2)
    for _ in range(1200):
        gyro, wheels = ratio * rate_rad_s + 0.03, rate_rad_s + 0.3 * rng.standard_normal()
        agreement.add((gyro + 1e-3 * rng.standard_normal()) * STEP_S, wheels * STEP_S, STEP_S)
        found = agreement.fault(1.0, 1e-4)
        assert found.startswith(cause) and bool(found) == bool(cause)


def test_nothing_is_said_before_the_wheels_have_turned_or_the_scale_factor_is_known() -> None:
    agreement = TurnAgreement()
    for _ in range(500):
        agreement.add(0.0, 0.0, STEP_S)
    assert agreement.fault(-0.9, 0.2) == ''
    assert turned(1.0).fault(-0.9, 0.2) == ''


def inverted(item: Measurement) -> Measurement:
    if isinstance(item, ImuSample):
        x, y, z = item.rate_rad_s
        return replace(item, rate_rad_s=(x, y, -z))
    return item


def mirrored(item: Measurement) -> Measurement:
    if isinstance(item, FeatureObservations):
        return replace(item, pixels=item.pixels * [-1.0, 1.0] + [639.0, 0.0])
    return item


@pytest.mark.slow
@pytest.mark.parametrize(('change', 'who'), [(inverted, 'the gyro turns'), (mirrored, 'the images turn')])
def test_a_run_with_a_wrong_sign_has_not_converged(
    change: Callable[[Measurement], Measurement], who: str
) -> None:
    source = ModifiedSource(recording('lanes', 2, 60.0), lambda items: map(change, items))
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    assert not conclude(run).converged
    assert any(text.startswith(f'{who} opposite to') for text in model_fit(run).misfits)


def test_exchanged_axes_are_named_where_the_filter_diverges() -> None:
    def exchanged(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample):
            x, y, z = item.rate_rad_s
            return replace(item, rate_rad_s=(z, x, y))
        return item

    source = ModifiedSource(recording('cleaning', 2, 30.0), lambda items: map(exchanged, items))
    with pytest.raises(FilterDivergedError, match='an axis is mirrored or swapped'):
        calibrate(source, Config(), default_model())


@pytest.mark.parametrize(
    ('reading', 'message', 'todo'),
    [
        (0.02, 'its axes are swapped', 'check the transform to imu_link'),
        (0.0, 'it is stuck', 'check its wiring'),
    ],
)
def test_a_gyro_that_does_not_see_the_turns_is_named(reading: float, message: str, todo: str) -> None:
    def deaf(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample):
            x, y, z = item.rate_rad_s
            return replace(item, rate_rad_s=(x, y, reading * z))
        return item

    source = ModifiedSource(recording('cleaning', 2, 30.0), lambda items: map(deaf, items))
    with pytest.raises(NotObservableError, match=f'no turns: .*: .*{message}') as caught:
        calibrate(source, Config(), default_model())
    assert caught.value.todo.startswith(todo)


def test_the_scale_factor_counts_together_with_what_else_turns_the_robot() -> None:
    """Beside a scale that goes with the speed it is that at a speed at which the robot never turns."""
    run = calibrate(recording('cleaning', 1, 30.0), Config(), default_model())
    history = run.history
    wrong = replace(
        history, mean=history.mean - 0.9 * (np.arange(history.mean.shape[1]) == COEFFICIENTS_START)
    )
    assert 'no gyro has a scale factor' in mounting_fault(replace(run, history=wrong))
    compensated = replace(
        wrong,
        mean=np.column_stack([wrong.mean, np.full(len(wrong.mean), 0.9)]),
        columns=np.column_stack([wrong.columns, wrong.turn_rad]),
    )
    assert mounting_fault(replace(run, history=compensated)) == ''
