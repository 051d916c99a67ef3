"""The lesson: what a recording hides, against what a person has found."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gyrocal_ros.model.sensor import coefficient_names
from gyrocal_ros.pipeline.calibration import Calibration

NOTHING, STRANGER = 'nothing', 'something unknown'
"""What may be guessed beside the effects of the library."""


@dataclass(frozen=True, slots=True)
class GuessRow:
    """One number of the truth, and what the present model says of it."""

    name: str
    truth: float
    unit: str
    found: float | None
    """None where the model has no such coefficient."""
    std: float | None

    @property
    def sigma(self) -> float | None:
        """How many standard deviations the estimate is off."""
        if self.found is None or not self.std:
            return None
        return (self.found - self.truth) / self.std


@dataclass(frozen=True, slots=True)
class Reveal:
    """The truth, and how near a person came."""

    hidden: tuple[str, ...]
    guess: str | None
    guessed_right: bool | None
    """None where nothing was guessed."""
    missed: tuple[str, ...]
    """Hidden effects that the model lacks."""
    needless: tuple[str, ...]
    """Effects of the model that the robot does not have."""
    lines: tuple[GuessRow, ...]


def reveal(
    answer: Mapping[str, Any], guess: str | None, found: Calibration, added: tuple[str, ...], known: set[str]
) -> Reveal:
    """Hold what was found against the truth.

    Args:
        answer: of the sealed file.
        guess: name of an effect, `NOTHING` or `STRANGER`.
        found: by the present model.
        added: effects that were added to it.
        known: names of the effects of the library.
    """
    hidden = tuple(str(item['effect']) for item in answer['effects'])
    right = None
    if guess == NOTHING:
        right = not hidden
    elif guess == STRANGER:
        right = any(name not in known for name in hidden)
    elif guess is not None:
        right = guess in hidden
    return Reveal(
        hidden=hidden,
        guess=guess,
        guessed_right=right,
        missed=tuple(name for name in hidden if name not in added),
        needless=tuple(name for name in added if name not in hidden),
        lines=tuple(_lines(answer, found)),
    )


def _lines(answer: Mapping[str, Any], found: Calibration) -> Iterator[GuessRow]:
    estimates = dict(
        zip(found.names, zip(found.values.tolist(), found.stds.tolist(), strict=True), strict=True)
    )
    truth = answer['scale_factor']
    yield GuessRow('scale factor', truth, '1', found.scale_factor, found.scale_factor_std)
    in_model = {effect.name: effect for effect in found.model.effects}
    for item in answer['effects']:
        name = str(item['effect'])
        effect = in_model.get(name)
        names = coefficient_names(effect) if effect is not None else ()
        short = (
            {about.name: full for about, full in zip(effect.coefficients, names, strict=True)}
            if effect
            else {}
        )
        for coefficient, about in item['coefficients'].items():
            value, std = estimates.get(short.get(coefficient, ''), (None, None))
            label = f'{name}.{coefficient}'
            yield GuessRow(label, float(about['value']), str(about['unit']), value, std)


def off_in_words(line: GuessRow) -> str:
    """By how much an estimate is off."""
    if line.found is None:
        return 'not in the model'
    error = line.found - line.truth
    part = f'{100.0 * error / line.truth:+.2f} %' if line.truth else f'{error:+.3g}'
    return (
        f'{part} ({line.sigma:+.1f} sigma)' if line.sigma is not None and math.isfinite(line.sigma) else part
    )
