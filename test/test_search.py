"""The search for what is missing, on a filter that is made of numbers; and what it looks at first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from recordings import recording
from synthetic import DT_S, RIG, Drive, drive, readings, score_statistics_of, turning_rad_s

from gyrocal_ros.data import (
    Array,
    CovariateSample,
    ImuSample,
    Measurement,
    Span,
    TemperatureSample,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.diagnose.candidates import candidate_set
from gyrocal_ros.diagnose.limits import with_limit
from gyrocal_ros.diagnose.predictive_gain import predictive_gain, vuong_sigma
from gyrocal_ros.diagnose.ranking import PRICE
from gyrocal_ros.diagnose.search import (
    BESIDES,
    MIN_FORESEEN,
    RESCUERS,
    RIVALS,
    STANDS_OUT,
    search,
    trial,
    with_effect,
)
from gyrocal_ros.diagnose.summarise import MAX_SIGNALS, coarse_step, summarise_recording
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.motion import SPEED_SIGNAL
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import BLOCK_S, ScoreStatistics
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.in_memory import InMemorySource

DURATION_S = 100.0
LIMIT_RAD_S = math.radians(85.0)
STD = 0.01
"""Of every coefficient in the end."""


@dataclass
class Robot:
    """Stands in for the filter: tells of each hidden effect that the model lacks, and what it foresees."""

    hidden: dict[str, float]
    """How strong, in sigma of a block."""
    foresees: dict[str, float]
    """Log-likelihood that an effect of the model gains."""
    made: Drive = field(default_factory=lambda: drive(duration_s=DURATION_S))
    diverges_without: str = ''
    ends: dict[str, float] = field(default_factory=dict)
    """Where the estimate of an effect ends, if elsewhere than where it is hidden."""
    models: list[tuple[str, ...]] = field(default_factory=list)

    def __call__(self, model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        names = tuple(effect.name for effect in model.effects)
        self.models.append(names)
        if self.diverges_without and self.diverges_without not in names:
            raise FilterDivergedError('lost the measurements')
        history = self.made.run.history
        steps, values = len(history.time_s), self.estimates(model)
        scores = self.scores(names, candidates) if candidates else None
        coefficients, uneven = np.tile(values, (steps, 1)), np.linspace(0.5, 1.5, steps)
        told = replace(
            history,
            mean=np.hstack([history.mean[:, :COEFFICIENTS_START], coefficients]),
            std=np.full((steps, COEFFICIENTS_START + len(values)), STD),
            columns=np.hstack([history.columns, np.zeros((steps, len(values) - 1))]),
            log_likelihood=sum(self.foresees.get(name, 0.0) for name in names) / steps * uneven,
        )
        state = replace(self.made.run.state, mean=told.mean[-1], coefficient_count=len(values))
        return replace(self.made.run, model=model, history=told, state=state, scores=scores)

    def estimates(self, model: SensorModel) -> Array:
        """The first coefficient of each effect is as strong as it is hidden."""
        known = {**self.hidden, **self.ends}
        firsts = ((known.get(effect.name, 0.0), effect) for effect in model.effects)
        return np.concatenate([[first, *[0.0] * (len(effect.coefficients) - 1)] for first, effect in firsts])

    def scores(self, names: Sequence[str], candidates: tuple[Effect, ...]) -> ScoreStatistics:
        """Every effect has its own columns, whatever else is on trial."""
        blocks, each = round(DURATION_S / BLOCK_S), 20
        noise = np.random.default_rng(0).normal(size=(blocks, each))

        def columns(effect: Effect) -> Array:
            rng = np.random.default_rng(sum(map(ord, effect.name)))
            return rng.normal(size=(blocks, each, len(effect.coefficients)))

        lacking = {name: size for name, size in self.hidden.items() if name not in names}
        seen = noise + sum(size * columns(find_effect(name))[:, :, 0] for name, size in lacking.items())
        return score_statistics_of(
            np.concatenate([columns(item) for item in candidates], axis=2), seen, candidates
        )


NOTHING_READ = readings(np.zeros(1000))


class TestSearch:
    def test_what_is_missing_is_put_in_and_nothing_more(self) -> None:
        robot = Robot({'gyro_lag': 2.0}, {'gyro_lag': 400.0})
        found = search(default_model(), NOTHING_READ, robot)
        (change,) = found.additions
        assert change.effect.name == 'gyro_lag' and change.is_kept and found.kept == found.additions
        assert change.predictive_gain == pytest.approx(400.0) and change.gain > 100.0 and change.sigma > 4.0
        assert change.before is found.first and change.after is found.last
        assert [effect.name for effect in found.last.model.effects] == ['scale_factor', 'gyro_lag']
        assert robot.models == [('scale_factor',), ('scale_factor', 'gyro_lag')]

    def test_two_are_found_one_after_the_other(self) -> None:
        sizes = {'gyro_lag': 1.0, 'scale_cubic': 2.0}
        found = search(default_model(), NOTHING_READ, Robot(sizes, {'gyro_lag': 90.0, 'scale_cubic': 300.0}))
        assert [change.effect.name for change in found.kept] == ['scale_cubic', 'gyro_lag']
        assert found.last.model.version == default_model().version + 2
        assert found.additions[1].before is found.additions[0].after

    def test_nothing_is_made_of_chance(self) -> None:
        found = search(default_model(), NOTHING_READ, Robot({}, {}))
        assert (
            found.additions == () and found.last is found.first and found.first.unexplained_structure is None
        )

    @pytest.mark.parametrize('gained', [-50.0, 0.0, 0.9 * MIN_FORESEEN])
    def test_what_does_not_help_is_not_kept_and_is_said(self, gained: float) -> None:
        found = search(default_model(), NOTHING_READ, Robot({'gyro_lag': 2.0}, {'gyro_lag': gained}))
        (change,) = found.additions
        assert change.effect.name == 'gyro_lag' and not change.is_kept
        assert change.predictive_gain == pytest.approx(gained) and change.gain > PRICE
        assert found.kept == () and found.last is found.first

    @pytest.mark.parametrize(('part', 'is_kept'), [(0.9, False), (-0.9, False), (1.1, True), (-1.1, True)])
    def test_what_ends_at_zero_is_not_there(self, part: float, is_kept: bool) -> None:
        """However much better the recording is foreseen: other coefficients have taken its place."""
        doubt = search(default_model(), NOTHING_READ, Robot({'gyro_lag': 2.0}, {})).changes[0].stds[0]
        ends = {'gyro_lag': part * STANDS_OUT * max(doubt, STD)}
        robot = Robot({'gyro_lag': 2.0}, {'gyro_lag': 400.0}, ends=ends)
        (change,) = search(default_model(), NOTHING_READ, robot).changes
        assert (
            change.predictive_gain == pytest.approx(400.0) and change.is_kept == change.stands_out == is_kept
        )

    @pytest.mark.parametrize(('part', 'tried'), [(0.5, False), (2.0, True)])
    def test_what_hardly_adds_to_what_was_found_is_not_tried(self, part: float, tried: bool) -> None:
        """What was found is not quite exact, and something always goes with the rest."""
        weak = 1.0
        robot = Robot({'gyro_lag': weak}, {'gyro_lag': 50.0})
        (alone,) = search(default_model(), NOTHING_READ, robot).changes
        strong = math.sqrt(2.0 * alone.gain / (part * BESIDES) / 200.0)
        sizes = {'scale_cubic': strong, 'gyro_lag': weak}
        found = search(default_model(), NOTHING_READ, Robot(sizes, {'scale_cubic': 1e4, 'gyro_lag': 50.0}))
        names = [change.effect.name for change in found.additions]
        assert names[0] == 'scale_cubic' and ('gyro_lag' in names) == tried

    def test_after_a_rejected_one_the_next_is_tried_without_it(self) -> None:
        robot = Robot({'gyro_lag': 2.0, 'scale_cubic': 1.0}, {'gyro_lag': -9.0, 'scale_cubic': 90.0})
        found = search(default_model(), NOTHING_READ, robot)
        assert [(change.effect.name, change.is_kept) for change in found.additions] == [
            ('gyro_lag', False),
            ('scale_cubic', True),
        ]
        assert [effect.name for effect in found.last.model.effects] == ['scale_factor', 'scale_cubic']
        assert robot.models.count(('scale_factor', 'gyro_lag')) == 1

    @pytest.mark.parametrize(('more', 'first'), [(50.0, 'turn_slip'), (0.5 * MIN_FORESEEN, 'scale_cubic')])
    def test_of_two_that_look_alike_a_run_decides(self, more: float, first: str) -> None:
        sizes = {'turn_slip': 2.0, 'scale_cubic': 2.0}
        robot = Robot(sizes, {'turn_slip': 100.0 + more, 'scale_cubic': 100.0})
        (change,) = search(default_model(), NOTHING_READ, robot, most=1).changes
        assert change.effect.name == first
        assert change.outdone == (('scale_cubic',) if first == 'turn_slip' else ())
        found = search(default_model(), NOTHING_READ, robot)
        assert {change.effect.name for change in found.kept} == set(sizes), 'both are there in the end'

    def test_it_ends_after_so_many(self) -> None:
        sizes = dict.fromkeys(('gyro_lag', 'scale_cubic', 'turn_slip', 'focal_length'), 2.0)
        robot = Robot(sizes, dict.fromkeys(sizes, 100.0))
        assert len(search(default_model(), NOTHING_READ, robot, most=2).changes) == 2
        assert [len(names) for names in robot.models] == [1, 2, 3, *[3] * RIVALS]

    def test_an_effect_begins_where_the_evidence_puts_it(self) -> None:
        found = search(default_model(), NOTHING_READ, Robot({'gyro_lag': 2.0}, {'gyro_lag': 400.0}))
        (item,) = found.additions[0].effect.coefficients
        assert item.prior_mean == pytest.approx(2.0, abs=0.3)
        assert found.additions[0].stds[0] == pytest.approx(1.0 / math.sqrt(200.0), rel=0.5)

    def test_something_unknown_that_explains_more_is_not_forced_into_an_effect(self) -> None:
        robot = Robot({'gyro_lag': 0.8}, {'gyro_lag': 40.0}, knocked())
        found = search(default_model(), NOTHING_READ, robot)
        assert found.additions == ()
        assert (
            found.first.unexplained_structure is not None
            and found.first.unexplained_structure.at_s is not None
        )
        assert found.first.ranked[0].effect.name == 'gyro_lag' and found.first.ranked[0].is_significant

    def test_what_the_headings_alone_see_is_not_believed(self) -> None:
        found = search(default_model(), NOTHING_READ, Robot({}, {}, knocked()))
        assert found.additions == () and found.first.unexplained_structure is None

    def test_a_filter_that_cannot_run_is_an_error(self) -> None:
        robot = Robot({}, {}, diverges_without='scale_cubic')
        with pytest.raises(FilterDivergedError):
            search(default_model(), NOTHING_READ, robot)


def knocked() -> Drive:
    """A gyro whose bias jumps half way."""
    return drive(math.radians(0.3) * (DT_S * np.arange(1000) > 0.5 * DURATION_S), duration_s=DURATION_S)


def saturated() -> Drive:
    """A gyro that reads no more than its limit, on a robot that turns faster."""
    read = np.clip(turning_rad_s(DURATION_S), -LIMIT_RAD_S, LIMIT_RAD_S)
    return drive(duration_s=DURATION_S, read_rad_s=read)


def read_by(made: Drive) -> RecordingSummary:
    """The readings that a drive was run on."""
    history = made.run.history
    return readings(history.turn_rad / history.dt_s, start_s=0.5 * DT_S)


class TestLimits:
    def test_a_filter_that_cannot_run_is_rescued_by_a_limit(self) -> None:
        made = saturated()
        robot = Robot({'gyro_lag': 2.0}, {'gyro_lag': 100.0}, made, diverges_without='rate_saturation')
        found = search(default_model(), read_by(made), robot)
        rescue, lag = found.additions
        assert rescue.effect.name == 'rate_saturation' and rescue.before is None and rescue.is_kept
        assert rescue.gain == rescue.predictive_gain == math.inf and rescue.p_value == 0.0
        assert rescue.effect.coefficients[0].prior_mean == pytest.approx(LIMIT_RAD_S, rel=0.01)
        assert found.first is rescue.after and lag.before is found.first
        assert [effect.name for effect in found.last.model.effects] == [
            'scale_factor',
            'rate_saturation',
            'gyro_lag',
        ]

    def test_no_limit_rescues_what_has_no_pile_or_has_it_already(self) -> None:
        robot = Robot({}, {}, diverges_without='scale_cubic')
        scattered = readings(np.random.default_rng(0).normal(size=5000), hz=100.0)
        for model, recorded in (
            (default_model(), scattered),
            (default_model(), read_by(saturated())),
            (with_effect(default_model(), with_limit('rate_saturation', 1.0)), read_by(saturated())),
        ):
            with pytest.raises(FilterDivergedError):
                search(model, recorded, robot)
        with_it = ('scale_factor', 'rate_saturation')
        without_rescuers = [names for names in robot.models if names[-1] not in RESCUERS]
        assert without_rescuers == [('scale_factor',), ('scale_factor',), with_it, with_it]

    def test_an_effect_so_large_that_the_filter_cannot_run_is_found(self) -> None:
        robot = Robot({'camera_tilt': 5.0}, {}, diverges_without='camera_tilt')
        found = search(default_model(), NOTHING_READ, robot)
        (change,) = found.kept
        assert change.effect.name == 'camera_tilt' and change.before is None and found.first is change.after
        assert {names[-1] for names in robot.models} >= set(RESCUERS)

    @pytest.mark.parametrize(('gained', 'is_in'), [(1e6, True), (1.0, False)])
    def test_a_limit_has_to_foresee_more_than_any_rival(self, gained: float, is_in: bool) -> None:
        made = saturated()
        robot = Robot({}, {'rate_saturation': gained}, made)
        found = search(default_model(), read_by(made), robot)
        assert ('scale_factor', 'rate_saturation') in robot.models
        assert [change.effect.name for change in found.kept] == ['rate_saturation'] * is_in
        if is_in:
            assert found.additions[0].gain == pytest.approx(gained)


class TestTrial:
    def test_one_effect_is_tried_whatever_is_said_of_it(self) -> None:
        robot = Robot({'gyro_lag': 2.0}, {'scale_cubic': -3.0})
        found = trial(default_model(), NOTHING_READ, robot, find_effect('scale_cubic'))
        (change,) = found.additions
        assert change.effect.name == 'scale_cubic' and not change.is_kept and change.sigma < 4.0
        assert found.last is found.first and len(robot.models) == 2

    def test_one_that_has_no_evidence_is_tried_as_it_is(self) -> None:
        limit = with_limit('rate_deadband', 0.01)
        (change,) = trial(default_model(), NOTHING_READ, Robot({}, {'rate_deadband': 20.0}), limit).changes
        assert change.effect == limit and change.is_kept
        assert (change.gain, change.sigma, change.p_value) == (0.0, 0.0, 1.0) and not change.stds.any()


class TestForesight:
    def gained(self, log_likelihood: Array | float, dof: Array | float = 1.0) -> Run:
        made = drive(duration_s=DURATION_S).run
        full = np.ones(len(made.history.time_s))
        return replace(
            made, history=replace(made.history, log_likelihood=log_likelihood * full, dof=dof * full)
        )

    def test_it_is_the_difference_of_log_likelihoods_by_blocks(self) -> None:
        ramp = np.linspace(0.0, 1.0, round(DURATION_S / DT_S))
        gains = predictive_gain(self.gained(1.0), self.gained(1.0 + ramp))
        each = round(BLOCK_S / DT_S)
        np.testing.assert_allclose(gains, ramp.reshape(-1, each).sum(axis=1))
        np.testing.assert_allclose(
            predictive_gain(self.gained(1.0 + ramp), self.gained(1.0)).sum(), -ramp.sum(), rtol=0.01
        )

    def test_to_have_used_more_features_is_no_gain(self) -> None:
        """Twice as many, each foreseen as well as before."""
        np.testing.assert_allclose(
            predictive_gain(self.gained(-2.0, 4.0), self.gained(-4.0, 8.0)), 0.0, atol=1e-9
        )
        assert predictive_gain(self.gained(-2.0, 4.0), self.gained(-3.0, 8.0)).sum() == pytest.approx(1000.0)

    def test_a_run_that_ended_earlier_gains_nothing_later(self) -> None:
        short = self.gained(3.0)
        half = {
            name: getattr(short.history, name)[:500] for name in ('time_s', 'log_likelihood', 'dof', 't_ns')
        }
        gains = predictive_gain(self.gained(1.0), replace(short, history=replace(short.history, **half)))
        assert len(gains) == round(DURATION_S / BLOCK_S)
        assert np.all(gains[:5] > 0.0)

    def test_certainty_is_mean_over_scatter(self) -> None:
        gains = np.array([1.0, 3.0, 2.0, 2.0])
        assert vuong_sigma(gains) == pytest.approx(8.0 / (2.0 * math.sqrt(2.0 / 3.0)))
        assert vuong_sigma(-gains) == -vuong_sigma(gains)
        assert vuong_sigma(gains[:1]) == vuong_sigma(np.ones(5)) == 0.0


class TestLookAt:
    def source(self, *measurements: Measurement) -> InMemorySource:
        return InMemorySource('made', RIG, Span(0, nanoseconds(10.0)), measurements)

    def signal(self, name: str, *values: float) -> list[Measurement]:
        return [CovariateSample(place, name, value) for place, value in enumerate(values)]

    def test_signals_and_readings(self) -> None:
        recorded = summarise_recording(
            self.source(
                *(ImuSample(t_ns, (9.0, 9.0, 0.1 * t_ns), (0.0, 0.0, 9.8)) for t_ns in range(3)),
                *self.signal('fan', 1.0, 3.0),
                *self.signal('still', 7.0, 7.0),
                WheelSample(1, 0.2, 0.0),
                WheelSample(2, 0.4, 0.0),
                TemperatureSample(3, 25.0),
            )
        )
        assert recorded.rate_t_ns.tolist() == [0, 1, 2]
        np.testing.assert_allclose(recorded.rate_rad_s, [0.0, 0.1, 0.2])
        about = {signal.name: (signal.mean, signal.spread) for signal in recorded.signals}
        assert about == {'fan': (2.0, 1.0), SPEED_SIGNAL: (pytest.approx(0.3), pytest.approx(0.1))}
        assert recorded.has_temperature and recorded.extras == {'temperature'}
        assert recorded.duration_s == 10.0 and recorded.left_out == () and recorded.rig is RIG

    def test_of_too_many_signals_those_that_vary_most_are_tried(self) -> None:
        few = [f'steady{place}' for place in range(3)]
        many = [f'lively{place}' for place in range(MAX_SIGNALS)]
        measurements = [item for name in few for item in self.signal(name, 10.0, 10.1)]
        measurements += [item for name in many for item in self.signal(name, 1.0, -1.0)]
        recorded = summarise_recording(self.source(*measurements))
        assert {signal.name for signal in recorded.signals} == set(many)
        assert sorted(recorded.left_out) == few

    def test_nothing_but_what_is_there(self) -> None:
        recorded = summarise_recording(self.source())
        assert recorded.signals == () and recorded.extras == set() and len(recorded.rate_rad_s) == 0

    def test_a_recording_offers_its_covariates(self) -> None:
        recorded = summarise_recording(recording('cleaning', 1, 20.0))
        names = {signal.name for signal in recorded.signals}
        assert {SPEED_SIGNAL, 'battery_state.current'} <= names
        tried = {item.effect.name for item in candidate_set(default_model(), recorded).trials}
        assert f'covariate_bias:{SPEED_SIGNAL}' in tried
        assert len(recorded.rate_rad_s) == pytest.approx(2000, abs=5)


class TestCoarseStep:
    """Of the gyro's converter, by its readings."""

    @staticmethod
    def step_deg_s(rate_rad_s: Array) -> float | None:
        step = coarse_step(readings(rate_rad_s))
        return None if step is None else math.degrees(step)

    @staticmethod
    def turning(noise_deg_s: float) -> Array:
        time_s = np.arange(12_000) / 200.0
        noise = np.random.default_rng(1).normal(size=len(time_s))
        slow: Array = np.radians(60.0 * np.sin(0.2 * time_s) ** 5 + noise_deg_s * noise)
        return slow

    @pytest.mark.parametrize('step_deg_s', [0.1, 0.5])
    def test_is_told_where_it_is_wider_than_the_noise(self, step_deg_s: float) -> None:
        step = math.radians(step_deg_s)
        read = step * np.round(self.turning(0.2 * step_deg_s) / step) - 0.0123
        assert self.step_deg_s(read) == pytest.approx(step_deg_s)
        assert self.step_deg_s(-1.07 * read) == pytest.approx(1.07 * step_deg_s)

    def test_does_no_harm_where_the_noise_is_wider(self) -> None:
        step = math.radians(0.1)
        assert self.step_deg_s(step * np.round(self.turning(0.1) / step)) is None

    def test_is_not_seen_where_there_is_none(self) -> None:
        smooth = self.turning(0.01)
        assert self.step_deg_s(smooth) is None
        assert self.step_deg_s(np.where(np.abs(smooth) < 0.01, 0.0, smooth)) is None, 'a dead band'
        assert self.step_deg_s(np.clip(smooth, -0.5, 0.5)) is None, 'a limit'
        assert self.step_deg_s(np.zeros(5000)) is None
        assert self.step_deg_s(np.empty(0)) is None
