"""The way from an emulated board to the host: the wire, jitter, and faults on demand."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gyrocal_ros.board.protocol import BITS_PER_BYTE
from gyrocal_ros.data import NS_PER_S, nanoseconds
from gyrocal_ros.errors import GyrocalError, did_you_mean

BEFORE_ALL_NS = -(1 << 63)
PUNCTUAL_NS = NS_PER_S // 4
"""Once in so long a time all that waits comes through, as the protocol asks for."""


class FaultKind(StrEnum):
    """What can go wrong, by the name that is given to `--fault`."""

    NOISE = 'noise'
    CUT = 'cut'
    DROP = 'drop'
    PAUSE = 'pause'
    UNPLUG = 'unplug'
    RESTART = 'restart'


ABOUT = {
    FaultKind.NOISE: 'this share of the bytes is wrong',
    FaultKind.CUT: 'this share of the frames breaks off',
    FaultKind.DROP: 'this share of the frames is lost',
    FaultKind.PAUSE: 'nothing comes through, then all that waited at once',
    FaultKind.UNPLUG: 'the port is gone',
    FaultKind.RESTART: 'the board is without power',
}
SHARED = (FaultKind.NOISE, FaultKind.CUT, FaultKind.DROP)
"""Those that befall a share of what is sent."""
FORM = re.compile(r'(?P<kind>\w+)(@(?P<from>[\d.]+))?\+(?P<for>[\d.]+)(=(?P<share>[\d.]+))?')


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong for a while."""

    kind: FaultKind
    from_ns: int
    until_ns: int
    share: float = 1.0

    def holds(self, t_ns: int) -> bool:
        """Whether it is at work."""
        return self.from_ns <= t_ns < self.until_ns


def parse_fault(text: str, now_ns: int | None = None) -> Fault:
    """Read `KIND@FROM+FOR` or `KIND@FROM+FOR=SHARE`, times in seconds.

    Args:
        text: what a person wrote.
        now_ns: when a fault without `@FROM` begins; without it, all have to say it.

    Raises:
        GyrocalError: it is not of that form.
    """
    form, where = FORM.fullmatch(text.strip()), f'fault {text.strip()!r}'
    kinds = [kind.value for kind in FaultKind]
    if form is None or (form['from'] is None and now_ns is None):
        raise GyrocalError(
            'is not understood', where=where, todo='write KIND@FROM+FOR[=SHARE], as in noise@120+30=0.05'
        )
    if form['kind'] not in kinds:
        raise GyrocalError('is not known', where=where, todo=did_you_mean(form['kind'], kinds))
    kind = FaultKind(form['kind'])
    from_ns = nanoseconds(_number(form['from'], where)) if form['from'] else now_ns or 0
    share = _number(form['share'] or '1', where)
    if (kind in SHARED) != (form['share'] is not None) or not 0.0 < share <= 1.0:
        todo = f'write {kind}@FROM+FOR' + ('=SHARE, a share from 0 to 1' if kind in SHARED else '')
        raise GyrocalError('has a wrong share', where=where, todo=todo)
    return Fault(kind, from_ns, from_ns + nanoseconds(_number(form['for'], where)), share)


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise GyrocalError(f'{text} is no number', where=where) from None


@dataclass(frozen=True, slots=True)
class Delivery:
    """Bytes that come to the host."""

    t_ns: int
    data: bytes


class EmulatedLine:
    """Carries frames, in the order in which they come in.

    Args:
        baud_rate: how fast the wire is.
        jitter_s: what the host's side adds to the way of a frame, at most; all is equally likely. The
            first frame of each quarter of a second is not held up.
        faults: what goes wrong, and when; more may be appended while it runs.
        rng: of jitter and faults.
    """

    def __init__(
        self, baud_rate: int, jitter_s: float, faults: list[Fault], rng: np.random.Generator
    ) -> None:
        self.faults = faults
        self._byte_ns = BITS_PER_BYTE * NS_PER_S // baud_rate
        self._jitter_ns = nanoseconds(jitter_s)
        self._jitter, self._chance = rng.spawn(2)
        self._wire_free_ns = self._delivered_ns = self._punctual_ns = BEFORE_ALL_NS

    def carry(self, frame: bytes, t_ns: int) -> Delivery | None:
        """Carry a frame that is ready at `t_ns`; None where nothing of it arrives."""
        self._wire_free_ns = max(t_ns, self._wire_free_ns) + len(frame) * self._byte_ns
        due_ns = self._jittered(self._wire_free_ns)
        for fault in self.faults:
            if fault.kind is FaultKind.PAUSE and fault.holds(due_ns):
                due_ns = fault.until_ns
        due_ns = self._delivered_ns = max(due_ns, self._delivered_ns)
        for fault in self.faults:
            if fault.holds(due_ns):
                frame = self._spoiled(frame, fault)
        return Delivery(due_ns, frame) if frame else None

    def _jittered(self, t_ns: int) -> int:
        """Hold up what has come over the wire."""
        jitter_ns = int(self._jitter.integers(0, self._jitter_ns, endpoint=True))
        if t_ns >= self._punctual_ns:
            self._punctual_ns = (t_ns // PUNCTUAL_NS + 1) * PUNCTUAL_NS
            return t_ns
        return min(t_ns + jitter_ns, self._punctual_ns)

    def _spoiled(self, frame: bytes, fault: Fault) -> bytes:
        """Return what one fault leaves of a frame."""
        chance = self._chance
        match fault.kind:
            case FaultKind.NOISE:
                wrong = chance.integers(1, 256, len(frame)) * (chance.random(len(frame)) < fault.share)
                return bytes(byte ^ flips for byte, flips in zip(frame, wrong.tolist(), strict=True))
            case FaultKind.CUT if chance.random() < fault.share:
                return frame[: int(chance.integers(len(frame)))]
            case FaultKind.DROP if chance.random() < fault.share:
                return b''
            case FaultKind.UNPLUG:
                return b''
        return frame
