"""The benches: their arithmetic, and short runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.bench import accuracy, camera_off, image_speed
from gyrocal_ros.bench.accuracy import CONVENTIONAL, OURS, PAPER, accuracy_row, cases, in_parallel
from gyrocal_ros.bench.bench_run import BenchRun, Variant, bound_std, end_of_first_turn_s, run_bench
from gyrocal_ros.bench.speed import filter_alone, gyrocal_process
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

SHORT = replace(find_scenario('lanes'), duration_s=40.0)


@pytest.fixture(scope='module')
def run() -> BenchRun:
    return run_bench(SHORT, 0, OURS, with_bound=True)


@pytest.mark.slow
def test_a_run_has_errors_of_the_right_size(run: BenchRun) -> None:
    assert not run.diverged
    assert abs(run.early_error) < 1e-3 and abs(run.settled_error) < 5e-4
    assert run.nees == pytest.approx((run.final_error / run.final_std) ** 2) and run.nees < 9.0
    assert run.nis_per_dof == pytest.approx(1.0, abs=0.06)
    assert 0.0 < run.heading_rms_rad < math.radians(0.2)


@pytest.mark.slow
def test_the_standard_deviation_is_close_to_the_bound(run: BenchRun) -> None:
    assert 0.9 < run.final_std / run.bound_std < 1.1
    assert bound_std(replace(SHORT, duration_s=20.0), 0) > run.bound_std, 'a shorter run has less information'


def test_a_run_that_diverges_is_marked() -> None:
    run = run_bench(SHORT, 0, CONVENTIONAL)
    assert run.diverged and math.isnan(run.final_error)


def test_the_first_turn_ends_where_the_robot_has_turned() -> None:
    source = SimSource(SHORT, 0)
    time_s = end_of_first_turn_s(source)
    yaw = source.truth.trajectory.motion(np.array([0.0, time_s])).euler_rad[:, 2]
    rate = source.truth.trajectory.motion(np.array([time_s - 0.2, time_s + 0.2])).rate_rad_s[:, 2]
    assert abs(yaw[1] - yaw[0]) > math.radians(45.0)
    assert abs(rate[0]) > math.radians(2.0) > abs(rate[1])
    standing = SimSource(replace(find_scenario('standing'), duration_s=10.0), 0)
    assert end_of_first_turn_s(standing) == 10.0


def test_a_variant_changes_settings_and_model() -> None:
    assert OURS.config(Config()) == Config() and OURS.model().bias.form == 'drift'
    features = PAPER.config(Config()).features
    assert (features.parametrisation, features.motion_gate_m) == ('camera_frame', 0.0)
    assert PAPER.model().bias.form == 'settling'
    assert Variant('small', map_size=5).config(Config()).features.map_size == 5


def test_rows_summarise_the_seeds() -> None:
    runs = [
        BenchRun(0, 1e-3, -2e-4, 3e-5, 1e-5, 0.98, math.radians(0.1), 1e-5),
        BenchRun(1, -2e-3, 1e-4, -4e-5, 2e-5, 1.02, math.radians(0.1), 1.6e-5),
        BenchRun(2, *(math.nan,) * 6, diverged=True),
    ]
    row = accuracy_row(cases(True)[0], runs)
    assert (row['seeds'], row['diverged'], row['variant']) == (3, 1, 'inverse_depth')
    expected = {
        'early_max_percent': 0.2,
        'settled_max_percent': 0.02,
        'final_rms_percent': 100.0 * math.sqrt(12.5) * 1e-5,
        'final_max_percent': 4e-3,
        'nees': (9.0 + 4.0) / 2.0,
        'inside_3_sigma': 0.5,
        'nis_per_dof_min': 0.98,
        'nis_per_dof_max': 1.02,
        'std_by_bound_max': 1.25,
        'heading_rms_deg': 0.1,
    }
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    nothing = accuracy_row(cases(True)[0], runs[2:])
    assert nothing['final_rms_percent'] is None and nothing['nees'] is None


def test_every_case_can_be_run() -> None:
    for label, scenario, variant, _, _ in cases(quick=False):
        assert label and isinstance(scenario, Scenario) and variant.model().effects
        source = SimSource(replace(scenario, duration_s=5.0), 0)
        assert len(list(source.measurements())) > 5 * scenario.imu_hz


def negative(value: int) -> int:
    return -value


@pytest.mark.slow
def test_parallel_results_keep_the_order_of_the_tasks() -> None:
    assert list(in_parallel(negative, range(5))) == [0, -1, -2, -3, -4]


def test_the_filter_is_timed_on_measurements_in_memory() -> None:
    row = filter_alone(replace(SHORT, duration_s=5.0), repeats=1)
    assert row['times_real_time'] == pytest.approx(5.0 / row['cpu_s'])
    assert '100 Hz' in row['case']


@pytest.mark.slow
def test_the_time_of_an_image_is_that_of_tracker_and_filter() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(image_speed, 'SIMULATED_S', 6.0)
        (row,) = image_speed.image_speed([])
    assert row['images'] > 40
    assert row['decode_ms'] > 0.0
    assert row['filter_ms'] > 0.0
    assert row['tracker_ms'] + row['filter_ms'] == pytest.approx(row['beyond_decoding_ms'])


@pytest.mark.slow
def test_the_memory_of_a_process_excludes_that_of_its_parent() -> None:
    ours = np.ones(30_000_000)
    process = gyrocal_process('effects')
    assert 10.0 < process.peak_mb < 150.0 < ours.nbytes / 1e6
    with pytest.raises(RuntimeError, match='no-such-bag'):
        gyrocal_process('replay', 'no-such-bag')


@pytest.mark.slow
def test_dead_reckoning_with_the_camera_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenario is short: 40 s with the camera, then spins."""
    short = replace(
        find_scenario('blind_spins'),
        stages=(('lanes', 40.0), ('spins', 0.0)),
        duration_s=160.0,
        camera_until_s=40.0,
    )
    monkeypatch.setattr(camera_off, 'find_scenario', lambda name: short)
    calibrated, nominal = camera_off.ten_rotations(0)
    assert calibrated.heading_rad.shape == nominal.heading_rad.shape == (2,)
    assert np.degrees(np.abs(calibrated.heading_rad)).max() < 3.0
    assert np.degrees(np.abs(nominal.heading_rad)).min() > 100.0, 'the nominal scale factor is 8 % too large'


@pytest.mark.slow
def test_the_table_has_a_row_for_each_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, 'in_parallel', map)
    monkeypatch.setattr(accuracy, 'cases', lambda quick: [('short', SHORT, OURS, False, False)])
    (row,) = accuracy.accuracy(seeds=2)
    assert row['case'] == 'short' and row['seeds'] == 2 and row['diverged'] == 0
    assert row['std_by_bound_max'] is None


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (['accuracy', '--only', 'lane'], "did you mean 'lanes'?"),
        (['blind', '--only', 'none', 'scale_cubi'], "did you mean 'scale_cubic'?"),
        (['speed', '--only', 'lanes'], 'name accuracy or blind'),
        (['--only', 'lanes'], 'name accuracy or blind'),
    ],
)
def test_an_unknown_case_is_refused(
    args: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['bench', *args]) == 2
    assert message in capsys.readouterr().err
