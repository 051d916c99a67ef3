"""What a person should know about a recording before trusting what comes out of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from gyrocal_ros.errors import RecordingError


class Severity(StrEnum):
    """How much a finding matters."""

    ERROR = 'error'
    """Nothing can be calibrated from this recording."""
    WARNING = 'warning'
    """The work goes on, but the result may suffer."""
    NOTE = 'note'
    """Good to know."""


@dataclass(frozen=True, slots=True)
class BagIssue:
    """One thing that is wrong or odd."""

    severity: Severity
    kind: str
    """A word for programs, the same for all findings of one kind: `gap`, `upside_down`."""
    topic: str
    """The topic it concerns; empty for the recording as a whole."""
    text: str
    """What is wrong, in one clause with its figures."""
    todo: str = ''
    """What to do about it."""

    def __str__(self) -> str:
        where = f'{self.topic}: ' if self.topic else ''
        return f'{where}{self.text}; {self.todo}' if self.todo else f'{where}{self.text}'


def refuse_errors(findings: Iterable[BagIssue], where: str) -> None:
    """Raise the first finding that leaves nothing to calibrate.

    Args:
        findings: what was found.
        where: the recording.

    Raises:
        RecordingError: one of them is an error.
    """
    for finding in findings:
        if finding.severity is Severity.ERROR:
            place = f'{where}, {finding.topic}' if finding.topic else where
            raise RecordingError(finding.text, where=place, todo=finding.todo)


def one_a_kind(findings: Iterable[BagIssue]) -> list[BagIssue]:
    """Return one finding a kind, the worst of each: enough for a person who wants to get on."""
    order = list(Severity)
    worst: dict[str, BagIssue] = {}
    for finding in findings:
        known = worst.setdefault(finding.kind, finding)
        if order.index(finding.severity) < order.index(known.severity):
            worst[finding.kind] = finding
    return list(worst.values())
