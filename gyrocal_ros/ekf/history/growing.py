"""Columns that grow row by row, for recordings of many hours."""

from __future__ import annotations

import mmap
from math import prod

import numpy as np

from gyrocal_ros.data import Array

GROWTH = 2
"""Factor by which the memory of a full column grows: what is unused is never touched, so it takes none."""
FIRST_ROWS = 1024


class GrowingColumn:
    """A column to which rows are appended.

    Args:
        shape: shape of a row.
        dtype: type of its numbers.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: type = float) -> None:
        self._rows = _untouched((FIRST_ROWS, *shape), np.dtype(dtype))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: Array | float) -> None:
        """Add one row."""
        self._make_room(1)
        self._rows[self._count] = row
        self._count += 1

    def extend(self, rows: np.ndarray) -> None:
        """Add several rows (n, ...)."""
        self._make_room(len(rows))
        self._rows[self._count : self._count + len(rows)] = rows
        self._count += len(rows)

    def pad(self, count: int) -> None:
        """Add rows of NaN up to a number of rows."""
        while self._count < count:
            self.append(np.nan)

    def rows(self) -> np.ndarray:
        """Return all rows so far, (s, ...), as a view that later rows do not change."""
        return self._rows[: self._count]

    def _make_room(self, count: int) -> None:
        while self._count + count > len(self._rows):
            grown = _untouched((GROWTH * len(self._rows), *self._rows.shape[1:]), self._rows.dtype)
            grown[: self._count] = self.rows()
            self._rows = grown


def _untouched(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Return an array in a mapping of its own: pages count once they are written, and go back with the array.

    Arrays on the heap would leave gaps behind where many columns grow in turn.
    """
    size = max(1, prod(shape) * dtype.itemsize)
    return np.ndarray(shape, dtype, mmap.mmap(-1, size, access=mmap.ACCESS_COPY))
