"""Output of the commands: results on standard output, everything else on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from tqdm import tqdm

from gyrocal_ros.files import json_text

_line = 0
"""Line below the cursor on which this process draws its progress bars."""
tqdm.monitor_interval = 0  # no thread beside, so that processes can be forked


def draw_on_line(number: int) -> None:
    """Draw the progress bars of this process on a line of their own, beside those of other processes."""
    global _line
    _line = number


def progress(
    label: str, items: Iterable[Any] = (), *, total: float | None = None, unit: str = 'it'
) -> tqdm[Any]:
    """Return a progress bar, shown on a terminal after 2 s of work.

    Either iterate over it to get `items`, or give `total`, use it as a context and call its `update`.

    Args:
        label: description of the work.
        items: items of the work.
        total: amount of work, if there are no `items` or they have no length.
        unit: unit of `total`.
    """
    return tqdm(
        items,
        desc=label,
        total=total,
        unit=unit,
        delay=2.0,
        position=_line or None,
        leave=False,
        disable=not sys.stderr.isatty(),
    )


def warn(message: str) -> None:
    """Print a warning on standard error."""
    with suppress(OSError):  # a full disk behind it must not end the work
        print(f'gyrocal: warning: {message}', file=sys.stderr, flush=True)


def print_json(values: Mapping[str, Any]) -> None:
    """Print one JSON object."""
    print(json_text(values), end='')


def print_row(row: Mapping[str, Any], header: bool) -> None:
    """Print one row of a table immediately, for tables whose rows take long to compute.

    Args:
        row: names and values; a column is at least 9 characters wide, 32 for text.
        header: print the names above the row.
    """
    widths = [max(len(name), 32 if isinstance(value, str) else 9) for name, value in row.items()]
    if header:
        print('  '.join(name.ljust(width) for name, width in zip(row, widths, strict=True)).rstrip())
    cells = [_cell(value).ljust(width) for value, width in zip(row.values(), widths, strict=True)]
    print('  '.join(cells).rstrip(), flush=True)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table; each column is as wide as its longest cell."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    for row in (header, *rows):
        yield '  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def print_message(message: str) -> None:
    """Print a message on the state of the work on standard error."""
    with suppress(OSError):
        print(f'gyrocal: {message}', file=sys.stderr, flush=True)


def _cell(value: Any) -> str:
    return f'{value:.4g}' if isinstance(value, float) else '-' if value is None else str(value)
