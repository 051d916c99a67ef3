"""What commands print for other programs, under the names that scripts rely on."""

from __future__ import annotations

from typing import Any

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.advice import CAUTION, advice
from gyrocal_ros.diagnose.comparison import Comparison, ModelResult
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.drift import BlindDrift, blind_drift, heading_rms_deg, held_out_from_s
from gyrocal_ros.diagnose.improvement import Improvement, Revision
from gyrocal_ros.diagnose.ranking import RankedEffect, estimate, estimate_stds
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.diagnose.search import Search
from gyrocal_ros.diagnose.shapes import UnexplainedStructure
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.pipeline.calibration import Calibration, coefficient_table, conclude


def summarise(run: Run, calibration: Calibration) -> dict[str, Any]:
    """What `replay --json` prints, but for the time it took."""
    summary: dict[str, Any] = {
        'source': run.source,
        'scale_factor': calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'scale_factor_volt': calibration.scale_factor_volt,
        'bias': float(calibration.values[0]),
        'bias_std': float(calibration.stds[0]),
        'converged': calibration.converged,
        'convergence_time_s': calibration.convergence_time_s,
        'coefficients': coefficient_table(calibration),
        'duration_s': calibration.duration_s,
        'nis_per_dof': nis_per_dof(run),
        'events': [event.text for event in run.events],
    }
    heading_rms = heading_rms_deg(run)
    if heading_rms is not None:
        drift = blind_drift(run, from_s=held_out_from_s(run))
        summary['heading_rms_deg'] = heading_rms
        summary['blind_drift_deg'] = {'rms': drift.rms_deg, 'max': drift.max_deg}
    return summary


def summarise_diagnosis(searched: Search, diagnosis: Diagnosis) -> dict[str, Any]:
    """What `diagnose --json` prints, but for the time it took."""
    run = searched.first.run
    return {
        'source': run.source,
        'verdict': diagnosis.verdict,
        'missing': [_finding(finding) for finding in diagnosis.missing],
        'fails_where': [_failure(failure) for failure in diagnosis.fails_where],
        'unexplained': _oddity(diagnosis.unexplained),
        'advice': advice(diagnosis),
        'not_judged': diagnosis.not_judged,
        'ranked': [_suspect(ranked_effect) for ranked_effect in diagnosis.ranked],
        'drift_reference': diagnosis.drift_reference,
        'duration_s': run.span.duration_s,
    }


def summarise_comparison(comparison: Comparison) -> dict[str, Any]:
    """What `compare --json` prints, but for the time it took."""
    run = comparison.results[0].run
    return {
        'source': run.source,
        'best': comparison.best.label,
        'models': [_rival(rival) for rival in comparison.results],
        'diverged': [{'model': label, 'why': why} for label, why in comparison.diverged.items()],
        'drift_reference': comparison.drift_reference,
        'duration_s': run.span.duration_s,
    }


def summarise_improvement(improved: Improvement) -> dict[str, Any]:
    """What `improve --json` prints, but for the time it took."""
    run = improved.final.examined.run
    return {
        'source': run.source,
        'effects': [effect.name for effect in run.model.effects],
        'coefficients': coefficient_table(conclude(run)),
        'revisions': [merit(revision) for revision in improved.revisions],
        'unexplained': _oddity(improved.final.examined.unexplained_structure),
        'drift_reference': improved.drift_reference,
        'duration_s': run.span.duration_s,
    }


def merit(revision: Revision) -> dict[str, Any]:
    """The figures of merit of one revision."""
    run = revision.examined.run
    calibration = conclude(run)
    return {
        'revision': revision.label,
        'effect': None if revision.effect is None else revision.effect.name,
        'kept': revision.is_kept,
        'why': revision.why,
        'held_out_drift_deg': _drift(revision.held_out),
        'fitted_drift_deg': _drift(revision.fitted),
        'held_out_drift_fell_sigma': revision.drift_sigma,
        'log_likelihood': float(run.history.log_likelihood.sum()),
        'log_likelihood_gain': revision.gain,
        'log_likelihood_gain_sigma': revision.gain_sigma,
        'nis_per_dof': nis_per_dof(run),
        'scale_factor': calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'coefficients': coefficient_table(calibration),
    }


def nis_per_dof(run: Run) -> float:
    """Innovations as a part of what the filter expects, 1 where it is right."""
    return float(run.history.nis.sum() / run.history.dof.sum())


def _finding(finding: MissingEffect) -> dict[str, Any]:
    return {
        'effect': finding.effect.name,
        'coefficients': _coefficients(finding.effect, finding.values, finding.stds),
        'log_likelihood_gain': finding.gain,
        'significance_sigma': finding.sigma,
        'p_value': finding.p_value,
        'held_out_drift_before_deg': finding.drift_before_deg,
        'held_out_drift_after_deg': finding.drift_after_deg,
        'confused_with': finding.confused_with,
    }


def _suspect(ranked_effect: RankedEffect) -> dict[str, Any]:
    return {
        'effect': ranked_effect.effect.name,
        'coefficients': _coefficients(
            ranked_effect.effect, estimate(ranked_effect), estimate_stds(ranked_effect)
        ),
        'log_likelihood_gain': ranked_effect.fit.gain,
        'significance_sigma': ranked_effect.fit.sigma,
        'p_value': ranked_effect.fit.p_value,
        'significant': ranked_effect.is_significant,
    }


def _coefficients(effect: Effect, values: Array, stds: Array) -> dict[str, dict[str, Any]]:
    return {
        item.name: {'value': float(value), 'std': float(std), 'unit': item.unit}
        for item, value, std in zip(effect.coefficients, values, stds, strict=True)
    }


def _failure(failure: Failure) -> dict[str, Any]:
    in_time = {'from_s': failure.from_s, 'to_s': failure.to_s}
    place = in_time if failure.regime is None else {'regime': failure.regime}
    return {'what': failure.what, **place, 'sigma': failure.sigma}


def _oddity(odd: UnexplainedStructure | None) -> dict[str, Any] | None:
    if odd is None:
        return None
    shape = odd.shape
    return {
        'what': odd.what,
        'signal': shape.signal,
        'of': 'scale' if shape.of_scale else 'bias',
        'unit': '1' if shape.of_scale else 'rad/s',
        'at_s': odd.at_s,
        'knots': shape.knots,
        'values': shape.values,
        'stds': shape.stds,
        'log_likelihood_gain': odd.gain,
        'significance_sigma': odd.sigma,
        'caution': CAUTION,
    }


def _rival(rival: ModelResult) -> dict[str, Any]:
    calibration = conclude(rival.run)
    by_truth = rival.fails_by_truth
    return {
        'model': rival.label,
        'effects': [effect.name for effect in rival.run.model.effects],
        'scale_factor': calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'coefficients': coefficient_table(calibration),
        'converged': calibration.converged,
        'heading_rms_deg': rival.heading_rms_deg,
        'blind_drift_deg': _drift(rival.drift),
        'drift_fell_sigma': rival.drift_sigma,
        'log_likelihood_gain': rival.gain,
        'log_likelihood_gain_sigma': rival.gain_sigma,
        'nis_per_dof': nis_per_dof(rival.run),
        'fails_where': [_failure(failure) for failure in rival.fails_where],
        'fails_by_truth': None if by_truth is None else [_failure(failure) for failure in by_truth],
    }


def _drift(drift: BlindDrift) -> dict[str, Any]:
    low, high = drift.interval_deg
    return {
        'rms': drift.rms_deg,
        'low': low,
        'high': high,
        'max': drift.max_deg,
        'spans': len(drift.error_rad),
    }
