"""The formulas of the paper: attitude, motion, camera, bias."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import CAMERA, differences, eventful_block
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.effects import find_effect
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.camera import (
    bearing,
    bearing_jacobian,
    in_image,
    mount_from_yaw,
    project,
    project_with_jacobian,
)
from gyrocal_ros.model.gyro import Correction, body_rates, correct
from gyrocal_ros.model.kinematics import PoseStep, integrate
from gyrocal_ros.model.lens import MAX_ANGLE_RAD, by_radial_coefficients, distort, undistort
from gyrocal_ros.model.rotation import euler_rate_matrices, rotation_derivatives, rotation_from_euler
from gyrocal_ros.model.sensor import SensorModel, placed

ATTITUDES = [
    np.array(euler, float) for euler in ([0, 0, 0], [0.1, -0.2, 3.0], [-0.7, 1.2, -2.0], [3.0, -1.4, 9.0])
]

# --- rotation -----------------------------------------------------------------------------------


@pytest.mark.parametrize('euler', ATTITUDES, ids=str)
class TestRotation:
    def test_matrix_agrees_with_z_y_x_angles(self, euler: Array) -> None:
        expected = Rotation.from_euler('ZYX', euler[::-1]).as_matrix()
        np.testing.assert_allclose(rotation_from_euler(euler), expected, atol=1e-15)

    def test_derivatives(self, euler: Array) -> None:
        expected = differences(rotation_from_euler, euler).transpose(2, 0, 1)
        np.testing.assert_allclose(rotation_derivatives(euler), expected, atol=1e-9)

    def test_body_rates_convert_to_angle_rates(self, euler: Array) -> None:
        """The angles of `R exp([w] dt)` are `euler + E w dt`."""
        rate = np.array([0.3, -0.5, 0.8])

        def attitude(turn: Array) -> Array:
            return rotation_from_euler(euler) @ Rotation.from_rotvec(turn).as_matrix()

        E_wb = euler_rate_matrices(euler[:, None])[:, :, 0]
        by_angles = differences(rotation_from_euler, euler) @ E_wb @ rate
        np.testing.assert_allclose(by_angles, differences(attitude, np.zeros(3)) @ rate, atol=1e-8)


# --- kinematics ---------------------------------------------------------------------------------

FRAME_S = 0.07
"""Interval between two images."""


def drive(intervals: int, tilt_rad: float, seed: int = 0) -> tuple[Array, Array, Array, Array]:
    """Return a start pose (6,), body rates, intervals and steps of a turn at 92 deg/s over a rough floor."""
    rng = np.random.default_rng(seed)
    dt_s = rng.uniform(0.9, 1.1, intervals) * FRAME_S / intervals
    rate = np.column_stack([rng.normal(0.0, 5.0 * tilt_rad, (intervals, 2)), np.full(intervals, 1.6)])
    return np.array([0.3, -0.2, 0.1, tilt_rad, -tilt_rad, 2.0]), rate, dt_s, 0.3 * dt_s


def step(pose: Array, rate: Array, dt_s: Array, distance_m: Array) -> Array:
    motion = integrate(pose[:3], pose[3:], rate, dt_s, distance_m)
    return np.concatenate([motion.position_m, motion.euler_rad])


def fine_integration(
    pose: Array, rate: Array, dt_s: Array, distance_m: Array, steps: int = 200
) -> tuple[Array, Array]:
    """Integrate position and attitude matrix in many small steps."""
    position, attitude = pose[:3].copy(), rotation_from_euler(pose[3:])
    for rates, interval, distance in zip(rate, dt_s, distance_m, strict=True):
        half = Rotation.from_rotvec(rates * interval / steps / 2.0).as_matrix()
        for _ in range(steps):
            attitude = attitude @ half
            position += attitude[:, 0] * distance / steps
            attitude = attitude @ half
    return position, attitude


@pytest.mark.parametrize('tilt_deg', [0.0, 0.3, 3.0], ids=['level', 'rough', 'ramp'])
@pytest.mark.parametrize('intervals', [7, 14])
def test_integration_agrees_with_a_fine_one(intervals: int, tilt_deg: float) -> None:
    drawn = drive(intervals, math.radians(tilt_deg))
    position, attitude = fine_integration(*drawn)
    after = step(*drawn)
    turn_rad = 1.6 * FRAME_S / intervals
    np.testing.assert_allclose(
        rotation_from_euler(after[3:]), attitude, atol=0.25 * math.radians(tilt_deg) * turn_rad**2 + 1e-11
    )
    np.testing.assert_allclose(after[:3], position, atol=1e-6)


def test_yaw_on_a_level_floor_is_exact_and_not_wrapped() -> None:
    count = 500
    dt_s, rate = np.full(count, 0.01), np.zeros((count, 3))
    rate[:, 2] = np.linspace(0.0, 3.0, count)
    motion = integrate(np.zeros(3), np.array([0.0, 0.0, 3.0]), rate, dt_s, np.zeros(count))
    assert motion.euler_rad[2] == pytest.approx(3.0 + rate[:, 2] @ dt_s, rel=1e-14)


def test_a_full_circle_is_closed() -> None:
    count, radius_m = 720, 0.5
    rate = np.tile([0.0, 0.0, 1.0], (count, 1))
    dt_s = np.full(count, 2.0 * math.pi / count)
    motion = integrate(np.zeros(3), np.zeros(3), rate, dt_s, radius_m * dt_s)
    np.testing.assert_allclose(motion.position_m, 0.0, atol=1e-12)


class TestDerivativesOfMotion:
    """The derivatives are of first order in the motion inside the block: better for a short block."""

    @pytest.fixture(params=[(1, 0.0), (7, 0.01), (14, 0.05)], ids=str)
    def drawn(self, request: pytest.FixtureRequest) -> tuple[Array, Array, Array, Array]:
        return drive(*request.param)

    @pytest.fixture
    def motion(self, drawn: tuple[Array, Array, Array, Array]) -> PoseStep:
        pose, *moved = drawn
        return integrate(pose[:3], pose[3:], *moved)

    def test_by_pose(self, drawn: tuple[Array, Array, Array, Array], motion: PoseStep) -> None:
        pose, *moved = drawn
        expected = differences(lambda at: step(at, *moved), pose)
        np.testing.assert_allclose(motion.transition, expected, atol=2e-4)

    def test_by_rates(self, drawn: tuple[Array, Array, Array, Array], motion: PoseStep) -> None:
        pose, rate, dt_s, distance = drawn
        expected = differences(
            lambda at: step(pose, at.reshape(rate.shape), dt_s, distance), rate.ravel(), 1e-5
        ).reshape(6, len(dt_s), 3)
        np.testing.assert_allclose(motion.rate_gain / dt_s, expected.transpose(0, 2, 1) / dt_s, atol=1e-2)


# --- camera -------------------------------------------------------------------------------------

PINHOLE = replace(CAMERA, distortion=(0.0,) * 5)
STRONG = replace(CAMERA, distortion=(-0.28, 0.07, 1e-3, -1e-3, 0.0))
RATIONAL = replace(
    CAMERA,
    lens='rational_polynomial',
    distortion=(0.45, 0.02, 5e-4, -3e-4, 1e-4, 0.78, 0.10, 1e-3),
)
FISHEYE = replace(CAMERA, lens='equidistant', distortion=(-0.02, 0.006, -0.004, 5e-4))
POINTS = np.array([[0.0, 0.0, 2.0], [1.5, -1.0, 2.5], [-2.0, 1.2, 2.2], [0.4, 1.8, 2.6]])


@pytest.mark.parametrize(
    'camera',
    [PINHOLE, CAMERA, STRONG, RATIONAL, FISHEYE],
    ids=['pinhole', 'mild', 'strong', 'rational', 'fisheye'],
)
class TestCamera:
    def test_projects_as_opencv_does(self, camera: CameraIntrinsics) -> None:
        cv2 = pytest.importorskip('cv2')
        matrix = np.array(
            [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
        )
        if camera.lens == 'equidistant':
            expected, _ = cv2.fisheye.projectPoints(
                POINTS[:, None], np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion)
            )
            expected = expected.transpose(1, 0, 2) if len(expected) == 1 else expected
        else:
            expected, _ = cv2.projectPoints(
                POINTS, np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion)
            )
        np.testing.assert_allclose(project(camera, POINTS), expected[:, 0], atol=1e-9)

    def test_only_the_direction_matters(self, camera: CameraIntrinsics) -> None:
        np.testing.assert_allclose(project(camera, 7.0 * POINTS), project(camera, POINTS), atol=1e-9)

    def test_derivative(self, camera: CameraIntrinsics) -> None:
        pixels, by_point = project_with_jacobian(camera, POINTS)
        np.testing.assert_allclose(pixels, project(camera, POINTS), atol=1e-12)
        expected = differences(lambda nudge: project(camera, POINTS + nudge), np.zeros(3))
        np.testing.assert_allclose(by_point, expected, atol=1e-5)

    def test_bearing_undoes_the_lens(self, camera: CameraIntrinsics) -> None:
        normalised = bearing(camera, project(camera, POINTS))
        np.testing.assert_allclose(normalised, POINTS[:, :2] / POINTS[:, 2:], atol=1e-12)

    def test_derivative_of_bearing(self, camera: CameraIntrinsics) -> None:
        pixels = project(camera, POINTS)
        expected = differences(lambda nudge: bearing(camera, pixels + nudge), np.zeros(2), 1e-3)
        np.testing.assert_allclose(bearing_jacobian(camera, bearing(camera, pixels)), expected, atol=1e-9)

    def test_derivative_by_radial_coefficients(self, camera: CameraIntrinsics) -> None:
        normalised = POINTS[:, :2] / POINTS[:, 2:]

        def distorted(nudge: Array) -> Array:
            first, second, *others = camera.distortion
            bent = (first + float(nudge[0]), second + float(nudge[1]), *others)
            return distort(replace(camera, distortion=bent), normalised)[0]

        expected = differences(distorted, np.zeros(2), 1e-5)
        np.testing.assert_allclose(by_radial_coefficients(camera, normalised), expected, atol=1e-9)


def test_a_fisheye_sees_wide_angles_and_returns_rays_beyond_them_at_the_limit() -> None:
    angles = np.radians([0.0, 1e-5, 30.0, 60.0, 80.0, 88.0])
    normalised = np.column_stack([np.tan(angles), np.zeros(6)])
    distorted, slope = distort(FISHEYE, normalised)
    np.testing.assert_allclose(undistort(FISHEYE, distorted), normalised, rtol=1e-9)
    assert np.isfinite(slope).all() and (np.linalg.det(slope) > 0.0).all()
    beyond = undistort(FISHEYE, np.array([[0.0, 3.0]]))
    np.testing.assert_allclose(beyond, [[0.0, np.tan(MAX_ANGLE_RAD)]])


def test_points_at_or_behind_the_camera_give_finite_pixels() -> None:
    points = np.array([[0.1, 0.2, 0.0], [0.1, 0.2, -2.0], [0.0, 0.0, 0.0]])
    assert np.isfinite(project(CAMERA, points)).all()
    assert all(np.isfinite(part).all() for part in project_with_jacobian(CAMERA, points))


def test_inside_the_image() -> None:
    pixels = np.array([[0.0, 0.0], [639.0, 479.0], [639.1, 0.0], [-0.1, 5.0], [5.0, 479.5], [14.0, 14.0]])
    assert in_image(CAMERA, pixels).tolist() == [True, True, False, False, False, True]
    assert in_image(CAMERA, pixels, 14.0).tolist() == [False] * 5 + [True]


def test_mount_by_yaw() -> None:
    """At -90 deg the right of the image is the right of the robot, and its bottom points backwards."""
    mount = mount_from_yaw(0.1, 0.0, 0.2, -90.0)
    np.testing.assert_allclose(mount.R_bs @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(mount.R_bs @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(mount.R_bs @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_array_equal(mount.p_bs, [0.1, 0.0, 0.2])


# --- gyro ---------------------------------------------------------------------------------------


def test_a_drifting_bias_has_a_constant_mean() -> None:
    assert BiasModel().step(0.02, 100.0) == (0.02, 1.0)


def test_a_settling_bias_follows_the_paper_for_any_step() -> None:
    model = BiasModel('settling', 500.0, 0.03)
    at_once, slope = model.step(0.01, 60.0)
    bias = 0.01
    for _ in range(600):
        bias, _ = model.step(bias, 0.1)
    assert bias == pytest.approx(at_once, rel=1e-12)
    assert slope == pytest.approx((model.step(0.02, 60.0)[0] - at_once) / 0.01)
    by_quotient = (500.0 * 0.01 + 0.1 * 0.03) / (500.0 + 0.1)
    assert model.step(0.01, 0.1)[0] == pytest.approx(by_quotient, abs=1e-3 * abs(by_quotient - 0.01))
    assert list(model.step(0.01, 1e6)) == pytest.approx([0.03, 0.0])


def test_corrections_of_all_terms_add_up() -> None:
    block = eventful_block()
    model = SensorModel('two', BiasModel(), (find_effect('scale_factor'), find_effect('scale_cubic')))
    added = correct(placed(model.effects, 'gyro'), block, np.array([0.1, 0.02]), (None, None))
    correction, columns = added.rate_rad_s, added.by_values
    rate = block.rate_rad_s[:, 2]
    np.testing.assert_allclose(correction, 0.1 * rate + 0.02 * rate**3)
    np.testing.assert_allclose(columns, np.stack([rate, rate**3], axis=1))


def test_body_rates_contain_biases_and_correction() -> None:
    block, nominal = eventful_block(), eventful_block().rate_rad_s
    bias, added = np.array([0.01, -0.02, 0.03]), np.linspace(0.0, 0.1, 12)
    rates = body_rates(block, Correction(added, np.zeros((12, 0)), 0.0, ()), bias)
    np.testing.assert_allclose(rates - nominal, bias + np.outer(added, [0.0, 0.0, 1.0]))
    np.testing.assert_array_equal(block.rate_rad_s, nominal)
