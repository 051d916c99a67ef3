"""Alternatives to what a search found: other combinations of effects that may predict better.

A search adds one effect after the other, each the best beside those before. Where one effect imitates two
others, it is taken, and with it in the model the two are not found any more.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.search.additions import Addition, Search
from gyrocal_ros.diagnose.search.elimination import without_addition
from gyrocal_ros.diagnose.search.look_alikes import look_alikes
from gyrocal_ros.diagnose.search.one_more import with_one_more
from gyrocal_ros.diagnose.search.search import continued
from gyrocal_ros.diagnose.search.thermometer import price_of_power_on
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect

FAR_BEHIND = 25.0
"""Log-likelihood by which an alternative predicts worse, with all that is significant, from which it is given
up: exact coefficients and effects that show at few moments gain less."""
LEFT = 0.2
"""Part of an effect that is left beside another one, below which that one displaces it."""


def best_alternative(found: Search, recording: RecordingSummary, calibrate: Calibrate, most: int) -> Search:
    """Return a search, or the best one that does without an effect which others look like, or displace.

    One effect alone was compared with those that look like it by the search itself.

    Args:
        found: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try.
    """
    confused = look_alikes(found) if len(found.kept) > 1 else {}
    doubtful = [
        (item, other)
        for item in found.kept
        if ((other := _displacing(found, item)) or confused.get(item.effect.name)) and item.before is not None
    ]
    tasks = [partial(_without, found, *pair, recording, calibrate, most) for pair in doubtful]
    best = found
    for changed in side_by_side(calibrate, tasks):
        if _advantage(best, changed) > found.first.settings.min_predictive_gain:
            best = changed
    return best


def _without(
    found: Search,
    item: Addition,
    other: Effect | None,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> Search:
    """Search again from before an addition, without it; another effect may take its place."""
    assert item.before is not None
    additions, present = [*found.additions[: found.additions.index(item)]], item.before
    if other is not None:
        with suppress(*CANNOT_RUN):
            additions.append(with_one_more(present, other, recording, calibrate))
            present = additions[-1].after if additions[-1].is_kept else present
    without, last = frozenset([item.effect.name]), found.last.run

    def is_beaten(examined: ExaminedModel) -> bool:
        return float(predictive_gain(examined.run, last).sum()) > FAR_BEHIND

    again = continued(additions, present, recording, calibrate, most, without, is_beaten)
    return replace(found, additions=tuple(again))


def _displacing(found: Search, item: Addition) -> Effect | None:
    """Return the best effect that was left out and leaves almost nothing of one that was added; or None.

    With it the recording is predicted better, yet beside what it displaces it may be rejected.
    """
    least = found.first.settings.min_predictive_gain
    rejected = [
        other
        for other in found.additions
        if not other.is_kept and other.predictive_gain > least and _displaces(other, item)
    ]
    return max(rejected, key=lambda other: other.predictive_gain).effect if rejected else None


def _displaces(rejected: Addition, kept: Addition) -> bool:
    """Return True if almost nothing is left of an effect, added earlier, beside one that was rejected."""
    name = kept.effect.name
    if rejected.before is None or all(effect.name != name for effect in rejected.before.model.effects):
        return False
    before, after = (
        float(np.linalg.norm(examined.estimate_of(name)[0][kept.strengths]))
        for examined in (rejected.before, rejected.after)
    )
    return after < LEFT * before


def searched_again(found: Search, recording: RecordingSummary, calibrate: Calibrate, most: int) -> Search:
    """Return a search without the effect with which a filter that had diverged ran at all.

    It was the one with which the filter ran best while everything else was missing, so it may stand for what
    was found later, or for an effect that looks like it. Where the filter runs without it by now, the search
    goes on from there, and finds it again if it is there.

    Args:
        found: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try.
    """
    recovered = next((item for item in found.additions if item.before is None), None)
    if recovered is None or recovered.effect.name in recording.certain or len(found.kept) < 2:
        return found
    removal = without_addition(found.last, recovered, recording, calibrate)
    if removal is None:
        return found
    additions = continued(found.additions, removal.after, recording, calibrate, most + 1)
    other = replace(found, additions=tuple(additions), removals=(*found.removals, removal))
    gain = float(predictive_gain(found.last.run, other.last.run).sum())
    return other if gain > -found.first.settings.min_predictive_gain else found


def _advantage(present: Search, other: Search) -> float:
    """Return the predictive log-likelihood that another search gains, less the price of more effects.

    The price is that of `ranking.best_explanation`: two effects have to be worth it as well; so has one that
    follows power-on in place of the temperature. An effect that is only left out, without another in its
    place, is the elimination's to judge.
    """
    settings = present.first.settings
    names, others = ({item.effect.name for item in search.kept} for search in (present, other))
    if others <= names:
        return -math.inf
    gain = float(predictive_gain(present.last.run, other.last.run).sum())
    price = (settings.coefficient_price + settings.significant_gain) * (len(others) - len(names))
    price += price_of_power_on(*([item.effect for item in search.kept] for search in (present, other)))
    return gain - price
