"""Columns that grow row by row, for recordings of many hours."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array

GROWTH = 1.25
"""Factor by which the memory of a full column grows: what is unused stays small."""
FIRST_ROWS = 1024


class GrowingColumn:
    """A column to which rows are appended.

    Args:
        shape: shape of a row.
        dtype: type of its numbers.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: type = float) -> None:
        self._rows: np.ndarray = np.empty((FIRST_ROWS, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: Array | float) -> None:
        """Add one row."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows[: self._unused()])])
        self._rows[self._count] = row
        self._count += 1

    def pad(self, count: int) -> None:
        """Add rows of NaN up to a number of rows."""
        while self._count < count:
            self.append(np.nan)

    def rows(self) -> np.ndarray:
        """Return all rows so far, (s, ...), as a view that later rows do not change."""
        return self._rows[: self._count]

    def _unused(self) -> int:
        return int((GROWTH - 1.0) * len(self._rows))
