"""Emulation of a ceiling camera: renders the images of a simulated robot in real time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import NS_PER_S, CameraIntrinsics, Frame, Mount, TruthSample, nanoseconds
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.sim.world import START_NS, SimSource

COVERED_GREY = 8
CLOCK_AHEAD_NS = 2 * NS_PER_S
LOST_OF = 3
FAULT_PATTERN = re.compile(r'(?P<kind>\w+)@(?P<start>[\d.]+)\+(?P<length>[\d.]+)')


class CameraFaultKind(StrEnum):
    """Fault of the camera, with the name used in settings."""

    COVER = 'cover'
    """The images are dark."""
    OFF = 'off'
    """No images are taken."""
    CLOCK = 'clock'
    """The clock that stamps the images is ahead by `CLOCK_AHEAD_NS`."""
    FREEZE = 'freeze'
    """The image of the start of the fault is repeated, with new stamps."""
    LOSE = 'lose'
    """Of `LOST_OF` images, all but the first are lost."""


@dataclass(frozen=True, slots=True)
class CameraFault:
    """A fault and its interval, in seconds since the start."""

    kind: CameraFaultKind
    start_s: float
    end_s: float


def parse_camera_faults(text: str) -> list[CameraFault]:
    """Parse faults of the form `KIND@FROM+FOR`, in seconds, separated by blanks.

    Raises:
        ConfigError: a fault is malformed.
    """
    return [_camera_fault(word) for word in text.split()]


def _camera_fault(word: str) -> CameraFault:
    match, kinds = FAULT_PATTERN.fullmatch(word), [kind.value for kind in CameraFaultKind]
    if match is None:
        raise ConfigError(f'{word!r} is malformed', todo='write KIND@FROM+FOR, as in cover@60+10')
    if match['kind'] not in kinds:
        raise ConfigError(f'{match["kind"]!r} is not a fault', todo=did_you_mean(match['kind'], kinds))
    try:
        start_s, length_s = float(match['start']), float(match['length'])
    except ValueError:
        raise ConfigError(
            f'{word!r} contains no valid times', todo='write KIND@FROM+FOR, as in cover@60+10'
        ) from None
    return CameraFault(CameraFaultKind(match['kind']), start_s, start_s + length_s)


class EmulatedCamera:
    """Images of a simulated robot, numbered from 0.

    Args:
        source: the simulated robot.
        faults: faults of the camera.
    """

    def __init__(self, source: SimSource, faults: Sequence[CameraFault]) -> None:
        self.start_ns = START_NS
        """Stamp of the start."""
        self._source, self._faults = source, faults
        self._time_s = source.image_times()
        self._images = source.image_sequence()
        self._frozen: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self._time_s)

    @property
    def nominal(self) -> tuple[CameraIntrinsics, Mount]:
        """Nominal calibration and mounting of the camera, without hidden effects."""
        rig = self._source.rig
        assert rig.camera is not None
        return rig.camera, rig.camera_mount

    def stamp_ns(self, number: int) -> int:
        """Return the middle of the exposure on the camera's clock."""
        return self._middle_ns(number) + (
            CLOCK_AHEAD_NS if CameraFaultKind.CLOCK in self._active_faults(number) else 0
        )

    def due_ns(self, number: int) -> int:
        """Return the time at which an image is available: the end of its exposure."""
        exposure_s = self._source.scenario.image_conditions.exposure_s
        return self._middle_ns(number) + nanoseconds(0.5 * exposure_s)

    def next_after(self, number: int, now_ns: int) -> int:
        """Return the number of the next image that is not yet due; images in between are skipped."""
        number += 1
        while number < len(self) and self.due_ns(number) < now_ns:
            number += 1
        return number

    def take(self, number: int) -> Frame | None:
        """Take an image; return None while the camera is off, and for an image that is lost."""
        active = self._active_faults(number)
        if CameraFaultKind.OFF in active or (CameraFaultKind.LOSE in active and number % LOST_OF):
            return None
        if CameraFaultKind.FREEZE not in active:
            self._frozen = None
        image = self._images.render(number) if self._frozen is None else self._frozen
        if CameraFaultKind.FREEZE in active:
            self._frozen = image
        return Frame(self.stamp_ns(number), _covered(image) if CameraFaultKind.COVER in active else image)

    def truth(self, number: int) -> TruthSample:
        """Return the true pose of the robot at the time of an image."""
        truth, time_s = self._source.truth, self._time_s[number : number + 1]
        x, y, z = truth.position(time_s)[0].tolist()
        yaw_rad = float(truth.trajectory.motion(time_s).euler_rad[0, 2])
        return TruthSample(self.stamp_ns(number), (x, y, z), yaw_rad)

    def _middle_ns(self, number: int) -> int:
        return self.start_ns + nanoseconds(float(self._time_s[number]))

    def _active_faults(self, number: int) -> set[CameraFaultKind]:
        time_s = self._time_s[number]
        return {fault.kind for fault in self._faults if fault.start_s <= time_s < fault.end_s}


def _covered(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.full_like(image, COVERED_GREY)
