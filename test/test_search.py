"""The search for what a model lacks, with a filter made of numbers."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from synthetic import (
    DT_S,
    RIG,
    Drive,
    drive,
    readings,
    readings_of,
    recording_of,
    score_statistics_of,
    turning_rad_s,
)

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import examine, with_effect
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search.additions import CLEAR_SIGMA, NONE, Addition, addition
from gyrocal_ros.diagnose.search.elimination import eliminate
from gyrocal_ros.diagnose.search.improvement import improvement
from gyrocal_ros.diagnose.search.look_alikes import look_alikes
from gyrocal_ros.diagnose.search.search import continued, search, try_effect
from gyrocal_ros.diagnose.search.traces import traces
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.traits import has_impossible_sign, is_bias_walk, is_limit, may_break_the_filter
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S, ScoreStatistics
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError, NotObservableError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.sim.scenarios import CAMERA

DURATION_S = 100.0
LIMIT_RAD_S = math.radians(85.0)
STD = 0.01
"""Final standard deviation of every coefficient."""
MIN_GAIN = DEFAULT_SETTINGS.min_predictive_gain
RECOVERING = {
    name
    for name, effect in EFFECTS.items()
    if is_bias_walk(effect) or (may_break_the_filter(effect) and not is_limit(effect))
}
"""Effects that are tried where the filter diverges."""


def test_a_sign_is_impossible_where_it_is_sure_and_no_sensor_has_it() -> None:
    def is_impossible(name: str, *values: float) -> bool:
        return has_impossible_sign(find_effect(name), np.array(values), np.full(len(values), STD))

    assert is_impossible('gyro_lag', -0.04) and not is_impossible('gyro_lag', 0.04)
    assert not is_impossible('gyro_lag', -0.02), 'by chance'
    assert is_impossible('bias_warmup', 0.1, -50.0) and not is_impossible('bias_warmup', -0.1, 50.0)
    assert not is_impossible('camera_time_offset', -0.04), 'an image may be late or early'


@dataclass
class FakeFilter:
    """Stands in for the filter: its scores show each hidden effect that the model lacks."""

    hidden: dict[str, float]
    """Size of each hidden effect, in sigma of a block."""
    predictive_gains: dict[str, float]
    """Predictive log-likelihood that an effect of the model gains."""
    made: Drive = field(default_factory=lambda: drive(duration_s=DURATION_S))
    diverges_without: str = ''
    ends: dict[str, float] = field(default_factory=dict)
    """Final estimate of an effect, where it is not its hidden size."""
    leftover_of: dict[str, str] = field(default_factory=dict)
    """Hidden effects that are none: they show as long as another one starts at an inexact value."""
    alone: dict[str, float] = field(default_factory=dict)
    """Final estimate of an effect that is the only one added."""
    beside: dict[str, float] = field(default_factory=dict)
    """Predictive log-likelihood that an effect gains where it is not the only one added."""
    at_once: dict[str, float] = field(default_factory=dict)
    """Predictive log-likelihood that an effect gains in a single step besides."""
    known_from_s: float = 0.0
    """Time before which the coefficients are as uncertain as large."""
    unusable_with: str = ''
    """Effect with which no image can be used."""
    shows_seldom: tuple[str, ...] = ()
    """Hidden effects that show in some blocks alone."""
    shown_in: tuple[int, ...] = (3,)
    unbent_by: str = ''
    """Effect with which the headings show no structure."""
    looks_like: dict[str, str] = field(default_factory=dict)
    """Effects of one coefficient that act for the most part as another one does."""
    likeness: float = 0.8
    """Correlation of those two."""
    models: list[tuple[str, ...]] = field(default_factory=list)

    def __call__(self, model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        names = tuple(effect.name for effect in model.effects)
        self.models.append(names)
        if self.diverges_without and self.diverges_without not in names:
            raise FilterDivergedError('lost the measurements')
        if self.unusable_with in names:
            raise NotObservableError('no image feature could be used')
        gains = {**self.predictive_gains, **(self.beside if len(names) > 2 else {})}
        made = drive(duration_s=DURATION_S) if self.unbent_by in names else self.made
        history = made.run.history
        steps, values = len(history.time_s), self.estimates(model)
        exact = {effect.name for effect in model.effects if self.starts_exactly(effect)}
        gone = {name for name, of in self.leftover_of.items() if of in exact}
        scores = self.scores({*names, *gone}, candidates) if candidates else None
        coefficients, uneven = np.tile(values, (steps, 1)), np.linspace(0.5, 1.5, steps)
        changed = replace(
            history,
            mean=np.hstack([history.mean[:, :COEFFICIENTS_START], coefficients]),
            std=np.where(history.time_s < self.known_from_s, 9.0, STD)[:, None]
            * np.ones(COEFFICIENTS_START + len(values)),
            columns=np.hstack([history.columns, np.zeros((steps, len(values) - 1))]),
            change=np.zeros((steps, 1 + len(values))),
            change_variance=np.zeros((steps, 1 + len(values))),
            suspected_std=np.zeros((steps, 1 + len(values))),
            log_likelihood=sum(gains.get(name, 0.0) for name in names) / steps * uneven
            + sum(self.at_once.get(name, 0.0) for name in names) * (np.arange(steps) == steps // 2),
        )
        state = replace(made.run.state, mean=changed.mean[-1], coefficient_count=len(values))
        return replace(made.run, model=model, history=changed, state=state, scores=scores)

    def estimates(self, model: SensorModel) -> Array:
        """Return the hidden size of each effect as its first coefficient."""
        known = {**self.hidden, **self.ends, **(self.alone if len(model.effects) == 2 else {})}
        firsts = ((known.get(effect.name, 0.0), effect) for effect in model.effects)
        return np.concatenate([[first, *[0.0] * (len(effect.coefficients) - 1)] for first, effect in firsts])

    def starts_exactly(self, effect: Effect) -> bool:
        """Return True if an effect starts at its hidden size."""
        size = self.hidden.get(effect.name)
        return size is not None and math.isclose(effect.coefficients[0].prior_mean, size)

    def scores(self, names: Collection[str], candidates: tuple[Effect, ...]) -> ScoreStatistics:
        """Return scores in which every effect has its own columns, whatever the other candidates are."""
        blocks, each = round(DURATION_S / BLOCK_S), 20
        noise = np.random.default_rng(0).normal(size=(blocks, each))

        def columns(effect: Effect) -> Array:
            rng = np.random.default_rng(sum(map(ord, effect.name)))
            own = rng.normal(size=(blocks, each, len(effect.coefficients)))
            other = self.looks_like.get(effect.name)
            if other is None:
                return own
            return self.likeness * columns(find_effect(other)) + math.sqrt(1.0 - self.likeness**2) * own

        missing = {name: size for name, size in self.hidden.items() if name not in names}
        measured = noise
        for name, size in missing.items():
            shown = np.isin(
                np.arange(blocks), self.shown_in if name in self.shows_seldom else np.arange(blocks)
            )
            measured = measured + size * shown[:, None] * columns(find_effect(name))[:, :, 0]
        every = np.concatenate([columns(item) for item in candidates], axis=2)
        return score_statistics_of(every, measured, candidates)


AT_REST = replace(recording_of(readings(np.zeros(1000))), rig=replace(RIG, camera=CAMERA))


def drifts(before_deg: float, after_deg: float) -> Any:
    """Return the drift without an effect and with it, as far as it is read."""
    return SimpleNamespace(rms_deg=before_deg), SimpleNamespace(rms_deg=after_deg)


class TestSearch:
    def test_the_missing_effect_is_added_and_nothing_more(self) -> None:
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0})
        found = search(default_model(), AT_REST, fake)
        (added,) = found.additions
        assert added.effect.name == 'gyro_lag' and added.is_kept and found.kept == found.additions
        assert added.predictive_gain == pytest.approx(400.0) and added.gain > 100.0 and added.sigma > 4.0
        assert added.before is found.first and added.after is found.last
        assert [effect.name for effect in found.last.model.effects] == ['scale_factor', 'gyro_lag']
        assert fake.models == [('scale_factor',), ('scale_factor', 'gyro_lag')]

    def test_two_effects_are_found_one_after_the_other(self) -> None:
        sizes = {'gyro_lag': 1.0, 'scale_cubic': 2.0}
        found = search(default_model(), AT_REST, FakeFilter(sizes, {'gyro_lag': 90.0, 'scale_cubic': 300.0}))
        assert [item.effect.name for item in found.kept] == ['scale_cubic', 'gyro_lag']
        assert found.last.model.version == default_model().version + 2
        assert found.additions[1].before is found.additions[0].after

    @pytest.mark.parametrize(
        ('rise', 'expected', 'is_kept'),
        [(1.4, 0.5, True), (1.6, 0.5, False), (1.6, 2.0, True), (3.1, 2.0, False), (math.nan, 0.5, True)],
    )
    def test_an_effect_that_raises_the_drift_is_not_kept(
        self, rise: float, expected: float, is_kept: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """However much better it predicts; where no drift can be measured, it cannot rise."""
        monkeypatch.setattr(
            'gyrocal_ros.diagnose.search.additions.drift_of_both', lambda *runs: drifts(1.0, rise)
        )
        monkeypatch.setattr(
            'gyrocal_ros.diagnose.search.additions.drift_by_noise_deg', lambda *runs: expected
        )
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.better_sigma', lambda *drifts: -2.0)
        found = search(default_model(), AT_REST, FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0}))
        (added,) = found.additions
        assert added.is_kept == is_kept and added.raises_drift != is_kept
        assert found.last is (added.after if is_kept else found.first)

    @pytest.mark.parametrize(('rose_sigma', 'gained', 'is_kept'), [(0.8, 400.0, True), (1.2, 400.0, False)])
    def test_a_rise_by_chance_does_not_count_against_a_clear_gain(
        self, rose_sigma: float, gained: float, is_kept: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Of two effects, each may make up for the other in the few spans of a recording."""
        monkeypatch.setattr(
            'gyrocal_ros.diagnose.search.additions.drift_of_both', lambda *runs: drifts(0.7, 2.3)
        )
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.drift_by_noise_deg', lambda *runs: 0.1)
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.better_sigma', lambda *drifts: -rose_sigma)
        found = search(default_model(), AT_REST, FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': gained}))
        assert found.additions[0].gain_sigma > CLEAR_SIGMA
        assert found.additions[0].is_kept == is_kept

    def test_readings_that_tell_nothing_are_no_excuse_for_drift(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A limit at the fastest turn would explain any error of fast turns, for these count no more."""
        before, after = (
            SimpleNamespace(run=SimpleNamespace(by_noise_deg=deg), settings=DEFAULT_SETTINGS)
            for deg in (0.3, 5.0)
        )
        module = 'gyrocal_ros.diagnose.search.additions'
        monkeypatch.setattr(f'{module}.drift_of_both', lambda *runs: drifts(0.5, 3.4))
        monkeypatch.setattr(f'{module}.drift_by_noise_deg', lambda run, drift: run.by_noise_deg)
        monkeypatch.setattr(f'{module}.turn_against_body_rad', lambda run: 0.0)
        monkeypatch.setattr(f'{module}.better_sigma', lambda *drifts: math.nan)
        for name, raises in (('rate_saturation', True), ('gyro_noise', False)):
            runs = cast(Any, before), cast(Any, after)
            added = Addition(find_effect(name), *runs, 9.0, 9.0, 0.0, np.zeros(1), NONE)
            assert added.raises_drift == raises

    @pytest.mark.parametrize(('known_from', 'is_kept'), [(0.2, False), (0.9, True)])
    def test_drift_before_an_effect_is_known_does_not_count(
        self, known_from: float, is_kept: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """An effect whose signal changes late makes every span drift that begins before."""
        known_s = known_from * DURATION_S

        def measured(before: Run, after: Run, from_s: float) -> Any:
            return drifts(math.nan, math.nan) if from_s > 0.5 * DURATION_S else drifts(1.0, 9.0)

        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.drift_of_both', measured)
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.drift_by_noise_deg', lambda *runs: 0.5)
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.better_sigma', lambda *drifts: -2.0)
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0}, known_from_s=known_s)
        (added,) = search(default_model(), AT_REST, fake).additions
        assert added.known_from_s == pytest.approx(known_s, abs=1.0) and added.is_kept == is_kept

    def test_a_trial_that_can_use_nothing_ends_the_trial_alone(self) -> None:
        """An effect may be estimated so wrongly that no image fits any more."""
        sizes, gains = {'gyro_lag': 2.0}, {'gyro_lag': 400.0}
        fake = FakeFilter(sizes, gains, unusable_with='gyro_lag')
        found = search(default_model(), AT_REST, fake)
        assert ('scale_factor', 'gyro_lag') in fake.models and found.additions == ()
        with pytest.raises(NotObservableError):
            search(default_model(), AT_REST, FakeFilter(sizes, gains, unusable_with='scale_factor'))

    def test_noise_adds_nothing(self) -> None:
        found = search(default_model(), AT_REST, FakeFilter({}, {}))
        assert found.additions == () and found.last is found.first
        assert found.first.unexplained_structure is None

    @pytest.mark.parametrize('gained', [-50.0, 0.0, 0.9 * MIN_GAIN])
    def test_an_effect_that_does_not_help_is_reported_and_not_kept(self, gained: float) -> None:
        found = search(default_model(), AT_REST, FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': gained}))
        (added,) = found.additions
        assert added.effect.name == 'gyro_lag' and not added.is_kept
        assert added.predictive_gain == pytest.approx(gained)
        assert added.gain > DEFAULT_SETTINGS.coefficient_price
        assert found.kept == () and found.last is found.first

    @pytest.mark.parametrize(('part', 'is_kept'), [(0.9, False), (-0.9, False), (1.1, True), (-1.1, True)])
    def test_an_effect_that_ends_at_zero_is_not_kept(self, part: float, is_kept: bool) -> None:
        """However much predictive log-likelihood it gains: other coefficients have taken its place."""
        ends = {'scale_cubic': part * DEFAULT_SETTINGS.nonzero_sigma * STD}
        fake = FakeFilter({'scale_cubic': 2.0}, {'scale_cubic': 400.0}, ends=ends)
        added, *_ = search(default_model(), AT_REST, fake).additions
        assert added.predictive_gain == pytest.approx(400.0)
        assert added.is_kept == added.stands_out == is_kept

    @pytest.mark.parametrize(('factor', 'is_kept'), [(0.9, True), (1.1, False)])
    def test_an_effect_far_below_its_usual_size_is_a_trace_of_something_else(
        self, factor: float, is_kept: bool
    ) -> None:
        """However significant it is: a signal that is recorded seldom leaves some."""
        (usual,) = find_effect('gyro_lag').coefficients
        assert usual.typical is not None
        strict = replace(DEFAULT_SETTINGS, min_usual_part=factor * 2.0 / usual.typical.low)
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0})
        (added,) = search(default_model(), AT_REST, fake, settings=strict).additions
        assert added.stands_out and added.is_kept == is_kept and added.is_negligible != is_kept

    @pytest.mark.parametrize(('left_deg', 'is_kept'), [(0.05, True), (0.3, False)])
    def test_what_takes_the_drift_away_is_no_trace(
        self, left_deg: float, is_kept: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A bias by vibration is as large as the floor is rough, however small its coefficient is."""
        monkeypatch.setattr(
            'gyrocal_ros.diagnose.search.additions.drift_of_both', lambda *runs: drifts(0.6, left_deg)
        )
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.drift_by_noise_deg', lambda *runs: 0.1)
        (usual,) = find_effect('gyro_lag').coefficients
        assert usual.typical is not None
        strict = replace(DEFAULT_SETTINGS, min_usual_part=1.1 * 2.0 / usual.typical.low)
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0})
        (added,) = search(default_model(), AT_REST, fake, settings=strict).additions
        assert added.is_below(strict.min_usual_part) and added.is_kept == is_kept

    @pytest.mark.parametrize('is_there', [False, True])
    def test_beside_a_trace_only_what_it_does_not_explain_counts(self, is_there: bool) -> None:
        """Images that are a little late are no reason to name an effect that shows in turns as they do."""
        (usual,) = find_effect('gyro_lag').coefficients
        assert usual.typical is not None
        strict = replace(DEFAULT_SETTINGS, min_usual_part=1.1 * 2.0 / usual.typical.low)
        sizes = {'gyro_lag': 2.0} | ({'scale_cubic': 2.0} if is_there else {})
        fake = FakeFilter(sizes, dict.fromkeys(sizes, 400.0), looks_like={'scale_cubic': 'gyro_lag'})
        found = search(default_model(), AT_REST, fake, settings=strict)
        alike = found.first.find('scale_cubic')
        assert alike is not None and alike.is_significant
        names = [item.effect.name for item in found.additions]
        assert 'gyro_lag' in names and ('scale_cubic' in names) == is_there

    @pytest.mark.parametrize(
        ('size', 'constant', 'is_negligible'),
        [
            (0.5, 1.0, False),
            (0.5, 9.0, False),
            (0.5, 0.1, True),
            (9.0, 0.1, False),
            (9.0, -1.0, True),
            (0.05, 9.0, True),
        ],
    )
    @pytest.mark.parametrize('name', ['turn_hysteresis', 'bias_warmup'])
    def test_what_fades_at_once_is_small_though_it_is_strong(
        self, name: str, size: float, constant: float, is_negligible: bool
    ) -> None:
        """It leaves a heading of strength times time constant."""
        effect = find_effect(name)
        usual = [item.typical.low for item in effect.coefficients if item.typical is not None]
        values = np.array([size, constant]) * usual
        after: Any = SimpleNamespace(estimate_of=lambda _: (values, 0.0 * values), settings=DEFAULT_SETTINGS)
        added = Addition(effect, None, after, 9.0, 9.0, 0.0, np.zeros(2), strengths=np.array([0]))
        assert added.is_negligible == is_negligible

    @pytest.mark.parametrize(('name', 'is_trace'), [('focal_length', True), ('radial_distortion', False)])
    def test_a_lens_is_not_named_for_what_the_tilt_gyros_may_do(self, name: str, is_trace: bool) -> None:
        effect = find_effect(name)
        usual = [item.typical for item in effect.coefficients]
        values = 0.8 * np.array([item.low for item in usual if item is not None])
        after: Any = SimpleNamespace(estimate_of=lambda _: (values, 0.0 * values), settings=DEFAULT_SETTINGS)
        added = Addition(effect, None, after, 9.0, 9.0, 0.0, np.zeros(2), strengths=np.array([0]))
        assert added.is_negligible == is_trace

    @pytest.mark.parametrize(
        ('constant_s', 'std_s', 'is_momentary'),
        [(0.004, 0.01, True), (0.004, 0.2, False), (1.0, 0.01, False)],
    )
    def test_a_memory_that_shrinks_to_nothing_is_none(
        self, constant_s: float, std_s: float, is_momentary: bool
    ) -> None:
        """A kink of the scale factor looks like a hysteresis of no duration."""
        values, stds = np.array([math.radians(0.4), constant_s]), np.array([math.radians(0.01), std_s])
        after: Any = SimpleNamespace(estimate_of=lambda _: (values, stds))
        added = Addition(find_effect('turn_hysteresis'), None, after, 9.0, 9.0, 0.0, np.zeros(2), NONE)
        assert added.is_momentary == is_momentary
        left_out: Any = SimpleNamespace(
            effect=added.effect, is_kept=False, is_negligible=True, is_momentary=is_momentary
        )
        assert traces([left_out]) == (set() if is_momentary else {'turn_hysteresis'})

    def test_a_noise_is_no_memory(self) -> None:
        """The size of a walk is far below any time constant."""
        after: Any = SimpleNamespace(estimate_of=lambda _: (np.array([1e-5]), np.array([1e-7])))
        added = Addition(find_effect('bias_instability'), None, after, 9.0, 9.0, 0.0, np.zeros(1), NONE)
        assert not added.is_momentary

    @pytest.mark.slow
    @pytest.mark.parametrize(('part', 'inexact', 'is_found'), [(0.5, '', True), (0.5, 'scale_cubic', False)])
    def test_an_effect_that_hardly_adds_to_what_was_found_is_tried_beside_exact_coefficients(
        self, part: float, inexact: str, is_found: bool
    ) -> None:
        """Where the coefficients found are inexact at the start, some other effect goes with the rest."""
        weak = 1.0
        fake = FakeFilter({'gyro_lag': weak}, {'gyro_lag': 50.0})
        (alone,) = search(default_model(), AT_REST, fake).additions
        strong = math.sqrt(2.0 * alone.gain / (part * DEFAULT_SETTINGS.residual_part) / 200.0)
        sizes = {'scale_cubic': strong, 'gyro_lag': weak}
        gains = {'scale_cubic': 1e4, 'gyro_lag': 50.0}
        fake = FakeFilter(sizes, gains, leftover_of={'gyro_lag': inexact} if inexact else {})
        found = search(default_model(), AT_REST, fake)
        assert [item.effect.name for item in found.additions] == ['scale_cubic', 'gyro_lag'][: 1 + is_found]
        assert fake.models[1:3] == [('scale_factor', 'scale_cubic')] * 2
        assert ('gyro_lag' in fake.models[-1]) == is_found

    @pytest.mark.parametrize(
        ('gained', 'sigma', 'is_kept'),
        [(50.0, 6.0, True), (5.0, 6.0, False), (50.0, 3.5, False)],
    )
    def test_a_run_decides_on_an_effect_that_few_moments_show(
        self, gained: float, sigma: float, is_kept: bool
    ) -> None:
        """Beside others that were found, for their errors may have spoiled the scatter."""
        sizes, gains = {'scale_cubic': 2.0, 'gyro_lag': 6.0}, {'scale_cubic': 300.0, 'gyro_lag': gained}
        fake = FakeFilter(sizes, gains, ends={'gyro_lag': sigma * STD}, shows_seldom=('gyro_lag',))
        cubic, lag = search(default_model(), AT_REST, fake).additions
        assert cubic.is_kept and fake.models[2] == ('scale_factor', 'scale_cubic')
        assert lag.effect.name == 'gyro_lag' and lag.is_kept == is_kept
        assert lag.gain == pytest.approx(gained) and (lag.p_value < 1e-5) == (gained > 10.0)

    @pytest.mark.parametrize(('part', 'is_kept'), [(0.9, False), (1.1, True)])
    def test_what_few_moments_show_has_to_be_of_a_usual_size(self, part: float, is_kept: bool) -> None:
        usual = find_effect('principal_point').coefficients[0].typical
        assert usual is not None and 0.9 * usual.low > DEFAULT_SETTINGS.significant_sigma * STD
        fake = FakeFilter(
            {'scale_cubic': 2.0, 'principal_point': 8.0},
            {'scale_cubic': 300.0, 'principal_point': 50.0},
            ends={'principal_point': part * usual.low},
            shows_seldom=('principal_point',),
            shown_in=(0, 1, 2, 3, 4, 6, 8, 9),
        )
        first, second, *_ = search(default_model(), AT_REST, fake).additions
        assert [(item.effect.name, item.is_kept) for item in (first, second)] == [
            ('scale_cubic', True),
            ('principal_point', is_kept),
        ]

    def test_an_effect_of_the_camera_that_few_moments_show_is_not_tried(self) -> None:
        """Slow errors of images look like it, whatever was found before."""
        sizes, gains = {'scale_cubic': 2.0, 'principal_point': 6.0}, {'scale_cubic': 300.0}
        fake = FakeFilter(sizes, {**gains, 'principal_point': 50.0}, shows_seldom=('principal_point',))
        (added,) = search(default_model(), AT_REST, fake).additions
        assert added.effect.name == 'scale_cubic'

    @pytest.mark.parametrize(
        ('gained', 'sigma', 'is_kept'), [(50.0, 6.0, True), (10.0, 6.0, False), (50.0, 3.0, False)]
    )
    def test_an_effect_of_the_gyro_that_some_moments_show_is_tried_alone(
        self, gained: float, sigma: float, is_kept: bool
    ) -> None:
        """A run decides; without it something is missing all the same, and the diagnosis says so."""
        fake = FakeFilter(
            {'gyro_lag': 6.0},
            {'gyro_lag': gained},
            ends={'gyro_lag': sigma * STD},
            shows_seldom=('gyro_lag',),
            shown_in=(1, 3, 4, 6, 9),
        )
        judging = replace(DEFAULT_SETTINGS, min_judgeable_part=0.0)
        found = search(default_model(), AT_REST, fake, settings=judging)
        assert [(item.effect.name, item.is_kept) for item in found.additions] == [('gyro_lag', is_kept)]
        diagnosed = diagnose(found, AT_REST)
        assert [item.effect.name for item in diagnosed.missing] == ['gyro_lag'] * is_kept
        assert diagnosed.uneven == ('' if is_kept else 'gyro_lag')
        assert 'gyro_lag' not in diagnosed.not_judged
        assert diagnosed.verdict == ('effect_found' if is_kept else 'cannot_tell')

    def test_after_one_that_a_run_rejects_the_next_is_tried(self) -> None:
        sizes = {'gyro_lag': 6.0, 'scale_cubic': 5.8}
        fake = FakeFilter(
            sizes,
            {'gyro_lag': -9.0, 'scale_cubic': 90.0},
            shows_seldom=('gyro_lag', 'scale_cubic'),
            shown_in=(1, 3, 4, 6, 9),
        )
        found = search(default_model(), AT_REST, fake)
        names = [(item.effect.name, item.is_kept) for item in found.additions]
        assert names[:2] == [('gyro_lag', False), ('scale_cubic', True)]

    @pytest.mark.parametrize('is_judged', [True, False])
    @pytest.mark.parametrize('hidden', [{'gyro_lag': 6.0}, {}])
    def test_an_effect_that_one_moment_shows_is_not_tried_alone(
        self, hidden: dict[str, float], is_judged: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        fake = FakeFilter(hidden, {'gyro_lag': 50.0}, shows_seldom=('gyro_lag',))
        judging = replace(DEFAULT_SETTINGS, min_judgeable_part=0.0)
        found = search(default_model(), AT_REST, fake, settings=judging)
        assert found.additions == () and len(fake.models) == 1
        # A fake filter tells nothing of the fit.
        monkeypatch.setattr('gyrocal_ros.diagnose.diagnosis.model_fit', lambda run: ModelFit((), is_judged))
        diagnosed = diagnose(found, AT_REST)
        assert diagnosed.uneven == ''
        assert diagnosed.verdict == ('nothing_missing' if is_judged else 'cannot_tell')

    def test_a_rejected_effect_is_tried_again_beside_one_found_later(self) -> None:
        sizes = {'gyro_lag': 2.0, 'scale_cubic': 1.0}
        fake = FakeFilter(sizes, {'gyro_lag': 400.0, 'scale_cubic': 90.0}, alone={'gyro_lag': 0.0})
        found = search(default_model(), AT_REST, fake)
        names = [(item.effect.name, item.is_kept) for item in found.additions]
        assert names == [('gyro_lag', False), ('scale_cubic', True), ('gyro_lag', True)]

    def test_after_a_rejected_effect_the_next_is_tried_without_it(self) -> None:
        fake = FakeFilter({'gyro_lag': 2.0, 'scale_cubic': 1.0}, {'gyro_lag': -9.0, 'scale_cubic': 90.0})
        found = search(default_model(), AT_REST, fake)
        assert [(item.effect.name, item.is_kept) for item in found.additions] == [
            ('gyro_lag', False),
            ('scale_cubic', True),
            ('gyro_lag', False),
        ]
        assert [effect.name for effect in found.last.model.effects] == ['scale_factor', 'scale_cubic']
        assert fake.models.count(('scale_factor', 'gyro_lag')) == 1

    @pytest.mark.slow
    @pytest.mark.parametrize(('more', 'first'), [(50.0, 'turn_slip'), (0.5 * MIN_GAIN, 'scale_cubic')])
    def test_of_two_that_look_alike_a_run_decides(self, more: float, first: str) -> None:
        sizes = {'turn_slip': 2.0, 'scale_cubic': 2.0}
        fake = FakeFilter(sizes, {'turn_slip': 100.0 + more, 'scale_cubic': 100.0})
        (added,) = search(default_model(), AT_REST, fake, most=1).additions
        assert added.effect.name == first
        assert added.outperformed == (('scale_cubic',) if first == 'turn_slip' else ())
        found = search(default_model(), AT_REST, fake)
        assert {item.effect.name for item in found.kept} == set(sizes), 'both are there in the end'

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ('lag', 'gain', 'first'),
        [
            (-2.0, 100.0, 'scale_cubic'),
            (-2.0, 108.0, 'scale_cubic'),
            (-2.0, 200.0, 'gyro_lag'),
            (2.0, 100.0, 'gyro_lag'),
        ],
    )
    def test_of_two_that_look_alike_the_one_with_an_impossible_sign_gives_way(
        self, lag: float, gain: float, first: str
    ) -> None:
        """A lag is positive; one that predicts clearly better stands for something else, and is left out."""
        fake = FakeFilter({'gyro_lag': lag, 'scale_cubic': 2.0}, {'gyro_lag': gain, 'scale_cubic': 100.0})
        (added,) = search(default_model(), AT_REST, fake, most=1).additions
        assert added.effect.name == first
        assert added.is_kept == (first == 'scale_cubic' or lag > 0.0)

    @pytest.mark.parametrize('size', [2.0, -2.0])
    def test_an_effect_that_would_need_an_impossible_sign_is_not_confused(self, size: float) -> None:
        """Images that are late look like a gyro that reads ahead of time: none does."""
        sizes = {'scale_cubic': size}
        gains = dict.fromkeys(('scale_cubic', 'gyro_lag'), 100.0)
        fake = FakeFilter(sizes, gains, looks_like={'gyro_lag': 'scale_cubic'}, likeness=0.999)
        found = search(default_model(), AT_REST, fake, most=1)
        assert [item.effect.name for item in found.kept] == ['scale_cubic']
        assert ('gyro_lag' in look_alikes(found)['scale_cubic']) == (size > 0.0)

    @pytest.mark.slow
    def test_a_moment_does_not_decide_between_two_that_look_alike(self) -> None:
        fake = FakeFilter(
            {'turn_slip': 2.0, 'scale_cubic': 2.0},
            {'turn_slip': 100.0, 'scale_cubic': 100.0},
            at_once={'turn_slip': 50.0},
        )
        (added,) = search(default_model(), AT_REST, fake, most=1).additions
        assert added.effect.name == 'scale_cubic' and added.outperformed == ()

    @pytest.mark.slow
    def test_the_number_of_runs_is_limited(self) -> None:
        sizes = dict.fromkeys(('gyro_lag', 'scale_cubic', 'turn_slip', 'focal_length'), 2.0)
        fake = FakeFilter(sizes, dict.fromkeys(sizes, 100.0))
        assert len(search(default_model(), AT_REST, fake, most=2).additions) == 2
        assert [len(names) for names in fake.models] == [1, 2, 3, *[3] * DEFAULT_SETTINGS.max_rivals]

    def test_an_effect_starts_with_the_estimate_of_the_scores(self) -> None:
        found = search(default_model(), AT_REST, FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0}))
        (item,) = found.additions[0].effect.coefficients
        assert item.prior_mean == pytest.approx(2.0, abs=0.3)
        assert item.prior_std <= find_effect('gyro_lag').coefficients[0].prior_std

    def test_unexplained_structure_that_explains_more_is_not_forced_into_an_effect(self) -> None:
        fake = FakeFilter({'gyro_lag': 0.8}, {'gyro_lag': 40.0}, knocked())
        found = search(default_model(), AT_REST, fake)
        assert found.additions == ()
        structure = found.first.unexplained_structure
        assert structure is not None and structure.at_s is not None
        assert found.first.ranked[0].effect.name == 'gyro_lag' and found.first.ranked[0].is_significant

    @pytest.mark.parametrize('unbent_by', ['gyro_lag', 'scale_cubic'])
    def test_the_effect_whose_run_leaves_no_structure_is_added(self, unbent_by: str) -> None:
        """However much more the structure gains than all effects, and whichever of them seems best."""
        sizes, gains = {'gyro_lag': 0.8, 'scale_cubic': 0.7}, {'gyro_lag': 60.0, 'scale_cubic': 50.0}
        fake = FakeFilter(sizes, gains, knocked(), unbent_by=unbent_by)
        found = search(default_model(), AT_REST, fake)
        assert found.first.ranked[0].effect.name == 'gyro_lag'
        assert found.additions[0].effect.name == unbent_by and found.additions[0].is_kept
        assert found.first.unexplained_structure is not None and found.last.unexplained_structure is None

    @pytest.mark.parametrize(
        ('fit', 'is_added'),
        [
            (ModelFit((), True, 1.0), True),
            (ModelFit((), True, 2.0), False),
            (ModelFit(('the estimates change',), True, 1.0), False),
            (ModelFit((), False), False),
        ],
    )
    def test_an_effect_that_leaves_only_noise_is_added_whatever_structure_is_left(
        self, fit: ModelFit, is_added: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr('gyrocal_ros.diagnose.search.search.model_fit', lambda run: fit)
        fake = FakeFilter({'gyro_lag': 0.8}, {'gyro_lag': 40.0}, knocked())
        found = search(default_model(), AT_REST, fake)
        assert found.first.unexplained_structure is not None
        assert [item.effect.name for item in found.additions] == ['gyro_lag'] * is_added

    def test_structure_that_the_headings_alone_show_is_ignored(self) -> None:
        found = search(default_model(), AT_REST, FakeFilter({}, {}, knocked()))
        assert found.additions == () and found.first.unexplained_structure is None

    def test_a_filter_that_cannot_run_is_an_error(self) -> None:
        fake = FakeFilter({}, {}, diverges_without='scale_cubic')
        with pytest.raises(FilterDivergedError):
            search(default_model(), AT_REST, fake)

    def test_thresholds_are_those_of_the_settings(self) -> None:
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 400.0})
        strict = replace(DEFAULT_SETTINGS, min_predictive_gain=401.0)
        found = search(default_model(), AT_REST, fake, settings=strict)
        assert found.first.settings is strict and found.last is found.first
        assert [(item.effect.name, item.is_kept) for item in found.additions] == [('gyro_lag', False)]
        stricter = replace(strict, significant_sigma=1e3)
        assert search(default_model(), AT_REST, fake, settings=stricter).additions == ()


