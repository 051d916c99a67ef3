"""Effects that explain much, but not in all stretches of a recording alike.

Few moments may show an effect, and where more than one is missing, the estimates of each scatter.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, contradicts
from gyrocal_ros.diagnose.analysis.ranking import MUCH_MORE, RankedEffect, estimate
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.search.additions import Addition
from gyrocal_ros.diagnose.search.one_more import with_one_more
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.effects.traits import is_usual
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.statistics import chi_square_tail, sigma_of


def uneven_explanation(
    ranked: Sequence[RankedEffect], tried: Collection[str], settings: DiagnosisSettings
) -> RankedEffect | None:
    """Return the effect that gains most by the filter's own S, though its scatter says that it may be chance.

    None where no effect gains that much. Effects with a scan are left out: whatever their time constant, one
    of many explains chance well. Those of the camera have to be strong: slow errors of images look like them.
    The arguments are those of `uneven_gyro_effect`.
    """
    untried = [item for item in ranked if item.effect.name not in tried and item.profile is None]
    uneven = [item for item in untried if not item.is_significant and item.merit > settings.significant_gain]
    uneven = [item for item in uneven if item.effect.acts_on != 'camera' or _is_strong(item, settings)]
    return max(uneven, key=lambda item: item.merit, default=None)


def _is_strong(item: RankedEffect, settings: DiagnosisSettings) -> bool:
    return item.merit > settings.uneven_view_gain and item.fit.sigma > settings.uneven_sigma


def uneven_gyro_effect(
    ranked: Sequence[RankedEffect], tried: Collection[str], settings: DiagnosisSettings
) -> RankedEffect | None:
    """Return the effect of the gyro that explains much, though unevenly: a sign that something is missing.

    It has to be of a usual size, and larger than its scatter by half of what makes it significant. Effects of
    the camera are no sign: the slow errors of images look like them.

    Args:
        ranked: ranked effects.
        tried: names of effects to leave out.
        settings: thresholds.
    """
    least = 0.5 * settings.significant_sigma
    likely = [item for item in ranked if item.effect.acts_on == 'gyro' and item.fit.sigma > least]
    usual = [item for item in likely if is_usual(item.effect, estimate(item))]
    return uneven_explanation(usual, tried, settings)


def uneven_sign(
    ranked: Sequence[RankedEffect], refuted: Collection[str], settings: DiagnosisSettings
) -> RankedEffect | None:
    """Return the effect of the gyro that explains much, though unevenly, unless others explain far more.

    Where those of camera and floor do, it is they that are at fault for a while: wheels spin, tracks slide.
    """
    found = uneven_gyro_effect(ranked, refuted, settings)
    others = (item.merit for item in ranked if item.effect.acts_on != 'gyro')
    return None if found and max(others, default=0.0) > MUCH_MORE * found.merit else found


def uneven_first_effect(
    ranked: Sequence[RankedEffect], tried: Collection[str], settings: DiagnosisSettings
) -> RankedEffect | None:
    """Return the effect that explains so much, though unevenly, that a run has to decide beside no other one.

    It acts on the gyro, or gains more than the slow errors of images do.

    Args:
        ranked: ranked effects.
        tried: names of effects to leave out.
        settings: thresholds.
    """
    strong = [item for item in ranked if _is_strong(item, settings)]
    of_gyro = uneven_gyro_effect(ranked, tried, settings)
    return uneven_explanation(strong, tried, settings) if of_gyro is None else of_gyro


def uneven_addition(
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    excluded: set[str],
    *,
    is_first: bool,
) -> Addition | None:
    """Add the effect that gains most though its estimates scatter, if a run predicts clearly better with it.

    Few moments may show an effect. Then the scatter of the blocks says little, and a run decides, where
    nothing else contradicts the model. It has to be of a usual size: slow errors of images look like small
    errors of the camera. Where it would be the first one, it acts on the gyro, or gains much more than those.
    """
    settings, ranked = present.settings, present.ranked
    explanation = uneven_first_effect if is_first else uneven_explanation
    uneven = explanation(ranked, excluded, settings)
    if uneven is None:
        return None
    with suppress(*CANNOT_RUN):
        added = with_one_more(present, uneven.effect, recording, calibrate)
        gain = added.predictive_gain
        p_value = chi_square_tail(max(2.0 * gain / settings.min_inflation, 0.0), len(added.strengths))
        added = replace(added, gain=gain, sigma=sigma_of(p_value), p_value=p_value)
        return replace(added, objection=_objection(added))
    return None


def _objection(added: Addition) -> str:
    """Return what speaks against an effect that shows at few moments; empty if a run confirms it."""
    distance = added.distance_from_zero(added.after)
    if min(added.sigma, distance) <= added.after.settings.significant_sigma:
        return 'it shows at few moments, and the run does not confirm it clearly'
    if added.is_below(1.0):
        return 'it shows at few moments, and is smaller than in real sensors'
    return 'the model does not fit with it either' if contradicts(added.after) else ''
