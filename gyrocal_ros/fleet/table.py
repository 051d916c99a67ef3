"""The tables of one or several fleets as arrays."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.fleet.result import CALIBRATED
from gyrocal_ros.fleet.store import ABOUT, CALIBRATIONS, SCORES

STEP = 2000
"""Number of rows of score statistics that are in memory at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class FleetTable:
    """All bags of one or several runs."""

    folders: tuple[Path, ...]
    columns: Mapping[str, Sequence[Any]]
    """Columns of `calibrations.parquet`, each with a value for each of n bags; None where there is none."""
    model: Mapping[str, Any]
    """The sensor model of the run, as in `model.yaml`."""

    def __len__(self) -> int:
        return len(self.columns['bag'])

    def numbers(self, name: str) -> Array:
        """Return a column as numbers (n,), NaN where there is none."""
        values = self.columns.get(name) or [None] * len(self)
        return np.array([math.nan if value is None else value for value in values], float)

    def flags(self, name: str) -> np.ndarray:
        """Return where a column of truth values is true (n,)."""
        return np.array([value is True for value in self.columns[name]], bool)

    @property
    def calibrated(self) -> np.ndarray:
        """Mask (n,) of the bags with a calibration."""
        return np.array([status == CALIBRATED for status in self.columns['status']], bool)

    @property
    def coefficients(self) -> list[str]:
        """Names of the columns that have a standard deviation beside them."""
        return [name for name in self.columns if f'{name}_std' in self.columns]

    @property
    def priors(self) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of the prior of each coefficient, by its column; the bias has none."""
        found = {}
        for effect in self.model.get('effects', ()):
            name, stds = effect['name'], effect['prior_std']
            offset = (
                1.0 if name == SCALE_FACTOR else 0.0
            )  # the column is the factor, the model has what is beyond 1
            for item, std in stds.items():
                column = name if len(stds) == 1 else f'{name}.{item}'
                found[column] = (offset + effect['prior_mean'][item], std)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTable:
    """Score statistics of n bags and c columns; zero information where a bag lacks a column."""

    bags: tuple[str, ...]
    robots: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    information: Array
    """(n, c) diagonal of Lambda."""
    score: Array
    """(n, c) b."""
    std: Array
    """(n, c) standard deviation of each estimate by the scatter within the bag; NaN where not excited."""


def read_fleet(folders: Sequence[Path]) -> FleetTable:
    """Read the calibrations of one or several runs; a bag of two runs counts once, as of the last one.

    Raises:
        GyrocalError: a folder holds no finished fleet, or the runs have different models.
    """
    import pyarrow
    from pyarrow import parquet

    tables, models = [], []
    for folder in folders:
        try:
            tables.append(parquet.read_table(folder / CALIBRATIONS))
            models.append(json.loads((folder / ABOUT).read_text(encoding='utf-8'))['model'])
        except (OSError, pyarrow.ArrowException, ValueError, KeyError) as error:
            todo = 'give a folder that `gyrocal fleet run` has finished'
            raise GyrocalError(f'is no finished fleet ({error})', where=str(folder), todo=todo) from error
    if any(model != models[0] for model in models):
        todo = 'run both with the same --model: coefficients of different models cannot be merged'
        raise GyrocalError('have different sensor models', where=', '.join(map(str, folders)), todo=todo)
    merged = pyarrow.concat_tables(tables, promote_options='permissive').to_pydict()
    last = {bag: row for row, bag in enumerate(merged['bag'])}
    rows = sorted(last.values(), key=lambda row: (merged['robot'][row], merged['bag'][row]))
    columns = {name: [values[row] for row in rows] for name, values in merged.items()}
    return FleetTable(tuple(folders), columns, models[0])


def without_robot(table: FleetTable, robot: str) -> FleetTable:
    """Return a table without the bags of one robot."""
    kept = [row for row, name in enumerate(table.columns['robot']) if name != robot]
    columns = {name: [values[row] for row in kept] for name, values in table.columns.items()}
    return FleetTable(table.folders, columns, table.model)


def read_scores(folders: Sequence[Path]) -> ScoreTable:
    """Read the score statistics of one or several runs, without those between two columns."""
    names: dict[str, str] = {}
    parts: list[tuple[Any, IntArray, IntArray, dict[str, Array]]] = []
    for batch in _batches(folders, ['bag', 'robot', 'names', 'units', 'std', 'information', 'score']):
        lists, texts = batch.column('names'), batch.column('names').flatten().dictionary_encode()
        known, codes = texts.dictionary.to_pylist(), texts.indices.to_numpy()
        units = batch.column('units').flatten()
        for code, name in enumerate(known):
            if name not in names:
                names[name] = units[int(np.argmax(codes == code))].as_py()
        place = {name: column for column, name in enumerate(names)}
        columns = np.array([place[name] for name in known], np.int64)[codes] if len(codes) else codes
        rows = np.repeat(np.arange(len(batch)), np.diff(lists.offsets.to_numpy()))
        values = {
            name: batch.column(name).flatten().to_numpy(zero_copy_only=False)
            for name in ('std', 'information', 'score')
        }
        parts.append((batch.select(['bag', 'robot']), rows, columns, values))
    count = sum(len(batch) for batch, *_ in parts)
    information, score = np.zeros((count, len(names))), np.zeros((count, len(names)))
    std = np.full((count, len(names)), math.nan)
    start, last = 0, {}
    labels: list[tuple[str, str]] = []
    for batch, rows, columns, values in parts:
        for name, array in (('information', information), ('score', score), ('std', std)):
            array[start + rows, columns] = values[name]
        labels += zip(batch.column('bag').to_pylist(), batch.column('robot').to_pylist(), strict=True)
        start += len(batch)
    last = {bag: row for row, (bag, _) in enumerate(labels)}
    kept = sorted(last.values(), key=lambda row: (labels[row][1], labels[row][0]))
    return ScoreTable(
        bags=tuple(labels[row][0] for row in kept),
        robots=tuple(labels[row][1] for row in kept),
        names=tuple(names),
        units=tuple(names.values()),
        information=information[kept],
        score=score[kept],
        std=std[kept],
    )


def read_information(folders: Sequence[Path], scores: ScoreTable, columns: IntArray) -> Array:
    """Read Lambda (n, q, q) of some columns (q,) of a score table."""
    row_of = {bag: row for row, bag in enumerate(scores.bags)}
    found = np.zeros((len(scores.bags), len(columns), len(columns)))
    wanted = [scores.names[column] for column in columns]
    for batch in _batches(folders, ['bag', 'names', 'cross_information']):
        offsets = batch.column('names').offsets.to_numpy()
        encoded = batch.column('names').flatten().dictionary_encode()
        known, codes = encoded.dictionary.to_pylist(), encoded.indices.to_numpy()
        rows = np.array([row_of[bag] for bag in batch.column('bag').to_pylist()], np.int64)
        cross = batch.column('cross_information')
        flat, starts = cross.flatten().to_numpy(zero_copy_only=False), cross.offsets.to_numpy()
        for layout, members in _layouts(codes, offsets):
            order = {known[code]: place for place, code in enumerate(layout)}
            here = [(i, order[name]) for i, name in enumerate(wanted) if name in order]
            count = len(layout)
            for i, a in here:
                for j, b in here:
                    if a < b:
                        place = a * count - a * (a + 1) // 2 + b - a - 1
                        values = flat[starts[members] - starts[0] + place]
                        found[rows[members], i, j] = found[rows[members], j, i] = values
    diagonal = np.arange(len(columns))
    found[:, diagonal, diagonal] = scores.information[:, columns]
    return found


def _layouts(codes: IntArray, offsets: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield each distinct list of codes, and the rows that have it."""
    lengths, starts = np.diff(offsets), offsets[:-1] - offsets[0]
    for length in np.unique(lengths):
        members = np.flatnonzero(lengths == length)
        matrix = codes[starts[members][:, None] + np.arange(length)]
        if (matrix == matrix[0]).all():  # most fleets have one layout
            yield matrix[0], members
            continue
        layouts, which = np.unique(matrix, axis=0, return_inverse=True)
        for number, layout in enumerate(layouts):
            yield layout, members[which.ravel() == number]


def _batches(folders: Sequence[Path], columns: list[str]) -> Iterator[Any]:
    from pyarrow import parquet

    for folder in folders:
        with parquet.ParquetFile(folder / SCORES) as file:
            yield from file.iter_batches(STEP, columns=columns)
