"""What is notable about a heading reference, and about the gyro beside it."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Span
from gyrocal_ros.ekf.equations.heading import GYRO_LAG
from gyrocal_ros.ekf.history.run import Run, RunEvent
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.pipeline.reference_fit import ReferenceFit

MAX_MISFIT_DEG = 2.0
"""Largest rms difference of a usable reference from the best fit of the gyro, beyond its random walk."""
WALKED_PART = 0.5
"""The same in the random walk over the recording: a walk leaves a quarter beside a straight line (rms)."""
EXACT_STD, EXACT_SIGMA = 2.5e-4, 3.0
"""Standard deviation of a scale factor that is 1 within three of them from which that is hardly chance."""
ONE = 2e-4
"""Difference from 1 that the rules of integration make."""
REPORTED_OFFSET_S = 0.02
"""Smallest time offset that is reported."""


def reference_events(fitted: ReferenceFit, config: Config, span: Span, run: Run) -> Iterator[RunEvent]:
    """Yield an event for each notable property of the reference."""
    if abs(fitted.time_offset_s) >= REPORTED_OFFSET_S:
        late = 'late' if fitted.time_offset_s > 0.0 else 'early'
        offset_ms, std_ms = abs(fitted.time_offset_s) * 1e3, fitted.time_offset_std_s * 1e3
        late += '' if fitted.gyro_lag_s else ', or the gyro lags'
        text = f'the reference is stamped {offset_ms:.1f} +- {std_ms:.1f} ms too {late}; this is corrected'
        yield RunEvent(span.start_ns, text)
    if fitted.gyro_lag_s and GYRO_LAG not in run.model.coefficient_names:
        lag_ms, std_ms = fitted.gyro_lag_s * 1e3, fitted.gyro_lag_std_s * 1e3
        text = f'the gyro lags by {lag_ms:.1f} +- {std_ms:.1f} ms; `gyrocal improve` adds that to the model'
        yield RunEvent(span.start_ns, text)
    if fitted.time_constant_s > 0.0:
        lag_ms = fitted.time_constant_s * 1e3
        text = f'the reference smooths its headings (time constant {lag_ms:.0f} ms); this is corrected'
        yield RunEvent(span.start_ns, text)
    if scale_std := _std_of_one(run):
        text = (
            f'the scale factor is exactly 1 (+- {100.0 * scale_std:.2g} %), as if the reference were '
            'computed from this gyro; such a reference cannot calibrate it'
        )
        yield RunEvent(span.start_ns, text)
    expected_deg_s = config.gyro.bias_walk_deg_s
    if fitted.bias_walk_deg_s > expected_deg_s:
        times = fitted.bias_walk_deg_s / expected_deg_s
        text = (
            f'the bias of the gyro walks by {fitted.bias_walk_deg_s:.2g} deg/s/sqrt(s), {times:.0f} times '
            'the setting gyro.bias_walk_deg_s; `gyrocal diagnose` looks for the cause'
        )
        yield RunEvent(span.start_ns, text)
    outliers = int(run.history.rejected.sum())
    if outliers:
        text = f'outliers among the headings of the reference, which count little: {outliers}'
        yield RunEvent(span.start_ns, text)
    walked_deg = math.degrees(fitted.walk_rad) * math.sqrt(span.duration_s)
    misfit_deg = math.degrees(fitted.residual_rms_rad)
    if misfit_deg > math.hypot(MAX_MISFIT_DEG, WALKED_PART * walked_deg):
        yield RunEvent(
            span.start_ns,
            f'the reference does not fit the gyro: {misfit_deg:.1f} deg rms remain at best '
            f'(random walk {walked_deg:.1f} deg over the recording)',
        )


def _std_of_one(run: Run) -> float:
    """Return the standard deviation of a scale factor that is 1 beyond chance; 0 of any other."""
    std = float(run.history.std[-1, COEFFICIENTS_START]) if len(run.history.std) else math.inf
    is_one = abs(float(run.state.coefficients[0])) < max(EXACT_SIGMA * std, ONE)
    return std if is_one and std < EXACT_STD else 0.0
