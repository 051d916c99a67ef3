"""Calibration against another heading reference than the ceiling.

A gyro that lags looks to first order like headings that are stamped early. Only how its low pass rounds the
beginning and end of turns tells it from them. Where it is not certain, it counts as time offset.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.ekf.equations.heading import ModelLag
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, with_further_errors
from gyrocal_ros.ekf.state.start import Start, initial_state
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.heading_reference import fit_reference
from gyrocal_ros.pipeline.in_memory import known_reference
from gyrocal_ros.pipeline.reference_events import reference_events
from gyrocal_ros.pipeline.reference_fit import ReferenceFit
from gyrocal_ros.pipeline.reference_smoothing import with_true_headings
from gyrocal_ros.pipeline.run_filter import Report, run_filter


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
    fitted = known_reference(source) or fit_reference(source.measurements(), source.name, config)
    lag = ModelLag.of(model, initial_state(model, config, start))
    # As on the robot, a lag that the model lacks is corrected, and shown to a diagnosis.
    headings = with_true_headings(
        source.measurements(), _beside(fitted, lag), lags=follows_changes and lag is None
    )
    known = with_noise(config, fitted)
    if follows_changes:
        gyro = replace(known.gyro, bias_walk_deg_s=fitted.bias_walk_deg_s)
        known = replace(known, gyro=gyro)
    run = run_filter(source, headings, known, model, start, report, candidates, follows_changes)
    if lag is not None:
        run = _with_offset_unknown(run, fitted, lag)
    return replace(run, events=(*run.events, *reference_events(fitted, config, source.span, run)))


def _beside(fitted: ReferenceFit, lag: ModelLag | None) -> ReferenceFit:
    """Return the fit with the time offset beside the lag of a model, where none was certain."""
    if lag is None or fitted.gyro_lag_s:
        return fitted
    return replace(fitted, time_offset_s=fitted.time_offset_s + lag.mean_s / fitted.scale_factor)


def _with_offset_unknown(run: Run, fitted: ReferenceFit, lag: ModelLag) -> Run:
    """Return a run with the error of the lag that the time offset allows, which is no state of the filter."""
    std_s = fitted.scale_factor * fitted.gyro_lag_std_s if fitted.gyro_lag_s else lag.std_s
    std, place = run.history.std.copy(), COEFFICIENTS_START + lag.index
    std[:, place] = np.hypot(std[:, place], std_s)
    state = with_further_errors(run.state, np.array([place]), std_s)
    return replace(run, state=state, history=replace(run.history, std=std))


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
