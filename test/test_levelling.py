"""Levelling by gravity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_states import some_state

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.ekf.equations.levelling import Levelling, unlevelled
from gyrocal_ros.ekf.state.layout import EULER, State

GRAVITY_M_S2 = 9.80665
DT_S, COUNT = 0.01, 10


def block(force: tuple[float, float, float], rate: Array | None = None) -> MotionBlock:
    """Return 0.1 s of constant specific force, with small rates about x and y."""
    rates = np.tile([1e-4, 1e-4, 0.0], (COUNT, 1)) if rate is None else rate
    zeros = np.zeros(COUNT)
    return MotionBlock(
        start_ns=0,
        end_ns=int(COUNT * DT_S * 1e9),
        time_s=DT_S * np.arange(COUNT),
        dt_s=np.full(COUNT, DT_S),
        rate_rad_s=rates,
        yaw_acceleration_rad_s2=zeros,
        specific_force_m_s2=np.tile(force, (COUNT, 1)),
        vibration_m2_s4=zeros,
        distance_m=zeros,
        wheel_turn_rad=zeros,
        temperature_c=np.full(COUNT, np.nan),
        wheel_gap_s=COUNT * DT_S,
    )


def tilted(roll_rad: float, pitch_rad: float) -> tuple[float, float, float]:
    return (
        -GRAVITY_M_S2 * math.sin(pitch_rad),
        GRAVITY_M_S2 * math.sin(roll_rad) * math.cos(pitch_rad),
        GRAVITY_M_S2 * math.cos(roll_rad) * math.cos(pitch_rad),
    )


def start() -> State:
    state = some_state()
    mean = state.mean.copy()
    mean[EULER][:2] = 0.0
    return unlevelled(replace(state, mean=mean))


def levelled(force: tuple[float, float, float], rate: Array | None = None, times: int = 300) -> State:
    state, levelling = start(), Levelling()
    for _ in range(times):
        state = levelling.update(state, block(force, rate))
    return state


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_roll_and_pitch_become_those_of_gravity(sign: float) -> None:
    """A driver may publish gravity in place of the specific force."""
    x, y, z = tilted(0.06, -0.03)
    state = levelled((sign * x, sign * y, sign * z))
    np.testing.assert_allclose(state.euler_rad[:2], [0.06, -0.03], atol=2e-3)


def test_an_accelerated_or_turning_robot_teaches_less() -> None:
    still, braking = (levelled((x, 0.0, GRAVITY_M_S2), times=5) for x in (0.0, 4.0))
    turning = levelled(tilted(0.0, 0.0), np.tile([1e-4, 1e-4, 1.0], (COUNT, 1)), times=5)
    stds = [math.sqrt(state.covariance[EULER, EULER][1, 1]) for state in (still, braking, turning)]
    assert stds[0] < 0.9 * stds[1] and stds[0] < 0.9 * stds[2]


def test_a_gyro_with_one_axis_is_not_levelled() -> None:
    state = levelled(tilted(0.06, 0.0), np.tile([0.0, 0.0, 0.3], (COUNT, 1)), times=1)
    np.testing.assert_array_equal(state.mean, start().mean)


def test_the_noise_of_the_tilt_gyros_is_measured() -> None:
    """Readings of a block are means of two samples, as the buffer makes them."""
    rng, levelling, density = np.random.default_rng(0), Levelling(), np.array([0.002, 0.02])
    for _ in range(300):
        samples = density / math.sqrt(DT_S) * rng.standard_normal((COUNT + 1, 2))
        rates = np.zeros((COUNT, 3))
        rates[:, :2] = 0.5 * (samples[1:] + samples[:-1])
        found = levelling.rate_noise_rad_s(block((0.0, 0.0, GRAVITY_M_S2), rates))
    np.testing.assert_allclose(found, density, rtol=0.15)
