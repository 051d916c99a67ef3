"""Calibration: one run of the filter over a source, with settings and a sensor model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.ekf.history.run import Run, RunEvent
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import NotObservableError, RecordingError
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.by_heading import calibrate_by_heading
from gyrocal_ros.pipeline.run_filter import Report, run_filter
from gyrocal_ros.vision.dirty_lens import LIFETIME_S, MANY_MARKS, MANY_MARKS_TEXT

MIN_TURN_RAD = math.radians(45.0)
"""Minimum total turn from which a scale factor can be estimated."""


def calibrate(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None = None,
    report: Report | None = None,
    candidates: tuple[Effect, ...] = (),
    follows_changes: bool = False,
) -> Run:
    """Run the filter over a source.

    Ground truth bypasses the filter and is stored in the run.

    Args:
        source: measurements in the order of their stamps.
        config: settings.
        model: the sensor model to estimate.
        start: result of an earlier calibration.
        report: called with the progress about once a second of recorded time.
        candidates: effects that the model lacks, to collect score statistics of.
        follows_changes: True to follow a scale factor that changes, as on the robot; False to estimate one
            for the whole recording and to keep what compares models, for a diagnosis.

    Raises:
        FilterDivergedError: the measurements contradict the model beyond repair.
        NotObservableError: the robot hardly turned, so the scale factor is not observable.
        RecordingError: the source has no IMU samples to estimate from.
    """
    if source.rig.camera is None:
        run = calibrate_by_heading(source, config, model, start, report, candidates, follows_changes)
    else:
        run = run_filter(
            source, source.measurements(), config, model, start, report, candidates, follows_changes
        )
    _require_observable(run)
    return replace(run, events=(*run.events, *marks_on_lens(run), *_unrecorded_signals(run)))


def marks_on_lens(run: Run) -> Iterator[RunEvent]:
    """Yield an event at the first time at which many features have been found on the lens."""
    history = run.history
    found_s = np.repeat(history.time_s, history.on_lens.astype(int))
    within_s = found_s[MANY_MARKS - 1 :] - found_s[: 1 - MANY_MARKS]
    for index in np.flatnonzero(within_s < LIFETIME_S)[:1] + MANY_MARKS - 1:
        step = int(np.searchsorted(history.time_s, found_s[index]))
        yield RunEvent(int(history.t_ns[step]), MANY_MARKS_TEXT)


def _unrecorded_signals(run: Run) -> Iterator[RunEvent]:
    """Yield an event for each signal that effects of the model require and that was not recorded."""
    recorded = set(run.signal_names)
    if np.isfinite(run.history.temperature_c).any():
        recorded.add(TEMPERATURE)
    for signal, names in followers_by_signal(run.model).items():
        if signal not in recorded:
            text = f'{signal} is not recorded: {", ".join(names)} cannot be estimated'
            yield RunEvent(run.span.start_ns, text)


def _require_observable(run: Run) -> None:
    """Raise an error for a run without turns, or without images and headings."""
    history = run.history
    if len(history.t_ns) == 0:
        raise RecordingError(
            'holds no stretch with IMU samples to work on',
            where=run.source,
            todo='look at it with `gyrocal check`',
        )
    if not np.any(history.dof > 0):
        raise NotObservableError(
            'no image feature and no reference heading could be used',
            where=run.source,
            todo='record the ceiling camera uncovered, with a tracker that keeps the ids of its features, or '
            'name a `--heading-reference`',
        )
    turns_rad = history.turn_rad + history.mean[:, YAW_BIAS] * history.dt_s
    turned_rad = float(np.abs(turns_rad[history.resting == 0]).sum())
    if turned_rad < MIN_TURN_RAD:
        fault, _, remedy = mounting_fault(run).partition('; ')
        raise NotObservableError(
            f'no turns: {math.degrees(turned_rad):.0f} deg in all, so the scale factor cannot be known'
            + (f': {fault}' if fault else ''),
            where=run.source,
            todo=remedy
            or 'record two full turns each way, with the ceiling or the heading reference in view',
        )
