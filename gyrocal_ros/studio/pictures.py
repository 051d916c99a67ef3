"""Figures of the page, from the state of a session; the report draws them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gyrocal_ros.diagnose.analysis.drift import (
    SPAN_S,
    BlindDrift,
    blind_drift,
    held_out_from_s,
    reference_heading,
)
from gyrocal_ros.diagnose.analysis.ranking import estimate
from gyrocal_ros.diagnose.analysis.wander import Wander
from gyrocal_ros.diagnose.search.improvement import Improvement, Revision
from gyrocal_ros.diagnose.series.effect_axis import curve_before_adding, effect_axis
from gyrocal_ros.diagnose.series.error_curves import ErrorBySignal, ErrorCurve, curve_by_effects
from gyrocal_ros.diagnose.series.law_axis import curves_of_law, law_axis
from gyrocal_ros.diagnose.series.model_series import coefficients
from gyrocal_ros.diagnose.series.run_series import camera_off, windows
from gyrocal_ros.diagnose.series.search_series import FIRST_MODEL, open_candidate_rows
from gyrocal_ros.effects import find_effect
from gyrocal_ros.report import calibration_figures, comparison_figures
from gyrocal_ros.report import diagnosis_figures as figures
from gyrocal_ros.report.improvement import drift_marks
from gyrocal_ros.studio.revisions import TriedModel
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.tasks import Examination

MAX_STRETCHES = 5
"""Maximum number of stretches of time that are marked as failures."""
MAX_CANDIDATES = 10
"""Number of candidates up to which the significant ones are complemented by others."""
MAX_SIGNALS = 4
"""Maximum number of figures of the error left over in a report, the most significant first."""
FIRST, PRESENT = FIRST_MODEL, 'the present model'
KINDS = {
    'heading': 'Heading error',
    'drift': 'Blind drift',
    'innovations': 'Innovations',
    'coefficients': 'Coefficients',
}
"""Quantities that can be shown, with their labels."""


def against_measurement(state: StudioState, kind: str) -> Any | None:
    """Draw model against measurement over time; during the first run, its preview.

    Args:
        state: the state.
        kind: a key of `KINDS`.
    """
    chain, improved = state.tree.chain, state.improvement
    if improved is None:
        return _preview(state)
    shown = [chain[0], chain[-1]] if len(chain) > 1 else list(chain)
    names = [FIRST, PRESENT] if len(chain) > 1 else [PRESENT]
    if kind == 'coefficients':
        known = () if state.revealed is None else state.revealed.coefficients
        truth = dict(item.in_model for item in known if item.in_model is not None)
        return calibration_figures.coefficients(_examination(chain[-1]).examined.run, truth=truth)
    return _model_figure(kind, dict(zip(names, shown, strict=True)), improved)


def side_by_side(state: StudioState, labels: tuple[str, str], kind: str) -> Any | None:
    """Draw two revisions side by side; None if one of them has not run.

    Args:
        state: the state.
        labels: labels of the revisions.
        kind: a key of `KINDS`.
    """
    found = {label: state.tree.find(label) for label in labels}
    chosen = {label: one for label, one in found.items() if one is not None and one.examination is not None}
    if state.improvement is None or len(chosen) < len(found):
        return None
    return _model_figure(kind, chosen, state.improvement)


def _model_figure(kind: str, models: Mapping[str, TriedModel], improved: Improvement) -> Any | None:
    """Draw several models over time, with the failures of the last one."""
    examinations = {name: _examination(tried) for name, tried in models.items()}
    revisions = {name: _revision(improved, tried.label) for name, tried in models.items()}
    last = list(examinations.values())[-1]
    if kind == 'drift':
        drifts = {name: revision.held_out for name, revision in revisions.items()}
        return (
            comparison_figures.drift_by_span(drifts)
            if all(len(one.error_rad) for one in drifts.values())
            else None
        )
    if kind == 'coefficients':
        estimates = coefficients((name, one.examined.run, True) for name, one in examinations.items())
        return comparison_figures.coefficients_by_model(estimates, list(examinations))
    if kind == 'innovations':
        if len(examinations) == 1:
            history = last.examined.run.history
            return calibration_figures.innovations(history, windows(history))
        return comparison_figures.consistency(
            {name: windows(one.examined.run.history) for name, one in examinations.items()}
        )
    wanders = {name: one.wander for name, one in examinations.items()}
    return _heading(wanders, last, list(revisions.values())[-1].held_out)


def _heading(wanders: Mapping[str, Wander], examination: Examination, drift: BlindDrift) -> Any:
    history, structure = examination.examined.run.history, examination.examined.unexplained_structure
    stretches = [failure for failure in examination.diagnosis.fails_where if failure.from_s is not None]
    return figures.where_it_fails(
        'Heading by the gyro alone, less the observed heading',
        wanders,
        history.time_s,
        np.degrees(history.turn_rad / history.dt_s),
        stretches[:MAX_STRETCHES],
        None if structure is None else structure.at_s,
        camera_off(history),
        drift,
    )


def _preview(state: StudioState) -> Any | None:
    preview = state.preview
    if preview is None:
        return None
    title = 'Heading by the gyro alone, less the observed heading: so far'
    figure = figures.where_it_fails(title, {'so far': preview.wander}, preview.time_s, preview.rate_deg_s)
    if state.contents is not None:
        figure.update_xaxes(range=[0.0, state.contents.duration_s])
    return figure


def error_by_signal(state: StudioState, signal: str, of_scale: bool, chosen: str | None = None) -> Any | None:
    """Draw the error left over as a function of a signal; None if it is not known.

    Args:
        state: the state.
        signal: name of the signal.
        of_scale: True for the error of the scale.
        chosen: effect that may be added, whose curve is drawn over the points.
    """
    chain = state.tree.chain
    if not chain or chain[0].examination is None or chain[-1].examination is None:
        return None
    first, present = chain[0].examination, chain[-1].examination
    key = (signal, of_scale)
    if key not in first.error_curves:
        return None
    before, after, added = first.error_curves[key], None, None
    if len(chain) > 1:
        after = present.error_curves.get(key)
        added = curve_by_effects(present.examined.run, len(chain) - 1, signal, before, of_scale)
    left = before if after is None else after
    if state.proposal is not None and state.proposal.name == chosen:
        run = state.proposal.examination.examined.run
        proposed = dict(curves_of_law(state.proposal.law, run, signal, of_scale, left))
    else:
        proposed = dict(_proposed(present, chosen, key, left))
    error = ErrorBySignal(signal, of_scale, before, after, added, proposed)
    return figures.error_by_signal(error, (FIRST, PRESENT))


def axis_of(state: StudioState, chosen: str | None) -> tuple[str, bool] | None:
    """Return the key of the error curve that shows an effect which may be added; None without one."""
    if state.examination is None or chosen is None:
        return None
    proposal = state.proposal
    is_law = proposal is not None and proposal.name == chosen
    axis = law_axis(proposal.law) if proposal is not None and is_law else effect_axis(find_effect(chosen))
    return axis if axis in state.examination.error_curves else None


def _proposed(
    present: Examination, chosen: str | None, key: tuple[str, bool], like: ErrorCurve
) -> Iterator[tuple[str, ErrorCurve]]:
    """Yield the curve of the chosen effect, and that of the best other one with the same axis."""
    ranked = [item for item in present.examined.ranked if effect_axis(item.effect) == key]
    for item in sorted(ranked, key=lambda item: item.effect.name != chosen)[:2]:
        if chosen is None or not item.is_significant:
            continue
        curve = curve_before_adding(item.effect, estimate(item), like)  # type: ignore[arg-type]
        if curve is not None:
            yield f'by {item.effect.name}, if added', curve


def signals(state: StudioState) -> list[tuple[str, bool]]:
    """Return the keys of the error curves of the present model, the most significant first."""
    return [] if state.examination is None else list(state.examination.error_curves)


def scores(state: StudioState) -> Any | None:
    """Draw the score of each effect that the present model lacks."""
    examination = state.examination
    if examination is None:
        return None
    best = None if examination.best is None else examination.best.effect.name
    rows = open_candidate_rows(examination.examined, best, examination.indistinguishable, MAX_CANDIDATES)
    return figures.scores(rows) if rows else None


def revisions(state: StudioState) -> Any | None:
    """Draw the drift of each revision."""
    improved = state.improvement
    if improved is None or not all(len(one.held_out.error_rad) for one in improved.revisions):
        return None
    title = f'Heading drift in {SPAN_S:.0f} s without the camera'
    return comparison_figures.drift_by_model(
        title, drift_marks(improved), by_noise_deg=improved.drift_by_noise_deg
    )


def all_figures(state: StudioState) -> dict[str, Any]:
    """Draw all figures of the present model, by name."""
    found = {kind: against_measurement(state, kind) for kind in KINDS}
    found |= {'evidence': scores(state), 'revisions': revisions(state)}
    for number, (signal, of_scale) in enumerate(signals(state)[:MAX_SIGNALS], start=1):
        found[f'left_over_{number}'] = error_by_signal(state, signal, of_scale)
    return {name: figure for name, figure in found.items() if figure is not None}


def drift_deg(examination: Examination, state: StudioState) -> float:
    """Return the held-out drift of a forecast, relative to the same reference as that of the revisions."""
    present = state.examination
    if present is None:
        return math.nan
    run = examination.examined.run
    return blind_drift(run, reference_heading(present.examined.run), held_out_from_s(run)).rms_deg


def _examination(tried: TriedModel) -> Examination:
    assert tried.examination is not None
    return tried.examination


def _revision(improved: Improvement, label: str) -> Revision:
    return next(one for one in improved.revisions if one.label == label)
