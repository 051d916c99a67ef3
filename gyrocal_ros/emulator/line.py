"""Emulation of the line from the board to the host: transmission time, jitter and faults."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gyrocal_ros.board.protocol import BITS_PER_BYTE
from gyrocal_ros.data import NS_PER_S, nanoseconds
from gyrocal_ros.errors import GyrocalError, did_you_mean

NEVER_NS = -(1 << 63)
PUNCTUAL_INTERVAL_NS = NS_PER_S // 4
"""Interval within which at least one frame is delivered without jitter, as the protocol requires."""


class FaultKind(StrEnum):
    """Fault of the line or the board, with the name used by `--fault`."""

    NOISE = 'noise'
    CUT = 'cut'
    DROP = 'drop'
    PAUSE = 'pause'
    UNPLUG = 'unplug'
    RESTART = 'restart'
    GAIN = 'gain'


FAULT_DESCRIPTIONS = {
    FaultKind.NOISE: 'this share of the bytes is corrupted',
    FaultKind.CUT: 'this share of the frames is truncated',
    FaultKind.DROP: 'this share of the frames is lost',
    FaultKind.PAUSE: 'nothing is delivered, then everything delayed at once',
    FaultKind.UNPLUG: 'the port is disconnected',
    FaultKind.RESTART: 'the board has no power',
    FaultKind.GAIN: 'the gyro reads too little by this share',
}
WITH_SHARE = (FaultKind.NOISE, FaultKind.CUT, FaultKind.DROP, FaultKind.GAIN)
"""Faults that affect a share of the bytes, frames or rates."""
FAULT_PATTERN = re.compile(r'(?P<kind>\w+)(@(?P<from>[\d.]+))?\+(?P<for>[\d.]+)(=(?P<share>[\d.]+))?')


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault during an interval of time."""

    kind: FaultKind
    from_ns: int
    until_ns: int
    share: float = 1.0

    def is_active(self, t_ns: int) -> bool:
        """Return whether the fault is active."""
        return self.from_ns <= t_ns < self.until_ns


def parse_fault(text: str, now_ns: int | None = None) -> Fault:
    """Parse `KIND@FROM+FOR` or `KIND@FROM+FOR=SHARE`, times in seconds.

    Args:
        text: user input.
        now_ns: start of a fault without `@FROM`; if None, `@FROM` is required.

    Raises:
        GyrocalError: the text is malformed.
    """
    match, where = FAULT_PATTERN.fullmatch(text.strip()), f'fault {text.strip()!r}'
    kinds = [kind.value for kind in FaultKind]
    if match is None or (match['from'] is None and now_ns is None):
        raise GyrocalError(
            'is malformed', where=where, todo='write KIND@FROM+FOR[=SHARE], as in noise@120+30=0.05'
        )
    if match['kind'] not in kinds:
        raise GyrocalError('is not a fault', where=where, todo=did_you_mean(match['kind'], kinds))
    kind = FaultKind(match['kind'])
    from_ns = nanoseconds(_number(match['from'], where)) if match['from'] else now_ns or 0
    share = _number(match['share'] or '1', where)
    if (kind in WITH_SHARE) != (match['share'] is not None) or not 0.0 < share <= 1.0:
        todo = f'write {kind}@FROM+FOR' + ('=SHARE, a share from 0 to 1' if kind in WITH_SHARE else '')
        raise GyrocalError('has a wrong share', where=where, todo=todo)
    return Fault(kind, from_ns, from_ns + nanoseconds(_number(match['for'], where)), share)


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise GyrocalError(f'{text} is not a number', where=where) from None


@dataclass(frozen=True, slots=True)
class DataEvent:
    """Bytes delivered to the host."""

    t_ns: int
    data: bytes


class EmulatedLine:
    """Delivers frames in order, with delays and faults.

    Args:
        baud_rate: speed of the line.
        jitter_s: upper limit of the random delay on the host's side, uniformly distributed. The first
            frame of each quarter of a second has none.
        faults: faults of the line; more may be appended while it runs.
        rng: generator for jitter and faults.
    """

    def __init__(
        self, baud_rate: int, jitter_s: float, faults: list[Fault], rng: np.random.Generator
    ) -> None:
        self.faults = faults
        self._byte_ns = BITS_PER_BYTE * NS_PER_S // baud_rate
        self._jitter_ns = nanoseconds(jitter_s)
        self._jitter_rng, self._fault_rng = rng.spawn(2)
        self._wire_free_ns = self._delivered_ns = self._punctual_ns = NEVER_NS

    def carry(self, frame: bytes, t_ns: int) -> DataEvent | None:
        """Transmit a frame that is ready at `t_ns`; return None if nothing of it is delivered."""
        self._wire_free_ns = max(t_ns, self._wire_free_ns) + len(frame) * self._byte_ns
        due_ns = self._jittered(self._wire_free_ns)
        for fault in self.faults:
            if fault.kind is FaultKind.PAUSE and fault.is_active(due_ns):
                due_ns = fault.until_ns
        due_ns = self._delivered_ns = max(due_ns, self._delivered_ns)
        for fault in self.faults:
            if fault.is_active(due_ns):
                frame = self._after_fault(frame, fault)
        return DataEvent(due_ns, frame) if frame else None

    def _jittered(self, t_ns: int) -> int:
        """Add the random delay to the time of a transmitted frame."""
        jitter_ns = int(self._jitter_rng.integers(0, self._jitter_ns, endpoint=True))
        if t_ns >= self._punctual_ns:
            self._punctual_ns = (t_ns // PUNCTUAL_INTERVAL_NS + 1) * PUNCTUAL_INTERVAL_NS
            return t_ns
        return min(t_ns + jitter_ns, self._punctual_ns)

    def _after_fault(self, frame: bytes, fault: Fault) -> bytes:
        """Return what is left of a frame after a fault."""
        rng = self._fault_rng
        match fault.kind:
            case FaultKind.NOISE:
                wrong = rng.integers(1, 256, len(frame)) * (rng.random(len(frame)) < fault.share)
                return bytes(byte ^ flips for byte, flips in zip(frame, wrong.tolist(), strict=True))
            case FaultKind.CUT if rng.random() < fault.share:
                return frame[: int(rng.integers(len(frame)))]
            case FaultKind.DROP if rng.random() < fault.share:
                return b''
            case FaultKind.UNPLUG:
                return b''
        return frame
