"""One pass of the filter over a stream of measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, ClockStep, Measurement, Source, TruthSample, seconds
from gyrocal_ros.ekf.history.run import Recorder, Run
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.visual_slam import VisualSlam


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a run."""

    done_s: float
    total_s: float
    so_far: Callable[[], Run] | None = None
    """Returns the run up to now, as if it ended here; None while nothing is estimated yet."""


Report: TypeAlias = Callable[[Progress], None]


def run_filter(
    source: Source,
    measurements: Iterable[Measurement],
    config: Config,
    model: SensorModel,
    start: Start | None,
    report: Report | None,
    candidates: tuple[Effect, ...],
    follows_changes: bool,
) -> Run:
    """Run the filter once.

    Args:
        source: source of the measurements: its name, rig and span.
        measurements: measurements in the order of their stamps; ground truth bypasses the filter.
        config: settings.
        model: the sensor model to estimate.
        start: result of an earlier calibration.
        report: called with the progress about once a second of recorded time.
        candidates: effects that the model lacks, to collect score statistics of.
        follows_changes: True to follow a scale factor that changes, see `ekf.slam`; False to compare models.

    Raises:
        FilterDivergedError: the measurements contradict the model beyond repair.
    """
    slam = EkfSlam(model, config, source.rig, start, candidates, follows_changes)
    visual = VisualSlam(slam)
    recorder = Recorder(len(model.coefficients), candidates, keeps_features=not follows_changes)
    span, reported_ns = source.span, source.span.start_ns

    def so_far() -> Run:
        return Run(
            source=source.name,
            span=span,
            rig=source.rig,
            config=config,
            model=model,
            history=recorder.history(),
            state=slam.state,
            truth=recorder.truth(),
            events=recorder.events,
            scores=recorder.scores(),
            signal_names=recorder.signal_names,
            features=recorder.features(),
            unfollowed_walk=slam.watch.unfollowed_walk,
        )

    try:
        for measurement in measurements:
            if isinstance(measurement, TruthSample):
                recorder.add_truth(measurement)
                continue
            for record in visual.step(measurement):
                recorder.add(record)
            if isinstance(measurement, ClockStep):
                recorder.add_clock_step(measurement)
            if report is not None and recorder.running_ns(measurement.t_ns) - reported_ns >= NS_PER_S:
                reported_ns = recorder.running_ns(measurement.t_ns)
                report(Progress(seconds(reported_ns - span.start_ns), span.duration_s, so_far))
        for record in visual.finish():
            recorder.add(record)
    except np.linalg.LinAlgError as error:
        todo = 'check the priors of the model and the settings'
        raise FilterDivergedError(f'the numbers overflow ({error})', where=source.name, todo=todo) from error
    except FilterDivergedError as error:
        fault, _, remedy = mounting_fault(so_far()).partition('; ')
        what = f'{error.what}: {fault}' if fault else error.what
        raise FilterDivergedError(what, where=source.name, todo=remedy or error.todo) from error
    return so_far()
