"""Comparison of the way by the wheels with the way that features move: a camera mounted otherwise than told.

On a straight lane all features of the ceiling move against the way of the robot, whatever their height. Where
the camera is turned about its axis relative to its transform, or the wheels run backwards, they move in
another direction, and the map explains that badly, with features at infinity.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations, IntArray, MotionBlock, Mount
from gyrocal_ros.model.camera import bearing

LANE_M, MAX_TURN_RAD = 0.15, math.radians(2.0)
"""Way after which two images are compared, and turn within it up to which it is straight."""
MIN_FEATURES, MIN_SHIFT = 4, 0.01
"""Features that two images must have in common, and shift of their bearings (x/z, y/z) from which it tells a
direction."""
LANES, MIN_AGREEMENT = 12, 0.9
"""Number of lanes that tell the direction, and mean of their unit vectors from which they agree on it."""
MAX_ANGLE_RAD = math.radians(30.0)
"""Angle that no error of a mount explains that was measured; smaller ones are effects of the library."""
LEAST_UP = 0.1
"""Vertical part of a ray from which its bearing is used as it is: walls may be seen, too."""
TURNED_CAMERA = 'the images show another way than the wheels'
REMEDY = 'correct the transform of the camera, or the sign of the speed'
"""Beginning and end of the event."""


class WayAgreement:
    """Compares pairs of images on straight lanes, until enough of them have told the direction.

    The pose is that by gyro and wheels: a wrong mount spoils that by the filter.
    """

    def __init__(self) -> None:
        self._ids: IntArray | None = None
        self._bearings: Array = np.empty(0, complex)
        self._way_m = self._turn_rad = 0.0
        self._lanes, self._sum = 0, 0.0j

    def move(self, block: MotionBlock) -> None:
        """Add the motion of a block."""
        way_m, turn_rad, *_ = block.way_and_turn()
        self._way_m += way_m
        self._turn_rad += turn_rad

    def event(self, seen: FeatureObservations, camera: CameraIntrinsics, mount: Mount) -> str:
        """Take the features of an image; return what is wrong, once; empty otherwise."""
        if self._lanes >= LANES:
            return ''
        is_straight = self._ids is not None and abs(self._turn_rad) < MAX_TURN_RAD
        if is_straight and abs(self._way_m) < LANE_M:
            return ''
        bearings = _levelled(seen.pixels, camera, mount)
        if is_straight:
            self._compare(seen.ids, bearings)
        self._ids, self._bearings = seen.ids, bearings
        self._way_m = self._turn_rad = 0.0
        return self.finding

    def _compare(self, ids: IntArray, bearings: Array) -> None:
        """Compare an image with that at the beginning of a lane."""
        assert self._ids is not None
        _, first, second = np.intersect1d(self._ids, ids, return_indices=True)
        if len(first) < MIN_FEATURES:
            return
        shifts = self._bearings[first] - bearings[second] * cmath.rect(1.0, self._turn_rad)
        shift = complex(np.median(shifts.real), np.median(shifts.imag))
        if abs(shift) > MIN_SHIFT:
            way = cmath.rect(math.copysign(1.0, self._way_m), 0.5 * self._turn_rad)
            self._sum += shift / abs(shift) / way
            self._lanes += 1

    @property
    def finding(self) -> str:
        """What is wrong; empty where nothing is, or while that is not known."""
        angle_rad = cmath.phase(self._sum)
        agrees = abs(self._sum) > MIN_AGREEMENT * self._lanes
        if self._lanes < LANES or not agrees or abs(angle_rad) < MAX_ANGLE_RAD:
            return ''
        return (
            f'{TURNED_CAMERA}, at {math.degrees(abs(angle_rad)):.0f} deg: the camera is turned about its '
            f'axis, or the wheels run backwards; {REMEDY}'
        )


def turned_camera(event: str) -> str:
    """Return what the text of an event, which may tell others as well, says of the way; empty for nothing."""
    _, is_told, rest = event.partition(TURNED_CAMERA)
    return f'{TURNED_CAMERA}{rest.partition(REMEDY)[0]}{REMEDY}' if is_told else ''


def _levelled(pixels: Array, camera: CameraIntrinsics, mount: Mount) -> Array:
    """Return the bearings x/z + i y/z of pixels (n, 2) in the axes of a level robot."""
    rays = np.column_stack([bearing(camera, pixels), np.ones(len(pixels))]) @ mount.R_bs.T
    return (rays[:, 0] + 1.0j * rays[:, 1]) / np.maximum(rays[:, 2], LEAST_UP)
