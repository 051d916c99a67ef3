"""The way by the images is compared with that by the wheels: a turned camera, wheels that run backwards."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest
from contracts import eventful_block
from recordings import ModifiedSource, each, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, Mount, WheelSample
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import MissingEffect, diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.status import MEND_YAW, Status, diagnosis_status, improvement_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.features.way_agreement import TURNED_CAMERA, WRONG_YAW, WayAgreement, turned_camera
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate

SOURCE = recording('cleaning', 4, duration_s=60.0)


def calibrated(kind: type, change: Callable[[Any], Any]) -> Run:
    return calibrate(ModifiedSource(SOURCE, each(kind, change)), Config(), default_model())


def turned(seen: FeatureObservations, quarters: int) -> FeatureObservations:
    """Return features as a camera sees them that is turned about its axis by some right angles."""
    camera = SOURCE.rig.camera
    assert camera is not None
    centre = np.array([camera.cx_px, camera.cy_px])
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarters)
    return replace(seen, pixels=(seen.pixels - centre) @ turn.T + centre)


def test_a_good_robot_has_no_fault() -> None:
    run = calibrated(WheelSample, lambda wheels: wheels)
    assert mounting_fault(run) == '' and not run.events


@pytest.mark.parametrize('quarters, angles_deg', [(1, (89, 90, 91)), (2, (178, 179, 180))])
def test_a_camera_that_is_turned_about_its_axis(quarters: int, angles_deg: tuple[int, ...]) -> None:
    run = calibrated(FeatureObservations, lambda seen: turned(seen, quarters))
    fault = mounting_fault(run)
    assert fault.startswith(TURNED_CAMERA) and any(f'at {angle} deg' in fault for angle in angles_deg)
    assert sum(TURNED_CAMERA in event.text for event in run.events) == 1


@pytest.mark.parametrize('angle_deg', [-6.0, 5.0, 2.0])
def test_a_yaw_of_the_mount_that_was_measured_badly_is_told_as_such(angle_deg: float) -> None:
    rig = SOURCE.rig
    turn = rotation_from_euler(np.array([0.0, 0.0, math.radians(angle_deg)]))
    mount = replace(rig.camera_mount, R_bs=turn @ rig.camera_mount.R_bs, p_bs=rig.camera_mount.p_bs)
    source = ModifiedSource(SOURCE, iter, replace(rig, camera_mount=mount))
    run = calibrate(source, Config(), default_model())
    assert mounting_fault(run) == ''
    told = [event.text for event in run.events if WRONG_YAW in event.text]
    if abs(angle_deg) < 3.0:
        assert told == []
        return
    found = re.search(r'is ([+-][\d.]+) \S ([\d.]+) deg off', told[0])
    assert len(told) == 1 and found is not None
    assert abs(float(found[1]) - angle_deg) < 3.0 * float(found[2]) and float(found[2]) < 2.0


def test_a_diagnosis_tells_the_mount_and_judges_no_effect() -> None:
    source = ModifiedSource(SOURCE, each(FeatureObservations, lambda seen: turned(seen, 2)))

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        return calibrate(source, Config(), model, candidates=candidates)

    summary = summarise_recording(source)
    diagnosis = diagnose(find_missing(default_model(), summary, run), summary)
    status = diagnosis_status(diagnosis)
    assert diagnosis.verdict == 'cannot_tell'
    assert status.level == 'red' and TURNED_CAMERA in status.sentence
    assert status.next_step.startswith('Correct the transform of the camera')


def test_a_fault_is_told_without_what_else_happened_in_that_step() -> None:
    fault = mounting_fault(calibrated(FeatureObservations, lambda seen: turned(seen, 2)))
    assert turned_camera(f'the map was dropped; {fault}; the bias walks') == fault
    assert turned_camera('the map was dropped') == ''


def test_wheels_that_run_backwards() -> None:
    run = calibrated(WheelSample, lambda wheels: replace(wheels, speed_m_s=-wheels.speed_m_s))
    assert mounting_fault(run).startswith(TURNED_CAMERA)


def test_a_small_error_of_the_mount_is_left_to_effects() -> None:
    angle = np.radians(4.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    camera = SOURCE.rig.camera
    assert camera is not None
    centre = np.array([camera.cx_px, camera.cy_px])
    run = calibrated(
        FeatureObservations, lambda seen: replace(seen, pixels=(seen.pixels - centre) @ turn.T + centre)
    )
    assert mounting_fault(run) == ''


@pytest.mark.parametrize('known_rad_s, is_told', [(0.03, False), (0.0, True)])
def test_a_bias_of_the_gyro_turns_no_camera(known_rad_s: float, is_told: bool) -> None:
    """A camera that looks ahead shows a turn as it shows a way to the side."""
    rng, camera, agreement = np.random.default_rng(5), SOURCE.rig.camera, WayAgreement()
    assert camera is not None
    points_w = np.column_stack([rng.uniform(-4.0, 8.0, 900), rng.uniform(-4.0, 4.0, 900), np.full(900, 2.5)])
    lean = rotation_from_euler(np.array([0.0, math.radians(25.0), 0.0]))
    mount = Mount(lean @ SOURCE.rig.camera_mount.R_bs, np.zeros(3))
    for i in range(160):
        block = replace(
            eventful_block(),
            start_ns=i * 10**8,
            end_ns=(i + 1) * 10**8,
            dt_s=np.array([0.1]),
            rate_rad_s=np.array([[0.0, 0.0, -0.03]]),
            distance_m=np.array([0.02]),
        )
        agreement.move(block, known_rad_s)
        points_c = (points_w - [0.02 * (i + 1), 0.0, 0.0]) @ mount.R_bs
        pixels, _ = project_with_jacobian(camera, points_c)
        seen = (points_c[:, 2] > 0.5) & (pixels > 0.0).all(axis=1)
        seen &= (pixels < [camera.width_px, camera.height_px]).all(axis=1)
        ids = np.flatnonzero(seen)
        agreement.event(FeatureObservations(block.end_ns, ids, pixels[ids]), camera, mount)
    assert (WRONG_YAW in agreement.finding) == is_told


@pytest.mark.slow
def test_a_diagnosis_tells_a_wrong_yaw_and_judges_neither_camera_nor_wheels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = SOURCE.rig
    turn = rotation_from_euler(np.array([0.0, 0.0, math.radians(8.0)]))
    mount = replace(rig.camera_mount, R_bs=turn @ rig.camera_mount.R_bs)
    source = ModifiedSource(SOURCE, iter, replace(rig, camera_mount=mount))

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        return calibrate(source, Config(), model, candidates=candidates)

    recorded = summarise_recording(source)
    found = diagnose(find_missing(default_model(), recorded, run), recorded)
    status = diagnosis_status(found)
    assert found.verdict == 'cannot_tell' and WRONG_YAW in found.wrong_yaw
    assert status.level != 'green' and 'Neither camera, wheels nor noise can be judged' in status.sentence
    for name in ('camera_position', 'bias_instability'):
        wrong = SimpleNamespace(effect=find_effect(name), confused_with=())
        imitated = diagnosis_status(replace(found, missing=cast('tuple[MissingEffect, ...]', (wrong,))))
        assert name not in imitated.sentence and imitated.next_step == MEND_YAW
    examined = SimpleNamespace(run=run(default_model(), ()))
    nothing = Mock(revisions=(), kept=(), harmful=(), final=Mock(examined=examined))
    of_revisions = 'gyrocal_ros.diagnose.status._status_of_revisions'
    monkeypatch.setattr(of_revisions, lambda improved: Status('green', 'Nothing was added.'))
    improved = improvement_status(nothing)
    assert (improved.level, improved.next_step) == ('yellow', MEND_YAW)
    assert WRONG_YAW[1:] in improved.sentence and improved.sentence.endswith('mended. Nothing was added.')
