"""The regression gate, and the growth of time and memory, at small size."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.bench import gate, growth
from gyrocal_ros.bench.gate import CHECKS, Check, Figure, baseline_to_dict, load_baseline, measure_baseline
from gyrocal_ros.bench.speed import Process
from gyrocal_ros.cli import bench
from gyrocal_ros.cli.main import main
from gyrocal_ros.report.growth import growth_page
from gyrocal_ros.sim.world import SimSource


def numbers(seed: int) -> dict[str, float]:
    return {'error': float(seed % 4), 'nis_per_dof': 1.0 + 0.1 * (seed % 2)}


def worse(seed: int) -> dict[str, float]:
    return {name: 10.0 * value for name, value in numbers(seed).items()}


BASELINE = measure_baseline(map, (Check('some', 4, numbers),))


def test_tolerance_follows_from_the_scatter_over_seeds() -> None:
    error = BASELINE['some.error']
    assert error.value == 1.5 and not error.both_sides
    assert error.tolerance == pytest.approx(2.0 * np.std(4 * [0.0, 1.0, 2.0, 3.0], ddof=1) / 2.0)
    assert BASELINE['some.nis_per_dof'].both_sides


def test_the_same_code_passes_and_worse_code_does_not() -> None:
    assert all(item.passes for item in gate.gate(map, BASELINE, (Check('some', 4, numbers),)))
    assert not any(item.passes for item in gate.gate(map, BASELINE, (Check('some', 4, worse),)))


def test_smaller_errors_pass_and_smaller_nis_does_not() -> None:
    assert Figure(1.0, 0.1, both_sides=False).allows(0.2)
    assert not Figure(1.0, 0.1, both_sides=True).allows(0.2)
    assert not Figure(1.0, 0.1, both_sides=False).allows(1.2)
    assert not Figure(1.0, 0.1, both_sides=False).allows(math.nan)


@pytest.mark.slow
def test_every_figure_of_the_gate_has_a_baseline() -> None:
    baseline = load_baseline()
    landmarks = next(check for check in CHECKS if check.name == 'landmark')
    assert {name.partition('.')[0] for name in baseline} == {check.name for check in CHECKS}
    assert all(item.passes for item in gate.gate(map, baseline, (landmarks,)))
    assert all(figure.tolerance > 0.0 for figure in baseline.values())


def test_a_baseline_is_written_and_read_back(tmp_path: Path) -> None:
    file = tmp_path / 'kept.json'
    file.write_text(json.dumps(baseline_to_dict(BASELINE)), encoding='utf-8')
    assert load_baseline(file).keys() == BASELINE.keys()
    read, written = load_baseline(file)['some.error'], BASELINE['some.error']
    assert (read.value, read.both_sides) == (written.value, written.both_sides)
    assert read.tolerance == pytest.approx(written.tolerance, rel=0.01)


def test_the_command_fails_if_a_figure_exceeds_its_tolerance(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for measure, status in ((numbers, 0), (worse, 2)):
        outcomes = gate.gate(map, BASELINE, (Check('some', 4, measure),))
        monkeypatch.setattr(bench, 'gate', lambda each, baseline, outcomes=outcomes: outcomes)
        assert main(['bench', '--quick', '--json']) == status
        captured = capsys.readouterr()
        assert json.loads(captured.out)['figures']['some.error']['passes'] is (status == 0)
        assert ('some.error' in captured.err) is (status == 2)


def test_an_unknown_bench_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['bench', 'acuracy']) == 2
    assert "did you mean 'accuracy'" in capsys.readouterr().err


@pytest.mark.slow
def test_lanes_and_spins_give_figures_of_the_right_size(monkeypatch: pytest.MonkeyPatch) -> None:
    found = gate.spins(0) | gate.landmark(0)
    assert 0.0 < found['heading_error_deg'] < 2.0
    assert 0.0 < found['inverse_depth_cm'] < 20.0


def test_sizes_observe_enough_features() -> None:
    most = next(size for size in growth.sizes() if size.value == 60)
    assert most.scenario.features == 60 and most.config.features.map_size == 120
    used = growth._filter_alone(SimSource(replace(most.scenario, duration_s=3.0), 0), most.config)[1]
    assert used > 55.0


def test_growth_has_an_exponent_and_a_plot(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = [replace(size, scenario=replace(size.scenario, duration_s=2.0)) for size in growth.sizes()[:2]]
    monkeypatch.setattr(growth, 'sizes', lambda: sizes)
    costs = iter((Process(1.0, 100.0), Process(2.0, 110.0)))
    monkeypatch.setattr(growth, 'gyrocal_process', lambda *words: next(costs))
    first, second = growth.growth()
    assert first['replay_exponent'] is None
    assert second['replay_exponent'] == pytest.approx(1.0), 'twice the features, twice the time'
    assert (second['size'], second['peak_mb']) == (10, 110.0)
    page = growth_page([first, second], 'this machine')
    assert 'memory_features' in page and 'time_features' in page


def test_zero_seeds_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['bench', 'comparison', '--seeds', '0']) == 2
    assert '--seeds' in capsys.readouterr().err


def test_only_the_gate_accepts_keep(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['bench', 'speed', '--keep']) == main(['bench', '--keep']) == 2
    assert '--keep' in capsys.readouterr().err
