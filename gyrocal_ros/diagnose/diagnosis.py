"""Which physical effect does the sensor model lack? The answer, with its doubts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.candidates import LIMITS, has_lever, needs, with_means
from gyrocal_ros.diagnose.drift import blind_drift, held_out_from_s, reference_path
from gyrocal_ros.diagnose.ranking import RankedEffect, twins
from gyrocal_ros.diagnose.recorded import Recorded, coarse_step
from gyrocal_ros.diagnose.regimes import Failure, failures
from gyrocal_ros.diagnose.search import ExaminedModel, Search
from gyrocal_ros.diagnose.shapes import UnexplainedStructure
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.model.sensor import Effect, coefficient_names

BY_THE_WAY = 0.2
"""What is left over and explains less than this part of what was found does not spoil the finding."""
ALWAYS_JUDGED = ('scale_asymmetry', 'scale_quadratic', 'scale_cubic', 'bias_warmup', 'gyro_lag')
"""Effects that any recording with turns can judge; one that cannot judge most of them tells nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class MissingEffect:
    """One effect that is missing."""

    effect: Effect
    """Its prior means are the estimates."""
    values: Array
    stds: Array
    """(k,) by the run of the filter with it, no surer than the scatter over the recording allows."""
    gain: float
    """Log-likelihood that it gains."""
    sigma: float
    p_value: float
    drift_before_deg: float
    drift_after_deg: float
    """Held out: each span begins with what was known by then."""
    confused_with: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients."""
        return coefficient_names(self.effect)


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What the model lacks on one recording."""

    verdict: str
    """`nothing_missing`, `effect_found`, `cannot_tell` or `unexplained`."""
    missing: tuple[MissingEffect, ...]
    """The one that explains most first."""
    ranked: tuple[RankedEffect, ...]
    """Everything that was tried against the model as it was, the best first."""
    not_judged: dict[str, str]
    """Effects that this recording cannot judge, and why."""
    unexplained: UnexplainedStructure | None
    """What is left over that no effect explains."""
    fails_where: tuple[Failure, ...]
    """Where the model as it was is off by more than chance, worst first."""
    drift_reference: str
    """What headings were compared with for the drift."""
    coarse_step_rad_s: float | None = None
    """Of the gyro's converter, where it is wider than the noise: what is found may be its steps."""


def diagnose(searched: Search, recorded: Recorded) -> Diagnosis:
    """Draw the conclusions from a search."""
    first, last = searched.first, searched.last
    findings = sorted(_findings(searched), key=lambda finding: finding.gain, reverse=True)
    not_judged = dict(_not_judged(last, recorded))
    coarse_step_rad_s = coarse_step(recorded)
    return Diagnosis(
        verdict=_verdict(findings, last.unexplained_structure, not_judged, coarse_step_rad_s is not None),
        missing=tuple(findings),
        ranked=first.ranked,
        not_judged=not_judged,
        unexplained=last.unexplained_structure,
        fails_where=tuple(failures(first.run, first.seen)),
        drift_reference=reference_path(last.run)[1],
        coarse_step_rad_s=coarse_step_rad_s,
    )


def _findings(searched: Search) -> Iterator[MissingEffect]:
    run = searched.last.run
    reference = reference_path(run)
    from_s = held_out_from_s(run)

    def drift_deg(stage: ExaminedModel) -> float:
        return blind_drift(stage.run, reference, from_s).rms_deg

    confused = _confused(searched)
    start = len(searched.last.model.coefficients)
    for change in reversed(searched.kept):
        start -= len(change.effect.coefficients)
        places = slice(start, start + len(change.effect.coefficients))
        values = run.state.coefficients[places]
        stds = np.maximum(run.history.std[-1, COEFFICIENTS_START:][places], change.stds)
        yield MissingEffect(
            effect=with_means(change.effect, values.tolist()),
            values=values,
            stds=stds,
            gain=change.gain,
            sigma=change.sigma,
            p_value=change.p_value,
            drift_before_deg=drift_deg(change.before) if change.before is not None else float('nan'),
            drift_after_deg=drift_deg(change.after),
            confused_with=confused.get(change.effect.name, ()),
        )


def _confused(searched: Search) -> dict[str, tuple[str, ...]]:
    """What each effect that was found may be confused with, the others found being there.

    Asked of the evidence that knows of no effect yet; a limit is not among it. What a run of its own
    has told apart is not confused.
    """
    first = searched.first
    outdone = {change.effect.name: change.outdone for change in searched.kept}
    found = {item.effect.name: item for item in first.ranked if item.effect.name in outdone}
    confused = {}
    for name, ranked_effect in found.items():
        rest = [item.fit.columns for item in found.values() if item is not ranked_effect]
        beside = np.concatenate(rest) if rest else np.empty(0, np.int64)
        others = [item for item in first.ranked if item.effect.name not in {*outdone, *outdone[name]}]
        confused[name] = tuple(twins(ranked_effect, others, first.scores, beside))
    return confused


def _verdict(
    findings: list[MissingEffect],
    left: UnexplainedStructure | None,
    not_judged: dict[str, str],
    is_coarse: bool,
) -> str:
    if left is not None and left.gain > BY_THE_WAY * sum(finding.gain for finding in findings):
        return 'unexplained'
    if findings:
        is_doubtful = is_coarse or any(finding.confused_with for finding in findings)
        return 'cannot_tell' if is_doubtful else 'effect_found'
    blind_to = sum(name in not_judged for name in ALWAYS_JUDGED)
    return 'nothing_missing' if blind_to <= len(ALWAYS_JUDGED) // 2 else 'cannot_tell'


def _not_judged(stage: ExaminedModel, recorded: Recorded) -> Iterator[tuple[str, str]]:
    present = {effect.name for effect in stage.model.effects}
    judged = {ranked_effect.effect.name: ranked_effect for ranked_effect in stage.ranked}
    for name, effect in EFFECTS.items():
        if name in present or name in LIMITS:
            continue
        lacking = set(needs(effect)) - recorded.extras
        if effect.acts_on == 'camera' and recorded.rig.camera is None:
            lacking.add('images of the ceiling')
        if lacking:
            yield name, f'not recorded: {", ".join(sorted(lacking))}'
        elif name == 'wheel_scale' and not has_lever(recorded.rig):
            yield name, 'only a camera at a distance from the turning centre shows it'
        elif name not in judged:
            yield name, 'nothing in this recording depends on it'
        elif not (judged[name].could_show or judged[name].is_significant):
            yield name, 'even one of usual size would not show in this recording'
    for name in recorded.left_out:
        yield name, 'more signals are recorded than can be tried'
