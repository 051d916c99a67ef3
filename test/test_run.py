"""The record of a run: fields by name, growth, ground truth, events."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.data import ClockStep, TruthSample, nanoseconds
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, UpdateStats
from gyrocal_ros.ekf.history.run import (
    BLOCK_ROWS,
    SCALARS,
    TRUTH_INTERVAL_NS,
    History,
    Recorder,
    step_by_step,
)
from gyrocal_ros.ekf.history.step_record import StepRecord

K = 2
STATS = UpdateStats(nis=3.0, dof=2, log_determinant=1.5)
REST = UpdateStats(nis=1.0, dof=3, log_determinant=0.5)
UPDATE = MeasurementUpdate(
    used=7,
    rejected=2,
    dropped_ids=np.array([4, 7, 9]),
    unmoved=1,
    added=1,
    on_lens=4,
    stats=STATS,
    heading_rad=0.01,
    heading_std_rad=0.002,
    waits=True,
)


def record(time_s: float = 0.0, event: str = '', **covariates: float) -> StepRecord:
    block = replace(
        eventful_block(),
        end_ns=eventful_block().start_ns + nanoseconds(0.06),
        covariates={name: np.array([0.0, value]) for name, value in covariates.items()},
        wheels_at_rest=True,
        gap_s=0.04,
    )
    return StepRecord(
        t_ns=nanoseconds(time_s),
        mean=np.arange(9.0 + K),
        std=0.1 * np.arange(9.0 + K),
        change=np.arange(1.0 + K),
        change_variance=0.2 * np.arange(1.0 + K),
        suspected_std=0.3 * np.arange(1.0 + K),
        update=UPDATE,
        resting=REST,
        block=block,
        correction_rad=0.03,
        tilt_rad=0.004,
        columns=np.array([0.5, -0.5]),
        gyro_valid_s=0.05,
        unobserved_turn_std_rad=0.006,
        pixel_noise_px=0.3,
        stamp_noise_s=0.007,
        event=event,
        scale_change=0.02,
        scale_followed=True,
        bias_walk=8.0,
    )


def history(*records: StepRecord) -> History:
    recorder = Recorder(K)
    for item in records:
        recorder.add(item)
    return recorder.history()


def test_history_has_a_field_for_each_column() -> None:
    others = {'t_ns', 'time_s', 'mean', 'std', 'change', 'change_variance', 'suspected_std'}
    others |= {'columns', 'signals'}
    assert not others & SCALARS.keys()
    assert {field.name for field in fields(History)} == others | SCALARS.keys()


@pytest.mark.parametrize(('stats', 'resting'), [(REST, 1), (UpdateStats(), 0)])
def test_a_rest_is_one_that_the_filter_has_used(stats: UpdateStats, resting: int) -> None:
    still = replace(record(0.0).block, wheels_at_rest=True)
    assert history(replace(record(0.0), block=still, resting=stats)).resting.tolist() == [resting]


def test_each_field_of_the_history_is_that_of_the_step() -> None:
    step = record(5.0)
    block, found = step.block, history(step)
    expected = {
        'nis': 3.0,
        'dof': 2.0,
        'log_likelihood': STATS.log_likelihood + REST.log_likelihood,
        'used': 7.0,
        'rejected': 2.0,
        'dropped': 3.0,
        'on_lens': 4.0,
        'in_view': 10.0,
        'heading_innovation_rad': 0.01,
        'heading_innovation_std_rad': 0.002,
        'pixel_noise_px': 0.3,
        'stamp_noise_s': 0.007,
        'waits': 1.0,
        'dt_s': 0.06,
        'turn_rad': float(block.rate_rad_s[:, 2] @ block.dt_s),
        'correction_rad': 0.03,
        'tilt_rad': 0.004,
        'gyro_valid_s': 0.05,
        'unobserved_turn_std_rad': 0.006,
        'distance_m': float(block.distance_m.sum()),
        'temperature_c': float(block.temperature_c[-1]),
        'forward_m_s2': float(block.specific_force_m_s2[:, 0] @ block.dt_s) / 0.06,
        'resting': 1.0,
        'gap_s': 0.04,
        'wheel_turn_rad': float(block.wheel_turn_rad.sum()),
        'scale_change': 0.02,
        'scale_followed': 1.0,
        'bias_walk': 8.0,
    }
    assert expected.keys() == SCALARS.keys()
    for name, value in expected.items():
        column = getattr(found, name)
        assert column.shape == (1,) and column[0] == pytest.approx(value), name
    np.testing.assert_array_equal(found.t_ns, [nanoseconds(5.0)])
    np.testing.assert_array_equal(found.time_s, [0.0])
    np.testing.assert_array_equal(found.mean, [step.mean])
    np.testing.assert_array_equal(found.std, [step.std])
    np.testing.assert_array_equal(found.change, [step.change])
    np.testing.assert_array_equal(found.change_variance, [step.change_variance])
    np.testing.assert_array_equal(found.suspected_std, [step.suspected_std])
    np.testing.assert_array_equal(found.columns, [step.columns])
    np.testing.assert_array_equal(found.coefficients, [[9.0, 10.0]])


def test_a_step_without_a_measurement_has_no_heading_innovation() -> None:
    found = history(replace(record(), update=MeasurementUpdate(), resting=UpdateStats()))
    assert np.isnan(found.heading_innovation_rad[0]) and np.isnan(found.heading_innovation_std_rad[0])
    assert found.dof[0] == 0.0 and found.log_likelihood[0] == 0.0


@pytest.mark.slow
def test_memory_grows_with_the_steps() -> None:
    count = 2500
    found = history(*(replace(record(0.1 * i), pixel_noise_px=float(i)) for i in range(count)))
    np.testing.assert_array_equal(found.pixel_noise_px, np.arange(count))
    np.testing.assert_allclose(found.time_s, 0.1 * np.arange(count))
    assert found.mean.shape == (count, 9 + K) and found.pixel_noise_px.flags.c_contiguous


def test_a_step_takes_the_memory_that_is_documented() -> None:
    count = 10
    found = history(*(record(0.1 * i) for i in range(count)))
    assert sum(getattr(found, field.name).nbytes for field in fields(found)) / count < 450


def test_later_steps_do_not_change_a_history() -> None:
    recorder = Recorder(K)
    for i in range(10):
        recorder.add(replace(record(0.1 * i), pixel_noise_px=float(i)))
    early = recorder.history()
    for i in range(10, 3000):  # over several blocks, until the columns have grown twice
        recorder.add(replace(record(0.1 * i), pixel_noise_px=float(i)))
    np.testing.assert_array_equal(early.pixel_noise_px, np.arange(10))
    np.testing.assert_array_equal(recorder.history().pixel_noise_px, np.arange(3000))


def test_columns_are_read_step_by_step() -> None:
    count = 2 * BLOCK_ROWS + 3
    read = list(step_by_step(np.arange(count), 0.5 * np.arange(count)))
    assert read == [(i, 0.5 * i) for i in range(count)]
    assert [type(number) for number in read[-1]] == [int, float]
    assert list(step_by_step(np.empty(0), np.empty(0))) == []


def test_an_empty_history_has_all_columns() -> None:
    found = history()
    assert found.time_s.shape == found.nis.shape == (0,) and found.mean.shape == (0, 9 + K)


def test_other_signals_are_nan_where_they_were_not_recorded() -> None:
    recorder = Recorder(K)
    for step in (record(0.0), record(0.1, fan=4.0), record(0.2, fan=5.0, load=6.0), record(0.3, load=7.0)):
        recorder.add(step)
    assert recorder.signal_names == ('fan', 'load')
    nan = np.nan
    np.testing.assert_array_equal(recorder.history().signals, [[nan, nan], [4, nan], [5, 6], [nan, 7]])


def test_steps_of_the_clock_do_not_count_as_time() -> None:
    recorder = Recorder(K)
    recorder.add(record(1.0))
    recorder.add_clock_step(ClockStep(nanoseconds(101.1), nanoseconds(100.0)))
    recorder.add(record(101.2))
    found = recorder.history()
    np.testing.assert_allclose(found.time_s, [0.0, 0.2])
    np.testing.assert_array_equal(found.t_ns, [nanoseconds(1.0), nanoseconds(101.2)])
    (event,) = recorder.events
    assert event.t_ns == nanoseconds(101.1) and event.text.startswith('the clock stepped by +100.0 s')


def test_events_of_steps_are_kept_with_their_stamps() -> None:
    recorder = Recorder(K)
    recorder.add(record(1.0))
    recorder.add(record(2.0, 'a new map was started'))
    assert [(event.t_ns, event.text) for event in recorder.events] == [
        (nanoseconds(2.0), 'a new map was started')
    ]


def test_ground_truth_is_thinned_and_unwrapped() -> None:
    recorder = Recorder(K)
    recorder.add(record(0.0))
    assert recorder.truth() is None
    for tick in range(300):
        yaw_rad = float(np.angle(np.exp(0.2j * tick)))
        recorder.add_truth(TruthSample(tick * TRUTH_INTERVAL_NS // 2, (0.1 * tick, 0.0, 0.0), yaw_rad))
    truth = recorder.truth()
    assert truth is not None and len(truth.time_s) == 150
    np.testing.assert_allclose(truth.time_s, 0.02 * np.arange(150))
    np.testing.assert_allclose(truth.yaw_rad, 0.4 * np.arange(150), atol=1e-9)
    np.testing.assert_allclose(truth.position_m[:, 0], 0.2 * np.arange(150))


def test_score_statistics_are_there_with_candidates_alone() -> None:
    assert Recorder(K).scores() is None
    recorder = Recorder(K, (find_effect('scale_cubic'),))
    information, score = np.array([[2.0]]), np.array([3.0])
    with_scores = replace(STATS, information=information, score=score)
    for time_s in (0.0, 9.0, 11.0):
        recorder.add(replace(record(time_s), update=replace(UPDATE, stats=with_scores), resting=with_scores))
    scores = recorder.scores()
    assert scores is not None
    np.testing.assert_array_equal(scores.start_s, [0.0, 10.0])
    np.testing.assert_array_equal(scores.information[:, 0, 0], [8.0, 4.0])
    np.testing.assert_array_equal(scores.score[:, 0], [12.0, 6.0])
