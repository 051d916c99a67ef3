"""Wheels that slip, a robot that is lifted, a view that moves: which sensor says where the robot is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, FeatureObservations, ImuSample, Measurement, WheelSample
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.features.robust import LIFT_RATE, SLIP_RATE, Slip
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.map_watch import GOES_ON_S, LIFTED, LIFTED_IMAGES, SLIPS, SlipWatch
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
    scenario = replace(find_scenario('cleaning'), duration_s=70.0, imu_hz=100, camera_hz=8)
    simulated = SimSource(scenario, seed)
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


LIFT_S, LIFTED_S = 30.0, 5.0
"""Time at which somebody takes the robot, and for how long."""
LIFT_M, ROCK_RAD = np.array([0.25, -0.15, 0.35]), 0.12
"""Largest displacement of the robot in the hands, and amplitude of its roll."""


def lift(time_s: Array) -> tuple[Array, Array, Array]:
    """Return the displacement (n, 3), the roll (n,) and its rate (n,) of the robot in somebody's hands."""
    part = np.clip((time_s - LIFT_S) / LIFTED_S, 0.0, 1.0)
    there, phase = np.sin(np.pi * part) ** 2, 4.0 * np.pi * part
    d_part = np.where((part > 0.0) & (part < 1.0), 1.0 / LIFTED_S, 0.0)
    d_there = np.pi * np.sin(2.0 * np.pi * part) * d_part
    rate = ROCK_RAD * (d_there * np.sin(phase) + there * np.cos(phase) * 4.0 * np.pi * d_part)
    return there[:, None] * LIFT_M, ROCK_RAD * there * np.sin(phase), rate


def rolls(roll_rad: Array) -> Array:
    """Return rotations (n, 3, 3) about the x axis."""
    rotations = np.tile(np.eye(3), (len(roll_rad), 1, 1))
    rotations[:, 1, 1] = rotations[:, 2, 2] = np.cos(roll_rad)
    rotations[:, 2, 1] = np.sin(roll_rad)
    rotations[:, 1, 2] = -rotations[:, 2, 1]
    return rotations


class LiftedSource(SimSource):
    """A simulated robot that somebody lifts; its wheels are switched off meanwhile."""

    def camera_poses(self, time_s: Array) -> tuple[Array, Array]:
        R_wc, p_wc = super().camera_poses(time_s)
        mount, (displaced_m, roll_rad, _) = self.truth.camera_mount, lift(time_s)
        R_wb = R_wc @ mount.R_bs.T
        R_wb_lifted = R_wb @ rolls(roll_rad)
        p_wb = p_wc - R_wb @ mount.p_bs + displaced_m
        return R_wb_lifted @ mount.R_bs, p_wb + R_wb_lifted @ mount.p_bs

    def _wheels(self) -> Iterator[WheelSample]:
        for item in super()._wheels():
            is_lifted = 0.0 < (item.t_ns - self.span.start_ns) / NS_PER_S - LIFT_S < LIFTED_S
            yield replace(item, speed_m_s=0.0, yaw_rate_rad_s=0.0) if is_lifted else item

    def _imu(self) -> Iterator[ImuSample]:
        samples, truth = list(super()._imu()), self.truth
        time_s = np.array([item.t_ns - self.span.start_ns for item in samples]) / NS_PER_S
        _, roll_rad, rate = lift(time_s)
        level = truth.trajectory.motion(time_s).rate_rad_s
        added = (level[:, None] @ rolls(roll_rad))[:, 0] - level + rate[:, None] * [1.0, 0.0, 0.0]
        added[:, 2] /= truth.scale_factor
        for item, change in zip(samples, added, strict=True):
            yield replace(item, rate_rad_s=tuple((np.array(item.rate_rad_s) + change).tolist()))


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 2])
def test_a_robot_that_is_lifted_is_followed(seed: int) -> None:
    source = LiftedSource(replace(find_scenario('cleaning'), duration_s=70.0), seed)
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    calibration, history = conclude(run), run.history
    assert abs(calibration.scale_factor - source.truth.scale_factor) < 3.0 * calibration.scale_factor_std
    assert calibration.converged and model_fit(run).fits is not False
    assert sum(LIFTED in event.text for event in run.events) == 1
    is_high = np.abs(history.time_s - LIFT_S - 0.5 * LIFTED_S) < 0.1 * LIFTED_S
    np.testing.assert_allclose(history.mean[is_high, 2], LIFT_M[2], atol=0.06)
    assert np.abs(history.mean[history.time_s > LIFT_S + LIFTED_S + 1.0, 2]).max() < 0.03


def image_of(rate: Array | None, *, contradicts_turn: bool = False) -> MeasurementUpdate:
    return MeasurementUpdate(slip_std=rate, contradicts_turn=contradicts_turn)


def test_a_slip_and_a_lift_are_told_once_each() -> None:
    watch, step_ns = SlipWatch(), NS_PER_S // 10
    told = [watch.event(image_of(SLIP_RATE), step * step_ns) for step in range(3)]
    told += [watch.event(image_of(LIFT_RATE), step * step_ns) for step in range(3, 3 + LIFTED_IMAGES + 2)]
    assert [text for text in told if text] == [SLIPS, LIFTED]
    assert told.index(LIFTED) == 3 + LIFTED_IMAGES - 1


def test_a_slip_goes_on_for_a_while() -> None:
    watch = SlipWatch()
    assert watch.slip(0, drives=False) is Slip.POSSIBLE and watch.slip(0, drives=True) is Slip.ON_FLOOR
    watch.event(image_of(SLIP_RATE), NS_PER_S)
    soon_ns = NS_PER_S + round(0.9 * GOES_ON_S * NS_PER_S)
    assert watch.slip(soon_ns, drives=True) is Slip.GOES_ON
    assert watch.slip(2 * soon_ns, drives=False) is Slip.POSSIBLE
    for step in range(5):
        watch.event(image_of(None, contradicts_turn=True), soon_ns + step)
    assert watch.slip(soon_ns + 5, drives=False) is Slip.EXCLUDED


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
