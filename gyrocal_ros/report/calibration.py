"""The page about a calibration: verdict, coefficients, figures, model and settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from gyrocal_ros import __version__
from gyrocal_ros.config.declare import to_yaml
from gyrocal_ros.diagnose.analysis.drift import (
    REFERENCES,
    BlindDrift,
    blind_drift,
    calibrated_from_s,
    dead_reckoning,
    heading_error,
)
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit, model_fit
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D, slam_path, truth_path
from gyrocal_ros.diagnose.series.run_series import CONFIDENCE, distances_m, uncorrected, windows
from gyrocal_ros.diagnose.status import calibration_status
from gyrocal_ros.effects.base import shown_in
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.ekf.state.map import ceiling_map
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.pipeline.mount_tilt import mount_tilt
from gyrocal_ros.report import calibration_figures as figures
from gyrocal_ros.report.comparison_figures import drift_by_span
from gyrocal_ros.report.describe import Verdict, events_in_words, meaning, with_std
from gyrocal_ros.report.first_page import first_page
from gyrocal_ros.report.html import Section, details, document, gallery, table, verdict_box, warnings
from gyrocal_ros.report.plot import SIGMAS

CAPTIONS = {
    'scale_factor': """The estimate with its band of three standard deviations, which should contain the true
        value nearly all the time. Bottom: width of that band, and distance of the estimate from its final
        value.""",
    'coefficients': """The bands are three standard deviations. A band that has not narrowed means that this
        recording does not observe the coefficient.""",
    'path': """The gyro paths use gyro and wheels alone from the start to the end, both with the bias found
        here. Crosses mark the ends.""",
    'map': """Features of the ceiling seen from above, at their final estimates. Ellipses are three standard
        deviations, {reach_mm:.0f} mm at the median and so mostly smaller than the marks; a long one is a
        feature whose distance is not known yet.""",
    'distance': """Distance of the paths above from the ground truth, which is aligned in position and heading
        at the first moment.""",
    'blind_drift': """Each mark is a span of {span_s:.0f} s in the later part of the recording, in which the
        gyro works alone with the heading, bias and coefficients that the filter had at its beginning,
        compared with {reference}. Nothing was fitted on what follows.""",
    'heading': """The error should stay inside the band, which is three standard deviations of the heading by
        SLAM.""",
    'heading_alone': """Without ground truth only the standard deviation by the filter can be shown, three
        times.""",
    'bias': """The bias wanders by itself. A bias that follows the temperature needs a sensor model with the
        temperature.""",
    'innovations': """Normalised innovations squared (NIS) over windows of {window_s:.0f} s. A consistent
        filter is within the bounds in {expected:.0%} of the windows; this one is in {inside:.0%}. Far above
        one, the filter is overconfident. Below, where recorded: the features used and rejected, and the
        innovations as headings with the band that the measurement noise alone explains.""",
}


class CoefficientRow(NamedTuple):
    """One row of the table of coefficients."""

    name: str
    value: str
    unit: str
    """Unit of the value and of the prior, each with its standard deviation; degrees in place of rad."""
    prior: str
    meaning: str
    """What the value means; empty where that is plain."""


OTHERS = 2
"""First coefficient without a figure of its own: after bias and scale factor."""


def calibration_page(run: Run, calibration: Calibration, findings: Sequence[tuple[str, str]] = ()) -> str:
    """Return the page as HTML text.

    Args:
        run: a finished run.
        calibration: its result.
        findings: severity and text of the issues of the recording.
    """
    fit = model_fit(run)
    return document(
        f'Gyro calibration of {run.source}',
        f'{calibration.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(conclusion(calibration, run, fit, *_drifts(calibration, run, fit))),
            warnings([*findings, *events_in_words(run)]),
            first_page(run),
            table(
                'Coefficients',
                ('coefficient', 'value', 'unit', 'prior', 'meaning'),
                coefficient_rows(calibration, run.history),
                '± is one standard deviation, here and above.',
            ),
            gallery(calibration_sections(run, calibration)),
            details('Sensor model (model.yaml)', model_to_yaml(run.model)),
            details('Settings (settings.yaml)', to_yaml(run.config)),
        ],
    )


def conclusion(
    calibration: Calibration, run: Run, fit: ModelFit, before: BlindDrift, after: BlindDrift
) -> Verdict:
    """State the result of a calibration.

    Args:
        calibration: the result.
        run: the run that it is from.
        fit: whether the model fits the run.
        before: blind drift of the nominal gyro.
        after: blind drift of the calibrated gyro.
    """
    sentences = [_scale_sentence(calibration), _bias_sentence(calibration)]
    tilt = mount_tilt(run)
    if tilt is not None:
        sentences.append(f'Levelled by gravity, {tilt}; this is corrected.')
    if len(after.error_rad) and (fit.misfits or after.start_s[0] >= (calibration.convergence_time_s or 0.0)):
        spread = 'rms' if len(after.error_rad) > 1 else 'in the only span,'
        sentences.append(
            f'With the camera covered, the heading drifts {after.rms_deg:.3g} deg in {after.span_s:.0f} s '
            f'({spread} against {REFERENCES[after.reference]}; worst {after.max_deg:.3g} deg). '
            f'With the nominal scale factor it was {before.rms_deg:.3g} deg.'
        )
    return Verdict(calibration_status(calibration, run, fit), tuple(sentences))


def coefficient_rows(calibration: Calibration, history: History) -> list[CoefficientRow]:
    """Return bias and coefficients, each with its prior."""
    priors = zip(history.mean[0, YAW_BIAS:], history.std[0, YAW_BIAS:], strict=True)
    found = zip(calibration.names, calibration.values, calibration.stds, calibration.units, strict=True)
    rows = []
    for (name, value, std, unit), (mean, prior_std) in zip(found, priors, strict=True):
        shown, factor = shown_in(unit)
        now, prior = with_std(factor * value, factor * std), with_std(factor * mean, factor * prior_std)
        rows.append(CoefficientRow(name, now, shown, prior, meaning(name, value, std)))
    return rows


def calibration_sections(run: Run, calibration: Calibration) -> Iterator[Section]:
    """Yield the figures of the page that this run has the data for."""
    history = run.history
    yield _section('scale_factor', figures.scale_factor(history, calibration))
    if run.state.coefficient_count > 1:
        yield _section('coefficients', figures.coefficients(run, OTHERS))

    truth, tracks = truth_path(run), _paths(run)
    compared = tracks if truth is None else {'ground truth': truth, **tracks}
    yield _section('path', figures.paths(compared), half=True)
    ceiling = ceiling_map(run.state, run.config.features.parametrisation)
    if len(ceiling.ids):
        reach_mm = 1000.0 * SIGMAS * ceiling.median_std_m
        yield _section('map', figures.ceiling_map(ceiling, tracks['SLAM']), half=True, reach_mm=reach_mm)
    if truth is not None:
        yield _section('distance', figures.distances(*distances_m(tracks, truth)))

    before, after = _drifts(calibration, run, model_fit(run))
    if len(after.error_rad) > 2:
        reference = REFERENCES[after.reference]
        drift = drift_by_span({'nominal gyro': before, 'calibrated gyro': after})
        yield _section('blind_drift', drift, span_s=after.span_s, reference=reference)
    error = heading_error(run)
    yield _section('heading' if error else 'heading_alone', figures.heading(history, error))
    yield _section('bias', figures.bias(history))
    parts = windows(history)
    yield _section(
        'innovations',
        figures.innovations(history, parts),
        window_s=parts.length_s,
        expected=CONFIDENCE,
        inside=parts.share_inside,
    )


def _section(name: str, figure: Any, half: bool = False, **facts: float | str) -> Section:
    return Section(name, figure, CAPTIONS[name].format(**facts), half)


def _drifts(calibration: Calibration, run: Run, fit: ModelFit) -> tuple[BlindDrift, BlindDrift]:
    """Return the blind drift of the nominal and of the calibrated gyro."""
    is_calibrated = calibration.converged and not fit.misfits
    from_s = calibrated_from_s(run, calibration.convergence_time_s if is_calibrated else None)
    return blind_drift(uncorrected(run), from_s=from_s), blind_drift(run, from_s=from_s)


def _paths(run: Run) -> dict[str, Trajectory2D]:
    coefficients, bias = run.state.coefficients, float(run.state.bias_rad_s[2])
    return {
        'SLAM': slam_path(run),
        'calibrated gyro': dead_reckoning(run, coefficients, bias),
        'nominal gyro': dead_reckoning(uncorrected(run), coefficients, bias),
    }


def _scale_sentence(calibration: Calibration) -> str:
    nominal = calibration.nominal_scale_factor_volt
    volt = with_std(calibration.scale_factor_volt, calibration.scale_factor_std * nominal)
    excess = 100.0 * (1.0 / abs(calibration.scale_factor) - 1.0)
    how = f'{abs(excess):.2f} % too {"much" if excess > 0.0 else "little"}'
    if calibration.scale_factor < 0.0:
        how += ', and turns the wrong way round'
    return (
        f'The scale factor is {with_std(calibration.scale_factor, calibration.scale_factor_std)}, that is '
        f'{volt} deg/s/V instead of the nominal {nominal:g}: uncalibrated, the gyro reports {how}.'
    )


def _bias_sentence(calibration: Calibration) -> str:
    bias = with_std(math.degrees(calibration.values[0]), math.degrees(calibration.stds[0]))
    return f'The bias at the end is {bias} deg/s, to be added to the scaled rate.'
