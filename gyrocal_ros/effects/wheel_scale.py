"""The wheels are larger or smaller than assumed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Coefficient, Place, SeenPoints, TypicalRange

MIN_LEVER_M = 0.01
"""Minimum distance of the camera from the turning centre that is known accurately enough as a reference."""


@dataclass(frozen=True)
class WheelScale:
    """True distance = (1 + s) times odometry.

    No measurement determines the size of the map, so the filter keeps path and map in metres of the odometer;
    the variance of a state that stretched them would decrease by linearisation alone. In these metres the
    camera, whose position is known in true ones, is 1 + s times nearer to the turning centre. This is the
    only influence of s, and all that makes it observable.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='The wheels are larger or smaller than assumed, by wear, tyre pressure, load or '
        'carpet that they sink into. Every distance by odometry is wrong by the same fraction, and so '
        'is the size of everything that the camera maps. Nothing in the map contradicts it. Only in '
        'turns the camera moves on a circle whose true size is known, and which then looks too large '
        'or too small compared with the rest. Path and map stay in metres of the odometer: multiply '
        'them by 1 + s for true ones.',
        equation='d = (1 + s) d_odometry',
        usual_size='1 to 5 %',
        best_motion='full turns on the spot, which move the camera on a circle of known size, '
        'and drives in between',
        twins=('focal_length', 'camera_position', 'principal_point'),
        source='Borenstein and Feng 1996, Measurement and correction of systematic odometry errors in '
        'mobile robots, IEEE Transactions on Robotics and Automation 12(6)',
        example=(0.03,),
        shown_against='distance',
    )
    acts_on: ClassVar[Place] = 'camera'
    name: str = 'wheel_scale'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('s', '1', prior_std=0.03, typical=TypicalRange(0.02, 0.05)),
    )

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the mounting in metres of the odometer; its height stays, as that of the map is free.

        An offset of the camera is in these metres already. No drive tells the two apart, whatever their size.
        """
        said = mount.p_bs - mount.shift
        nearer = said / np.array([1.0 + values[0], 1.0 + values[0], 1.0])
        return camera, replace(mount, p_bs=nearer + mount.shift)

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the shift of the points as the camera moves nearer, in its axes and the points' scale."""
        said = (seen.p_bc - seen.shift)[:2] / (1.0 + values[0])
        return (seen.by_point.dot(seen.R_bc[:2].T.dot(said)) * seen.scale[:, None])[:, :, None]

    def odometry(self, distance_m: Array, values: Array) -> Array:
        """Return the distance that the wheels report."""
        return distance_m / (1.0 + values[0])

    def unobservable(self, recording: RecordingSummary) -> str:
        """Refuse a camera near the turning centre: only the circle of the camera has a known true size."""
        if np.hypot(*recording.rig.camera_mount.p_bs[:2]) < MIN_LEVER_M:
            return 'only a camera at a distance from the turning centre shows it'
        return ''
