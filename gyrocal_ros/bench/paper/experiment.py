"""Definitions for all experiments of the reproduction."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

NOMINAL_VOLT = 146.4
"""Scale factor of the XV-3500 by its data sheet, deg/s/V, as in the paper."""
TRUE_VOLT = 135.5
"""Scale factor of the XV-3500 by the paper's rate table, deg/s/V."""

Verdict = Literal['holds', 'does not hold', 'in part']

T = TypeVar('T')
R = TypeVar('R')


class Mapper(Protocol):
    """Applies a function to every task, in order: the built-in `map`, or one that uses all cores."""

    def __call__(self, function: Callable[[T], R], tasks: Sequence[T], /) -> Iterable[R]: ...


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement of the paper, the corresponding result here, and the verdict."""

    what: str
    paper: str
    here: str
    verdict: Verdict


def assess(what: str, paper: str, here: str, holds: bool) -> Claim:
    """Return a claim that holds or does not hold."""
    return Claim(what, paper, here, 'holds' if holds else 'does not hold')
