"""Bias or scale as a linear filter of the past: lag, resonance, hysteresis, settling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, Stimulus
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Of
from gyrocal_ros.effects.learned.signals import RATE, required, to_record, values_of
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place

DYNAMICS, ABS_RATE, SIDE, LAST_TURN = 'dynamics', 'abs_rate', 'turn_side', 'last_turn'
MOVING, START = 'moving', 'start'
TAUS_S: dict[str, tuple[float, ...]] = {
    DYNAMICS: (0.01, 0.03, 0.1),
    RATE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    ABS_RATE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    SIDE: (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    LAST_TURN: (2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    MOVING: (0.25, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0),
    START: (15.0, 30.0, 60.0, 120.0, 250.0),
}
"""What a memory may be driven by, with its time constants: the rate less its low-pass, and that less its own
low-pass; the rate; its magnitude; the side of the turn (-1, 0, 1); the side of the last turn, decaying after
it; whether the wheels move (0, 1); a pulse at power-on."""
_DRIVES = {
    DYNAMICS: 'the rate less its low-pass, and that less its own',
    RATE: 'the rate',
    ABS_RATE: 'the magnitude of the rate',
    SIDE: 'the side of the turn: -1, 0 or 1',
    LAST_TURN: 'the side of the last turn, fading after it',
    MOVING: 'whether the wheels move: 0 or 1',
    START: 'a pulse at power-on',
}
OF_SCALE = (START, ABS_RATE)
"""Drives of which a scale may be a memory, beside any signal."""
_SHOWN_AGAINST: dict[str, Stimulus] = {START: 'time', TEMPERATURE: 'temperature'}
OTHER_TAUS_S = (3.0, 10.0, 30.0, 100.0)
"""Time constants for any other signal."""
TURNING_RAD_S = math.radians(5.0)
"""Rate above which the robot is in a turn."""

MOVING_M_S = 0.02
"""Speed above which the robot drives."""


@dataclass(frozen=True)
class ExponentialBank:
    """`sum_j c_j h_j` with `dh_j/dt = (u - h_j) / tau_j` and the drive u."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str
    coefficients: tuple[Coefficient, ...]

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='The sensor remembers: its bias or its scale depends on what was, over a bank of time '
            'constants. A lag, a resonance, hysteresis and slow heating have this form.',
            equation=f'w = w_n + sum_j c_j h_j{" w_n" if self.of == "scale" else ""}, '
            f'dh_j/dt = (u - h_j) / tau_j, u: {_DRIVES.get(self.drive, self.drive)}',
            usual_size='as found',
            best_motion='single turns with rests between them',
            source='Wahlberg 1991, System identification using Laguerre models, IEEE Transactions on '
            'Automatic Control 36(5)',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against=_SHOWN_AGAINST.get(self.drive, 'turn' if self.drive in TAUS_S else 'signal'),
        )

    @property
    def drive(self) -> str:
        """Name of the drive, a key of `TAUS_S` or a signal."""
        return self.name.partition(':')[2]

    @property
    def signal(self) -> str:
        """Name of the signal where a recording may lack it, else empty."""
        return '' if self.drive in TAUS_S else to_record(self.drive)

    @property
    def of(self) -> Of:
        """What remembers."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    @property
    def tau_s(self) -> Array:
        """(q,) time constants."""
        return np.array(TAUS_S.get(self.drive, OTHER_TAUS_S))

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution and its derivative (N, k); the memory is that of the bank."""
        columns, memory = _BANKS.get(self.drive, _followed)(self, block, memory)
        if self.of == 'scale':
            columns = columns * block.rate_rad_s[:, 2:]
        return GyroTerm(columns @ values, columns, memory)


def memory(of: Of, drive: str) -> ExponentialBank:
    """Make a bank with a prior of usual size.

    Args:
        of: what remembers.
        drive: a key of `TAUS_S`, or a signal.

    Raises:
        ConfigError: a scale cannot remember the rate or its side, since that is a bias.
    """
    if of == 'scale' and drive in TAUS_S:
        required(drive, OF_SCALE, f'scale_memory:{drive}')
    count = len(TAUS_S.get(drive, OTHER_TAUS_S)) * (2 if drive == DYNAMICS else 1)
    is_by_rate = of == 'bias' and drive in (DYNAMICS, RATE, ABS_RATE)
    std, unit = (0.1, '1') if is_by_rate else (TYPICAL[of], UNIT[of])
    items = tuple(Coefficient(f'c{number}', unit, std) for number in range(1, count + 1))
    return ExponentialBank(f'{of}_memory:{drive}', items)


