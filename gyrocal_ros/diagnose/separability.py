"""Test drives that tell effects apart: what to record next where two explanations are left.

`separability.json` holds the rows of `gyrocal bench motions --json` (see `bench.separability`) and the
instructions of the drives (`sim.drives`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import COVARIATE_EFFECTS, SCALE_FACTOR, find_effect
from gyrocal_ros.errors import ConfigError, did_you_mean

MAX_UNLISTED_CORRELATION = 0.85
"""Pairs of effects whose correlation exceeds this in no drive have no row of their own."""
MIN_SEPARATION = 2.0 * DEFAULT_SETTINGS.indistinguishable_sigma
"""With d sigma between two effects, the right one gains d^2 / 2 more, with a standard deviation of d: it is
preferred by d / 2 sigma."""


@dataclass(frozen=True, slots=True)
class BestDrive:
    """The drive that tells two effects apart best."""

    first: str
    second: str
    drive: str
    """Name of a test drive, or of everyday use where that is best."""
    correlation: float
    """Correlation of the two effects in that drive."""
    sigma: float
    """Separation of the two in that drive, at the usual size of the one that shows less."""
    everyday_correlation: float | None
    """Correlation in everyday use; None where one of them does not show."""
    everyday_sigma: float
    """Separation in everyday use."""

    @property
    def helps(self) -> bool:
        """True if the drive tells them apart."""
        return self.sigma >= MIN_SEPARATION


@dataclass(frozen=True, slots=True)
class Table:
    """The computed figures of each drive."""

    everyday: str
    """Name of the drive that represents everyday use."""
    drives: dict[str, str]
    """Name and instruction of each drive."""
    significance: dict[str, dict[str, float]]
    """Sigma of each effect of usual size, by drive."""
    correlations: dict[frozenset[str], dict[str, float | None]]
    """Correlation of pairs of effects, by drive."""

    def correlation(self, first: str, second: str, drive: str) -> float | None:
        """Return the correlation of two effects in a drive, for a pair without a row its upper bound."""
        row = self.correlations.get(frozenset((first, second)))
        return MAX_UNLISTED_CORRELATION if row is None else row[drive]

    def separation(self, first: str, second: str, drive: str) -> float:
        """Return by how many sigma a drive separates two effects."""
        weaker = min(self.significance[first][drive], self.significance[second][drive])
        if SCALE_FACTOR in (first, second):  # every model has it: what is significant is separate from it
            return weaker
        correlation = self.correlation(first, second, drive)
        return 0.0 if correlation is None else weaker * math.sqrt(max(1.0 - correlation**2, 0.0))


@cache
def table() -> Table:
    """Read the computed figures."""
    text = files('gyrocal_ros.diagnose').joinpath('separability.json').read_text(encoding='utf-8')
    content = json.loads(text)
    rows = {row.pop('effect'): row for row in content['rows']}
    return Table(
        everyday=content['everyday'],
        drives=content['drives'],
        significance={name: row for name, row in rows.items() if '/' not in name},
        correlations={frozenset(name.split('/')): row for name, row in rows.items() if '/' in name},
    )


def best_drive(first: str, second: str) -> BestDrive:
    """Find the drive that tells two effects, given by name, apart best.

    Raises:
        ConfigError: an effect is not of the library, so nothing was computed for it.
    """
    known, one, other = table(), kind_of(first), kind_of(second)
    for name in (one, other):
        if name not in known.significance:
            raise ConfigError('has no figures', where=name, todo=did_you_mean(name, known.significance))
    best = max(known.drives, key=lambda drive: known.separation(one, other, drive))
    return BestDrive(
        first=first,
        second=second,
        drive=best,
        correlation=known.correlation(one, other, best) or 0.0,
        sigma=known.separation(one, other, best),
        everyday_correlation=known.correlation(one, other, known.everyday),
        everyday_sigma=known.separation(one, other, known.everyday),
    )


def drive_for(name: str) -> str | None:
    """Return the instruction of the test drive that shows an effect best; None if none shows it."""
    known = table()
    shows = known.significance.get(kind_of(name), {})
    best = max(shows, key=lambda drive: shows[drive], default=None)
    if best is None or best not in known.drives or best == known.everyday:
        return None
    return known.drives[best] if shows[best] > DEFAULT_SETTINGS.significant_sigma else None


def how_to_tell_apart(effect_name: str, others: Sequence[str]) -> list[str]:
    """Return what to record next, a sentence for each effect that may be meant instead."""
    return [_sentence(effect_name, other) for other in others]


def kind_of(name: str) -> str:
    """Return the name under which an effect is tabled: covariate effects without their signal."""
    kind = name.partition(':')[0]
    return kind if kind in COVARIATE_EFFECTS else name


def _sentence(name: str, other: str) -> str:
    to_tell = f'To tell {name} from {other}'
    if kind_of(name) == kind_of(other):
        return f'{to_tell}, make one of the two signals change without the other.'
    if not {kind_of(name), kind_of(other)} <= table().significance.keys():
        return f'{to_tell}, record {_best_motion(name)}; and {_best_motion(other)}.'
    found = best_drive(name, other)
    if not found.helps:
        return f'{to_tell}, measure one of them by other means: no motion tells them apart.'
    in_use = '' if found.drive == table().everyday else f', {found.everyday_sigma:.0f} sigma in everyday use'
    return (
        f'{to_tell}, record five minutes of this: {table().drives[found.drive]}. '
        f'It separates them by {found.sigma:.0f} sigma at their usual size{in_use}.'
    )


def _best_motion(name: str) -> str:
    return find_effect(name).about.best_motion
