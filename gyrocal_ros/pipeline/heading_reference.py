"""Fit of another heading reference than the ceiling to the gyro.

An unknown reference may be stamped late, drift, jump, or slip. A fit of its heading to the integrated gyro
shows that, and gives its time offset and its noise, before the filter relies on it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import NS_PER_S, Measurement
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.noise.reference_bank import NoiseFit
from gyrocal_ros.errors import NotObservableError
from gyrocal_ros.pipeline.reference_fit import HeadingTrack, ReferenceFit, fit_bias_walk, fit_noise
from gyrocal_ros.pipeline.reference_readings import (
    MIN_RATE_RAD_S,
    Readings,
    comparable,
    read_headings,
    sharpened,
    smoothed,
    track_at,
    without_repetitions,
)
from gyrocal_ros.pipeline.reference_smoothing import LowPass, find_low_pass
from gyrocal_ros.statistics import robust_std

OFFSETS_S = np.arange(-0.5, 0.501, 0.02)
"""Time offsets that are tried first; the maximum-likelihood fit begins at the best."""
OFFSET_PASSES = 3
"""Maximum-likelihood fits, each near the scale factor and the time offset of the one before."""
TURN_S, TRIMMED_FITS, TRIM_SIGMA = 1.0, 4, 3.0
"""Length of the turns that are compared, and number of fits, each without the outliers of the one before."""
PLAUSIBLE_SCALE = (0.5, 2.0)
"""Bounds of the scale factor of a usable reference."""


@dataclass(frozen=True, slots=True)
class _TurnFit:
    """Fit of scale factor and bias to the turns over a second."""

    scale_factor: float
    bias_rad_s: float
    deviation_rad: float
    """Robust deviation of a turn from the fit."""


def fit_reference(
    measurements: Iterable[Measurement], where: str, config: Config | None = None
) -> ReferenceFit:
    """Fit the reference heading by scale, bias, time offset, heading and noise.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
    """
    config = config or Config()
    readings = read_headings(measurements, where, config)
    coarse = {offset_s: _by_turns(readings, offset_s) for offset_s in OFFSETS_S.tolist()}
    offset_s = min(coarse, key=lambda offset: coarse[offset].deviation_rad)
    scale_factor, bias_rad_s = coarse[offset_s].scale_factor, coarse[offset_s].bias_rad_s
    if -PLAUSIBLE_SCALE[1] <= scale_factor <= -PLAUSIBLE_SCALE[0]:
        raise NotObservableError(
            f'the reference turns opposite to the gyro ({scale_factor:.2f} times as far): the IMU is upside '
            'down, or one of them has the wrong sign',
            where=where,
            todo='publish the mounting of the IMU on /tf_static; headings turn counterclockwise (REP 103)',
        )
    if not PLAUSIBLE_SCALE[0] <= scale_factor <= PLAUSIBLE_SCALE[1]:
        raise NotObservableError(
            f'the reference turns {scale_factor:.2f} times as far as the gyro, so it is unfit as a '
            'heading reference: slipping wheels, or other units',
            where=where,
            todo='give a reference that does not slip',
        )
    gyro, measured = config.gyro, without_repetitions(readings)
    fitted, offset_s = _fit_noise_and_offset(measured, offset_s, (scale_factor, bias_rad_s), gyro)
    estimate = fitted.scale_factor, fitted.bias_rad_s
    smoothing, lag = _low_passes(measured, offset_s, fitted, gyro)
    late_s = 0.0 if smoothing is None else smoothing.time_constant_s
    lag_s = 0.0 if lag is None else lag.time_constant_s
    if late_s or lag_s:
        measured, readings = (sharpened(smoothed(item, late_s), lag_s) for item in (measured, readings))
        fitted, offset_s = _fit_noise_and_offset(measured, offset_s - late_s + lag_s, estimate, gyro)
        estimate = fitted.scale_factor, fitted.bias_rad_s
    track = track_at(readings, offset_s, estimate)
    bias_walk_deg_s = fit_bias_walk(track, fitted, gyro)
    if bias_walk_deg_s > gyro.bias_walk_deg_s:
        # What the bias does would else count as noise of the headings.
        wandering = replace(gyro, bias_walk_deg_s=bias_walk_deg_s)
        fitted, offset_s = _fit_noise_and_offset(measured, offset_s, estimate, wandering)
    return replace(
        _as_fit(fitted, offset_s + late_s, _misfit_rad(track, fitted.jumps_s)),
        time_constant_s=late_s,
        gyro_lag_s=lag_s,
        gyro_lag_std_s=0.0 if lag is None else lag.std_s,
        rest_noise_rad_s=readings.rest_noise_rad_s,
        bias_walk_deg_s=bias_walk_deg_s,
    )


def _low_passes(
    measured: Readings, offset_s: float, fitted: NoiseFit, gyro: GyroConfig
) -> tuple[LowPass | None, LowPass | None]:
    """Return the low pass of the reference and that in the gyro, at most one of them.

    Args:
        measured: gyro and reference.
        offset_s: time offset without a low pass.
        fitted: fit without one.
        gyro: noise of the gyro.
    """
    estimate, readings = (fitted.scale_factor, fitted.bias_rad_s), comparable(measured)

    def behind(time_constant_s: float) -> HeadingTrack:
        return track_at(smoothed(readings, time_constant_s), offset_s - time_constant_s, estimate)

    def ahead(time_constant_s: float) -> HeadingTrack:
        return track_at(sharpened(readings, time_constant_s), offset_s + time_constant_s, estimate)

    smoothing, lag = (find_low_pass(track, fitted.noise, gyro) for track in (behind, ahead))
    if smoothing is not None and lag is not None:
        return (smoothing, None) if smoothing.gain > lag.gain else (None, lag)
    return smoothing, lag


def _fit_noise_and_offset(
    readings: Readings, offset_s: float, estimate: tuple[float, float], gyro: GyroConfig
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
        fitted = fit_noise(track_at(readings, offset_s, estimate), gyro, fitted)
        estimate = fitted.scale_factor, fitted.bias_rad_s
        offset_s += fitted.time_offset_s
    assert fitted is not None
    return fitted, offset_s


def _by_turns(readings: Readings, offset_s: float) -> _TurnFit:
    """Fit scale factor and bias to the turns over a second.

    Few of the turns contain an outlier or a jump of the reference, and those are left out.
    """
    track = track_at(readings, offset_s)
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
