"""The page about models side by side on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.comparison import Comparison, ModelResult
from gyrocal_ros.diagnose.heading_filter import headings
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report import model_series
from gyrocal_ros.report.conclusions import of_comparison
from gyrocal_ros.report.figures import models
from gyrocal_ros.report.figures.models import Mark
from gyrocal_ros.report.html import (
    Section,
    details,
    document,
    gallery,
    meter_table,
    table,
    verdict_box,
    warnings,
)
from gyrocal_ros.report.model_sections import drift_section, heading_section
from gyrocal_ros.report.page import events
from gyrocal_ros.report.series import windows
from gyrocal_ros.report.summary import nis_per_dof
from gyrocal_ros.report.tables import with_gain
from gyrocal_ros.report.words import drift_in_words

FAILURES = 8
CAPTIONS = {
    'drift_by_span': """The same spans one by one; the lines are the rms.""",
    'truth': """The heading by the whole filter, camera and all, less the ground truth.""",
    'failures': """How far beyond chance each model is off, in the places where one of them is worst. A model
        without a mark in a place does not fail there.""",
    'coefficients': """With three standard deviations.""",
    'innovations': """How much measurements differ from predictions, by what the filter expects. Well above
        one the filter is too sure of itself.""",
}


def comparison_page(comparison: Comparison, findings: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page as HTML text.

    Args:
        comparison: of one or more models.
        findings: severity and text of what is odd about the recording.
    """
    run = comparison.results[0].run
    heads = ('model', 'drift (deg)', 'log-likelihood', 'NIS per dof', 'SLAM less truth (deg)', 'fails in')
    note = (
        'Drift is the rms after a minute without the camera, in brackets where it would be found in 90 '
        'of 100 recordings. Log-likelihood: by how much better the recording is foreseen than by '
        f'{comparison.results[0].label}.'
    )
    occurred = {event: None for rival in comparison.results for event in events(rival.run)}
    return document(
        f'Models compared on {run.source}',
        f'{run.span.duration_s:.0f} s recorded, gyrocal {__version__}',
        [
            verdict_box(of_comparison(comparison)),
            warnings([*findings, *occurred]),
            table('Models', heads, [_row(rival, comparison) for rival in comparison.results], note),
            gallery(comparison_sections(comparison)),
            *(_failures(rival) for rival in comparison.results),
            *(
                details(f'Model {rival.label}', model_to_yaml(rival.run.model))
                for rival in comparison.results
            ),
        ],
    )


def _row(rival: ModelResult, comparison: Comparison) -> tuple[str, ...]:
    is_first = rival is comparison.results[0]
    rms_deg = rival.heading_rms_deg
    return (
        rival.label,
        drift_in_words(rival.drift),
        '' if is_first else with_gain(rival.gain, rival.gain_sigma),
        f'{nis_per_dof(rival.run):.2f}',
        'no truth recorded' if rms_deg is None else f'{rms_deg:.3f} rms',
        _places(rival.fails_where),
    )


def _places(failures: Sequence[Failure]) -> str:
    return {0: 'no place', 1: 'one place'}.get(len(failures), f'{len(failures)} places')


def comparison_sections(comparison: Comparison) -> Iterator[Section]:
    """The figures of the page."""
    rivals = comparison.results
    if all(len(rival.drift.error_rad) for rival in rivals):
        drifts = {rival.label: rival.drift for rival in rivals}
        marks = [Mark(label, 'held out', drift) for label, drift in drifts.items()]
        yield drift_section('Drift without the camera', marks, joined=False, half=True)
        yield Section('drift_by_span', models.drift_by_span(drifts), CAPTIONS['drift_by_span'], half=True)
    seen = {rival.label: headings(rival.run) for rival in rivals}
    yield heading_section('Heading by the gyro alone', seen, rivals[0].run.history)
    found = model_series.failures_by_model(rivals)
    if any(found.values()):
        yield Section('failures', models.failures_by_model(found), CAPTIONS['failures'])
    errors = model_series.slam_errors_deg(rivals)
    if errors:
        figure = models.heading_errors('Heading by SLAM less the ground truth', errors)
        yield Section('truth', figure, CAPTIONS['truth'])
    told = model_series.coefficients((rival.label, rival.run, True) for rival in rivals)
    labels = [rival.label for rival in rivals]
    figure = models.coefficients_by_model(told, labels, joined=False)
    yield Section('coefficients', figure, CAPTIONS['coefficients'])
    figure = models.consistency({rival.label: windows(rival.run.history) for rival in rivals})
    yield Section('innovations', figure, CAPTIONS['innovations'])


def _failures(rival: ModelResult) -> str:
    """Where a model fails, against the camera and against the ground truth."""
    heads = ('place, and what would have to be added', 'sigma')
    sets = [(f'Where {rival.label} fails against the camera', rival.fails_where)]
    if rival.fails_by_truth is not None:
        sets.append((f'Where {rival.label} fails against the ground truth', rival.fails_by_truth))
    return ''.join(
        meter_table(title, heads, [(item.what, item.sigma) for item in failures[:FAILURES]], 'Worst first.')
        for title, failures in sets
        if failures
    )
