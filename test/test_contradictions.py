"""Features that contradict the others for long leave the map; wrong matches and wrong models are none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recordings import ModifiedSource, each, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, Rig
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.contradictions import LastingContradictions
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import find_scenario

IDS = np.arange(10)


def found(of_image: Callable[[int], Array], images: int) -> list[int]:
    """Return the features found, given the distances (10,) of each image."""
    lasting = LastingContradictions()
    return sorted({int(i) for k in range(images) for i in lasting.find(IDS, of_image(k))})


def by_chance(image: int) -> Array:
    """Return distances of good features: chi-square of two degrees of freedom, per degree."""
    return np.random.default_rng(image).exponential(1.0, len(IDS))


def test_good_features_are_never_found() -> None:
    assert found(by_chance, 3000) == []


@pytest.mark.parametrize('distance, images', [(5.0, 8), (6.0, 6), (30.0, 3)])
def test_a_lasting_contradiction_is_found_within_some_images(distance: float, images: int) -> None:
    def of_image(image: int) -> Array:
        return np.where(IDS == 3, distance, 0.7)

    assert found(of_image, images - 1) == []
    assert found(of_image, images) == [3]


def test_wrong_matches_now_and_then_are_no_contradiction_that_lasts() -> None:
    assert found(lambda image: np.where((IDS == 3) & (image % 8 == 0), 100.0, 0.7), 800) == []


def test_where_most_features_are_off_the_model_is_to_blame() -> None:
    assert found(lambda image: np.where(IDS < 7, 12.0, 1.0), 50) == []
    assert found(lambda image: np.where(IDS == 3, 60.0, 12.0), 50) == [3]


AMPLITUDE_PX, PERIOD_S = 1.0, 10.0
SHARP = replace(find_scenario('cleaning').errors, pixel_noise_px=0.1)
SOURCE = recording('cleaning', 5, duration_s=60.0, camera_hz=8, errors=SHARP)


def sliding(seen: FeatureObservations) -> FeatureObservations:
    """Return features of which every fourth slides slowly to and fro along an edge, by 1 px."""
    phase = 2e-9 * np.pi * (seen.t_ns - SOURCE.span.start_ns) / PERIOD_S + seen.ids
    way_px = np.where(seen.ids % 4 == 0, AMPLITUDE_PX * np.sin(phase), 0.0)
    return replace(seen, pixels=seen.pixels + np.outer(way_px, [1.0, 0.3]))


def run_of(change: Callable[[FeatureObservations], FeatureObservations], rig: Rig | None = None) -> Run:
    """Return a run on features as a tracker of images tells them, with their covariances."""
    noise = np.square(SHARP.pixel_noise_px) * np.eye(2)

    def tracked(seen: FeatureObservations) -> FeatureObservations:
        return replace(change(seen), covariances_px2=np.tile(noise, (len(seen.ids), 1, 1)))

    config = Config()
    exact = replace(config, camera=replace(config.camera, pixel_noise_px=SHARP.pixel_noise_px))
    source = ModifiedSource(SOURCE, each(FeatureObservations, tracked), rig)
    return calibrate(source, exact, default_model())


def test_features_that_slide_are_removed_and_good_ones_stay() -> None:
    good, bad = run_of(lambda seen: seen).history, run_of(sliding).history
    assert good.dropped.sum() == 0 and bad.dropped.sum() > 15
    assert bad.used.sum() < 0.85 * good.used.sum()  # a quarter slides; each stays in until it is found
    assert bad.nis.sum() < 1.025 * bad.dof.sum()


def test_an_error_of_the_lens_is_none_of_the_features() -> None:
    camera = SOURCE.rig.camera
    assert camera is not None
    k1, *others = camera.distortion
    wrong = replace(SOURCE.rig, camera=replace(camera, distortion=(k1 + 0.03, *others)))
    good, bad = run_of(lambda seen: seen).history, run_of(lambda seen: seen, wrong).history
    assert bad.pixel_noise_px[-1] > 1.2 * good.pixel_noise_px[-1]  # the error shows
    assert bad.used.sum() > 0.9 * good.used.sum()
