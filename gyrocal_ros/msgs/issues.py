"""Issues of a recording that a person should know before trusting results computed from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from gyrocal_ros.errors import RecordingError


class Severity(StrEnum):
    """Severity of an issue, the most severe first."""

    ERROR = 'error'
    """Nothing can be calibrated from this recording."""
    WARNING = 'warning'
    """The calibration continues, but its result may suffer."""
    NOTE = 'note'
    """Information only."""


@dataclass(frozen=True, slots=True)
class BagIssue:
    """One thing in a recording that is wrong or unusual."""

    severity: Severity
    kind: str
    """Identifier for programs, the same for all issues of one kind: `gap`, `upside_down`."""
    topic: str
    """Topic that has the issue; empty for the recording as a whole."""
    text: str
    """Description in one clause, with its figures."""
    todo: str = ''
    """Remedy; empty if there is none."""

    def __str__(self) -> str:
        where = f'{self.topic}: ' if self.topic else ''
        return f'{where}{self.text}; {self.todo}' if self.todo else f'{where}{self.text}'


def raise_first_error(issues: Iterable[BagIssue], where: str) -> None:
    """Raise the first issue that makes calibration impossible.

    Args:
        issues: issues of the recording.
        where: name of the recording.

    Raises:
        RecordingError: one of the issues is an error.
    """
    for issue in issues:
        if issue.severity is Severity.ERROR:
            place = f'{where}, {issue.topic}' if issue.topic else where
            raise RecordingError(issue.text, where=place, todo=issue.todo)


def worst_per_kind(issues: Iterable[BagIssue]) -> list[BagIssue]:
    """Return the most severe issue of each kind: a summary for a person."""
    order = list(Severity)
    worst: dict[str, BagIssue] = {}
    for issue in issues:
        known = worst.setdefault(issue.kind, issue)
        if order.index(issue.severity) < order.index(known.severity):
            worst[issue.kind] = issue
    return list(worst.values())
