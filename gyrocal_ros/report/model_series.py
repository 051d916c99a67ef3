"""What pages about several models show that does not stand in a run as it is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.comparison import ModelResult
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.report.series import heading_error

MOST_PLACES = 12
"""No more places where models fail are drawn than these, the worst of each model first."""


@dataclass(frozen=True, slots=True)
class CoefficientOfModel:
    """What one model says of a coefficient."""

    model: str
    value: float
    std: float
    is_kept: bool = True


def coefficients(runs: Iterable[tuple[str, Run, bool]]) -> dict[str, list[CoefficientOfModel]]:
    """What each model says of each coefficient, by the coefficient's name with its unit, angles in degrees.

    Args:
        runs: name of the model, its run, and whether it was kept.
    """
    told: dict[str, list[CoefficientOfModel]] = {}
    for model, run, is_kept in runs:
        known = conclude(run)
        for name, unit, value, std in zip(known.names, known.units, known.values, known.stds, strict=True):
            size, shown = (np.degrees(1.0), f'deg{unit[3:]}') if unit.startswith('rad') else (1.0, unit)
            item = CoefficientOfModel(model, float(size * value), float(size * std), is_kept)
            told.setdefault(f'{name} ({shown})', []).append(item)
    return told


def slam_errors_deg(rivals: Iterable[ModelResult]) -> dict[str, tuple[Array, Array]]:
    """Heading error of the filter against the ground truth, where it is recorded: times and errors."""
    errors = {rival.label: heading_error(rival.run) for rival in rivals}
    return {
        label: (error.time_s, np.degrees(error.error_rad))
        for label, error in errors.items()
        if error is not None
    }


def failures_by_model(rivals: Iterable[ModelResult]) -> dict[str, dict[str, float]]:
    """Sigma by regime in which a model fails, by the model's label; a few regimes, the worst ones."""
    found = {rival.label: _by_regime(rival.fails_where) for rival in rivals}
    worst: dict[str, float] = {}
    for rows in found.values():
        for regime, sigma in rows.items():
            worst[regime] = max(sigma, worst.get(regime, 0.0))
    chosen = sorted(worst, key=lambda regime: worst[regime], reverse=True)[:MOST_PLACES]
    return {
        label: {regime: rows[regime] for regime in chosen if regime in rows} for label, rows in found.items()
    }


def _by_regime(failures: Iterable[Failure]) -> dict[str, float]:
    rows: dict[str, float] = {}
    for failure in failures:
        place = failure.regime or f'{failure.from_s:.0f} to {failure.to_s:.0f} s'
        rows[place] = max(failure.sigma, rows.get(place, 0.0))
    return rows
