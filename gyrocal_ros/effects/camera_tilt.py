"""The camera does not look in the direction that its mounting gives."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange


@dataclass(frozen=True)
class CameraTilt:
    """A small rotation about the optical frame's x and y, `R_bc' = R_bc R(tx, ty)`.

    Applied after the given transform, it yields the true mounting.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='The camera does not look quite where its mounting says: a bent bracket, a screw '
        'tightened unevenly, a tilted lens. When the robot turns on the spot, the ceiling then turns '
        'about another point of the image than expected. It is the tilt against the IMU: one that is mounted '
        'at an angle looks the same.',
        equation='R_bc = R_bc,given R(x, y)',
        usual_size='0.5 to 3 deg',
        best_motion='full turns on the spot',
        twins=('principal_point',),
        source='Kelly and Sukhatme 2011, Visual-inertial sensor fusion: localization, mapping and '
        'sensor-to-sensor self-calibration, International Journal of Robotics Research 30(1)',
        may_break_the_filter=True,
        example=(math.radians(1.0), math.radians(1.0)),
        shown_against='image',
    )
    acts_on: ClassVar[Place] = 'camera'
    rotates_camera: ClassVar[bool] = True
    name: str = 'camera_tilt'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'x',
            'rad',
            prior_std=math.radians(2.0),
            typical=TypicalRange(math.radians(0.3), math.radians(3.0)),
        ),
        Coefficient(
            'y',
            'rad',
            prior_std=math.radians(2.0),
            typical=TypicalRange(math.radians(0.3), math.radians(3.0)),
        ),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the tilted mounting."""
        tilt = rotation_from_euler(np.array([values[0], values[1], 0.0]))
        return camera, replace(mount, R_bs=mount.R_bs @ tilt)

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the rotation of the points, `dm_c = -t x m_c`; the y axis is itself tilted about x."""
        return pixels_by_tilt(seen.points_c, seen.by_point, float(values[0]))


@compiled
def pixels_by_tilt(points_c: Array, by_point: Array, tilt_rad: float) -> Array:
    """Return the derivative (m, r, 2) of measurements by a tilt of the camera about x and y.

    Args:
        points_c: (m, 3) in the optical frame.
        by_point: (m, r, 3) derivative of the measurements by them.
        tilt_rad: tilt about x.
    """
    c, s = math.cos(tilt_rad), math.sin(tilt_rad)
    # Rows x, y, z of a point; its derivative (3,) by the rotation about x and about y, interleaved.
    turns = np.array(
        [
            [0.0, 0.0, 0.0, s, 0.0, c],
            [0.0, -s, 0.0, 0.0, -1.0, 0.0],
            [0.0, -c, 1.0, 0.0, 0.0, 0.0],
        ]
    )
    by_tilt: Array = by_point @ (points_c @ turns).reshape(-1, 3, 2)
    return by_tilt
