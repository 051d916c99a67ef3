"""Every effect hidden in a recording without noise: with it in the model the innovations vanish."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import TruthSample, WheelSample
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.effects.traits import is_noise
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.sensors import SensorErrors, without_noise
from gyrocal_ros.sim.world import SimSource

PERFECT = replace(without_noise(SensorErrors()), track_error=0.0, force_bias_m_s2=0.0)
SHORT = replace(SCENARIOS['cleaning'], duration_s=20.0, errors=PERFECT)
DEG = math.radians(1.0)
NOISE_PX = 0.02
"""Noise of the best features of a tracker."""
LEFT_OVER = 0.03
"""Largest root mean square of the innovations in sigma: interpolation of samples and estimates of signals."""
VIBRATION_LEFT_OVER = 0.05
"""The same for an effect of the vibration: a variance of the samples of 0.05 s is known to a fifth only."""

HIDDEN: dict[str, tuple[Effect, tuple[float, ...]]] = {
    name: (find_effect(name), values)
    for name, values in {
        'scale_asymmetry': (0.01,),
        'scale_quadratic': (0.005,),
        'scale_cubic': (0.006,),
        'scale_power_4': (0.003,),
        'bias_warmup': (DEG, 100.0),
        'bias_temperature': (0.1 * DEG,),
        'scale_temperature': (5e-4,),
        'g_sensitivity': (0.1 * DEG, -0.1 * DEG),
        'cross_axis': (0.02, -0.03),
        'gyro_lag': (0.03,),
        'rate_saturation': (50.0 * DEG,),
        'rate_deadband': (0.4 * DEG,),
        'vibration_rectification': (0.5 * DEG,),
        'turn_hysteresis': (0.2 * DEG, 5.0),
        'covariate_bias:fan_speed.data': (0.3e-4 * DEG,),
        'covariate_scale:fan_speed.data': (1e-6,),
        'camera_time_offset': (-0.03,),
        'rolling_shutter': (0.008,),
        'wheel_scale': (0.1,),
        'turn_slip': (0.02,),
        'lateral_drift': (0.02, -0.01),
        'camera_tilt': (0.02, -0.03),
        'camera_position': (0.02, -0.01),
        'focal_length': (0.02,),
        'principal_point': (5.0, -3.0),
        'radial_distortion': (0.03, -0.01),
    }.items()
}
HIDDEN['turn_hysteresis by side'] = TurnHysteresis(driven_by='side'), (0.2 * DEG, 5.0)
HIDDEN |= {
    name: (OUT_OF_LIBRARY[name], values)
    for name, values in {
        'stranger_knock': (0.3 * DEG, 9.0),
        'stranger_speed_bias': (DEG,),
        'stranger_supply_kink': (0.01, 16.3),
    }.items()
}


def in_memory(source: SimSource) -> InMemorySource:
    """Simulate once, to run the filter on it several times."""
    return InMemorySource(source.name, source.rig, source.span, tuple(source.measurements()))


def known(effect: Effect, values: tuple[float, ...]) -> Effect:
    """Return the effect with known coefficients."""
    items = tuple(
        replace(item, prior_mean=value, prior_std=0.0)
        for item, value in zip(effect.coefficients, values, strict=True)
    )
    return replace(effect, coefficients=items)  # type: ignore[type-var]


def run_with(source: InMemorySource, *effects: Effect) -> Run:
    return calibrate(source, Config(), SensorModel('m', BiasModel(), (find_effect('scale_factor'), *effects)))


def left_over(run: Run) -> float:
    """Return the root mean square of the innovations, in the standard deviations of a filter with noise.

    The filter learns that features without noise are more exact than any tracker's, which is made up for.
    """
    history = run.history
    part = np.minimum(history.pixel_noise_px / NOISE_PX, 1.0)
    return math.sqrt(float(history.nis @ part**2) / history.dof.sum())


def scale_error_sigma(run: Run, scale_factor: float) -> float:
    history, place = run.history, COEFFICIENTS_START
    return float((1.0 + history.mean[-1, place] - scale_factor) / history.std[-1, place])


def test_every_effect_is_among_the_hidden_ones() -> None:
    """All but a play: no reading tells when it is crossed, so that innovations are left there."""
    corrected = {name for name, effect in EFFECTS.items() if not is_noise(effect)}
    assert set(HIDDEN) >= corrected - {'scale_factor', 'mount_backlash'}
    assert set(HIDDEN) >= set(OUT_OF_LIBRARY)


@pytest.mark.slow
@pytest.mark.parametrize('name', HIDDEN)
def test_with_the_effect_in_the_model_the_innovations_vanish(name: str) -> None:
    effect, values = HIDDEN[name]
    shaking = SensorErrors().vibration_m_s2 if name == 'vibration_rectification' else 0.0
    scenario = replace(SHORT, errors=replace(PERFECT, vibration_m_s2=shaking))
    source = SimSource(scenario, 3, hidden=(HiddenEffect(effect, values),))
    measured, true_scale = in_memory(source), source.truth.scale_factor
    complete = run_with(measured, known(source.hidden[0].effect, values))
    most = VIBRATION_LEFT_OVER if shaking else LEFT_OVER
    assert left_over(complete) < most
    assert abs(scale_error_sigma(complete, true_scale)) < 0.3
    without = run_with(measured)
    assert max(left_over(without) / most, abs(scale_error_sigma(without, true_scale))) > 1.0


@pytest.mark.slow
def test_effects_hidden_together_add_up() -> None:
    names = (
        'gyro_lag',
        'scale_cubic',
        'bias_warmup',
        'turn_slip',
        'wheel_scale',
        'camera_tilt',
        'focal_length',
    )
    hidden = tuple(HiddenEffect(*HIDDEN[name]) for name in names)
    source = SimSource(SHORT, 3, hidden=hidden)
    run = run_with(in_memory(source), *(known(item.effect, item.values) for item in hidden))
    assert left_over(run) < LEFT_OVER
    assert abs(scale_error_sigma(run, source.truth.scale_factor)) < 0.3


@pytest.mark.slow
def test_the_robot_moves_as_it_does_without_hidden_effects() -> None:
    """Effects change the readings; only the ground changes the motion."""
    plain = [item for item in SimSource(SHORT, 3).measurements() if isinstance(item, TruthSample)]
    for name, (effect, values) in HIDDEN.items():
        source = SimSource(SHORT, 3, hidden=(HiddenEffect(effect, values),))
        time_s = np.array([5.0, 20.0])
        moved = source.truth.position(time_s) - SimSource(SHORT, 3).truth.position(time_s)
        assert np.any(moved) == (name == 'lateral_drift')
        assert source.rig.camera == SimSource(SHORT, 3).rig.camera
    assert plain[-1].position_m == tuple(SimSource(SHORT, 3).truth.position(np.array([20.0]))[0].tolist())


def test_wheels_at_rest_stay_at_rest_whatever_is_hidden() -> None:
    hidden = tuple(HiddenEffect(*HIDDEN[name]) for name in ('turn_slip', 'wheel_scale', 'lateral_drift'))
    resting = [
        item for item in SimSource(SHORT, 3, hidden=hidden).measurements() if isinstance(item, WheelSample)
    ]
    assert all(item.speed_m_s == 0.0 and item.yaw_rate_rad_s == 0.0 for item in resting[:140])


def test_a_covariate_effect_counts_from_the_mean_of_its_signal() -> None:
    effect = find_effect('covariate_bias:battery_state.voltage')
    source = SimSource(SHORT, 3, hidden=(HiddenEffect(effect, (1e-3,)),))
    assert source.hidden[0].effect.reference == pytest.approx(16.2, abs=0.2)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ('name', 'values', 'message'),
    [
        ('gyro_lag', (0.01, 0.02), 'gyro_lag: needs 1 values, not 2'),
        ('covariate_bias:fan_sped.data', (1.0,), "did you mean 'fan_speed.data'"),
        ('gyro_lag', (-0.01,), 'gyro_lag: cannot be -0.01'),
        ('scale_cubic', (3.0,), 'too strong'),
    ],
)
def test_effects_that_cannot_be_hidden_are_refused(
    name: str, values: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        list(SimSource(SHORT, 3, hidden=(HiddenEffect(find_effect(name), values),)).measurements())