def knocked() -> Drive:
    """A gyro whose bias jumps half way."""
    return drive(math.radians(0.3) * (DT_S * np.arange(1000) > 0.5 * DURATION_S), duration_s=DURATION_S)


def saturated() -> Drive:
    """A gyro that reads no more than its limit, on a robot that turns faster."""
    read = np.clip(turning_rad_s(DURATION_S), -LIMIT_RAD_S, LIMIT_RAD_S)
    return drive(duration_s=DURATION_S, read_rad_s=read)


def summary_of(made: Drive) -> RecordingSummary:
    return recording_of(readings_of(made))


class TestLimits:
    def test_a_filter_that_cannot_run_recovers_with_a_limit(self) -> None:
        made = saturated()
        fake = FakeFilter({'gyro_lag': 2.0}, {'gyro_lag': 100.0}, made, diverges_without='rate_saturation')
        found = search(default_model(), summary_of(made), fake)
        recovered, lag = found.additions
        assert recovered.effect.name == 'rate_saturation'
        assert recovered.before is None and recovered.is_kept
        assert recovered.gain == recovered.predictive_gain == math.inf and recovered.p_value == 0.0
        assert recovered.effect.coefficients[0].prior_mean == pytest.approx(LIMIT_RAD_S, rel=0.01)
        assert found.first is recovered.after and lag.before is found.first
        assert [effect.name for effect in found.last.model.effects] == [
            'scale_factor',
            'rate_saturation',
            'gyro_lag',
        ]

    def test_no_limit_is_tried_that_the_readings_do_not_show_or_the_model_has(self) -> None:
        fake = FakeFilter({}, {}, diverges_without='scale_cubic')
        scattered = recording_of(readings(np.random.default_rng(0).normal(size=5000), hz=100.0))
        limit = with_means(find_effect('rate_saturation'), (1.0,))
        for model, recorded in (
            (default_model(), scattered),
            (default_model(), summary_of(saturated())),
            (with_effect(default_model(), limit), summary_of(saturated())),
        ):
            with pytest.raises(FilterDivergedError):
                search(model, recorded, fake)
        with_it = ('scale_factor', 'rate_saturation')
        others = [names for names in fake.models if names[-1] not in RECOVERING]
        assert others == [('scale_factor',), ('scale_factor',), with_it, with_it]

    def test_an_effect_so_large_that_the_filter_cannot_run_is_found(self) -> None:
        fake = FakeFilter({'camera_tilt': 5.0}, {}, diverges_without='camera_tilt')
        found = search(default_model(), AT_REST, fake)
        (added,) = found.kept
        assert added.effect.name == 'camera_tilt' and added.before is None and found.first is added.after
        assert {names[-1] for names in fake.models} >= RECOVERING

    def test_effects_that_may_break_the_filter(self) -> None:
        assert {
            'camera_tilt',
            'camera_time_offset',
            'rolling_shutter',
            'principal_point',
            'focal_length',
            'radial_distortion',
            'gyro_lag',
            'bias_instability',
        } == RECOVERING

    @pytest.mark.parametrize(('gained', 'is_found'), [(1e6, True), (1.0, False)])
    def test_a_limit_has_to_predict_better_than_any_rival(self, gained: float, is_found: bool) -> None:
        made = saturated()
        fake = FakeFilter({}, {'rate_saturation': gained}, made)
        found = search(default_model(), summary_of(made), fake)
        assert ('scale_factor', 'rate_saturation') in fake.models
        assert [item.effect.name for item in found.kept] == ['rate_saturation'] * is_found
        if is_found:
            assert found.additions[0].gain == pytest.approx(gained)

    @pytest.mark.parametrize(('part', 'is_alike'), [(0.9, True), (0.7, False)])
    def test_a_limit_that_predicts_nearly_as_well_is_listed(self, part: float, is_alike: bool) -> None:
        made = saturated()
        gains = {'rate_saturation': part * 400.0, 'gyro_lag': 400.0}
        fake = FakeFilter({'gyro_lag': 2.0}, gains, made, beside={'rate_saturation': 0.0})
        found = search(default_model(), summary_of(made), fake)
        assert [item.effect.name for item in found.kept] == ['gyro_lag']
        (confused,) = (item.confused_with for item in diagnose(found, AT_REST).missing[:1])
        assert ('rate_saturation' in confused) == is_alike


