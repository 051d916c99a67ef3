"""Dictionaries that commands print as JSON, under the keys that scripts rely on."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from gyrocal_ros import kernels, statistics
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.advice import CAUTION, advice
from gyrocal_ros.diagnose.analysis.comparison import Comparison, ModelResult
from gyrocal_ros.diagnose.analysis.drift import BlindDrift, blind_drift, calibrated_from_s, heading_rms_deg
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.ranking import RankedEffect, estimate, estimate_stds
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import Improvement, Revision
from gyrocal_ros.diagnose.search.timing import TimingFault
from gyrocal_ros.diagnose.status import (
    Status,
    calibration_status,
    comparison_status,
    diagnosis_status,
    improvement_status,
)
from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.effects.model_file import own_options
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.pipeline.calibration import Calibration, coefficient_table, conclude
from gyrocal_ros.pipeline.mount_tilt import mount_tilt

FEATURE_COUNTS = ('used', 'rejected', 'dropped', 'on_lens')
"""Counts of `History` in the summary."""


def summarise(run: Run, calibration: Calibration) -> dict[str, Any]:
    """Return what `replay --json` prints, except the wall time."""
    fit = model_fit(run)
    summary: dict[str, Any] = {
        'source': run.source,
        'kernels': kernels.IN_USE,
        'status': _status(calibration_status(calibration, run, fit)),
        SCALE_FACTOR: calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'scale_factor_volt': calibration.scale_factor_volt,
        'bias': float(calibration.values[0]),
        'bias_std': float(calibration.stds[0]),
        'converged': calibration.converged and not fit.misfits,
        'convergence_time_s': calibration.convergence_time_s,
        'coefficients': coefficient_table(calibration),
        'duration_s': calibration.duration_s,
        'nis_per_dof': nis_per_dof(run),
        'features': {name: int(getattr(run.history, name).sum()) for name in FEATURE_COUNTS},
        'model_fits': fit.fits,
        'misfits': list(fit.misfits),
        'events': [event.text for event in run.events],
    }
    tilt = mount_tilt(run)
    if tilt is not None:
        angle_deg, std_deg = math.degrees(tilt.angle_rad), math.degrees(tilt.std_rad)
        summary['mount_tilt_deg'] = {'value': angle_deg, 'std': std_deg}
    heading_rms = heading_rms_deg(run)
    if heading_rms is not None:
        from_s = calibrated_from_s(run, calibration.convergence_time_s if summary['converged'] else None)
        drift = blind_drift(run, from_s=from_s)
        summary['heading_rms_deg'] = heading_rms
        summary['blind_drift_deg'] = {'rms': drift.rms_deg, 'max': drift.max_deg, 'from_s': from_s}
    return summary


def summarise_diagnosis(searched: Search, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what `diagnose --json` prints, except the wall time."""
    run = searched.first.run
    return {
        'source': run.source,
        'status': _status(diagnosis_status(diagnosis)),
        'verdict': diagnosis.verdict,
        'missing': [_missing(item) for item in diagnosis.missing],
        'fails_where': [_failure(failure) for failure in diagnosis.fails_where],
        'timing': _timing(diagnosis.timing),
        'unexplained': _structure(diagnosis.unexplained),
        'uneven': diagnosis.uneven or None,
        'proven_limits': [
            {'name': effect.name, 'rad_s': effect.coefficients[0].prior_mean}
            for effect in diagnosis.proven_limits
        ],
        'model_fits': diagnosis.fit.fits,
        'misfits': list(diagnosis.fit.misfits),
        'advice': advice(diagnosis),
        'not_judged': diagnosis.not_judged,
        'ranked': [_ranked(ranked) for ranked in diagnosis.ranked],
        'drift_reference': diagnosis.drift_reference,
        'duration_s': run.span.duration_s,
    }


