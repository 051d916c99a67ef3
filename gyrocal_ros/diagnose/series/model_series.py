"""Several models on one recording, side by side: coefficients, heading errors, places where they fail."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.comparison import ModelResult
from gyrocal_ros.diagnose.analysis.drift import heading_error
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.pipeline.calibration import conclude

MAX_PLACES = 12
"""Maximum number of places where models fail that are compared; the worst of any model are taken."""


@dataclass(frozen=True, slots=True)
class CoefficientEstimate:
    """The estimate of a coefficient in one model."""

    model: str
    value: float
    std: float
    is_kept: bool = True
    """False for a model that was tried and left out."""


def coefficients(runs: Iterable[tuple[str, Run, bool]]) -> dict[str, list[CoefficientEstimate]]:
    """Collect the estimates of each coefficient by its name and unit, angles in degrees.

    Args:
        runs: label of the model, its run, and whether the model was kept.
    """
    found: dict[str, list[CoefficientEstimate]] = {}
    for model, run, is_kept in runs:
        known = conclude(run)
        for name, unit, value, std in zip(known.names, known.units, known.values, known.stds, strict=True):
            size, shown = (np.degrees(1.0), f'deg{unit[3:]}') if unit.startswith('rad') else (1.0, unit)
            item = CoefficientEstimate(model, float(size * value), float(size * std), is_kept)
            found.setdefault(f'{name} ({shown})', []).append(item)
    return found


def slam_errors_deg(results: Iterable[ModelResult]) -> dict[str, tuple[Array, Array]]:
    """Return times and heading errors of the filter by label of the model; only those with ground truth."""
    errors = {result.label: heading_error(result.run) for result in results}
    return {
        label: (error.time_s, np.degrees(error.error_rad))
        for label, error in errors.items()
        if error is not None
    }


def failures_by_model(results: Iterable[ModelResult]) -> dict[str, dict[str, float]]:
    """Return the sigma of each failure by label of the model and by place, for the worst places."""
    found = {result.label: _by_place(result.fails_where) for result in results}
    worst: dict[str, float] = {}
    for rows in found.values():
        for place, sigma in rows.items():
            worst[place] = max(sigma, worst.get(place, 0.0))
    chosen = sorted(worst, key=lambda place: worst[place], reverse=True)[:MAX_PLACES]
    return {label: {place: rows[place] for place in chosen if place in rows} for label, rows in found.items()}


def _by_place(failures: Iterable[Failure]) -> dict[str, float]:
    rows: dict[str, float] = {}
    for failure in failures:
        place = failure.regime or f'{failure.from_s:.0f} to {failure.to_s:.0f} s'
        rows[place] = max(failure.sigma, rows.get(place, 0.0))
    return rows
