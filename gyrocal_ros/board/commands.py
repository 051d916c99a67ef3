"""Commands to the board; each is repeated until it is acknowledged."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from gyrocal_ros.board.messages import Acknowledgement, SetRates, Zero
from gyrocal_ros.board.protocol import SEQUENCE_WRAP, encode

ANSWER_TIMEOUT_S = 0.5
"""Time after the expected end of a command's execution at which it is sent again."""
MAX_SEQUENCES = 8
"""Number of the latest transmissions of a command whose late answers are still accepted."""
MS_PER_S = 1000.0


Command = TypeVar('Command', SetRates, Zero)


@dataclass(slots=True)
class PendingCommand(Generic[Command]):
    """A command with its transmissions and its result."""

    command: Command
    result: int | None = None
    """Result reported by the board, one of `CommandResult`; None until it has answered."""
    attempts: int = 0
    _sent: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_SEQUENCES))
    _due_s: float = 0.0

    def is_due(self, now_s: float) -> bool:
        """Return whether the command must be sent, for the first time or again."""
        return self.result is None and now_s >= self._due_s

    def frame(self, sequence: int, now_s: float) -> bytes:
        """Return the frame of the command and start the timeout of its answer."""
        work_s = self.command.duration / MS_PER_S if isinstance(self.command, Zero) else 0.0
        self._due_s = now_s + work_s + ANSWER_TIMEOUT_S
        self._sent.append(sequence)
        self.attempts += 1
        return encode(self.command, sequence)

    def acknowledge(self, answer: Acknowledgement) -> None:
        """Process an answer that may belong to this command."""
        if answer.command == self.command.TYPE and answer.sequence in self._sent:
            self.result = answer.result


class CommandQueue:
    """The commands to one board.

    The rates are valid until the board is switched off.
    """

    def __init__(self, rates: SetRates) -> None:
        self.rates = PendingCommand(rates)
        self.zero: PendingCommand[Zero] | None = None
        self._sequence = 0

    def request_rates(self, rates: SetRates) -> None:
        """Request other rates."""
        self.rates = PendingCommand(rates)

    def resend_rates(self) -> None:
        """Request the same rates again, because the board may have lost them."""
        self.rates = PendingCommand(self.rates.command)

    def request_zero(self, duration_ms: int) -> PendingCommand[Zero]:
        """Request a measurement of the gyro zeros; the returned object will hold the result."""
        self.zero = PendingCommand(Zero(duration_ms))
        return self.zero

    def cancel_zero(self) -> None:
        """Stop requesting the measurement of the gyro zeros."""
        self.zero = None

    def due_frames(self, now_s: float) -> bytes:
        """Return the frames to be sent at this time of a monotonic clock."""
        return b''.join(
            pending.frame(self._next_sequence(), now_s)
            for pending in self._pending()
            if pending.is_due(now_s)
        )

    def acknowledge(self, answer: Acknowledgement) -> None:
        """Process an answer of the board."""
        for pending in self._pending():
            pending.acknowledge(answer)

    def _pending(self) -> list[PendingCommand[Any]]:
        return [self.rates] if self.zero is None else [self.rates, self.zero]

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) % SEQUENCE_WRAP
        return self._sequence
