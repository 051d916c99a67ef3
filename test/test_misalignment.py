"""A camera that is tilted against the gyros: in turns, the x and y gyros miss a part of the rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations import predict
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import EULER
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

SPINS_S, LANES_S = 30.0, 30.0
TILT_RAD, PIXEL_PX = 0.03, 0.05


def spun_and_driven(tilt_rad: float) -> Run:
    """Spin on the spot, then drive straight, below a camera that is tilted about both axes."""
    usual = find_scenario('spins')
    scenario = replace(
        usual,
        stages=(('spins', SPINS_S), ('lanes', 0.0)),
        duration_s=SPINS_S + LANES_S,
        camera_hz=10,
        errors=replace(usual.errors, pixel_noise_px=PIXEL_PX),
    )
    hidden = (HiddenEffect(find_effect('camera_tilt'), (tilt_rad, -tilt_rad)),) if tilt_rad else ()
    config = Config()
    config = replace(config, camera=replace(config.camera, pixel_noise_px=PIXEL_PX))
    return calibrate(SimSource(scenario, 3, hidden=hidden), config, default_model())


def largest_tilt_deg(run: Run) -> float:
    return float(np.degrees(np.abs(run.history.mean[:, EULER][:, :2]).max()))


@pytest.mark.slow
def test_images_of_a_tilted_camera_fit_after_spins() -> None:
    run = spun_and_driven(TILT_RAD)
    assert run.history.pixel_noise_px[-1] < 1.5 * PIXEL_PX
    assert largest_tilt_deg(run) < 3.0 * np.degrees(TILT_RAD)


@pytest.mark.slow
def test_they_do_not_where_what_spins_tell_of_the_biases_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predict, 'MISALIGNMENT_RAD', 0.0)
    assert spun_and_driven(TILT_RAD).history.pixel_noise_px[-1] > 20.0 * PIXEL_PX


@pytest.mark.slow
def test_below_an_upright_camera_the_robot_stays_level() -> None:
    run = spun_and_driven(0.0)
    assert largest_tilt_deg(run) < 0.7 and run.history.pixel_noise_px[-1] < 1.1 * PIXEL_PX
