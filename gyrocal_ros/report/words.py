"""What diagnosis, comparison and improvement say to a person, in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.advice import join
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.drift import BlindDrift
from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.report.tables import with_std

BEYOND_DOUBT = 30.0
"""It does not matter by how many sigma more."""


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    names = [finding.effect.name for finding in diagnosis.missing]
    odd = diagnosis.unexplained
    if diagnosis.verdict == 'unexplained' and odd is not None:
        what = f'{odd.what} ({odd.sigma:.0f} sigma)'
        if names:
            return f'The model lacks {join(names)}, and something that no effect explains: {what}.'
        return f'Something is there that no effect of the library explains: {what}.'
    if diagnosis.verdict == 'nothing_missing':
        return 'Nothing is missing: gyro, wheels and camera agree with the model within chance.'
    if not names:
        return 'This recording cannot tell whether something is missing: too little in it would show it.'
    if diagnosis.coarse_step_rad_s is not None:
        step = f'steps of {math.degrees(diagnosis.coarse_step_rad_s):.2g} deg/s'
        return f'The gyro reads in {step}, wider than its noise: that, or {join(names, "or")}.'
    doubtful = [finding for finding in diagnosis.missing if finding.confused_with]
    if diagnosis.verdict != 'cannot_tell' or not doubtful:
        return f'The model lacks {join(names)}.'
    sure = [finding.effect.name for finding in diagnosis.missing if not finding.confused_with]
    lacks = f'{join(sure)}, and something more' if sure else 'something'
    return f'The model lacks {lacks}, {"; ".join(map(_either, doubtful))}.'


def _either(finding: MissingEffect) -> str:
    others = join([*finding.confused_with], 'or')
    return f'most likely {finding.effect.name}; but it may as well be {others}'


def improvement_headline(improved: Improvement) -> str:
    """What came of it in one sentence."""
    names = [revision.effect.name for revision in improved.kept if revision.effect is not None]
    if not names:
        return 'Nothing was added: no effect helps to foresee this recording.'
    first, last = improved.kept[0].held_out.rms_deg, improved.final.held_out.rms_deg
    fell = (
        f': the held-out drift went from {first:.2f} to {last:.2f} deg'
        if math.isfinite(first) and math.isfinite(last) and len(improved.kept) > 1
        else ''
    )
    return f'Added {join(names)}{fell}.'


def coefficients_in_words(effect: Effect, values: Array, stds: Array) -> str:
    """`c = 0.0101 ± 0.0002`, several behind each other; angles in degrees."""
    items = zip(effect.coefficients, values.tolist(), stds.tolist(), strict=True)
    return ', '.join(f'{item.name} = {quantity(value, std, item.unit)}' for item, value, std in items)


def drift_in_words(drift: BlindDrift) -> str:
    """`0.21 (0.12 to 0.80)`, rms and its interval in deg, or a dash where no span is long enough."""
    if not len(drift.error_rad):
        return '-'
    low, high = drift.interval_deg
    above = f'to {high:.2f}' if math.isfinite(high) else 'or more'
    return f'{drift.rms_deg:.2f} ({low:.2f} {above})'


def figure(value: float, form: str = '.2f') -> str:
    """A number, or a dash where there is none: a filter that cannot run without an effect has no drift."""
    return f'{value:{form}}' if math.isfinite(value) else '-'


def sigma_in_words(sigma: float) -> str:
    """`7.5`, `> 30` where more does not matter, or a dash where there is none."""
    return figure(sigma, '.1f') if not sigma > BEYOND_DOUBT else f'> {BEYOND_DOUBT:.0f}'


def failures_in_words(failures: Sequence[Failure], most: int = 5) -> Iterator[str]:
    """A line for each of the worst, or that there is none."""
    if not failures:
        yield '  nowhere by more than chance'
    for failure in failures[:most]:
        yield f'  {failure.what} ({failure.sigma:.0f} sigma)'
    if len(failures) > most:
        yield f'  and {len(failures) - most} more'


def quantity(value: float, std: float, unit: str) -> str:
    """`0.0101 ± 0.0002 1/K`, angles in degrees; without the deviation where there is none."""
    if unit.startswith('rad'):
        value, std, unit = math.degrees(value), math.degrees(std), unit.replace('rad', 'deg', 1)
    number = with_std(value, std) if std > 0.0 else f'{value:.4g}'
    return f'{number} {unit}'.removesuffix(' 1')
