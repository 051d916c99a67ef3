"""Effects that look like those found, beside all others that were found."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.diagnose.analysis.ranking import estimate, estimate_stds, indistinguishable
from gyrocal_ros.diagnose.search.additions import NONE, Search
from gyrocal_ros.effects.traits import has_impossible_sign


def look_alikes(searched: Search) -> dict[str, tuple[str, ...]]:
    """Return the effects that each effect found may be confused with, beside the others found.

    The score statistics are those of the first model, or of the last one that lacked the effect where the
    first could not run without it; a limit has none, and was tried in a run. Effects that a run of their own
    has told apart are not confused, nor those that would need a sign that no sensor has: images that are
    late are no lag of the gyro.
    """
    names = {item.effect.name for item in searched.kept}
    confused = {}
    for item in searched.kept:
        name, first = item.effect.name, searched.first
        lacking = item.before if first.find(name) is None and item.before is not None else first
        found = {other.effect.name: other for other in lacking.ranked if other.effect.name in names}
        if name not in found:
            continue
        rest = [other.fit.columns for other in found.values() if other is not found[name]]
        beside = np.concatenate(rest) if rest else NONE
        excluded = {*names, *item.outperformed}
        others = [
            other
            for other in lacking.ranked
            if other.effect.name not in excluded
            and not has_impossible_sign(other.effect, estimate(other), estimate_stds(other))
        ]
        like = indistinguishable(found[name], others, lacking.scores, beside, first.settings)
        confused[name] = (*like, *(limit for limit in item.alike if limit not in names))
    return confused
