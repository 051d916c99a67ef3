"""The commands `diagnose`, `compare` and `improve` on short simulated bags."""

from __future__ import annotations

import argparse
import json
import math
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.cli import improve
from gyrocal_ros.cli.bag_runs import BagRuns
from gyrocal_ros.cli.diagnose import add_arguments, as_text, next_steps
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import TruthSample
from gyrocal_ros.diagnose.advice import CAUTION, FINER_STEPS, advice
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit
from gyrocal_ros.diagnose.analysis.shapes import RATE, UnexplainedStructure, shapes
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.diagnose.search.timing import TimingFault
from gyrocal_ros.diagnose.status import diagnosis_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.covariate import covariate_bias
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.files import json_text
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.pipeline.in_memory import InMemorySource, preload
from gyrocal_ros.sim.hidden import DrawnEffect, hide

Output = pytest.CaptureFixture[str]
ASYMMETRY = 0.01
DURATION_S = 120.0


def bag_of(path: Path, *drawn: DrawnEffect, with_truth: bool = True, duration_s: float = DURATION_S) -> Path:
    """Write a short bag with hidden effects."""
    source = recording('cleaning', 3, duration_s, hide(drawn, find_effect), camera_hz=5)
    with new_bag(path) as bag:
        bag.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
        for measurement in source.measurements():
            if with_truth or not isinstance(measurement, TruthSample):
                bag.write(measurement)
    return path


@pytest.fixture(scope='module')
def skewed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a gyro that reads turns to one side larger."""
    return bag_of(tmp_path_factory.mktemp('bags') / 'skewed', DrawnEffect('scale_asymmetry', (ASYMMETRY,)))


@pytest.fixture(scope='module')
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag without hidden effects and without ground truth."""
    return bag_of(tmp_path_factory.mktemp('bags') / 'plain', with_truth=False)


@pytest.fixture(scope='module')
def brief(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same for a minute."""
    return bag_of(tmp_path_factory.mktemp('bags') / 'brief', with_truth=False, duration_s=60.0)


def read_json(capsys: Output) -> dict[str, Any]:
    """Return the JSON that a command has printed, which has no NaN and no infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f'{word} in JSON')

    found: dict[str, Any] = json.loads(capsys.readouterr().out, parse_constant=refuse)
    return found


@pytest.fixture(scope='module')
def searched() -> tuple[Search, Diagnosis]:
    """The diagnosis of the bag `skewed`, by the library."""
    source = recording(
        'cleaning',
        3,
        DURATION_S,
        hide([DrawnEffect('scale_asymmetry', (ASYMMETRY,))], find_effect),
        camera_hz=5,
    )
    held, config = preload(source, Config(), default_model())
    recorded = summarise_recording(held)
    found = search(
        default_model(),
        recorded,
        lambda model, candidates: calibrate(held, config, model, candidates=candidates),
    )
    return found, diagnose(found, recorded)


