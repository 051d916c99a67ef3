"""Features that turn with the camera."""

from __future__ import annotations

import numpy as np
import pytest
from contracts import CAMERA, view_at
from recordings import ModifiedSource, each, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, seconds
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.turning_view import STAYS_PX, TURNS_WITH_CAMERA, turn_with_camera
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.model.features.base import Anchors, PosedCamera
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.sensors import SensorErrors

RNG = np.random.default_rng(0)
COUNT = 12
FIRST_PX = RNG.uniform([60.0, 60.0], [580.0, 420.0], (COUNT, 2))
NOISE_PX = 0.05


def view(yaw_deg: float) -> PosedCamera:
    """Return the camera of a robot that has turned."""
    return view_at(np.array([0.3, 0.1, 0.0, 0.0, 0.0, np.radians(yaw_deg)]))


def anchors(count: int = COUNT) -> Anchors:
    """Return the camera at the first sight of features."""
    first, none = view(0.0), np.empty((count, 3, 0))
    return Anchors(np.tile(first.R_wc, (count, 1, 1)), np.tile(first.p_wc, (count, 1)), none, none)


def on_the_ceiling(yaw_deg: float) -> Array:
    """Return where features of the room are after a turn."""
    rays = np.column_stack([bearing(CAMERA, FIRST_PX), np.ones(COUNT)])
    return project(CAMERA, rays @ view(0.0).R_wc.T @ view(yaw_deg).R_wc)


def turning(pixels: Array, yaw_deg: float) -> list[int]:
    """Return the features that turn with the camera."""
    directions = bearing(CAMERA, FIRST_PX[: len(pixels)])
    found = turn_with_camera(view(yaw_deg), directions, anchors(len(pixels)), pixels, STAYS_PX)
    return np.flatnonzero(found).tolist()


@pytest.mark.parametrize('yaw_deg', [1.5, -4.0, 90.0])
def test_dust_turns_with_the_camera(yaw_deg: float) -> None:
    pixels = FIRST_PX + RNG.normal(0.0, NOISE_PX, FIRST_PX.shape)
    assert len(turning(pixels, yaw_deg)) >= 10
    assert turning(on_the_ceiling(yaw_deg), yaw_deg) == []


def test_a_turn_too_small_to_see_tells_nothing() -> None:
    assert turning(FIRST_PX, 0.05) == []


def test_some_specks_among_features_of_the_room_are_no_reason_to_leave_an_image_out() -> None:
    pixels = on_the_ceiling(5.0)
    pixels[:5] = FIRST_PX[:5]
    assert turning(pixels, 5.0) == []


def test_dust_outvotes_a_wrong_match() -> None:
    pixels = FIRST_PX.copy()
    pixels[7] += 20.0
    assert turning(pixels, 5.0) == [k for k in range(COUNT) if k != 7]


def test_two_features_are_too_few() -> None:
    assert turning(FIRST_PX[:2], 5.0) == []


DUST_PX = RNG.uniform([60.0, 60.0], [580.0, 420.0], (8, 2))


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'dark_s'), [(1, (18.0, 28.0)), (2, (39.0, 51.0)), (4, (39.0, 53.0))])
def test_dust_in_the_dark_does_not_spoil_a_calibration(seed: int, dark_s: tuple[float, float]) -> None:
    """Without the check the scale factor was 900 and 100 standard deviations off, or the filter diverged."""

    def in_the_dark(image: FeatureObservations) -> FeatureObservations:
        if not dark_s[0] < seconds(image.t_ns - source.span.start_ns) < dark_s[1]:
            return image
        pixels = DUST_PX + np.random.default_rng(image.t_ns).normal(0.0, NOISE_PX, DUST_PX.shape)
        return FeatureObservations(image.t_ns, 10_000 + np.arange(len(DUST_PX)), pixels)

    source = recording(seed=seed)
    run = calibrate(ModifiedSource(source, each(FeatureObservations, in_the_dark)), Config(), default_model())
    assert [event.text for event in run.events] == [TURNS_WITH_CAMERA]
    error = 1.0 + float(run.state.coefficients[0]) - SensorErrors().scale_factor
    assert abs(error) < 3.0 * np.sqrt(run.state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])
    assert run.history.nis.sum() / run.history.dof.sum() == pytest.approx(1.0, abs=0.15)
