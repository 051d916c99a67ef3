"""The axis of an effect, and its curve before it is added."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrocal_ros.diagnose.analysis.shapes import FORCE, HEADING, RATE, TEMPERATURE_C, TIME
from gyrocal_ros.diagnose.series.effect_axis import curve_before_adding, effect_axis
from gyrocal_ros.diagnose.series.error_curves import ErrorCurve
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.covariate import covariate_bias

DEG = math.radians(1.0)
VOLTAGE = 'battery_state.voltage'


@pytest.mark.parametrize(
    ('name', 'axis'),
    [
        ('scale_asymmetry', (RATE, False)),
        ('scale_cubic', (RATE, False)),
        ('bias_temperature', (TEMPERATURE_C, False)),
        ('scale_temperature', (TEMPERATURE_C, True)),
        ('bias_warmup', (TIME, False)),
        ('g_sensitivity', (FORCE, False)),
        (f'covariate_bias:{VOLTAGE}', (VOLTAGE, False)),
        (f'covariate_scale:{VOLTAGE}', (VOLTAGE, True)),
        ('bias_curve:heading', (HEADING, False)),
        ('gyro_lag', None),
        ('turn_hysteresis', None),
        ('focal_length', None),
        ('gyro_noise', None),
    ],
)
def test_each_effect_has_its_axis(name: str, axis: tuple[str, bool] | None) -> None:
    assert effect_axis(find_effect(name)) == axis


def curve(knots: list[float]) -> ErrorCurve:
    return ErrorCurve(np.array(knots), np.zeros(len(knots)), np.zeros(len(knots)))


def test_by_the_rate_the_straight_line_is_the_scale_factors() -> None:
    """Of `c |w|`, sampled evenly, what a straight line leaves is `c |w|` less its mean."""
    effect = find_effect('scale_asymmetry')
    proposed = curve_before_adding(effect, np.array([0.01]), curve([-60.0, -30.0, 0.0, 30.0, 60.0]))
    assert proposed is not None
    expected = 0.01 * DEG * (np.abs(proposed.knots) - 36.0)
    np.testing.assert_allclose(proposed.values, expected, atol=1e-5)


def test_a_scale_over_the_temperature_is_a_part_of_the_rate() -> None:
    effect = find_effect('scale_temperature')
    proposed = curve_before_adding(effect, np.array([1e-3]), curve([20.0, 24.0, 28.0]))
    assert proposed is not None
    np.testing.assert_allclose(proposed.values, 1e-3 * (proposed.knots - 24.0), atol=1e-9)


def test_a_recorded_signal_may_be_far_from_what_a_sketch_shows() -> None:
    effect = covariate_bias(VOLTAGE, reference=15.0)
    proposed = curve_before_adding(effect, np.array([0.02]), curve([10.0, 15.0, 25.0]))
    assert proposed is not None
    slope = np.diff(proposed.values) / np.diff(proposed.knots)
    np.testing.assert_allclose(slope, 0.02, rtol=1e-6)
