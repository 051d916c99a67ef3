"""Stamps of images that err at random from image to image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from recordings import Modification, ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, Measurement, nanoseconds
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.status import diagnosis_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.noise.stamp_noise import (
    MAX_STD_S,
    PRIOR_STD_S,
    PRIOR_WEIGHT,
    TELLING_STD_S,
    StampError,
    StampNoise,
    stamp_error,
    with_stamp_noise,
)
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.statistics import nis_per_dof

KNOWN_S = 0.0004
"""Standard deviation of the stamp by the pixels of an image in a turn."""


def error(error_s: float, noise: StampNoise, rate_rad_s: float = 1.0) -> StampError:
    """Return an error as an image tells it while the filter expects some noise of the stamps."""
    return StampError(error_s, KNOWN_S**2 + noise.std_s**2, rate_rad_s)


def learned(stamp_std_s: float, images: int = 60, seed: int = 0) -> StampNoise:
    """Return what images tell whose stamps have noise."""
    rng, noise = np.random.default_rng(seed), StampNoise()
    for error_s in np.hypot(stamp_std_s, KNOWN_S) * rng.normal(size=images):
        noise.learn(error(float(error_s), noise))
    return noise


@pytest.mark.parametrize('std_s', [0.002, 0.005, 0.02])
def test_the_noise_is_learned(std_s: float) -> None:
    found = [learned(std_s, seed=seed) for seed in range(20)]
    assert np.sqrt(np.mean([item.std_s**2 for item in found])) == pytest.approx(std_s, rel=0.15)
    assert all(item.learned_s == item.std_s for item in found)


def test_exact_stamps_have_none() -> None:
    found = [learned(0.0, seed=seed).std_s for seed in range(100)]
    assert np.count_nonzero(found) <= 2


def test_some_noise_is_expected_before_images_tell() -> None:
    assert StampNoise().std_s == PRIOR_STD_S and StampNoise().learned_s == 0.0
    few = learned(0.0, images=PRIOR_WEIGHT + 1)
    assert few.std_s == pytest.approx(PRIOR_STD_S, rel=0.02) and few.learned_s == 0.0


@pytest.mark.parametrize('growth_rad', [0.0, 0.004, -0.02])
def test_what_the_gyro_model_lacks_is_no_noise(growth_rad: float) -> None:
    """An error of the heading stays, or grows with each image, also while the turn becomes slower."""
    noise, rng = StampNoise(), np.random.default_rng(2)
    for number, rate_rad_s in enumerate(np.linspace(1.5, 0.5, 40)):
        heading_rad = 0.03 + growth_rad * number
        error_s = heading_rad / rate_rad_s + KNOWN_S * rng.normal()
        noise.learn(error(error_s, noise, float(rate_rad_s)))
    assert noise.std_s == 0.0


def test_what_exceeds_the_largest_noise_is_none() -> None:
    assert learned(0.5).std_s == MAX_STD_S


def test_a_few_outliers_do_not_matter() -> None:
    noise, rng = StampNoise(), np.random.default_rng(1)
    for number, error_s in enumerate(KNOWN_S * rng.normal(size=60)):
        noise.learn(error(0.5 if number % 20 == 0 else float(error_s), noise))
    assert noise.std_s == 0.0


def test_images_between_turns_tell_nothing() -> None:
    noise = StampNoise()
    for number in range(100):
        large = (-1.0) ** number
        noise.learn(error(large, noise))
        noise.learn(error(large, noise))
        noise.learn(None if number % 2 else StampError(large, 1.01 * TELLING_STD_S**2 + noise.std_s**2, 1.0))
    assert noise.std_s == PRIOR_STD_S, 'no three images follow on each other'


def image(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return velocities of features (m, 2) and the covariance (m, 2, m, 2) of their innovation."""
    root = rng.normal(size=(12, 12))
    return 300.0 * rng.normal(size=(6, 2)), (root @ root.T + np.eye(12)).reshape(6, 2, 6, 2)


def seen_error(velocity: Array, yaw_rate: float, residual: Array, whitening: Array) -> StampError | None:
    """Return the error by features that move with a velocity (m, 2), as by a rate of 1 along x."""
    by_pose = np.zeros((*velocity.shape, 6))
    by_pose[:, :, 0] = velocity
    return stamp_error(by_pose, np.array([1.0, 0.0, 0.0, 0.0, 0.0, yaw_rate]), residual, whitening)


