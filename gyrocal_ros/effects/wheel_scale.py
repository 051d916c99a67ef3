"""The wheels are larger or smaller than believed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place


@dataclass(frozen=True)
class WheelScale:
    """True distance = (1 + s) times odometry."""

    about: ClassVar[Explanation] = Explanation(
        physics='The wheels are larger or smaller than believed, by wear, tyre pressure, load or '
        'carpet that they sink into. Every distance by odometry is off by the same part. As the size '
        'of everything that the camera maps comes from the wheels, the map shrinks or grows along, '
        'and little contradicts it.',
        equation='d = (1 + s) d_odometry',
        usual_size='1 to 5 %',
        best_motion='full turns on the spot, which swing the camera through a circle of known size, '
        'and drives in between',
        twins=('focal_length', 'camera_position', 'principal_point'),
        source='Borenstein and Feng 1996, Measurement and correction of systematic odometry errors in '
        'mobile robots, IEEE Transactions on Robotics and Automation 12(6)',
        example=(0.03,),
        shown_against='distance',
    )
    acts_on: ClassVar[Place] = 'wheels'
    name: str = 'wheel_scale'
    coefficients: tuple[Coefficient, ...] = (Coefficient('s', '1', prior_std=0.03),)

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """`s d`."""
        return values[0] * block.distance_m, block.distance_m[:, None]