class TestLimitSizes:
    """The size of a limit that noise hides is fitted again beside an effect that is found later."""

    @staticmethod
    def found(best: float, gain: float) -> list[tuple[str, float]]:
        """Return effects and first values after a search that starts with a narrow dead band."""
        narrow, *_ = find_effect('rate_deadband').coefficients[0].scan
        fake = FakeFilter({'gyro_lag': 3.0}, {'gyro_lag': 400.0})

        def calibrate(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
            limit = next(item for item in model.effects if item.name == 'rate_deadband')
            is_best = math.isclose(limit.coefficients[0].prior_mean, best)
            fake.predictive_gains['rate_deadband'] = gain if is_best else 0.0
            return fake(model, candidates)

        model = with_effect(default_model(), with_means(find_effect('rate_deadband'), (narrow,)))
        present = examine(model, AT_REST, calibrate)
        first = examine(default_model(), AT_REST, fake)
        limited = addition(first, present)
        vars(limited)['is_kept'] = True
        last = continued([limited], present, AT_REST, calibrate, most=2)[-1].after
        return [(item.name, item.coefficients[0].prior_mean) for item in last.model.effects]

    @pytest.mark.parametrize(('gain', 'place'), [(50.0, 2), (0.5 * MIN_GAIN, 0)])
    def test_the_width_that_predicts_best_is_taken(self, gain: float, place: int) -> None:
        widths = find_effect('rate_deadband').coefficients[0].scan
        found = dict(self.found(widths[2], gain))
        assert 'gyro_lag' in found and found['rate_deadband'] == widths[place]


class TestElimination:
    def test_an_effect_that_ends_at_zero_beside_the_others_is_removed_and_reported(self) -> None:
        sizes = {'gyro_lag': 2.0, 'scale_cubic': 1.0}
        fake = FakeFilter(sizes, {'gyro_lag': 400.0, 'scale_cubic': 90.0})
        both = search(default_model(), AT_REST, fake)
        assert [item.effect.name for item in both.kept] == ['gyro_lag', 'scale_cubic']
        assert eliminate(both, AT_REST, fake) is both, 'both are far from zero'
        fake.ends = {'gyro_lag': 2.0 * STD}
        fake.alone = {'gyro_lag': 2.0}
        doubtful = search(default_model(), AT_REST, fake)
        found = eliminate(doubtful, AT_REST, fake)
        (removal,) = found.removals
        assert removal.effect.name == 'gyro_lag' and removal.distance == pytest.approx(2.0)
        assert removal.before is doubtful.last and removal.after is found.last
        assert [item.effect.name for item in found.kept] == ['scale_cubic']
        assert [effect.name for effect in found.last.model.effects] == ['scale_factor', 'scale_cubic']
        assert found.last.model.version == doubtful.last.model.version + 1
        assert [missing.effect.name for missing in diagnose(found, AT_REST).missing] == ['scale_cubic']
        shown = improvement(found)
        assert [(one.label, one.is_kept) for one in shown.revisions] == [
            ('0_default', True),
            ('1_gyro_lag', False),
            ('2_scale_cubic', True),
            ('3_without_gyro_lag', True),
        ]
        assert shown.revisions[1].why.startswith('removed again: ')
        assert '2.0 sigma from zero' in shown.final.why and shown.final.examined is found.last

    @pytest.mark.parametrize(('gained', 'is_needed'), [(50.0, True), (0.5 * MIN_GAIN, False)])
    def test_a_run_decides_about_a_limit(self, gained: float, is_needed: bool) -> None:
        """The filter does not estimate it, so it has no distance from zero."""
        made = saturated()
        gains = {'rate_saturation': 1e6, 'gyro_lag': 100.0}
        beside = {'rate_saturation': gained, 'gyro_lag': 1.1e6}
        fake = FakeFilter({'gyro_lag': 2.0}, gains, made, beside=beside)
        both = search(default_model(), summary_of(made), fake)
        assert [item.effect.name for item in both.kept] == ['rate_saturation', 'gyro_lag']
        fake.predictive_gains['gyro_lag'] = beside['gyro_lag']
        found = eliminate(both, summary_of(made), fake)
        assert [item.effect.name for item in found.removals] == ['rate_saturation'] * (not is_needed)

    @pytest.mark.parametrize('drifts_more', [True, False])
    def test_an_effect_without_which_the_robot_drifts_more_stays(
        self, drifts_more: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Where its twin tells as much, its own strength is hardly known."""
        sizes = {'gyro_lag': 2.0, 'scale_cubic': 1.0}
        fake = FakeFilter(sizes, {'gyro_lag': 400.0, 'scale_cubic': 90.0}, alone={'gyro_lag': 2.0})
        fake.ends = {'gyro_lag': 2.0 * STD}
        both = search(default_model(), AT_REST, fake)
        assert [item.effect.name for item in both.kept] == ['gyro_lag', 'scale_cubic']
        monkeypatch.setattr('gyrocal_ros.diagnose.search.additions.drifts_more', lambda *drifts: drifts_more)
        assert bool(eliminate(both, AT_REST, fake).removals) != drifts_more

    def test_an_effect_without_which_the_filter_diverges_stays(self) -> None:
        sizes = {'gyro_lag': 2.0, 'scale_cubic': 1.0}
        fake = FakeFilter(sizes, {'gyro_lag': 400.0, 'scale_cubic': 90.0}, alone={'gyro_lag': 2.0})
        fake.ends = {'gyro_lag': 0.0}
        both = search(default_model(), AT_REST, fake)
        fake.diverges_without = 'gyro_lag'
        assert eliminate(both, AT_REST, fake) is both


class TestTryEffect:
    def test_an_effect_is_tried_whatever_the_scores_are(self) -> None:
        fake = FakeFilter({'gyro_lag': 2.0}, {'scale_cubic': -3.0})
        found = try_effect(default_model(), AT_REST, fake, find_effect('scale_cubic'))
        (added,) = found.additions
        assert added.effect.name == 'scale_cubic' and not added.is_kept and added.sigma < 4.0
        assert found.last is found.first and len(fake.models) == 2

    def test_an_effect_without_scores_keeps_its_prior(self) -> None:
        limit = with_means(find_effect('rate_deadband'), (0.01,))
        fake = FakeFilter({}, {'rate_deadband': 20.0})
        (added,) = try_effect(default_model(), AT_REST, fake, limit).additions
        assert added.effect == limit and added.is_kept
        assert (added.gain, added.sigma, added.p_value) == (0.0, 0.0, 1.0) and not added.stds.any()
