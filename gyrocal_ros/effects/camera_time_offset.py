"""The images are stamped late or early against the clock of the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.model.sensor import Coefficient, Place


@dataclass(frozen=True)
class CameraTimeOffset:
    """Stamp minus true time of exposure: an image stamped t was taken at t - offset.

    The filter looks at each image at its true time; the derivative is the motion of the pixels.
    """

    acts_on: ClassVar[Place] = 'time'
    name: str = 'camera_time_offset'
    coefficients: tuple[Coefficient, ...] = (Coefficient('offset', 's', prior_std=0.03),)
