"""The page about several models on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.analysis.comparison import Comparison, ModelResult
from gyrocal_ros.diagnose.analysis.drift import REFERENCES, SPAN_S
from gyrocal_ros.diagnose.analysis.heading_filter import headings
from gyrocal_ros.diagnose.json_summary import nis_per_dof
from gyrocal_ros.diagnose.series.model_series import coefficients, failures_by_model, slam_errors_deg
from gyrocal_ros.diagnose.series.run_series import windows
from gyrocal_ros.diagnose.status import comparison_status
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report import comparison_figures as figures
from gyrocal_ros.report.comparison_figures import Mark, drift_section
from gyrocal_ros.report.describe import (
    FAILURE_HEADS,
    Verdict,
    drift_in_words,
    events_in_words,
    with_gain,
)
from gyrocal_ros.report.diagnosis_figures import heading_section
from gyrocal_ros.report.first_page import first_page
from gyrocal_ros.report.html import (
    Section,
    bar_table,
    details,
    document,
    gallery,
    table,
    verdict_box,
    warnings,
)

MAX_FAILURES = 8
"""Maximum number of failures of each model in the tables."""
CAPTIONS = {
    'drift_by_span': """The same spans one by one; the lines are the rms.""",
    'truth': """The heading by the whole filter, with the camera, less the ground truth.""",
    'failures': """Significance of the errors of each model, in the places where one of them is worst. A model
        without a mark in a place does not fail there.""",
    'coefficients': """With three standard deviations.""",
    'innovations': """Innovations relative to their covariance; far above 1, the filter is overconfident.""",
}


def comparison_page(comparison: Comparison, findings: Sequence[tuple[str, str]] = ()) -> str:
    """Return the page as HTML text.

    Args:
        comparison: one or more models.
        findings: severity and text of the issues of the recording.
    """
    results, run = comparison.results, comparison.results[0].run
    heads = ('model', 'drift (deg)', 'predictive gain', 'NIS per dof', 'SLAM less truth (deg)', 'fails in')
    note = (
        f'Drift: rms after {SPAN_S:.0f} s without the camera, with its 90 % interval. '
        f'Predictive gain: log-likelihood of the recording relative to {results[0].label}; each measurement '
        'is predicted from those before it.'
    )
    occurred = {event: None for result in results for event in events_in_words(result.run)}
    return document(
        f'Models compared on {run.source}',
        f'{run.span.duration_s:.0f} s recorded, gyrocal {__version__}',
        [
            verdict_box(conclusion(comparison)),
            warnings([*findings, *occurred]),
            first_page(comparison.best.run),
            table('Models', heads, [_row(result, results[0]) for result in results], note),
            gallery(comparison_sections(comparison)),
            *(_failures(result) for result in results),
            *(details(f'Model {result.label}', model_to_yaml(result.run.model)) for result in results),
        ],
    )


def conclusion(comparison: Comparison) -> Verdict:
    """State which model is best, and whether that is more than chance."""
    reference = REFERENCES[comparison.drift_reference]
    sentences = [
        f'{result.label}: with the camera covered for {SPAN_S:.0f} s the heading drifts '
        f'{drift_in_words(result.drift)} deg (rms against {reference}).'
        for result in comparison.results
    ]
    sentences += [f'With {label} the filter cannot run: {why}.' for label, why in comparison.diverged.items()]
    return Verdict(comparison_status(comparison), tuple(sentences))


def _row(result: ModelResult, first: ModelResult) -> tuple[str, ...]:
    rms_deg = result.heading_rms_deg
    return (
        result.label,
        drift_in_words(result.drift),
        'reference' if result is first else with_gain(result.gain, result.gain_sigma),
        f'{nis_per_dof(result.run):.2f}',
        'no truth recorded' if rms_deg is None else f'{rms_deg:.3f} rms',
        _places(result),
    )


def _places(result: ModelResult) -> str:
    count = len(result.fails_where)
    return {0: 'no place', 1: 'one place'}.get(count, f'{count} places')


def comparison_sections(comparison: Comparison) -> Iterator[Section]:
    """Yield the figures of the page."""
    results = comparison.results
    if all(len(result.drift.error_rad) for result in results):
        drifts = {result.label: result.drift for result in results}
        marks = [Mark(label, 'held out', drift) for label, drift in drifts.items()]
        yield drift_section('Drift without the camera', marks, joined=False, half=True)
        yield _section('drift_by_span', figures.drift_by_span(drifts), half=True)
    seen = {result.label: headings(result.run) for result in results}
    yield heading_section('Heading by the gyro alone', seen, results[0].run.history)
    found = failures_by_model(results)
    if any(found.values()):
        yield _section('failures', figures.failures_by_model(found))
    errors = slam_errors_deg(results)
    if errors:
        yield _section('truth', figures.heading_errors('Heading by SLAM less the ground truth', errors))
    estimates = coefficients((result.label, result.run, True) for result in results)
    labels = [result.label for result in results]
    yield _section('coefficients', figures.coefficients_by_model(estimates, labels, joined=False))
    parts = {result.label: windows(result.run.history) for result in results}
    yield _section('innovations', figures.consistency(parts))


def _section(name: str, figure: object, half: bool = False) -> Section:
    return Section(name, figure, CAPTIONS[name], half)


def _failures(result: ModelResult) -> str:
    """Return tables of the failures against the camera and against the ground truth."""
    sets = [(f'Where {result.label} fails against the camera', result.fails_where)]
    if result.fails_by_truth is not None:
        sets.append((f'Where {result.label} fails against the ground truth', result.fails_by_truth))
    return ''.join(
        bar_table(
            title,
            FAILURE_HEADS,
            [(item.what, item.sigma) for item in failures[:MAX_FAILURES]],
            'Worst first.',
        )
        for title, failures in sets
        if failures
    )
