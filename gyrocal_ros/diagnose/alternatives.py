"""Alternatives to what a search found: other combinations of effects that may predict better.

A search adds one effect after the other, each the best beside those before. Where one effect imitates two
others, it is taken, and with it in the model the two are not found any more.
"""

from __future__ import annotations

import math
from dataclasses import replace

from gyrocal_ros.diagnose.additions import Search
from gyrocal_ros.diagnose.elimination import without_addition
from gyrocal_ros.diagnose.examined import Calibrate
from gyrocal_ros.diagnose.look_alikes import look_alikes
from gyrocal_ros.diagnose.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.search import continued
from gyrocal_ros.model.recording import RecordingSummary


def best_alternative(found: Search, recording: RecordingSummary, calibrate: Calibrate, most: int) -> Search:
    """Return a search, or the best one that does without an effect which others look like.

    One effect alone was compared with those that look like it by the search itself.

    Args:
        found: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try.
    """
    if len(found.kept) < 2:
        return found
    confused = look_alikes(found)
    doubtful = [item for item in found.kept if item.before is not None and confused.get(item.effect.name)]
    best = found
    for item in doubtful:
        place = found.additions.index(item)
        assert item.before is not None
        without = frozenset([item.effect.name])
        additions = continued(found.additions[:place], item.before, recording, calibrate, most, without)
        other = replace(found, additions=tuple(additions))
        if _advantage(best, other) > found.first.settings.min_predictive_gain:
            best = other
    return best


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
    if recovered is None or len(found.kept) < 2:
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

    The price is that of `ranking.best_explanation`: two effects have to be worth it as well. An effect that
    is only left out, without another in its place, is the elimination's to judge.
    """
    settings = present.first.settings
    names, others = ({item.effect.name for item in search.kept} for search in (present, other))
    if others <= names:
        return -math.inf
    gain = float(predictive_gain(present.last.run, other.last.run).sum())
    price = settings.coefficient_price + settings.significant_gain
    return gain - price * (len(others) - len(names))
