"""Backward elimination: effects that were added, tested again beside all others."""

from __future__ import annotations

import math
from dataclasses import replace

from gyrocal_ros.diagnose.analysis.drift import drift_of_both, drift_of_both_deg, drifts_more
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, without_effect
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.search.additions import Addition, Removal, Search
from gyrocal_ros.diagnose.search.noise_fit import fit_noises, with_noise
from gyrocal_ros.effects.traits import is_noise
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary

SMALLER = 0.7
"""Size of a noise beside what was found after it, relative to that alone, below which it is added again."""


def eliminate(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search from whose final model every effect was removed that does not earn its place.

    An effect that was added early may have stood for another one that was found later. The effect closest to
    zero is removed first, for the others may gain by that. A limit, or a noise, has no distance from zero: a
    run without it decides. A noise that was as large because an effect was missing is added again, smaller.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    needed: set[str] = set()
    while True:
        weakest = _weakest(searched, needed)
        if weakest is None:
            return searched
        removal = without_addition(searched.last, weakest, recording, calibrate)
        if removal is not None and not removal.is_needed:
            searched = replace(searched, removals=(*searched.removals, removal))
            continue
        needed.add(weakest.effect.name)
        again = None if removal is None else _smaller_noise(removal, recording, calibrate)
        if removal is not None and again is not None:
            searched = Search(searched.first, (*searched.additions, again), (*searched.removals, removal))


def without_harm(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search whose final model does not drift more than its first one because of noise.

    With a larger walk of the bias the filter follows what disturbs the gyro, and between two images that
    helps. Where the disturbance comes and goes, its last value is a poor guess for a minute without images.
    By chance the drift may rise a little with a bias that truly walks; without its noise the scale factor
    would seem to change. What was found beside a noise that is left out stays only if the robot drifts less.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    for noise in [item for item in searched.kept if is_noise(item.effect)]:
        if not drifts_more(*drift_of_both(searched.first.run, searched.last.run)):
            break
        removal = without_addition(searched.last, noise, recording, calibrate)
        if removal is None:
            continue
        without = replace(searched, removals=(*searched.removals, replace(removal, is_harmful=True)))
        without = _without_what_came_after(noise, without, recording, calibrate)
        if drifts_more(*drift_of_both(without.last.run, searched.last.run)):
            searched = without
    return searched


def _without_what_came_after(
    noise: Addition, searched: Search, recording: RecordingSummary, calibrate: Calibrate
) -> Search:
    """Remove effects that were found beside a noise that is left out, if the drift is no less with them."""
    names = [item.effect.name for item in searched.additions]
    for item in searched.additions[names.index(noise.effect.name) + 1 :]:
        if item not in searched.kept or is_noise(item.effect):
            continue
        removal = without_addition(searched.last, item, recording, calibrate)
        if removal is None:
            continue
        without_deg, with_deg = drift_of_both_deg(removal.after.run, searched.last.run)
        if without_deg <= with_deg:
            removal = replace(removal, was_beside_noise=True)
            searched = replace(searched, removals=(*searched.removals, removal))
    return searched


def _weakest(searched: Search, needed: set[str]) -> Addition | None:
    """Return the addition to remove next; None where all earn their place.

    The last addition was tested beside all others when it was added, unless one was removed since.
    """
    kept = searched.kept if searched.removals else searched.kept[:-1]
    last = searched.last
    distances = [
        (item.distance_from_zero(last), item)
        for item in kept
        if item.before is not None and item.effect.name not in needed
    ]
    doubtful = [
        (distance, item)
        for distance, item in distances
        if distance < last.settings.nonzero_sigma or math.isinf(distance)
    ]
    return min(doubtful, key=lambda pair: pair[0], default=(0.0, None))[1]


def without_addition(
    last: ExaminedModel, added: Addition, recording: RecordingSummary, calibrate: Calibrate
) -> Removal | None:
    """Run the filter without an effect that was added; return None where it cannot run."""
    model, distance = without_effect(last.model, added.effect.name), added.distance_from_zero(last)
    try:
        after = examine(model, recording, calibrate, last.settings)
    except CANNOT_RUN:
        return None
    return Removal(added.effect, last, after, distance)


def _smaller_noise(removal: Removal, recording: RecordingSummary, calibrate: Calibrate) -> Addition | None:
    """Run the filter with a noise of the size that it has beside all else; None where that is no better."""
    if not is_noise(removal.effect):
        return None
    name, size = removal.effect.name, removal.effect.coefficients[0].prior_mean
    noise = next((item for item in fit_noises(removal.after) if item.effect.name == name), None)
    if noise is None or noise.size > SMALLER * size:
        return None
    try:
        again = with_noise(removal.after, noise, recording, calibrate)
    except CANNOT_RUN:
        return None
    is_better = float(predictive_gain(removal.before.run, again.after.run).sum()) > 0.0
    return again if again.is_kept and is_better else None
