"""A heading reference that contains the gyro is detected by the noise that both have."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, HeadingSample, ImuSample, Measurement, MotionBlock
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.equations.heading import CONTAINS_GYRO
from gyrocal_ros.ekf.noise.shared_noise import SharedNoise
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

DEG = math.radians(1.0)
STEP_S, SAMPLES = 0.01, 10
GYRO_NOISE = 0.1 * DEG
"""Standard deviation of a reading."""


def block(rate_rad_s: Array) -> MotionBlock:
    rates = np.zeros((SAMPLES, 3))
    rates[:, 2] = rate_rad_s
    made = eventful_block(SAMPLES)
    start_ns = made.start_ns
    return replace(
        made, rate_rad_s=rates, dt_s=np.full(SAMPLES, STEP_S), end_ns=start_ns + round(SAMPLES * STEP_S * 1e9)
    )


def compared(
    share: float, reference_deg: float = 0.001, sway_deg_s: float = 0.0, seconds: float = 60.0
) -> SharedNoise:
    """Compare a reference that repeats a share of the noise of the gyro, and has noise of its own.

    Args:
        share: of the noise of the gyro in the turns of the reference.
        reference_deg: standard deviation of its headings.
        sway_deg_s: standard deviation of the true rate over 0.5 s.
        seconds: length.
    """
    rng, shared, yaw_rad = np.random.default_rng(0), SharedNoise(), 3.0
    readings = GYRO_NOISE * rng.standard_normal(round(seconds / STEP_S) + 1)
    noise = 0.5 * (readings[1:] + readings[:-1])
    sway = np.repeat(sway_deg_s * DEG * rng.standard_normal(round(seconds / 0.5)), round(0.5 / STEP_S))
    for k in range(0, len(noise), SAMPLES):
        here = slice(k, k + SAMPLES)
        shared.move(block(2.0 * DEG + noise[here] + sway[here]))
        yaw_rad += STEP_S * float(np.sum(2.0 * DEG + share * noise[here] + sway[here]))
        shared.add(math.remainder(yaw_rad + reference_deg * DEG * rng.standard_normal(), 2.0 * math.pi))
    return shared


@pytest.mark.parametrize('share', [0.5, 1.0])
def test_the_share_of_the_noise_is_found(share: float) -> None:
    shared = compared(share)
    slope, std = shared.slope
    assert shared.is_shared and abs(slope - share) < 4.0 * std < 0.2


@pytest.mark.parametrize('sway_deg_s', [0.0, 0.02, 0.1, 5.0])
@pytest.mark.parametrize('reference_deg', [0.0, 0.01, 0.5])
def test_an_independent_reference_is_none(sway_deg_s: float, reference_deg: float) -> None:
    """Also a perfect one, which sees how the robot sways while it hardly turns."""
    assert not compared(0.0, reference_deg, sway_deg_s).is_shared


def test_a_few_seconds_prove_nothing() -> None:
    assert not compared(1.0, seconds=4.0).is_shared


def test_without_headings_nothing_is_kept() -> None:
    """A robot has no reference at all, or loses it for hours."""
    for shared in (SharedNoise(), compared(0.0, seconds=3.0)):
        for _ in range(200):
            shared.move(block(np.zeros(SAMPLES)))
        before = len(pickle.dumps(shared))
        for _ in range(2000):
            shared.move(block(np.zeros(SAMPLES)))
        assert len(pickle.dumps(shared)) == before
    assert compared(1.0).is_shared


def integrated(samples: Sequence[Measurement], share: float) -> list[Measurement]:
    """Add headings that mix the gyro, without its bias, with perfect wheels."""
    imu = [sample for sample in samples if isinstance(sample, ImuSample)]
    time_s = np.array([sample.t_ns - imu[0].t_ns for sample in imu]) * 1e-9
    rate = np.array([sample.rate_rad_s[2] for sample in imu])
    rate -= rate[time_s < 0.5].mean()
    true = recording('cleaning', 3, 60.0).truth.trajectory.motion(time_s).euler_rad[:, 2]
    own = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])
    yaw_rad = share * own + (1.0 - share) * true
    return [
        HeadingSample(sample.t_ns, float(yaw)) for sample, yaw in zip(imu[::10], yaw_rad[::10], strict=True)
    ]


@pytest.mark.parametrize('share', [0.8, 1.0])
def test_it_calibrates_nothing(share: float) -> None:
    made = recording('cleaning', 3, 60.0)

    def with_headings(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        samples = [sample for sample in measurements if not isinstance(sample, FeatureObservations)]
        yield from sorted([*samples, *integrated(samples, share)], key=lambda sample: sample.t_ns)

    source = ModifiedSource(made, with_headings, replace(made.rig, camera=None))
    run = calibrate(source, Config(), default_model())
    assert [event.text for event in run.events].count(CONTAINS_GYRO) == 1
    calibration = conclude(run)
    assert not calibration.converged and calibration.scale_factor_std > 0.05
