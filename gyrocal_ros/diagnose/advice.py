"""Advice on what to do next: motions that tell effects apart, signals to record, what to look for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from gyrocal_ros.diagnose.analysis.shapes import TEMPERATURE_C, TIME, UnexplainedStructure
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.separability import drive_for, how_to_tell_apart
from gyrocal_ros.effects.traits import NOT_RECORDED
from gyrocal_ros.model.sensor import Effect

RECORD = (
    'Record five minutes with turns to both sides at several speeds, straight lanes and short rests, '
    'with the ceiling or the heading reference in view.'
)
MEND_STAMPS = (
    'Stamp images and IMU with one clock, when they are taken, not when they arrive; look at the '
    'synchronisation of the IMU board.'
)
FINER_STEPS = 'Give the converter of the gyro a finer range, or use its raw counts.'
MAX_TWINS = 3
"""Number of effects that are listed in place of one."""
RECORDED = '.'
"""What is in the name of a recorded signal, between topic and field, and in no other."""
CAUTION = (
    'A signal that changes slowly goes together with anything that changes slowly: '
    'find a reason, or make it change often, before you trust this.'
)


def advice(diagnosis: Diagnosis) -> list[str]:
    """Return sentences for a person, the most urgent first."""
    if diagnosis.timing is not None:
        return [MEND_STAMPS]
    sentences = [
        sentence
        for item in diagnosis.missing
        for sentence in how_to_tell_apart(item.effect.name, item.confused_with[:MAX_TWINS])
    ]
    together = [item.effect.name for item in diagnosis.missing if item.together_with]
    if together:
        sentences.append(f'{join(together)} explain the recording only together: add all of them.')
    if diagnosis.unexplained is not None and not diagnosis.only_steps:
        sentences += _on_structure(diagnosis.unexplained)
    if diagnosis.proven_limits and diagnosis.verdict != 'nothing_missing':  # there the status says so
        sentences.append(
            f'The readings prove {limits_in_words(diagnosis.proven_limits)}, though this recording is not '
            'predicted better with it: look at the settings of the gyro.'
        )
    if diagnosis.coarse_step_rad_s is not None:
        step = f'{math.degrees(diagnosis.coarse_step_rad_s):.2g} deg/s'
        sentences.append(
            f'The gyro reads in steps of {step}, wider than its noise, so rates between two steps are read '
            f'wrong, however long one waits. {FINER_STEPS}'
        )
    sentences += _what_to_record(diagnosis.not_judged)
    if diagnosis.unexplained is None:  # structure hides what else could have been seen
        sentences += _what_to_drive(diagnosis.not_judged)
    if diagnosis.fit.misfits:
        sentences.append(f'The model does not fit: {join(list(diagnosis.fit.misfits))}.')
    if diagnosis.verdict == 'cannot_tell' and not diagnosis.missing:
        sentences.append(RECORD)
    return sentences


def grouped(not_judged: dict[str, str]) -> dict[str, list[str]]:
    """Group effects that could not be judged by the reason."""
    reasons: dict[str, list[str]] = {}
    for name, why in not_judged.items():
        reasons.setdefault(why, []).append(name)
    return reasons


def join(names: list[str], word: str = 'and') -> str:
    """Join names as in `a, b and c`."""
    return f' {word} '.join([', '.join(names[:-1]), names[-1]]) if len(names) > 1 else ''.join(names)


def twins_in_words(twins: Sequence[str], word: str = 'and') -> str:
    """Return effects that look like one that was found; of many, the likeliest and how many more."""
    left = len(twins) - MAX_TWINS
    others = [f'{left} other{"s" if left > 1 else ""}'] if left > 0 else []
    return join([*twins[:MAX_TWINS], *others], word)


def limits_in_words(limits: Sequence[Effect]) -> str:
    """Return limits of the gyro with their sizes."""
    sizes = [math.degrees(effect.coefficients[0].prior_mean) for effect in limits]
    return join([f'{effect.name} ({size:.3g} deg/s)' for effect, size in zip(limits, sizes, strict=True)])


def _on_structure(structure: UnexplainedStructure) -> Iterator[str]:
    if structure.at_s is not None:
        causes = 'a knock, a bump, a motor or a fan switched on'
        yield f'Find out what happened at {structure.at_s:.0f} s: {causes}.'
        return
    signal = structure.shape.signal
    if signal == TIME:
        yield (
            'Something changes with time that is not recorded: record temperatures, supply voltage, '
            'motor currents and fan speeds, and diagnose again.'
        )
    else:
        kind = 'scale' if structure.shape.of_scale else 'bias'
        yield (
            f'Look for what links the {kind} of the gyro to {signal}. If you know the law, write it as '
            'an effect of your own (docs/your_own_effect.md) and give it with --effects-from.'
        )
        if RECORDED in signal or signal == TEMPERATURE_C:
            yield CAUTION


def _what_to_record(not_judged: dict[str, str]) -> Iterator[str]:
    for why, names in grouped(not_judged).items():
        if why.startswith(NOT_RECORDED):
            yield f'Record {why.removeprefix(NOT_RECORDED)} to judge {join(names)}.'


def _what_to_drive(not_judged: dict[str, str]) -> Iterator[str]:
    """Yield drives that excite effects whose signals were recorded."""
    drives: dict[str, list[str]] = {}
    for name, why in not_judged.items():
        drive = drive_for(name)
        if drive is not None and not why.startswith(NOT_RECORDED):
            drives.setdefault(drive, []).append(name)
    for drive, names in drives.items():
        yield f'To judge {join(names)}, record five minutes of this: {drive}.'
