"""The first thing that pages about models say: the verdict, what speaks for it, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrocal_ros.diagnose.advice import advice
from gyrocal_ros.diagnose.comparison import Comparison
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.drift import REFERENCES, SPAN_S
from gyrocal_ros.diagnose.improvement import CHANCE_SIGMA, Improvement, Revision
from gyrocal_ros.effects import find_effect
from gyrocal_ros.report.tables import Kind, Verdict
from gyrocal_ros.report.words import (
    BEYOND_DOUBT,
    diagnosis_headline,
    drift_in_words,
    improvement_headline,
)

COVERED = f'With the camera covered for {SPAN_S:.0f} s the heading drifts'


def of_diagnosis(diagnosis: Diagnosis) -> Verdict:
    """Which effect is missing, and what to do about it."""
    kind: Kind = 'found' if diagnosis.missing else 'bad'
    if diagnosis.verdict == 'nothing_missing':
        kind = 'good'
    sentences = [*_findings(diagnosis), *_leftovers(diagnosis)]
    todo = [*_additions(diagnosis), *advice(diagnosis)]
    return Verdict(kind, diagnosis_headline(diagnosis), tuple(sentences), tuple(todo))


def of_comparison(comparison: Comparison) -> Verdict:
    """Which model is best, and whether that is more than chance."""
    reference = REFERENCES[comparison.drift_reference]
    sentences = [
        f'{rival.label}: {COVERED[0].lower()}{COVERED[1:]} {drift_in_words(rival.drift)} deg '
        f'(rms against {reference}).'
        for rival in comparison.results
    ]
    sentences += [f'With {label} the filter cannot run: {why}.' for label, why in comparison.diverged.items()]
    kind, headline = _best(comparison)
    fails = bool(comparison.best.fails_where)
    todo = (f'Ask `gyrocal diagnose` what {comparison.best.label} lacks.',) if fails else ()
    return Verdict(kind, headline, tuple(sentences), todo)


def of_improvement(improved: Improvement) -> Verdict:
    """What was added, and how far the error fell."""
    first, final = improved.kept[0], improved.final
    before, after = drift_in_words(first.held_out), drift_in_words(final.held_out)
    against = f'rms on held-out spans against {REFERENCES[improved.drift_reference]}'
    tried = [_rejection(revision) for revision in improved.revisions if not revision.is_kept]
    if final is first:
        return Verdict(
            'good', improvement_headline(improved), (f'{COVERED} {before} deg ({against}).', *tried)
        )
    fall = f'{COVERED} {after} deg; before, it was {before} deg ({against}).'
    todo = 'Give the robot the new model.yaml and calibration.yaml of this folder.'
    return Verdict('good', improvement_headline(improved), (fall, *tried), (todo,))


def _findings(diagnosis: Diagnosis) -> Iterator[str]:
    for finding in diagnosis.missing:
        name = finding.effect.name
        about, _, _ = find_effect(name).about.physics.partition('. ')
        sure = 'without it the filter loses the measurements'
        if math.isfinite(finding.gain):
            sure = f'log-likelihood +{finding.gain:.0f}, {_sigmas(finding.sigma)}'
        yield f'{name}: {about.rstrip(".")} ({sure}).'
        if math.isfinite(finding.drift_before_deg) and math.isfinite(finding.drift_after_deg):
            against = f'rms on held-out spans against {REFERENCES[diagnosis.drift_reference]}'
            without = f'{finding.drift_before_deg:.2f} deg without it'
            yield f'{COVERED} {without} and {finding.drift_after_deg:.2f} deg with it ({against}).'


def _leftovers(diagnosis: Diagnosis) -> Iterator[str]:
    odd = diagnosis.unexplained
    if odd is not None and diagnosis.verdict != 'unexplained':
        yield f'By the way, a little is left over: {odd.what} ({_sigmas(odd.sigma)}).'
    if diagnosis.not_judged:
        count = len(diagnosis.not_judged)
        what = f'{count} effects' if count > 1 else 'one effect'
        yield f'This recording says nothing of {what} of the library; why is said at the end.'


def _additions(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.missing:
        name = diagnosis.missing[0].effect.name
        yield f'Add it with `gyrocal add {name}`, or let `gyrocal improve` add it and show what it gains.'


def _sigmas(sigma: float) -> str:
    return f'{sigma:.1f} sigma' if sigma < BEYOND_DOUBT else 'beyond any doubt'


def _best(comparison: Comparison) -> tuple[Kind, str]:
    best, first = comparison.best, comparison.results[0]
    places = len(best.fails_where)
    if len(comparison.results) == 1:
        if not places:
            return 'good', f'{best.label} fits this recording: it fails nowhere by more than chance.'
        return 'found', f'{best.label} is off by more than chance in {_count(places)}.'
    if best is first:
        return 'good', f'No other model is better than {first.label}.'
    sure = f'log-likelihood +{best.gain:.1f}, {best.gain_sigma:.1f} sigma'
    if best.gain_sigma < CHANCE_SIGMA:
        return 'found', f'{best.label} is best, but hardly better than {first.label} ({sure}).'
    return 'found', f'{best.label} foresees the recording better than {first.label} ({sure}).'


def _count(places: int) -> str:
    return 'one place' if places == 1 else f'{places} places'


def _rejection(revision: Revision) -> str:
    assert revision.effect is not None
    return f'{revision.effect.name} was tried and {revision.why}.'
