"""Sentences and numbers that pages, commands and the studio share. Each verdict has its one phrasing here."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.drift import BlindDrift
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.diagnose.status import Status
from gyrocal_ros.effects.base import shown_in
from gyrocal_ros.effects.model_file import own_options
from gyrocal_ros.effects.traits import is_limit
from gyrocal_ros.ekf.history.run import Run, RunEvent
from gyrocal_ros.model.sensor import Effect

MAX_SIGMA = 30.0
"""Significance above which the exact number does not matter."""
MOST_ALIKE = 3
"""Number of events of one kind that are listed; of more, the first is."""
NO_FAILURE = 'Nowhere: chance and a slowly wandering bias explain all differences.'
FAILURE_HEADS = ('place, and the correction needed there', 'sigma')


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result in a few sentences, which come first on a page."""

    status: Status
    sentences: tuple[str, ...]
    todo: tuple[str, ...] = ()
    """Further steps, after that of the status."""

    @property
    def headline(self) -> str:
        """The status in one sentence."""
        return self.status.sentence

    @property
    def steps(self) -> tuple[str, ...]:
        """All next steps."""
        return (*((self.status.next_step,) if self.status.next_step else ()), *self.todo)


def status_line(status: Status) -> str:
    """Return the status as the first line of a result on the command line."""
    return f'[{status.level}] {status.sentence}'


def summarised(events: Sequence[RunEvent]) -> Iterator[RunEvent]:
    """Yield the events; of many that differ in their numbers alone, the first, with how many there are."""
    kinds = [re.sub(r'[-+]?\d+(\.\d+)?', '#', event.text) for event in events]
    counts, told = Counter(kinds), set()
    for event, kind in zip(events, kinds, strict=True):
        if counts[kind] <= MOST_ALIKE:
            yield event
        elif kind not in told:
            told.add(kind)
            yield replace(event, text=f'{event.text}; {counts[kind] - 1} more like this')


def events_in_words(run: Run) -> Iterator[tuple[str, str]]:
    """Yield the events of a run as warnings with their times."""
    for event in summarised(run.events):
        yield 'warning', f'{(event.t_ns - run.span.start_ns) / NS_PER_S:.1f} s after the start: {event.text}'


def failures_in_words(failures: Sequence[Failure], most: int = 5) -> Iterator[str]:
    """Yield a line for each of the worst failures, or one that says that there is none."""
    if not failures:
        yield '  nowhere: all differences are within chance'
    for failure in failures[:most]:
        yield f'  {failure.what} ({failure.sigma:.0f} sigma)'
    if len(failures) > most:
        yield f'  and {len(failures) - most} more'


def coefficients_in_words(effect: Effect, values: Array, stds: Array) -> str:
    """Return `c = 0.0101 ± 0.0002` for each coefficient, angles in degrees, and what else makes a limit."""
    items = zip(effect.coefficients, values.tolist(), stds.tolist(), strict=True)
    words = [f'{item.name} = {quantity(value, std, item.unit)}' for item, value, std in items]
    if is_limit(effect):
        words += [f'{name} = {value:.4g}' for name, value in own_options(effect).items()]
    return ', '.join(words)


def meaning(name: str, value: float, std: float) -> str:
    """Return what the scale factor does; empty for every other coefficient."""
    if name != 'scale_factor':
        return ''
    return f'true rate = ({with_std(1.0 + value, std)}) times the nominal rate'


def quantity(value: float, std: float, unit: str) -> str:
    """Return `0.0101 ± 0.0002 1/K`, angles in degrees; without the deviation where it is zero."""
    unit, factor = shown_in(unit)
    value, std = factor * value, factor * std
    text = with_std(value, std) if std > 0.0 else f'{value:.4g}'
    return f'{text} {unit}'.removesuffix(' 1')


def with_std(value: float, std: float) -> str:
    """Return a number and its standard deviation, to two digits of the latter: `0.92555 ± 0.00021`."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f'{value:g} ± {std:g}'
    decimals = 1 - math.floor(math.log10(std))
    if decimals > 8:
        return f'{value:.4g} ± {std:.2g}'
    shown = max(decimals, 0)
    return f'{round(value, decimals):.{shown}f} ± {round(std, decimals):.{shown}f}'


def with_gain(gain: float, sigma: float) -> str:
    """Return a gain of log-likelihood with its significance where that is known."""
    if not math.isfinite(gain):
        return 'fails without it'
    return f'{gain:+.1f} ({sigma:.1f} sigma)' if math.isfinite(sigma) else f'{gain:+.1f}'


def drift_in_words(drift: BlindDrift) -> str:
    """Return `0.21 (0.12 to 0.80)`, rms and its interval in deg, or a dash where no span is long enough."""
    if not len(drift.error_rad):
        return '-'
    low, high = drift.interval_deg
    above = f'to {high:.2f}' if math.isfinite(high) else 'or more'
    return f'{drift.rms_deg:.2f} ({low:.2f} {above})'


def launch_command(folder: str) -> str:
    """Return the command that starts the robot with the model and the calibration in a folder."""
    files = f'model:={folder}/model.yaml calibration:={folder}/calibration.yaml'
    return f'ros2 launch gyrocal_ros robot.launch.py {files}'


def number(value: float, form: str = '.2f') -> str:
    """Return a number, or a dash where it is not finite."""
    return f'{value:{form}}' if math.isfinite(value) else '-'


def sigma_in_words(sigma: float) -> str:
    """Return `7.5`, `> 30` above `MAX_SIGMA`, or a dash where it is unknown."""
    return number(sigma, '.1f') if not sigma > MAX_SIGMA else f'> {MAX_SIGMA:.0f}'
