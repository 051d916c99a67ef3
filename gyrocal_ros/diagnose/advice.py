"""What to do next: motions that tell effects apart, signals to record, what is left to look for."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrocal_ros.diagnose.candidate_fit import SIGNIFICANT_SIGMA
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.separability import kind_of, table, to_tell_apart
from gyrocal_ros.diagnose.shapes import TIME, UnexplainedStructure
from gyrocal_ros.sim.drives import TEST_DRIVES

NOT_RECORDED = 'not recorded: '
CAUTION = (
    'A signal that changes slowly goes together with anything that changes slowly: '
    'find a reason, or make it change often, before you trust this.'
)


def advice(diagnosis: Diagnosis) -> list[str]:
    """Sentences for a person, the most urgent first."""
    sentences = [
        sentence
        for finding in diagnosis.missing
        for sentence in to_tell_apart(finding.effect.name, finding.confused_with)
    ]
    if diagnosis.unexplained is not None:
        sentences += _of_unexplained(diagnosis.unexplained)
    if diagnosis.coarse_step_rad_s is not None:
        step = f'{math.degrees(diagnosis.coarse_step_rad_s):.2g} deg/s'
        sentences.append(
            f'The gyro reads in steps of {step}, wider than its noise, so that rates between two of them '
            'are read wrong, however long one waits: give its converter a finer range, or its raw counts.'
        )
    sentences += _to_record(diagnosis.not_judged)
    if diagnosis.unexplained is None:  # which hides what else could have been seen
        sentences += _to_drive(diagnosis.not_judged)
    if diagnosis.verdict == 'cannot_tell' and not diagnosis.missing:
        sentences.append(
            'Record at least two minutes with turns to both sides at several speeds, straight lanes '
            'and short rests, while the camera sees the ceiling.'
        )
    return sentences


def grouped(not_judged: dict[str, str]) -> dict[str, list[str]]:
    """Reasons why something could not be judged, each with the effects it holds for."""
    reasons: dict[str, list[str]] = {}
    for name, why in not_judged.items():
        reasons.setdefault(why, []).append(name)
    return reasons


def join(names: list[str], word: str = 'and') -> str:
    """`a, b and c`"""
    return f' {word} '.join([', '.join(names[:-1]), names[-1]]) if len(names) > 1 else ''.join(names)


def _of_unexplained(odd: UnexplainedStructure) -> Iterator[str]:
    if odd.at_s is not None:
        yield f'Find out what happened at {odd.at_s:.0f} s: a knock, a bump, a motor or a fan switched on.'
        return
    signal = odd.shape.signal
    if signal == TIME:
        yield (
            'Something changes with time that is not recorded: record temperatures, supply voltage, '
            'motor currents and fan speeds, and diagnose again.'
        )
    else:
        kind = 'scale' if odd.shape.of_scale else 'bias'
        yield (
            f'Look for what links the {kind} of the gyro to {signal}. If you know a law, write it as '
            'an effect of your own (docs/your_own_effect.md) and give it with --effects-from.'
        )
        yield CAUTION


def _to_record(not_judged: dict[str, str]) -> Iterator[str]:
    for why, names in grouped(not_judged).items():
        if why.startswith(NOT_RECORDED):
            yield f'Record {why.removeprefix(NOT_RECORDED)} to judge {join(names)}.'


def _to_drive(not_judged: dict[str, str]) -> Iterator[str]:
    """Drives that bring out what was recorded but not excited."""
    drives: dict[str, list[str]] = {}
    for name, why in not_judged.items():
        shows = table().shows.get(kind_of(name), {})
        best = max(shows, key=lambda drive: shows[drive], default=None)
        if best in TEST_DRIVES and shows[best] > SIGNIFICANT_SIGMA and not why.startswith(NOT_RECORDED):
            drives.setdefault(best, []).append(name)
    for drive, names in drives.items():
        yield f'To judge {join(names)}, record five minutes of this: {TEST_DRIVES[drive].about}.'
