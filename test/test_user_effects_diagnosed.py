"""An effect in a file of the user's is diagnosed exactly as the same effect in the library.

The source file of a built-in effect is copied under other names and takes its place. Verdict, rank and
numbers have to stay.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import ModifiedSource, each, recording
from synthetic import banded, readings_of
from test_own_effects import blocks_of_the_guide

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ImuSample, Measurement, Source
from gyrocal_ros.diagnose.analysis.candidates import candidates_for
from gyrocal_ros.diagnose.analysis.limits import Competition, propose_limits
from gyrocal_ros.diagnose.analysis.ranking import estimate, estimate_stds
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.registry import load_file
from gyrocal_ros.effects.traits import why_unobservable
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, ScannedColumns, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect

DEG = math.radians(1.0)
DEAD_RAD_S = 0.4 * DEG
OWN = 'own_'
"""Beginning of the names of the copied effects."""


@dataclass(frozen=True)
class Case:
    """An effect hidden in a short recording."""

    name: str
    values: tuple[float, ...]
    seed: int = 3
    duration_s: float = 45.0
    dead_rad_s: float = 0.0
    """Width of a dead band behind the noise."""
    camera_hz: int = 5
    """Half the usual images, where they show the effect as well."""

    def source(self) -> Source:
        hidden = (HiddenEffect(find_effect(self.name), self.values),) if self.values else ()
        made = recording('cleaning', self.seed, self.duration_s, hidden, camera_hz=self.camera_hz)
        return ModifiedSource(made, each(ImuSample, self._dead)) if self.dead_rad_s else made

    def _dead(self, sample: ImuSample) -> Measurement:
        roll, pitch, yaw = sample.rate_rad_s
        return replace(sample, rate_rad_s=(roll, pitch, 0.0 if abs(yaw) < self.dead_rad_s else yaw))


CASES = {
    'with a time constant': Case('bias_warmup', (1.5 * DEG, 60.0)),
    'with forms and a memory': Case('turn_hysteresis', (0.8 * DEG, 8.0), camera_hz=10),
    'a limit that a run confirms': Case('rate_saturation', (0.4,), camera_hz=10),
    'a limit that the readings prove': Case('rate_deadband', (), dead_rad_s=DEAD_RAD_S),
    'with a required signal': Case('bias_temperature', (0.05 * DEG,), duration_s=60.0),
    'of the images': Case('camera_time_offset', (0.03,)),
    'that breaks the filter': Case('camera_tilt', (20.0 * DEG, 0.0), seed=4, duration_s=60.0),
    'of the images, that breaks it': Case('camera_time_offset', (0.25,), seed=4, duration_s=60.0),
    'observable with a lever only': Case('wheel_scale', (0.2,), seed=4),
}
LONG = ('that breaks the filter', 'a limit that a run confirms')
"""Cases whose search has many runs."""


@contextmanager
def instead_of(name: str, folder: Path, change: Callable[[str], str] = str) -> Iterator[LibraryEffect]:
    """Replace a built-in effect by a user's copy of its file.

    Args:
        name: name of the built-in effect.
        folder: folder of the user's file.
        change: changes the source text of the copy.
    """
    before, built_in = dict(EFFECTS), type(EFFECTS[name])
    text = Path(inspect.getfile(built_in)).read_text(encoding='utf-8')
    text = re.sub(rf'\b{built_in.__name__}\b', f'Own{built_in.__name__}', text)
    assert text.count(f"'{name}'") == 1
    file = folder / 'my_effects.py'
    file.write_text(change(text.replace(f"'{name}'", f"'{OWN}{name}'")), encoding='utf-8')
    try:
        (effect,) = load_file(file)
        del EFFECTS[name]
        yield effect
        del sys.modules[type(effect).__module__]
    finally:
        EFFECTS.clear()
        EFFECTS.update(before)


@cache
def prepared(case: Case) -> tuple[Source, Config, RecordingSummary]:
    """Simulate and read a recording, once."""
    source, config = preload(case.source(), Config(), default_model())
    return source, config, summarise_recording(source)


def searched(case: Case) -> tuple[Search, RecordingSummary, list[tuple[str, ...]]]:
    """Search for what the default model lacks; return the models that were run, too."""
    models: list[tuple[str, ...]] = []
    source, config, recorded = prepared(case)

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        models.append(tuple(effect.name.removeprefix(OWN) for effect in model.effects))
        return calibrate(source, config, model, candidates=candidates)

    return search(default_model(), recorded, run, most=1), recorded, models


def outcome(case: Case) -> dict[str, Any]:
    """Diagnose a recording; names of copied effects are those of the built-in ones."""
    found, recorded, models = searched(case)
    diagnosis = diagnose(found, recorded)
    structures = (found.first.unexplained_structure, found.last.unexplained_structure)

    def name(effect: Effect) -> str:
        return effect.name.removeprefix(OWN)

    def names(several: tuple[str, ...]) -> list[str]:
        return [item.removeprefix(OWN) for item in several]

    return {
        'verdict': diagnosis.verdict,
        'models': sorted(models),
        'missing': [
            {
                'name': name(item.effect),
                'values': item.values.tolist(),
                'stds': item.stds.tolist(),
                'gain': [item.gain, item.sigma, item.p_value],
                'drift': [item.drift_before_deg, item.drift_after_deg],
                'confused_with': names(item.confused_with),
            }
            for item in diagnosis.missing
        ],
        'ranked': [
            {
                'name': name(item.effect),
                'values': estimate(item).tolist(),
                'stds': estimate_stds(item).tolist(),
                'gain': [item.fit.gain, item.merit, item.fit.sigma, item.fit.p_value],
                'significant': [item.is_significant, item.could_show],
            }
            for item in diagnosis.ranked
        ],
        'additions': [
            {
                'name': name(item.effect),
                'prior': [(about.prior_mean, about.prior_std) for about in item.effect.coefficients],
                'kept': [item.is_kept, item.stands_out, item.predictive_gain, item.gain],
                'outperformed': names(item.outperformed),
                'recovered': item.before is None,
            }
            for item in found.additions
        ],
        'not_judged': sorted((key.removeprefix(OWN), why) for key, why in diagnosis.not_judged.items()),
        'structures': [(item.what, item.gain, item.sigma) for item in structures if item is not None],
        'fails_where': [(item.what, item.sigma) for item in diagnosis.fails_where],
    }


@cache
def built_in(case: Case) -> dict[str, Any]:
    return outcome(case)


def assert_same(found: Any, expected: Any, where: str = '') -> None:
    """Compare numbers to 1e-9 of their size, everything else exactly."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys(), where
        for key in expected:
            assert_same(found[key], expected[key], f'{where}.{key}')
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected), where
        for place, (one, other) in enumerate(zip(found, expected, strict=True)):
            assert_same(one, other, f'{where}[{place}]')
    elif isinstance(expected, float):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12, nan_ok=True), where
    else:
        assert found == expected, where


