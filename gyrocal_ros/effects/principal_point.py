"""The optical axis meets the image at another pixel than the calibration says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange

BY_CENTRE = np.eye(2)
"""Derivative of a pixel by the principal point."""


@dataclass(frozen=True)
class PrincipalPoint:
    """True principal point = that of camera_info plus (u0, v0)."""

    about: ClassVar[Explanation] = Explanation(
        physics='The optical axis meets the image elsewhere than the calibration says, because lens '
        'and image sensor have moved against each other or images are cropped. The whole image seems '
        'shifted by the same number of pixels, much as if the camera were tilted.',
        equation='(u, v) = (u, v)_camera_info + (u0, v0)',
        usual_size='1 to 10 px',
        best_motion='full turns on the spot; corners at the border of the image distinguish it from a tilt',
        twins=('camera_tilt', 'camera_position', 'wheel_scale'),
        source='Zhang 2000, A flexible new technique for camera calibration, IEEE Transactions on '
        'Pattern Analysis and Machine Intelligence 22(11)',
        may_break_the_filter=True,
        example=(5.0, 5.0),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'camera'
    name: str = 'principal_point'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('u0', 'px', prior_std=5.0, typical=TypicalRange(1.0, 10.0)),
        Coefficient('v0', 'px', prior_std=5.0, typical=TypicalRange(1.0, 10.0)),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the camera with its true principal point."""
        u0, v0 = map(float, values)
        return replace(camera, cx_px=camera.cx_px + u0, cy_px=camera.cy_px + v0), mount

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the motion of the pixels with the principal point."""
        by_values = np.empty((len(seen.pixels), 2, 2))
        by_values[:] = BY_CENTRE
        return by_values
