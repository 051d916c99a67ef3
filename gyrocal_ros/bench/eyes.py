"""Accuracy and consistency from images of difficult scenes: render, track, filter, compare with the truth."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import first_seeds, in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, Frame, Measurement, Rig, Source, Span
from gyrocal_ros.diagnose.analysis.drift import heading_rms_deg
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import EFFECTS, default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.images import after_jpeg
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.image_scenes import find_scene
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.statistics import nis_per_dof

NORMAL_95 = 1.96
"""Half-width of the interval with 95 % of a normal distribution, in standard deviations."""


@dataclass(slots=True, eq=False)
class StoredImages:
    """A simulated recording whose images have been stored as JPEG, with the time that they cost."""

    simulated: SimSource
    frames: int = 0
    spent_s: float = 0.0
    """Processor time of the simulation so far."""

    @property
    def name(self) -> str:
        """Scenario and seed."""
        return self.simulated.name

    @property
    def rig(self) -> Rig:
        """Nominal camera and mounting."""
        return self.simulated.rig

    @property
    def span(self) -> Span:
        """Interval from the first IMU sample to the end."""
        return self.simulated.span

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements."""
        quality = self.simulated.scenario.image_conditions.jpeg_quality
        start_s = time.process_time()
        for measurement in self.simulated.measurements():
            if isinstance(measurement, Frame):
                measurement = replace(measurement, image=after_jpeg(measurement.image, quality))
                self.frames += 1
            self.spent_s += time.process_time() - start_s
            yield measurement
            start_s = time.process_time()


@dataclass(frozen=True, slots=True)
class EyesRun:
    """Result of one scene with one seed."""

    scene: str
    seed: int
    failure: str = ''
    """Why there is no calibration; the other fields are then NaN."""
    scale_error: float = math.nan
    """Relative error of the scale factor."""
    scale_z: float = math.nan
    bias_z: float = math.nan
    """Errors of the scale factor and of the final yaw bias, in standard deviations."""
    heading_rms_deg: float = math.nan
    nis_per_dof: float = math.nan
    converged: bool = False
    features: float = math.nan
    """Mean number of features in an image."""
    render_ms: float = math.nan
    tracker_ms: float = math.nan
    """Processor time per image."""


def eyes(seeds: int, scenes: Sequence[str], seconds: float) -> Iterator[dict[str, Any]]:
    """Yield one row per scene as they become ready, and one for all scenes together.

    Args:
        seeds: number of recordings of each scene.
        scenes: names of scenes.
        seconds: length of a recording.
    """
    first = first_seeds(scenes, seeds)
    tasks = [(scene, first[scene] + k, seconds) for scene in scenes for k in range(seeds)]
    every = []
    for scene, group in groupby(in_parallel(_run_task, tasks), key=lambda run: run.scene):
        runs = list(group)
        every += runs
        yield eyes_row(scene, runs)
    yield eyes_row('all', every)


def model_of(scenario: Scenario) -> SensorModel:
    """Return the default model, and with it the rolling shutter of a camera that has one."""
    model = default_model()
    if scenario.image_conditions.readout_s != 0.0:
        for effect in EFFECTS.values():
            model = with_effect(model, effect) if effect.acts_on == 'shutter' else model
    return model


def run_eyes(scene: str, seed: int, seconds: float) -> EyesRun:
    """Simulate cleaning below a ceiling without hidden effects, and calibrate from the images."""
    scenario = replace(find_scene(scene).applied_to(find_scenario('cleaning')), duration_s=seconds)
    simulated = SimSource(scenario, seed, images=True)
    stored, model = StoredImages(simulated), model_of(scenario)
    try:
        start_s = time.process_time()
        tracked, config = preload(stored, Config(), model)
        tracked_s = time.process_time() - start_s - stored.spent_s
        start_s = time.process_time()
        run = calibrate(tracked, config, model)
        filter_s = time.process_time() - start_s
    except GyrocalError as error:
        return EyesRun(scene, seed, failure=error.what)
    return replace(
        _compared(EyesRun(scene, seed), run, simulated),
        features=_mean_features(tracked),
        render_ms=1e3 * stored.spent_s / stored.frames,
        tracker_ms=1e3 * (tracked_s - filter_s) / stored.frames,
    )


def eyes_row(label: str, runs: Sequence[EyesRun]) -> dict[str, Any]:
    """Return the figures of some recordings.

    scale_rms_percent, scale_max_percent: relative error of the scale factor.
    scale_z_rms, bias_z_rms: errors over their standard deviations, 1 for a consistent filter.
    scale_in_95, bias_in_95: share of errors within 1.96 standard deviations, 0.95 for a consistent filter.
    render_ms, tracker_ms: processor time per image; the tracker's is that of tracker and filter together less
    that of the filter alone.
    """
    good = [run for run in runs if not run.failure]

    def column(name: str) -> Array:
        return np.array([getattr(run, name) for run in good], dtype=float)

    return {
        'scene': label,
        'bags': len(runs),
        'failed': len(runs) - len(good),
        'converged': sum(run.converged for run in runs) / len(runs),
        'scale_rms_percent': _rms(100.0 * column('scale_error')),
        'scale_max_percent': float(np.abs(100.0 * column('scale_error')).max()) if good else None,
        'scale_z_rms': _rms(column('scale_z')),
        'scale_in_95': _mean(np.abs(column('scale_z')) < NORMAL_95),
        'bias_z_rms': _rms(column('bias_z')),
        'bias_in_95': _mean(np.abs(column('bias_z')) < NORMAL_95),
        'heading_rms_deg': _rms(column('heading_rms_deg')),
        'nis_per_dof': _mean(column('nis_per_dof')),
        'features': _mean(column('features')),
        'render_ms': _mean(column('render_ms')),
        'tracker_ms': _mean(column('tracker_ms')),
    }


def _compared(result: EyesRun, run: Run, simulated: SimSource) -> EyesRun:
    """Return the result with the errors of a run."""
    found, truth = conclude(run), simulated.truth
    scale_error = found.scale_factor - truth.scale_factor
    return replace(
        result,
        scale_error=scale_error / truth.scale_factor,
        scale_z=scale_error / found.scale_factor_std,
        bias_z=float((found.values[0] - truth.bias_rad_s[-1, 2]) / found.stds[0]),
        heading_rms_deg=heading_rms_deg(run) or math.nan,
        nis_per_dof=nis_per_dof(run.history.nis, run.history.dof) or math.nan,
        converged=found.converged,
    )


def _mean_features(tracked: Source) -> float:
    seen = [len(item.ids) for item in tracked.measurements() if isinstance(item, FeatureObservations)]
    return float(np.mean(seen))


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _mean(values: np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _run_task(task: tuple[str, int, float]) -> EyesRun:
    return run_eyes(*task)
