"""Folder of a fleet: a small file for each finished bag, and the tables that are made of them.

Every file appears complete or not at all, so that the work may be killed at any time and continued.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import json_text, write_text_atomic
from gyrocal_ros.fleet.plan import PlannedBag
from gyrocal_ros.fleet.result import BagResult, decode, encode, failed

CALIBRATIONS, SCORES, ABOUT = 'calibrations.parquet', 'scores.parquet', 'fleet.json'
RESULTS = 'bags'
"""Folder of the result files."""
ROWS_AT_A_TIME = 1000
"""Number of rows that are in memory while a table is written."""

TEXT, NUMBER, TRUTH = 'string', 'double', 'bool'
COLUMNS = {
    'bag': TEXT,
    'robot': TEXT,
    'time': TEXT,
    'status': TEXT,
    'reason': TEXT,
    'scale_factor': NUMBER,
    'scale_factor_std': NUMBER,
    'bias': NUMBER,
    'bias_std': NUMBER,
    'converged': TRUTH,
    'model_fits': TRUTH,
    'verdict': TEXT,
    'effect': TEXT,
    'effect_sigma': NUMBER,
    'blind_drift_deg': NUMBER,
    'duration_s': NUMBER,
    'convergence_time_s': NUMBER,
    'nis_per_dof': NUMBER,
    'temperature_c': NUMBER,
}
"""Columns that `calibrations.parquet` always has, with their types; coefficients of the model and columns of
the user's table follow."""
LISTS = ('value', 'std', 'information', 'score')
"""Columns of `scores.parquet` with one number for each coefficient."""


class FleetStore:
    """The results in one folder.

    Args:
        folder: created if it does not exist.

    Raises:
        GyrocalError: the folder contains other files, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._results = folder / RESULTS
        if folder.is_file() or (folder.is_dir() and any(folder.iterdir()) and not self._results.is_dir()):
            raise GyrocalError('is not the folder of a fleet', where=str(folder), todo='give a new name')
        try:
            self._results.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            todo = 'check the path and its permissions'
            raise GyrocalError(
                f'cannot be written ({error.strerror})', where=str(folder), todo=todo
            ) from error

    def load(self, bag: str, key: str) -> BagResult | None:
        """Return the stored result of a bag; None if there is none for this `key`."""
        try:
            return decode(self._path(bag).read_bytes(), key)
        except OSError:
            return None

    def save(self, bag: str, key: str, result: BagResult) -> None:
        """Store the result of a bag."""
        _write_bytes(self._path(bag), encode(result, key))

    def write_tables(
        self,
        planned: Sequence[PlannedBag],
        results: Iterable[BagResult],
        about: Mapping[str, Any],
    ) -> None:
        """Write the tables and `fleet.json`.

        Args:
            planned: the bags in the order of the rows.
            results: their results, in the same order; read once, so that they need not be in memory.
            about: content of `fleet.json`.
        """
        from pyarrow import parquet

        rows, temporary = zip(planned, results, strict=True), self.folder / f'.{SCORES}.{os.getpid()}.part'
        calibrations: list[dict[str, Any]] = []
        try:
            with parquet.ParquetWriter(temporary, _score_schema(), compression='zstd') as writer:
                while part := list(itertools.islice(rows, ROWS_AT_A_TIME)):
                    calibrations += [_calibration(item, result) for item, result in part]
                    writer.write_table(_score_table(part), row_group_size=ROWS_AT_A_TIME)
            write_parquet(self.folder / CALIBRATIONS, calibration_table(calibrations))
            temporary.replace(self.folder / SCORES)
        finally:
            temporary.unlink(missing_ok=True)
        write_text_atomic(self.folder / ABOUT, json_text(about), overwrite=True)

    def _path(self, bag: str) -> Path:
        name = hashlib.sha256(bag.encode()).hexdigest()[:32]
        return self._results / name[:2] / f'{name}.npz'


def lost() -> BagResult:
    """Return the result of a bag whose result file has disappeared since it was written."""
    return failed('its result was removed while the tables were written', is_final=False)


def calibration_table(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Return rows as a table; a column that is not in `COLUMNS` has the type of its values."""
    import pyarrow

    names = list(dict.fromkeys(itertools.chain(COLUMNS, *rows)))
    columns = {name: [row.get(name) for row in rows] for name in names}
    types = {name: COLUMNS.get(name) or _type_of(columns[name]) for name in names}
    arrays = {
        name: pyarrow.array(
            [None if v is None else str(v) for v in values] if types[name] == TEXT else values,
            type=pyarrow.type_for_alias(types[name]),
        )
        for name, values in columns.items()
    }
    return pyarrow.table(arrays)


def write_parquet(path: Path, table: Any) -> None:
    """Write a table in one step."""
    from pyarrow import parquet

    part = path.parent / f'.{path.name}.{os.getpid()}.part'
    try:
        parquet.write_table(table, part, compression='zstd')
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _calibration(planned: PlannedBag, result: BagResult) -> dict[str, Any]:
    """Return a row: the figures of the bag; a time of the user's table replaces that of the stamps."""
    given = {name: value for name, value in planned.columns.items() if value is not None}
    clashing = set(given) & (set(COLUMNS) - {'time', 'temperature_c'})
    others = {name: value for name, value in given.items() if name not in clashing}
    return {**result.row, **others, 'bag': planned.bag, 'robot': planned.robot}


def _score_schema() -> Any:
    import pyarrow

    text, numbers = pyarrow.string(), pyarrow.list_(pyarrow.float64())
    return pyarrow.schema(
        [('bag', text), ('robot', text), ('names', pyarrow.list_(text)), ('units', pyarrow.list_(text))]
        + [(name, numbers) for name in LISTS]
        + [('cross_information', numbers)]
    )


def _score_table(rows: Sequence[tuple[PlannedBag, BagResult]]) -> Any:
    import pyarrow

    return pyarrow.Table.from_pylist(list(_score_rows(rows)), schema=_score_schema())


def _score_rows(rows: Sequence[tuple[PlannedBag, BagResult]]) -> Iterator[dict[str, Any]]:
    for planned, result in rows:
        scores = result.scores
        if scores is not None:
            yield {
                'bag': planned.bag,
                'robot': planned.robot,
                'names': list(scores.names),
                'units': list(scores.units),
                'value': scores.value,
                'std': scores.std,
                'information': np.diagonal(scores.information),
                'score': scores.score,
                'cross_information': scores.information[np.triu_indices(len(scores.names), 1)],
            }


def _type_of(values: Sequence[Any]) -> str:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return TRUTH
    return NUMBER if kinds and kinds <= {int, float} else TEXT


def _write_bytes(path: Path, content: bytes) -> None:
    part = path.parent / f'.{path.name}.{os.getpid()}.part'
    try:
        path.parent.mkdir(exist_ok=True)
        try:
            part.write_bytes(content)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        todo = 'free some space, then run the same command to continue'
        raise GyrocalError(f'cannot be written ({error.strerror})', where=str(path), todo=todo) from error
