"""The composition root: settings, a sensor model and a source go in, a finished run comes out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    ClockStep,
    Frame,
    HeadingSample,
    Measurement,
    Rig,
    Source,
    Span,
    TruthSample,
    seconds,
)
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.ekf.run import Recorder, Run, RunEvent
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.start import Start
from gyrocal_ros.ekf.state import COEFFICIENTS_START, YAW_BIAS
from gyrocal_ros.errors import FilterDivergedError, NotObservableError, RecordingError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.heading_reference import (
    WALKS_DEG,
    ReferenceFit,
    fit_reference,
    log_likelihood,
    on_time,
)
from gyrocal_ros.pipeline.visual_slam import VisualSlam

MAX_MISFIT_DEG = 2.0
"""A heading reference that differs more than this from the best fit of the gyro is no good."""
MIN_TURN_RAD = math.radians(45.0)
"""Less turning than this, to and fro, tells nothing of a scale factor."""
MAX_HELD_S = 1800.0
"""Recordings up to this long are held in memory for those who run the filter several times."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run has come."""

    done_s: float
    total_s: float
    so_far: Callable[[], Run] | None = None
    """The run up to now, as if it ended here; None while nothing is estimated yet."""


@dataclass(frozen=True, slots=True, eq=False)
class InMemorySource:
    """A source whose measurements are in memory."""

    name: str
    rig: Rig
    span: Span
    held: Sequence[Measurement]

    def measurements(self) -> Iterator[Measurement]:
        """Yield them."""
        return iter(self.held)


def calibrate(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None = None,
    report: Callable[[Progress], None] | None = None,
    candidates: tuple[Effect, ...] = (),
) -> Run:
    """Run the filter over a source.

    Ground truth in the source goes past the filter into the run.

    Args:
        source: measurements in the order of their stamps.
        config: settings.
        model: the sensor model to estimate.
        start: what an earlier calibration knows.
        report: told of the progress about once a second of recorded time.
        candidates: effects that the model lacks, to gather evidence of.

    Raises:
        FilterDivergedError: the measurements contradict the model beyond repair.
        NotObservableError: the robot hardly turned, so that no scale factor can be known.
        RecordingError: the source holds nothing to estimate from.
    """
    if source.rig.camera is None:
        run = _calibrate_by_heading(source, config, model, start, report, candidates)
    else:
        run = _run(source, source.measurements(), config, model, start, report, candidates)
    _require_observable(run)
    return replace(run, events=(*run.events, *_unrecorded_signals(run)))


def preload(
    source: Source,
    config: Config,
    model: SensorModel,
    report: Callable[[Progress], None] | None = None,
) -> tuple[Source, Config]:
    """The source, read and its images followed once, however often the filter then runs over it.

    Args:
        source: a recording; one of great length stays where it is.
        config: settings.
        model: the sensor model that helps to follow the images.
        report: told of the progress about once a second of recorded time.

    Returns:
        The same recording with features in place of images, and settings that know their noise.

    Raises:
        FilterDivergedError: the images contradict the model beyond repair.
    """
    if source.span.duration_s > MAX_HELD_S:
        return source, config
    held: list[Measurement] = []
    followed: list[Measurement] = []
    seeing: VisualSlam | None = None
    for measurement in _telling(source, report):
        if isinstance(measurement, Frame) and seeing is None:
            seeing = VisualSlam(EkfSlam(model, config, source.rig), followed.append)
            for earlier in held:
                seeing.step(earlier)
        if seeing is not None:
            seeing.step(measurement)
        if not isinstance(measurement, Frame):
            held.append(measurement)
    if seeing is None:
        return InMemorySource(source.name, source.rig, source.span, held), config
    if any(isinstance(measurement, ClockStep) for measurement in held):
        return source, config
    seeing.finish()
    merged = sorted([*held, *followed], key=attrgetter('t_ns'))
    noise = replace(config.camera, pixel_noise_px=config.tracker.noise_px)
    return InMemorySource(source.name, source.rig, source.span, merged), replace(config, camera=noise)


def _telling(source: Source, report: Callable[[Progress], None] | None) -> Iterator[Measurement]:
    """Yield the measurements and tell about once a second how far they are."""
    reported_s = 0.0
    for measurement in source.measurements():
        yield measurement
        done_s = seconds(measurement.t_ns - source.span.start_ns)
        if report is not None and done_s - reported_s >= 1.0:
            reported_s = done_s
            report(Progress(done_s, source.span.duration_s))


