"""Calibration against another heading reference than the ceiling.

An unknown reference may be stamped late, drift, jump, or slip. A fit of its heading to the integrated gyro
shows that, and gives its time offset and its noise, before the filter relies on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    ClockStep,
    HeadingSample,
    ImuSample,
    Measurement,
    Source,
)
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.motion import GAP_NS
from gyrocal_ros.ekf.noise.reference_bank import NoiseFit
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import NotObservableError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.reference_events import reference_events
from gyrocal_ros.pipeline.reference_fit import HeadingTrack, ReferenceFit, fit_bias_walk, fit_noise
from gyrocal_ros.pipeline.reference_smoothing import (
    find_time_constant,
    low_passed,
    turned_rad,
    with_true_headings,
)
from gyrocal_ros.pipeline.rests import RestFinder
from gyrocal_ros.pipeline.run_filter import Report, run_filter
from gyrocal_ros.statistics import robust_std

OFFSETS_S = np.arange(-0.5, 0.501, 0.02)
"""Time offsets that are tried first; the maximum-likelihood fit begins at the best."""
OFFSET_PASSES = 3
"""Maximum-likelihood fits, each near the scale factor and the time offset of the one before."""
TURN_S, TRIMMED_FITS, TRIM_SIGMA = 1.0, 4, 3.0
"""Length of the turns that are compared, and number of fits, each without the outliers of the one before."""
MIN_HEADINGS = 10
MIN_TURN_RAD = math.radians(45.0)
"""Smallest sum of turns, to both sides, that can be fitted."""
MIN_RATE_RAD_S = math.radians(2.0)
"""Rate beside the bias from which the robot turns."""
SWING_S = 0.2
"""Time over which rates are averaged for it; swings to and fro are slower."""
PLAUSIBLE_SCALE = (0.5, 2.0)
"""Bounds of the scale factor of a usable reference."""


@dataclass(frozen=True, slots=True)
class _TurnFit:
    """Fit of scale factor and bias to the turns over a second."""

    scale_factor: float
    bias_rad_s: float
    deviation_rad: float
    """Robust deviation of a turn from the fit."""


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Gyro and reference over a recording."""

    imu_s: Array
    rate_rad_s: Array
    turned_rad: Array
    """(i,) integral of the rate."""
    rested_s: Array
    """(i,) time at rest up to each."""
    rest_noise_rad_s: float
    """Density of the noise of the gyro at rest, rad/s/sqrt(Hz)."""
    heading_s: Array
    yaw_rad: Array
    """(n,) as measured, not unwrapped."""


def calibrate_by_heading(
    source: Source,
    config: Config,
    model: SensorModel,
    start: Start | None,
    report: Report | None,
    candidates: tuple[Effect, ...],
    follows_changes: bool,
) -> Run:
    """Calibrate against another heading reference, with its time offset and its noise by maximum likelihood.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
        FilterDivergedError: the measurements contradict the model beyond repair.
    """
    fitted = fit_reference(source.measurements(), source.name, config)
    correction = fitted.time_offset_s, fitted.time_constant_s, fitted.scale_factor
    stream = with_true_headings(source.measurements(), *correction)
    known = with_noise(config, fitted)
    if follows_changes:
        gyro = replace(known.gyro, bias_walk_deg_s=fitted.bias_walk_deg_s)
        known = replace(known, gyro=gyro)
    run = run_filter(source, stream, known, model, start, report, candidates, follows_changes)
    return replace(run, events=(*run.events, *reference_events(fitted, config, source.span, run)))


def with_noise(config: Config, fitted: ReferenceFit) -> Config:
    """Return the settings for a heading reference, with the noise of a fit.

    Its random walk is that of gyro and reference together, which the headings cannot tell apart.
    """
    walk_deg = math.degrees(fitted.walk_rad)
    gyro_deg = min(config.gyro.rate_noise_deg_s, walk_deg)
    reference = replace(
        config.reference,
        estimate_noise=False,
        heading_noise_deg=math.degrees(fitted.white_rad),
        heading_walk_deg=math.sqrt(walk_deg**2 - gyro_deg**2),
        tail_dof=fitted.tail_dof,
        stamp_noise_s=fitted.stamp_noise_s,
    )
    gyro = replace(config.gyro, rate_noise_deg_s=gyro_deg)
    rest = replace(config.rest, rate_noise_deg_s=math.degrees(fitted.rest_noise_rad_s))
    return replace(for_reference(config), gyro=gyro, rest=rest, reference=reference)


