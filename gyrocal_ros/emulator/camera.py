"""A ceiling camera that is none: it takes the images of a simulated robot as time goes by."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import NS_PER_S, CameraIntrinsics, Frame, Mount, TruthSample, nanoseconds
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.film import EXPOSURE_S
from gyrocal_ros.sim.world import START_NS, SimSource

COVERED_GREY = 8
CLOCK_AHEAD_NS = 2 * NS_PER_S
FORM = re.compile(r'(?P<kind>\w+)@(?P<start>[\d.]+)\+(?P<length>[\d.]+)')


class Trouble(StrEnum):
    """What can befall the camera."""

    COVER = 'cover'
    """It sees nothing but dark."""
    OFF = 'off'
    """It takes no images."""
    CLOCK = 'clock'
    """The clock that stamps its images is ahead by `CLOCK_AHEAD_NS`."""


@dataclass(frozen=True, slots=True)
class Spell:
    """A trouble and its time, in seconds since the start."""

    trouble: Trouble
    start_s: float
    end_s: float


def parse_spells(text: str) -> list[Spell]:
    """Read `KIND@FROM+FOR`, in seconds, several separated by blanks.

    Raises:
        ConfigError: one is not of that form.
    """
    return [_spell(word) for word in text.split()]


def _spell(word: str) -> Spell:
    form, kinds = FORM.fullmatch(word), [trouble.value for trouble in Trouble]
    if form is None:
        raise ConfigError(f'{word!r} is not understood', todo='write KIND@FROM+FOR, as in cover@60+10')
    if form['kind'] not in kinds:
        raise ConfigError(f'{form["kind"]!r} is not known', todo=did_you_mean(form['kind'], kinds))
    try:
        start_s, length_s = float(form['start']), float(form['length'])
    except ValueError:
        raise ConfigError(f'{word!r} holds no times', todo='write KIND@FROM+FOR, as in cover@60+10') from None
    return Spell(Trouble(form['kind']), start_s, start_s + length_s)


class EmulatedCamera:
    """The images of a simulated robot, by their numbers from 0 on.

    Args:
        source: the robot.
        spells: troubles.
    """

    def __init__(self, source: SimSource, spells: Sequence[Spell]) -> None:
        self.start_ns = START_NS
        """Stamp of the start."""
        self._source, self._spells = source, spells
        self._time_s = source.image_times()
        self._film = source.film()

    def __len__(self) -> int:
        return len(self._time_s)

    @property
    def believed(self) -> tuple[CameraIntrinsics, Mount]:
        """Calibration and mounting of the camera, as the robot knows them."""
        rig = self._source.rig
        assert rig.camera is not None
        return rig.camera, rig.camera_mount

    def stamp_ns(self, number: int) -> int:
        """The middle of the exposure, by the clock of the camera."""
        return self._middle_ns(number) + (CLOCK_AHEAD_NS if Trouble.CLOCK in self._troubles(number) else 0)

    def due_ns(self, number: int) -> int:
        """When the image is there: at the end of the exposure."""
        return self._middle_ns(number) + nanoseconds(0.5 * EXPOSURE_S)

    def next_after(self, number: int, now_ns: int) -> int:
        """The next image that is not over yet; those between are left out."""
        number += 1
        while number < len(self) and self.due_ns(number) < now_ns:
            number += 1
        return number

    def take(self, number: int) -> Frame | None:
        """Take an image; None while the camera is off."""
        troubles = self._troubles(number)
        if Trouble.OFF in troubles:
            return None
        image = self._film.take(number)
        return Frame(self.stamp_ns(number), _covered(image) if Trouble.COVER in troubles else image)

    def truth(self, number: int) -> TruthSample:
        """Where the robot is at the time of an image."""
        truth, time_s = self._source.truth, self._time_s[number : number + 1]
        x, y, z = truth.position(time_s)[0].tolist()
        yaw_rad = float(truth.trajectory.motion(time_s).euler_rad[0, 2])
        return TruthSample(self.stamp_ns(number), (x, y, z), yaw_rad)

    def _middle_ns(self, number: int) -> int:
        return self.start_ns + nanoseconds(float(self._time_s[number]))

    def _troubles(self, number: int) -> set[Trouble]:
        time_s = self._time_s[number]
        return {spell.trouble for spell in self._spells if spell.start_s <= time_s < spell.end_s}


def _covered(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.full_like(image, COVERED_GREY)
