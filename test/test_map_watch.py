"""Detection of a lost map."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import nanoseconds
from gyrocal_ros.ekf.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.map_watch import LOST_IMAGES, MAX_RESTARTS, MapWatch
from gyrocal_ros.ekf.update import MeasurementUpdate
from gyrocal_ros.errors import FilterDivergedError

GOOD = MeasurementUpdate(used=15)
BAD = MeasurementUpdate(used=1, rejected=14)


def noise() -> AdaptiveNoise:
    return AdaptiveNoise(0.4, 0.02, 5.0)


def losses(updates: list[MeasurementUpdate], interval_s: float = 0.1) -> list[bool]:
    watch = MapWatch()
    return [watch.is_lost(update, noise(), nanoseconds(interval_s * k)) for k, update in enumerate(updates)]


def test_the_map_is_lost_after_consecutive_contradictions() -> None:
    assert losses([BAD] * (LOST_IMAGES + 1)) == [False] * (LOST_IMAGES - 1) + [True, False]


def test_a_good_image_restarts_the_count() -> None:
    assert not any(losses([BAD] * (LOST_IMAGES - 1) + [GOOD] + [BAD] * (LOST_IMAGES - 1)))


@pytest.mark.parametrize(
    ('update', 'contradicts'),
    [
        (MeasurementUpdate(used=0, rejected=2), False),
        (MeasurementUpdate(used=0, rejected=3), True),
        (MeasurementUpdate(used=5, rejected=10), False),
        (MeasurementUpdate(used=5, rejected=11), True),
        (MeasurementUpdate(), False),
    ],
    ids=['few', 'three', 'two thirds', 'most', 'empty'],
)
def test_an_image_contradicts_if_most_features_are_rejected(
    update: MeasurementUpdate, contradicts: bool
) -> None:
    assert any(losses([update] * LOST_IMAGES)) is contradicts


def test_too_many_lost_maps_are_a_divergence() -> None:
    enough = LOST_IMAGES * (MAX_RESTARTS + 1)
    assert sum(losses([BAD] * (enough - 1))) == MAX_RESTARTS
    with pytest.raises(FilterDivergedError, match=f'again and again.*{MAX_RESTARTS + 1} new maps') as caught:
        losses([BAD] * enough)
    assert 'gyrocal check' in caught.value.todo


def test_maps_lost_now_and_then_are_no_divergence() -> None:
    assert sum(losses([BAD] * LOST_IMAGES * 10, interval_s=1.0)) == 10


def test_noise_at_its_limit_is_a_divergence() -> None:
    pixel_noise = noise()
    for _ in range(3000):
        pixel_noise.update(np.full(15, 1e6), 2)
    with pytest.raises(FilterDivergedError, match='exceed 5 px') as caught:
        MapWatch().is_lost(GOOD, pixel_noise, 0)
    assert 'gyrocal check' in caught.value.todo