class TestDiagnose:
    @pytest.mark.slow
    def test_the_json_that_scripts_rely_on(self, skewed: Path, tmp_path: Path, capsys: Output) -> None:
        out = tmp_path / 'out'
        assert main(['diagnose', str(skewed), '--json', '-o', str(out)]) == 0
        found = read_json(capsys)
        assert found['verdict'] == 'effect_found' and found['unexplained'] is None
        (missing,) = found['missing']
        assert missing['effect'] == 'scale_asymmetry' and missing['confused_with'] == []
        (value,) = missing['coefficients'].values()
        assert value['unit'] == '1' and abs(value['value'] - ASYMMETRY) < 4.0 * value['std'] < 1e-3
        assert missing['log_likelihood_gain'] > 100.0 and missing['significance_sigma'] > 4.5
        assert 0.0 <= missing['p_value'] < 1e-5
        assert missing['held_out_drift_after_deg'] < 0.5 * missing['held_out_drift_before_deg']
        assert found['fails_where']
        for failure in found['fails_where']:
            assert failure['what'] and failure['sigma'] > 4.5
            assert ('regime' in failure) != ('from_s' in failure and 'to_s' in failure)
        assert found['ranked'][0]['effect'] == 'scale_asymmetry'
        assert found['drift_reference'] == 'ground truth'
        assert found['duration_s'] == pytest.approx(DURATION_S, abs=1.0) and found['wall_s'] > 0.0
        assert isinstance(found['advice'], list) and isinstance(found['not_judged'], dict)
        assert {item.name for item in out.iterdir()} >= {'diagnosis.json', 'report.html'}

    @pytest.mark.slow
    def test_a_bag_without_hidden_effects(self, plain: Path, capsys: Output) -> None:
        assert main(['diagnose', str(plain)]) == 0
        printed = capsys.readouterr().out
        assert printed.startswith('[green] Nothing is missing')
        assert 'The most significant effect was' in printed and 'gyrocal add' not in printed

    @pytest.mark.slow
    def test_as_text(self, searched: tuple[Search, Diagnosis]) -> None:
        lines = list(as_text(searched[1]))
        assert lines[0] == '[yellow] Missing: scale_asymmetry.'
        (found,) = (match for line in lines if '->' in line and (match := re.search(r'c = ([\d.]+)', line)))
        assert float(found[1]) == pytest.approx(ASYMMETRY, rel=0.05)
        assert 'Where the model fails, worst first:' in lines

    @pytest.mark.slow
    def test_camera_effects_cannot_be_judged_without_a_camera(
        self, searched: tuple[Search, Diagnosis]
    ) -> None:
        source = recording('cleaning', 3, 5.0)
        recorded = summarise_recording(
            InMemorySource(source.name, replace(source.rig, camera=None), source.span, ())
        )
        not_judged = diagnose(searched[0], recorded).not_judged
        assert not_judged['camera_tilt'] == 'not recorded: images of the ceiling'
        assert 'looks the same' in not_judged['gyro_lag'], 'as the time offset of a heading reference'

    @pytest.mark.slow
    def test_the_next_command_can_be_copied(self, searched: tuple[Search, Diagnosis], tmp_path: Path) -> None:
        model = tmp_path / 'my model.yaml'
        parser = argparse.ArgumentParser()
        add_arguments(parser)
        args = parser.parse_args(['my bag', '-r', 'imu/data_raw:=/imu', '--model', str(model)])
        missing = searched[1].missing[0]
        saturation = with_means(find_effect('rate_saturation'), (1.0472,))
        current = covariate_bias('battery_state.current', reference=-1.61605, spread=0.5)
        several = tuple(replace(missing, effect=effect) for effect in (missing.effect, saturation, current))
        lines = list(next_steps(replace(searched[1], missing=several), args))
        assert f"gyrocal improve 'my bag' -r imu/data_raw:=/imu --model '{model}' -o improved" in lines[5]
        for line in lines[2:5]:
            assert main(shlex.split(line.partition(': ')[2])[1:]) == 0
        _, asymmetry, limit, bias = load_model(model).effects
        assert asymmetry.coefficients[0].prior_mean == pytest.approx(missing.values[0], rel=1e-3)
        assert asymmetry.coefficients[0].prior_std == pytest.approx(
            missing.effect.coefficients[0].prior_std, rel=0.05
        )
        assert limit.coefficients[0].prior_mean == pytest.approx(1.0472, rel=1e-7)
        assert getattr(bias, 'reference') == -1.61605  # noqa: B009

    def test_effects_that_look_alike_are_named_with_the_drive_that_separates_them(
        self, searched: tuple[Search, Diagnosis]
    ) -> None:
        missing = replace(searched[1].missing[0], confused_with=('scale_quadratic',))
        unsure = replace(searched[1], verdict='cannot_tell', missing=(missing,))
        printed = '\n'.join(as_text(unsure))
        assert 'Missing: scale_asymmetry (not distinguishable here from scale_quadratic).' in printed
        assert any('scale_asymmetry' in text and 'scale_quadratic' in text for text in advice(unsure))

    @pytest.mark.slow
    def test_an_effect_is_told_from_zero_whatever_is_suspected_of_the_camera(
        self, searched: tuple[Search, Diagnosis]
    ) -> None:
        kept = searched[0].kept[0]
        history = kept.after.run.history
        suspected = replace(history, suspected_std=np.ones_like(history.suspected_std))
        after = replace(kept.after, run=replace(kept.after.run, history=suspected))
        assert kept.distance_from_zero(after) == kept.distance_from_zero(kept.after) > 10.0

    @pytest.mark.slow
    def test_a_coarse_converter_makes_the_verdict_uncertain(self, searched: tuple[Search, Diagnosis]) -> None:
        search_, diagnosis = searched
        source = recording('cleaning', 3, DURATION_S, camera_hz=5)
        fine = summarise_recording(preload(source, Config(), default_model())[0])
        step = math.radians(0.5)
        rate = step * np.round(fine.readings.rate_rad_s / step) + math.radians(0.1)
        coarse = replace(fine, readings=replace(fine.readings, rate_rad_s=rate))
        assert diagnose(search_, fine).verdict == 'effect_found'
        unsure = diagnose(search_, coarse)
        assert unsure.verdict == 'cannot_tell' and unsure.coarse_step_rad_s == pytest.approx(step)
        assert 'steps of 0.5 deg/s' in diagnosis_status(unsure).sentence
        assert 'scale_asymmetry' in diagnosis_status(unsure).sentence
        assert any('finer range' in text for text in advice(unsure))
        clean = replace(unsure, missing=(), verdict='nothing_missing')
        assert diagnosis_status(clean).sentence.startswith('The model fits as a whole')
        shape = shapes(search_.last.run, search_.last.seen)[0]
        strange = UnexplainedStructure('the scale goes with time', 80.0, 9.0, shape)
        last = replace(search_.first, unexplained_structure=strange)
        by_steps = diagnose(replace(search_, first=last, additions=()), coarse)
        assert by_steps.verdict == 'cannot_tell' and by_steps.unexplained is strange
        status = diagnosis_status(by_steps)
        assert status.sentence.endswith('wider than its noise; these cause the errors.')
        assert status.next_step == FINER_STEPS and any(FINER_STEPS in text for text in advice(by_steps))
        assert not any('Look for what links' in text for text in advice(by_steps))

    def test_stamps_at_fault_are_mended_first(self, searched: tuple[Search, Diagnosis]) -> None:
        drifting = replace(
            searched[1], verdict='timing', timing=TimingFault('changes', 0.0, 0.03, 0.01, 500.0, 300.0)
        )
        assert advice(drifting) == [diagnosis_status(drifting).next_step]
        parser = argparse.ArgumentParser()
        add_arguments(parser)
        misfit = replace(drifting, missing=(), fit=ModelFit(('NIS 9.0',), True))
        steps = list(next_steps(misfit, parser.parse_args(['bag'])))
        assert not any('gyrocal learn' in step for step in steps)

    def test_unexplained_structure(self, searched: tuple[Search, Diagnosis]) -> None:
        search_, diagnosis = searched
        shape = shapes(search_.last.run, search_.last.seen)[0]
        jump = UnexplainedStructure('the bias jumped by +0.2 deg/s at 40 s', 80.0, 9.0, shape, at_s=40.0)
        strange = replace(diagnosis, verdict='unexplained', missing=(), unexplained=jump)
        assert 'Missing' not in diagnosis_status(strange).sentence
        assert 'No effect of the library explains this: the bias jumped' in diagnosis_status(strange).sentence
        assert any('at 40 s' in text for text in advice(strange))
        for signal, changes_slowly in (('battery_state.voltage', True), (RATE, False)):
            follows = replace(jump, shape=replace(shape, signal=signal), at_s=None)
            assert (CAUTION in advice(replace(strange, unexplained=follows))) == changes_slowly
        both = replace(strange, missing=diagnosis.missing)
        assert diagnosis_status(both).sentence.startswith(
            'Missing: scale_asymmetry. No effect of the library'
        )
        shown = json.loads(json_text(summarise_diagnosis(search_, strange)))['unexplained']
        assert shown['at_s'] == 40.0 and shown['significance_sigma'] == 9.0 and shown['caution']
        assert len(shown['knots']) == len(shown['values']) == len(shown['stds'])
        assert shown['of'] in ('bias', 'scale') and shown['signal'] == shape.signal

    def test_advice_on_effects_that_could_not_be_judged(self, searched: tuple[Search, Diagnosis]) -> None:
        why = dict.fromkeys(('bias_temperature', 'scale_temperature'), 'not recorded: temperature')
        why['cross_axis'] = 'nothing in this recording depends on it'
        unsure = replace(searched[1], missing=(), verdict='cannot_tell', not_judged=why)
        sentences = advice(unsure)
        assert 'Record temperature to judge bias_temperature and scale_temperature.' in sentences
        assert any(text.startswith('To judge cross_axis, record five minutes') for text in sentences)
        assert any('turns to both sides' in text for text in sentences)
        printed = '\n'.join(as_text(unsure))
        assert printed.startswith('[yellow] This recording cannot tell')
        assert 'bias_temperature and scale_temperature: not recorded: temperature' in printed


