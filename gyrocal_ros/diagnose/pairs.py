"""Two effects that explain a recording only together.

Where two large effects are missing, the model fails with either alone, and its estimates scatter from stretch
to stretch. So neither is significant, or kept, though both at once explain everything.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from gyrocal_ros.diagnose.additions import Addition, Search
from gyrocal_ros.diagnose.elimination import eliminate
from gyrocal_ros.diagnose.examined import Calibrate, ExaminedModel, contradicts
from gyrocal_ros.diagnose.one_more import with_one_more
from gyrocal_ros.diagnose.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.ranking import best_pair
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary


def explained_by_pair(found: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search, or one that adds two effects at once with which the model fits.

    They are added to what was found, or else take its place.

    Args:
        found: a finished search, whose last model the recording contradicts.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    alone = replace(found, additions=tuple(item for item in found.additions if item.before is None))
    for start in [found] if alone.last is found.last else [found, alone]:
        with suppress(*CANNOT_RUN):
            added = tuple(_pair(start.last, recording, calibrate))
            other = replace(start, additions=(*start.additions, *added))
            if added and not contradicts(other.last):
                other = eliminate(other, recording, calibrate)
                if _is_better(found, other):
                    return other
    return found


def _pair(present: ExaminedModel, recording: RecordingSummary, calibrate: Calibrate) -> Iterator[Addition]:
    """Add the two effects that explain most together, one after the other; none where no two do."""
    pair = best_pair(present.ranked, present.scores, present.settings)
    if pair is None:
        return
    for item, other, beside in (
        (pair.stronger, pair.weaker, pair.beside[0]),
        (pair.weaker, pair.stronger, pair.beside[1]),
    ):
        added = with_one_more(present, item.effect, recording, calibrate)
        added = replace(added, gain=beside.gain, sigma=beside.sigma, p_value=beside.p_value)
        yield replace(added, together_with=other.effect.name)
        present = added.after


def _is_better(found: Search, other: Search) -> bool:
    """Return True if another search predicts better, and its pairs are neither too small nor impossible."""
    gain = float(predictive_gain(found.last.run, other.last.run).sum())
    in_the_end = [replace(item, after=other.last) for item in other.kept if item.together_with]
    are_sound = all(item.stands_out and not (item.is_negligible or item.is_impossible) for item in in_the_end)
    return are_sound and gain > found.first.settings.min_predictive_gain and not contradicts(other.last)
