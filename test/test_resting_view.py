"""A robot at rest sees what moves: such features leave the map, unless it is the robot that was moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, FeatureObservations, IntArray, TruthSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.resting_view import MIN_SHIFTS, SHIFTED_IMAGES, RestingView
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.camera import bearing, mount_from_yaw
from gyrocal_ros.model.features.base import PosedCamera, posed_camera
from gyrocal_ros.sim.scenarios import CAMERA, find_scenario
from gyrocal_ros.sim.world import SimSource

MOUNT = mount_from_yaw(0.09, 0.0, 0.1, -90.0)
IDS = np.arange(8)
RNG = np.random.default_rng(0)
PIXELS = RNG.uniform([50.0, 50.0], [270.0, 190.0], (8, 2))
NOISE_PX = 0.05
RATE_PX = 0.4
"""Motion from one image to the next, in pixels."""
SHIFT = RATE_PX * np.array([0.8, -0.6])
SUN = np.array([1, 4, 6])
"""Features on a patch of sun."""
REST_S = 3.0
"""Time for which the simulated robot stands at first."""


def view(yaw_rad: float = 0.0) -> PosedCamera:
    """Return the camera of a robot with a heading."""
    return posed_camera(CAMERA, MOUNT, np.zeros(3), np.array([0.0, 0.0, yaw_rad]))


def moving(shifts_px: Array, images: int = 20) -> IntArray:
    """Return what moves after some images in which features (8,) shift by vectors (8, 2) each."""
    resting = RestingView()
    found = np.empty(0, np.int64)
    for k in range(images):
        noise = RNG.normal(0.0, NOISE_PX, PIXELS.shape)
        _, found = resting.see(IDS, PIXELS + k * shifts_px + noise, view(), NOISE_PX)
    return found


def no_motion(seen: tuple[IntArray, IntArray]) -> bool:
    """Return True if an image shows neither a shift nor a moving feature."""
    return not any(len(ids) for ids in seen)


def shifts_of(ids: IntArray) -> Array:
    """Return the shifts (8, 2) of a view in which some features move."""
    return np.isin(IDS, ids)[:, None] * SHIFT


def test_what_shifts_while_others_stay_moves() -> None:
    np.testing.assert_array_equal(moving(shifts_of(SUN)), SUN)


def test_nothing_moves_in_a_view_that_stays() -> None:
    assert not len(moving(np.zeros((8, 2)), images=200))


@pytest.mark.parametrize('staying', [0, 2])
def test_a_robot_that_is_moved_sees_no_motion_of_its_own(staying: int) -> None:
    assert not len(moving(shifts_of(IDS[staying:])))


def test_features_that_appear_while_the_robot_is_moved_do_not_count_as_staying() -> None:
    resting = RestingView()
    for k in range(20):
        ids = np.concatenate([IDS, 100 + IDS + 8 * k])  # eight new ones in each image
        pixels = np.concatenate([PIXELS + k * SHIFT, PIXELS])
        assert no_motion(resting.see(ids, pixels, view(), NOISE_PX))


def test_wrong_matches_do_not_move() -> None:
    resting = RestingView()
    for k in range(30):
        pixels = PIXELS.copy()
        if k % SHIFTED_IMAGES != 1:  # wrong at first, and later two at a time
            pixels[2] += 15.0
        assert not len(resting.see(IDS, pixels, view(), NOISE_PX)[1])
    for _ in range(MIN_SHIFTS * SHIFTED_IMAGES):  # the first place was wrong, this one is right
        assert not len(resting.see(IDS, PIXELS, view(), NOISE_PX)[1])


def test_a_sway_that_the_gyro_measures_is_not_motion() -> None:
    resting, lens = RestingView(), replace(CAMERA, distortion=(0.0,) * 5)
    directions = np.column_stack([bearing(lens, PIXELS), np.ones(len(PIXELS))])
    for yaw_rad in 0.02 * np.sin(np.arange(30)):
        there = replace(view(float(yaw_rad)), camera=lens)
        seen = directions @ view().R_wc.T @ there.R_wc
        pixels = seen[:, :2] / seen[:, 2:] * lens.fx_px + [lens.cx_px, lens.cy_px]
        assert no_motion(resting.see(IDS, pixels, there, NOISE_PX))


def test_a_robot_that_left_compares_with_nothing() -> None:
    resting = RestingView()
    for k in range(20):
        resting.leave()
        assert no_motion(resting.see(IDS, PIXELS + k * shifts_of(SUN), view(), NOISE_PX))


def test_a_feature_that_shifts_is_compared_with_its_new_place() -> None:
    resting = RestingView()
    shifted = []
    for k in range(9):
        pixels = PIXELS + (k > 2) * 2.0 * shifts_of(SUN) / RATE_PX
        now, moving = resting.see(IDS, pixels, view(), NOISE_PX)
        shifted.append(now.tolist())
        assert not len(moving)
    assert [k for k, now in enumerate(shifted) if now == SUN.tolist()] == [2 + SHIFTED_IMAGES]
    assert sum(map(len, shifted)) == len(SUN)


def test_an_image_of_features_that_stay_shows_that_the_robot_does() -> None:
    resting = RestingView()
    seen = []
    for _ in range(3):
        resting.see(IDS, PIXELS, view(), NOISE_PX)
        seen.append(resting.is_still)
    resting.see(IDS, PIXELS + 2.0 * SHIFT / RATE_PX, view(), NOISE_PX)
    assert [*seen, resting.is_still] == [False, True, True, False]


def test_a_patch_of_sun_does_not_move_a_robot_at_rest() -> None:
    """A third of the features creep over the ceiling; as in images, errors of the others stay the same."""
    scenario = find_scenario('cleaning')
    errors = replace(scenario.errors, pixel_noise_px=NOISE_PX)
    simulated = SimSource(replace(scenario, duration_s=20.0, errors=errors), 3)
    config = replace(Config(), camera=replace(Config().camera, pixel_noise_px=NOISE_PX))
    stream = SlamStream(EkfSlam(default_model(), config, simulated.rig))
    first: dict[int, Array] = {}
    dropped: list[int] = []
    for item in simulated.measurements():
        rest_s = (item.t_ns - simulated.span.start_ns) / NS_PER_S
        if rest_s > REST_S:
            break
        if isinstance(item, FeatureObservations):
            pixels = np.array(
                [first.setdefault(int(i), at) for i, at in zip(item.ids, item.pixels, strict=True)]
            )
            pixels += np.isin(item.ids, list(first)[:5])[:, None] * np.array([1.2, -0.9]) * rest_s
            covariances = np.broadcast_to(NOISE_PX**2 * np.eye(2), (len(pixels), 2, 2))
            item = replace(item, pixels=pixels, covariances_px2=covariances)
        if not isinstance(item, TruthSample):
            dropped += [int(i) for record in stream.step(item) for i in record.update.dropped_ids]
    state = stream.slam.state
    assert not np.isin(list(first)[:5], state.landmarks.ids).any()
    assert set(dropped) == set(list(first)[:5])
    assert np.isin(list(first)[5:], state.landmarks.ids).all()
    assert np.hypot(*state.position_m[:2]) < 1e-3
