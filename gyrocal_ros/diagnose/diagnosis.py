"""Which physical effect does the sensor model lack? The answer, with its doubts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CovariateSample, ImuSample, Source, TemperatureSample, seconds
from gyrocal_ros.diagnose.candidates import NEEDS_A_RUN, Signal, candidates_for
from gyrocal_ros.diagnose.drift import blind_drift, reference_path
from gyrocal_ros.diagnose.ranking import Suspect, rank, twins, unexcited, with_estimate
from gyrocal_ros.diagnose.shapes import BiasStep, bias_step
from gyrocal_ros.ekf.evidence import Evidence
from gyrocal_ros.ekf.motion import SPEED_SIGNAL
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel, coefficient_names

Calibrate = Callable[[SensorModel, tuple[Effect, ...]], Run]
"""Runs the filter with a model and with candidates on trial."""

STEP_INTERVAL_S = 15.0
MAX_STEPS = 40
"""Moments at which the bias is tried to jump: enough to name one."""
PEEK_S = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What a recording offers as explanations."""

    signals: tuple[Signal, ...]
    has_temperature: bool
    duration_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One effect that is missing."""

    effect: Effect
    """Its prior means are the estimates."""
    values: Array
    stds: Array
    """(k,) by the scatter over the recording."""
    gain: float
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
    missing: tuple[Finding, ...]
    """The one that explains most first."""
    ranked: tuple[Suspect, ...]
    """Everything that was tried against the model as it was."""
    not_judged: tuple[str, ...]
    """Effects that this recording does not excite."""
    unexplained_at_s: float | None
    """When something happened that no effect explains."""
    run: Run
    """The filter with the model as it was."""


def look_at(source: Source) -> Recorded:
    """See which signals a recording offers, by its first seconds."""
    values: dict[str, list[float]] = {}
    has_temperature, start_ns = False, None
    for sample in source.measurements():
        if isinstance(sample, ImuSample) and start_ns is None:
            start_ns = sample.t_ns
        if start_ns is not None and seconds(sample.t_ns - start_ns) > PEEK_S:
            break
        if isinstance(sample, CovariateSample):
            values.setdefault(sample.name, []).append(sample.value)
        has_temperature = has_temperature or isinstance(sample, TemperatureSample)
    signals = [
        Signal(name, float(np.mean(column)), max(float(np.std(column)), 0.1 * abs(float(np.mean(column)))))
        for name, column in values.items()
    ]
    varying = tuple(signal for signal in signals if signal.spread > 0.0)
    return Recorded((*varying, Signal(SPEED_SIGNAL, 0.0, 0.2)), has_temperature, source.span.duration_s)


def diagnose(model: SensorModel, recorded: Recorded, calibrate: Calibrate, most: int = 2) -> Diagnosis:
    """Find what a model lacks: try all effects at once, add the best, ask again.

    Args:
        model: the present sensor model.
        recorded: what the recording offers.
        calibrate: runs the filter.
        most: effects to look for, one pass of the filter each beyond the first.
    """
    run = before = calibrate(model, _on_trial(model, recorded))
    ranked = first_ranked = _ranked(before)
    findings: list[Finding] = []
    unexplained_at_s = None
    while ranked and ranked[0].is_significant and len(findings) < most:
        best = ranked[0]
        if isinstance(best.effect, BiasStep):
            unexplained_at_s = best.effect.at_s
            break
        model = SensorModel(model.name, model.bias, (*model.effects, with_estimate(best)), model.version)
        after = calibrate(model, _on_trial(model, recorded))
        findings.append(_finding(best, ranked, before, after))
        before, ranked = after, _ranked(after)
    assert run.evidence is not None
    return Diagnosis(
        verdict=_verdict(findings, unexplained_at_s),
        missing=tuple(findings),
        ranked=tuple(first_ranked),
        not_judged=tuple(unexcited(run.evidence, first_ranked)),
        unexplained_at_s=unexplained_at_s,
        run=run,
    )


def _on_trial(model: SensorModel, recorded: Recorded) -> tuple[Effect, ...]:
    candidates = candidates_for(model, recorded.signals, recorded.has_temperature)
    interval_s = max(STEP_INTERVAL_S, recorded.duration_s / MAX_STEPS)
    moments = np.arange(interval_s, recorded.duration_s - interval_s, interval_s)
    return (*candidates, *(bias_step(float(at_s)) for at_s in moments))


def _ranked(run: Run) -> list[Suspect]:
    assert run.evidence is not None
    return [suspect for suspect in rank(run.evidence) if suspect.effect.name not in NEEDS_A_RUN]


def _finding(best: Suspect, ranked: Sequence[Suspect], before: Run, after: Run) -> Finding:
    evidence: Evidence | None = before.evidence
    assert evidence is not None
    reference = reference_path(after)
    middle_s = 0.5 * float(after.history.time_s[-1])
    effect = with_estimate(best)
    count = len(effect.coefficients)
    stds = np.zeros(count)
    stds[best.fit.columns - best.columns[0]] = np.sqrt(np.diagonal(best.fit.covariance))
    library = [suspect for suspect in ranked if not isinstance(suspect.effect, BiasStep)]
    return Finding(
        effect=effect,
        values=np.array([item.prior_mean for item in effect.coefficients]),
        stds=stds,
        gain=best.fit.gain,
        sigma=best.fit.sigma,
        p_value=best.fit.p_value,
        drift_before_deg=blind_drift(before, reference, middle_s).rms_deg,
        drift_after_deg=blind_drift(after, reference, middle_s).rms_deg,
        confused_with=tuple(twins(best, library, evidence)),
    )


def _verdict(findings: Sequence[Finding], unexplained_at_s: float | None) -> str:
    if not findings:
        return 'nothing_missing' if unexplained_at_s is None else 'unexplained'
    return 'cannot_tell' if findings[0].confused_with else 'effect_found'
