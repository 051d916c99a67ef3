"""Rate error left over as a function of each recorded signal, before and after effects were added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.heading_filter import TURNING_RAD_S
from gyrocal_ros.diagnose.analysis.shapes import RATE, Shape, axes, hats, shapes
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.ekf.history.run import Run

MAX_CURVES = 6
"""Maximum number of signals in a report."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCurve:
    """The rate error as a function of a signal, less its mean."""

    knots: Array
    values: Array
    """(k,) rad/s for the bias, 1 for the scale."""
    stds: Array


@dataclass(frozen=True, slots=True, eq=False)
class ErrorBySignal:
    """The error of the bias or the scale as a function of one signal, before and after effects were added."""

    signal: str
    of_scale: bool
    before: ErrorCurve
    after: ErrorCurve | None
    """None where nothing was added."""
    by_effects: ErrorCurve | None = None
    """Curve of the effects that were added, which should go through `before`; None where not computed."""
    proposed: Mapping[str, ErrorCurve] = field(default_factory=dict)
    """Curves by their labels: of the effect that may be added and its closest rival, or of a learned law and
    its closed forms."""


def errors_by_signal(searched: Search) -> list[ErrorBySignal]:
    """Return the curves before and after the search, the one that explains most first."""
    first, last = searched.first, searched.last
    before = {_key(shape): shape for shape in reversed(shapes(first.run, first.seen))}
    after = {} if last is first else {_key(shape): shape for shape in shapes(last.run, last.seen)}
    return [
        ErrorBySignal(
            signal=shape.signal,
            of_scale=shape.of_scale,
            before=centred(shape),
            after=centred(after[key]) if key in after else None,
        )
        for key, shape in reversed(before.items())
    ][:MAX_CURVES]


def centred(shape: Shape) -> ErrorCurve:
    """Subtract the mean over the knots, so that the first knot, the reference, has a standard deviation too.

    By the rate a straight line is subtracted, which is only another scale factor.
    """
    free = np.flatnonzero(np.isfinite(shape.values) & (shape.stds > 0.0))
    covariance = np.zeros((len(shape.knots), len(shape.knots)))
    covariance[np.ix_(free, free)] = shape.fit.covariance
    known = np.flatnonzero(np.isfinite(shape.values))
    knots = shape.knots[known]
    projection = _centring(knots, shape.signal)
    spread = projection @ covariance[np.ix_(known, known)] @ projection.T
    return ErrorCurve(knots, projection @ shape.values[known], np.sqrt(np.maximum(np.diagonal(spread), 0.0)))


def curve_by_effects(
    run: Run, added: int, signal: str, like: ErrorCurve, of_scale: bool
) -> ErrorCurve | None:
    """Express the rate correction by the effects that were added last as a function of a signal.

    Args:
        run: run of the model with these effects.
        added: number of effects that were added.
        signal: name of the signal.
        like: curve whose knots are used.
        of_scale: True for an error of the scale, False for one of the bias.

    Returns:
        None where they add nothing to the rate: effects of the camera or the wheels.
    """
    history = run.history
    count = sum(len(effect.coefficients) for effect in run.model.effects[len(run.model.effects) - added :])
    first = run.state.coefficient_count - count
    added_rad = history.columns[:, first:] @ run.state.coefficients[first:]
    values = dict(axes(run)).get(signal)
    if values is None or not np.any(added_rad):
        return None
    rate = history.turn_rad / history.dt_s
    parts = hats(np.where(np.isfinite(values), values, like.knots[0]), like.knots, signal)
    columns = parts * np.where(np.abs(rate) > TURNING_RAD_S, rate, 0.0)[:, None] if of_scale else parts
    basis = np.concatenate([columns, rate[:, None]], axis=1) * np.sqrt(history.dt_s)[:, None]
    fitted = np.linalg.lstsq(basis, added_rad / np.sqrt(history.dt_s), rcond=None)[0][: len(like.knots)]
    return ErrorCurve(like.knots, _centring(like.knots, signal) @ fitted, np.zeros(len(fitted)))


def _centring(knots: Array, signal: str) -> Array:
    """Return the projection (k, k) that removes the mean over the knots; by the rate, a straight line."""
    basis = np.stack([np.ones(len(knots)), knots], axis=1)[:, : 2 if signal == RATE else 1]
    without: Array = np.eye(len(knots)) - basis @ np.linalg.pinv(basis)
    return without


def _key(shape: Shape) -> tuple[str, bool]:
    return shape.signal, shape.of_scale
