"""Detection of a lost map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import recording
from synthetic import drive

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import nanoseconds
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf import slam
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.history.run import RunEvent
from gyrocal_ros.ekf.image_update import update_from_image
from gyrocal_ros.ekf.map_watch import (
    LOST_IMAGES,
    MAP_DROPPED,
    REMEMBERED_IMAGES,
    SOUND_IMAGES,
    LostMaps,
    MapWatch,
    loses_its_map,
)
from gyrocal_ros.ekf.noise.adaptive_noise import AdaptiveNoise
from gyrocal_ros.errors import FilterDivergedError, IndefiniteCovarianceError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

GOOD = MeasurementUpdate(used=15)
BAD = MeasurementUpdate(used=1, rejected=14)


def noise() -> AdaptiveNoise:
    return AdaptiveNoise(0.4, 0.02, 5.0)


def losses(updates: list[MeasurementUpdate]) -> list[bool]:
    watch = MapWatch()
    return [watch.is_lost(update, noise()) for update in updates]


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


def test_many_contradicting_images_are_a_divergence() -> None:
    with pytest.raises(FilterDivergedError, match='again and again.*every 4th') as caught:
        losses([BAD, GOOD] * REMEMBERED_IMAGES)
    assert 'gyrocal check' in caught.value.todo


def test_images_that_all_contradict_start_new_maps_before_they_are_a_divergence() -> None:
    assert sum(losses([BAD] * 5 * LOST_IMAGES)) == 5
    with pytest.raises(FilterDivergedError, match='again and again'):
        losses([BAD] * 6 * LOST_IMAGES)


def test_some_contradicting_images_are_none() -> None:
    lost = losses(([BAD] * LOST_IMAGES + [GOOD] * 5 * LOST_IMAGES) * 30)
    assert sum(lost) == 30


def test_noise_at_its_limit_is_a_divergence() -> None:
    pixel_noise = noise()
    for _ in range(3000):
        pixel_noise.update(np.full(15, 1e6), 2)
    with pytest.raises(FilterDivergedError, match='exceed 5 px') as caught:
        MapWatch().is_lost(GOOD, pixel_noise)
    assert 'gyrocal check' in caught.value.todo


@pytest.mark.parametrize(
    ('lost_s', 'contradicts'),
    [([], False), ([5, 10, 15], False), ([5, 10, 15, 64], True), ([5, 10, 15, 66, 90], False)],
    ids=['none', 'three', 'four in a minute', 'not in a minute'],
)
def test_a_map_that_is_lost_often_contradicts_the_model(lost_s: list[int], contradicts: bool) -> None:
    run = drive(duration_s=120.0).run
    events = [RunEvent(run.span.start_ns + nanoseconds(time_s), MAP_DROPPED) for time_s in lost_s]
    assert loses_its_map(replace(run, events=tuple(events))) is contradicts
    watched = LostMaps()
    for time_s in lost_s:
        watched.add(time_s)
    assert watched.are_many is contradicts


@pytest.mark.parametrize('form', ['inverse_depth', 'pixel'])
def test_a_map_that_was_bent_beyond_repair_is_dropped(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a robot in somebody's hands; only the filters of the paper diverge, as they did there."""
    source, images = recording('cleaning', 1, 60.0), 0

    def bent_once(*arguments: Any) -> Any:
        nonlocal images
        images += 1
        if images == 200:
            raise IndefiniteCovarianceError
        return update_from_image(*arguments)

    monkeypatch.setattr(slam, 'update_from_image', bent_once)
    config = replace(Config(), features=replace(Config().features, parametrisation=form))
    if form == 'pixel':
        with pytest.raises(FilterDivergedError):
            calibrate(source, config, default_model())
        return
    run = calibrate(source, config, default_model())
    found, true = conclude(run), source.truth.scale_factor
    assert [event.text for event in run.events] == [MAP_DROPPED]
    assert found.converged and abs(found.scale_factor - true) < 3.0 * found.scale_factor_std


def test_a_map_that_is_bent_at_once_or_again_shows_readings_at_fault() -> None:
    watch = MapWatch()
    assert not watch.may_be_bent()
    assert [any(map(watch.is_lost, [GOOD] * SOUND_IMAGES, [noise()] * SOUND_IMAGES))] == [False]
    assert watch.may_be_bent() and not watch.may_be_bent()
