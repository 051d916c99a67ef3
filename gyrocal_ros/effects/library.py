"""The effects of the package: one physical effect per file, and this table of contents."""

from __future__ import annotations

from collections.abc import Callable

from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.bias_instability import BiasInstability
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
from gyrocal_ros.effects.gyro_noise import GyroNoise
from gyrocal_ros.effects.lateral_drift import LateralDrift
from gyrocal_ros.effects.mount_backlash import MountBacklash
from gyrocal_ros.effects.principal_point import PrincipalPoint
from gyrocal_ros.effects.radial_distortion import RadialDistortion
from gyrocal_ros.effects.rate_deadband import RateDeadband
from gyrocal_ros.effects.rate_noise import RateNoise
from gyrocal_ros.effects.rate_saturation import RateSaturation
from gyrocal_ros.effects.rolling_shutter import RollingShutter
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.effects.scale_asymmetry import ScaleAsymmetry
from gyrocal_ros.effects.scale_temperature import ScaleTemperature
from gyrocal_ros.effects.stretched_path import StretchedPath
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.effects.turn_slip import TurnSlip
from gyrocal_ros.effects.vibration_rectification import VibrationRectification
from gyrocal_ros.effects.wheel_scale import WheelScale

SHIPPED: tuple[LibraryEffect, ...] = (
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
    MountBacklash(),
    CameraTimeOffset(),
    RollingShutter(),
    WheelScale(),
    TurnSlip(),
    LateralDrift(),
    CameraTilt(),
    CameraPosition(),
    FocalLength(),
    PrincipalPoint(),
    RadialDistortion(),
    GyroNoise(),
    RateNoise(),
    BiasInstability(),
)

DISTURBANCES: tuple[LibraryEffect, ...] = (StretchedPath(),)
"""What images show that is no fault of a sensor: a diagnosis tries them, and does not name them."""

COVARIATE_EFFECTS: dict[str, Callable[[str], LibraryEffect]] = {
    'covariate_bias': covariate_bias,
    'covariate_scale': covariate_scale,
}
"""Effects whose names contain their signal, `covariate_bias:battery_state.current`."""

SCALE_FACTOR = 'scale_factor'
"""Name of the first effect of every sensor model."""

PAPER_EFFECTS: dict[int, LibraryEffect] = {8: BiasWarmup()}
"""Effects that have an equation of their own in Lee et al. 2012, by the number of the equation."""
