"""Thresholds of the diagnosis: their declarations, their page, and `bench blind --set`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from gyrocal_ros.bench import blind as bench
from gyrocal_ros.bench.blind import BlindResult, run_blind
from gyrocal_ros.bench.blind_cases import Case, cases
from gyrocal_ros.cli import bench as command
from gyrocal_ros.cli.main import main
from gyrocal_ros.diagnose.settings import (
    DEFAULT_SETTINGS,
    DiagnosisSettings,
    described,
    differing,
    markdown_table,
    with_thresholds,
)
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.sim.scenarios import find_scenario

PACKAGE = Path(__file__).resolve().parent.parent
PAGE = PACKAGE / 'docs' / 'diagnosis_settings.md'
UNITS = {'sigma', 'nat', '1', 's', 'deg/sqrt(s)'}
Output = pytest.CaptureFixture[str]


@pytest.mark.parametrize('item', fields(DiagnosisSettings), ids=lambda item: item.name)
def test_a_threshold_is_declared_with_unit_meaning_and_guard(item: Any) -> None:
    assert set(item.metadata) == {'unit', 'meaning', 'guard'}
    assert item.metadata['unit'] in UNITS
    assert len(item.metadata['meaning']) > 20 and item.metadata['guard']
    assert not item.metadata['meaning'].endswith('.')
    assert isinstance(item.default, int | float) and item.default > 0


def test_every_threshold_is_used() -> None:
    code = '\n'.join(path.read_text(encoding='utf-8') for path in (PACKAGE / 'gyrocal_ros').rglob('*.py'))
    for item in fields(DiagnosisSettings):
        assert re.search(rf'(settings|SETTINGS)\.{item.name}\b', code), item.name


def test_thresholds_are_described() -> None:
    rows = {row['name']: row for row in described()}
    assert list(rows) == [item.name for item in fields(DiagnosisSettings)]
    assert rows['min_predictive_gain']['value'] == 3.0 and rows['min_predictive_gain']['unit'] == 'nat'
    other = replace(DEFAULT_SETTINGS, min_predictive_gain=5.0)
    assert {row['name']: row for row in described(other)}['min_predictive_gain']['value'] == 5.0


def test_the_page_describes_every_threshold() -> None:
    page = PAGE.read_text(encoding='utf-8')
    assert markdown_table() in page, 'paste the output of `markdown_table`'
    for row in described():
        cells = f'| `{row["name"]}` | {row["value"]:g} | {row["unit"]} | {row["meaning"]} | {row["guard"]} |'
        assert cells in page.splitlines()


class TestAssignments:
    def test_values_are_parsed(self) -> None:
        found = with_thresholds(['significant_sigma=3.5', 'max_rivals=0', 'map_walk_deg=1e-3'], '--set')
        expected = replace(DEFAULT_SETTINGS, significant_sigma=3.5, max_rivals=0, map_walk_deg=1e-3)
        assert found == expected and isinstance(found.max_rivals, int)
        assert differing(found) == {'significant_sigma': 3.5, 'max_rivals': 0, 'map_walk_deg': 1e-3}

    def test_nothing_given_is_the_default(self) -> None:
        assert with_thresholds([], '--set') == DEFAULT_SETTINGS and differing(DEFAULT_SETTINGS) == {}
        assert differing(with_thresholds(['significant_sigma=4'], '--set')) == {}

    def test_the_last_value_counts(self) -> None:
        found = with_thresholds(['significant_sigma=3', 'significant_sigma=5'], '--set')
        assert found.significant_sigma == 5.0

    @pytest.mark.parametrize(
        ('text', 'message'),
        [
            (
                'signifcant_sigma=3',
                "--set: 'signifcant_sigma' is not known; did you mean 'significant_sigma'?",
            ),
            ('significant_sigma', "significant_sigma is ''; give NAME=NUMBER"),
            ('significant_sigma=three', "significant_sigma is 'three'; give NAME=NUMBER"),
            ('significant_sigma=nan', "significant_sigma is 'nan'; give a finite number"),
            ('significant_sigma=inf', "significant_sigma is 'inf'; give a finite number"),
            ('significant_sigma=-1', "significant_sigma is '-1'; give a finite number, 0 or more"),
            ('max_rivals=1.5', "max_rivals is '1.5'; give NAME=WHOLE_NUMBER"),
            ('=3', "'' is not known"),
        ],
    )
    def test_other_assignments_are_refused(self, text: str, message: str) -> None:
        with pytest.raises(ConfigError, match=re.escape(message)):
            with_thresholds([text], '--set')


class TestSweep:
    def test_the_diagnosis_of_a_case_has_the_settings(self, monkeypatch: pytest.MonkeyPatch) -> None:
        class Seen(Exception):
            """Ends the trial where the search begins."""

        def find_missing(*args: Any, settings: DiagnosisSettings) -> None:
            assert settings == DiagnosisSettings(significant_sigma=3.5)
            raise Seen

        monkeypatch.setattr(bench, 'find_missing', find_missing)
        scenario = replace(find_scenario('cleaning'), duration_s=5.0)
        monkeypatch.setattr(bench, 'find_scenario', lambda name: scenario)
        with pytest.raises(Seen):
            run_blind(Case('none'), 0, DiagnosisSettings(significant_sigma=3.5))

    @pytest.fixture
    def trials(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> list[tuple[Case, int, DiagnosisSettings, object, bool]]:
        """Record the trials of the command instead of running them."""
        tasks: list[tuple[Case, int, DiagnosisSettings, object, bool]] = []

        def in_order(
            function: object, given: list[tuple[Case, int, DiagnosisSettings, object, bool]]
        ) -> Iterator[Any]:
            tasks.extend(given)
            for case, seed, *_ in given:
                yield BlindResult(case, seed, (), is_costly=False, shown=(), drift_known_deg=0.1)

        monkeypatch.setattr(bench, 'in_parallel', in_order)
        monkeypatch.setattr(command, 'provenance', lambda: {'version': '0', 'machine': 'm'})
        return tasks

    def test_the_command_passes_thresholds(
        self, trials: list[tuple[Case, int, DiagnosisSettings, object, bool]], capsys: Output
    ) -> None:
        args = ['bench', 'blind', '--seeds', '2', '--only', 'none', '--set', 'significant_sigma=3.5']
        assert main([*args, '--set', 'max_rivals=1', '--json']) == 0
        expected = DiagnosisSettings(significant_sigma=3.5, max_rivals=1)
        assert trials == [(cases()[0], seed, expected, None, False) for seed in (0, 1)]
        printed = json.loads(capsys.readouterr().out)
        assert printed['settings'] == {'significant_sigma': 3.5, 'max_rivals': 1}
        assert [row['hidden'] for row in printed['benches']['blind']] == ['none', 'all']

    def test_without_thresholds_the_default_holds(
        self, trials: list[tuple[Case, int, DiagnosisSettings, object, bool]], capsys: Output
    ) -> None:
        assert main(['bench', 'blind', '--seeds', '1', '--only', 'none', '--json']) == 0
        assert [settings for _, _, settings, *_ in trials] == [DEFAULT_SETTINGS]
        assert json.loads(capsys.readouterr().out)['settings'] == {}

    def test_the_command_passes_that_every_seed_draws_another_robot(
        self, trials: list[tuple[Case, int, DiagnosisSettings, object, bool]]
    ) -> None:
        args = ['bench', 'blind', '--seeds', '1', '--only', 'none', '--json']
        assert main([*args, '--varied']) == 0 and main(args) == 0
        assert [varied for *_, varied in trials] == [True, False]
        assert main([*args, '--varied', '--images']) == 2

    def test_the_table_is_headed_by_the_thresholds(
        self, trials: list[tuple[Case, int, DiagnosisSettings, object, bool]], capsys: Output
    ) -> None:
        assert main(['bench', 'blind', '--seeds', '1', '--only', 'none', '--set', 'nonzero_sigma=2']) == 0
        assert capsys.readouterr().out.startswith('blind: gyrocal 0, m, nonzero_sigma = 2\n')
        assert len(trials) == 1

    @pytest.mark.parametrize(
        ('args', 'message'),
        [
            (['blind', '--set', 'structure_sgma=3'], "did you mean 'structure_sigma'?"),
            (
                ['accuracy', '--set', 'structure_sigma=3'],
                '--set: is only for the bench blind; name blind',
            ),
            (['--set', 'structure_sigma=3'], '--set: is only for the bench blind; name blind'),
        ],
    )
    def test_other_thresholds_and_benches_are_refused(
        self, args: list[str], message: str, capsys: Output
    ) -> None:
        assert main(['bench', *args]) == 2
        assert message in capsys.readouterr().err
