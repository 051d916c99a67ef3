"""Bias or scale as a linear filter of the past: lag, resonance, hysteresis, settling."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearMemoryEffect, Stimulus
from gyrocal_ros.effects.fading import fading_memory
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Of
from gyrocal_ros.effects.learned.drives import (
    ABS_RATE,
    ANY_TURN,
    DYNAMICS,
    LAST_REST,
    LAST_TURN,
    MOVING,
    SIDE,
    START,
    fast_part,
    kept_of_steady,
    low_pass,
    motion_drive,
    side_of,
    since_rest,
    start_of_turn,
)
from gyrocal_ros.effects.learned.events import event_of, since_event
from gyrocal_ros.effects.learned.forms import Over
from gyrocal_ros.effects.learned.signals import RATE, required, to_record, values_of
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import Coefficient, Memory

TAUS_S: dict[str, tuple[float, ...]] = {
    DYNAMICS: (0.01, 0.03, 0.1),
    RATE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    ABS_RATE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    SIDE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    LAST_TURN: (2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    ANY_TURN: (2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    LAST_REST: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    MOVING: (0.25, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    START: (15.0, 30.0, 60.0, 120.0, 250.0),
}
"""What a memory may be driven by, with its time constants: the rate less its low-pass, and that less its own
low-pass; the rate; its magnitude; the side of the turn (-1, 0, 1); the side of the last turn, decaying after
it; the same of a turn to any side; the end of a rest; whether the wheels move (0, 1); a pulse at power-on."""
DRIVES = {
    DYNAMICS: 'the rate less its low-pass, and that less its own',
    RATE: 'the rate',
    ABS_RATE: 'the magnitude of the rate',
    SIDE: 'the side of the turn: -1, 0 or 1',
    LAST_TURN: 'the side of the last turn, fading after it',
    ANY_TURN: 'a turn to any side, fading after it',
    LAST_REST: 'the end of a rest, fading after it',
    MOVING: 'whether the wheels move: 0 or 1',
    START: 'a pulse at power-on',
}
"""What a memory may be driven by, in words."""
OF_SCALE = (START, ABS_RATE)
"""Drives of which a scale may be a memory, beside any signal."""
_SHOWN_AGAINST: dict[str, Stimulus] = {START: 'time', TEMPERATURE: 'temperature'}
OTHER_TAUS_S = (3.0, 10.0, 30.0, 100.0, 0.3, 1.0)
"""Time constants for any other signal. The short ones, which show its rate of change, come last: in a model
that was stored without them the others keep their meaning."""
EVENT_TAUS_S = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Time constants of what fades after an event of a signal."""


def taus_s(drive: str) -> tuple[float, ...]:
    """Return the time constants of a memory of a drive."""
    return TAUS_S.get(drive, OTHER_TAUS_S if event_of(drive) is None else EVENT_TAUS_S)


def drive_as_noun(drive: str) -> str:
    """Return what a memory is driven by, as a noun."""
    event = event_of(drive)
    return DRIVES.get(drive, drive) if event is None else f'{event.in_words}, fading after it'


def memory_shown_against(drive: str) -> Stimulus:
    """Return what a sketch varies to show a memory of a drive."""
    if event_of(drive) is not None:
        return 'event'
    return _SHOWN_AGAINST.get(drive, 'turn' if drive in TAUS_S else 'signal')


@dataclass(frozen=True)
class ExponentialBank(LinearMemoryEffect):
    """`sum_j c_j h_j` with `dh_j/dt = (u - h_j) / tau_j` and the drive u."""

    name: str
    coefficients: tuple[Coefficient, ...]

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='The sensor remembers: its bias or its scale depends on what was, over a bank of time '
            'constants. A lag, a resonance, hysteresis and slow heating have this form.',
            equation=f'w = w_n + sum_j c_j h_j{" w_n" if self.of == "scale" else ""}, '
            f'dh_j/dt = (u - h_j) / tau_j, u: {drive_as_noun(self.follows)}',
            usual_size='as found',
            best_motion='single turns with rests between them',
            source='Wahlberg 1991, System identification using Laguerre models, IEEE Transactions on '
            'Automatic Control 36(5)',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against=memory_shown_against(self.follows),
        )

    @cached_property
    def follows(self) -> str:
        """Name of the drive, a key of `TAUS_S`, a signal or an event of one."""
        return self.name.partition(':')[2]

    @property
    def signal(self) -> str:
        """Name of the signal where a recording may lack it, else empty."""
        event = event_of(self.follows)
        if event is not None:
            return to_record(event.signal)
        return '' if self.follows in TAUS_S else to_record(self.follows)

    @property
    def of(self) -> Of:
        """What remembers."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    @cached_property
    def tau_s(self) -> Array:
        """(q,) time constants."""
        return np.array(taus_s(self.follows))

    @property
    def over(self) -> Over:
        """What its response is a function of."""
        if self.follows in (LAST_TURN, ANY_TURN, LAST_REST, START) or event_of(self.follows) is not None:
            return 'fading'
        return 'dynamics' if self.follows == DYNAMICS else 'response'

    def basis(self, values: Array) -> Array:
        """Return the responses (n, k) at times (n,) from 0 on.

        They are those to a unit step of the drive, after a turn, rest or start, or to the start of a turn.
        """
        if self.over == 'dynamics':
            dt_s = np.diff(values, prepend=values[0])
            columns, _ = _fast_changes(self.tau_s, start_of_turn(values), dt_s, None)
            return columns
        kept = np.exp(-values[:, None] / self.tau_s)
        return kept if self.over == 'fading' else 1.0 - kept

    def present(self, values: Array) -> Array:
        """Return what the model has already of the responses (n, 0): nothing."""
        return np.empty((len(values), 0))

    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the memories (N, k), times the rate for a scale."""
        other = _followed if event_of(self.follows) is None else _after_event
        columns, memory = _BANKS.get(self.follows, other)(self, block, memory)
        return columns * block.rate_rad_s[:, 2:] if self.of == 'scale' else columns, memory


