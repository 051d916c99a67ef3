"""The page about a diagnosis: missing effects, scores of all candidates, what is left over."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape

from gyrocal_ros import __version__
from gyrocal_ros.diagnose.advice import advice, grouped
from gyrocal_ros.diagnose.analysis.drift import REFERENCES, SPAN_S, BlindDrift
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.series.error_curves import errors_by_signal
from gyrocal_ros.diagnose.series.search_series import (
    candidate_rows,
    effect_curve,
    held_out_drifts,
    models_that_ran,
)
from gyrocal_ros.diagnose.status import diagnosis_status
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.base import shown_in
from gyrocal_ros.effects.describe import NOT_ESTIMATED
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.report import diagnosis_figures as figures
from gyrocal_ros.report.comparison_figures import Mark, drift_by_span, drift_section
from gyrocal_ros.report.describe import (
    FAILURE_HEADS,
    NO_FAILURE,
    Verdict,
    events_in_words,
    meaning,
    sigma_in_words,
    with_std,
)
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

MAX_STRETCHES = 5
"""Maximum number of stretches of time to mark, the worst ones."""
MAX_FAILURES = 12
"""Maximum number of failures in the table; the others are folded."""
FINAL_MODEL = 'with all effects found'
SCORES = """Left: log-likelihood gain of each effect, were it in the model. Right: its significance by the
    scatter over the recording, whatever the noise settings. A long bar on the left with a short one on the
    right fits only a part of the recording."""
DIAMONDS = """While an effect is missing, effects that resemble it may look significant too. The diamonds show
    their significance with the missing effect in the model: left of the dashed line they are chance."""
CONTRIBUTION = 'By the estimates, with three standard deviations.'
DRIFT_BY_SPAN = """Each mark is a span of {span_s:.0f} s in the later part of the recording, with the
    estimates of its beginning, compared with {reference}. The lines are the rms."""
LEFT_OVER = (
    "Error of the gyro's bias or scale as a free function of each recorded signal, the best explanation "
    'first. The mean is removed; by the rate a straight line, which is the scale factor. The bars are three '
    'standard deviations; where nothing is missing, they reach zero. A signal that changes slowly fits any '
    'error that changes slowly.'
)


def diagnosis_page(searched: Search, diagnosis: Diagnosis, findings: Sequence[tuple[str, str]] = ()) -> str:
    """Return the page as HTML text.

    Args:
        searched: the search.
        diagnosis: its conclusions.
        findings: severity and text of the issues of the recording.
    """
    run = searched.first.run
    return document(
        f'Diagnosis of {run.source}',
        f'{run.span.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}',
        [
            verdict_box(conclusion(diagnosis)),
            warnings([*findings, *events_in_words(run)]),
            first_page(searched.last.run),
            *(_card(item) for item in diagnosis.missing),
            gallery(_sections(searched, diagnosis)),
            gallery(_left_over(searched), 'What is left over', LEFT_OVER),
            _failures(diagnosis.fails_where),
            _not_judged(diagnosis),
            details('Sensor model with the effects found (model.yaml)', model_to_yaml(searched.last.model)),
        ],
    )


def diagnosis_sections(searched: Search, diagnosis: Diagnosis) -> Iterator[Section]:
    """Yield the figures of the page."""
    yield from _sections(searched, diagnosis)
    yield from _left_over(searched)


def conclusion(diagnosis: Diagnosis) -> Verdict:
    """State which effect is missing, why, and what to do."""
    sentences = [*_reasons(diagnosis), *_remarks(diagnosis)]
    return Verdict(diagnosis_status(diagnosis), tuple(sentences), tuple(advice(diagnosis)))


def _reasons(diagnosis: Diagnosis) -> Iterator[str]:
    against = f'rms on held-out spans against {REFERENCES[diagnosis.drift_reference]}'
    for item in diagnosis.missing:
        name = item.effect.name
        about, _, _ = find_effect(name).about.physics.partition('. ')
        reason = 'without it the filter loses the measurements'
        if math.isfinite(item.gain):
            reason = f'log-likelihood +{item.gain:.0f}, {sigma_in_words(item.sigma)} sigma'
        yield f'{name}: {about.rstrip(".")} ({reason}).'
        if math.isfinite(item.drift_before_deg) and math.isfinite(item.drift_after_deg):
            drifts = f'{item.drift_before_deg:.2f} deg without it and {item.drift_after_deg:.2f} deg with it'
            yield f'With the camera covered for {SPAN_S:.0f} s the heading drifts {drifts} ({against}).'


def _remarks(diagnosis: Diagnosis) -> Iterator[str]:
    structure = diagnosis.unexplained
    if structure is not None and diagnosis.verdict != 'unexplained':
        yield f'A small part is left over: {structure.what} ({sigma_in_words(structure.sigma)} sigma).'
    if diagnosis.not_judged:
        count = len(diagnosis.not_judged)
        what = f'{count} effects' if count > 1 else 'one effect'
        yield f'This recording cannot judge {what} of the library; the reasons are at the end.'


def estimate_rows(found: MissingEffect) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, value, unit and meaning of each coefficient of an effect that was found."""
    items = zip(found.effect.coefficients, found.names, found.values, found.stds, strict=True)
    for item, name, value, std in items:
        unit, factor = shown_in(item.unit)
        if std == 0.0:
            yield name, f'{factor * value:.4g}', unit, NOT_ESTIMATED
        elif unit == '1' and found.effect.acts_on == 'gyro':
            yield name, with_std(value, std), '1', f'{with_std(100.0 * value, 100.0 * std)} % of the rate'
        else:
            yield name, with_std(factor * value, factor * std), unit, meaning(name, value, std)


