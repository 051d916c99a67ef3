"""Effects that explain a recording only together.

Where two or three effects are missing, the model fails with each alone, and its estimates scatter from
stretch to stretch. So none is significant, or kept, though all at once explain everything.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, contradicts
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.ranking import Together, best_together
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.search.additions import Addition, Search
from gyrocal_ros.diagnose.search.elimination import eliminate
from gyrocal_ros.diagnose.search.noise_fit import a_walk_explains
from gyrocal_ros.diagnose.search.one_more import with_one_more
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary

TRIED = (2, 1), (3, 1), (2, 2)
"""Numbers of effects that are tried together, and of recorded signals that may be among them: two of these
explain whatever changes slowly, so laws come first."""


def explained_by_several(found: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search, or one that adds several effects at once with which the model fits.

    They are added to what was found, or take its place.

    Args:
        found: a finished search, whose last model the recording contradicts.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    alone = replace(found, additions=tuple(item for item in found.additions if item.before is None))
    starts = [found] if alone.last is found.last else [found, alone]
    for (count, signals), start in product(TRIED, starts):
        last = start.last
        together = best_together(last.ranked, last.scores, count, signals, last.settings)
        if together is None:
            continue
        with suppress(*CANNOT_RUN):
            added = tuple(_added(last, together, recording, calibrate))
            other = replace(start, additions=(*start.additions, *added))
            if not (contradicts(other.last) or a_walk_explains(last, other.last)):
                other = eliminate(other, recording, calibrate)
                if _is_better(found, other):
                    return other
    return found


def _added(
    present: ExaminedModel, together: Together, recording: RecordingSummary, calibrate: Calibrate
) -> Iterator[Addition]:
    """Add effects one after the other, each with what it gains beside all others."""
    for item, beside in zip(together.effects, together.beside, strict=True):
        added = with_one_more(present, item.effect, recording, calibrate)
        others = tuple(other.effect.name for other in together.effects if other is not item)
        present = added.after
        yield replace(
            added, gain=beside.gain, sigma=beside.sigma, p_value=beside.p_value, together_with=others
        )


def _is_better(found: Search, other: Search) -> bool:
    """Return True if another search predicts better, and nothing it added is too small or impossible."""
    gain = float(predictive_gain(found.last.run, other.last.run).sum())
    in_the_end = [replace(item, after=other.last) for item in other.kept if item.together_with]
    are_sound = all(item.stands_out and not (item.is_negligible or item.is_impossible) for item in in_the_end)
    return are_sound and gain > found.first.settings.min_predictive_gain and not contradicts(other.last)
