"""The cases of the blind trials: what is hidden in them."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.sim.hidden import DRAWN, LIBRARY_RANGES, OUT_OF_LIBRARY_RANGES
from gyrocal_ros.sim.sensors import stream

WRONG_NOISE = 2.0
"""Factor by which the noise settings are wrong, to either side."""
PAIRS = 20
"""Number of cases with two effects at once."""
TRIPLES = 10
"""Number of cases with three effects at once; noise is none of them."""


@dataclass(frozen=True, slots=True)
class Case:
    """The hidden effects, and the factor by which the noise settings of the filter are wrong."""

    label: str
    names: tuple[str, ...] = ()
    noise: float = 1.0


def cases() -> list[Case]:
    """Return all cases.

    They hide each effect alone, nothing, nothing with wrong noise settings, effects that the library
    does not have, and two and three effects at once.
    """
    rng = stream(0, 'pairs of effects')
    pairs = [rng.choice(list(LIBRARY_RANGES), 2, replace=False).tolist() for _ in range(PAIRS)]
    rng = stream(0, 'triples of effects')
    triples = [rng.choice(DRAWN, 3, replace=False).tolist() for _ in range(TRIPLES)]
    return [
        Case('none'),
        Case('none, noise set too high', noise=WRONG_NOISE),
        Case('none, noise set too low', noise=1.0 / WRONG_NOISE),
        *(Case(name, (name,)) for name in (*LIBRARY_RANGES, *OUT_OF_LIBRARY_RANGES)),
        *(Case(' + '.join(several), tuple(several)) for several in (*pairs, *triples)),
    ]
