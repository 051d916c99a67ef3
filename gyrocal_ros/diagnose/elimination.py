"""Backward elimination: effects that were added, tested again beside all others."""

from __future__ import annotations

import math
from dataclasses import replace

from gyrocal_ros.diagnose.additions import Addition, Removal, Search
from gyrocal_ros.diagnose.examined import Calibrate, ExaminedModel, examine, without_effect
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary


def eliminate(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search from whose final model every effect was removed that does not earn its place.

    An effect that was added early may have stood for another one that was found later. The effect closest to
    zero is removed first, for the others may gain by that. A limit, or a noise, has no distance from zero: a
    run without it decides.

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
        removal = _removal(searched.last, weakest, recording, calibrate)
        if removal is None:
            needed.add(weakest.effect.name)
        else:
            searched = replace(searched, removals=(*searched.removals, removal))


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


def _removal(
    last: ExaminedModel, weakest: Addition, recording: RecordingSummary, calibrate: Calibrate
) -> Removal | None:
    """Run the filter without an effect; return None where it is needed after all."""
    model, distance = without_effect(last.model, weakest.effect.name), weakest.distance_from_zero(last)
    try:
        after = examine(model, recording, calibrate, last.settings)
    except CANNOT_RUN:
        return None
    removal = Removal(weakest.effect, last, after, distance)
    is_needed = -removal.predictive_gain > last.settings.min_predictive_gain
    return None if is_needed and math.isinf(distance) else removal
