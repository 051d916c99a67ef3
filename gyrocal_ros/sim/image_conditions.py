"""Conditions under which a camera takes its images, from light and exposure to dust and moving things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from gyrocal_ros.config.declare import setting, with_settings
from gyrocal_ros.data import Array
from gyrocal_ros.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ImageConditions:
    """Conditions of the images; each is independent of the others."""

    exposure_s: float = setting(
        0.008,
        's',
        'exposure time, in which motion blurs the image; the longest one if it is automatic',
        low=1e-5,
        high=0.2,
    )
    blur_poses: int = setting(5, '', 'number of poses that are averaged over the exposure', low=1, high=50)
    light: float = setting(1.0, '', 'brightness of the room relative to a normal one', low=0.001, high=20.0)
    darkness_s: float = setting(
        0.0, 's', 'time for which the light is off, in the middle of the recording', low=0.0, high=3600.0
    )
    auto_exposure: bool = setting(
        False, '', 'exposure time and gain follow the brightness of the last images'
    )
    flicker: float = setting(
        0.0, '', 'amplitude of the flicker of the lamps, relative to their brightness', low=0.0, high=1.0
    )
    flicker_hz: float = setting(100.0, 'Hz', 'frequency of the flicker', low=1.0, high=1000.0)
    read_noise_grey: float = setting(
        1.2, 'grey levels', 'standard deviation of a pixel in the dark, without gain', low=0.0, high=50.0
    )
    shot_noise_grey: float = setting(
        0.0,
        'grey levels',
        'standard deviation of a pixel by photon noise at grey level 100, without gain',
        low=0.0,
        high=50.0,
    )
    vignetting: float = setting(0.25, '', 'relative loss of brightness in the corners', low=0.0, high=0.95)
    dust: int = setting(0, '', 'number of specks on the lens', low=0, high=200)
    readout_s: float = setting(
        0.0, 's', 'time from the first to the last row of a rolling shutter; 0 global', low=0.0, high=0.1
    )
    optical_blur_px: float = setting(
        0.0, 'px', 'standard deviation of the blur of the lens', low=0.0, high=10.0
    )
    antialiased: bool = setting(True, '', 'a pixel averages the light over its area')
    jpeg_quality: int = setting(80, '', 'JPEG quality of stored images', low=1, high=100)
    sun_patch: bool = setting(False, '', 'the sun moves a patch of light over the ceiling')
    curtain: bool = setting(False, '', 'a curtain moves in the wind')
    fan: bool = setting(False, '', 'a ceiling fan rotates')
    person: bool = setting(False, '', 'a person walks around')


@dataclass(frozen=True, slots=True)
class _Sections:
    condition: ImageConditions


def with_conditions(conditions: ImageConditions, assignments: Sequence[str], where: str) -> ImageConditions:
    """Return the conditions with values given as `NAME=VALUE`.

    Args:
        conditions: the other values.
        assignments: fields of `ImageConditions`; the last one of a name counts.
        where: option that gives them, for the error message.

    Raises:
        ConfigError: a name is not known, or a value has the wrong type or is out of bounds.
    """
    try:
        values = {
            name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in assignments)
        }
    except yaml.YAMLError as error:
        raise ConfigError('cannot be read', where=where, todo='give NAME=VALUE') from error
    return with_settings(_Sections(conditions), {'condition': values}, where).condition


DARK = 0.03
"""Brightness of a room without its light, by what comes through the door."""
TARGET_GREY = 110.0
"""Mean grey level that the automatic exposure aims at."""
MAX_GAIN, MIN_FACTOR = 16.0, 0.02
"""Limits of gain and of the exposure time relative to the longest one."""
SPEED = 0.25
"""Share of the deviation (of the logarithm) that is corrected from one image to the next."""


class ExposureControl:
    """Exposure time and gain, which follow the brightness of the images if they are automatic."""

    def __init__(self, conditions: ImageConditions) -> None:
        self._conditions, self._factor = conditions, 1.0

    @property
    def exposure_s(self) -> float:
        """Exposure time of the next image."""
        return self._conditions.exposure_s * min(self._factor, 1.0)

    @property
    def gain(self) -> float:
        """Gain of the next image, at least 1."""
        return max(self._factor, 1.0)

    def follow(self, mean_grey: float) -> None:
        """Take the mean grey level of an image into account."""
        if self._conditions.auto_exposure:
            self._factor *= float(TARGET_GREY / max(mean_grey, 1.0)) ** SPEED
            self._factor = min(max(self._factor, MIN_FACTOR), MAX_GAIN)


def room_light(conditions: ImageConditions, time_s: Array) -> Array:
    """Return the brightness (n,) of the room at times (n,), relative to a normal one."""
    middle_s = 0.5 * float(time_s[0] + time_s[-1])
    is_off = np.abs(time_s - middle_s) < 0.5 * conditions.darkness_s
    return conditions.light * np.where(is_off, DARK, 1.0)


def flicker(conditions: ImageConditions, time_s: Array, exposure_s: float) -> Array:
    """Return the relative brightness of the lamps: its mean over each exposure around times (...)."""
    contrast = conditions.flicker * np.sinc(conditions.flicker_hz * exposure_s)
    return 1.0 + contrast * np.cos(2.0 * np.pi * conditions.flicker_hz * time_s)
