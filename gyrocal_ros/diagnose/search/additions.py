"""The steps of a search: effects that were added to a model, and removed again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.drift import (
    better_sigma,
    drift_by_noise_deg,
    drift_of_both,
    drifts_more,
    turn_against_body_rad,
)
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, coefficient_places
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.effects.traits import has_impossible_sign, least_shown_part, scanned_coefficient
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.sensor import Effect, LimitEffect
from gyrocal_ros.statistics import vuong_sigma

NONE: IntArray = np.empty(0, np.int64)
CLEAR_SIGMA, CHANCE_SIGMA = 4.0, 1.0
"""Significance from which a predictive gain is clear, and below which a rise of the drift is chance."""
DRIFT_LEFT = 1.0 / 3.0
"""Part of a drift that an effect leaves at most that takes it away."""
MOMENTARY = 0.1
"""Time constant, as a part of the shortest one that is tried, below which a memory is none."""
KNOWN_PART = 0.5
"""Standard deviation of an effect, as a part of its size, from which the filter has learned what it is."""


IMPOSSIBLE_SIGN = 'it has a sign that no sensor has: it stands for something else'
"""Objection to an effect."""


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that was added to the model."""

    effect: Effect
    """The effect with the prior that it was added with."""
    before: ExaminedModel | None
    """None where the filter could not run without it."""
    after: ExaminedModel
    gain: float
    """Log-likelihood that the score statistics predicted; for a limit, what the run gained."""
    sigma: float
    p_value: float
    stds: Array
    """(k,) standard deviations of coefficients that the filter does not estimate; zero for all others."""
    strengths: IntArray
    """(q,) indices of the coefficients that say how strong it is; not a limit or a time constant."""
    outperformed: tuple[str, ...] = ()
    """Effects that looked like it, until a run with each predicted the recording clearly worse."""
    alike: tuple[str, ...] = ()
    """Limits with which a run predicts the recording nearly as well; no score statistics tell of them."""
    objection: str = ''
    """Clause that says why a run does not confirm it, for a learned effect, one that shows at few moments, or
    one that follows a recorded signal; empty if it does."""
    rival: Addition | None = None
    """Law with which a run predicts nearly as well as with this noise."""
    is_shown: bool = False
    """True for a noise that the readings themselves show."""
    together_with: tuple[str, ...] = ()
    """Effects beside which alone it explains the recording; they are judged when all are added."""
    is_rewritten: bool = False
    """True for a closed form in place of the learned curve or memory of the same name."""

    @property
    def predictive_gain(self) -> float:
        """Predictive log-likelihood gained over the model before."""
        return (
            math.inf if self.before is None else float(predictive_gain(self.before.run, self.after.run).sum())
        )

    @property
    def gain_sigma(self) -> float:
        """Significance of the predictive gain."""
        return (
            math.inf if self.before is None else vuong_sigma(predictive_gain(self.before.run, self.after.run))
        )

    @property
    def stands_out(self) -> bool:
        """True if any of its strengths is clear of zero once all others are estimated beside it."""
        return self.distance_from_zero(self.after) > self.after.settings.nonzero_sigma

    @cached_property
    def is_kept(self) -> bool:
        """True if the recording is predicted better with it, it is not negligible, and nothing gets worse.

        A closed form need only predict as well as the curve. So does noise that the readings themselves show,
        for the filter takes it over. What the filter cannot run without is kept.
        """
        if self.before is None or self.together_with:
            return True
        least = self.after.settings.min_predictive_gain
        predicts = self.predictive_gain > (-least if self.is_rewritten or self.is_shown else least)
        counts = self.stands_out and not self.is_negligible and not self.is_momentary
        gets_worse = bool(self.objection) or self.raises_drift or self.spoils_fit
        return predicts and counts and not gets_worse

    @cached_property
    def is_negligible(self) -> bool:
        """True if all of its strengths are far smaller than in real sensors: the trace of something else.

        What takes most of the drift away is none: a bias by vibration is as large as the floor is rough.
        """
        settings, is_of_camera = self.after.settings, self.effect.acts_on == 'camera'
        part = settings.min_usual_part_camera if is_of_camera else settings.min_usual_part
        return self.is_below(max(part, least_shown_part(self.effect))) and not self.takes_drift_away

    @property
    def is_momentary(self) -> bool:
        """True if its memory has shrunk to nothing: what it stands for goes with the motion of the moment."""
        place = scanned_coefficient(self.effect)
        if place is None or self.effect.coefficients[place].unit != 's':
            return False
        values, stds = self.after.estimate_of(self.effect.name)
        shortest = self.effect.coefficients[place].scan[0]
        return bool(values[place] + 2.0 * stds[place] < MOMENTARY * shortest)

    @property
    def takes_drift_away(self) -> bool:
        """True if little is left of a held-out drift that noise does not explain."""
        if self.before is None:
            return False
        earlier, later = drift_of_both(self.before.run, self.after.run)
        by_noise_deg = self.after.settings.max_drift_rise * drift_by_noise_deg(self.after.run, later)
        return earlier.rms_deg > max(by_noise_deg, later.rms_deg / DRIFT_LEFT)

    @property
    def spoils_fit(self) -> bool:
        """True if the model fits without it and not with it: what it stands for is not constant."""
        if self.before is None or not model_fit(self.before.run).fits:
            return False
        return model_fit(self.after.run).fits is False

    def is_below(self, part: float) -> bool:
        """Return True if all of its strengths are smaller than a part of the smallest usual ones.

        What fades leaves a heading of strength times time constant, so a time constant below the usual ones
        makes it smaller, too.
        """
        values, _ = self.after.estimate_of(self.effect.name)
        usual = [item.typical for item in self.effect.coefficients]
        sizes = [
            math.inf if item is None else value / item.low for item, value in zip(usual, values, strict=True)
        ]
        fading = [size for size, item in zip(sizes, usual, strict=True) if item and not item.is_strength]
        memory = max(min([1.0, *fading]), 0.0)
        return len(self.strengths) > 0 and all(abs(sizes[place]) * memory < part for place in self.strengths)

    @property
    def is_impossible(self) -> bool:
        """True if a coefficient has a sign that no real sensor has."""
        return has_impossible_sign(self.effect, *self.after.estimate_of(self.effect.name))

    @property
    def raises_drift(self) -> bool:
        """True if the held-out drift rises with the effect by more than chance does where it is harmless.

        Only spans count that begin when the effect is known: a coefficient that nothing has shown yet makes
        any heading drift. Drift that the model expects does not count against it: with a noise the filter
        follows the bias faster, a loose camera turns against the robot, and in a short recording a span
        begins while the scale factor is a guess. That readings beyond a limit tell nothing is no excuse: with
        what they tell, the robot drifted less. A rise by chance does not count against a clear gain: with two
        effects, what is missing of one may make up for the other in the few spans of a recording.
        """
        if self.before is None:
            return False
        earlier, later = drift_of_both(self.before.run, self.after.run, self.known_from_s)
        expecting = self.before.run if isinstance(self.effect, LimitEffect) else self.after.run
        turned_deg = math.degrees(turn_against_body_rad(self.after.run))
        least_deg = max(math.hypot(earlier.rms_deg, turned_deg), drift_by_noise_deg(expecting, later))
        if not later.rms_deg > self.after.settings.max_drift_rise * least_deg:
            return False
        is_chance = better_sigma(earlier, later) > -CHANCE_SIGMA
        return not (is_chance and self.gain_sigma > CLEAR_SIGMA)

    @property
    def known_from_s(self) -> float:
        """Time at which the strengths are known to `KNOWN_PART` of their size; 0 without any."""
        if not len(self.strengths):
            return 0.0
        history = self.after.run.history
        places = coefficient_places(self.after.model, self.effect.name).start + self.strengths
        size = float(np.linalg.norm(self.after.run.state.coefficients[places]))
        is_known = np.linalg.norm(history.std[:, COEFFICIENTS_START + places], axis=1) <= KNOWN_PART * size
        return float(history.time_s[np.argmax(is_known)]) if is_known.any() else float(history.time_s[-1])

    def distance_from_zero(self, examined: ExaminedModel) -> float:
        """Return how far its strongest coefficient is from zero in a model with it, in standard deviations.

        Infinite for a limit or a noise, whose size the filter does not estimate.
        """
        if not len(self.strengths):
            return math.inf
        values, stds = (part[self.strengths] for part in examined.estimate_of(self.effect.name))
        estimated = stds > 0.0
        return float(np.max(np.abs(values[estimated]) / stds[estimated], initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Removal:
    """An effect that was removed again, for it does not earn its place beside those found after it."""

    effect: Effect
    before: ExaminedModel
    after: ExaminedModel
    distance: float
    """Distance from zero of its strongest coefficient beside all others, in standard deviations."""
    is_harmful: bool = False
    """True for a noise that is there, but with which the robot drifts more."""
    was_beside_noise: bool = False
    """True for an effect that was found beside such a noise, and with which the robot drifts no less."""

    @property
    def predictive_gain(self) -> float:
        """Predictive log-likelihood that the model without it gains; negative where it loses some."""
        return float(predictive_gain(self.before.run, self.after.run).sum())

    @property
    def is_needed(self) -> bool:
        """True if without it the recording is predicted worse, and the robot drifts more.

        A limit or a noise has no distance from zero: that the prediction is worse is enough.
        """
        loses = -self.predictive_gain > self.after.settings.min_predictive_gain
        if not loses or math.isinf(self.distance):
            return loses
        return drifts_more(*drift_of_both(self.before.run, self.after.run))


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A finished search."""

    first: ExaminedModel
    additions: tuple[Addition, ...]
    """Kept and rejected ones, in the order in which they were tried."""
    removals: tuple[Removal, ...] = ()
    """Effects that were kept at first and removed in the end."""

    @property
    def kept(self) -> tuple[Addition, ...]:
        """Additions that helped, and that were not removed again or rewritten in closed form.

        A noise may be added again, smaller.
        """
        rewritten = [item for item in self.additions if item.is_rewritten and item.is_kept]
        removed = {item.effect.name: item.after.model.version - 1 for item in rewritten}
        removed |= {item.effect.name: item.after.model.version for item in self.removals}
        return tuple(
            item
            for item in self.additions
            if item.is_kept and item.after.model.version > removed.get(item.effect.name, 0)
        )

    @property
    def last(self) -> ExaminedModel:
        """The latest version of the model, with all additions that helped."""
        helped = [item.after for item in self.additions if item.is_kept]
        versions = [self.first, *helped, *(item.after for item in self.removals)]
        return max(versions, key=lambda examined: examined.model.version)

    def with_last(self, examined: ExaminedModel) -> Search:
        """Return the search with another examination of its last model."""
        last = self.last
        if last is self.first:
            return replace(self, first=examined)
        additions = [replace(item, after=examined) if item.after is last else item for item in self.additions]
        removals = [replace(item, after=examined) if item.after is last else item for item in self.removals]
        return replace(self, additions=tuple(additions), removals=tuple(removals))


def addition(before: ExaminedModel, after: ExaminedModel) -> Addition:
    """Describe the last effect of the model `after`, which is not in the model before."""
    effect = after.model.effects[-1]
    found = before.find(effect.name)
    unknown = np.zeros(len(effect.coefficients))
    if found is None:
        return Addition(effect, before, after, 0.0, 0.0, 1.0, unknown, NONE)
    return Addition(
        effect=effect,
        before=before,
        after=after,
        gain=found.fit.gain,
        sigma=found.fit.sigma,
        p_value=found.fit.p_value,
        stds=unknown,
        strengths=found.places,
    )
