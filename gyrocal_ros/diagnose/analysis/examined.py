"""A model on a recording, and what the recording says that it lacks."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidates import candidates_for, with_disturbances
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, headings
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect, rank, with_estimate, without_disturbed
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure, confirmed, unexplained_structure
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.effects.traits import is_noise, is_unusual
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.scatter import scatter_of
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class ExaminedModel:
    """One model on a recording, and what the recording says that it lacks."""

    model: SensorModel
    run: Run
    scores: ScoreStatistics
    ranked: tuple[RankedEffect, ...]
    """Candidate effects, the best first."""
    disturbed: dict[str, str]
    """Effects that are not among them because what the camera sees explains more, and what that is."""
    seen: Headings
    unexplained_structure: UnexplainedStructure | None
    """Structure left over as a function of something recorded; None where it may be chance."""
    settings: DiagnosisSettings

    def find(self, name: str) -> RankedEffect | None:
        """Return the candidate of that name."""
        return next((item for item in self.ranked if item.effect.name == name), None)

    def estimate_of(self, name: str) -> tuple[Array, Array]:
        """Return the final estimates (k,) of the coefficients of an effect of the model.

        Their standard deviations (k,) are those that the scatter over the recording supports. What is
        suspected of the camera does not add to them: an effect in the model is no suspicion any more.
        """
        places = coefficient_places(self.model, name)
        inflation = scatter_of(self.run)[0].inflation[1:]
        stds = self.run.history.std[-1, COEFFICIENTS_START:] * inflation
        return self.run.state.coefficients[places], stds[places]


def examine(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> ExaminedModel:
    """Run the filter with a model and with everything else as candidates."""
    candidates = with_disturbances(candidates_for(model, recording), recording)
    run = calibrate(model, candidates.carried)
    assert run.scores is not None
    scores, seen = candidates.project(run.scores), headings(run, settings)
    ranked, disturbed = without_disturbed(rank(scores, settings), settings)
    most_gained = max((item.fit.gain for item in ranked if item.effect.acts_on == 'gyro'), default=0.0)
    structure = confirmed(unexplained_structure(run, seen, settings), most_gained, settings)
    return ExaminedModel(model, run, scores, tuple(ranked), disturbed, seen, structure, settings)


def contradicts(examined: ExaminedModel) -> bool:
    """Return True if the recording contradicts a model, whatever it lacks."""
    return examined.unexplained_structure is not None or model_fit(examined.run).fits is False


def unusual_noises(model: SensorModel) -> list[Effect]:
    """Return the noises of a model that no gyro has: with these it owes its fit to the filter alone."""
    return [
        item for item in model.effects if is_noise(item) and is_unusual(item, item.coefficients[0].prior_mean)
    ]


def gain_of_run(present: ExaminedModel, model: SensorModel, calibrate: Calibrate) -> float:
    """Return the predictive log-likelihood that a run with a model gains; minus infinity without a run."""
    with suppress(*CANNOT_RUN):
        return float(predictive_gain(present.run, calibrate(model, ())).sum())
    return -math.inf


def wider_model(present: ExaminedModel, effect: Effect) -> SensorModel:
    """Return the model with one more effect, its prior by the score statistics where there are any."""
    found = present.find(effect.name)
    if found is not None:
        effect = with_estimate(found, present.scores, present.settings)
    return with_effect(present.model, effect)


def with_effect(model: SensorModel, effect: Effect) -> SensorModel:
    """Return the next version of the model, with one more effect."""
    return replace(model, effects=(*model.effects, effect), version=model.version + 1)


def without_effect(model: SensorModel, name: str) -> SensorModel:
    """Return the next version of the model, without the effect of that name."""
    effects = tuple(effect for effect in model.effects if effect.name != name)
    return replace(model, effects=effects, version=model.version + 1)


def coefficient_places(model: SensorModel, name: str) -> slice:
    """Return the places of an effect's coefficients among those of its model."""
    start = 0
    for effect in model.effects:
        end = start + len(effect.coefficients)
        if effect.name == name:
            return slice(start, end)
        start = end
    raise KeyError(name)
