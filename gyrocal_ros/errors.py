"""Errors that a user can act on.

Libraries inside the package raise these and never print or exit; the command line and the nodes display
the one-line message and decide how to continue.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

CHECK_THE_SENSORS = 'look for outliers, wrong units and exchanged axes of the gyro with `gyrocal check`'


class GyrocalError(Exception):
    """An error that the user can fix. The message says what is wrong, where, and what to do.

    Args:
        what: what is wrong, in one clause.
        where: the file, topic or setting concerned.
        todo: what to do about it.
    """

    def __init__(self, what: str, *, where: str = '', todo: str = '') -> None:
        self.what, self.where, self.todo = what, where, todo
        message = f'{where}: {what}' if where else what
        super().__init__(f'{message}; {todo}' if todo else message)

    def __reduce__(self) -> tuple[object, ...]:
        """Pass between processes with all parts, whatever the arguments of a subclass are."""
        return GyrocalError.__new__, (type(self), *self.args), self.__dict__


class ConfigError(GyrocalError):
    """A setting or a sensor model that cannot be used."""


class RecordingError(GyrocalError):
    """A bag that cannot be read, or lacks data that the command needs."""


class MessageError(RecordingError):
    """One message whose content cannot be used. It is left out and counted; no message ends a program."""


class FilterDivergedError(GyrocalError):
    """The estimate is inconsistent with the measurements; its values would be meaningless."""


class IndefiniteCovarianceError(FilterDivergedError):
    """The covariance of an innovation is singular or indefinite."""

    def __init__(self) -> None:
        super().__init__(
            'the readings contradict each other: the covariance of the innovation is no longer positive '
            'definite',
            todo=CHECK_THE_SENSORS,
        )


class NotObservableError(GyrocalError):
    """The recording does not contain the motion that the result requires."""


CANNOT_RUN = (FilterDivergedError, NotObservableError)
"""Errors of a run with an effect that may be wrong; a wrong time offset, say, leaves no image to use."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the known name nearest to `name`, or all known names, as text for an error message."""
    near = nearest(name, known)
    return f'did you mean {near!r}?' if near else f'known are {", ".join(known)}'


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that resembles `name` most, or None if none does."""
    return next(iter(difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)), None)
