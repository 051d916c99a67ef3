"""The axis of an effect: what its error goes with, and its curve there before it is added."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.shapes import FORCE, HEADING, RATE, TEMPERATURE_C, TIME
from gyrocal_ros.diagnose.series.error_curves import ErrorCurve
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.sketch import TURNING_RAD_S, motion_of_sketch, sketch
from gyrocal_ros.effects.traits import required_signals
from gyrocal_ros.model.sensor import Effect, GyroEffectOnReadings

_AXES = {
    'rate': RATE,
    'slow rate': RATE,
    'time': TIME,
    'temperature': TEMPERATURE_C,
    'force': FORCE,
    'heading': HEADING,
}
"""Axis of an error curve for what a sketch varies."""
POINTS = 101


def effect_axis(effect: Effect) -> tuple[str, bool] | None:
    """Return the signal of the error curve that shows an effect, and True if it shows in the scale.

    None for an effect on something else than the yaw rate, and for one that no signal alone determines.
    """
    if not isinstance(effect, LibraryEffect) or effect.acts_on != 'gyro':
        return None
    if isinstance(effect, GyroEffectOnReadings):
        return None
    shown = effect.about.shown_against
    signal = required_signals(effect)[0] if shown == 'signal' else _AXES.get(shown)
    if signal is None:
        return None
    return signal, signal != RATE and _vanishes_at_rest(effect)


def curve_before_adding(effect: LibraryEffect, values: Array, like: ErrorCurve) -> ErrorCurve | None:
    """Return the error that an effect would explain, over its axis, less what the error curve is less.

    Args:
        effect: an effect with an axis.
        values: (k,) its coefficients.
        like: error curve over that axis.
    """
    axis = effect_axis(effect)
    if axis is None:
        return None
    signal, of_scale = axis
    drawn = sketch(effect, [tuple(values.tolist())])
    added = np.radians(list(drawn.lines.values())[-1]) / (TURNING_RAD_S if of_scale else 1.0)
    x = np.linspace(like.knots[0], like.knots[-1], POINTS)
    # The sketch of an effect that follows a recorded signal is drawn against the signal less its reference.
    from_reference = float(getattr(effect, 'reference', 0.0))
    at_knots, at_x = (_extended(drawn.x + from_reference, added, where) for where in (like.knots, x))
    count = 2 if signal == RATE else 1
    weights = np.polyfit(like.knots, at_knots, count - 1)
    return ErrorCurve(x, at_x - np.polyval(weights, x), np.zeros(POINTS))


def _vanishes_at_rest(effect: Any) -> bool:
    """Return True if an effect contributes only while the robot turns."""
    block = motion_of_sketch(effect)
    at_rest = replace(block, rate_rad_s=np.zeros_like(block.rate_rad_s))
    term = effect.contribute(at_rest, np.array(effect.about.example), None)
    return not np.any(term.rate_rad_s) and not np.any(term.by_values)


def _extended(x: Array, y: Array, where: Array) -> Array:
    """Interpolate; beyond the ends continue the last slopes."""
    inside = np.interp(where, x, y)
    below = np.minimum(where - x[0], 0.0) * (y[1] - y[0]) / (x[1] - x[0])
    above = np.maximum(where - x[-1], 0.0) * (y[-1] - y[-2]) / (x[-1] - x[-2])
    extended: Array = inside + below + above
    return extended
