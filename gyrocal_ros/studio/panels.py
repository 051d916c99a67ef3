"""The words and tables of the page, from the state of a session."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from dash import html

from gyrocal_ros.diagnose.advice import join
from gyrocal_ros.diagnose.candidate_fit import held_out_gain
from gyrocal_ros.diagnose.ranking import RankedEffect, estimate, estimate_stds
from gyrocal_ros.diagnose.separability import how_to_tell_apart
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.report.describe import (
    NO_FAILURE,
    coefficients_in_words,
    drift_in_words,
    missing_headline,
    sigma_in_words,
    with_gain,
)
from gyrocal_ros.studio.lesson import off_in_words
from gyrocal_ros.studio.pictures import drift_deg
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.worker import Examined

MOST_LISTED = 8
MOST_FAILURES = 8


@dataclass(frozen=True, slots=True)
class EffectChoice:
    """One effect that may be added."""

    effect: Effect
    ranked_effect: RankedEffect | None
    """None for a limit, which only a run can judge."""


def choices(examined: Examined) -> list[EffectChoice]:
    """What may be added, the most telling first: all that is significant, and what comes next."""
    ranked = [EffectChoice(ranked_effect.effect, ranked_effect) for ranked_effect in examined.stage.ranked]
    ranked.sort(key=lambda one: one.ranked_effect is not examined.best)
    certain = sum(one.ranked_effect is not None and one.ranked_effect.is_significant for one in ranked)
    limits = [EffectChoice(effect, None) for effect in examined.limits]
    return [*ranked[:certain], *limits, *ranked[certain : max(certain, MOST_LISTED)]]


def bag(view: StudioState) -> list[Any]:
    """What is in the recording, and what is wrong with it."""
    contents = view.contents
    if contents is None:
        return [html.P('Looking into the recording ...')]
    if contents.check is None:
        return [html.P(f'A simulated robot cleaned for {contents.duration_s:.0f} s. What is odd about it?')]
    check = contents.check
    used = [topic for topic in check.topics if topic.role]
    summary = f'{check.duration_s:.0f} s, {len(used)} topics in use of {len(check.topics)}'
    rows = [
        (topic.name, topic.role or 'not used', str(topic.count), _number(topic.rate_hz, '.4g'))
        for topic in check.topics
    ]
    complaints = [
        html.Li([html.B(f'{issue.severity}: '), str(issue)], className=str(issue.severity))
        for issue in check.issues
    ]
    return [
        html.P([html.B(summary), ' - ' if complaints else '; nothing to complain of.']),
        html.Ul(complaints, className='findings') if complaints else None,
        html.Details(
            [html.Summary('Topics'), _table(('topic', 'used as', 'messages', 'Hz'), rows)], id='topics'
        ),
    ]


def failures(view: StudioState) -> list[Any]:
    """Where the present model is off by more than chance."""
    now = view.examined
    if now is None:
        return []
    found = now.failures
    if not found:
        return [html.P(NO_FAILURE)]
    rows = [(item.what, f'{item.sigma:.0f}') for item in found[:MOST_FAILURES]]
    more = f' and {len(found) - MOST_FAILURES} more' if len(found) > MOST_FAILURES else ''
    return [
        html.Details(
            [
                html.Summary(f'The worst places, in words: {found[0].what}'),
                _table(('place, and what would have to be added', 'sigma'), rows),
                html.P(more) if more else None,
            ]
        )
    ]


def verdict(view: StudioState) -> str:
    """State which effect the present model lacks, in one or two sentences."""
    now = view.examined
    if now is None:
        return ''
    best = now.best
    if best is not None:
        headline = missing_headline({best.effect.name: now.twins})
        return f'{headline} It explains most of what is left ({sigma_in_words(best.fit.sigma)} sigma).'
    otherwise = 'No effect of the library explains more than chance would.'
    if now.limits:
        otherwise = f'The readings suggest a limit: {join([one.name for one in now.limits], "or")}.'
    return missing_headline({}, now.stage.unexplained_structure, otherwise)


def candidate_list(view: StudioState) -> list[Any]:
    """A button for every effect that may be added, with a bar: the logarithm of what it explains."""
    now = view.examined
    if now is None:
        return []
    offered = choices(now)
    most = max([_log_gain(one) for one in offered] + [1.0])
    return [
        html.Button(
            [
                html.B(one.effect.name),
                html.Span(
                    html.Span(style={'width': f'{100.0 * _log_gain(one) / most:.0f}%'}), className='bar'
                ),
                html.Span(_strength(one), className='strength'),
            ],
            id={'do': 'choose', 'effect': one.effect.name},
            className='candidate',
        )
        for one in offered
    ]


def _log_gain(choice: EffectChoice) -> float:
    return 0.0 if choice.ranked_effect is None else math.log10(1.0 + max(choice.ranked_effect.fit.gain, 0.0))


def _strength(choice: EffectChoice) -> str:
    if choice.ranked_effect is None:
        return 'by the readings'
    fit = choice.ranked_effect.fit
    return f'+{max(fit.gain, 0.0):.0f}, {sigma_in_words(fit.sigma)} sigma'


def candidate_card(view: StudioState, chosen: str | None) -> list[Any]:
    """All about one effect that may be added."""
    now = view.examined
    if now is None:
        return []
    choice = next((one for one in choices(now) if one.effect.name == chosen), None)
    if choice is None:
        return [html.P('Choose an effect above to see what it is and what it would do.')]
    about: Explanation = find_effect(choice.effect.name).about
    rows: list[tuple[str, Any]] = [('equation', html.Code(about.equation))]
    if choice.ranked_effect is not None:
        rows += _evidence(choice.ranked_effect, now, chosen)
    rows.append(('held-out drift', html.Span(_forecast(view, choice.effect.name), id='forecast')))
    return [
        html.H3(choice.effect.name, id='candidate-name'),
        html.P(about.physics, className='physics'),
        html.Dl([part for term, what in rows for part in (html.Dt(term), html.Dd(what))]),
    ]


def _evidence(ranked_effect: RankedEffect, examined: Examined, chosen: str | None) -> list[tuple[str, Any]]:
    found = coefficients_in_words(ranked_effect.effect, estimate(ranked_effect), estimate_stds(ranked_effect))
    gain = held_out_gain(examined.stage.scores, ranked_effect.fit.columns)
    rows: list[tuple[str, Any]] = [
        ('coefficients', found),
        ('log-likelihood', with_gain(ranked_effect.fit.gain, ranked_effect.fit.sigma)),
    ]
    if gain is not None:
        rows.append(('on the second half', f'{gain:+.1f} log-likelihood, fitted on the first half alone'))
    if examined.best is not None and chosen == examined.best.effect.name and examined.twins:
        apart = ' '.join(how_to_tell_apart(ranked_effect.effect.name, examined.twins))
        rows.append(('indistinguishable from', f'{join([*examined.twins], "or")}. {apart}'))
    return rows


def _forecast(view: StudioState, effect: str) -> str:
    """What adding the effect would do to the held-out error."""
    improved, ahead = view.improvement, view.forecast(effect)
    if improved is None or not len(improved.final.held_out.error_rad):
        return 'the recording is too short to tell'
    before = improved.final.held_out.rms_deg
    if ahead is not None:
        return f'from {before:.2f} to {drift_deg(ahead, view):.2f} deg'
    doing = view.doing
    if doing is not None and doing.what == 'forecast' and doing.subject == effect:
        return f'now {before:.2f} deg; being tried in advance, {100.0 * doing.advance.part:.0f} %'
    return f'now {before:.2f} deg'


def revision_table(view: StudioState) -> list[Any]:
    """The revisions with their figures of merit."""
    improved = view.improvement
    if improved is None:
        return []
    rows = [
        (
            one.label,
            ('present' if one is improved.final else 'kept') if one.is_kept else 'left out',
            drift_in_words(one.held_out),
            drift_in_words(one.fitted),
            with_gain(one.gain, one.gain_sigma) if one.effect is not None else '',
        )
        for one in improved.revisions
    ]
    return [
        _table(('revision', '', 'held out (deg)', 'fitted (deg)', 'log-likelihood'), rows),
        html.P(improved.final.why[:1].upper() + improved.final.why[1:] + '.', className='note'),
    ]


def lesson(view: StudioState) -> list[Any]:
    """The truth, once it is wanted."""
    told = view.revealed
    if told is None:
        return []
    hidden = join([*told.hidden]) if told.hidden else 'nothing'
    said = {True: 'Your guess was right.', False: 'Your guess was wrong.', None: 'You did not guess.'}
    rows = [
        (
            line.name,
            f'{line.truth:.6g} {line.unit}'.removesuffix(' 1'),
            '' if line.found is None else f'{line.found:.6g}',
            off_in_words(line),
        )
        for line in told.lines
    ]
    remarks = [f'Hidden: {hidden}.', said[told.guessed_right]]
    if told.missed:
        remarks.append(missing_headline(dict.fromkeys(told.missed, ())))
    if told.needless:
        remarks.append(f'The model has what the robot has not: {join([*told.needless])}.')
    return [html.P(' '.join(remarks), id='truth'), _table(('', 'truth', 'found', 'off by'), rows)]


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> html.Div:
    body = [
        html.Tr([html.Th(row[0], scope='row'), *(html.Td(cell) for cell in row[1:])], key=str(row[0]))
        for row in rows
    ]
    top = html.Tr([html.Th(head, scope='col') for head in heads])
    return html.Div(html.Table([html.Thead(top), html.Tbody(body)]), className='wide')


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ''
