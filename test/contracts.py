"""What every feature parametrisation and every physical effect must fulfil.

A test class that inherits a contract and is parametrised over a registry passes each of its tests
with each entry. A new kind of effect gets its class here, on top of `EffectContract`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from gyrocal_ros.config import FeatureConfig
from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.camera import project, project_with_jacobian
from gyrocal_ros.model.features.base import Anchors, NewFeatures, Parametrisation, View, view_from_pose
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import (
    CameraEffect,
    Effect,
    GroundEffect,
    GyroEffect,
    SeenPoints,
    SensorModel,
    WheelEffect,
)

CAMERA = CameraIntrinsics(640, 480, 250.0, 260.0, 310.0, 245.0, (-0.05, 0.01, 1e-3, -2e-3, 0.001))
MOUNT = Mount(rotation_from_euler(np.array([0.03, -0.02, -1.2])), np.array([0.09, -0.03, 0.1]))


def differences(function: Callable[[Array], Array], at: ArrayLike, step: float | Array = 1e-6) -> Array:
    """Central differences of `function` at a vector (k,): the derivative by it, as the last axis."""
    centre = np.asarray(at, float)
    steps = np.broadcast_to(step, centre.shape)
    columns = []
    for i, h in enumerate(steps):
        nudge = np.zeros_like(centre)
        nudge[i] = h
        columns.append((function(centre + nudge) - function(centre - nudge)) / (2.0 * h))
    return np.stack(columns, axis=-1)


def assert_positive_definite(covariances: Array) -> None:
    """Each of the matrices (..., n, n) is a covariance of full rank."""
    np.testing.assert_allclose(covariances, np.swapaxes(covariances, -1, -2), rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariances).min() > 0.0


# --- feature parametrisations -------------------------------------------------------------------

FEATURES = FeatureConfig()
PIXELS = np.array([[320.0, 240.0], [20.0, 470.0], [630.5, 3.2], [100.0, 30.0], [400.0, 260.0]])
NOISE_PX = 0.4
FIRST_POSE = np.array([0.4, -0.2, 0.01, 0.02, -0.03, 2.5])
LATER_POSE = np.array([0.7, 0.1, 0.00, -0.01, 0.02, 3.4])


def view_at(pose: Array) -> View:
    """The camera of the contract at a pose (6,): position and Euler angles."""
    return view_from_pose(CAMERA, MOUNT, pose[:3], pose[3:])


class ParametrisationContract:
    """A feature parametrisation is right about itself: starts, predictions and all derivatives."""

    @pytest.fixture
    def first(self, form: Parametrisation) -> NewFeatures:
        return form.initialise(view_at(FIRST_POSE), PIXELS, NOISE_PX, FEATURES)

    @pytest.fixture
    def moved(self, first: NewFeatures) -> tuple[Array, Anchors]:
        """Features whose estimate has moved on since their first sight."""
        change = 1.0 + 0.05 * np.random.default_rng(0).standard_normal(first.parameters.shape)
        return first.parameters * change, first.anchors

    def test_first_sight_is_where_it_was_seen(self, form: Parametrisation, first: NewFeatures) -> None:
        view = view_at(FIRST_POSE)
        measured, _ = form.measure(view, PIXELS, NOISE_PX, FEATURES)
        prediction = form.predict(view, first.parameters, first.anchors)
        np.testing.assert_allclose(prediction.expected, measured, atol=1e-9)
        np.testing.assert_allclose(project(CAMERA, prediction.points_c), PIXELS, atol=1e-8)

    def test_first_sight_lies_at_the_assumed_depth(self, form: Parametrisation, first: NewFeatures) -> None:
        """The paper's d is the range, other forms take the depth along the optical axis."""
        view = view_at(FIRST_POSE)
        points_c = (form.world(first.parameters, first.anchors)[0] - view.p_wc) @ view.R_wc
        assert np.all(points_c[:, 2] < FEATURES.prior_depth_m + 1e-9)
        assert np.all(np.linalg.norm(points_c, axis=1) > FEATURES.prior_depth_m - 1e-9)

    def test_start_goes_with_the_pose(self, form: Parametrisation, first: NewFeatures) -> None:
        """Moving the robot at first sight moves the point, as `by_pose` says through `world`."""

        def points(pose: Array) -> Array:
            new = form.initialise(view_at(pose), PIXELS, NOISE_PX, FEATURES)
            return form.world(new.parameters, new.anchors)[0]

        _, world_by_parameters = form.world(first.parameters, first.anchors)
        np.testing.assert_allclose(
            world_by_parameters @ first.by_pose, differences(points, FIRST_POSE), atol=1e-7
        )

    def test_first_sight_says_nothing_of_the_pose(self, form: Parametrisation, first: NewFeatures) -> None:
        """A robot elsewhere would have placed the feature elsewhere and seen it at the same pixel."""
        seen = form.predict(view_at(FIRST_POSE), first.parameters, first.anchors)
        np.testing.assert_allclose(
            seen.by_pose + seen.by_feature @ first.by_pose, 0.0, atol=1e-9 * np.abs(seen.by_pose).max()
        )

    def test_doubt_of_the_start_is_a_covariance(self, form: Parametrisation, first: NewFeatures) -> None:
        assert first.noise.shape == (len(PIXELS), 3, 3)
        assert_positive_definite(first.noise)

    def test_doubt_of_the_start_is_that_of_a_pixel_and_of_the_depth(self, form: Parametrisation) -> None:
        """Told in the image centre, where the paper's noise of one focal length holds."""
        view, centre = view_at(FIRST_POSE), np.array([[CAMERA.cx_px, CAMERA.cy_px]])
        new = form.initialise(view, centre, NOISE_PX, FEATURES)
        points_w, by_parameters = form.world(new.parameters, new.anchors)
        to_camera = view.R_wc.T @ by_parameters[0]
        noise_c = to_camera @ new.noise[0] @ to_camera.T
        by_point = project_with_jacobian(CAMERA, (points_w - view.p_wc) @ view.R_wc)[1][0]
        np.testing.assert_allclose(
            by_point @ noise_c @ by_point.T, NOISE_PX**2 * np.eye(2), atol=0.05 * NOISE_PX**2
        )
        assert noise_c[2, 2] > 0.5**2, 'the depth is nearly unknown'

    def test_measurement_has_its_rows(self, form: Parametrisation) -> None:
        measured, noise = form.measure(view_at(LATER_POSE), PIXELS, NOISE_PX, FEATURES)
        assert measured.shape == (len(PIXELS), form.rows)
        assert noise.shape == (len(PIXELS), form.rows, form.rows)
        assert_positive_definite(noise)

    def test_prediction_by_pose(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        prediction = form.predict(view_at(LATER_POSE), *moved)
        by_pose = differences(lambda pose: form.predict(view_at(pose), *moved).expected, LATER_POSE)
        scale = np.abs(by_pose).max()
        np.testing.assert_allclose(prediction.by_pose, by_pose, atol=1e-7 * scale)

    def test_prediction_by_feature(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        view, (parameters, anchors) = view_at(LATER_POSE), moved
        by_feature = differences(
            lambda nudge: form.predict(view, parameters + nudge, anchors).expected, np.zeros(3)
        )
        scale = np.abs(by_feature).max()
        np.testing.assert_allclose(form.predict(view, *moved).by_feature, by_feature, atol=1e-7 * scale)

    def test_prediction_agrees_with_the_world(
        self, form: Parametrisation, moved: tuple[Array, Anchors]
    ) -> None:
        view = view_at(LATER_POSE)
        points_w, _ = form.world(*moved)
        points_c = (points_w - view.p_wc) @ view.R_wc
        prediction = form.predict(view, *moved)
        np.testing.assert_allclose(project(CAMERA, prediction.points_c), project(CAMERA, points_c), atol=1e-8)
        assert np.all(prediction.points_c[:, 2] * points_c[:, 2] > 0.0), 'what is behind stays behind'

    def test_world_by_parameters(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        parameters, anchors = moved
        by_parameters = differences(lambda nudge: form.world(parameters + nudge, anchors)[0], np.zeros(3))
        np.testing.assert_allclose(form.world(*moved)[1], by_parameters, atol=1e-6)


# --- effects ------------------------------------------------------------------------------------


def eventful_block(count: int = 12, seed: int = 0) -> MotionBlock:
    """A block in which every signal that an effect may need is there and moves."""
    rng = np.random.default_rng(seed)
    dt_s = rng.uniform(0.004, 0.006, count)
    end_s = 30.0 + np.cumsum(dt_s)
    return MotionBlock(
        start_ns=30_000_000_000,
        end_ns=round(end_s[-1] * 1e9),
        time_s=end_s - 0.5 * dt_s,
        dt_s=dt_s,
        rate_rad_s=np.radians(rng.uniform([-5, -5, -90], [5, 5, 90], (count, 3))),
        yaw_acceleration_rad_s2=rng.uniform(-3.0, 3.0, count),
        specific_force_m_s2=rng.normal([0.0, 0.0, 9.8], 0.5, (count, 3)),
        distance_m=0.3 * dt_s,
        wheel_turn_rad=rng.uniform(-0.5, 0.5, count) * dt_s,
        temperature_c=rng.uniform(20.0, 45.0, count),
        covariates={'battery_state.voltage': rng.uniform(14.0, 16.0, count)},
    )


def part_of(block: MotionBlock, part: slice) -> MotionBlock:
    """Some intervals of a block, as a block."""
    columns = {
        item.name: getattr(block, item.name)[part]
        for item in fields(block)
        if isinstance(getattr(block, item.name), np.ndarray)
    }
    return replace(block, covariates={n: c[part] for n, c in block.covariates.items()}, **columns)


SCALE_FACTOR = find_effect('scale_factor')


class EffectContract:
    """An effect of any kind says what it is."""

    def test_name_can_stand_in_a_file(self, effect: Effect) -> None:
        assert re.fullmatch(r'[a-z][a-z0-9_]*(:[\w./]+)?', effect.name)

    def test_coefficients_are_complete(self, effect: Effect) -> None:
        assert effect.coefficients
        names = [item.name for item in effect.coefficients]
        assert len(set(names)) == len(names)
        for item in effect.coefficients:
            assert re.fullmatch(r'[a-z][a-z0-9_]*', item.name)
            assert re.fullmatch(r'1|\S+', item.unit)
            assert math.isfinite(item.prior_mean)
            assert 0.0 <= item.prior_std < math.inf
            assert 0.0 <= item.walk < math.inf

    @staticmethod
    def draws(effect: Effect) -> list[Array]:
        """Coefficient values as they may come up: the prior mean, and half a sigma about it."""
        rng = np.random.default_rng(1)
        mean = np.array([item.prior_mean for item in effect.coefficients])
        std = np.array([item.prior_std for item in effect.coefficients])
        return [mean, *(mean + 0.5 * std * rng.uniform(-1.0, 1.0, (3, len(mean))))]

    @staticmethod
    def steps(effect: Effect) -> Array:
        """Steps for differences, small against the priors."""
        return np.array([1e-4 * (item.prior_std or 1e-3) for item in effect.coefficients])

    def test_model_file_keeps_it(self, effect: Effect) -> None:
        items = tuple(
            replace(item, prior_mean=item.prior_mean + 0.1, prior_std=2.0 * item.prior_std, walk=1e-6)
            for item in effect.coefficients
        )
        changed = replace(effect, coefficients=items)  # type: ignore[type-var]
        others = () if effect.name == SCALE_FACTOR.name else (SCALE_FACTOR,)
        model = SensorModel('mine', BiasModel(), (*others, changed), version=3)
        assert model_from_dict(model_to_dict(model), 'model.yaml') == model


class GyroEffectContract(EffectContract):
    """An effect in the gyro: a correction of the yaw rate, and its derivative."""

    def test_contribution_has_its_shapes(self, effect: GyroEffect) -> None:
        for count in (1, 12):
            for values in self.draws(effect):
                term = effect.contribute(eventful_block(count), values, None)
                assert term.rate_rad_s.shape == (count,)
                assert term.by_values.shape == (count, len(effect.coefficients))

    def test_derivative_is_that_of_the_contribution(self, effect: GyroEffect) -> None:
        first, second = eventful_block(), eventful_block(7)
        steps = self.steps(effect)

        def rate_of_second(values: Array) -> Array:
            memory = effect.contribute(first, values, None).memory
            return effect.contribute(second, values, memory).rate_rad_s

        for values in self.draws(effect):
            memory = effect.contribute(first, values, None).memory
            by_values = effect.contribute(second, values, memory).by_values
            np.testing.assert_allclose(
                by_values * steps, differences(rate_of_second, values, steps) * steps, rtol=1e-5, atol=1e-12
            )

    def test_two_blocks_are_as_good_as_one(self, effect: GyroEffect) -> None:
        whole = eventful_block(12)
        values = self.draws(effect)[1]
        halves, memory = [], None
        for part in (slice(0, 5), slice(5, 12)):
            term = effect.contribute(part_of(whole, part), values, memory)
            memory = term.memory
            halves.append(term.rate_rad_s)
        if effect.name != 'vibration_rectification':  # whose window is the block
            joined = effect.contribute(whole, values, None).rate_rad_s
            np.testing.assert_allclose(np.concatenate(halves), joined, rtol=1e-9, atol=1e-12)

    def test_it_leaves_the_block_alone(self, effect: GyroEffect) -> None:
        block, untouched = eventful_block(), eventful_block()
        effect.contribute(block, self.draws(effect)[1], None)
        np.testing.assert_array_equal(block.rate_rad_s, untouched.rate_rad_s)
        np.testing.assert_array_equal(block.time_s, untouched.time_s)


class MotionEffectContract(EffectContract):
    """An effect on the wheels or over the ground: metres, and their derivative."""

    def test_derivative_is_that_of_the_contribution(self, effect: WheelEffect | GroundEffect) -> None:
        block, steps = eventful_block(), self.steps(effect)
        for values in self.draws(effect):
            added, by_values = effect.contribute(block, values)
            assert added.shape == ((12,) if effect.acts_on == 'wheels' else (3,))
            expected = differences(lambda at: effect.contribute(block, at)[0], values, steps)
            np.testing.assert_allclose(by_values, expected, rtol=1e-6, atol=1e-12)


class CameraEffectContract(EffectContract):
    """An effect on the camera: another camera, and the derivative of what it sees."""

    def test_derivative_is_that_of_the_pixels(self, effect: CameraEffect) -> None:
        points_b = np.array([[0.3, 0.2, 2.1], [-1.0, 0.4, 2.5], [0.9, -1.1, 2.3]])

        def pixels(values: Array) -> Array:
            camera, mount = effect.corrected(CAMERA, MOUNT, values)
            return project(camera, (points_b - mount.p_bs) @ mount.R_bs)

        for values in self.draws(effect)[:1]:
            camera, mount = effect.corrected(CAMERA, MOUNT, values)
            points_c = (points_b - mount.p_bs) @ mount.R_bs
            seen_pixels, by_point = project_with_jacobian(camera, points_c)
            scale = np.array([0.5, 1.0, 2.0])
            seen = SeenPoints(
                camera,
                mount.R_bs,
                scale[:, None] * points_c,
                scale,
                seen_pixels,
                by_point / scale[:, None, None],
            )
            steps = self.steps(effect)
            np.testing.assert_allclose(
                effect.pixels_by_values(seen, values) * steps,
                differences(pixels, values, steps) * steps,
                rtol=1e-5,
                atol=1e-9,
            )
