"""The lens distorts the image differently than its calibration says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.camera import pixels_by_radial_coefficients
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange


@dataclass(frozen=True)
class RadialDistortion:
    """True k1, k2 of the lens model = those of camera_info plus these coefficients."""

    about: ClassVar[Explanation] = Explanation(
        physics='The lens bends straight lines outwards or inwards, more or less than its '
        'calibration says. Corners near the middle of the image are where they should be, those near '
        'the border are not.',
        equation='(x, y) (1 + k1 r^2 + k2 r^4)',
        usual_size='k1 to 0.05, k2 to 0.01',
        best_motion='turns and drives that carry corners from the middle of the image to its border',
        twins=('focal_length',),
        source='Brown 1971, Close-range camera calibration, Photogrammetric Engineering 37(8)',
        may_break_the_filter=True,
        example=(0.02, 0.005),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'camera'
    name: str = 'radial_distortion'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k1', '1', prior_std=0.03, typical=TypicalRange(0.004, 0.03)),
        Coefficient('k2', '1', prior_std=0.01, typical=TypicalRange(0.001, 0.006)),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the camera with its true distortion."""
        k1, k2, *others = camera.distortion
        true = (k1 + float(values[0]), k2 + float(values[1]), *others)
        return replace(camera, distortion=true), mount

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the derivative of the lens with respect to k1 and k2, times the focal length."""
        return pixels_by_radial_coefficients(seen.camera, seen.points_c)
