"""Which motion tells which effects apart: what to record next where two explanations are left.

The figures are those of `gyrocal bench motions --json`, kept in `motions.json`; see `bench.motions`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from gyrocal_ros.diagnose.ranking import TWIN_SIGMA
from gyrocal_ros.effects import COVARIATE_EFFECTS, find_effect
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.drives import EVERYDAY, TEST_DRIVES

ALIKE = 0.85
"""Pairs whose correlation no drive brings above this have no row of their own."""
DRIVES = {EVERYDAY.name: EVERYDAY, **TEST_DRIVES}
MIN_APART = 2.0 * TWIN_SIGMA
"""With d sigma between two effects the right one gains d^2 / 2 more, give or take d: it is preferred by
d / 2 sigma."""


@dataclass(frozen=True, slots=True)
class Advice:
    """The drive that tells two effects apart best."""

    first: str
    second: str
    drive: str
    """Name of a test drive (`sim.drives`), or of everyday use where that is best."""
    correlation: float
    """Of the two in that drive."""
    sigma: float
    """What lies between them there, at the usual size of whichever shows less."""
    everyday_correlation: float | None
    """None where one of them does not show."""
    everyday_sigma: float
    """The same in everyday use."""

    @property
    def helps(self) -> bool:
        """Whether the drive tells them apart."""
        return self.sigma >= MIN_APART


@dataclass(frozen=True, slots=True)
class Table:
    """The computed figures, each a row of drives."""

    shows: dict[str, dict[str, float]]
    """Effect to the sigma of its usual size."""
    alike: dict[frozenset[str], dict[str, float | None]]
    """Two effects to their correlation."""

    def correlation(self, first: str, second: str, drive: str) -> float | None:
        """Of two effects in a drive; of a pair that no drive finds alike, the most that it may be."""
        row = self.alike.get(frozenset((first, second)))
        return ALIKE if row is None else row[drive]

    def apart(self, first: str, second: str, drive: str) -> float:
        """Sigma between two effects in a drive."""
        weaker = min(self.shows[first][drive], self.shows[second][drive])
        if 'scale_factor' in (first, second):  # it is in every model: what shows is told from it
            return weaker
        correlation = self.correlation(first, second, drive)
        return 0.0 if correlation is None else weaker * math.sqrt(max(1.0 - correlation**2, 0.0))


@cache
def table() -> Table:
    """Read the computed figures."""
    text = files('gyrocal_ros.diagnose').joinpath('motions.json').read_text(encoding='utf-8')
    rows = {row.pop('effect'): row for row in json.loads(text)['rows']}
    return Table(
        shows={name: row for name, row in rows.items() if '/' not in name},
        alike={frozenset(name.split('/')): row for name, row in rows.items() if '/' in name},
    )


def tell_apart(first: str, second: str) -> Advice:
    """Find the drive that tells two effects, given by name, apart best.

    Raises:
        ConfigError: nothing has been computed of an effect, for it is not of the library.
    """
    known, one, other = table(), kind_of(first), kind_of(second)
    for name in (one, other):
        if name not in known.shows:
            raise ConfigError('has no figures', where=name, todo=did_you_mean(name, list(known.shows)))
    best = max(DRIVES, key=lambda drive: known.apart(one, other, drive))
    return Advice(
        first=first,
        second=second,
        drive=best,
        correlation=known.correlation(one, other, best) or 0.0,
        sigma=known.apart(one, other, best),
        everyday_correlation=known.correlation(one, other, EVERYDAY.name),
        everyday_sigma=known.apart(one, other, EVERYDAY.name),
    )


def to_tell_apart(effect_name: str, twin_names: Sequence[str]) -> list[str]:
    """What to record next, a sentence for each twin.

    Args:
        effect_name: the effect that is thought to be there.
        twin_names: those that may be meant instead.
    """
    return [_sentence(effect_name, twin) for twin in twin_names]


def kind_of(name: str) -> str:
    """Name under which an effect is tabled: that of a recorded signal without the signal."""
    kind = name.partition(':')[0]
    return kind if kind in COVARIATE_EFFECTS else name


def _sentence(name: str, twin: str) -> str:
    to_tell = f'To tell {name} from {twin}'
    if kind_of(name) == kind_of(twin):
        return f'{to_tell}, make one of the two signals change without the other.'
    if not {kind_of(name), kind_of(twin)} <= table().shows.keys():
        return f'{to_tell}, record {_best_motion(name)}; and {_best_motion(twin)}.'
    found = tell_apart(name, twin)
    if not found.helps:
        return f'{to_tell}, measure one of them from outside: no motion tells them apart.'
    anyway = '' if found.drive == EVERYDAY.name else f', {found.everyday_sigma:.0f} in everyday use'
    return (
        f'{to_tell}, record five minutes of this: {DRIVES[found.drive].about}. '
        f'{found.sigma:.0f} sigma then lie between them at their usual size{anyway}.'
    )


def _best_motion(name: str) -> str:
    return find_effect(name).about.best_motion
