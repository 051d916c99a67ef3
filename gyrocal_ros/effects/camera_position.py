"""The camera is not at the position that its mounting gives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange


@dataclass(frozen=True)
class CameraPosition:
    """Offset (x, y) of the mounting in body axes."""

    about: ClassVar[Explanation] = Explanation(
        physics='The camera is not where its mounting says. When the robot turns on the spot, the '
        'camera moves on a circle of another size, or starts from another side, than expected.',
        equation='p_bc = p_bc,given + (x, y, 0)',
        usual_size='5 to 20 mm',
        best_motion='full turns on the spot, at several places',
        twins=('principal_point', 'wheel_scale'),
        source='Kelly and Sukhatme 2011, Visual-inertial sensor fusion: localization, mapping and '
        'sensor-to-sensor self-calibration, International Journal of Robotics Research 30(1)',
        example=(0.01, 0.01),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'camera'
    name: str = 'camera_position'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('x', 'm', prior_std=0.02, typical=TypicalRange(0.004, 0.02)),
        Coefficient('y', 'm', prior_std=0.02, typical=TypicalRange(0.004, 0.02)),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the shifted mounting; the offset is in metres of the odometer."""
        shift = np.array([values[0], values[1], 0.0])
        return camera, replace(mount, p_bs=mount.p_bs + shift, shift=mount.shift + shift)

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the shift of the points by minus the offset, in the camera's axes and the points' scale."""
        return seen.by_point.dot(-seen.R_bc[:2].T) * seen.scale[:, None, None]
