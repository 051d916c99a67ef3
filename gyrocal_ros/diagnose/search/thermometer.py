"""What a thermometer shows is taken for an effect of the temperature, not of the time since power-on.

While a robot warms up both look alike. On another day only the first holds: nobody records when the gyro was
switched on, and the air may be warmer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress

from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.search.additions import Addition
from gyrocal_ros.diagnose.search.one_more import with_one_more
from gyrocal_ros.effects.traits import are_twins, follows_power_on, follows_temperature
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect

MIN_GAIN = 60.0
"""Log-likelihood by which an effect of the time since power-on has to be better to take the place of one of
the temperature: beside others that are not quite exact, either may gain some dozens."""


def or_by_temperature(
    added: Addition, excluded: Collection[str], recording: RecordingSummary, calibrate: Calibrate
) -> Addition:
    """Return an addition, or an effect of the temperature that predicts as well as one of power-on.

    Args:
        added: the best explanation, after its run.
        excluded: names of effects not to try.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    before = added.before
    found = None if before is None else before.find(added.effect.name)
    if before is None or found is None or not follows_power_on(added.effect):
        return added
    alike = [
        item
        for item in before.ranked
        if item.effect.name not in excluded
        and item.is_significant
        and item.merit > found.merit - MIN_GAIN
        and _is_twin_by_temperature(item.effect, added.effect)
    ]
    if not alike:
        return added
    with suppress(*CANNOT_RUN):
        other = with_one_more(before, max(alike, key=lambda item: item.merit).effect, recording, calibrate)
        lost = -float(predictive_gain(added.after.run, other.after.run).sum())
        if other.is_kept and lost < before.settings.min_predictive_gain:
            return other
    return added


def price_of_power_on(before: Iterable[Effect], after: Iterable[Effect]) -> float:
    """Return the log-likelihood that effects have to gain over others because they follow power-on."""
    kept, taken = list(before), list(after)
    names = {effect.name for effect in taken}
    is_swapped = any(
        follows_power_on(one) and _is_twin_by_temperature(other, one)
        for one in taken
        for other in kept
        if other.name not in names
    )
    return MIN_GAIN if is_swapped else 0.0


def _is_twin_by_temperature(effect: Effect, other: Effect) -> bool:
    return follows_temperature(effect) and are_twins(effect, other)
