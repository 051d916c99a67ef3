"""A gyro or a camera that is loose in its mount."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import turn_against_body_rad
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.mount_backlash import MountBacklash
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.sensor import with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect

DEG = math.radians(1.0)
EFFECT = MountBacklash()


def jumps(rates_deg_s: list[float], bias_deg_s: float = 0.0, rests: bool = False) -> Array:
    """Return what the heading jumps by, in plays, in ten intervals of 0.1 s."""
    block = eventful_block(len(rates_deg_s))
    rates = np.zeros((len(rates_deg_s), 3))
    rates[:, 2] = np.array(rates_deg_s) * DEG
    block = replace(block, rate_rad_s=rates, dt_s=np.full(len(rates), 0.1), wheels_at_rest=rests)
    term = EFFECT.contribute(replace(block, bias_rad_s=bias_deg_s * DEG), np.array([1.0]), None)
    return term.rate_rad_s * block.dt_s


def test_the_heading_jumps_at_turns_to_the_other_side() -> None:
    jumped = jumps([20.0, 20.0, 0.0, 20.0, -20.0, -20.0, 0.0, -20.0, 20.0, 20.0])
    np.testing.assert_allclose(jumped, [0.5, 0, 0, 0, -1, 0, 0, 0, 1, 0], atol=1e-12)


def test_neither_a_rest_nor_the_bias_crosses_the_play() -> None:
    assert not jumps([20.0, -20.0], rests=True).any()
    np.testing.assert_allclose(jumps([20.0, -1.0, -1.0, -1.0, -1.0], bias_deg_s=1.0)[1:], 0.0, atol=1e-12)


def test_a_loose_camera_stays_behind_while_its_play_is_crossed() -> None:
    """Half of the play of 4 deg is crossed from its middle, and all of it in the other direction."""
    block = eventful_block(20)
    rates = np.zeros((20, 3))
    rates[:, 2] = np.where(np.arange(20) < 8, 4.0, -4.0) * DEG
    block = replace(block, rate_rad_s=rates, dt_s=np.full(20, 0.1), bias_rad_s=0.0, wheels_at_rest=False)
    loose = with_means(EFFECT, (-4.0 * DEG,))
    turned = rates[:, 2] + loose.contribute(block, np.array([-4.0 * DEG]), None).rate_rad_s
    stays = np.r_[np.arange(5), 8 + np.arange(10)]
    np.testing.assert_allclose(turned[stays], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.delete(turned, stays), np.delete(rates[:, 2], stays))


@pytest.mark.parametrize('play_deg', [0.5, -0.5])
def test_readings_of_a_simulated_robot_lose_or_gain_the_play_at_each_turn_back(play_deg: float) -> None:
    rates = np.repeat([0.0, 30.0, 0.0, 30.0, 0.0, -30.0, 0.0], 100) * DEG
    dt_s = np.full(len(rates), 0.01)
    read = EFFECT.readings(rates, dt_s, np.array([play_deg * DEG]), 1.0)
    lost = np.cumsum((rates - read) * dt_s)[np.arange(50, len(rates), 200)] / DEG
    np.testing.assert_allclose(lost, np.array([0.0, 0.5, 0.5, -0.5]) * play_deg, atol=1e-9)


def test_without_play_the_readings_are_those_of_the_sensor() -> None:
    rates = np.linspace(-1.0, 1.0, 50)
    assert EFFECT.readings(rates, np.full(50, 0.01), np.zeros(1), 1.0) is rates


@pytest.mark.slow
@pytest.mark.parametrize('play_deg', [0.1, -0.1, -0.5])
def test_the_filter_estimates_the_play(play_deg: float) -> None:
    source = recording(hidden=(HiddenEffect(EFFECT, (play_deg * DEG,)),), camera_hz=10, duration_s=90.0)
    model = default_model()
    loose = with_means(EFFECT, (play_deg * DEG,))  # as a diagnosis has it
    history = calibrate(source, Config(), replace(model, effects=(*model.effects, loose))).history
    found_deg = math.degrees(history.mean[-1, COEFFICIENTS_START + 1])
    assert found_deg == pytest.approx(play_deg, rel=0.2)


@pytest.mark.parametrize(('play_deg', 'turn_deg'), [(-0.4, 0.4), (0.4, 0.0)])
def test_a_loose_camera_turns_against_the_robot(play_deg: float, turn_deg: float) -> None:
    """So the heading of the map may differ from that of the robot by the play: that is no drift."""
    assert EFFECT.turn_against_body_rad(np.array([play_deg * DEG])) == pytest.approx(turn_deg * DEG)
    loose = with_means(EFFECT, (play_deg * DEG,))
    model = replace(default_model(), effects=(*default_model().effects, loose))
    run = calibrate(recording(duration_s=20.0), Config(), model)
    state = replace(run.state, mean=np.append(run.state.mean[:COEFFICIENTS_START], [0.0, play_deg * DEG]))
    assert turn_against_body_rad(replace(run, state=state)) == pytest.approx(turn_deg * DEG)
