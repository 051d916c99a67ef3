"""A camera that is knocked while the robot drives: the calibration survives, and the knock is reported."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, FeatureObservations, Measurement, TruthSample
from gyrocal_ros.diagnose.analysis.drift import blind_drift
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.paths import slam_path
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.status import calibration_status, diagnosis_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, UpdateStats
from gyrocal_ros.ekf.features.knock_watch import KNOCKED, MOST_KNOCKS, SOUND_IMAGES, KnockWatch
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.turn_agreement import knocked_steps
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.statistics import nis_per_dof

AT_S, TURN_DEG = 40.0, 2.0


@cache
def recording() -> tuple[InMemorySource, float]:
    """Return a recording without ground truth whose camera turns about the vertical, and its scale factor."""
    scenario = replace(find_scenario('cleaning'), duration_s=120.0, imu_hz=100, camera_hz=8)
    simulated = SimSource(scenario, 1)
    camera, mount = simulated.rig.camera, simulated.rig.camera_mount
    assert camera is not None
    c, s = math.cos(math.radians(TURN_DEG)), math.sin(math.radians(TURN_DEG))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def changed(item: Measurement) -> Measurement:
        if not isinstance(item, FeatureObservations) or item.t_ns < simulated.span.start_ns + AT_S * NS_PER_S:
            return item
        rays_b = np.column_stack([bearing(camera, item.pixels), np.ones(len(item.ids))]) @ mount.R_bs.T
        return replace(item, pixels=project(camera, rays_b @ turn @ mount.R_bs))

    measured = [changed(item) for item in simulated.measurements() if not isinstance(item, TruthSample)]
    source = InMemorySource('knock', simulated.rig, simulated.span, measured)
    return source, simulated.truth.scale_factor


@pytest.fixture(scope='module')
def run() -> Run:
    return calibrate(recording()[0], Config(), default_model(), follows_changes=True)


def test_the_gyro_stays_calibrated(run: Run) -> None:
    calibration, true = conclude(run), recording()[1]
    assert abs(calibration.scale_factor - true) < 3.0 * calibration.scale_factor_std < 9e-4
    assert calibration.converged and model_fit(run).fits is not False
    assert nis_per_dof(run.history.nis, run.history.dof) == pytest.approx(1.0, abs=0.2)


def test_the_knock_is_reported_with_its_size(run: Run) -> None:
    (event,) = [event for event in run.events if KNOCKED in event.text]
    assert (event.t_ns - run.span.start_ns) / NS_PER_S == pytest.approx(AT_S, abs=0.2)
    assert f'{TURN_DEG:+.1f} deg' in event.text
    status = calibration_status(conclude(run), run, model_fit(run))
    assert status.level == 'yellow' and KNOCKED in status.sentence and 'fasten' in status.next_step.lower()


def test_the_heading_is_off_by_it_and_no_span_holds_it(run: Run) -> None:
    """The headings of the run itself are no reference across the knock."""
    (step,) = np.flatnonzero(knocked_steps(run))
    jumped = np.diff(slam_path(run).yaw_rad)[step - 1] - run.history.turn_rad[step]
    assert math.degrees(jumped) == pytest.approx(TURN_DEG, abs=0.4)
    spans = blind_drift(run, from_s=0.0, span_s=20.0)
    assert len(spans.start_s) and not np.any((spans.start_s < AT_S) & (spans.start_s + 20.0 > AT_S + 0.2))


def test_nothing_is_accused_of_it() -> None:
    source = recording()[0]
    recorded = summarise_recording(source)

    @remembered
    def once(model, candidates):  # type: ignore[no-untyped-def]
        return calibrate(source, Config(), model, candidates=candidates)

    found = diagnose(find_missing(default_model(), recorded, once), recorded)
    assert found.verdict == 'nothing_missing' and not found.missing
    status = diagnosis_status(found)
    assert status.level == 'yellow' and status.sentence.startswith('The camera was knocked')


def turned(turn_rad: float, nis: float = 1e4) -> MeasurementUpdate:
    return MeasurementUpdate(freed_turn_rad=turn_rad, stats=UpdateStats(nis=nis, dof=20))


SOUND = turned(0.0, nis=25.0)


def test_a_turn_among_images_that_do_not_agree_is_no_knock() -> None:
    watch = KnockWatch()
    for place in range(2 * SOUND_IMAGES):
        watch.see(turned(0.0) if place == SOUND_IMAGES + 1 else SOUND, 0.0)
    update, event = watch.see(turned(0.03), 0.0)
    assert not event and update.stats.nis == 1e4


def test_a_law_of_the_gyro_is_no_knock() -> None:
    """Where the scale differs by 4 % between the sides, images contradict each turn, some of them by much."""
    scenario = replace(find_scenario('demo'), duration_s=100.0, imu_hz=100, camera_hz=4)
    hidden = HiddenEffect(find_effect('scale_asymmetry'), (0.02,))
    run = calibrate(SimSource(scenario, 3, hidden=(hidden,)), Config(), default_model())
    assert float((run.history.nis / np.maximum(run.history.dof, 1)).max()) > 20.0
    assert not knocked_steps(run).any()


def test_a_turn_against_one_of_the_gyro_is_no_knock() -> None:
    watch = KnockWatch()
    for _ in range(SOUND_IMAGES):
        watch.see(SOUND, 0.0)
    assert not watch.see(turned(0.08), -0.5)[1]


def test_what_turns_the_camera_again_and_again_is_no_knock() -> None:
    watch, events = KnockWatch(), []
    for _ in range(MOST_KNOCKS + 2):
        for _ in range(SOUND_IMAGES):
            watch.see(SOUND, 0.0)
        update, event = watch.see(turned(-0.03), 0.0)
        events.append(event)
        assert (update.stats.dof == 0) == bool(event)
    assert [bool(event) for event in events] == [True] * MOST_KNOCKS + [False] * 2
    assert '-1.7 deg' in events[0]
