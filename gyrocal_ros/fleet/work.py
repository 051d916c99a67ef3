"""The work on one bag: check, replay, diagnose with all candidates, held-out drift."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros import __version__
from gyrocal_ros.bag.check import checked_bag
from gyrocal_ros.config.declare import to_dict
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.candidate_fit import fit
from gyrocal_ros.diagnose.analysis.candidates import ScanBank
from gyrocal_ros.diagnose.analysis.drift import blind_drift, held_out_from_s, reference_heading
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.json_summary import summarise
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.effects.covariate import CovariateBank, covariate_effects
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.effects.registry import load_file, load_installed
from gyrocal_ros.effects.traits import scanned_coefficient, strengths
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.fleet.result import CALIBRATED, BagResult, BagScores, failed
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload


@dataclass(frozen=True, slots=True)
class Job:
    """What is done with every bag; plain values that can be sent to a worker."""

    config: Config
    model: Mapping[str, Any]
    """The sensor model, as in `model.yaml`."""
    effects_from: str | None = None
    """Python file with effects of the user; every worker must be able to read it."""
    remap: Mapping[str, str] | None = None
    namespace: str | None = None
    heading_reference: str | None = None

    def digest(self) -> str:
        """Return a digest of version, settings, model and the user's effects."""
        own = Path(self.effects_from).read_text(encoding='utf-8') if self.effects_from else ''
        topics = [dict(self.remap or {}), self.namespace, self.heading_reference]
        parts = [__version__, to_dict(self.config), dict(self.model), own, topics]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def job_of(config: Config, model: SensorModel, **options: Any) -> Job:
    """Return the job of a sensor model; the options are further fields of `Job`."""
    return Job(config, model_to_dict(model), **options)