def summarise_comparison(comparison: Comparison) -> dict[str, Any]:
    """Return what `compare --json` prints, except the wall time."""
    run = comparison.results[0].run
    return {
        'source': run.source,
        'status': _status(comparison_status(comparison)),
        'best': comparison.best.label,
        'models': [_model(result) for result in comparison.results],
        'diverged': [{'model': label, 'why': why} for label, why in comparison.diverged.items()],
        'drift_reference': comparison.drift_reference,
        'duration_s': run.span.duration_s,
    }


def summarise_improvement(improved: Improvement) -> dict[str, Any]:
    """Return what `improve --json` prints, except the wall time."""
    run = improved.final.examined.run
    return {
        'source': run.source,
        'status': _status(improvement_status(improved)),
        'effects': [effect.name for effect in run.model.effects],
        'coefficients': coefficient_table(conclude(run)),
        'revisions': [merit(revision) for revision in improved.revisions],
        'unexplained': _structure(improved.final.examined.unexplained_structure),
        'drift_reference': improved.drift_reference,
        'duration_s': run.span.duration_s,
    }


def merit(revision: Revision) -> dict[str, Any]:
    """Return the figures of merit of one revision."""
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
        SCALE_FACTOR: calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'coefficients': coefficient_table(calibration),
    }


def nis_per_dof(run: Run) -> float:
    """Return the NIS per degree of freedom: 1 for a consistent filter, NaN without measurements."""
    value = statistics.nis_per_dof(run.history.nis, run.history.dof)
    return math.nan if value is None else value


def _status(status: Status) -> dict[str, str]:
    return {'level': status.level, 'sentence': status.sentence, 'next_step': status.next_step}


def _missing(item: MissingEffect) -> dict[str, Any]:
    return {
        'effect': item.effect.name,
        'coefficients': _coefficients(item.effect, item.values, item.stds),
        'options': own_options(item.effect),
        'log_likelihood_gain': item.gain,
        'significance_sigma': item.sigma,
        'p_value': item.p_value,
        'held_out_drift_before_deg': item.drift_before_deg,
        'held_out_drift_after_deg': item.drift_after_deg,
        'confused_with': item.confused_with,
        'together_with': item.together_with,
    }


def _ranked(ranked: RankedEffect) -> dict[str, Any]:
    return {
        'effect': ranked.effect.name,
        'coefficients': _coefficients(ranked.effect, estimate(ranked), estimate_stds(ranked)),
        'log_likelihood_gain': ranked.fit.gain,
        'significance_sigma': ranked.fit.sigma,
        'p_value': ranked.fit.p_value,
        'significant': ranked.is_significant,
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


def _timing(fault: TimingFault | None) -> dict[str, Any] | None:
    return None if fault is None else {'what': str(fault), **asdict(fault)}


def _structure(structure: UnexplainedStructure | None) -> dict[str, Any] | None:
    if structure is None:
        return None
    shape = structure.shape
    return {
        'what': structure.what,
        'signal': shape.signal,
        'of': 'scale' if shape.of_scale else 'bias',
        'unit': '1' if shape.of_scale else 'rad/s',
        'at_s': structure.at_s,
        'knots': shape.knots,
        'values': shape.values,
        'stds': shape.stds,
        'log_likelihood_gain': structure.gain,
        'significance_sigma': structure.sigma,
        'caution': CAUTION,
    }


def _model(result: ModelResult) -> dict[str, Any]:
    calibration = conclude(result.run)
    by_truth = result.fails_by_truth
    return {
        'model': result.label,
        'effects': [effect.name for effect in result.run.model.effects],
        SCALE_FACTOR: calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'coefficients': coefficient_table(calibration),
        'converged': calibration.converged,
        'heading_rms_deg': result.heading_rms_deg,
        'blind_drift_deg': _drift(result.drift),
        'drift_fell_sigma': result.drift_sigma,
        'log_likelihood_gain': result.gain,
        'log_likelihood_gain_sigma': result.gain_sigma,
        'nis_per_dof': nis_per_dof(result.run),
        'fails_where': [_failure(failure) for failure in result.fails_where],
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
