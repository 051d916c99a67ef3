"""Errors of the camera that the filter tests, and the words that tell them to the user."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.camera_tilt import CameraTilt
from gyrocal_ros.effects.camera_time_offset import CameraTimeOffset
from gyrocal_ros.effects.principal_point import PrincipalPoint
from gyrocal_ros.effects.radial_distortion import RadialDistortion
from gyrocal_ros.effects.rolling_shutter import RollingShutter
from gyrocal_ros.model.sensor import Effect

LENS, TILT, CENTRE = 'the distortion in camera_info', 'the camera looks', 'the principal point in camera_info'
SHUTTER, TIME = 'the rows of an image are exposed', 'the images and the gyro are'
"""First words of the faults; the remedy follows after a semicolon."""
ASK_HOW_MUCH = 'a diagnosis tells by how much'
ASK_WHICH = 'a diagnosis tells which, and by how much'


def lens_fault(errors: Array, sigma: float) -> str:
    """Return what is wrong with the distortion, k1 and k2 (2,)."""
    k1, k2 = errors
    return (
        f'{LENS} does not fit the images ({sigma:.0f} sigma): k1 {k1:+.2g}, k2 {k2:+.2g} would fit '
        'better; calibrate the camera again'
    )


def tilt_fault(errors: Array, sigma: float) -> str:
    """Return by how much the camera is tilted, (2,) in rad."""
    tilt_deg = math.degrees(float(np.linalg.norm(errors)))
    return (
        f'{TILT} {tilt_deg:.1f} deg beside the direction of its transform, or the IMU is mounted at an '
        f'angle, or the principal point in camera_info is wrong ({sigma:.0f} sigma); {ASK_WHICH}'
    )


def centre_fault(errors: Array, sigma: float) -> str:
    """Return by how much the principal point is off, (2,) in px."""
    u, v = errors
    return (
        f'{CENTRE} is off by {u:+.1f}, {v:+.1f} px, or the camera looks beside the direction of its '
        f'transform ({sigma:.0f} sigma); {ASK_WHICH}'
    )


def shutter_fault(errors: Array, sigma: float) -> str:
    """Return how long the camera reads out an image, (1,) in s."""
    readout_ms = 1e3 * abs(float(errors[0]))
    return f'{SHUTTER} one after the other, within {readout_ms:.0f} ms ({sigma:.0f} sigma); {ASK_HOW_MUCH}'


def time_fault(errors: Array, sigma: float) -> str:
    """Return how far the stamps of images and gyro are apart, (1,) in s."""
    offset_ms = 1e3 * float(errors[0])
    late = 'the images are stamped late' if offset_ms > 0.0 else 'the gyro lags, or images are stamped early'
    digits = 1 if abs(offset_ms) >= 0.1 else 2
    return f'{TIME} {abs(offset_ms):.{digits}f} ms apart ({sigma:.0f} sigma): {late}; {ASK_WHICH}'


def changing_time_fault(errors: Array, sigma: float) -> str:
    """Return that the stamps of images and gyro are apart by another time again, (1,) in s."""
    return (
        f'{TIME} apart by changing times, now {1e3 * float(errors[0]):+.1f} ms ({sigma:.0f} sigma): their '
        f'clocks drift, or the model lacks an effect of the gyro; {ASK_WHICH}'
    )


@dataclass(frozen=True, slots=True)
class CameraError:
    """An error of the camera, as an effect that the model lacks."""

    effect: Effect
    fault: Callable[[Array, float], str]
    """Tells it by its values and its significance in sigma."""


CAMERA_ERRORS = (
    CameraError(RadialDistortion(), lens_fault),
    CameraError(CameraTilt(), tilt_fault),
    CameraError(PrincipalPoint(), centre_fault),
    CameraError(RollingShutter(), shutter_fault),
    CameraError(CameraTimeOffset(), time_fault),
)
