"""Features on the lens: they stay in the image while the view changes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations, Frame, nanoseconds
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.sim.render import CeilingRenderer, ceiling_renderer
from gyrocal_ros.vision.dirty_lens import LIFETIME_S
from gyrocal_ros.vision.lens_marks import LensMarks, ViewChange
from gyrocal_ros.vision.tracker import Tracker

CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (0.0,) * 5)
SPECKS = np.array([[100, 120], [220, 330], [330, 100], [420, 400], [540, 200], [560, 380]])


@pytest.fixture(scope='module')
def renderer() -> CeilingRenderer:
    return ceiling_renderer(CAMERA, 1, ceiling_height_m=2.5, objects=0)


def image(renderer: CeilingRenderer, x_m: float, yaw_rad: float, dusty: bool) -> NDArray[np.uint8]:
    rendered = renderer.render(attitude(yaw_rad), np.array([x_m, 0.0, 0.1]), rng=np.random.default_rng(0))
    for u, v in SPECKS if dusty else ():
        cv2.circle(rendered, (int(u), int(v)), 9, 20, -1)
    return np.asarray(cv2.GaussianBlur(rendered, (0, 0), 1.0), np.uint8)


def attitude(yaw_rad: float) -> Array:
    return rotation_from_euler(np.array([0.0, 0.0, yaw_rad]))


def drive(
    renderer: CeilingRenderer, step_m: float, step_rad: float, dusty: bool = True, images: int = 20
) -> list[FeatureObservations]:
    tracker = Tracker(CAMERA, TrackerConfig())
    return [
        tracker.track(
            Frame(nanoseconds(0.1 * k), image(renderer, step_m * k, step_rad * k, dusty)),
            attitude(step_rad * k),
            None,
        )
        for k in range(images)
    ]


def near_specks(seen: FeatureObservations) -> int:
    distances_px = np.linalg.norm(seen.pixels[:, None] - SPECKS, axis=2).min(axis=1)
    return int((distances_px < 12.0).sum())


@pytest.mark.parametrize(('step_m', 'step_rad'), [(0.08, 0.0), (0.0, 0.06), (0.03, 0.04)])
def test_specks_are_dropped_when_the_view_changes(
    renderer: CeilingRenderer, step_m: float, step_rad: float
) -> None:
    seen = drive(renderer, step_m, step_rad)
    assert near_specks(seen[0]) >= 5
    assert sum(each.on_lens for each in seen) >= 5
    assert max(near_specks(each) for each in seen[-5:]) <= 1
    assert min(len(each.ids) for each in seen[-5:]) >= 10


def test_nothing_is_dropped_at_rest_or_from_a_clean_lens(renderer: CeilingRenderer) -> None:
    resting = drive(renderer, 0.0, 0.0, images=6)
    assert near_specks(resting[-1]) >= 5
    assert sum(each.on_lens for each in resting) == 0
    assert sum(each.on_lens for each in drive(renderer, 0.03, 0.04, dusty=False)) == 0


def test_what_comes_back_after_a_full_turn_is_not_on_the_lens(renderer: CeilingRenderer) -> None:
    """A feature of the ceiling is elsewhere in between; specks are found as before."""
    spins = drive(renderer, 0.0, 2.0 * np.pi / 45, dusty=False, images=100)
    assert sum(each.on_lens for each in spins) == 0
    assert len(set(spins[-1].ids.tolist()) & set(spins[0].ids.tolist())) >= 5


def test_a_change_of_light_is_no_change_of_the_view(renderer: CeilingRenderer) -> None:
    view, first = ViewChange(), image(renderer, 0.0, 0.0, dusty=False)
    rng = np.random.default_rng(0)
    for gain in (1.0, 0.5, 1.0, 0.8):
        noisy = gain * first + rng.normal(0.0, 3.0, first.shape)
        view.add(np.clip(noisy, 0, 255).astype(np.uint8))
    view.add(np.zeros_like(first))
    view.add(first)
    assert view.number == 1
    view.add(image(renderer, 0.3, 0.0, dusty=False))
    assert view.number == 2


def test_marks_are_forgotten() -> None:
    marks = LensMarks()
    marks.add(np.array([[10, 20]]), 0)
    marks.add(np.array([[30, 40]]), nanoseconds(LIFETIME_S - 1.0))
    assert len(marks.pixels) == 2
    marks.add(np.zeros((0, 2), np.intp), nanoseconds(LIFETIME_S + 1.0))
    assert marks.pixels.tolist() == [[30, 40]]
