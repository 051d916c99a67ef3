"""Comparison of the way by the wheels with the way that features move: a camera mounted otherwise than told.

On a straight lane all features of the ceiling move against the way of the robot, whatever their height. Where
the camera is turned about its axis relative to its transform, or the wheels run backwards, they move in
another direction, and the map explains that badly, with features at infinity.
"""

from __future__ import annotations

import cmath
import math
from statistics import median

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations, IntArray, MotionBlock, Mount
from gyrocal_ros.ekf.features.landmarks import match_ids
from gyrocal_ros.model.camera import bearing

LANE_M, MAX_TURN_RAD = 0.15, math.radians(2.0)
"""Way after which two images are compared, and turn within it up to which it is straight."""
MIN_FEATURES, MIN_SHIFT = 4, 0.01
"""Features that two images must have in common, and shift of their bearings (x/z, y/z) from which it tells a
direction."""
LANES, MOST_LANES, MIN_AGREEMENT = 12, 100, 0.9
"""Numbers of lanes from which and up to which they tell the direction, and mean of their unit vectors from
which they agree on it."""
MAX_ANGLE_RAD = math.radians(30.0)
"""Angle from which the camera is turned, or the wheels run backwards; a smaller one is a yaw that was
measured badly, which makes the path wrong but not the gyro."""
MIN_ANGLE_RAD, MIN_SIGMA = math.radians(3.0), 4.0
"""Smallest error of the yaw that is reported, and its significance."""
LEAST_UP = 0.1
"""Vertical part of a ray from which its bearing is used as it is: walls may be seen, too."""
TURNED_CAMERA = 'the images show another way than the wheels'
REMEDY = 'correct the transform of the camera, or the sign of the speed'
"""Beginning and end of the event."""
WRONG_YAW = 'the yaw of the camera in its transform is'
"""First words of the event of a smaller angle."""


class WayAgreement:
    """Compares pairs of images on straight lanes, until enough of them have told the direction.

    The way is that by the wheels: a wrong mount spoils that by the filter. The turn is that by the gyro,
    whose bias has to be known: the images of a tilted camera shift by a turn as they do by a way.
    """

    def __init__(self) -> None:
        self._ids: IntArray | None = None
        self._bearings: Array = np.empty(0, complex)
        self._way_m = self._turn_rad = 0.0
        self._lanes, self._sum = 0, 0.0j
        self._has_told = False

    def move(self, block: MotionBlock, bias_rad_s: float) -> None:
        """Add the motion of a block, given the bias of the yaw gyro."""
        way_m, turn_rad, *_ = block.way_and_turn()
        self._way_m += way_m
        self._turn_rad += turn_rad + bias_rad_s * block.duration_s

    def event(self, seen: FeatureObservations, camera: CameraIntrinsics, mount: Mount) -> str:
        """Take the features of an image; return what is wrong, once; empty otherwise."""
        if self._has_told or self._lanes >= MOST_LANES:
            return ''
        is_straight = self._ids is not None and abs(self._turn_rad) < MAX_TURN_RAD
        if is_straight and abs(self._way_m) < LANE_M:
            return ''
        bearings = _levelled(seen.pixels, camera, mount)
        if is_straight:
            self._compare(seen.ids, bearings)
        self._ids, self._bearings = seen.ids, bearings
        self._way_m = self._turn_rad = 0.0
        finding = self.finding
        self._has_told = bool(finding)
        return finding

    def _compare(self, ids: IntArray, bearings: Array) -> None:
        """Compare an image with that at the beginning of a lane."""
        assert self._ids is not None
        second, first = match_ids(self._ids, ids)
        if len(first) < MIN_FEATURES:
            return
        shifts = self._bearings[first] - bearings[second] * cmath.rect(1.0, self._turn_rad)
        shift = complex(median(shifts.real.tolist()), median(shifts.imag.tolist()))
        if abs(shift) > MIN_SHIFT:
            way = cmath.rect(math.copysign(1.0, self._way_m), 0.5 * self._turn_rad)
            self._sum += shift / abs(shift) / way
            self._lanes += 1

    @property
    def finding(self) -> str:
        """What is wrong; empty where nothing is, or while that is not known."""
        agreement = abs(self._sum) / max(self._lanes, 1)
        if self._lanes < LANES or agreement < MIN_AGREEMENT:
            return ''
        angle_rad = cmath.phase(self._sum)
        # Of unit vectors that scatter by s, the mean has a length of 1 - s^2 / 2 (Mardia and Jupp 2000).
        std_rad = math.sqrt(2.0 * max(1.0 - agreement, 0.0) / self._lanes)
        angle_deg = math.degrees(angle_rad)
        if abs(angle_rad) >= MAX_ANGLE_RAD:
            return (
                f'{TURNED_CAMERA}, at {abs(angle_deg):.0f} deg: the camera is turned about its axis, or the '
                f'wheels run backwards; {REMEDY}'
            )
        if abs(angle_rad) < max(MIN_ANGLE_RAD, MIN_SIGMA * std_rad):
            return ''
        uncertainty = f'{angle_deg:+.1f} \N{PLUS-MINUS SIGN} {math.degrees(std_rad):.1f} deg'
        return f'{WRONG_YAW} {uncertainty} off, by the way of the wheels; subtract that'


def turned_camera(event: str) -> str:
    """Return what the text of an event, which may tell others as well, says of the way; empty for nothing."""
    _, is_told, rest = event.partition(TURNED_CAMERA)
    return f'{TURNED_CAMERA}{rest.partition(REMEDY)[0]}{REMEDY}' if is_told else ''


def wrong_yaw(event: str) -> str:
    """Return what the text of an event, which may tell others as well, says of the yaw; empty for nothing."""
    _, is_told, rest = event.partition(WRONG_YAW)
    return f'{WRONG_YAW}{rest.partition(";")[0]}' if is_told else ''


def _levelled(pixels: Array, camera: CameraIntrinsics, mount: Mount) -> Array:
    """Return the bearings x/z + i y/z of pixels (n, 2) in the axes of a level robot."""
    rays = np.column_stack([bearing(camera, pixels), np.ones(len(pixels))]) @ mount.R_bs.T
    return (rays[:, 0] + 1.0j * rays[:, 1]) / np.maximum(rays[:, 2], LEAST_UP)
