"""Defective pixels of a camera are found while the robot turns, and replaced."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal_ros.vision.defective_pixels import MIN_IMAGES, TURN_RAD, DefectivePixels

HEIGHT, WIDTH = 120, 160
HOT, DARK = (40, 30), (70, 100)
Image = NDArray[np.uint8]


def views(count: int = 30, noise_grey: float = 0.0) -> Iterator[Image]:
    """Yield images of different parts of a ceiling with texture of all sizes."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        image = 120.0 + rng.normal(0.0, noise_grey, (HEIGHT, WIDTH))
        for sigma_px in (0.8, 2.0, 6.0):
            texture = rng.normal(0.0, 40.0 * sigma_px, image.shape)
            image += cv2.GaussianBlur(texture, (0, 0), sigma_px)
        yield np.clip(image, 0, 255).astype(np.uint8)


def with_defects(image: Image, by_grey: int = 100) -> Image:
    """Return an image of a camera with a hot and a dark pixel."""
    image = image.copy()
    image[HOT] = min(255, int(image[HOT]) + by_grey)
    image[DARK] = max(0, int(image[DARK]) - by_grey)
    return image


def blurred(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 3.0), np.uint8)


def learned(images: Iterator[Image], turn_rad: float = 1.1 * TURN_RAD) -> DefectivePixels:
    defects = DefectivePixels(HEIGHT, WIDTH)
    for index, image in enumerate(images):
        defects.learn(image, math.remainder(index * turn_rad, 2.0 * math.pi))
    return defects


@pytest.mark.parametrize(('noise_grey', 'by_grey'), [(0.0, 100), (0.0, 250), (10.0, 150)])
def test_hot_and_dark_pixels_are_replaced_by_those_around_them(noise_grey: float, by_grey: int) -> None:
    defects = learned(with_defects(image, by_grey) for image in views(noise_grey=noise_grey))
    assert defects.count == 2
    smooth = blurred(next(views()))
    corrected = defects.corrected(with_defects(smooth, by_grey))
    assert np.abs(corrected.astype(int) - smooth).max() <= 2


def test_a_defect_that_compression_has_spread_is_replaced() -> None:
    def compressed(image: Image) -> Image:
        encoded = cv2.imencode('.jpg', with_defects(image, 200), [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
        return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), np.uint8)

    defects = learned(compressed(image) for image in views())
    smooth = blurred(next(views()))
    left = defects.corrected(compressed(smooth)).astype(int) - smooth
    assert 2 <= defects.count <= 30
    assert abs(left[HOT]) <= 15 and abs(left[DARK]) <= 15


@pytest.mark.parametrize('noise_grey', [0.0, 10.0, 25.0])
def test_a_good_camera_has_none(noise_grey: float) -> None:
    defects = learned(views(noise_grey=noise_grey))
    image = next(views())
    assert defects.count == 0 and defects.corrected(image) is image


def lined(image: Image) -> Image:
    """Return an image with a line of the ceiling along a lane."""
    image = image.copy()
    image[:, 50] = 250
    return image


def with_mast(image: Image) -> Image:
    """Return an image with a speckled part of the robot in view."""
    image = image.copy()
    image[:60:2, :60:2] = 250
    return image


@pytest.mark.parametrize(
    ('changed', 'turn_rad'), [(with_defects, 0.0), (lined, 0.01 * TURN_RAD), (with_mast, 1.1 * TURN_RAD)]
)
def test_what_may_be_something_else_is_left_as_it_is(
    changed: Callable[[Image], Image], turn_rad: float
) -> None:
    assert learned((changed(image) for image in views()), turn_rad).count == 0


def test_a_pixel_that_recovers_is_used_again() -> None:
    good = views(200)
    defects = learned(with_defects(next(good)) for _ in range(MIN_IMAGES))
    assert defects.count == 2
    for index, image in enumerate(good):
        defects.learn(image, math.remainder(index * 1.1 * TURN_RAD, 2.0 * math.pi))
    assert defects.count == 0
