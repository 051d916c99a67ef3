"""The figures of the page: from the state of a session to figures of the report's own kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gyrocal_ros.diagnose.drift import BlindDrift, blind_drift, held_out_from_s, reference_path
from gyrocal_ros.diagnose.error_curves import ErrorBySignal, curve_by_effects
from gyrocal_ros.diagnose.improvement import Improvement, Revision
from gyrocal_ros.diagnose.model_series import coefficients
from gyrocal_ros.diagnose.run_series import camera_off, windows
from gyrocal_ros.diagnose.search_series import FIRST_MODEL, open_candidate_rows
from gyrocal_ros.diagnose.wander import Wander
from gyrocal_ros.report import calibration_figures, comparison_figures
from gyrocal_ros.report import diagnosis_figures as figures
from gyrocal_ros.report.improvement import drift_marks
from gyrocal_ros.studio.revisions import TriedModel
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.worker import Examined

STRETCHES = 5
MOST_CANDIDATES = 10
MOST_SIGNALS = 4
"""Of what is left over, so many are written with a report, the most telling ones."""
AS_IT_WAS, NOW = FIRST_MODEL, 'the present model'
KINDS = {
    'heading': 'Heading error',
    'drift': 'Blind drift',
    'innovations': 'Innovations',
    'coefficients': 'Coefficients',
}
"""What the model can be held against, and in words."""
COMPARED = {'heading': 'Heading error', 'drift': 'Blind drift', 'innovations': 'Innovations'}


def against_measurement(view: StudioState, kind: str) -> Any | None:
    """Model against measurement over time; while a first run is under way, as far as that has come.

    Args:
        view: the state.
        kind: one of `KINDS`.
    """
    chain, improved = view.trials.chain, view.improvement
    if improved is None:
        return _glimpse(view)
    shown = [chain[0], chain[-1]] if len(chain) > 1 else list(chain)
    names = [AS_IT_WAS, NOW] if len(chain) > 1 else [NOW]
    return _held_against(kind, dict(zip(names, shown, strict=True)), improved)


def side_by_side(view: StudioState, labels: tuple[str, str], kind: str) -> Any | None:
    """Two revisions side by side; None where one of them has not run.

    Args:
        view: the state.
        labels: of the revisions.
        kind: one of `COMPARED`.
    """
    found = {label: view.trials.find(label) for label in labels}
    chosen = {label: one for label, one in found.items() if one is not None and one.examined is not None}
    if view.improvement is None or len(chosen) < len(found):
        return None
    return _held_against(kind, chosen, view.improvement)


def _held_against(kind: str, trials: Mapping[str, TriedModel], improved: Improvement) -> Any | None:
    """Several trials over time, the last one being the one whose failures are marked."""
    examined = {name: _examined(trial) for name, trial in trials.items()}
    revisions = {name: _revision(improved, trial.label) for name, trial in trials.items()}
    last = list(examined.values())[-1]
    if kind == 'drift':
        drifts = {name: revision.held_out for name, revision in revisions.items()}
        return (
            comparison_figures.drift_by_span(drifts)
            if all(len(one.error_rad) for one in drifts.values())
            else None
        )
    if kind == 'coefficients':
        told = coefficients((name, one.stage.run, True) for name, one in examined.items())
        return comparison_figures.coefficients_by_model(told, list(examined))
    if kind == 'innovations':
        if len(examined) == 1:
            history = last.stage.run.history
            return calibration_figures.innovations(history, windows(history))
        return comparison_figures.consistency(
            {name: windows(one.stage.run.history) for name, one in examined.items()}
        )
    wanders = {name: one.wander for name, one in examined.items()}
    return _heading(wanders, last, list(revisions.values())[-1].held_out)


def _heading(wanders: Mapping[str, Wander], examined: Examined, drift: BlindDrift) -> Any:
    run = examined.stage.run
    history, odd = run.history, examined.stage.unexplained_structure
    stretches = [failure for failure in examined.failures if failure.from_s is not None]
    return figures.where_it_fails(
        'Heading by the gyro alone, less the heading that was seen',
        wanders,
        history.time_s,
        np.degrees(history.turn_rad / history.dt_s),
        stretches[:STRETCHES],
        None if odd is None else odd.at_s,
        camera_off(history),
        drift,
    )


def _glimpse(view: StudioState) -> Any | None:
    glimpse = view.glimpse
    if glimpse is None:
        return None
    title = 'Heading by the gyro alone, less the heading that was seen: so far'
    figure = figures.where_it_fails(title, {'so far': glimpse.wander}, glimpse.time_s, glimpse.rate_deg_s)
    if view.contents is not None:
        figure.update_xaxes(range=[0.0, view.contents.duration_s])
    return figure


def left_over(view: StudioState, signal: str, of_scale: bool) -> Any | None:
    """What is left over as a function of a signal; None where the recording cannot tell."""
    chain = view.trials.chain
    if not chain or chain[0].examined is None or chain[-1].examined is None:
        return None
    first, now = chain[0].examined, chain[-1].examined
    question = (signal, of_scale)
    if question not in first.left_over:
        return None
    before, after, told = first.left_over[question], None, None
    if len(chain) > 1:
        after = now.left_over.get(question)
        told = curve_by_effects(now.stage.run, len(chain) - 1, signal, before, of_scale)
    return figures.error_by_signal(ErrorBySignal(signal, of_scale, before, after, told), (AS_IT_WAS, NOW))


def signals(view: StudioState) -> list[tuple[str, bool]]:
    """What the rest can be told by, and whether as an error of the scale, the most telling first."""
    return [] if view.examined is None else list(view.examined.left_over)


def scores(view: StudioState) -> Any | None:
    """What every effect that the present model lacks would explain."""
    examined = view.examined
    if examined is None:
        return None
    best = None if examined.best is None else examined.best.effect.name
    table = open_candidate_rows(examined.stage, best, examined.twins, MOST_CANDIDATES)
    return figures.scores(table) if table else None


def revisions(view: StudioState) -> Any | None:
    """The error falling, revision by revision."""
    improved = view.improvement
    if improved is None or not all(len(one.held_out.error_rad) for one in improved.revisions):
        return None
    return comparison_figures.drift_by_model('Drift in 60 s without the camera', drift_marks(improved))


def all_of(view: StudioState) -> dict[str, Any]:
    """All figures that the page can show of the present model, by name."""
    found = {kind: against_measurement(view, kind) for kind in KINDS}
    found |= {'evidence': scores(view), 'revisions': revisions(view)}
    for place, (signal, of_scale) in enumerate(signals(view)[:MOST_SIGNALS], start=1):
        found[f'left_over_{place}'] = left_over(view, signal, of_scale)
    return {name: figure for name, figure in found.items() if figure is not None}


def drift_deg(examined: Examined, view: StudioState) -> float:
    """Held-out drift of something that may become a revision, told as the revisions are."""
    now = view.examined
    if now is None:
        return math.nan
    run = examined.stage.run
    return blind_drift(run, reference_path(now.stage.run), held_out_from_s(run)).rms_deg


def _examined(trial: TriedModel) -> Examined:
    assert trial.examined is not None
    return trial.examined


def _revision(improved: Improvement, label: str) -> Revision:
    return next(one for one in improved.revisions if one.label == label)
