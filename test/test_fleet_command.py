"""The command `gyrocal fleet`, from simulated bags to the prior of the next robot."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli import fleet as command
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.model_file import model_to_dict
from gyrocal_ros.fleet.examine import bags_to_examine
from gyrocal_ros.fleet.plan import PlannedBag
from gyrocal_ros.fleet.result import BagResult, BagScores, failed
from gyrocal_ros.fleet.store import CALIBRATIONS, SCORES, FleetStore
from gyrocal_ros.fleet.table import read_fleet
from gyrocal_ros.fleet.work import analyse, job_of
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.sim.fleet import AGEING_SPREAD, draw_fleet, draw_law
from gyrocal_ros.sim.scenarios import find_scenario

MEAN, TAU, BIAS_TAU = 1.02, 0.005, 0.002


def drawn_fleet(
    folder: Path, seed: int = 0, robots: int = 12, mean: float = MEAN, unseen: str | None = None
) -> Path:
    """Write the tables of a fleet whose results are drawn; one bag has failed.

    The model may have an effect that no bag shows, so that every bag returns its prior.
    """
    model, prior_row = default_model(), {}
    if unseen is not None:
        model = with_effect(model, find_effect(unseen))
        (item,) = model.effects[-1].coefficients
        prior_row = {unseen: item.prior_mean, f'{unseen}_std': item.prior_std}
    rng = np.random.default_rng(seed)
    planned, results = [], []
    for robot in range(robots):
        scale = mean + TAU * rng.standard_normal()
        for bag in range(2):
            planned.append(PlannedBag(f'/bags/{robot:02d}_{bag}', f'r{robot:02d}', {'age_h': 200.0 * bag}))
            row = prior_row | {
                'status': 'calibrated',
                'reason': '',
                'scale_factor': scale + 1e-4 * rng.standard_normal(),
                'scale_factor_std': 1e-4,
                'bias': BIAS_TAU * rng.standard_normal(),
                'bias_std': 1e-5,
                'converged': True,
                'temperature_c': 25.0 + 5.0 * rng.standard_normal(),
                'duration_s': 60.0,
            }
            information = np.array([[4.0]])
            score = information[0] * 0.1 + 2.0 * rng.standard_normal(1)
            scores = BagScores(('gyro_lag.tau',), ('s',), information, score, np.array([0.5]))
            results.append(BagResult(row, scores))
    planned.append(PlannedBag('/bags/broken', 'r00', {}))
    results.append(failed('is damaged <here>'))
    FleetStore(folder).write_tables(planned, results, {'model': model_to_dict(model)})
    return folder


@pytest.mark.slow
def test_bags_are_run_once_and_give_the_same_bytes_in_any_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = tmp_path / 'bags'
    simulate = [
        'simulate',
        str(bags),
        '--fleet',
        '2',
        '--bags',
        '1',
        '--duration',
        '20',
        '--scenario',
        'demo',
    ]
    assert main(simulate) == 0
    damaged = bags / 'robot_0001' / 'damaged.mcap'
    damaged.write_bytes(b'nothing')
    with (bags / 'fleet.csv').open('a', encoding='utf-8') as file:
        file.write('robot_0001/damaged.mcap,robot_0001,,\nrobot_0001/absent,robot_0001,,\n')
    capsys.readouterr()
    run = ['fleet', 'run', str(bags / 'fleet.csv'), '--json', '--workers']
    seen = {}
    for name, workers in (('one', '1'), ('two', '2')):
        assert main([*run, workers, '-o', str(tmp_path / name)]) == 0
        seen[name] = json.loads(capsys.readouterr().out)
        assert (seen[name]['calibrated'], seen[name]['failed'], seen[name]['resumed']) == (2, 2, 0)
    for name in (CALIBRATIONS, SCORES):
        assert (tmp_path / 'one' / name).read_bytes() == (tmp_path / 'two' / name).read_bytes()
    before = (tmp_path / 'one' / SCORES).read_bytes()
    assert main([*run, '1', '-o', str(tmp_path / 'one')]) == 0
    again = json.loads(capsys.readouterr().out)
    assert (again['resumed'], again['work_s']) == (3, 0.0), 'only the absent bag may appear later'
    assert (tmp_path / 'one' / SCORES).read_bytes() == before
    table = read_fleet([tmp_path / 'one'])
    assert len(set(table.columns['bag'])) == 4
    reasons = dict(zip(table.columns['bag'], table.columns['reason'], strict=True))
    assert 'damaged' in reasons[str(damaged)] and 'Traceback' not in reasons[str(damaged)]


@pytest.mark.slow
def test_a_remote_bag_is_copied_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip('fsspec')
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path / 'scratch'))
    (tmp_path / 'scratch').mkdir()
    assert main(['simulate', str(tmp_path / 'bag'), '--duration', '15', '--scenario', 'demo']) == 0
    memory = fsspec.filesystem('memory')
    memory.put(str(tmp_path / 'bag'), '/remote/bag', recursive=True)
    job = job_of(Config(), default_model())
    remote, local = analyse('memory://remote/bag', job), analyse(str(tmp_path / 'bag'), job)
    assert remote.row == local.row and remote.row['status'] == 'calibrated'
    assert list((tmp_path / 'scratch').iterdir()) == []
    gone = analyse('memory://remote/none', job)
    assert gone.row['status'] == 'failed' and not gone.is_final


def test_the_report_has_the_failed_bags_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = drawn_fleet(tmp_path / 'fleet')
    assert main(['fleet', 'report', str(folder), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary['bags'], summary['calibrated'], summary['robots']) == (25, 24, 12)
    assert summary['failed'] == [{'bag': '/bags/broken', 'reason': 'is damaged <here>'}]
    scale = summary['coefficients']['scale_factor']
    assert scale['mean']['low'] < MEAN < scale['mean']['high']
    assert scale['spread']['low'] < TAU < scale['spread']['high']
    assert set(scale['slopes']) == {'age (1000 h)', 'temperature (K)'}
    assert set(scale['robots']) == {f'r{number:02d}' for number in range(12)}
    assert summary['missing'] == [] and summary['strongest']['effect'] == 'gyro_lag'
    page = (folder / 'report.html').read_text(encoding='utf-8')
    assert 'is damaged \\u003chere>' in page and 'http://' not in page.split('<script>')[0]
    assert main(['fleet', 'report', str(folder)]) == 0
    text = capsys.readouterr().out
    assert '24 of 25 bags of 12 robots are calibrated.' in text and 'report.html' in text


def test_an_effect_that_no_bag_shows_stays_as_unknown_as_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = drawn_fleet(tmp_path / 'fleet', unseen='scale_cubic'), tmp_path / 'prior.yaml'
    assert main(['fleet', 'report', str(folder)]) == 0
    assert 'No bag tells scale_cubic' in capsys.readouterr().out
    assert main(['fleet', 'prior', str(folder), '-o', str(out)]) == 0
    prior, (item,) = load_calibration(out), find_effect('scale_cubic').coefficients
    assert prior.stds[2] == pytest.approx(item.prior_std) and prior.values[2] == item.prior_mean


def test_the_prior_starts_a_replay_and_leaves_a_robot_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = drawn_fleet(tmp_path / 'fleet', robots=30)
    out = tmp_path / 'prior.yaml'
    assert main(['fleet', 'prior', str(folder), '-o', str(out)]) == 0
    prior = load_calibration(out)
    assert prior.names == ('bias', 'scale_factor') and not prior.converged
    assert prior.scale_factor == pytest.approx(MEAN, abs=3.0 * TAU / 30**0.5)
    assert prior.scale_factor_std == pytest.approx(TAU, rel=0.4)
    assert prior.stds[0] == pytest.approx(BIAS_TAU, rel=0.4)
    assert main(['fleet', 'prior', str(folder), '-o', str(out)]) == 2, 'a file is not replaced unasked'
    without = tmp_path / 'without.yaml'
    assert main(['fleet', 'prior', str(folder), '-o', str(without), '--leave-out', 'r03']) == 0
    assert load_calibration(without).scale_factor != prior.scale_factor
    assert '29 robots' in load_calibration(without).source
    capsys.readouterr()
    assert main(['fleet', 'prior', str(folder), '-o', str(out), '--leave-out', 'r3']) == 2
    assert "there is no robot 'r3'" in capsys.readouterr().err


def test_the_studio_lists_the_bags_of_the_most_unusual_robot_first(tmp_path: Path) -> None:
    planned, results = [], []
    for robot in range(6):
        path = tmp_path / f'r{robot}' / 'bag'
        path.mkdir(parents=True)
        planned.append(PlannedBag(str(path), f'r{robot}', {}))
        row = {'status': 'calibrated', 'converged': True, 'scale_factor': 1.0 + 1e-3 * (-1) ** robot}
        results.append(BagResult(row | {'scale_factor_std': 1e-4}, None))
    results[4] = BagResult({**results[4].row, 'scale_factor': 1.2}, None)
    planned.append(PlannedBag('s3://far/bag', 'r1', {}))
    results.append(BagResult({**results[0].row}, None))
    (tmp_path / 'r0' / 'bag').rmdir()
    FleetStore(tmp_path / 'fleet').write_tables(planned, results, {'model': {}})
    listed = bags_to_examine(tmp_path / 'fleet')
    assert listed[0] == ('r4-bag', tmp_path / 'r4' / 'bag')
    assert sorted(title for title, _ in listed) == ['r1-bag', 'r2-bag', 'r3-bag', 'r4-bag', 'r5-bag']


def test_two_fleets_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = drawn_fleet(tmp_path / 'a'), drawn_fleet(tmp_path / 'b', seed=1, mean=MEAN + 0.03)
    assert main(['fleet', 'compare', str(first), str(second), '--json']) == 0
    differences = json.loads(capsys.readouterr().out)['differences']
    scale = next(item for item in differences if item['coefficient'] == 'scale_factor')
    assert scale['difference']['low'] < 0.03 < scale['difference']['high']
    assert main(['fleet', 'compare', str(first), str(tmp_path)]) == 2


def test_without_the_extra_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, 'find_spec', lambda name: None if name == 'dask' else object())
    assert main(['fleet', 'report', 'nothing']) == 2
    assert "needs dask; pip install 'gyrocal_ros[fleet]'" in capsys.readouterr().err


@pytest.mark.slow
def test_the_help_loads_no_library_of_fleets() -> None:
    code = (
        'import sys\nfrom gyrocal_ros.cli.main import command_parser\n'
        "command_parser('fleet'); command_parser('simulate')\n"
        "loaded = {'dask', 'distributed', 'pyarrow', 'fsspec', 'plotly'} & set(sys.modules)\n"
        'assert not loaded, loaded'
    )
    subprocess.run([sys.executable, '-c', code], check=True)


def test_a_simulated_fleet_follows_its_law() -> None:
    law = draw_law(3, 60.0, effects=['gyro_lag'])
    fleet = draw_fleet(law, 3, 400, 2, find_scenario('demo'), 60.0)
    healthy = [part for part in fleet.parts if not part.is_faulty]
    assert len(healthy) == 380 and len(fleet.bags) == 800
    assert np.mean([part.scale_factor for part in healthy]) == pytest.approx(law.mean, abs=0.15 * law.spread)
    assert np.std([part.scale_factor for part in healthy]) == pytest.approx(law.spread, rel=0.15)
    ageing = np.std([part.ageing_per_h for part in healthy]) / abs(law.ageing_per_h)
    assert ageing == pytest.approx(AGEING_SPREAD, rel=0.15)
    assert len({bag.seed for bag in fleet.bags}) == 800
    assert all(bag.effect is law.effect for bag in fleet.bags)
    assert draw_fleet(law, 3, 400, 2, find_scenario('demo'), 60.0) == fleet


def test_the_sealed_answer_of_a_fleet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = str(tmp_path / 'bags')
    assert (
        main(['simulate', bags, '--fleet', '2', '--bags', '1', '--duration', '1', '--scenario', 'demo']) == 0
    )
    assert main(['reveal', bags]) == 0
    assert 'ageing_per_1000_h' in capsys.readouterr().out
    assert main(['simulate', bags, '--bags', '3']) == 2
    assert main(['simulate', bags, '--fleet', '2', '--hidden']) == 2
    shutil.rmtree(bags)
    assert main(['simulate', bags, '--fleet', '2']) == 2, 'the sealed answer is still there'