def fingerprint(bag: str) -> str:
    """Return a digest of the files of a bag by name, size and time of change, without reading them.

    Raises:
        OSError: the bag does not exist, or its storage cannot be reached.
    """
    from fsspec.core import url_to_fs

    fs, path = url_to_fs(bag)
    files = fs.find(path, detail=True) if fs.isdir(path) else {path: fs.info(path)}
    changes = ('mtime', 'ETag', 'etag', 'LastModified', 'last_modified', 'updated')
    parts = [
        [name, about.get('size'), *(str(about[item]) for item in changes if item in about)]
        for name, about in sorted(files.items())
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def analyse(bag: str, job: Job) -> BagResult:
    """Return the result of one bag; a bag that cannot be used gives a failed result with its reason."""
    try:
        with _local_copy(bag) as path:
            try:
                return _analyse(path, job)
            except GyrocalError as error:
                return failed(str(error).replace(str(path), bag))
            except MemoryError:
                return failed('the worker had too little memory', is_final=False)
            except Exception as error:  # one bag must not end the work on all others
                reason = f'{type(error).__name__}: {error}'.replace(str(path), bag)
                return failed(reason, is_final=False)
    except OSError as error:
        return failed(f'cannot be copied ({error})', is_final=False)


@contextmanager
def _local_copy(bag: str) -> Iterator[Path]:
    """Yield a bag as a local path; a remote one is copied to scratch space and removed afterwards."""
    if '://' not in bag:
        yield Path(bag)
        return
    from fsspec.core import url_to_fs

    fs, path = url_to_fs(bag)
    scratch = Path(tempfile.mkdtemp(prefix='gyrocal-'))
    try:
        copy = scratch / path.rstrip('/').rsplit('/', 1)[-1]
        fs.get(path, str(copy), recursive=True)
        yield copy
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _analyse(path: Path, job: Job) -> BagResult:
    load_installed()
    if job.effects_from:
        load_file(Path(job.effects_from))
    model = model_from_dict(job.model, 'model')
    topics: Any = {
        'remap': dict(job.remap or {}),
        'namespace': job.namespace,
        'heading_reference': job.heading_reference,
    }
    with checked_bag(path, job.config, with_covariates=True, **topics) as checked:
        source, config = preload(checked.source, job.config, model)
    recording = summarise_recording(source)

    def run_filter(wider: SensorModel, candidates: tuple[Effect, ...] = ()) -> Run:
        return calibrate(source, config, wider, candidates=candidates)

    searched = search(model, recording, run_filter)
    if len(searched.first.model.effects) > len(model.effects):
        added = searched.first.model.effects[-1].name
        return failed(f'the filter cannot follow it without {added}; add that to the model')
    run = searched.first.run
    return BagResult(_row(searched, diagnose(searched, recording)), bag_scores(run))


def _row(searched: Search, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the figures of one bag."""
    run = searched.first.run
    summary = summarise(run, conclude(run))
    best = diagnosis.missing[0] if diagnosis.missing else None
    drift = blind_drift(run, reference_heading(run), held_out_from_s(run))
    temperature = run.history.temperature_c
    row: dict[str, Any] = {
        'status': CALIBRATED,
        'reason': '',
        'scale_factor': summary['scale_factor'],
        'scale_factor_std': summary['scale_factor_std'],
        'bias': summary['bias'],
        'bias_std': summary['bias_std'],
        'converged': bool(summary['converged']),
        'model_fits': summary['model_fits'],
        'verdict': diagnosis.verdict,
        'effect': best.effect.name if best else None,
        'effect_sigma': best.sigma if best else None,
        'blind_drift_deg': drift.rms_deg,
        'time': _iso(run.span.start_ns),
        'duration_s': summary['duration_s'],
        'convergence_time_s': summary['convergence_time_s'],
        'nis_per_dof': summary['nis_per_dof'],
        'temperature_c': float(np.nanmean(temperature)) if np.isfinite(temperature).any() else None,
    }
    for name, entry in summary['coefficients'].items():
        if name not in row:
            row |= {name: entry['value'], f'{name}_std': entry['std']}
    return {name: _finite(value) for name, value in row.items()}


def _finite(value: Any) -> Any:
    """Return a plain value; None for a number that is not finite."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _iso(t_ns: int) -> str:
    """Return a stamp as ISO 8601 text in UTC, in whole seconds."""
    return datetime.fromtimestamp(t_ns // NS_PER_S, UTC).strftime('%Y-%m-%dT%H:%M:%SZ')


def bag_scores(run: Run) -> BagScores | None:
    """Sum the score statistics of a run over its blocks; None where no candidates were carried."""
    scores = run.scores
    if scores is None:
        return None
    labels = [label for effect in scores.candidates for label in _labels(effect)]
    return BagScores(
        names=tuple(name for name, _ in labels),
        units=tuple(unit for _, unit in labels),
        information=scores.information.sum(axis=0),
        score=scores.score.sum(axis=0),
        std=_stds(scores),
    )


def _stds(scores: ScoreStatistics) -> Array:
    """Return the standard deviation of each coefficient fitted alone; NaN where it is not excited."""
    stds = np.full(scores.score.shape[1], math.nan)
    for column in range(len(stds)):
        fitted = fit(scores, np.array([column]))
        if fitted is not None:
            stds[column] = math.sqrt(float(fitted.covariance[0, 0]))
    return stds


def _labels(carried: Effect) -> Iterator[tuple[str, str]]:
    """Yield name and unit of each column that the filter carries for an effect.

    Banks, which hold the columns of several effects or of several values of a scan, are resolved.
    """
    if not isinstance(carried, ScanBank):
        for one in covariate_effects(carried.signals) if isinstance(carried, CovariateBank) else [carried]:
            yield from ((f'{one.name}.{item.name}', item.unit) for item in one.coefficients)
        return
    effect, place = carried.effect, scanned_coefficient(carried.effect)
    assert place is not None
    number = carried.name.removeprefix(f'{effect.name} scan ')
    form = '' if number == '1' else f'[{number}]'
    for value in carried.scan.tolist():
        for row in strengths(effect):
            item = effect.coefficients[row]
            yield f'{effect.name}{form}.{item.name}@{value:g}', item.unit
