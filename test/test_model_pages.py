"""The pages of a diagnosis, a comparison and an improvement."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli import improve
from gyrocal_ros.config.declare import with_settings
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.advice import RECORD, advice, twins_in_words
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit
from gyrocal_ros.diagnose.analysis.comparison import Comparison, compare
from gyrocal_ros.diagnose.analysis.heading_filter import Headings
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit, model_fit
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.diagnose.analysis.shapes import RATE, TIME, Shape, UnexplainedStructure, shapes
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.analysis.wander import MAX_MOMENTS, wander
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.json_summary import (
    summarise_comparison,
    summarise_diagnosis,
    summarise_improvement,
)
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import Improvement, improvement
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.diagnose.series.error_curves import MAX_CURVES, centred, errors_by_signal
from gyrocal_ros.diagnose.series.model_series import (
    MAX_PLACES,
    coefficients,
    failures_by_model,
    slam_errors_deg,
)
from gyrocal_ros.diagnose.series.search_series import (
    candidate_rows,
    effect_curve,
    held_out_drifts,
    models_that_ran,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.diagnose.status import (
    SEE_LIMITS,
    TOO_SHORT,
    Level,
    Status,
    diagnosis_status,
    missing_sentence,
)
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.model.sensor import with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.report import comparison as comparison_report
from gyrocal_ros.report import comparison_figures as models
from gyrocal_ros.report import diagnosis as diagnosis_report
from gyrocal_ros.report import diagnosis_figures as figures
from gyrocal_ros.report import improvement as improvement_report
from gyrocal_ros.report import plot, write
from gyrocal_ros.report.comparison import comparison_page
from gyrocal_ros.report.comparison_figures import Mark
from gyrocal_ros.report.describe import NO_FAILURE, with_gain
from gyrocal_ros.report.diagnosis import diagnosis_page, estimate_rows
from gyrocal_ros.report.html import Section, gallery, with_code
from gyrocal_ros.report.improvement import improvement_page
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

ASYMMETRY = 0.008


@pytest.fixture(scope='module')
def searched_and_diagnosed() -> tuple[Search, Diagnosis]:
    scenario = replace(find_scenario('cleaning'), duration_s=90.0, imu_hz=100)
    hidden = (HiddenEffect(find_effect('scale_asymmetry'), (ASYMMETRY,)),)
    config = with_settings(Config(), {'tracker': {'features': 12}})
    source, config = preload(SimSource(scenario, 3, hidden=hidden), config, default_model())
    recorded = summarise_recording(source)
    searched = search(
        default_model(),
        recorded,
        lambda model, candidates: calibrate(source, config, model, candidates=candidates),
        most=1,
    )
    return searched, diagnose(searched, recorded)


@pytest.fixture(scope='module')
def searched(searched_and_diagnosed: tuple[Search, Diagnosis]) -> Search:
    return searched_and_diagnosed[0]


@pytest.fixture(scope='module')
def diagnosis(searched_and_diagnosed: tuple[Search, Diagnosis]) -> Diagnosis:
    found = searched_and_diagnosed[1]
    assert [item.effect.name for item in found.missing] == ['scale_asymmetry']
    return found


@pytest.fixture(scope='module')
def some_shape(searched: Search) -> Shape:
    return shapes(searched.first.run, searched.first.seen)[0]


@pytest.fixture(scope='module')
def improved(searched: Search) -> Improvement:
    return improvement(searched)


@pytest.fixture(scope='module')
def comparison(searched: Search) -> Comparison:
    return compare({'<old>.yaml': searched.first.run, 'new.yaml': searched.last.run}, {'bad.yaml': 'lost'})


def noisy(seed: int, bias_rad_s: float = 0.0) -> Headings:
    """Make two minutes of a gyro and a camera with the noise of their settings."""
    rng, count, dt_s = np.random.default_rng(seed), 1200, 0.1
    time_s = dt_s * np.arange(count)
    rate_noise, std = math.radians(0.03), math.radians(0.05)
    wander = rate_noise * math.sqrt(dt_s) * rng.normal(size=count)
    seen = 0.3 * time_s + std * rng.normal(size=count)
    return Headings(
        time_s=time_s,
        dt_s=np.full(count, dt_s),
        gyro_valid_s=np.full(count, dt_s),
        unobserved_turn_std_rad=np.zeros(count),
        turn_rad=0.3 * dt_s + bias_rad_s * dt_s + wander,
        seen_rad=np.where(np.arange(count) % 2, seen, np.nan),
        std_rad=np.full(count, std),
        rate_noise_rad_s=np.full(count, rate_noise),
        bias_walk_rad_s=0.0,
        map_walk_rad=math.radians(DEFAULT_SETTINGS.map_walk_deg),
        outlier_sigma=DEFAULT_SETTINGS.outlier_sigma,
    )


def shape(like: Shape, signal: str, values: list[float], stds: list[float]) -> Shape:
    """Make a shape with knots at -50, 0, 50 and so on."""
    covariance = np.diag(np.square(stds[1:]))
    fitted = Fit(np.arange(len(values) - 1), np.array(values[1:]), covariance, 10.0, np.ones(9), 9)
    knots = 50.0 * np.arange(-1, len(values) - 1)
    made = replace(like, knots=knots, values=np.array(values), stds=np.array(stds), fit=fitted)
    return replace(made, signal=signal, of_scale=False)


def check_page(page: str, names: list[str]) -> None:
    """Check that a page needs no other file and shows each figure once."""
    own = page.replace(plot.plotly_js(), '')
    assert re.findall(r'(?:src|href)\s*=(?!"#)|@import|url\(|https?://', own) == [], (
        'links within the page only'
    )
    assert re.findall(r'<div id="(\w+)" class="plotly-graph-div"', own) == names
    assert len(page) < 6_500_000


class TestWander:
    def test_the_error_of_noise_has_its_standard_deviation(self) -> None:
        found = [wander(noisy(seed)) for seed in range(8)]
        for error, std in (('error_rad', 'std_rad'), ('gained_rad', 'gained_std_rad')):
            z = np.concatenate([getattr(item, error) / getattr(item, std) for item in found])
            assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2, error

    def test_a_constant_bias_is_removed_and_a_jump_is_not(self) -> None:
        plain, biased = wander(noisy(0)), wander(noisy(0, bias_rad_s=0.01))
        np.testing.assert_allclose(biased.error_rad, plain.error_rad, atol=math.radians(0.2))
        seen = noisy(0)
        jumped = replace(seen, turn_rad=seen.turn_rad + 0.0005 * (seen.time_s > 60.0))
        error = wander(jumped)
        assert (np.abs(error.error_rad) > 5.0 * error.std_rad).mean() > 0.5

    def test_an_outlier_of_the_heading_is_ignored(self) -> None:
        seen = noisy(0)
        astray = seen.seen_rad.copy()
        astray[601] += 0.1
        found = wander(replace(seen, seen_rad=astray))
        assert np.abs(found.error_rad).max() < 0.02

    def test_windows_add_up_to_the_whole(self) -> None:
        found = wander(noisy(1))
        assert len(found.gained_s) == 11
        assert len(found.time_s) <= MAX_MOMENTS
        start = found.gained_s[0] - 0.5 * (found.gained_s[1] - found.gained_s[0])
        ends = np.interp([start, start + 110.0], found.time_s, found.error_rad)
        assert found.gained_rad.sum() == pytest.approx(ends[1] - ends[0], abs=math.radians(0.2))


class TestSeries:
    @pytest.mark.slow
    def test_a_shape_is_shown_less_its_mean(self, some_shape: Shape) -> None:
        curve = centred(shape(some_shape, TIME, [0.0, 1.0, 2.0], [0.0, 0.1, 0.2]))
        np.testing.assert_allclose(curve.values, [-1.0, 0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(curve.stds[0], math.hypot(0.1, 0.2) / 3.0)

    @pytest.mark.slow
    def test_a_shape_over_the_rate_is_shown_less_a_straight_line(self, some_shape: Shape) -> None:
        curve = centred(shape(some_shape, RATE, [0.0, 2.0, 2.0], [0.0, 0.1, 0.1]))
        np.testing.assert_allclose(curve.values, [-1.0 / 3.0, 2.0 / 3.0, -1.0 / 3.0], atol=1e-12)

    @pytest.mark.slow
    def test_knots_without_data_are_left_out(self, some_shape: Shape) -> None:
        part = shape(some_shape, TIME, [0.0, 1.0, math.nan], [0.0, 0.1, math.nan])
        fitted = replace(part.fit, values=part.fit.values[:1], covariance=part.fit.covariance[:1, :1])
        curve = centred(replace(part, fit=fitted))
        np.testing.assert_allclose(curve.values, [-0.5, 0.5])

    def test_the_shape_is_flat_with_the_missing_effect(self, searched: Search) -> None:
        by_rate = next(item for item in errors_by_signal(searched) if item.signal == RATE)
        assert by_rate.after is not None
        before, after = (np.abs(curve.values).max() for curve in (by_rate.before, by_rate.after))
        assert after < 0.2 * before
        questions = [(item.signal, item.of_scale) for item in errors_by_signal(searched)]
        assert len(set(questions)) == len(questions) <= MAX_CURVES

    def test_without_additions_nothing_is_compared(self, searched: Search) -> None:
        alone = replace(searched, additions=())
        assert all(item.after is None for item in errors_by_signal(alone))
        assert list(held_out_drifts(alone)) == ['the first model']

    def test_shapes_are_shown_in_the_order_of_their_gain(self, searched: Search) -> None:
        every = shapes(searched.first.run, searched.first.seen)
        first: dict[tuple[str, bool], Shape] = {}
        for item in every:
            first.setdefault((item.signal, item.of_scale), item)
        shown = errors_by_signal(searched)
        assert [(item.signal, item.of_scale) for item in shown] == list(first)[: len(shown)]
        np.testing.assert_array_equal(shown[0].before.knots, every[0].knots)

    def test_candidates_have_their_roles(self, searched: Search, diagnosis: Diagnosis) -> None:
        missing = replace(diagnosis.missing[0], confused_with=('scale_quadratic',))
        table = candidate_rows(searched, replace(diagnosis, missing=(missing,)))
        roles = {row.name: row.role for row in table}
        assert roles['scale_asymmetry'] == 'found'
        assert roles['scale_quadratic'] == 'twin'
        assert 'chance' in roles.values()
        assert [row.gain for row in table] == sorted((row.gain for row in table), reverse=True)
        left = {row.name: row.sigma_left for row in table}
        assert math.isnan(left['scale_asymmetry'])
        assert left['scale_quadratic'] < 4.5

    def test_a_model_that_could_not_run_is_not_shown(self, searched: Search) -> None:
        assert list(models_that_ran(searched)) == ['the first model', 'with scale_asymmetry']
        rescue = replace(searched.additions[0], before=None)
        rescued = Search(rescue.after, (rescue,))
        assert list(models_that_ran(rescued)) == list(held_out_drifts(rescued)) == ['with scale_asymmetry']

    def test_a_limit_without_scores_is_shown_too(self, searched: Search, diagnosis: Diagnosis) -> None:
        limit = replace(diagnosis.missing[0], effect=find_effect('rate_saturation'), gain=900.0)
        names = [row.name for row in candidate_rows(searched, replace(diagnosis, missing=(limit,)))]
        assert 'rate_saturation' in names
        rescue = replace(limit, gain=math.inf, sigma=math.inf)
        rescued = replace(diagnosis, missing=(rescue,))
        assert all(math.isfinite(row.gain) for row in candidate_rows(searched, rescued))
        assert 'without it the filter loses' in diagnosis_report.conclusion(rescued).sentences[0]

    def test_a_contribution_is_drawn_for_the_estimates(self, diagnosis: Diagnosis) -> None:
        missing = diagnosis.missing[0]
        drawn = effect_curve(missing)
        assert drawn is not None
        np.testing.assert_allclose(drawn.y[-1], missing.values[0] * 100.0)
        np.testing.assert_allclose(drawn.std[0], missing.stds[0] * 100.0)
        followed = find_effect('covariate_bias:battery_state.current')
        assert effect_curve(replace(missing, effect=followed)) is None
        early = replace(
            missing, effect=find_effect('gyro_lag'), values=np.array([-0.003]), stds=np.array([1e-5])
        )
        assert effect_curve(early) is None, 'a negative lag runs away'

    def test_coefficients_are_shown_in_degrees(self, searched: Search) -> None:
        run = searched.last.run
        shown = coefficients([('a', run, True)])
        assert list(shown) == ['bias (deg/s)', 'scale_factor (1)', 'scale_asymmetry (1)']
        assert shown['bias (deg/s)'][0].value == pytest.approx(math.degrees(run.state.bias_rad_s[2]))

    def test_the_worst_places_of_any_model_are_compared(self, comparison: Comparison) -> None:
        places = [Failure(f'{place}: off', 5.0 + place, regime=f'{place}') for place in range(20)]
        rivals = [replace(rival, fails_where=tuple(places)) for rival in comparison.results]
        in_time = Failure('10 to 20 s: off', 99.0, from_s=10.0, to_s=20.0)
        rivals[1] = replace(rivals[1], fails_where=(in_time,))
        found = failures_by_model(rivals)
        assert found['new.yaml'] == {'10 to 20 s': 99.0}
        assert list(found['<old>.yaml'])[:2] == ['19', '18']
        assert len(found['<old>.yaml']) == MAX_PLACES - 1


class TestFigures:
    @pytest.mark.slow
    def test_axes_have_titles_and_traces_names(
        self, searched: Search, diagnosis: Diagnosis, improved: Improvement, comparison: Comparison
    ) -> None:
        revision, run = improved.final, searched.last.run
        drawn = effect_curve(diagnosis.missing[0])
        assert drawn is not None
        history, errors = run.history, wander(searched.first.seen)
        every = [
            figures.scores(candidate_rows(searched, diagnosis)),
            figures.contribution('it', drawn),
            *(figures.error_by_signal(asked, ('before', 'after')) for asked in errors_by_signal(searched)),
            figures.where_it_fails('it', {'a': errors}, history.time_s, history.dt_s),
            models.drift_by_model('it', [Mark('a', 'held out', revision.held_out)]),
            models.drift_by_span({'a': revision.held_out}),
            models.coefficients_by_model(coefficients([('a', run, True)]), ['a']),
            models.heading_errors('it', slam_errors_deg(comparison.results)),
        ]
        for figure in every:
            assert figure.layout.title.text
            assert all(trace.name for trace in figure.data)
            axes = [*figure.select_xaxes(), *figure.select_yaxes()]
            assert sum(bool(axis.title.text) for axis in axes) >= 1
            assert all(len(trace.x) < 2.2 * plot.MAX_POINTS for trace in figure.data)

    def test_estimates_are_drawn_with_their_interval(self, improved: Improvement) -> None:
        start_s = 5.0 * np.arange(100)
        drift = replace(improved.final.held_out, start_s=start_s, error_rad=0.01 * np.sin(start_s))
        figure = models.drift_by_model('it', [Mark('a', 'held out', drift)])
        (trace,) = figure.data
        low, high = drift.interval_deg
        assert trace.y[0] - trace.error_y.arrayminus[0] == pytest.approx(low, rel=1e-5)
        assert trace.y[0] + trace.error_y.array[0] == pytest.approx(high, rel=1e-5)

    def test_an_infinite_interval_leaves_the_panel(self, improved: Improvement) -> None:
        drift = improved.final.held_out
        few = replace(drift, start_s=drift.start_s[:1], error_rad=drift.error_rad[:1])
        assert math.isinf(few.interval_deg[1])
        figure = models.drift_by_model('it', [Mark('a', 'held out', few)])
        (trace,) = figure.data
        assert trace.y[0] + trace.error_y.array[0] > figure.layout.yaxis.range[1] > trace.y[0]

    def test_revisions_that_were_left_out_are_hollow(self, improved: Improvement) -> None:
        drift = improved.final.held_out
        figure = models.drift_by_model('it', [Mark('a', 'x', drift), Mark('b', 'x', drift, is_kept=False)])
        kept, left_out = figure.data
        assert left_out.marker.symbol.endswith('-open')
        assert not kept.marker.symbol.endswith('-open')
        assert 'left out' in left_out.name
        assert 'lines' not in left_out.mode

    def test_stretches_and_the_jump_are_marked(self, searched: Search) -> None:
        history = searched.first.run.history
        figure = figures.where_it_fails(
            'it',
            {'a': wander(searched.first.seen)},
            history.time_s,
            history.turn_rad,
            [Failure('', 9.0, from_s=10.0, to_s=20.0), Failure('', 8.0, from_s=40.0, to_s=50.0)],
            jump_s=33.0,
        )
        words = [note.text for note in figure.layout.annotations]
        assert words == ['<b>1</b>', '<b>2</b>', ' the bias jumped at 33 s ']
        assert {shape.x0 for shape in figure.layout.shapes} == {10.0, 40.0, 33.0}


class TestPages:
    @pytest.mark.slow
    def test_diagnosis(self, searched: Search, diagnosis: Diagnosis) -> None:
        page = diagnosis_page(searched, diagnosis, [('warning', 'gaps in the <imu>')])
        names = ['heading', 'evidence', 'contribution_1', 'drift', 'drift_by_span']
        names += [f'left_over_{number}' for number in range(1, 7)]
        check_page(page, names)
        assert 'gaps in the &lt;imu&gt;' in page
        assert '<code>gyrocal add scale_asymmetry --set c=0.0' in page
        assert diagnosis.fails_where[0].what in page
        assert page == diagnosis_page(searched, diagnosis, [('warning', 'gaps in the <imu>')])

    @pytest.mark.slow
    def test_diagnosis_that_found_nothing(self, searched: Search, diagnosis: Diagnosis) -> None:
        nothing = replace(diagnosis, verdict='nothing_missing', missing=(), fails_where=())
        blind = replace(nothing, not_judged={'scale_temperature': 'not recorded: temperature'})
        page = diagnosis_page(replace(searched, additions=()), blind)
        names = ['heading', 'evidence', 'drift_by_span', *(f'left_over_{number}' for number in range(1, 7))]
        check_page(page, names)
        assert f'<p>{NO_FAILURE}</p>' in page
        assert 'not recorded: temperature' in page

    @pytest.mark.slow
    def test_improvement(self, improved: Improvement) -> None:
        rejected = replace(
            improved.final, label='2_gyro_lag', fate='left out', effect=find_effect('gyro_lag')
        )
        tried = replace(improved, revisions=(*improved.revisions, rejected))
        page = improvement_page(tried)
        check_page(page, ['drift', 'heading', 'drift_by_span', 'coefficients', 'over_time'])
        assert '2_gyro_lag' in page
        assert 'gyro_lag was tried and' in page

    @pytest.mark.slow
    def test_comparison(self, comparison: Comparison) -> None:
        page = comparison_page(comparison)
        names = ['drift', 'drift_by_span', 'heading', 'failures', 'truth', 'coefficients', 'innovations']
        check_page(page, names)
        assert 'With bad.yaml the filter cannot run: lost' in page
        assert '&lt;old&gt;.yaml' in page
        assert '<old>' not in page.replace(plot.plotly_js(), '')

    @pytest.mark.slow
    def test_pages_of_short_recordings_show_no_drift(
        self, comparison: Comparison, improved: Improvement
    ) -> None:
        drift = comparison.results[0].drift
        empty = replace(drift, start_s=drift.start_s[:0], error_rad=drift.error_rad[:0])
        short = replace(
            comparison, results=tuple(replace(rival, drift=empty) for rival in comparison.results)
        )
        assert '<div id="drift' not in comparison_page(short)
        revisions = tuple(replace(item, held_out=empty, fitted=empty) for item in improved.revisions)
        page = improvement_page(replace(improved, revisions=revisions))
        assert '<div id="drift' not in page
        assert 'too short for a drift over 60 s' in page and 'drifts - deg' not in page

    def test_half_figures_are_shown_in_pairs(self, improved: Improvement) -> None:
        figure = models.drift_by_span({'a': improved.final.held_out})
        html = gallery([Section(str(number), figure, '', half=True) for number in range(3)])
        assert re.findall(r'<figure class="(\w+)"', html) == ['half', 'half', 'full']

    def test_code_in_words(self) -> None:
        assert with_code('a < b: run `gyrocal`') == 'a &lt; b: run <code>gyrocal</code>'


class TestConclusions:
    def test_each_verdict_has_its_kind(self, diagnosis: Diagnosis, some_shape: Shape) -> None:
        structure = UnexplainedStructure('the bias jumped', 50.0, 9.0, some_shape, at_s=12.0)
        uncertain = replace(diagnosis.missing[0], confused_with=('scale_quadratic',))
        for verdict, missing, left, kind in (
            ('nothing_missing', (), None, 'green'),
            ('effect_found', diagnosis.missing, None, 'yellow'),
            ('cannot_tell', (uncertain,), None, 'yellow'),
            ('cannot_tell', (), None, 'yellow'),
            ('unexplained', (), structure, 'red'),
        ):
            case = replace(diagnosis, verdict=verdict, missing=missing, unexplained=left, fails_where=())
            words = diagnosis_report.conclusion(case)
            assert words.status.level == kind
            assert bool(words.steps) == (verdict != 'nothing_missing')

    def test_places_that_are_off_are_part_of_the_verdict(self, diagnosis: Diagnosis) -> None:
        place = Failure('the scale needs -0.041 %', 5.0, from_s=1.0, to_s=2.0)
        for places, level, sentence in (
            ((), 'green', 'Nothing is missing: all measurements agree with the model within chance.'),
            (
                (place,),
                'yellow',
                'The model fits as a whole; one place, listed below, is off by more than chance.',
            ),
            (
                (place,) * 3,
                'yellow',
                'The model fits as a whole; 3 places, listed below, are off by more than chance.',
            ),
        ):
            case = replace(diagnosis, verdict='nothing_missing', missing=(), fails_where=places)
            status = diagnosis_status(case)
            assert (status.level, status.sentence) == (level, sentence)
            assert bool(status.next_step) == bool(places)
        limit = with_means(find_effect('rate_deadband'), (math.radians(0.3),))
        limited = replace(case, fails_where=(), proven_limits=(limit,))
        status = diagnosis_status(limited)
        assert status.level == 'yellow' and status.next_step == SEE_LIMITS
        assert status.sentence.startswith('The readings prove rate_deadband (0.3 deg/s), which costs little')
        assert not any('prove' in sentence for sentence in advice(limited))
        beside = replace(limited, verdict='effect_found')
        assert any('prove rate_deadband (0.3 deg/s)' in sentence for sentence in advice(beside))
        unjudged = replace(case, verdict='cannot_tell', fit=ModelFit((), is_judged=False))
        assert diagnosis_status(unjudged) == Status('yellow', f'{TOO_SHORT.capitalize()}.', RECORD)
        interrupted = replace(unjudged, fit=ModelFit((), is_judged=False, gaps=22))
        assert diagnosis_status(interrupted).sentence.startswith('The gyro has 22 gaps, too many to judge')

    def test_the_next_step_names_all_effects_found(self, diagnosis: Diagnosis) -> None:
        missing = diagnosis.missing[0]
        several = (missing, replace(missing, effect=find_effect('gyro_lag')))
        case = replace(diagnosis, verdict='effect_found', missing=several)
        step = diagnosis_status(case).next_step
        assert step == f'Let `gyrocal improve` add {missing.effect.name} and gyro_lag and show the gain.'

    def test_of_many_effects_that_look_alike_a_few_are_listed(self) -> None:
        assert twins_in_words(['a', 'b']) == 'a and b' and twins_in_words([]) == ''
        assert twins_in_words(['a', 'b', 'c', 'd', 'e'], 'or') == 'a, b, c or 2 others'

    @pytest.mark.parametrize(
        ('level', 'ending'), [('red', 'Not for the robot yet'), ('yellow', 'On the robot')]
    )
    def test_a_model_that_does_not_fit_is_not_handed_to_the_robot(
        self, level: Level, ending: str, improved: Improvement, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(improve, 'improvement_status', lambda improved: Status(level, 'as it is'))
        assert improved.final is not improved.kept[0]
        assert [*improve.files_as_text(Path('out'), improved)][-1].startswith(ending)

    def test_an_effect_that_does_not_explain_evenly_is_said(self, diagnosis: Diagnosis) -> None:
        case = replace(diagnosis, verdict='cannot_tell', missing=(), fails_where=(), uneven='scale_cubic')
        status = diagnosis_status(case)
        assert status.level == 'yellow' and status.next_step == RECORD, 'there is nothing to learn from'
        assert status.sentence.startswith('Something is missing: scale_cubic would explain much of it')

    def test_certain_and_uncertain_effects_are_named_apart(self, diagnosis: Diagnosis) -> None:
        sure = replace(diagnosis.missing[0], confused_with=())
        uncertain = replace(sure, effect=find_effect('bias_temperature'), confused_with=('bias_warmup',))
        case = replace(diagnosis, verdict='cannot_tell', missing=(sure, uncertain))
        assert diagnosis_report.conclusion(case).headline == (
            'Missing: scale_asymmetry and bias_temperature (not distinguishable here from bias_warmup).'
        )
        swapped = replace(case, missing=(uncertain, sure))
        assert diagnosis_status(swapped).sentence == (
            'Missing: bias_temperature (not distinguishable here from bias_warmup) and scale_asymmetry.'
        ), 'that which explains most comes first, as in the table'
        many = {'bias_temperature': ('bias_warmup', 'a', 'b', 'c', 'd')}
        assert missing_sentence(many).endswith('from bias_warmup, a, b or 2 others).')
        twins = {'scale_asymmetry': (), 'bias_temperature': ('bias_warmup',)}
        assert missing_sentence(twins) == diagnosis_status(case).sentence

    def test_the_drift_before_and_after_is_stated(self, diagnosis: Diagnosis) -> None:
        missing = replace(diagnosis.missing[0], drift_before_deg=2.0, drift_after_deg=0.25)
        words = diagnosis_report.conclusion(replace(diagnosis, missing=(missing,)))
        assert 'drifts 2.00 deg without it and 0.25 deg with it' in ' '.join(words.sentences)

    def test_a_comparison_states_whether_it_is_chance(self, comparison: Comparison) -> None:
        old, new = comparison.results
        sure = replace(comparison, results=(old, replace(new, gain=50.0, gain_sigma=6.0)))
        assert 'new.yaml predicts the recording better than' in comparison_report.conclusion(sure).headline
        by_chance = replace(comparison, results=(old, replace(new, gain=0.5, gain_sigma=0.4)))
        assert 'not significantly better' in comparison_report.conclusion(by_chance).headline
        worse = replace(comparison, results=(old, replace(new, gain=-5.0)))
        assert comparison_report.conclusion(worse).headline.startswith('No other model is better')

    def test_one_model_alone(self, comparison: Comparison) -> None:
        old, new = comparison.results
        words = comparison_report.conclusion(replace(comparison, results=(old,)))
        assert words.status.level == 'red', 'the model does not fit'
        assert 'diagnose' in words.steps[0]
        fine = replace(comparison, results=(replace(new, fails_where=()),))
        assert model_fit(old.run).fits is False
        assert comparison_report.conclusion(fine).status.level == 'green'

    def test_an_improvement_states_the_decrease(self, improved: Improvement) -> None:
        words = improvement_report.conclusion(improved)
        assert words.headline.startswith('Added scale_asymmetry')
        alone = replace(improved, revisions=improved.revisions[:1])
        assert improvement_report.conclusion(alone).todo == ()
        first, last = improved.kept[0], improved.final
        for factor, how in (
            (1.05, r'fell from .* to .* deg \(0\.\d sigma\), which may be chance\.'),
            (1.0, r'stayed at .* deg\.'),
            (0.95, r'rose from .* to .* deg \(0\.\d sigma\)\.'),
        ):
            drift = replace(last.held_out, error_rad=factor * last.held_out.error_rad)
            hardly = replace(improved, revisions=(replace(first, held_out=drift), last))
            sentence = improvement_report.conclusion(hardly).headline
            assert re.search(f'the held-out drift {how}', sentence), sentence

    def test_estimates_are_shown_with_their_meaning(self, diagnosis: Diagnosis) -> None:
        missing = diagnosis.missing[0]
        ((name, value, unit, means),) = estimate_rows(
            replace(missing, values=np.array([0.008]), stds=np.array([1e-4]))
        )
        assert (name, value, unit, means) == (
            'scale_asymmetry', '0.00800 ± 0.00010', '1', '0.800 ± 0.010 % of the rate',
        )  # fmt: skip
        limit = replace(missing, effect=find_effect('rate_saturation'), stds=np.zeros(1))
        ((_, _, _, means),) = estimate_rows(limit)
        assert 'not estimated' in means

    def test_gains_that_are_not_numbers(self) -> None:
        assert with_gain(12.34, 3.21) == '+12.3 (3.2 sigma)'
        assert with_gain(-1.0, math.nan) == '-1.0'
        assert with_gain(math.inf, math.nan) == 'fails without it'


class TestFolders:
    @pytest.mark.slow
    def test_hold_the_page_and_the_same_for_programs(
        self,
        searched: Search,
        diagnosis: Diagnosis,
        comparison: Comparison,
        improved: Improvement,
        tmp_path: Path,
    ) -> None:
        write.fill_diagnosis(tmp_path / 'a', searched, diagnosis)
        write.fill_comparison(tmp_path / 'b', comparison)
        write.fill_improvement(tmp_path / 'c', improved)
        for name, summary in (
            ('a/diagnosis.json', summarise_diagnosis(searched, diagnosis)),
            ('b/comparison.json', summarise_comparison(comparison)),
            ('c/history.json', summarise_improvement(improved)),
        ):
            assert json.loads((tmp_path / name).read_text()).keys() == summary.keys()
        assert all((tmp_path / name / 'report.html').is_file() for name in 'abc')
