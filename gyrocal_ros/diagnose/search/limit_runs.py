"""Runs of the filter with limits that the readings suggest: a dead band, a saturation."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from operator import itemgetter

import numpy as np

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, contradicts, examine, with_effect
from gyrocal_ros.diagnose.analysis.limits import Competition, LimitProposal, detected_limits, propose_limits
from gyrocal_ros.diagnose.analysis.model_fit import excess_nis
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.search.additions import NONE, Addition
from gyrocal_ros.diagnose.search.limit_sizes import best_size, possible_sizes
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.diagnose.search.uneven import uneven_gyro_effect
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.statistics import chi_square_tail, sigma_of


def limits_to_check(
    present: ExaminedModel, recording: RecordingSummary, best: RankedEffect | None
) -> list[LimitProposal]:
    """Return limits that the readings suggest, beside the best explanation of another kind."""
    structure = present.unexplained_structure
    uneven = uneven_gyro_effect(present.ranked, (), present.settings)
    others = Competition(
        lacks_something=any(item is not None for item in (structure, best, uneven)),
        contradicts=contradicts(present),
        has_jumped=structure is not None and structure.at_s is not None,
    )
    return list(propose_limits(present.run, present.seen, recording.readings, others, present.settings))


def tried_limit(
    present: ExaminedModel, limit: Effect, recording: RecordingSummary, calibrate: Calibrate
) -> tuple[Effect, float]:
    """Return a limit with the best size that the readings allow, and the log-likelihood that it gains."""
    return best_size(present, limit, possible_sizes(limit, recording.readings), calibrate)


def tried_limits(
    present: ExaminedModel, limits: Sequence[Effect], recording: RecordingSummary, calibrate: Calibrate
) -> list[tuple[Effect, float]]:
    """Return limits as `tried_limit` does, the one that gains most first."""
    tasks = [partial(tried_limit, present, limit, recording, calibrate) for limit in limits]
    return sorted(side_by_side(calibrate, tasks), key=itemgetter(1), reverse=True)


def with_limit(
    present: ExaminedModel, limit: Effect, recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    """Add a limit; None where no run is possible."""
    settings = present.settings
    with suppress(*CANNOT_RUN):
        after = examine(with_effect(present.model, limit), recording, calibrate, settings)
        gain = float(predictive_gain(present.run, after.run).sum())
        p_value = chi_square_tail(2.0 * gain / settings.min_inflation, 1)
        return Addition(limit, present, after, gain, sigma_of(p_value), p_value, np.zeros(1), NONE)
    return None


def limit_instead_of_timing(
    present: ExaminedModel, recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    """Return a limit that the readings show and with which the stamps look right, or None.

    A missing limit spoils the turns, as wrong stamps do, and nothing depends smoothly on it.
    """
    limits = detected_limits(present.model, recording.readings)
    for sized, gain in tried_limits(present, limits, recording, calibrate):
        if gain < present.settings.min_predictive_gain:
            continue
        limited = with_limit(present, sized, recording, calibrate)
        if limited is not None and limited.is_kept and timing_fault(limited.after) is None:
            return limited
    return None


def explains_most(added: Addition) -> bool:
    """Return True if an effect leaves little of the excess of the NIS, or nothing to contradict the model."""
    assert added.before is not None
    before, after = (excess_nis(examined.run) for examined in (added.before, added.after))
    return not contradicts(added.after) or after < added.after.settings.limit_leftover_part * before