def without_columns_at(text: str) -> str:
    """Remove the method `columns_at` from the source of an effect."""
    shorter = re.sub(r'    def columns_at\(.*?\n(?=\n|\Z)', '', text, flags=re.S)
    assert shorter.count('def ') == text.count('def ') - 1
    return shorter


@pytest.mark.slow
@pytest.mark.parametrize(
    'case',
    [
        pytest.param(case, id=name, marks=[pytest.mark.thorough] * (name in LONG))
        for name, case in CASES.items()
    ],
)
def test_a_copy_is_diagnosed_as_the_effect_itself(case: Case, tmp_path: Path) -> None:
    expected = built_in(case)
    assert [item['name'] for item in expected['missing']] == [case.name]
    with instead_of(case.name, tmp_path) as effect:
        assert effect.name == f'{OWN}{case.name}' and case.name not in EFFECTS
        assert_same(outcome(case), expected)
    assert case.name in EFFECTS and effect.name not in EFFECTS


@pytest.mark.slow
@pytest.mark.parametrize('name', ['with a time constant', 'with forms and a memory'])
def test_a_copy_without_columns_at_is_diagnosed_as_well(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    expected = built_in(case)  # before its effect is replaced
    with instead_of(case.name, tmp_path, without_columns_at) as effect:
        assert not isinstance(effect, ScannedColumns)
        assert_same(outcome(case), expected)


@pytest.mark.thorough
def test_the_filter_recovers_with_a_copy() -> None:
    """The case of the table in which the first run diverges is one of recovery."""
    (added,) = built_in(CASES['that breaks the filter'])['additions']
    assert added['recovered'] and added['name'] == 'camera_tilt'
    assert len(built_in(CASES['that breaks the filter'])['models']) > 5


def test_a_dead_band_hidden_by_noise_is_proposed_from_the_scan_of_a_copy(tmp_path: Path) -> None:
    made, others = banded(0.3 * DEG), Competition(lacks_something=True)

    def proposed() -> tuple[str, float]:
        (found,) = propose_limits(made.run, made.seen, readings_of(made), others, DEFAULT_SETTINGS)
        return found.effect.name, found.effect.coefficients[0].prior_mean

    name, width = proposed()
    assert name == 'rate_deadband'
    with instead_of(name, tmp_path):
        assert proposed() == (f'{OWN}{name}', width)


def test_a_copy_says_itself_where_it_cannot_be_observed(tmp_path: Path) -> None:
    recorded = summarise_recording(CASES['observable with a lever only'].source())
    mount = replace(recorded.rig.camera_mount, p_bs=np.array([0.0, 0.0, 0.1]))
    centred = replace(recorded, rig=replace(recorded.rig, camera_mount=mount))
    expected = why_unobservable(find_effect('wheel_scale'), centred)
    with instead_of('wheel_scale', tmp_path) as effect:
        assert why_unobservable(effect, centred) == expected != ''
        assert why_unobservable(effect, recorded) == ''
        names = [
            {item.effect.name for item in candidates_for(default_model(), r).candidates}
            for r in (centred, recorded)
        ]
        assert [effect.name in found for found in names] == [False, True]


class TestGuide:
    """The effect of docs/your_own_effect.md needs a recorded signal."""

    @pytest.fixture
    def low_supply(self, tmp_path: Path) -> Iterator[LibraryEffect]:
        (code,) = blocks_of_the_guide('python')
        file, before = tmp_path / 'my_effects.py', dict(EFFECTS)
        file.write_text(code, encoding='utf-8')
        (effect,) = load_file(file)
        yield effect
        EFFECTS.clear()
        EFFECTS.update(before)

    def test_it_declares_the_signal(self, low_supply: LibraryEffect) -> None:
        assert low_supply.about.needs == ('battery_state.voltage',)
        assert not hasattr(low_supply, 'signal')

    def test_it_is_a_candidate_where_the_signal_is_recorded(self, low_supply: LibraryEffect) -> None:
        recorded = summarise_recording(recording('cleaning', 3, 5.0))
        assert low_supply.about.needs[0] in recorded.recorded
        lacking = replace(recorded, recorded=recorded.recorded - {low_supply.about.needs[0]})
        assert why_unobservable(low_supply, recorded) == ''
        assert why_unobservable(low_supply, lacking) == 'not recorded: battery_state.voltage'

    @pytest.mark.slow
    def test_it_is_found(self, low_supply: LibraryEffect) -> None:
        found, recorded, _ = searched(Case(low_supply.name, (0.1,), duration_s=120.0))
        diagnosis = diagnose(found, recorded)
        (missing,) = diagnosis.missing
        assert missing.effect.name == low_supply.name and diagnosis.ranked[0].effect.name == low_supply.name
        assert abs(missing.values[0] - 0.1) < 4.0 * missing.stds[0] < 0.02
        assert missing.drift_after_deg < 0.5 * missing.drift_before_deg
        assert low_supply.name not in diagnosis.not_judged
