"""The lens magnifies more or less than its calibration says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange


@dataclass(frozen=True)
class FocalLength:
    """True focal length = (1 + s) times that of camera_info."""

    about: ClassVar[Explanation] = Explanation(
        physics='The lens magnifies more or less than its calibration says: refocused, warmed up, or '
        'calibrated at another distance. Everything seems nearer to or farther from the image centre '
        'by the same fraction. A ceiling that is a little lower would look almost the same, so few '
        'motions show it.',
        equation='f = (1 + s) f_camera_info',
        usual_size='0.5 to 3 %',
        best_motion='full turns on the spot and drives in between; corners at the border of the image',
        twins=('wheel_scale', 'radial_distortion'),
        source='Zhang 2000, A flexible new technique for camera calibration, IEEE Transactions on '
        'Pattern Analysis and Machine Intelligence 22(11)',
        may_break_the_filter=True,
        example=(0.02,),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'camera'
    least_shown_part: ClassVar[float] = 0.9
    """Scale factors of the x and y gyros that are a per cent off look like a focal length: both say how far
    points move in the image where the robot tilts."""
    name: str = 'focal_length'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('s', '1', prior_std=0.02, typical=TypicalRange(0.015, 0.03)),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the camera with its true focal length."""
        s = float(values[0])
        return replace(camera, fx_px=(1.0 + s) * camera.fx_px, fy_px=(1.0 + s) * camera.fy_px), mount

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the motion of the pixels away from the image centre."""
        centre = np.array([seen.camera.cx_px, seen.camera.cy_px])
        return ((seen.pixels - centre) / (1.0 + values[0]))[:, :, None]
