"""Traces: effects far smaller than in real sensors. They are not named, but explain what they do themselves.

Images that are 0.2 ms late are such a trace. Without it, what it explains would be given to another effect.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from gyrocal_ros.diagnose.analysis.candidate_fit import fit
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect, best_explanation
from gyrocal_ros.diagnose.search.additions import Addition


def traces(found: Sequence[Addition]) -> set[str]:
    """Return the names of the effects that were not kept because they are traces."""
    small = [item for item in found if not item.is_kept and item.is_negligible and not item.is_momentary]
    return {item.effect.name for item in small}


def best_beside(
    present: ExaminedModel, excluded: Collection[str], beside: Collection[str]
) -> RankedEffect | None:
    """Return the effect that explains most, significant beside traces; None without any.

    Args:
        present: the model so far, with its ranking.
        excluded: names of effects to leave out.
        beside: names of traces.
    """
    small = [item for item in present.ranked if item.effect.name in beside]
    left_out = {*excluded}
    while True:
        best = best_explanation(present.ranked, present.scores, left_out, present.settings)
        others = [item.fit.columns for item in small if item is not best]
        if best is None or not others:
            return best
        alone = fit(present.scores, best.fit.columns, np.concatenate(others))
        if alone is not None and alone.sigma >= present.settings.significant_sigma:
            return best
        left_out.add(best.effect.name)