def _card(found: MissingEffect) -> str:
    about = find_effect(found.effect.name).about
    heads = ('coefficient', 'estimate', 'unit', 'meaning')
    return (
        table(f'Missing: {found.effect.name}', heads, estimate_rows(found))
        + f'<p class="physics">{escape(about.physics)}</p>'
        + f'<p class="physics"><b>Equation</b> <code>{escape(about.equation)}</code></p>'
    )


def _sections(searched: Search, diagnosis: Diagnosis) -> Iterator[Section]:
    seen = {name: examined.seen for name, examined in _first_and_last(searched).items()}
    stretches = [failure for failure in diagnosis.fails_where if failure.from_s is not None][:MAX_STRETCHES]
    jump_s = None if diagnosis.unexplained is None else diagnosis.unexplained.at_s
    title = 'Heading by the gyro alone' if diagnosis.verdict == 'nothing_missing' else 'Where the model fails'
    yield figures.heading_section(title, seen, searched.first.run.history, stretches, jump_s)
    rows = candidate_rows(searched, diagnosis)
    has_diamonds = any(row.role == 'found' for row in rows)
    yield Section('evidence', figures.scores(rows), f'{SCORES} {DIAMONDS}' if has_diamonds else SCORES)
    for number, item in enumerate(diagnosis.missing, start=1):
        curve = effect_curve(item)
        if curve is not None:
            figure = figures.contribution(item.effect.name, curve)
            yield Section(f'contribution_{number}', figure, CONTRIBUTION, half=True)
    yield from _drift_sections(held_out_drifts(searched), diagnosis.drift_reference)


def _first_and_last(searched: Search) -> dict[str, ExaminedModel]:
    """Return the first model with which the filter ran, and that with all effects found."""
    (name, first), *more = models_that_ran(searched).items()
    return {name: first, FINAL_MODEL: searched.last} if more else {name: first}


def _left_over(searched: Search) -> Iterator[Section]:
    name, *_ = _first_and_last(searched)
    for number, error in enumerate(errors_by_signal(searched), start=1):
        figure = figures.error_by_signal(error, (name, FINAL_MODEL))
        yield Section(f'left_over_{number}', figure, '', half=True)


def _drift_sections(drifts: Mapping[str, BlindDrift], reference: str) -> Iterator[Section]:
    if not all(len(drift.error_rad) for drift in drifts.values()):
        return
    if len(drifts) > 1:
        marks = [Mark(name, 'held out', drift) for name, drift in drifts.items()]
        yield drift_section('Drift without the camera', marks, half=True)
    span_s = next(iter(drifts.values())).span_s
    caption = DRIFT_BY_SPAN.format(span_s=span_s, reference=REFERENCES[reference])
    yield Section('drift_by_span', drift_by_span(drifts), caption, half=True)


def _failures(failures: Sequence[Failure]) -> str:
    if not failures:
        return f'<h2>Where the model fails</h2><p>{NO_FAILURE}</p>'
    shown = [(failure.what, failure.sigma) for failure in failures[:MAX_FAILURES]]
    more = ''
    if len(failures) > MAX_FAILURES:
        rest = '\n'.join(f'{failure.sigma:5.1f} sigma  {failure.what}' for failure in failures[MAX_FAILURES:])
        more = details(f'{len(failures) - MAX_FAILURES} more', rest)
    note = 'Worst first. Each place is judged alone, so one cause shows in many places.'
    return bar_table('Where the model fails', FAILURE_HEADS, shown, note) + more


def _not_judged(diagnosis: Diagnosis) -> str:
    if not diagnosis.not_judged:
        return '<h2>What cannot be judged</h2><p>Every effect of the library could be judged.</p>'
    rows = [(', '.join(names), why) for why, names in grouped(diagnosis.not_judged).items()]
    return table('What this recording cannot judge', ('effect', 'reason'), rows)
