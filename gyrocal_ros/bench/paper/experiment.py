"""What all experiments of the reproduction have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

NOMINAL_VOLT = 146.4
"""Scale factor of the XV-3500 by its data sheet, deg/s/V, as the paper gives it."""
TRUE_VOLT = 135.5
"""The same by the paper's rate table."""

Holds = Literal['holds', 'does not hold', 'in part']

T = TypeVar('T')
R = TypeVar('R')


class Mapper(Protocol):
    """Does a function for every task, in order: the built-in `map`, or one that uses all cores."""

    def __call__(self, function: Callable[[T], R], tasks: Sequence[T], /) -> Iterable[R]: ...


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement of the paper, and what becomes of it here."""

    what: str
    paper: str
    here: str
    verdict: Holds


def assessed(what: str, paper: str, here: str, holds: bool) -> Claim:
    """A claim that holds or does not."""
    return Claim(what, paper, here, 'holds' if holds else 'does not hold')
