"""The composition root: settings, a sensor model and a source go in, a finished run comes out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config import Config
from gyrocal_ros.data import Rig, Source, Tracking, TruthSample
from gyrocal_ros.ekf.run import Recorder, Run
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.start import Start
from gyrocal_ros.errors import FilterDivergedError, NotObservableError, RecordingError
from gyrocal_ros.model.gyro import SensorModel
from gyrocal_ros.vision.tracker import Tracker

MIN_TURN_RAD = math.radians(45.0)
"""Less turning than this, to and fro, tells nothing of a scale factor."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run has come."""

    done_s: float
    total_s: float


def make_filter(model: SensorModel, config: Config, rig: Rig, start: Start | None = None) -> EkfSlam:
    """The estimator with its tracker, as it runs live and offline."""
    track: Tracking | None = None
    if rig.camera is not None:
        track = Tracker(rig.camera, config.tracker).track
    return EkfSlam(model, config, rig, track, start)


def calibrate(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Run:
    """Run the filter over a source.

    Ground truth in the source goes past the filter into the run.

    Args:
        source: measurements in the order of their stamps.
        config: settings.
        model: the sensor model to estimate.
        start: what an earlier calibration knows.
        report: told of the progress about once a second of recorded time.

    Raises:
        FilterDivergedError: the measurements contradict the model beyond repair.
        NotObservableError: the robot hardly turned, so that no scale factor can be known.
        RecordingError: the source holds nothing to estimate from.
    """
    slam = make_filter(model, config, source.rig, start)
    recorder = Recorder(len(model.coefficients))
    span = source.span
    told_s = 0.0
    try:
        for measurement in source.measurements():
            if isinstance(measurement, TruthSample):
                recorder.add_truth(measurement)
                continue
            for record in slam.step(measurement):
                recorder.add(record)
            done_s = (measurement.t_ns - span.start_ns) / 1e9
            if report is not None and done_s - told_s >= 1.0:
                told_s = done_s
                report(Progress(done_s, span.duration_s))
        for record in slam.finish():
            recorder.add(record)
    except FilterDivergedError as error:
        raise FilterDivergedError(error.what, where=source.name, todo=error.todo) from error
    run = Run(
        source=source.name,
        span=span,
        rig=source.rig,
        config=config,
        model=model,
        history=recorder.history(),
        state=slam.state,
        truth=recorder.truth(),
        events=recorder.events,
    )
    _require_observable(run)
    return run


def _require_observable(run: Run) -> None:
    """A scale factor needs turns, and something else than the gyro that saw them."""
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
            todo='record the ceiling camera uncovered, or name a `--heading-reference`',
        )
    turned_rad = float(np.abs(history.turn_rad[history.resting == 0]).sum())
    if turned_rad < MIN_TURN_RAD:
        raise NotObservableError(
            f'no turns: {math.degrees(turned_rad):.0f} deg in all, so the scale factor cannot be known',
            where=run.source,
            todo='record two full turns each way while the camera sees the ceiling',
        )