def _run(
    source: Source,
    measurements: Iterable[Measurement],
    config: Config,
    model: SensorModel,
    start: Start | None,
    report: Callable[[Progress], None] | None,
    candidates: tuple[Effect, ...],
) -> Run:
    """One pass of the filter."""
    slam = EkfSlam(model, config, source.rig, start, candidates)
    seeing = VisualSlam(slam)
    recorder = Recorder(len(model.coefficients), candidates)
    span, told_ns = source.span, source.span.start_ns

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
        )

    try:
        for measurement in measurements:
            if isinstance(measurement, TruthSample):
                recorder.add_truth(measurement)
                continue
            for record in seeing.step(measurement):
                recorder.add(record)
            if isinstance(measurement, ClockStep):
                recorder.add_clock_step(measurement)
            if report is not None and recorder.running_ns(measurement.t_ns) - told_ns >= NS_PER_S:
                told_ns = recorder.running_ns(measurement.t_ns)
                report(Progress(seconds(told_ns - span.start_ns), span.duration_s, so_far))
        for record in seeing.finish():
            recorder.add(record)
    except FilterDivergedError as error:
        raise FilterDivergedError(error.what, where=source.name, todo=error.todo) from error
    return so_far()


def _unrecorded_signals(run: Run) -> Iterator[RunEvent]:
    """Effects of the model that follow what was not recorded, and so stay as they were."""
    recorded = set(run.signal_names)
    if np.isfinite(run.history.temperature_c).any():
        recorded.add('temperature')
    for signal, names in followers_by_signal(run.model).items():
        if signal not in recorded:
            text = f'{signal} is not recorded: nothing can be learned of {", ".join(names)}'
            yield RunEvent(run.span.start_ns, text)


def _calibrate_by_heading(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None,
    report: Callable[[Progress], None] | None,
    candidates: tuple[Effect, ...],
) -> Run:
    """Calibrate against another heading reference, whose noise the likelihood tells.

    A reference of unknown make drifts; taken for white, its drift would make the filter far too sure.
    """
    first_look = fit_reference(source.measurements(), source.name)
    stream = [
        on_time(sample, first_look.time_offset_s) if isinstance(sample, HeadingSample) else sample
        for sample in source.measurements()
    ]
    stream.sort(key=attrgetter('t_ns'))
    runs = []
    for walk_deg in WALKS_DEG:
        reference = replace(config.reference, heading_walk_deg=walk_deg)
        runs.append(
            _run(source, stream, replace(config, reference=reference), model, start, report, candidates)
        )
    run = max(runs, key=lambda run: log_likelihood(run.history))
    run = replace(run, events=(*run.events, *_reference_events(first_look, source.span)))
    return _widened(run, first_look.scale_std)


def _widened(run: Run, scale_std: float) -> Run:
    """The run with all its doubts as much larger as the scatter of the reference asks for."""
    history, state = run.history, run.state
    factor = max(1.0, scale_std / float(history.std[-1, COEFFICIENTS_START]))
    return replace(
        run,
        history=replace(history, std=factor * history.std),
        state=replace(state, covariance=factor**2 * state.covariance),
    )


def _reference_events(first_look: ReferenceFit, span: Span) -> Iterator[RunEvent]:
    """What a person should know of the reference."""
    if abs(first_look.time_offset_s) >= 0.02:
        late = 'late' if first_look.time_offset_s > 0.0 else 'early'
        text = (
            f'the reference is stamped {abs(first_look.time_offset_s) * 1e3:.0f} ms too {late}; allowed for'
        )
        yield RunEvent(span.start_ns, text)
    misfit_deg = math.degrees(first_look.residual_rms_rad)
    if misfit_deg > MAX_MISFIT_DEG:
        text = f'the reference does not fit the gyro: {misfit_deg:.1f} deg rms are left over at best'
        yield RunEvent(span.start_ns, text)


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
    turns_rad = history.turn_rad + history.mean[:, YAW_BIAS] * history.dt_s
    turned_rad = float(np.abs(turns_rad[history.resting == 0]).sum())
    if turned_rad < MIN_TURN_RAD:
        raise NotObservableError(
            f'no turns: {math.degrees(turned_rad):.0f} deg in all, so the scale factor cannot be known',
            where=run.source,
            todo='record two full turns each way while the camera sees the ceiling',
        )
