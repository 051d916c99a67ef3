"""A camera that is knocked while the robot drives: reported, and no evidence against the gyro."""

from __future__ import annotations

import math

from gyrocal_ros.data import changed
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, UpdateStats

SOUND_IMAGES, SOUND_NIS = 100, 5.0
"""Number of images that agree before one of a knock, and their largest NIS per degree of freedom: where the
model lacks an effect, images contradict the turns before they contradict one by as much as a knock."""
KNOCKED = 'the camera was knocked'
"""First words of the event of a run."""
TURNING_RAD_S = math.radians(10.0)
"""Yaw rate from which no knock is reported: late images contradict the gyro where a turn begins."""
MOST_KNOCKS = 2
"""Number of knocks that are reported: what turns the camera again and again is no knock."""


class KnockWatch:
    """Reports a camera that is knocked: among images that agree, one that has turned as no gyro misses.

    The heading is off by as much from then on. The image says nothing of the gyro and counts as not measured.
    """

    def __init__(self) -> None:
        self._sound_images = self._knocks = 0

    def see(self, update: MeasurementUpdate, rate_rad_s: float) -> tuple[MeasurementUpdate, str]:
        """Return what an image tells, given the yaw rate by the gyro, and an event; empty for none."""
        turn_deg = math.degrees(update.freed_turn_rad)
        is_sound = not turn_deg and update.stats.nis <= SOUND_NIS * update.stats.dof
        sound_images, self._sound_images = self._sound_images, self._sound_images + 1 if is_sound else 0
        may_be_one = sound_images >= SOUND_IMAGES and abs(rate_rad_s) < TURNING_RAD_S
        if not turn_deg or not may_be_one or self._knocks == MOST_KNOCKS:
            return update, ''
        self._knocks += 1
        event = (
            f'{KNOCKED}, or the gyro lost a turn: the images turned by {turn_deg:+.1f} deg at once; '
            'fasten it, measure its yaw again, and record again'
        )
        return changed(update, stats=UpdateStats()), event


def knock(event: str) -> str:
    """Return what the text of an event, which may tell others as well, says of a knock; empty for nothing."""
    _, found, rest = event.partition(KNOCKED)
    return f'{KNOCKED}{rest.partition(";")[0]}' if found else ''
