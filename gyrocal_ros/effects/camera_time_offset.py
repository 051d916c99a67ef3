"""The images are stamped late or early relative to the clock of the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange


@dataclass(frozen=True)
class CameraTimeOffset:
    """Stamp minus true time of exposure: an image stamped t was taken at t - offset.

    The filter uses each image at its true time; the derivative is the motion of the pixels.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='The stamps of the images are not the times of their exposure: the camera stamps them '
        'when they have been read out or have arrived, or its clock has an offset. While the robot '
        'turns, the heading that an image shows is then that of a little earlier or later. At rest '
        'and between turns nothing shows.',
        equation='exposure = stamp - offset',
        usual_size='5 to 60 ms',
        best_motion='turns that start and stop abruptly',
        twins=('gyro_lag',),
        source='Li and Mourikis 2014, Online temporal calibration for camera-IMU systems: theory and '
        'algorithms, International Journal of Robotics Research 33(7)',
        may_break_the_filter=True,
        example=(0.02,),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'time'
    name: str = 'camera_time_offset'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('offset', 's', prior_std=0.03, typical=TypicalRange(0.003, 0.06)),
    )
