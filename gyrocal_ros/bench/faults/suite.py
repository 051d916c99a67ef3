"""The cases of the fault suite, their verdicts, and the table."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.bench.faults import bag_bytes, bombs, clouds, contents, documents, streams
from gyrocal_ros.bench.faults.isolated import Outcome, run_isolated
from gyrocal_ros.bench.faults.kills import kill_while_writing
from gyrocal_ros.bench.faults.references import REFERENCE_FAULTS, write_faulty_reference
from gyrocal_ros.bench.faults.semantic import FAULTS, Sized, sized, write_faulty_recording
from gyrocal_ros.bench.faults.serial_line import feed_damaged_line
from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import shipped
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

Command: TypeAlias = Callable[[Sequence[str]], int]
"""The command line: arguments to exit status."""

SCALE_STD = f'{SCALE_FACTOR}_std'

BASE_SEED, BASE_S, IMAGES_S = 7, 25.0, 3.0
"""Seed and length of the recordings that are damaged, without and with images."""
SILENT_SIGMA, SILENT_SHARE = 5.0, 1e-3
"""A converged result is wrong if its error exceeds both: in standard deviations, and relative."""
RECORDINGS = 3
"""Number of recordings for each semantic fault, at most."""


class Verdict(StrEnum):
    """End of one case; the value is the column of the table."""

    REJECTED = 'rejected'
    """Refused in one line that begins with `error`."""
    SURVIVED = 'survived'
    """Done; the result has no scale factor to judge."""
    RIGHT = 'right'
    """Converged to the truth."""
    NOT_CONVERGED = 'not converged'
    WRONG = 'silently wrong'
    """Converged, but to a wrong value."""
    TRACEBACK = 'traceback'
    """Ended by an exception or a signal, or left files that it should not."""
    TIMEOUT = 'timeout'
    """Exceeded the limit of time or memory."""


BAD = (Verdict.WRONG, Verdict.TRACEBACK, Verdict.TIMEOUT)


@dataclass(frozen=True, slots=True)
class Bases:
    """Sound recordings and documents that are damaged, and the true scale factor."""

    folder: Path
    scale_factor: float
    command: Command

    @property
    def bag(self) -> Path:
        """A recording of features."""
        return self.folder / 'features'

    @property
    def images(self) -> Path:
        """A recording of images, too short to calibrate from."""
        return self.folder / 'images'


@dataclass(frozen=True, slots=True)
class Case:
    """One case: its kind, a label by which it can be repeated, and a function that judges it."""

    kind: str
    label: str
    judge: Callable[[Bases, Path], tuple[Verdict, str]]


def judged(outcome: Outcome, scale_factor: float) -> tuple[Verdict, str]:
    """Return the verdict on a command, and what it printed on standard error.

    Args:
        outcome: end of the command.
        scale_factor: the truth; NaN if no value is right.
    """
    if outcome.exceeds_limits:
        return Verdict.TIMEOUT, f'{outcome.peak_bytes / 1e6:.0f} MB, status {outcome.status}'
    errors = outcome.errors.strip()
    if 'Traceback' in errors or outcome.status not in (0, 2):
        return Verdict.TRACEBACK, errors or f'status {outcome.status}'
    if outcome.status == 2:
        one_line = ' error: ' in f' {errors}' and '\n' not in errors.split(' error: ', 1)[1]
        return (Verdict.REJECTED if one_line else Verdict.TRACEBACK), errors
    try:
        result = json.loads(outcome.output)
    except ValueError:
        return Verdict.SURVIVED, errors
    if SCALE_FACTOR not in result:
        return Verdict.SURVIVED, errors
    if not result['converged']:
        return Verdict.NOT_CONVERGED, errors
    error = abs(result[SCALE_FACTOR] - scale_factor)
    limit = max(SILENT_SIGMA * result[SCALE_STD], SILENT_SHARE * abs(scale_factor))
    text = f'{result[SCALE_FACTOR]:.5f} +- {result[SCALE_STD]:.5f}, true {scale_factor:.5f}'
    return (Verdict.RIGHT if error <= limit else Verdict.WRONG), text


# --- kinds ------------------------------------------------------------------------------------------

DamageBag: TypeAlias = Callable[[Random, Path, Path], Path]


def _bag_case(damage: DamageBag, random: Random, bases: Bases, folder: Path) -> tuple[Verdict, str]:
    bag = damage(random, bases.bag, folder)
    command = ['check', str(bag), '--json'] if random.random() < 0.3 else ['replay', str(bag), '--json']
    return judged(run_isolated(partial(bases.command, command)), bases.scale_factor)


def _image_case(random: Random, bases: Bases, folder: Path) -> tuple[Verdict, str]:
    bag = clouds.damage_images(random, bases.images, folder)
    command = random.choice((['check', str(bag)], ['replay', str(bag), '--json']))
    return judged(run_isolated(partial(bases.command, command)), math.nan)


def _document_case(option: str, name: str, random: Random, bases: Bases, folder: Path) -> tuple[Verdict, str]:
    original = bases.folder / name if (bases.folder / name).exists() else shipped(f'config/{name}')
    file = documents.damage_document(random, original, folder)
    command = ['replay', str(bases.bag), '--json', option, str(file)]
    return judged(run_isolated(partial(bases.command, command)), bases.scale_factor)


def _serial_case(random: Random, bases: Bases, folder: Path) -> tuple[Verdict, str]:
    return judged(run_isolated(partial(feed_damaged_line, random)), math.nan)


def _kill_case(random: Random, bases: Bases, folder: Path) -> tuple[Verdict, str]:
    problem = kill_while_writing(random, folder)
    return (Verdict.TRACEBACK if problem else Verdict.SURVIVED), problem


Judge: TypeAlias = Callable[[Random, Bases, Path], tuple[Verdict, str]]
KINDS: dict[str, Judge] = {
    'bag bytes': partial(_bag_case, bag_bytes.damage_bag_file),
    'metadata': partial(_bag_case, bag_bytes.damage_metadata),
    'bombs': partial(_bag_case, bombs.damage_by_bomb),
    'message bytes': partial(_bag_case, contents.damage_cdr),
    'numbers': partial(_bag_case, contents.damage_numbers),
    'stamps': partial(_bag_case, contents.damage_stamps),
    'streams': partial(_bag_case, streams.damage_streams),
    'clouds': partial(_bag_case, clouds.damage_clouds),
    'camera_info': partial(_bag_case, clouds.damage_camera_info),
    'transforms': partial(_bag_case, clouds.damage_transforms),
    'images': _image_case,
    'model.yaml': partial(_document_case, '--model', 'model.yaml'),
    'settings': partial(_document_case, '--config', 'gyrocal.yaml'),
    'calibration': partial(_document_case, '--start-from', 'calibration.yaml'),
    'serial': _serial_case,
    'kills': _kill_case,
}
"""Kinds of damage, each of which takes any number of seeds."""
SEMANTIC, REFERENCES, SOUND = 'semantic', 'references', 'sound'


WriteFaulty: TypeAlias = Callable[[str, float, int, Path], tuple[Path, float]]
"""Function from name, size, seed and folder to a recording of wrong sensors and the true scale factor."""


def _semantic_case(
    write: WriteFaulty, name: str, size: float, seed: int, bases: Bases, folder: Path
) -> tuple[Verdict, str]:
    bag, scale_factor = write(name, size, seed, folder)
    outcome = run_isolated(partial(bases.command, ['replay', str(bag), '--json']))
    # A comparison with NaN is false, so a converged result where no value is right counts as wrong.
    return judged(outcome, scale_factor)


def cases(seeds: int, only: Sequence[str] = (), *, quick: bool = False) -> Iterator[Case]:
    """Yield the cases, kind after kind.

    Args:
        seeds: number of cases of each kind of damage is ten times this; also the number of sound recordings,
            and of recordings for each semantic fault, at most `RECORDINGS`.
        only: kinds to run; all if empty.
        quick: two cases of each kind of damage, and none of the long ones.

    Raises:
        GyrocalError: a kind is not known.
    """
    known = (*KINDS, SEMANTIC, REFERENCES, SOUND)
    for name in only:
        if name not in known:
            raise GyrocalError(
                'is not a kind of fault', where=repr(name), todo=f'known are {", ".join(known)}'
            )
    for kind, judge in KINDS.items():
        if not only or kind in only:
            for seed in range(2 if quick else 10 * seeds):
                random = Random(f'{kind} {seed}')
                yield Case(kind, f'seed {seed}', partial(judge, random))
    if quick and not only:
        return
    wrong_sensors: tuple[tuple[str, Mapping[str, Sized], WriteFaulty], ...] = (
        (SEMANTIC, FAULTS, write_faulty_recording),
        (REFERENCES, REFERENCE_FAULTS, write_faulty_reference),
    )
    for kind, table, write in wrong_sensors:
        for name, size in sized(table) if not only or kind in only else ():
            for seed in range(1 if quick else min(seeds, RECORDINGS)):
                yield Case(
                    kind, f'{name} {size:g}, seed {seed}', partial(_semantic_case, write, name, size, seed)
                )
    if not only or SOUND in only:
        for seed in range(seeds):
            yield Case(SOUND, f'seed {seed}', partial(_semantic_case, write_faulty_recording, '', 0.0, seed))


def faults(
    seeds: int, only: Sequence[str], command: Command, *, quick: bool = False, report: Callable[[str], None]
) -> Iterator[dict[str, Any]]:
    """Run the cases and yield a row for each kind.

    Args:
        seeds: see `cases`.
        only: kinds to run; all if empty.
        command: the command line.
        quick: see `cases`.
        report: called with a line about each case that ended badly.
    """
    counts: Counter[Verdict] = Counter()
    kind = ''
    with _bases(command) as bases:
        for case in cases(seeds, only, quick=quick):
            if case.kind != kind and kind:
                yield _row(kind, counts)
                counts = Counter()
            kind = case.kind
            with tempfile.TemporaryDirectory() as folder:
                verdict, text = case.judge(bases, Path(folder))
            counts[verdict] += 1
            if verdict in BAD:
                report(f'{kind}, {case.label}: {verdict}: {text}')
    yield _row(kind, counts)


def _row(kind: str, counts: Counter[Verdict]) -> dict[str, Any]:
    return {'kind': kind, 'tried': counts.total(), **{str(item): counts[item] for item in Verdict}}


@contextmanager
def _bases(command: Command) -> Iterator[Bases]:
    """Write the recordings and the calibration that are damaged, into a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        bases = Bases(Path(folder), 0.0, command)
        scenario = replace(find_scenario('cleaning'), duration_s=BASE_S)
        source = SimSource(scenario, BASE_SEED)
        _write(source, bases.bag)
        _write(SimSource(replace(scenario, duration_s=IMAGES_S), BASE_SEED, images=True), bases.images)
        result = Path(folder) / 'result'
        outcome = run_isolated(partial(command, ['replay', str(bases.bag), '-o', str(result)]))
        if outcome.status:
            raise GyrocalError(f'the sound recording is refused: {outcome.errors}', where='bench faults')
        os.replace(result / 'calibration.yaml', Path(folder) / 'calibration.yaml')
        yield replace(bases, scale_factor=source.truth.scale_factor)


def _write(source: SimSource, path: Path) -> None:
    with new_bag(path) as bag:
        bag.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
        for sample in source.measurements():
            bag.write(sample)
