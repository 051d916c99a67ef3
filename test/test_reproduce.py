"""`gyrocal reproduce`: short versions of the experiments, the command, and the page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.bench.paper import (
    at_rest,
    convergence,
    landmark,
    mapping,
    rate_table,
    tracks,
    without_camera,
)
from gyrocal_ros.bench.paper.catalogue import EXPERIMENTS, Experiment
from gyrocal_ros.bench.paper.experiment import NOMINAL_VOLT, assess
from gyrocal_ros.cli import reproduce, reproduce_page
from gyrocal_ros.cli.main import main
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import SensorErrors

SHORT_LANES = replace(find_scenario('lanes'), duration_s=40.0)


def test_without_noise_the_proposed_form_finds_a_landmark_at_once() -> None:
    result = landmark.figure_14(map, 1)
    proposed, inverse, conventional = (method.errors_cm[0] for method in result.methods)
    assert proposed[0] == conventional[0] == pytest.approx(500.0 - 273.86, abs=0.01), 'the assumed range'
    assert inverse[0] > proposed[0], 'the same range is a larger depth'
    assert proposed[1:].max() < 0.1 and np.all(np.diff(proposed[1:]) <= 0.0)
    assert conventional[1] > 100.0 and conventional[-1] > 50.0
    assert result.moved_cm[-1] == pytest.approx(50.0)


def test_with_noise_all_forms_get_the_same_pixels_and_stay_near_the_bound() -> None:
    result = landmark.figure_15(map, 12)
    proposed, inverse, conventional = result.methods
    assert proposed.errors_cm.shape == (12, 11)
    correlation = np.corrcoef(proposed.errors_cm[:, 5], inverse.errors_cm[:, 5])[0, 1]
    assert correlation > 0.9, 'the same noise'
    assert 0.5 < proposed.rms_cm[-1] / result.bound_cm[-1] < 2.0
    assert conventional.failed > 0 and np.isnan(conventional.errors_cm).any()


def test_the_bound_is_that_of_triangulation_from_two_views() -> None:
    """After one step the error of the depth, z^2 / (f b) sqrt(2) sigma, dominates."""
    distance, height = float(np.linalg.norm(landmark.LANDMARK_M)), 2.5
    parallax = 100.0 * height / (200.0 * landmark.STEP_M) * np.sqrt(2.0) * landmark.NOISE_PX
    assert landmark.bound_cm()[1] == pytest.approx(parallax * distance, rel=0.01)


def test_the_fit_at_rest_recovers_the_simulated_parameters() -> None:
    truth = at_rest.Warmup(0.6, 6.04, 500.0)
    time_s = np.arange(5.0, 2500.0, 10.0)
    found = at_rest.fit(time_s, truth.at(time_s))
    assert found.t_s == pytest.approx(500.0, rel=0.01)
    assert (found.c1_deg_s, found.c2_deg_s) == pytest.approx((0.6, 6.04), abs=0.01)


def test_a_gyro_that_warms_up_reads_as_in_the_paper(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_rest, 'DURATION_S', 300.0)
    result = at_rest.figure_9(map, 1)
    expected = at_rest.Warmup(0.6, 6.04, 500.0).at(result.time_s)
    assert np.abs(result.read_deg_s - expected).max() < 0.02


def test_the_rate_table_measures_the_scale_factor_at_every_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rate_table, 'RATES_DEG_S', np.array([30.0, 90.0]))
    straight, straight_std = rate_table.measure_on_table(rate_table.SAMPLES[0], 0)
    assert np.all(np.abs(straight - 135.40) < 6.0 * straight_std)
    bent, _ = rate_table.measure_on_table(rate_table.SAMPLES[3], 0)
    expected = (
        135.48 + NOMINAL_VOLT * rate_table.BEND * (np.array([30.0, 90.0]) * NOMINAL_VOLT / 13548.0) ** 2
    )
    assert bent == pytest.approx(expected, abs=0.06)


def test_a_data_sheet_is_converted_to_a_wandering_bias() -> None:
    errors = without_camera.Gyro('some', 0.008, 8.0).in_robot(SensorErrors())
    noise, walk = 28.8, errors.bias_wander_deg_h * np.sqrt(2.0 / errors.bias_wander_time_s)
    time_s = np.geomspace(1.0, 1e4, 2000)
    allan = np.sqrt(noise**2 / time_s + walk**2 * time_s / 3.0)
    assert allan.min() == pytest.approx(8.0, rel=1e-3)
    usual = without_camera.GYROS[1].in_robot(SensorErrors())
    assert usual.bias_wander_deg_h == pytest.approx(SensorErrors().bias_wander_deg_h, rel=0.01)


@pytest.mark.slow
def test_ten_rotations_show_the_error_of_the_nominal_scale_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(
        find_scenario('blind_spins'),
        stages=(('lanes', 40.0), ('spins', 0.0)),
        duration_s=160.0,
        camera_until_s=40.0,
    )
    monkeypatch.setattr(without_camera, 'find_scenario', lambda name: short)
    monkeypatch.setattr(without_camera, 'RUNS', 2)
    result = without_camera.table_1(map, 2)
    assert np.sign(result.nominal_deg).tolist() == [1.0, -1.0], 'one run to each side'
    assert np.abs(result.nominal_deg) == pytest.approx([25.0, 25.0], abs=2.0)
    assert np.abs(result.calibrated_deg).max() < 3.0
    assert len(result.every_calibrated_deg) == 4


def test_each_part_has_its_own_scale_factor_in_all_its_runs() -> None:
    parts = [
        without_camera.part_of(number) for number in range(without_camera.PARTS * without_camera.REPEATS)
    ]
    assert len(set(parts)) == without_camera.PARTS
    assert parts[0] == parts[without_camera.REPEATS - 1] != parts[without_camera.REPEATS]


@pytest.mark.slow
def test_tracks_start_at_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracks, 'OFF_S', 30.0)
    monkeypatch.setattr(tracks, 'END_S', 50.0)
    result = tracks.figure_13(map, 1)
    truth, slam, blind = (result.tracks[name] for name in (tracks.TRUTH, tracks.SLAM, tracks.GYRO))
    assert slam.position_m[0] == pytest.approx(truth.position_m[0])
    assert blind.time_s[0] == pytest.approx(30.0) and blind.time_s[-1] == pytest.approx(truth.time_s[-1])
    assert 0.0 < float(result.end_errors_m[tracks.SLAM][0]) < 0.05


@pytest.mark.slow
def test_mapped_features_are_near_the_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, 'find_scenario', lambda name: SHORT_LANES)
    ceiling, path, corners, errors = mapping._lanes(0)
    assert errors.shape == (len(ceiling.ids), 2) and len(corners) == 68
    assert np.median(errors[:, 0]) < 0.02
    assert path.position_m[0] == pytest.approx([0.0, 0.0], abs=0.01)


@pytest.mark.slow
def test_convergence_is_reported_for_every_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convergence, 'DURATION_S', 25.0)
    result = convergence.figure_10(map, 1)
    assert [variety.name for variety in result.varieties] == [item.name for item in convergence.VARIANTS]
    ours = result.varieties[0]
    assert ours.first is not None and 5.0 < ours.first.settled_s == ours.settled_s[0] < 20.0
    assert ours.final_volt[0] == pytest.approx(135.5, abs=0.1)


def test_every_result_has_its_figures() -> None:
    assert len(reproduce_page.SECTIONS) == 8 and len(EXPERIMENTS) == 10
    assert list(EXPERIMENTS)[0] == 'fig7' and 'table1' in EXPERIMENTS


@pytest.fixture
def landmarks_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit the command to two quick experiments, run in this process."""
    monkeypatch.setattr(reproduce, 'in_parallel', map)
    chosen: dict[str, Experiment] = {name: EXPERIMENTS[name] for name in ('fig14', 'fig15')}
    monkeypatch.setattr(reproduce, 'EXPERIMENTS', chosen)