def for_reference(config: Config) -> Config:
    """Return the settings for a heading reference that is learned while running, on the robot."""
    return replace(
        config,
        reference=replace(config.reference, estimate_noise=True),
        # The noise is estimated from all headings, so a calm end with small innovations says nothing.
        convergence=replace(config.convergence, scale_std=config.convergence.heading_scale_std, nis_low=0.0),
    )


def fit_reference(
    measurements: Iterable[Measurement], where: str, config: Config | None = None
) -> ReferenceFit:
    """Fit the reference heading by scale, bias, time offset, heading and noise.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
    """
    config = config or Config()
    readings = _read(measurements, where, config)
    coarse = {offset_s: _by_turns(readings, offset_s) for offset_s in OFFSETS_S.tolist()}
    offset_s = min(coarse, key=lambda offset: coarse[offset].deviation_rad)
    scale_factor, bias_rad_s = coarse[offset_s].scale_factor, coarse[offset_s].bias_rad_s
    if not PLAUSIBLE_SCALE[0] <= scale_factor <= PLAUSIBLE_SCALE[1]:
        raise NotObservableError(
            f'the reference turns {scale_factor:.2f} times as far as the gyro, so it is unfit as a '
            'heading reference: slipping wheels, or other units',
            where=where,
            todo='give a reference that does not slip',
        )
    gyro, measured = config.gyro, _without_repetitions(readings)
    fitted, offset_s = _fit_noise_and_offset(measured, offset_s, (scale_factor, bias_rad_s), gyro)
    estimate = fitted.scale_factor, fitted.bias_rad_s

    def behind(time_constant_s: float) -> HeadingTrack:
        return _track(_smoothed(measured, time_constant_s), offset_s - time_constant_s, estimate)

    time_constant_s = find_time_constant(behind, fitted.noise, gyro)
    if time_constant_s > 0.0:
        measured, readings = _smoothed(measured, time_constant_s), _smoothed(readings, time_constant_s)
        fitted, offset_s = _fit_noise_and_offset(measured, offset_s - time_constant_s, estimate, gyro)
        estimate = fitted.scale_factor, fitted.bias_rad_s
    track = _track(readings, offset_s, estimate)
    bias_walk_deg_s = fit_bias_walk(track, fitted, gyro)
    if bias_walk_deg_s > gyro.bias_walk_deg_s:
        # What the bias does would else count as noise of the headings.
        wandering = replace(gyro, bias_walk_deg_s=bias_walk_deg_s)
        fitted, offset_s = _fit_noise_and_offset(measured, offset_s, estimate, wandering)
    return replace(
        _as_fit(fitted, offset_s + time_constant_s, _misfit_rad(track, fitted.jumps_s)),
        time_constant_s=time_constant_s,
        rest_noise_rad_s=readings.rest_noise_rad_s,
        bias_walk_deg_s=bias_walk_deg_s,
    )


def _fit_noise_and_offset(
    readings: _Readings, offset_s: float, estimate: tuple[float, float], gyro: GyroConfig
) -> tuple[NoiseFit, float]:
    """Return the likeliest noise, and the time offset.

    Args:
        readings: gyro and reference.
        offset_s: time offset, roughly.
        estimate: scale factor and bias (rad/s), roughly.
        gyro: noise of the gyro.
    """
    fitted: NoiseFit | None = None
    for _ in range(OFFSET_PASSES):
        fitted = fit_noise(_track(readings, offset_s, estimate), gyro, fitted)
        estimate = fitted.scale_factor, fitted.bias_rad_s
        offset_s += fitted.time_offset_s
    assert fitted is not None
    return fitted, offset_s


def _smoothed(readings: _Readings, time_constant_s: float) -> _Readings:
    """Return the readings with the turn by the gyro behind a low pass.

    Rests are left out: behind a low pass the noise in them is not that of the gyro.
    """
    turned = low_passed(readings.imu_s, readings.turned_rad, time_constant_s)
    return replace(readings, turned_rad=turned, rested_s=np.zeros(len(turned)))


