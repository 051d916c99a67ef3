"""The page about an improved model: its revisions, and how the error fell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.analysis.drift import REFERENCES, SPAN_S
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw
from gyrocal_ros.diagnose.search.improvement import Improvement, Revision
from gyrocal_ros.diagnose.series.model_series import coefficients
from gyrocal_ros.diagnose.status import improvement_status
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report.calibration_figures import coefficients as over_time
from gyrocal_ros.report.comparison_figures import (
    Mark,
    coefficients_by_model,
    drift_by_span,
    drift_section,
)
from gyrocal_ros.report.describe import (
    Verdict,
    drift_in_words,
    events_in_words,
    launch_command,
    with_gain,
)
from gyrocal_ros.report.diagnosis_figures import heading_section
from gyrocal_ros.report.first_page import first_page
from gyrocal_ros.report.html import Section, details, document, gallery, table, verdict_box, warnings
from gyrocal_ros.report.laws_figures import law_sections

FITTED = """Fitted: the same spans with the final coefficients; where that is much smaller, the model fits the
    noise of this recording. Hollow marks are revisions that were left out."""
DRIFT_BY_SPAN = 'The held-out spans one by one; the lines are the rms.'
COEFFICIENTS = """With three standard deviations. A coefficient that moves by more than that when an effect is
    added was biased before: it had absorbed a part of the missing effect."""
OVER_TIME = """With the model {label}, and three standard deviations. A constant coefficient stays within the
    band that it had before; a band that has not narrowed means that this recording does not observe it."""
HEADS = ('revision', '', 'held-out drift (deg)', 'fitted drift (deg)', 'predictive gain', 'reason')
NOTE = (
    f'Drift: rms after {SPAN_S:.0f} s without the camera, with its 90 % interval. Predictive gain: '
    'log-likelihood of the recording relative to the revision that it builds on; each measurement is '
    'predicted from those before it.'
)


def improvement_page(
    improved: Improvement,
    findings: Sequence[tuple[str, str]] = (),
    laws: Sequence[LearnedLaw] = (),
) -> str:
    """Return the page as HTML text.

    Args:
        improved: all revisions.
        findings: severity and text of the issues of the recording.
        laws: learned effects of the final model.
    """
    run = improved.final.examined.run
    return document(
        f'Improved model of {run.source}',
        f'{run.span.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(conclusion(improved)),
            warnings([*findings, *events_in_words(run)]),
            first_page(run),
            table('Revisions', HEADS, [_row(revision) for revision in improved.revisions], NOTE),
            gallery(improvement_sections(improved, laws)),
            details('Final sensor model (model.yaml)', model_to_yaml(run.model)),
        ],
    )


def conclusion(improved: Improvement) -> Verdict:
    """State what was added, and how far the error fell."""
    first, final = improved.kept[0], improved.final
    before, after = drift_in_words(first.held_out), drift_in_words(final.held_out)
    against = f'rms on held-out spans against {REFERENCES[improved.drift_reference]}'
    drifts = f'With the camera covered for {SPAN_S:.0f} s the heading drifts'
    tried = [
        f'{revision.effect.name} was tried and {revision.why}.'
        for revision in improved.revisions
        if revision.effect is not None and not revision.is_kept
    ]
    if not len(first.held_out.error_rad):
        result = f'The recording is too short for a drift over {SPAN_S:.0f} s that is held out.'
    elif final is first:
        result = f'{drifts} {before} deg ({against}).'
    else:
        result = f'{drifts} {after} deg; before, it was {before} deg ({against}).'
    if final is first:
        return Verdict(improvement_status(improved), (result, *tried))
    todo = f'Give the robot the new model; in this folder: {launch_command("$PWD")}'
    return Verdict(improvement_status(improved), (result, *tried), (todo,))


def _row(revision: Revision) -> tuple[str, ...]:
    return (
        revision.label,
        revision.fate,
        drift_in_words(revision.held_out),
        drift_in_words(revision.fitted),
        with_gain(revision.gain, revision.gain_sigma) if revision.effect is not None else '',
        revision.why,
    )


def improvement_sections(improved: Improvement, laws: Sequence[LearnedLaw] = ()) -> Iterator[Section]:
    """Yield the figures of the page, those of learned laws first."""
    yield from law_sections(laws)
    revisions, final = improved.revisions, improved.final
    if all(len(revision.held_out.error_rad) for revision in revisions):
        marks = drift_marks(improved)
        yield drift_section('Drift without the camera, revision by revision', marks, more=FITTED)
    first = improved.kept[0]
    shown = {revision.label: revision.examined.seen for revision in dict.fromkeys((first, final))}
    yield heading_section('Heading by the gyro alone', shown, final.examined.run.history)
    if final is not first and len(final.held_out.error_rad):
        drifts = {revision.label: revision.held_out for revision in improved.kept}
        yield Section('drift_by_span', drift_by_span(drifts), DRIFT_BY_SPAN)
    estimates = coefficients(
        (revision.label, revision.examined.run, revision.is_kept) for revision in revisions
    )
    labels = [revision.label for revision in revisions]
    yield Section('coefficients', coefficients_by_model(estimates, labels), COEFFICIENTS)
    yield Section('over_time', over_time(final.examined.run), OVER_TIME.format(label=final.label))


def drift_marks(improved: Improvement) -> list[Mark]:
    """Return the held-out and the fitted drift of each revision."""
    return [
        Mark(revision.label, series, drift, revision.is_kept)
        for revision in improved.revisions
        for series, drift in (('held out', revision.held_out), ('fitted', revision.fitted))
    ]
