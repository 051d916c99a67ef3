"""Which figures a report shows, in what order, and what it says below them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gyrocal_ros.diagnose.drift import (
    REFERENCES,
    BlindDrift,
    Trajectory2D,
    dead_reckoning,
    slam_path,
    truth_path,
)
from gyrocal_ros.ekf.map import ceiling_map
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.report import series
from gyrocal_ros.report.figures import calibration as figures
from gyrocal_ros.report.figures.drawing import SIGMAS
from gyrocal_ros.report.figures.models import drift_by_span
from gyrocal_ros.report.html import Section

CAPTIONS = {
    'scale_factor': """The estimate with its band of three standard deviations, which should hold the true
        value nearly all the time. Below, how wide that band is, and how far the estimate still was from
        its final value.""",
    'coefficients': """The bands are three standard deviations; one that has not narrowed means that this
        recording says nothing of the coefficient.""",
    'path': """The gyro paths use gyro and wheels alone from the start to the end, both with the bias found
        here. Crosses mark the ends.""",
    'map': """Features of the ceiling seen from above, as the map holds them at the end. Ellipses are three
        standard deviations, {reach_mm:.0f} mm at the median and so mostly smaller than the marks; a long one
        is a feature whose distance is not known yet.""",
    'distance': """The paths of the figure above against the ground truth, which is aligned in position and
        heading at the first moment.""",
    'blind_drift': """Each mark is a span of {span_s:.0f} s in the later part of the recording, in which the
        gyro is left alone with the heading, bias and coefficients that the filter had at its beginning,
        compared with {reference}: nothing was fitted on what follows.""",
    'heading': """The error should stay inside the band, which is three standard deviations of the heading by
        SLAM.""",
    'heading_alone': """Without ground truth only the filter's own doubt can be shown: three standard
        deviations.""",
    'bias': """The bias moves by itself. One that follows the temperature wants a sensor model that knows of
        the temperature.""",
    'innovations': """Differences between measurement and prediction: their squares by what the filter expects
        (NIS), over windows of {window_s:.0f} s. They should be within the bounds in {expected:.0%} of the
        windows and are in {inside:.0%}; well above one, the filter is too sure of itself. Below, where there
        are any, the features used and rejected, and the differences as a heading, with the band that the
        noise of the measurement alone explains.""",
}


def sections(run: Run, calibration: Calibration, before: BlindDrift, after: BlindDrift) -> Iterator[Section]:
    """Yield the figures that this run has the data for.

    Args:
        run: a finished run.
        calibration: what it has found.
        before: blind drift of the nominal gyro.
        after: blind drift of the calibrated gyro.
    """
    history = run.history
    yield _section('scale_factor', figures.scale_factor(history, calibration))
    if run.state.coefficient_count > 1:
        yield _section('coefficients', figures.coefficients(history, calibration))

    truth, tracks = truth_path(run), _paths(run)
    compared = tracks if truth is None else {'ground truth': truth, **tracks}
    yield _section('path', figures.paths(compared), half=True)
    ceiling = ceiling_map(run.state, run.config.features.parametrisation)
    if len(ceiling.ids):
        reach_mm = 1000.0 * SIGMAS * ceiling.median_std_m
        yield _section('map', figures.ceiling_map(ceiling, tracks['SLAM']), half=True, reach_mm=reach_mm)
    if truth is not None:
        yield _section('distance', figures.distances(*series.distances_m(tracks, truth)))

    if len(after.error_rad) > 2:
        reference = REFERENCES[after.reference]
        drift = drift_by_span({'nominal gyro': before, 'calibrated gyro': after})
        yield _section('blind_drift', drift, span_s=after.span_s, reference=reference)
    error = series.heading_error(run)
    yield _section('heading' if error else 'heading_alone', figures.heading(history, error))
    yield _section('bias', figures.bias(history))
    windows = series.windows(history)
    yield _section(
        'innovations',
        figures.innovations(history, windows),
        window_s=windows.length_s,
        expected=series.CONFIDENCE,
        inside=windows.share_inside,
    )


def _section(name: str, figure: Any, half: bool = False, **facts: float | str) -> Section:
    return Section(name, figure, CAPTIONS[name].format(**facts), half)


def _paths(run: Run) -> dict[str, Trajectory2D]:
    coefficients, bias = run.state.coefficients, float(run.state.bias_rad_s[2])
    return {
        'SLAM': slam_path(run),
        'calibrated gyro': dead_reckoning(run, coefficients, bias),
        'nominal gyro': dead_reckoning(series.uncorrected(run), coefficients, bias),
    }
