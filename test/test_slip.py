"""Wheels that slip, or a view that moves: which of images and wheels says where the robot is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, FeatureObservations, Measurement, WheelSample
from gyrocal_ros.diagnose.model_fit import model_fit
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.map_watch import SLIPS
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.statistics import nis_per_dof

SLIPS_S, SLIP_S = (15.0, 40.0, 52.0), 3.0
"""Times at which the wheels begin to err, and for how long they do."""


def driven(changed: Callable[[Measurement, float], Measurement], seed: int = 1) -> tuple[Run, SimSource]:
    """Return a run and its source, with measurements changed, given their times (s)."""
    simulated = SimSource(replace(find_scenario('cleaning'), duration_s=70.0), seed)
    start_ns = simulated.span.start_ns
    measured = [changed(item, (item.t_ns - start_ns) / NS_PER_S) for item in simulated.measurements()]
    source = InMemorySource('slip', simulated.rig, simulated.span, measured)
    return calibrate(source, Config(), default_model(), follows_changes=True), simulated


def slipping(added_m_s: float, factor: float = 1.0, *, always: bool = False) -> tuple[Run, SimSource]:
    """Return a run and its source, with wheels that err: a speed by a factor, and an added one."""

    def changed(item: Measurement, time_s: float) -> Measurement:
        errs = always or any(0.0 <= time_s - at_s < SLIP_S for at_s in SLIPS_S)
        if not isinstance(item, WheelSample) or not errs:
            return item
        return replace(
            item, speed_m_s=factor * item.speed_m_s + added_m_s, yaw_rate_rad_s=factor * item.yaw_rate_rad_s
        )

    return driven(changed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('added_m_s', 'factor'), [(0.2, 1.0), (0.0, 0.0)], ids=['wheels spin', 'encoders are stuck']
)
def test_wrong_wheels_spoil_neither_heading_nor_scale_factor(added_m_s: float, factor: float) -> None:
    run, simulated = slipping(added_m_s, factor)
    calibration = conclude(run)
    error = calibration.scale_factor - simulated.truth.scale_factor
    assert abs(error) < min(3.0 * calibration.scale_factor_std, 3e-4)
    assert calibration.converged and model_fit(run).fits is not False
    assert nis_per_dof(run.history.nis, run.history.dof) == pytest.approx(1.0, abs=0.2)
    events = [event for event in run.events if SLIPS in event.text]
    assert 1 <= len(events) <= len(SLIPS_S)
    assert all(
        any(0.0 <= (event.t_ns - run.span.start_ns) / NS_PER_S - at_s < SLIP_S for at_s in SLIPS_S)
        for event in events
    )


@pytest.mark.slow
def test_dead_encoders_do_not_hide_the_turns() -> None:
    run, simulated = slipping(0.0, 0.0, always=True)
    calibration = conclude(run)
    assert abs(calibration.scale_factor - simulated.truth.scale_factor) < 3.0 * calibration.scale_factor_std
    assert calibration.scale_factor_std < 5e-4


def test_wheels_that_do_not_slip_are_not_blamed() -> None:
    run, _ = slipping(0.0)
    assert not any(SLIPS in event.text for event in run.events)


def swaying(item: Measurement, time_s: float) -> Measurement:
    """Let a third of the features sway by 8 px, as those of a lamp that swings."""
    if not isinstance(item, FeatureObservations):
        return item
    sways = item.ids % 3 == 0
    sway_px = 8.0 * np.array([math.sin(1.9 * time_s), math.sin(3.1 * time_s)])
    return replace(item, pixels=item.pixels + sways[:, None] * sway_px)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [2, 4])
def test_a_third_of_the_view_that_sways_spoils_nothing(seed: int) -> None:
    run, simulated = driven(swaying, seed)
    calibration = conclude(run)
    error = calibration.scale_factor - simulated.truth.scale_factor
    assert abs(error) < min(3.0 * calibration.scale_factor_std, 3e-4)
    assert calibration.converged
    assert nis_per_dof(run.history.nis, run.history.dof) == pytest.approx(1.0, abs=0.2)