def memory(of: Of, drive: str) -> ExponentialBank:
    """Make a bank with a prior of usual size.

    Args:
        of: what remembers.
        drive: a key of `TAUS_S`, a signal, or an event of one.

    Raises:
        ConfigError: a scale cannot remember the rate or its side, since that is a bias.
    """
    if of == 'scale' and drive in TAUS_S:
        required(drive, OF_SCALE, f'scale_memory:{drive}')
    count = len(taus_s(drive)) * (2 if drive == DYNAMICS else 1)
    is_by_rate = of == 'bias' and drive in (DYNAMICS, RATE, ABS_RATE)
    std, unit = (0.1, '1') if is_by_rate else (TYPICAL[of], UNIT[of])
    items = tuple(Coefficient(f'c{number}', unit, std) for number in range(1, count + 1))
    return ExponentialBank(f'{of}_memory:{drive}', items)


def _followed(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    """Return the memory of a recorded signal, relative to its first value."""
    values = values_of(bank.follows, block)
    if np.isnan(values).any():
        return np.zeros((len(values), len(bank.tau_s))), before
    first, start = before if before is not None else (values[0], np.zeros(len(bank.tau_s)))
    h, _ = fading_memory(values - first, block.dt_s, bank.tau_s, start)
    return 0.5 * (h[1:] + h[:-1]), (first, h[-1])


def _of_motion(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    start = before if before is not None else np.zeros(len(bank.tau_s))
    h, _ = fading_memory(motion_drive(bank.follows, block), block.dt_s, bank.tau_s, start)
    return 0.5 * (h[1:] + h[:-1]), h[-1]


def _dynamics(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    return _fast_changes(bank.tau_s, block.rate_rad_s[:, 2], block.dt_s, before)


def _fast_changes(tau_s: Array, rate: Array, dt_s: Array, before: Memory) -> tuple[Array, Memory]:
    """Return the rate less its low-pass, and that less its own low-pass: lags, and a resonance."""
    first, second = before if before is not None else (None, None)
    fast, first = fast_part(np.repeat(rate[:, None], len(tau_s), axis=1), dt_s, tau_s, first)
    faster, second = fast_part(fast, dt_s, tau_s, second)
    return np.concatenate([fast, faster], axis=1), (first, second)


def _after_turn(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    """Return the side of the last turn, or 1 for any, decaying since its end."""
    side = side_of(block.rate_rad_s[:, 2])[:, None]
    side = np.abs(side) if bank.follows == ANY_TURN else side
    kept = np.where(side == 0.0, kept_of_steady(block.dt_s, bank.tau_s), 0.0)
    start = before if before is not None else np.zeros(len(bank.tau_s))
    h = low_pass(np.repeat(side, len(bank.tau_s), axis=1), kept, start)
    return h[1:], h[-1]


def _after_rest(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    drives, elapsed_s, now = since_rest(block, before)
    return drives[:, None] * np.exp(-elapsed_s[:, None] / bank.tau_s), now


def _after_event(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    has_been, elapsed_s, now = since_event(bank.follows, block, before)
    return has_been[:, None] * np.exp(-elapsed_s[:, None] / bank.tau_s), now


def _since_start(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    return np.exp(-block.time_s[:, None] / bank.tau_s), None


_BANKS = {
    DYNAMICS: _dynamics,
    RATE: _of_motion,
    ABS_RATE: _of_motion,
    SIDE: _of_motion,
    MOVING: _of_motion,
    LAST_TURN: _after_turn,
    ANY_TURN: _after_turn,
    LAST_REST: _after_rest,
    START: _since_start,
}
