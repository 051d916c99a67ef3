"""The effect library: one physical effect a file, and this table of contents.

`model.yaml` names effects of this table; see `model_file` for reading and writing it.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.bias_temperature import BiasTemperature
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.camera_position import CameraPosition
from gyrocal_ros.effects.camera_tilt import CameraTilt
from gyrocal_ros.effects.camera_time_offset import CameraTimeOffset
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.effects.cross_axis import CrossAxis
from gyrocal_ros.effects.focal_length import FocalLength
from gyrocal_ros.effects.g_sensitivity import GSensitivity
from gyrocal_ros.effects.gyro_lag import GyroLag
from gyrocal_ros.effects.lateral_drift import LateralDrift
from gyrocal_ros.effects.principal_point import PrincipalPoint
from gyrocal_ros.effects.radial_distortion import RadialDistortion
from gyrocal_ros.effects.rate_deadband import RateDeadband
from gyrocal_ros.effects.rate_saturation import RateSaturation
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.effects.scale_asymmetry import ScaleAsymmetry
from gyrocal_ros.effects.scale_temperature import ScaleTemperature
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.effects.turn_slip import TurnSlip
from gyrocal_ros.effects.vibration_rectification import VibrationRectification
from gyrocal_ros.effects.wheel_scale import WheelScale
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel

EFFECTS: dict[str, LibraryEffect] = {
    effect.name: effect
    for effect in (
        scale_power(1),
        ScaleAsymmetry(),
        scale_power(2),
        scale_power(3),
        BiasWarmup(),
        BiasTemperature(),
        ScaleTemperature(),
        GSensitivity(),
        CrossAxis(),
        GyroLag(),
        RateSaturation(),
        RateDeadband(),
        VibrationRectification(),
        TurnHysteresis(),
        CameraTimeOffset(),
        WheelScale(),
        TurnSlip(),
        LateralDrift(),
        CameraTilt(),
        CameraPosition(),
        FocalLength(),
        PrincipalPoint(),
        RadialDistortion(),
    )
}

COVARIATE_EFFECTS: dict[str, Callable[[str], LibraryEffect]] = {
    'covariate_bias': covariate_bias,
    'covariate_scale': covariate_scale,
}
"""Effects that are named with their signal, `covariate_bias:battery_state.current`."""


def find_effect(name: str, where: str = '') -> LibraryEffect:
    """The effect of that name with its usual priors.

    Args:
        name: a name of the table, `scale_power_N` for a power above the third, or the name of a
            covariate effect with its signal behind a colon.
        where: file that names it, for the error message.

    Raises:
        ConfigError: there is no such effect.
    """
    if name not in EFFECTS and ':' not in name:
        from gyrocal_ros.effects.user import load_installed  # which imports this table

        load_installed()
    if name in EFFECTS:
        return EFFECTS[name]
    power = re.fullmatch(r'scale_power_([4-9])', name)
    if power:
        return scale_power(int(power.group(1)))
    kind, _, signal = name.partition(':')
    if kind in COVARIATE_EFFECTS and signal:
        return COVARIATE_EFFECTS[kind](signal)
    known = [*EFFECTS, 'scale_power_4', *(f'{kind}:SIGNAL' for kind in COVARIATE_EFFECTS)]
    raise ConfigError(f'there is no effect {name!r}', where=where, todo=did_you_mean(name, known))


def default_model() -> SensorModel:
    """The model that a robot starts with: one scale factor, and a bias that drifts."""
    return SensorModel('default', BiasModel(), (find_effect('scale_factor'),))