class TestCompare:
    @pytest.mark.slow
    def test_the_json_that_scripts_rely_on(self, skewed: Path, tmp_path: Path, capsys: Output) -> None:
        models = [tmp_path / 'default.yaml', tmp_path / 'better.yaml']
        assert main(['add', 'scale_factor', '--model', str(models[0])]) == 0
        assert main(['add', 'scale_asymmetry', '--model', str(models[1])]) == 0
        capsys.readouterr()
        named = [argument for path in models for argument in ('--model', str(path))]
        assert main(['compare', str(skewed), *named, '--json']) == 0
        found = read_json(capsys)
        first, second = found['models']
        assert [first['model'], second['model']] == [str(path) for path in models]
        assert found['best'] == second['model'] and found['diverged'] == []
        assert first['log_likelihood_gain'] == 0.0 and second['log_likelihood_gain'] > 100.0
        assert second['log_likelihood_gain_sigma'] > 2.0
        for model in (first, second):
            drift = model['blind_drift_deg']
            assert drift['spans'] > 0 and drift['low'] < drift['rms'] <= drift['max']
            assert drift['high'] is None or drift['rms'] < drift['high']
            assert model['heading_rms_deg'] < 1.0 and model['nis_per_dof'] > 0.0
        assert second['nis_per_dof'] < 1.2 < first['nis_per_dof']
        assert set(second['coefficients']) == {'bias', 'scale_factor', 'scale_asymmetry'}
        assert first['fails_by_truth'] and not second['fails_by_truth']
        assert found['drift_reference'] == 'ground truth' and found['wall_s'] > 0.0

    @pytest.mark.slow
    def test_without_a_model_and_without_truth(self, brief: Path, tmp_path: Path, capsys: Output) -> None:
        out = tmp_path / 'out'
        assert main(['compare', str(brief), '-o', str(out)]) == 0
        printed = capsys.readouterr().out
        assert 'default' in printed and 'against the heading by SLAM' in printed
        assert 'nowhere: all differences are within chance' in printed and 'ground truth' not in printed
        (model,) = json.loads((out / 'comparison.json').read_text(encoding='utf-8'))['models']
        assert model['heading_rms_deg'] is None and model['fails_by_truth'] is None

    @pytest.mark.slow
    def test_a_model_that_the_filter_cannot_run_with_is_reported(
        self, brief: Path, tmp_path: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        model = tmp_path / 'broken.yaml'
        assert main(['add', 'gyro_lag', '--model', str(model)]) == 0
        runs = BagRuns.calibrate

        def run(self: BagRuns, model: SensorModel, candidates: tuple[Effect, ...] = ()) -> Run:
            if len(model.effects) > 1:
                raise FilterDivergedError('lost the measurements', where='bag')
            return runs(self, model, candidates)

        monkeypatch.setattr(BagRuns, 'calibrate', run)
        default = tmp_path / 'default.yaml'
        assert main(['add', 'scale_factor', '--model', str(default)]) == 0
        capsys.readouterr()
        assert main(['compare', str(brief), '--model', str(model), '--model', str(default)]) == 0
        assert f'{model}: the filter cannot run with this model: bag: lost' in capsys.readouterr().out
        assert main(['compare', str(brief), '--model', str(model)]) == 2
        assert 'lost the measurements' in capsys.readouterr().err


class TestImprove:
    @pytest.mark.slow
    def test_the_history_shows_the_error_falling(self, skewed: Path, tmp_path: Path, capsys: Output) -> None:
        out = tmp_path / 'improved'
        assert main(['improve', str(skewed), '-o', str(out)]) == 0
        captured = capsys.readouterr()
        assert captured.out.startswith('[green] Added scale_asymmetry: the held-out drift went from')
        assert str(out / 'model.yaml') in captured.out
        assert captured.err.startswith('gyrocal: run 1: scale_factor\n')
        assert {'0_default', '1_scale_asymmetry'} <= {item.name for item in out.iterdir() if item.is_dir()}
        before, after = (
            json.loads((out / name / 'merit.json').read_text(encoding='utf-8'))
            for name in ('0_default', '1_scale_asymmetry')
        )
        for kind in ('held_out_drift_deg', 'fitted_drift_deg'):
            assert after[kind]['rms'] < 0.5 * before[kind]['rms']
        assert after['log_likelihood_gain'] > 100.0 and after['log_likelihood'] > before['log_likelihood']
        assert after['kept'] and after['why'].startswith('kept: the recording is predicted better')
        assert after['nis_per_dof'] < before['nis_per_dof'] and after['effect'] == 'scale_asymmetry'
        for folder in (out, out / '1_scale_asymmetry'):
            assert [effect.name for effect in load_model(folder / 'model.yaml').effects] == [
                'scale_factor',
                'scale_asymmetry',
            ]
            known = load_calibration(folder / 'calibration.yaml')
            assert known.model.version == 2
            assert abs(known.values[2] - ASYMMETRY) < 4.0 * known.stds[2]
        assert [item.name for item in tmp_path.iterdir()] == ['improved']
        assert main(['improve', str(skewed), '-o', str(out)]) == 2
        assert 'is not empty' in capsys.readouterr().err

    @pytest.mark.slow
    def test_an_effect_that_is_not_there_is_left_out_and_reported(self, plain: Path, capsys: Output) -> None:
        assert main(['improve', str(plain), '--effect', 'scale_cubic', '--json']) == 0
        found = read_json(capsys)
        assert found['effects'] == ['scale_factor']
        before, after = found['revisions']
        assert not after['kept'] and after['why'].startswith('left out: ')
        said = r'; the held-out drift (stayed at \S+ deg|(fell|rose) from \S+ to \S+ deg \(\d\.\d sigma\))$'
        assert re.search(said, after['why']), after['why']
        assert abs(after['held_out_drift_fell_sigma']) < 2.0 and before['kept']

    @pytest.mark.slow
    def test_an_unknown_law_is_named_by_what_it_follows(self, tmp_path: Path, capsys: Output) -> None:
        law = DrawnEffect('stranger_scale_heading', (0.03, 0.5))
        bag = bag_of(tmp_path / 'law', law, duration_s=60.0)
        assert main(['improve', str(bag)]) == 0
        text = capsys.readouterr().out
        assert text.startswith('[red] Nothing was added')
        assert 'the scale goes with heading in the map (deg)' in text

    @pytest.mark.slow
    def test_an_interruption_leaves_nothing(
        self, brief: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(*args: Any) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(improve, 'open_bag_runs', interrupt)
        assert main(['improve', str(brief), '-o', str(tmp_path / 'out')]) == 130
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('command', ['diagnose', 'compare', 'improve'])
class TestBadInput:
    def test_a_bag_that_is_not_there(self, tmp_path: Path, capsys: Output, command: str) -> None:
        assert main([command, str(tmp_path / 'no_bag'), '-o', str(tmp_path / 'out')]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert 'no_bag' in line and list(tmp_path.iterdir()) == []

    @pytest.mark.slow
    def test_a_model_that_cannot_be_used(
        self, brief: Path, tmp_path: Path, capsys: Output, command: str
    ) -> None:
        model = tmp_path / 'model.yaml'
        model.write_text('effects: [scale_factor, gyro_lagg]', encoding='utf-8')
        assert main([command, str(brief), '--model', str(model)]) == 2
        assert "did you mean 'gyro_lag'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ('name', 'message'), [('gyro_lagg', "did you mean 'gyro_lag'?"), ('scale_factor', 'in the model already')]
)
def test_an_effect_that_cannot_be_tried(brief: Path, capsys: Output, name: str, message: str) -> None:
    assert main(['improve', str(brief), '--effect', name]) == 2
    assert message in capsys.readouterr().err
