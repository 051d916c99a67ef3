"""Texts and tables of the page, from the state of a session."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

from dash import html

from gyrocal_ros.diagnose.advice import RECORD, join
from gyrocal_ros.diagnose.analysis.candidate_fit import held_out_gain
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect, estimate, estimate_stds
from gyrocal_ros.diagnose.analysis.validation import coefficient_pairs
from gyrocal_ros.diagnose.separability import how_to_tell_apart
from gyrocal_ros.diagnose.series.failure_ranges import Ranges, failure_ranges
from gyrocal_ros.diagnose.status import NextSteps, Status, diagnosis_status, missing_sentence
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.base import Explanation, with_unit
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.report.describe import (
    FAILURE_HEADS,
    NO_FAILURE,
    coefficients_in_words,
    drift_in_words,
    quantity,
    sigma_in_words,
    with_gain,
)
from gyrocal_ros.report.laws import form_in_words, law_in_words, nothing_learned, variable_of
from gyrocal_ros.studio.lesson import error_text
from gyrocal_ros.studio.pictures import drift_deg
from gyrocal_ros.studio.state import Proposal, StudioState
from gyrocal_ros.studio.tasks import Examination

MAX_LISTED = 8
"""Number of effects up to which the significant ones are complemented by others."""
MAX_FAILURES = 8
"""Maximum number of failures in the table."""
ADD = 'Add {name}, and compare the drift.'
ADD_SEVERAL = 'Add {names}, one after the other, and compare the drift.'
ADD_LIMIT = 'Add it, and compare the drift.'
LEARN = 'Press Learn this: it learns what no effect of the library explains.'


@dataclass(frozen=True, slots=True)
class EffectChoice:
    """One effect that may be added."""

    effect: Effect
    ranked: RankedEffect | None
    """None for a limit, which only a run can score, and for a learned law."""
    proposal: Proposal | None = None
    """A law that was learned."""


def choices(state: StudioState) -> list[EffectChoice]:
    """Return what may be added: a learned law, the significant effects, best first, limits, and others."""
    examination, proposal = state.examination, state.proposal
    if examination is None:
        return []
    candidates = [EffectChoice(ranked.effect, ranked) for ranked in examination.examined.ranked]
    candidates.sort(key=lambda one: one.ranked is not examination.best)
    significant = sum(one.ranked is not None and one.ranked.is_significant for one in candidates)
    limits = [EffectChoice(effect, None) for effect in examination.limits]
    law = [] if proposal is None else [EffectChoice(proposal.law.effect, None, proposal)]
    others = candidates[significant : max(significant, MAX_LISTED)]
    return [*law, *candidates[:significant], *limits, *others]


def recording(state: StudioState) -> list[Any]:
    """Return contents and issues of the recording."""
    contents = state.contents
    if contents is None:
        return [html.P('Checking the recording ...')]
    if contents.check is None:
        return [
            html.P(f'A simulated robot cleans for {contents.duration_s:.0f} s, with hidden effects or none.')
        ]
    check = contents.check
    used = [topic for topic in check.topics if topic.role]
    summary = f'{check.duration_s:.0f} s, {len(used)} topics in use of {len(check.topics)}'
    rows = [
        (topic.name, topic.role or 'not used', str(topic.count), _number(topic.rate_hz, '.4g'))
        for topic in check.topics
    ]
    issues = [
        html.Li([html.B(f'{issue.severity}: '), str(issue)], className=str(issue.severity))
        for issue in check.issues
    ]
    return [
        html.P([html.B(summary), ': ' if issues else '; no issues.']),
        html.Ul(issues, className='issues') if issues else None,
        html.Details(
            [html.Summary('Topics'), _table(('topic', 'used as', 'messages', 'Hz'), rows)], id='topics'
        ),
    ]


def failures(state: StudioState) -> list[Any]:
    """Return where the present model fails by more than chance."""
    examination = state.examination
    if examination is None:
        return []
    found = examination.diagnosis.fails_where
    if not found:
        return [html.P(NO_FAILURE)]
    rows = [(item.what, f'{item.sigma:.0f}') for item in found[:MAX_FAILURES]]
    places = [_place(ranges) for ranges in failure_ranges(examination.examined.run, found[:MAX_FAILURES])]
    more = f' and {len(found) - MAX_FAILURES} more' if len(found) > MAX_FAILURES else ''
    return [
        html.Details(
            [
                html.Summary(f'Worst place: {found[0].what}', **places[0]),
                _table(FAILURE_HEADS, rows, places),
                html.P(more) if more else None,
            ]
        )
    ]


def _place(ranges: Ranges) -> dict[str, Any]:
    """Return the attributes of an element that marks a place in all figures while the pointer is on it."""
    return {'data-place': json.dumps(ranges), 'tabIndex': 0}


def status(state: StudioState) -> Status | None:
    """Return what the present model lacks, and the next step; None before the first run has ended."""
    examination = state.examination
    if examination is None:
        return None
    if state.proposal is not None:
        what = next(law_in_words(state.proposal.law))
        return Status('yellow', what, ADD.format(name=state.proposal.name))
    learn = LEARN if state.can_learn else f'{nothing_learned(examination.is_contradicted)} {RECORD}'
    return diagnosis_status(examination.diagnosis, NextSteps(ADD, ADD_SEVERAL, learn, ADD_LIMIT))


def candidate_list(state: StudioState) -> list[Any]:
    """Return a button for each effect that may be added, with a bar: the logarithm of its gain."""
    examination = state.examination
    if examination is None:
        return []
    offered = choices(state)
    longest = max([_log_gain(one) for one in offered] + [1.0])
    return [
        html.Button(
            [
                html.B(_breakable(one.effect.name)),
                html.Span(
                    html.Span(style={'width': f'{100.0 * _log_gain(one) / longest:.0f}%'}), className='bar'
                ),
                html.Span(_strength(one), className='strength'),
            ],
            id={'do': 'choose', 'effect': one.effect.name},
            className='candidate',
        )
        for one in offered
    ]


def _breakable(name: str) -> list[Any]:
    """Return a name that may break after its colon and its dots."""
    parts = re.split(r'(?<=[:._])', name)
    return [item for part in parts for item in (part, html.Wbr())]


def _log_gain(choice: EffectChoice) -> float:
    scored = choice.proposal if choice.ranked is None else choice.ranked.fit
    return 0.0 if scored is None else math.log10(1.0 + max(scored.gain, 0.0))


def _strength(choice: EffectChoice) -> str:
    if choice.proposal is not None:
        return f'learned, +{choice.proposal.gain:.0f}'
    if choice.ranked is None:
        return 'from the readings'
    fit = choice.ranked.fit
    return f'+{max(fit.gain, 0.0):.0f}, {sigma_in_words(fit.sigma)} sigma'


def candidate_card(state: StudioState, chosen: str | None) -> list[Any]:
    """Return the description of one effect that may be added."""
    examination = state.examination
    if examination is None:
        return []
    choice = next((one for one in choices(state) if one.effect.name == chosen), None)
    if choice is None:
        return [html.P('Choose an effect to see its description and its scores.')]
    about: Explanation = find_effect(choice.effect.name).about
    drift = html.Span(_forecast(state, choice.effect.name), id='forecast')
    rows: list[tuple[str, Any]] = [('held-out drift', drift), ('equation', html.Code(about.equation))]
    if choice.ranked is not None:
        rows += _scores(choice.ranked, examination, chosen)
    if choice.proposal is not None:
        rows += _learned(choice.proposal)
    return [
        html.H3(choice.effect.name, id='candidate-name'),
        html.Dl([part for term, value in rows for part in (html.Dt(term), html.Dd(value))]),
        html.P(about.physics, className='physics'),
    ]


def _scores(ranked: RankedEffect, examination: Examination, chosen: str | None) -> list[tuple[str, Any]]:
    found = coefficients_in_words(ranked.effect, estimate(ranked), estimate_stds(ranked))
    gain = held_out_gain(examination.examined.scores, ranked.fit.columns)
    rows: list[tuple[str, Any]] = [
        ('coefficients', found),
        ('log-likelihood', with_gain(ranked.fit.gain, ranked.fit.sigma)),
    ]
    if gain is not None:
        rows.append(('held-out gain', f'{gain:+.1f} on the second half, fitted on the first half only'))
    others = examination.indistinguishable
    if examination.best is not None and chosen == examination.best.effect.name and others:
        advice = ' '.join(how_to_tell_apart(ranked.effect.name, others))
        rows.append(('indistinguishable from', f'{join([*others], "or")}. {advice}'))
    return rows


def _learned(proposal: Proposal) -> list[tuple[str, Any]]:
    """Return what was learned, and its closed forms."""
    law = proposal.law
    rows: list[tuple[str, Any]] = [
        ('learned', next(law_in_words(law))),
        ('log-likelihood', with_gain(proposal.gain, proposal.sigma)),
    ]
    if law.forms:
        listed = html.Ul([html.Li(form_in_words(found)) for found in law.forms], className='forms')
        forms = [f'{variable_of(law)}:', listed]
        rows += [('closed forms', forms), ('usual causes', law.forms[0].means)]
    if law.closest:
        rows.append(('closest in the library', law.closest))
    return rows


def _forecast(state: StudioState, effect: str) -> str:
    """Return the held-out drift before and, if known, after adding an effect."""
    improved, forecast = state.improvement, state.forecast(effect)
    if improved is None or not len(improved.final.held_out.error_rad):
        return 'the recording is too short'
    before = improved.final.held_out.rms_deg
    if forecast is not None:
        return f'from {before:.2f} to {drift_deg(forecast, state):.2f} deg'
    running = state.running
    if running is not None and running.kind == 'forecast' and running.subject == effect:
        return f'now {before:.2f} deg; running in advance, {100.0 * running.progress.fraction:.0f} %'
    return f'now {before:.2f} deg'


def revision_table(state: StudioState) -> list[Any]:
    """Return the revisions with their figures of merit."""
    improved = state.improvement
    if improved is None:
        return []
    rows = [
        (
            one.label,
            'present' if one is improved.final else one.fate,
            drift_in_words(one.held_out),
            drift_in_words(one.fitted),
            with_gain(one.gain, one.gain_sigma) if one.effect is not None else '',
        )
        for one in improved.revisions
    ]
    return [
        _table(('revision', '', 'held out (deg)', 'fitted (deg)', 'gain'), rows),
        html.P(improved.final.why[:1].upper() + improved.final.why[1:] + '.', className='note'),
    ]


def validations(state: StudioState) -> list[Any]:
    """Return the models on other recordings: the drift with the coefficients of this one, and both fits."""
    parts: list[Any] = []
    for recording, models in state.validated.items():
        drifts = [
            (label, drift_in_words(one.drift), drift_in_words(one.fitted)) for label, one in models.items()
        ]
        label, last = list(models.items())[-1]
        coefficients = [
            (
                pair.name,
                quantity(pair.training, pair.training_std, pair.unit),
                quantity(pair.test, pair.test_std, pair.unit),
                f'{pair.sigma:+.1f} sigma' if math.isfinite(pair.sigma) else '',
            )
            for pair in coefficient_pairs(last)
            if not pair.is_zero
        ]
        training = f'training: {state.title}'
        parts += [
            html.H3(f'Drift on {recording} (deg)'),
            _table(('revision', f'{training}; test: {recording}', f'fitted on {recording}'), drifts),
            html.H3(f'Coefficients of {label}'),
            _table(('coefficient', training, f'fitted on {recording}', 'difference'), coefficients),
            html.P('Without those within one standard deviation of zero on both.', className='note'),
        ]
    return parts


def lesson(state: StudioState) -> list[Any]:
    """Return the answer, if it has been revealed."""
    revealed = state.revealed
    if revealed is None:
        return []
    hidden = join([*revealed.hidden]) if revealed.hidden else 'nothing'
    guess_text = {True: 'Your guess was right.', False: 'Your guess was wrong.', None: 'You did not guess.'}
    rows = [
        (
            item.name,
            with_unit(item.truth, item.unit, 6),
            '' if item.estimate is None else with_unit(item.estimate, item.unit, 6),
            error_text(item),
        )
        for item in revealed.coefficients
    ]
    sentences = [f'Hidden: {hidden}.', guess_text[revealed.guessed_right]]
    if revealed.missed:
        sentences.append(missing_sentence(dict.fromkeys(revealed.missed, ())))
    if revealed.superfluous:
        sentences.append(f'In the model but not hidden: {join([*revealed.superfluous])}.')
    heads = ('coefficient', 'truth', 'estimate', 'error')
    return [html.P(' '.join(sentences), id='truth'), _table(heads, rows)]


def _table(
    heads: Sequence[str], rows: Iterable[Sequence[Any]], attributes: Iterable[Mapping[str, Any]] = repeat({})
) -> html.Div:
    body = [
        html.Tr([html.Th(row[0], scope='row'), *(html.Td(cell) for cell in row[1:])], key=str(row[0]), **more)
        for row, more in zip(rows, attributes, strict=False)
    ]
    top = html.Tr([html.Th(head, scope='col') for head in heads])
    return html.Div(html.Table([html.Thead(top), html.Tbody(body)]), className='wide')


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ''