def _low_pass(drive: Array, dt_s: Array, tau_s: Array, start: Array) -> Array:
    """Solve `dh/dt = (u - h) / tau` for drives (N, q) that are constant in each interval.

    Returns:
        h (N + 1, q) at the beginning and at the ends of the intervals.
    """
    kept = np.exp(-dt_s[:, None] / tau_s)
    h = np.empty((len(dt_s) + 1, len(tau_s)))
    h[0] = start
    for row in range(len(dt_s)):
        h[row + 1] = drive[row] + kept[row] * (h[row] - drive[row])
    return h


def _followed(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    """Return the memory of a recorded signal, relative to its first value."""
    values = values_of(bank.drive, block)
    if np.isnan(values).any():
        return np.zeros((len(values), len(bank.tau_s))), before
    first, start = before if before is not None else (values[0], np.zeros(len(bank.tau_s)))
    drive = np.repeat((values - first)[:, None], len(bank.tau_s), axis=1)
    h = _low_pass(drive, block.dt_s, bank.tau_s, start)
    return 0.5 * (h[1:] + h[:-1]), (first, h[-1])


def _of_motion(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    rate = block.rate_rad_s[:, 2]
    drive = {RATE: rate, ABS_RATE: np.abs(rate), SIDE: _side(rate), MOVING: _moves(block)}[bank.drive]
    start = before if before is not None else np.zeros(len(bank.tau_s))
    h = _low_pass(np.repeat(drive[:, None], len(bank.tau_s), axis=1), block.dt_s, bank.tau_s, start)
    return 0.5 * (h[1:] + h[:-1]), h[-1]


def _dynamics(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    """Return the rate less its low-pass, and that less its own low-pass: lags, and a resonance."""
    tau_s, rate = bank.tau_s, block.rate_rad_s[:, 2:]
    first, second = before if before is not None else (np.zeros(len(tau_s)), np.zeros(len(tau_s)))
    h = _low_pass(np.repeat(rate, len(tau_s), axis=1), block.dt_s, tau_s, first)
    fast = rate - 0.5 * (h[1:] + h[:-1])
    g = _low_pass(fast, block.dt_s, tau_s, second)
    return np.concatenate([fast, fast - 0.5 * (g[1:] + g[:-1])], axis=1), (h[-1], g[-1])


def _after_turn(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    """Return the side of the last turn, decaying since its end; 1 during the turn."""
    side = _side(block.rate_rad_s[:, 2])
    columns = np.empty((len(side), len(bank.tau_s)))
    now = before if before is not None else np.zeros(len(bank.tau_s))
    kept = np.exp(-block.dt_s[:, None] / bank.tau_s)
    for row, (turned, faded) in enumerate(zip(side.tolist(), kept, strict=True)):
        now = np.full_like(now, turned) if turned else now * faded
        columns[row] = now
    return columns, now


def _since_start(bank: ExponentialBank, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    return np.exp(-block.time_s[:, None] / bank.tau_s), None


def _side(rate_rad_s: Array) -> Array:
    return np.sign(rate_rad_s) * (np.abs(rate_rad_s) > TURNING_RAD_S)


def _moves(block: MotionBlock) -> Array:
    """Return 1 (N,) where the wheels drive or turn the robot, else 0."""
    drives = np.abs(block.distance_m) > MOVING_M_S * block.dt_s
    turns = np.abs(block.wheel_turn_rad) > TURNING_RAD_S * block.dt_s
    return (drives | turns).astype(float)


_BANKS = {
    DYNAMICS: _dynamics,
    RATE: _of_motion,
    ABS_RATE: _of_motion,
    SIDE: _of_motion,
    MOVING: _of_motion,
    LAST_TURN: _after_turn,
    START: _since_start,
}
