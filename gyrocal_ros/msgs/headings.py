"""Messages that contain a heading, and their conversion.

A heading reference is named by its topic; by `TOPIC.field` for a yaw in a message of any type with a header,
in degrees if the name of the field says so; or by `tf:PARENT:CHILD` for the heading of a frame on `/tf`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, HeadingSample
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.msgs.topics import IMU, POSES, STAMP_FIELDS, FieldConversion, transforms
from gyrocal_ros.msgs.transforms import yaw_from_quaternion

MAGNETIC_FIELD = 'sensor_msgs/msg/MagneticField'
ORIENTATIONS = {
    **{type_name: f'{pose}.orientation' for type_name, pose in POSES.items()},
    'geometry_msgs/msg/TransformStamped': 'transform.rotation',
    'geometry_msgs/msg/QuaternionStamped': 'quaternion',
    IMU: 'orientation',
}
"""Message types that contain an orientation, with the dotted name of its quaternion."""
HEADING_TYPES = (*ORIENTATIONS, MAGNETIC_FIELD)
"""Message types of which the topic alone names a heading."""
TRANSFORM_PREFIX = 'tf:'
MAX_LINKS = 10
"""Largest number of transforms between two frames."""


@dataclass(frozen=True, slots=True)
class HeadingName:
    """A heading reference, as its user names it."""

    topic: str
    field: str = ''
    """Dotted name of a yaw; empty for a message that contains an orientation."""
    frames: tuple[str, str] | None = None
    """Parent and child for the heading of a frame on `/tf`."""


UNNAMED = HeadingName('')


def parse_heading_name(text: str) -> HeadingName:
    """Parse `TOPIC`, `TOPIC.field` or `tf:PARENT:CHILD`.

    Raises:
        ConfigError: it begins like the last, but does not name two frames.
    """
    if text.startswith(TRANSFORM_PREFIX):
        parent, _, child = text.removeprefix(TRANSFORM_PREFIX).partition(':')
        if not (parent and child) or ':' in child:
            raise ConfigError(
                f'{text!r} does not name two frames', todo='write tf:PARENT:CHILD, as in tf:map:base_link'
            )
        return HeadingName('tf', frames=(parent.strip('/'), child.strip('/')))
    topic, _, field = text.partition('.')
    return HeadingName(topic, field)


def heading_conversion(type_name: str, name: HeadingName = UNNAMED) -> FieldConversion[HeadingSample]:
    """Return the conversion of messages of a type, one of `HEADING_TYPES`, or of any with a yaw field."""
    if name.field:
        unit_rad = math.radians(1.0) if _is_in_degrees(name) else 1.0
        return FieldConversion((*STAMP_FIELDS, name.field), _by_yaw(unit_rad))
    if type_name == MAGNETIC_FIELD:
        return FieldConversion((*STAMP_FIELDS, 'magnetic_field.x', 'magnetic_field.y'), _by_field)
    orientation = ORIENTATIONS[type_name]
    return FieldConversion((*STAMP_FIELDS, *(f'{orientation}.{axis}' for axis in 'xyzw')), _by_quaternion)


def _by_yaw(unit_rad: float) -> Callable[[int, int, float], HeadingSample]:
    return lambda sec, nanosec, yaw: HeadingSample(sec * NS_PER_S + nanosec, yaw * unit_rad)


def _is_in_degrees(name: HeadingName) -> bool:
    words = re.split(r'[^a-z]+', f'{name.topic} {name.field}'.lower())
    return any(word in ('deg', 'degree', 'degrees') for word in words)


def _by_field(sec: int, nanosec: int, x: float, y: float) -> HeadingSample:
    """Return the heading against magnetic north of a level robot: the field turns the other way than it."""
    return HeadingSample(sec * NS_PER_S + nanosec, math.atan2(-y, x))


def _by_quaternion(sec: int, nanosec: int, x: float, y: float, z: float, w: float) -> HeadingSample:
    """Return the heading of an orientation; NaN for an unset one, all zero."""
    if x == y == z == w == 0.0:
        return HeadingSample(sec * NS_PER_S + nanosec, math.nan)
    return HeadingSample(sec * NS_PER_S + nanosec, yaw_from_quaternion(x, y, z, w))


class FrameHeading:
    """The heading of one frame in another, by the latest transforms between them.

    In a chain (map, odom, base_link) the transform next to the parent holds the corrections of a
    localisation, and the one next to the child comes from odometry, which may use the gyro itself. So there
    is a heading only where the correction has changed. It is stamped by the odometry, since a localisation
    stamps its corrections ahead, for as long as they are to hold.
    """

    def __init__(self, parent: str, child: str) -> None:
        self._parent, self._child = parent, child
        self._links: dict[str, tuple[str, Array, int]] = {}
        self._last_ns = 0
        self._correction: Array = np.zeros((3, 3))

    def add(self, message: Any) -> HeadingSample | None:
        """Take a TFMessage; return a heading if there is a new one."""
        for link, item in zip(transforms(message), message.transforms, strict=True):
            stamp = item.header.stamp
            t_ns = int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
            self._links[link.child] = link.parent, link.mount.R_bs, t_ns
        chain: list[tuple[Array, int]] = []
        frame = self._child
        while frame != self._parent and frame in self._links and len(chain) < MAX_LINKS:
            frame, rotation, t_ns = self._links[frame]
            chain.append((rotation, t_ns))
        if frame != self._parent or not chain:
            return None
        correction, (_, stamp_ns) = chain[-1][0], chain[0]
        is_corrected = len(chain) == 1 or not np.array_equal(correction, self._correction)
        if stamp_ns <= self._last_ns or not is_corrected:
            return None
        self._last_ns, self._correction = stamp_ns, correction
        R = reduce(lambda R, link: link[0] @ R, chain, np.eye(3))
        return HeadingSample(stamp_ns, math.atan2(R[1, 0], R[0, 0]))
