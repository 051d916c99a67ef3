"""The rows of an image are exposed one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange

BY_READOUT = np.ones(1)


@dataclass(frozen=True)
class RollingShutter:
    """Time from the exposure of the first row of an image to that of the last one.

    The stamp is that of the middle row. The time is negative where the sensor reads from the last row to the
    first.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='Most cheap cameras expose and read one row after the other. While the robot turns, the last '
        'rows show a later heading than the first ones, and the image is sheared. At rest nothing '
        'shows.',
        equation='exposure = stamp + readout (v / rows - 1/2)',
        usual_size='5 to 35 ms',
        best_motion='fast turns on the spot',
        source='Li, Kim and Mourikis 2013, Real-time motion tracking on a cellphone using inertial sensing '
        'and a rolling-shutter camera, IEEE International Conference on Robotics and Automation',
        may_break_the_filter=True,
        example=(0.02,),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'shutter'
    name: str = 'rolling_shutter'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('readout', 's', prior_std=0.03, typical=TypicalRange(0.004, 0.035)),
    )

    def readout_s(self, values: Array) -> tuple[float, Array]:
        """Return the time from the first row to the last one, and the derivative (1,)."""
        return float(values[0]), BY_READOUT
