"""What a thermometer shows is taken for an effect of the temperature, not of the time since power-on.

While a robot warms up both look alike. On another day only the first holds: nobody records when the gyro was
switched on, and the air may be warmer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from gyrocal_ros.diagnose.analysis.ranking import RankedEffect
from gyrocal_ros.effects.traits import are_twins, follows_power_on, follows_temperature
from gyrocal_ros.model.sensor import Effect

ALIKE_PART = 0.85
"""Part of the merit of an effect of the time since power-on from which one of the temperature is taken."""
MIN_GAIN = 100.0
"""Log-likelihood by which an effect of the time since power-on has to predict better than that: beside other
effects that are not quite exact either may gain some dozens."""


def or_by_temperature(
    best: RankedEffect, ranked: Sequence[RankedEffect], excluded: Collection[str]
) -> RankedEffect:
    """Return the best explanation, or an effect of the temperature that is nearly as good.

    Args:
        best: the best explanation.
        ranked: all candidates.
        excluded: names of effects not to try.
    """
    if not follows_power_on(best.effect):
        return best
    alike = [
        item
        for item in ranked
        if item.effect.name not in excluded
        and item.is_significant
        and item.merit >= ALIKE_PART * best.merit
        and _is_twin_by_temperature(item.effect, best.effect)
    ]
    return max(alike, key=lambda item: item.merit, default=best)


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
