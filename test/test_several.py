"""Effects that explain a recording only together, and runs that are not repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from synthetic import score_statistics_of
from test_learning import recording, runner
from test_ranking import ONES, independent

from gyrocal_ros.diagnose.advice import advice
from gyrocal_ros.diagnose.analysis.examined import examine
from gyrocal_ros.diagnose.analysis.ranking import best_together, rank
from gyrocal_ros.diagnose.analysis.runs import MOST_REMEMBERED, remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search import several
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import improvement
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.diagnose.search.several import explained_by_several
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS as SETTINGS
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.covariate import covariate_bias
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.sim.hidden import DrawnEffect

OPPOSITE = DrawnEffect('scale_asymmetry', (0.01,)), DrawnEffect('scale_quadratic', (-0.01,))
"""Errors of the scale factor that nearly cancel at usual rates."""


class TestBestTogether:
    def test_two_effects_that_hide_each_other_are_found(self) -> None:
        """Alone, either explains next to nothing, for the columns are alike and the effects opposite."""
        (columns, noise), (others, _) = independent(3), independent(1, seed=1)
        columns[:, :, 1] = columns[:, :, 0] + 0.2 * others[:, :, 0]
        scores = score_statistics_of(columns, columns @ [2.0, -2.0, 0.0] + 0.1 * noise, ONES[:3])
        ranked = rank(scores, SETTINGS)
        pair = best_together(ranked, scores, 2, 1, SETTINGS)
        assert pair is not None
        assert {item.effect.name for item in pair.effects} == {'scale_asymmetry', 'scale_quadratic'}
        more, less = pair.beside
        assert min(more.sigma, less.sigma) > SETTINGS.significant_sigma and more.gain >= less.gain
        assert sorted(float(item.values[0]) for item in pair.beside) == pytest.approx([-2.0, 2.0], abs=0.1)
        assert max(item.merit for item in ranked) < 0.2 * pair.merit

    def test_three_effects_are_no_two(self) -> None:
        columns, noise = independent(4)
        truth = [2.0, -1.5, 1.0, 0.0]
        scores = score_statistics_of(columns, columns @ truth + 0.1 * noise, ONES)
        ranked = rank(scores, SETTINGS)
        three = best_together(ranked, scores, 3, 1, SETTINGS)
        assert three is not None
        assert [item.effect.name for item in three.effects] == [effect.name for effect in ONES[:3]]
        assert [float(item.values[0]) for item in three.beside] == pytest.approx(truth[:3], abs=0.1)
        two = best_together(ranked, scores, 2, 1, SETTINGS)
        assert two is not None and two.merit < three.merit

    def test_one_effect_alone_is_no_pair(self) -> None:
        columns, noise = independent(3)
        scores = score_statistics_of(columns, columns @ [2.0, 0.0, 0.0] + noise, ONES[:3])
        assert best_together(rank(scores, SETTINGS), scores, 2, 1, SETTINGS) is None

    def test_two_recorded_signals_are_a_pair_only_where_that_is_allowed(self) -> None:
        columns, noise = independent(2)
        signals = covariate_bias('first', 0.0, 1.0), covariate_bias('second', 0.0, 1.0)
        for effects, allowed, is_pair in (
            (signals, 1, False),
            (signals, 2, True),
            ((ONES[0], signals[1]), 1, True),
        ):
            scores = score_statistics_of(columns, columns @ [2.0, -2.0] + noise, effects)
            found = best_together(rank(scores, SETTINGS), scores, 2, allowed, SETTINGS)
            assert (found is not None) == is_pair


class TestExplainedBySeveral:
    @pytest.mark.slow
    def test_effects_that_nearly_cancel_are_found_with_their_values(self) -> None:
        source = recording(*OPPOSITE, seconds=100.0, seed=2)
        recorded, calibrate = summarise_recording(source), remembered(runner(source))
        assert not search(default_model(), recorded, calibrate).kept, 'none explains anything alone'
        found = find_missing(default_model(), recorded, calibrate)
        assert {item.effect.name for item in found.kept} == {effect.name for effect in OPPOSITE}
        for name, (truth,) in ((effect.name, effect.values) for effect in OPPOSITE):
            values, stds = found.last.estimate_of(name)
            assert values[0] == pytest.approx(truth, abs=3.0 * stds[0]) and stds[0] < 0.05 * abs(truth)
        first, second = found.kept
        assert (first.together_with, second.together_with) == ((second.effect.name,), (first.effect.name,))
        assert f'only together with {second.effect.name}' in improvement(found).revisions[-2].why
        diagnosis = diagnose(found, recorded)
        assert diagnosis.verdict == 'effect_found'
        assert any(
            'explain the recording only together: add all of them' in text for text in advice(diagnosis)
        )
        shown = summarise_diagnosis(found, diagnosis)['missing']
        drifts = {(item['held_out_drift_before_deg'], item['held_out_drift_after_deg']) for item in shown}
        assert len(drifts) == 1, 'that without both and with both'
        ((before_deg, after_deg),) = drifts
        assert after_deg < 0.5 * before_deg
        assert {(item['effect'], *item['together_with']) for item in shown} == {
            ('scale_asymmetry', 'scale_quadratic'),
            ('scale_quadratic', 'scale_asymmetry'),
        }
        (left,) = diagnose(replace(found, additions=found.additions[:-1]), recorded).missing
        assert not left.together_with, 'the other one was removed again'

    @pytest.mark.slow
    def test_a_walk_of_the_bias_that_explains_as_much_is_preferred(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        source = recording(*OPPOSITE, seconds=100.0, seed=2)
        recorded, calibrate = summarise_recording(source), remembered(runner(source))
        plain = Search(examine(default_model(), recorded, calibrate), ())
        assert len(explained_by_several(plain, recorded, calibrate).kept) == 2
        monkeypatch.setattr(several, 'a_walk_explains', lambda before, after: True)
        assert explained_by_several(plain, recorded, calibrate) is plain

    @pytest.mark.slow
    def test_a_recording_that_hides_nothing_has_no_pair(self) -> None:
        source = recording(seconds=60.0)
        recorded, calibrate = summarise_recording(source), runner(source)
        plain = Search(examine(default_model(), recorded, calibrate), ())
        assert explained_by_several(plain, recorded, calibrate) is plain


@dataclass
class Changeable:
    """An effect of one's own that is no frozen dataclass."""

    name: str = 'changeable'


