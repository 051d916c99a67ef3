"""What the board has to be told: a command is repeated until it is answered."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from gyrocal_ros.board.messages import Acknowledgement, SetRates, Zero
from gyrocal_ros.board.protocol import SEQUENCE_WRAP, encode

PATIENCE_S = 0.5
"""A command is sent again when its answer takes so much longer than its work."""
LATE_ANSWERS = 8
"""An answer to one of so many repetitions still counts."""
MS_PER_S = 1000.0


Command = TypeVar('Command', SetRates, Zero)


@dataclass(slots=True)
class Order(Generic[Command]):
    """A command, and how far it has come."""

    command: Command
    result: int | None = None
    """What the board made of it, one of `Result`; None as long as it has not answered."""
    tries: int = 0
    _sent: deque[int] = field(default_factory=lambda: deque(maxlen=LATE_ANSWERS))
    _due_s: float = 0.0

    def is_due(self, now_s: float) -> bool:
        """Whether it has to be sent, for the first time or again."""
        return self.result is None and now_s >= self._due_s

    def frame(self, sequence: int, now_s: float) -> bytes:
        """Return its frame and wait for the answer from now on."""
        work_s = self.command.duration / MS_PER_S if isinstance(self.command, Zero) else 0.0
        self._due_s = now_s + work_s + PATIENCE_S
        self._sent.append(sequence)
        self.tries += 1
        return encode(self.command, sequence)

    def hear(self, answer: Acknowledgement) -> None:
        """Take an answer that may be to this command."""
        if answer.command == self.command.TYPE and answer.sequence in self._sent:
            self.result = answer.result


class Commands:
    """All that is to be sent to one board.

    Rates hold for as long as the board is on.
    """

    def __init__(self, rates: SetRates) -> None:
        self.rates = Order(rates)
        self.zero: Order[Zero] | None = None
        self._sequence = 0

    def ask_for_rates(self, rates: SetRates) -> None:
        """Ask for other rates."""
        self.rates = Order(rates)

    def repeat_rates(self) -> None:
        """Ask for the same rates once more: the board may have forgotten them."""
        self.rates = Order(self.rates.command)

    def ask_for_zero(self, duration_ms: int) -> Order[Zero]:
        """Ask for the zero of the gyros; the answer will stand in the order."""
        self.zero = Order(Zero(duration_ms))
        return self.zero

    def forget_zero(self) -> None:
        """Ask no more for the zero."""
        self.zero = None

    def due(self, now_s: float) -> bytes:
        """Return the frames that are to be sent now, by a clock that is never set."""
        return b''.join(
            order.frame(self._next_sequence(), now_s) for order in self._orders() if order.is_due(now_s)
        )

    def hear(self, answer: Acknowledgement) -> None:
        """Take an answer of the board."""
        for order in self._orders():
            order.hear(answer)

    def _orders(self) -> list[Order[Any]]:
        return [self.rates] if self.zero is None else [self.rates, self.zero]

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) % SEQUENCE_WRAP
        return self._sequence
