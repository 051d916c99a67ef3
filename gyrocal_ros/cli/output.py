"""What the commands say: results on standard output, all else on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from tqdm import tqdm

from gyrocal_ros.files import json_text


def progress(
    label: str, items: Iterable[Any] = (), *, total: float | None = None, unit: str = 'it'
) -> tqdm[Any]:
    """Show a progress bar with the time left, where a person is watching and the work takes a while.

    Iterate over it to get `items`, or give `total`, use it as a context and call its `update`.

    Args:
        label: what is being done.
        items: what is worked through.
        total: amount of work, where there are no `items` or they have no length.
        unit: unit of `total`.
    """
    return tqdm(
        items,
        desc=label,
        total=total,
        unit=unit,
        delay=2.0,
        leave=False,
        disable=not sys.stderr.isatty(),
    )


def warn(message: str) -> None:
    """Tell a person about something that the command has worked around."""
    print(f'gyrocal: warning: {message}', file=sys.stderr)


def print_json(values: Mapping[str, Any]) -> None:
    """Print one JSON object."""
    print(json_text(values), end='')


def print_row(row: Mapping[str, Any], header: bool) -> None:
    """Print one row of a table at once, so that a long one grows as its rows become ready.

    Args:
        row: names and values; the columns are as wide as their names, those of texts wider.
        header: print the names above it.
    """
    widths = [max(len(name), 32 if isinstance(value, str) else 9) for name, value in row.items()]
    if header:
        print('  '.join(name.ljust(width) for name, width in zip(row, widths, strict=True)).rstrip())
    cells = [_cell(value).ljust(width) for value, width in zip(row.values(), widths, strict=True)]
    print('  '.join(cells).rstrip(), flush=True)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table, its columns as wide as they need to be."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    for row in (header, *rows):
        yield '  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def tell(message: str) -> None:
    """Say on standard error how far the work has come."""
    print(f'gyrocal: {message}', file=sys.stderr, flush=True)


def _cell(value: Any) -> str:
    return f'{value:.4g}' if isinstance(value, float) else '-' if value is None else str(value)