class TestRemembered:
    def test_the_latest_runs_are_not_repeated(self) -> None:
        ran: list[str] = []

        @dataclass(frozen=True)
        class Result:
            model: SensorModel

        def calibrate(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
            ran.append(model.effects[-1].name)
            return Result(model)  # type: ignore[return-value]

        run, model = remembered(calibrate), default_model()
        effect = find_effect('scale_cubic')
        with_effect = replace(model, effects=(*model.effects, effect), version=2)
        assert run(model, ()).model is model
        assert run(with_effect, ()).model is with_effect
        later = replace(with_effect, version=7)
        assert run(later, ()).model is later and ran == ['scale_factor', 'scale_cubic']
        run(later, (find_effect('gyro_lag'),))
        assert len(ran) == 3, 'with other candidates it is another run'
        for value in np.linspace(0.0, 0.01, MOST_REMEMBERED).tolist():
            prior = replace(effect.coefficients[0], prior_mean=value, prior_std=1.0)
            run(replace(model, effects=(replace(effect, coefficients=(prior,)),)), ())  # type: ignore[type-var]
        run(model, ())
        assert len(ran) == 4 + MOST_REMEMBERED, 'only the latest ones are kept'
        changeable = replace(model, effects=(Changeable(),))  # type: ignore[arg-type]
        run(changeable, ())
        run(changeable, ())
        assert ran[-2:] == ['changeable', 'changeable']