@pytest.mark.usefixtures('landmarks_only')
def test_the_command_writes_page_and_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['reproduce', '--seeds', '3', '--json', '-o', str(tmp_path / 'made')]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert list(printed['results']) == ['fig14', 'fig15'] and printed['results']['fig15']['seeds'] == 3
    assert printed['version'] and 'cores' in printed['machine']
    claims = printed['results']['fig14']['claims']
    assert claims[0]['verdict'] == 'holds'
    assert json.loads((tmp_path / 'made/reproduced.json').read_text()) == printed
    page = (tmp_path / 'made/report.html').read_text()
    assert 'Fig. 15' in page and claims[0]['what'] in page


@pytest.mark.usefixtures('landmarks_only')
def test_the_command_prints_which_claims_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['reproduce', 'fig14']) == 0
    out = capsys.readouterr().out
    assert 'Fig. 14' in out and 'Fig. 15' not in out and ': holds\n' in out


def test_an_unknown_name_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['reproduce', 'fig16', '-o', str(tmp_path / 'made')]) == 2
    assert 'fig1' in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_claim_holds_or_not() -> None:
    assert assess('a claim', '1 m', '2 m', True).verdict == 'holds'
    assert assess('a claim', '1 m', '0 m', False).verdict == 'does not hold'


def test_some_experiments_have_a_fixed_number_of_runs() -> None:
    assert EXPERIMENTS['fig15'].count(None) == 200 and EXPERIMENTS['fig15'].count(7) == 7
    assert EXPERIMENTS['fig11'].count(3) == EXPERIMENTS['fig11'].count(50) == 12
    assert EXPERIMENTS['table1'].count(3) == without_camera.RUNS