def test_the_error_that_explains_an_innovation_best() -> None:
    rng = np.random.default_rng(3)
    velocity, covariance = image(rng)
    whitening = whitener(covariance.reshape(12, 12))
    found = seen_error(velocity, 0.8, 0.007 * velocity, whitening)
    assert found is not None and found.error_s == pytest.approx(0.007) and found.yaw_rate_rad_s == 0.8
    flat = velocity.ravel()
    assert found.variance_s2 == pytest.approx(
        1.0 / (flat @ np.linalg.solve(covariance.reshape(12, 12), flat))
    )
    draws = rng.multivariate_normal(np.zeros(12), covariance.reshape(12, 12), 4000)
    errors = [seen_error(velocity, 0.8, draw.reshape(6, 2), whitening) for draw in draws]
    assert np.var([item.error_s for item in errors if item]) == pytest.approx(found.variance_s2, rel=0.1)


def test_an_image_at_rest_tells_no_error() -> None:
    assert seen_error(np.zeros((3, 2)), 0.0, np.ones((3, 2)), np.eye(6)) is None


def test_the_noise_of_a_stamp_adds_to_the_variance_of_its_error() -> None:
    velocity, covariance = image(np.random.default_rng(4))
    noisy = with_stamp_noise(covariance, velocity, 0.005)
    before, after = (
        seen_error(velocity, 1.0, velocity, whitener(each.reshape(12, 12))) for each in (covariance, noisy)
    )
    assert before is not None and after is not None
    assert after.variance_s2 == pytest.approx(before.variance_s2 + 0.005**2)


def jittering(std_s: float) -> Modification:
    """Return a modification that shifts the stamps of images at random."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        rng = np.random.default_rng(5)
        shifted = (
            replace(item, t_ns=item.t_ns + nanoseconds(std_s * rng.normal()))
            if isinstance(item, FeatureObservations)
            else item
            for item in measurements
        )
        return iter(sorted(shifted, key=lambda item: item.t_ns))

    return change


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 4])
def test_a_calibration_with_noisy_stamps_is_as_good(seed: int) -> None:
    """With stamps that count for exact, they end 0.2 and 0.3 % off: a false change is followed."""
    source = recording(seed=seed, duration_s=90.0)
    run = calibrate(ModifiedSource(source, jittering(0.01)), Config(), default_model(), follows_changes=True)
    history = run.history
    error = 1.0 + history.coefficients[-1, 0] - source.truth.scale_factor
    assert abs(error) < 3.0 * history.std[-1, 9] and history.std[-1, 9] < 2e-4
    assert not history.scale_followed.any() and not run.events
    assert history.stamp_noise_s[-1] == pytest.approx(0.01, rel=0.3)
    assert nis_per_dof(history.nis, history.dof) == pytest.approx(1.0, abs=0.2)


def diagnosed(hidden: tuple[HiddenEffect, ...]) -> tuple[Search, Diagnosis]:
    noisy = ModifiedSource(recording(duration_s=90.0, hidden=hidden), jittering(0.01))
    source, config = preload(noisy, Config(), default_model())
    recorded = summarise_recording(source)
    found = find_missing(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    return found, diagnose(found, recorded)


@pytest.mark.slow
def test_noisy_stamps_alone_are_the_verdict() -> None:
    searched, found = diagnosed(())
    assert found.verdict == 'timing' and not found.missing
    fault = summarise_diagnosis(searched, found)['timing']
    assert fault['is_allowed_for'] and fault['std_s'] == pytest.approx(0.01, rel=0.3)
    status = diagnosis_status(found)
    assert status.level == 'yellow' and 'jitter by about' in status.sentence


@pytest.mark.slow
def test_an_effect_is_found_beside_noisy_stamps() -> None:
    _, found = diagnosed((HiddenEffect(find_effect('scale_asymmetry'), (0.01,)),))
    (missing,) = found.missing
    assert missing.effect.name == 'scale_asymmetry' and found.timing is None
    assert missing.values[0] == pytest.approx(0.01, abs=4.0 * missing.stds[0]) and missing.stds[0] < 2e-4
