"""Calibration against another heading reference than the ceiling.

An unknown reference may turn the other way than the gyro, be stamped late, or slip. A least squares fit of
its heading to the integrated gyro shows that before the filter relies on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    HeadingSample,
    ImuSample,
    Measurement,
    Source,
    Span,
    nanoseconds,
)
from gyrocal_ros.ekf.convergence import is_plausible
from gyrocal_ros.ekf.run import History, Run, RunEvent
from gyrocal_ros.ekf.start import Start
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.errors import NotObservableError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.run_filter import Report, run_filter

OFFSETS_S = np.arange(-0.3, 0.3001, 0.01)
"""Time offsets that are tried."""
MIN_TURN_RAD = math.radians(45.0)
"""Smallest range of headings that can be fitted."""
BLOCK_S = 5.0
"""Length of the blocks whose scatter gives the standard deviation of the scale factor."""
WALKS_DEG = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Random walks of the reference, deg/sqrt(s), among which the likelihood chooses."""
MAX_MISFIT_DEG = 2.0
"""Largest rms difference of a usable reference from the best fit of the gyro."""
REPORTED_OFFSET_S = 0.02
"""Smallest time offset that is reported."""


@dataclass(frozen=True, slots=True)
class ReferenceFit:
    """Least squares fit of a heading reference to the gyro over the whole recording."""

    scale_factor: float
    bias_rad_s: float
    time_offset_s: float
    """Stamp of the reference minus true time, positive when it is stamped late."""
    residual_rms_rad: float
    scale_std: float
    """Standard deviation of the scale factor by the scatter of the turns in blocks of 5 s. It is valid if
    errors of the reference do not last longer than a block."""


def calibrate_by_heading(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None,
    report: Report | None,
    candidates: tuple[Effect, ...],
    follows_changes: bool,
) -> Run:
    """Calibrate against another heading reference, with the random walk of the largest likelihood.

    An unknown reference drifts; taken for white noise, its drift would make the filter overconfident.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
        FilterDivergedError: the measurements contradict the model beyond repair.
    """
    fitted = fit_reference(source.measurements(), source.name)
    stream = [
        on_time(sample, fitted.time_offset_s) if isinstance(sample, HeadingSample) else sample
        for sample in source.measurements()
    ]
    stream.sort(key=attrgetter('t_ns'))
    runs = []
    for walk_deg in WALKS_DEG:
        walking = replace(config, reference=replace(config.reference, heading_walk_deg=walk_deg))
        runs.append(run_filter(source, stream, walking, model, start, report, candidates, follows_changes))
    run = max(runs, key=lambda run: log_likelihood(run.history))
    run = replace(run, events=(*run.events, *_reference_events(fitted, source.span)))
    return _widened(run, fitted.scale_std)


def fit_reference(measurements: Iterable[Measurement], where: str) -> ReferenceFit:
    """Fit the reference heading by scale, bias, offset in time and offset in heading.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
    """
    imu: list[tuple[int, float]] = []
    headings: list[tuple[int, float]] = []
    for sample in measurements:
        if isinstance(sample, ImuSample):
            imu.append((sample.t_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, HeadingSample):
            headings.append((sample.t_ns, sample.yaw_rad))
    if len(imu) < 2 or len(headings) < 10:
        raise NotObservableError(
            f'only {len(headings)} reference headings beside {len(imu)} IMU samples', where=where
        )
    start_ns = imu[0][0]
    imu_s, rate = _columns(imu, start_ns)
    heading_s, yaw = _columns(headings, start_ns)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu_s))])
    if np.ptp(np.unwrap(yaw)) < MIN_TURN_RAD and np.ptp(turned) < MIN_TURN_RAD:
        raise NotObservableError(
            'no turns, so the scale factor cannot be known', where=where, todo='record two turns each way'
        )
    yaw = np.unwrap(yaw)
    fits = [_fit(heading_s - offset_s, yaw, imu_s, turned, offset_s) for offset_s in OFFSETS_S]
    best = min(fits, key=lambda fit: fit.residual_rms_rad)
    if not is_plausible(best.scale_factor):
        raise NotObservableError(
            f'the reference turns {best.scale_factor:.2f} times as far as the gyro, so it is unfit as a '
            'heading reference: slipping wheels, or other units',
            where=where,
            todo='give a reference that does not slip',
        )
    return replace(best, scale_std=_scale_std(heading_s - best.time_offset_s, yaw, imu_s, turned))


