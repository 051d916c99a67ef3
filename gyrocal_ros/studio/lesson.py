"""The lesson: hidden effects of a recording compared with the effects that the user has found."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gyrocal_ros.effects.base import with_unit
from gyrocal_ros.model.sensor import coefficient_names
from gyrocal_ros.pipeline.calibration import Calibration

NOTHING, UNKNOWN = 'nothing', 'something unknown'
"""Possible guesses beside the effects of the library."""


@dataclass(frozen=True, slots=True)
class ComparedCoefficient:
    """True value of a coefficient, and its estimate in the present model."""

    name: str
    truth: float
    unit: str
    estimate: float | None
    """None if the model has no such coefficient."""
    std: float | None
    in_model: tuple[str, float] | None = None
    """Name and true value of the coefficient as the model has it; None if it has none."""

    @property
    def sigma(self) -> float | None:
        """Error of the estimate in standard deviations."""
        if self.estimate is None or not self.std:
            return None
        return (self.estimate - self.truth) / self.std


@dataclass(frozen=True, slots=True)
class Reveal:
    """The hidden effects, compared with the guess and with the present model."""

    hidden: tuple[str, ...]
    guess: str | None
    guessed_right: bool | None
    """None if nothing was guessed."""
    missed: tuple[str, ...]
    """Hidden effects that the model lacks."""
    superfluous: tuple[str, ...]
    """Effects of the model that the robot does not have."""
    coefficients: tuple[ComparedCoefficient, ...]


def reveal(
    answer: Mapping[str, Any], guess: str | None, found: Calibration, added: tuple[str, ...], known: set[str]
) -> Reveal:
    """Compare the guess and the present model with the truth.

    Args:
        answer: content of the sealed file.
        guess: name of an effect, `NOTHING` or `UNKNOWN`.
        found: calibration by the present model.
        added: names of the effects that were added to that.
        known: names of the effects of the library.
    """
    hidden = tuple(str(item['effect']) for item in answer['effects'])
    guessed_right = None
    if guess == NOTHING:
        guessed_right = not hidden
    elif guess == UNKNOWN:
        guessed_right = any(name not in known for name in hidden)
    elif guess is not None:
        guessed_right = guess in hidden
    return Reveal(
        hidden=hidden,
        guess=guess,
        guessed_right=guessed_right,
        missed=tuple(name for name in hidden if name not in added),
        superfluous=tuple(name for name in added if name not in hidden),
        coefficients=tuple(_coefficients(answer, found)),
    )


def _coefficients(answer: Mapping[str, Any], found: Calibration) -> Iterator[ComparedCoefficient]:
    estimates = dict(
        zip(found.names, zip(found.values.tolist(), found.stds.tolist(), strict=True), strict=True)
    )
    truth = answer['scale_factor']
    estimate, std = found.scale_factor, found.scale_factor_std
    yield ComparedCoefficient('scale factor', truth, '1', estimate, std, (found.names[1], truth - 1.0))
    in_model = {effect.name: effect for effect in found.model.effects}
    for item in answer['effects']:
        name = str(item['effect'])
        effect = in_model.get(name)
        names = coefficient_names(effect) if effect is not None else ()
        full_names = (
            {about.name: full for about, full in zip(effect.coefficients, names, strict=True)}
            if effect
            else {}
        )
        for coefficient, about in item['coefficients'].items():
            full, truth = full_names.get(coefficient, ''), float(about['value'])
            value, std = estimates.get(full, (None, None))
            label, known = f'{name}.{coefficient}', None if value is None else (full, truth)
            yield ComparedCoefficient(label, truth, str(about['unit']), value, std, known)


def error_text(item: ComparedCoefficient) -> str:
    """Return the error of an estimate, relative if possible, with its significance."""
    if item.estimate is None:
        return 'not in the model'
    error = item.estimate - item.truth
    text = f'{100.0 * error / item.truth:+.2f} %' if item.truth else with_unit(error, item.unit, 3)
    return (
        f'{text} ({item.sigma:+.1f} sigma)' if item.sigma is not None and math.isfinite(item.sigma) else text
    )
