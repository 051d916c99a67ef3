"""A recording in memory, its images tracked or its heading reference fitted once, for several runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ClockStep, Frame, Measurement, Rig, Source, Span, seconds
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.errors import FilterDivergedError, NotObservableError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.heading_reference import fit_reference
from gyrocal_ros.pipeline.reference_fit import ReferenceFit
from gyrocal_ros.pipeline.run_filter import Progress, Report
from gyrocal_ros.pipeline.visual_slam import VisualSlam

MAX_IN_MEMORY_S = 1800.0
"""Maximum duration of a recording that is loaded into memory."""
DIVERGED = (FilterDivergedError, np.linalg.LinAlgError)
"""Errors of a filter that contradicts the measurements."""


@dataclass(frozen=True, slots=True, eq=False)
class InMemorySource:
    """A source whose measurements are in memory."""

    name: str
    rig: Rig
    span: Span
    loaded: Sequence[Measurement]
    reference: ReferenceFit | None = None
    """Fit of the heading reference; None with a camera, and where there is none."""

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements."""
        return iter(self.loaded)


def preload(
    source: Source, config: Config, model: SensorModel, report: Report | None = None
) -> tuple[Source, Config]:
    """Read a source into memory, and track its images or fit its heading reference.

    The filter only guides the tracker. Where it diverges because of what the model lacks, a new one takes its
    place: runs on the features decide whether the model fits.

    Args:
        source: a recording; one longer than `MAX_IN_MEMORY_S` is returned unchanged.
        config: settings.
        model: the sensor model for the filter that guides the tracker.
        report: called with the progress about once a second of recorded time.

    Returns:
        The same recording with features in place of images, and settings with their pixel noise.
    """
    if source.span.duration_s > MAX_IN_MEMORY_S:
        return source, config
    loaded: list[Measurement] = []
    tracked: list[Measurement] = []
    visual: VisualSlam | None = None
    for measurement in _with_progress(source, report):
        if isinstance(measurement, Frame) and visual is None:
            visual = VisualSlam(EkfSlam(model, config, source.rig), tracked.append)
            for earlier in loaded:
                visual.step(earlier)
        if visual is not None:
            try:
                visual.step(measurement)
            except DIVERGED:
                visual.replace_filter(EkfSlam(model, config, source.rig))
        if not isinstance(measurement, Frame):
            loaded.append(measurement)
    if visual is None:
        kept = InMemorySource(source.name, source.rig, source.span, loaded)
        return replace(kept, reference=_fitted(kept, config)), config
    if any(isinstance(measurement, ClockStep) for measurement in loaded):
        return source, config
    with suppress(*DIVERGED):
        visual.finish()
    merged = sorted([*loaded, *tracked], key=attrgetter('t_ns'))
    noise = replace(config.camera, pixel_noise_px=config.tracker.noise_px)
    return InMemorySource(source.name, source.rig, source.span, merged), replace(config, camera=noise)


def known_reference(source: Source) -> ReferenceFit | None:
    """Return the fit of a heading reference that was made with the source; None without one."""
    return source.reference if isinstance(source, InMemorySource) else None


def _fitted(source: Source, config: Config) -> ReferenceFit | None:
    """Return the fit of the heading reference; None with a camera, and without one that can be fitted."""
    if source.rig.camera is None:
        with suppress(NotObservableError):
            return fit_reference(source.measurements(), source.name, config)
    return None


def _with_progress(source: Source, report: Report | None) -> Iterator[Measurement]:
    """Yield the measurements and report the progress about once a second of recorded time."""
    reported_s = 0.0
    for measurement in source.measurements():
        yield measurement
        done_s = seconds(measurement.t_ns - source.span.start_ns)
        if report is not None and done_s - reported_s >= 1.0:
            reported_s = done_s
            report(Progress(done_s, source.span.duration_s))
