"""Effects that look like those found, beside all others that were found."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.diagnose.additions import Search
from gyrocal_ros.diagnose.ranking import indistinguishable


def look_alikes(searched: Search) -> dict[str, tuple[str, ...]]:
    """Return the effects that each effect found may be confused with, beside the others found.

    The score statistics are those of the first model; a limit has none, and was tried in a run. Effects that
    a run of their own has told apart are not confused.
    """
    first = searched.first
    outperformed = {item.effect.name: item.outperformed for item in searched.kept}
    alike = {item.effect.name: item.alike for item in searched.kept}
    found = {item.effect.name: item for item in first.ranked if item.effect.name in outperformed}
    confused = {}
    for name, effect in found.items():
        rest = [item.fit.columns for item in found.values() if item is not effect]
        beside = np.concatenate(rest) if rest else np.empty(0, np.int64)
        excluded = {*outperformed, *outperformed[name]}
        others = [item for item in first.ranked if item.effect.name not in excluded]
        like = indistinguishable(effect, others, first.scores, beside, first.settings)
        confused[name] = (*like, *(limit for limit in alike[name] if limit not in outperformed))
    return confused
