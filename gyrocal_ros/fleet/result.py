"""Result of one bag: a row of figures, and the score statistics of the candidate effects."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal_ros.data import Array

CALIBRATED, FAILED = 'calibrated', 'failed'
"""Values of the column `status`."""


@dataclass(frozen=True, slots=True, eq=False)
class BagScores:
    """Score statistics of c candidate coefficients, summed over a bag (`ekf.history.score_statistics`)."""

    names: tuple[str, ...]
    """`effect.coefficient`, with `@value` for a coefficient that is scanned."""
    units: tuple[str, ...]
    information: Array
    """(c, c) Lambda."""
    score: Array
    """(c,) b."""
    std: Array
    """(c,) standard deviation of each estimate b / Lambda alone, by the scatter within the bag; NaN where
    the bag does not excite the coefficient."""

    @property
    def value(self) -> Array:
        """Estimate (c,) of each coefficient alone; NaN where it is not excited."""
        excited = np.isfinite(self.std)
        information = np.where(excited, np.diagonal(self.information), math.nan)
        value: Array = self.score / information
        return value


@dataclass(frozen=True, slots=True, eq=False)
class BagResult:
    """Result of one bag."""

    row: Mapping[str, Any]
    """Columns of `calibrations.parquet` that follow from the bag alone."""
    scores: BagScores | None
    """None for a failed bag."""
    is_final: bool = True
    """False where another try may succeed: the bag could not be copied, or its worker was lost."""


def failed(reason: str, *, is_final: bool = True) -> BagResult:
    """Return the result of a bag that could not be calibrated from."""
    return BagResult({'status': FAILED, 'reason': reason}, None, is_final)


def encode(result: BagResult, key: str) -> bytes:
    """Return the content of a result file; the same result gives the same bytes.

    Args:
        result: the result of a bag.
        key: digest of everything that the result depends on.
    """
    scores = result.scores
    head: dict[str, Any] = {'key': key, 'row': dict(result.row), 'names': None, 'units': None}
    arrays: dict[str, Array] = {}
    if scores is not None:
        head |= {'names': scores.names, 'units': scores.units}
        upper = np.triu_indices(len(scores.names))
        arrays = {'information': scores.information[upper], 'score': scores.score, 'std': scores.std}
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    np.savez_compressed(buffer, head=text, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def decode(content: bytes, key: str) -> BagResult | None:
    """Read a result file; return None if it is damaged or belongs to another `key`."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            head = json.loads(file['head'].tobytes())
            if head['key'] != key:
                return None
            if head['names'] is None:
                return BagResult(head['row'], None)
            count = len(head['names'])
            information = np.zeros((count, count))
            information[np.triu_indices(count)] = file['information']
            information += np.triu(information, 1).T
            names, units = tuple(head['names']), tuple(head['units'])
            return BagResult(head['row'], BagScores(names, units, information, file['score'], file['std']))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