def _read(measurements: Iterable[Measurement], where: str, config: Config) -> _Readings:
    imu: list[tuple[int, float]] = []
    headings: list[tuple[int, float]] = []
    finder, rests_ns = RestFinder(config), [0]
    stepped_ns = 0
    for sample in measurements:
        rest_ns = finder.add(sample)
        if rest_ns is not None:
            rests_ns += [at_ns - stepped_ns for at_ns in rest_ns]
        if isinstance(sample, ClockStep):
            stepped_ns += sample.step_ns - 2 * PAUSE_NS  # how the robot moved meanwhile is not known
        elif isinstance(sample, ImuSample):
            imu.append((sample.t_ns - stepped_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, HeadingSample):
            headings.append((sample.t_ns - stepped_ns, sample.yaw_rad))
    if len(imu) < 2 or len(headings) < MIN_HEADINGS:
        raise NotObservableError(
            f'only {len(headings)} reference headings beside {len(imu)} IMU samples',
            where=where,
            todo='give a reference that is measured at least once a second',
        )
    start_ns = imu[0][0]
    imu_s, rate = _columns(imu, start_ns)
    heading_s, yaw = _columns(headings, start_ns)
    turned = turned_rad(imu_s, rate)
    if _turned_to_and_fro_rad(imu_s, turned) < MIN_TURN_RAD:
        raise NotObservableError(
            'no turns, so the scale factor cannot be known', where=where, todo='record two turns each way'
        )
    edges_s = (np.array(rests_ns) - start_ns) / NS_PER_S
    rested_s = np.cumsum(np.diff(edges_s, prepend=edges_s[0]) * (np.arange(len(edges_s)) % 2 == 0))
    return _Readings(
        imu_s, rate, turned, np.interp(imu_s, edges_s, rested_s), finder.noise_rad_s, heading_s, yaw
    )


def _without_repetitions(readings: _Readings) -> _Readings:
    """Return the readings without headings that repeat the one before exactly, which are no measurements."""
    is_new = np.diff(readings.yaw_rad, prepend=math.nan) != 0.0
    return replace(readings, heading_s=readings.heading_s[is_new], yaw_rad=readings.yaw_rad[is_new])


def _turned_to_and_fro_rad(imu_s: Array, turned_rad: Array) -> float:
    """Return the sum of the turns to both sides, beside the bias and the noise of the gyro."""
    edges_s = np.arange(imu_s[0], imu_s[-1], SWING_S)
    turns = np.diff(np.interp(edges_s, imu_s, turned_rad))
    turns = np.abs(turns - np.median(turns)) if len(turns) else turns
    return float(turns[turns > MIN_RATE_RAD_S * SWING_S].sum())


def _track(readings: _Readings, offset_s: float, gyro: tuple[float, float] = (1.0, 0.0)) -> HeadingTrack:
    """Return the headings beside the gyro, at a time offset.

    Headings are unwrapped by the gyro, so that a gap in which the robot turns is no ambiguity.

    Args:
        readings: gyro and reference.
        offset_s: stamp minus true time of the reference.
        gyro: scale factor and bias (rad/s) as far as they are known.
    """
    imu_s, time_s = readings.imu_s, readings.heading_s - offset_s
    inside = (time_s >= imu_s[0]) & (time_s <= imu_s[-1])
    time_s = time_s[inside]
    around = float(np.median(np.diff(imu_s)))
    turned, before, after = (
        np.interp(time_s + shift_s, imu_s, readings.turned_rad) for shift_s in (0.0, -around, around)
    )
    expected = gyro[0] * turned + gyro[1] * time_s
    at_rest = np.diff(readings.rested_s) / np.diff(imu_s)
    rest_turned = np.concatenate([[0.0], np.cumsum(at_rest * np.diff(readings.turned_rad))])
    return HeadingTrack(
        time_s=time_s,
        yaw_rad=expected + np.unwrap(readings.yaw_rad[inside] - expected),
        turned_rad=turned,
        rate_rad_s=(after - before) / (2.0 * around),
        gap_s=np.diff(np.interp(time_s, *_gap_time(imu_s)), prepend=0.0),
        rest_s=_increments(np.interp(time_s, imu_s, readings.rested_s)),
        rest_turn_rad=_increments(np.interp(time_s, imu_s, rest_turned)),
        rest_noise_rad_s=readings.rest_noise_rad_s,
    )


def _increments(values: Array) -> Array:
    """Return the increments (n,) of values; that of the first is zero."""
    return np.diff(values, prepend=values[0])


def _gap_time(imu_s: Array) -> tuple[Array, Array]:
    """Return times and the time in gaps of the IMU up to each."""
    interval_s = np.diff(imu_s)
    in_gaps = np.where(interval_s > GAP_NS / NS_PER_S, interval_s, 0.0)
    return imu_s, np.concatenate([[0.0], np.cumsum(in_gaps)])


def _columns(samples: list[tuple[int, float]], start_ns: int) -> tuple[Array, Array]:
    return (
        np.array([(t_ns - start_ns) / NS_PER_S for t_ns, _ in samples]),
        np.array([value for _, value in samples]),
    )


def _by_turns(readings: _Readings, offset_s: float) -> _TurnFit:
    """Fit scale factor and bias to the turns over a second.

    Few of the turns contain an outlier or a jump of the reference, and those are left out.
    """
    track = _track(readings, offset_s)
    step = max(1, round(TURN_S / float(np.median(np.diff(track.time_s)))))
    by_gyro, by_reference, length_s, in_gaps_s = (
        column[step:] - column[:-step]
        for column in (track.turned_rad, track.yaw_rad, track.time_s, np.cumsum(track.gap_s))
    )
    is_short = (length_s < 2.0 * step * float(np.median(np.diff(track.time_s)))) & (in_gaps_s == 0.0)
    # Encoders err while the robot turns, and not at all at rest: turns are outliers among turns only.
    rate = by_gyro / length_s
    turns = is_short & (np.abs(rate - np.median(rate)) > MIN_RATE_RAD_S)
    groups = [group for group in (turns, is_short & ~turns) if group.any()]
    columns, left = np.stack([by_gyro, length_s], axis=1), is_short
    for _ in range(TRIMMED_FITS):
        solution = np.linalg.lstsq(columns[left], by_reference[left], rcond=None)[0]
        residual = by_reference - columns @ solution
        deviations = [robust_std(residual[group]) for group in groups]
        left = np.any(
            [
                group & (np.abs(residual) <= TRIM_SIGMA * deviation)
                for group, deviation in zip(groups, deviations, strict=True)
            ],
            axis=0,
        )
    return _TurnFit(float(solution[0]), float(solution[1]), deviations[0])


def _misfit_rad(track: HeadingTrack, jumps_s: tuple[float, ...]) -> float:
    """Return the rms of the headings about their best fit by scale factor, bias, heading and known breaks.

    Breaks are the jumps of the reference, and the pauses in which nobody measured the turn.
    """
    since_s = track.time_s - track.time_s[0]
    pauses_s = since_s[track.gap_s > PAUSE_NS / NS_PER_S].tolist()
    breaks = [(since_s >= at_s).astype(float) for at_s in (*jumps_s, *pauses_s)]
    columns = np.stack([track.turned_rad, track.time_s, np.ones(len(since_s)), *breaks], axis=1)
    solution = np.linalg.lstsq(columns, track.yaw_rad, rcond=None)[0]
    return float(np.sqrt(np.mean((track.yaw_rad - columns @ solution) ** 2)))


def _as_fit(fitted: NoiseFit, offset_s: float, residual_rms_rad: float) -> ReferenceFit:
    return ReferenceFit(
        scale_factor=fitted.scale_factor,
        bias_rad_s=fitted.bias_rad_s,
        time_offset_s=offset_s,
        time_offset_std_s=fitted.time_offset_std_s,
        residual_rms_rad=residual_rms_rad,
        white_rad=float(fitted.noise.white_rad),
        walk_rad=float(fitted.noise.walk_rad),
        tail_dof=float(fitted.noise.tail_dof),
        stamp_noise_s=float(fitted.noise.stamp_s),
    )
