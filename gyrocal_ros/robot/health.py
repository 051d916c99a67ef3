"""How a running part of the robot is, in sentences that a technician can act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum


class Level(IntEnum):
    """How bad it is, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Complaint:
    """One thing that is wrong now: a clause that says what, and what to do where that helps."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class Status:
    """The health of one part."""

    level: Level
    message: str
    numbers: Mapping[str, object] = field(default_factory=dict)
    """Counts and rates since the start, by a name that carries the unit."""


def status(fine: str, complaints: Sequence[Complaint], numbers: Mapping[str, object]) -> Status:
    """Put complaints together, the worst first; without any, `fine` is the message."""
    worst_first = sorted(complaints, key=lambda complaint: -complaint.level)
    level = worst_first[0].level if worst_first else Level.OK
    message = '; '.join(complaint.text for complaint in worst_first) or fine
    return Status(level, message, numbers)
