"""The page about an improved model: the error falling, revision by revision."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.improvement import Improvement, Revision
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report import model_series
from gyrocal_ros.report.conclusions import of_improvement
from gyrocal_ros.report.figures import models
from gyrocal_ros.report.figures.models import Mark
from gyrocal_ros.report.html import Section, details, document, gallery, table, verdict_box, warnings
from gyrocal_ros.report.model_sections import drift_section, heading_section
from gyrocal_ros.report.page import events
from gyrocal_ros.report.tables import with_gain
from gyrocal_ros.report.words import drift_in_words

TRIALS = (
    'Fitted: the same spans with the final coefficients; where that is much smaller, the model learns the '
    'noise of this recording. Hollow marks are trials that were left out.'
)
CAPTIONS = {
    'drift_by_span': """The held-out spans one by one; the lines are the rms.""",
    'coefficients': """With three standard deviations. One that moves by more than that when an effect is
        added was wrong before: it had taken on what the missing effect does.""",
}


def improvement_page(improved: Improvement, findings: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page as HTML text.

    Args:
        improved: all revisions.
        findings: severity and text of what is odd about the recording.
    """
    run = improved.final.examined.run
    rows = [_row(revision) for revision in improved.revisions]
    heads = ('revision', '', 'held-out drift (deg)', 'fitted drift (deg)', 'log-likelihood', 'why')
    note = (
        'Drift is the rms after a minute without the camera, in brackets where it would be found in 90 '
        'of 100 recordings. Log-likelihood: by how much better the recording is foreseen than by what it '
        'builds on.'
    )
    return document(
        f'Improved model of {run.source}',
        f'{run.span.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(of_improvement(improved)),
            warnings([*findings, *events(run)]),
            table('Revisions', heads, rows, note),
            gallery(improvement_sections(improved)),
            details('Final sensor model (model.yaml)', model_to_yaml(run.model)),
        ],
    )


def _row(revision: Revision) -> tuple[str, ...]:
    return (
        revision.label,
        'kept' if revision.is_kept else 'left out',
        drift_in_words(revision.held_out),
        drift_in_words(revision.fitted),
        with_gain(revision.gain, revision.gain_sigma) if revision.effect is not None else '',
        revision.why,
    )


def improvement_sections(improved: Improvement) -> Iterator[Section]:
    """The figures of the page."""
    revisions, final = improved.revisions, improved.final
    if all(len(revision.held_out.error_rad) for revision in revisions):
        marks = [
            Mark(revision.label, series, drift, revision.is_kept)
            for revision in revisions
            for series, drift in (('held out', revision.held_out), ('fitted', revision.fitted))
        ]
        yield drift_section('Drift without the camera, revision by revision', marks, more=TRIALS)
    first = improved.kept[0]
    shown = {revision.label: revision.examined.seen for revision in dict.fromkeys((first, final))}
    yield heading_section('Heading by the gyro alone', shown, final.examined.run.history)
    if final is not first and len(final.held_out.error_rad):
        drifts = {revision.label: revision.held_out for revision in improved.kept}
        yield Section('drift_by_span', models.drift_by_span(drifts), CAPTIONS['drift_by_span'])
    told = model_series.coefficients(
        (revision.label, revision.examined.run, revision.is_kept) for revision in revisions
    )
    labels = [revision.label for revision in revisions]
    yield Section('coefficients', models.coefficients_by_model(told, labels), CAPTIONS['coefficients'])