def on_time(sample: HeadingSample, offset_s: float) -> HeadingSample:
    """Return the sample with its stamp corrected."""
    return replace(sample, t_ns=sample.t_ns - nanoseconds(offset_s))


def log_likelihood(history: History) -> float:
    """Return the log-likelihood of the headings by the filter's innovations, up to a constant."""
    measured = history.dof > 0
    std = history.heading_innovation_std_rad[measured]
    return float(-0.5 * np.sum((history.heading_innovation_rad[measured] / std) ** 2) - np.sum(np.log(std)))


def _columns(samples: list[tuple[int, float]], start_ns: int) -> tuple[Array, Array]:
    return (
        np.array([(t_ns - start_ns) / NS_PER_S for t_ns, _ in samples]),
        np.array([value for _, value in samples]),
    )


def _fit(heading_s: Array, yaw: Array, imu_s: Array, turned: Array, offset_s: float) -> ReferenceFit:
    inside = (heading_s >= imu_s[0]) & (heading_s <= imu_s[-1])
    time_s, yaw = heading_s[inside], yaw[inside]
    columns = np.stack([np.interp(time_s, imu_s, turned), time_s, np.ones(len(time_s))], axis=1)
    solution = np.linalg.lstsq(columns, yaw, rcond=None)[0]
    residual = yaw - columns @ solution
    rms = float(np.sqrt(np.mean(residual**2)))
    return ReferenceFit(float(solution[0]), float(solution[1]), float(offset_s), rms, math.nan)


def _scale_std(heading_s: Array, yaw: Array, imu_s: Array, turned: Array) -> float:
    """Return the standard deviation by the scatter of blocks (HC3, MacKinnon and White 1985)."""
    edges = np.arange(max(heading_s[0], imu_s[0]), min(heading_s[-1], imu_s[-1]), BLOCK_S)
    if len(edges) < 5:
        return math.inf
    by_gyro, by_reference = (
        np.diff(np.interp(edges, imu_s, turned)),
        np.diff(np.interp(edges, heading_s, yaw)),
    )
    columns = np.stack([by_gyro, np.full(len(by_gyro), BLOCK_S)], axis=1)
    inverse = np.linalg.inv(columns.T @ columns)
    residual = by_reference - columns @ (inverse @ columns.T @ by_reference)
    leverage = np.einsum('ij,jk,ik->i', columns, inverse, columns)
    scores = columns * (residual / (1.0 - leverage))[:, None]
    return float(np.sqrt((inverse @ scores.T @ scores @ inverse)[0, 0]))


def _widened(run: Run, scale_std: float) -> Run:
    """Return the run with all standard deviations scaled up to the scatter of the reference."""
    history, state = run.history, run.state
    factor = max(1.0, scale_std / float(history.std[-1, COEFFICIENTS_START]))
    return replace(
        run,
        history=replace(history, std=factor * history.std),
        state=replace(state, covariance=factor**2 * state.covariance),
    )


def _reference_events(fitted: ReferenceFit, span: Span) -> Iterator[RunEvent]:
    """Yield an event for each notable property of the reference."""
    if abs(fitted.time_offset_s) >= REPORTED_OFFSET_S:
        late = 'late' if fitted.time_offset_s > 0.0 else 'early'
        text = (
            f'the reference is stamped {abs(fitted.time_offset_s) * 1e3:.0f} ms too {late}; this is corrected'
        )
        yield RunEvent(span.start_ns, text)
    misfit_deg = math.degrees(fitted.residual_rms_rad)
    if misfit_deg > MAX_MISFIT_DEG:
        text = f'the reference does not fit the gyro: {misfit_deg:.1f} deg rms remain at best'
        yield RunEvent(span.start_ns, text)
