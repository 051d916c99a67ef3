"""Contracts of feature parametrisations and of physical effects.

A test class inherits a contract and is parametrised over a registry, so each test runs with each entry. A new
kind of effect gets a class here, derived from `EffectContract`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from gyrocal_ros.config.sections import FeatureConfig, GyroConfig
from gyrocal_ros.data import NS_PER_S, Array, CameraIntrinsics, MotionBlock, Mount, nanoseconds, seconds
from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS, find_effect
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.checks import faults
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.ekf.equations.effects_by_place import (
    PoseMotion,
    as_exposed,
    first_sight_by_values,
    measurement_by_values,
    sort_effects,
    true_camera,
)
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.camera import project, project_with_jacobian
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import (
    Anchors,
    NewFeatures,
    Parametrisation,
    PosedCamera,
    Prediction,
    posed_camera,
)
from gyrocal_ros.model.recording import GyroReadings
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import (
    Effect,
    GroundEffect,
    GyroEffect,
    Memory,
    NoiseEffect,
    SensorModel,
    WheelEffect,
    with_means,
)

CAMERA = CameraIntrinsics(640, 480, 250.0, 260.0, 310.0, 245.0, (-0.05, 0.01, 1e-3, -2e-3, 0.001))
MOUNT = Mount(rotation_from_euler(np.array([0.03, -0.02, -1.2])), np.array([0.09, -0.03, 0.1]))


def differences(function: Callable[[Array], Array], at: ArrayLike, step: float | Array = 1e-6) -> Array:
    """Return central differences of `function` at a vector (k,); the derivative is the last axis."""
    centre = np.asarray(at, float)
    steps = np.broadcast_to(step, centre.shape)
    columns = []
    for i, h in enumerate(steps):
        nudge = np.zeros_like(centre)
        nudge[i] = h
        columns.append((function(centre + nudge) - function(centre - nudge)) / (2.0 * h))
    return np.stack(columns, axis=-1)


def assert_positive_definite(covariances: Array) -> None:
    """Check that each of the matrices (..., n, n) is a covariance of full rank."""
    np.testing.assert_allclose(covariances, np.swapaxes(covariances, -1, -2), rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(covariances).min() > 0.0


# --- feature parametrisations -------------------------------------------------------------------

FEATURES = FeatureConfig()
PIXELS = np.array([[320.0, 240.0], [20.0, 470.0], [630.5, 3.2], [100.0, 30.0], [400.0, 260.0]])
NOISE_PX = 0.4
FIRST_POSE = np.array([0.4, -0.2, 0.01, 0.02, -0.03, 2.5])
LATER_POSE = np.array([0.7, 0.1, 0.00, -0.01, 0.02, 3.4])


def view_at(pose: Array) -> PosedCamera:
    """Return the camera of the contract at a pose (6,): position and Euler angles."""
    return posed_camera(CAMERA, MOUNT, pose[:3], pose[3:])


def anchor_by_pose(first: NewFeatures) -> Array:
    """Return the derivative (3, 6) of the anchor of new features by the pose; zero without one."""
    return np.zeros((3, 6)) if first.anchor_by_pose is None else first.anchor_by_pose


class ParametrisationContract:
    """Contract of a feature parametrisation: initial values, predictions and all derivatives."""

    @pytest.fixture
    def first(self, form: Parametrisation) -> NewFeatures:
        return form.initialise(view_at(FIRST_POSE), PIXELS, NOISE_PX, FEATURES)

    @pytest.fixture
    def moved(self, first: NewFeatures) -> tuple[Array, Anchors]:
        """Return features whose estimate has changed since their first observation."""
        change = 1.0 + 0.05 * np.random.default_rng(0).standard_normal(first.parameters.shape)
        return first.parameters * change, first.anchors

    def test_a_new_feature_is_predicted_at_its_measurement(
        self, form: Parametrisation, first: NewFeatures
    ) -> None:
        view = view_at(FIRST_POSE)
        measured, _ = form.measure(view, PIXELS, NOISE_PX, FEATURES)
        prediction = form.predict(view, first.parameters, first.anchors)
        np.testing.assert_allclose(prediction.expected, measured, atol=1e-9)
        np.testing.assert_allclose(project(CAMERA, prediction.points_c), PIXELS, atol=1e-8)

    def test_a_new_feature_has_the_assumed_depth(self, form: Parametrisation, first: NewFeatures) -> None:
        """It is the range in the parametrisation of the paper, the depth along the optical axis in others."""
        view = view_at(FIRST_POSE)
        points_c = (form.world(first.parameters, first.anchors)[0] - view.p_wc) @ view.R_wc
        assert np.all(points_c[:, 2] < FEATURES.prior_depth_m + 1e-9)
        assert np.all(np.linalg.norm(points_c, axis=1) > FEATURES.prior_depth_m - 1e-9)

    def test_a_new_feature_moves_with_the_pose(self, form: Parametrisation, first: NewFeatures) -> None:
        """The derivative of the point by the pose is that of `world` times `by_pose`, and of its anchor."""

        def points(pose: Array) -> Array:
            new = form.initialise(view_at(pose), PIXELS, NOISE_PX, FEATURES)
            return form.world(new.parameters, new.anchors)[0]

        _, world_by_parameters = form.world(first.parameters, first.anchors)
        by_pose = world_by_parameters @ first.by_pose + anchor_by_pose(first)
        np.testing.assert_allclose(by_pose, differences(points, FIRST_POSE), atol=1e-7)

    def test_a_new_feature_does_not_depend_on_the_pose_in_the_image(
        self, form: Parametrisation, first: NewFeatures
    ) -> None:
        """A robot at another pose would have initialised the feature elsewhere, at the same pixel."""
        seen = form.predict(view_at(FIRST_POSE), first.parameters, first.anchors)
        by_pose = seen.by_pose + seen.by_feature @ first.by_pose
        by_pose -= seen.by_pose[:, :, :3] @ anchor_by_pose(first)
        np.testing.assert_allclose(by_pose, 0.0, atol=1e-9 * np.abs(seen.by_pose).max())

    def test_initial_noise_is_a_covariance(self, form: Parametrisation, first: NewFeatures) -> None:
        assert first.noise.shape == (len(PIXELS), 3, 3)
        assert_positive_definite(first.noise)

    def test_initial_noise_is_that_of_a_pixel_and_of_the_depth(self, form: Parametrisation) -> None:
        """Checked in the image centre, where the paper's noise with one focal length is exact."""
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

    def test_measurement_has_the_right_shape(self, form: Parametrisation) -> None:
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
        assert np.all(prediction.points_c[:, 2] * points_c[:, 2] > 0.0), 'behind the camera'

    def test_prediction_by_point(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        """The derivative is by `points_c`, which are the points times `scale`."""
        view = view_at(LATER_POSE)
        prediction = form.predict(view, *moved)
        points_c = (form.world(*moved)[0] - view.p_wc) @ view.R_wc
        np.testing.assert_allclose(prediction.points_c, prediction.scale[:, None] * points_c, atol=1e-9)
        if form.rows == 2:
            by_point = project_with_jacobian(CAMERA, prediction.points_c)[1]
            np.testing.assert_allclose(prediction.by_point, by_point, rtol=1e-9)

    def test_prediction_of_some(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        rows, (parameters, anchors) = np.array([3, 0]), moved
        some = form.predict(view_at(LATER_POSE), *moved)[rows]
        direct = form.predict(view_at(LATER_POSE), parameters[rows], anchors[rows])
        for name in Prediction.__slots__:
            np.testing.assert_allclose(getattr(some, name), getattr(direct, name), rtol=1e-12)

    def test_world_by_parameters(self, form: Parametrisation, moved: tuple[Array, Anchors]) -> None:
        parameters, anchors = moved
        by_parameters = differences(lambda nudge: form.world(parameters + nudge, anchors)[0], np.zeros(3))
        np.testing.assert_allclose(form.world(*moved)[1], by_parameters, atol=1e-6)


# --- effects ------------------------------------------------------------------------------------

SIGNAL = 'battery_state.voltage'
POSE_RATE = np.array([0.2, 0.1, 0.0, 0.01, -0.02, 1.3])
MOTION = PoseMotion(POSE_RATE, np.array([0.3, -0.1, 0.0, 0.5, -0.2, 4.0]))


def eventful_block(count: int = 12, seed: int = 0, start_s: float = 30.0) -> MotionBlock:
    """Return a block in which every signal that an effect may require varies."""
    rng = np.random.default_rng(seed)
    dt_s = rng.uniform(0.004, 0.006, count)
    end_s = start_s + np.cumsum(dt_s)
    rate = np.radians(rng.uniform([-5, -5, -90], [5, 5, 90], (count, 3)))
    return MotionBlock(
        start_ns=nanoseconds(start_s),
        end_ns=nanoseconds(float(end_s[-1])),
        time_s=end_s - 0.5 * dt_s,
        dt_s=dt_s,
        rate_rad_s=rate,
        yaw_acceleration_rad_s2=np.gradient(rate[:, 2]) / dt_s if count > 1 else np.array([3.0]),
        specific_force_m_s2=rng.normal([0.0, 0.0, 9.8], 0.5, (count, 3)),
        vibration_m2_s4=rng.uniform(0.0, 0.1, count),
        distance_m=0.3 * dt_s,
        wheel_turn_rad=rate[:, 2] * dt_s,
        temperature_c=rng.uniform(20.0, 45.0, count),
        covariates={SIGNAL: rng.uniform(14.0, 16.0, count)},
        heading_rad=rng.uniform(-3.0, 3.0, count),
        position_m=rng.uniform(-1.0, 1.0, (count, 2)),
    )


def half_slow_block() -> MotionBlock:
    """Return a block that turns slowly in its first half, by less than 0.1 rad/s, and fast in its second."""
    block = eventful_block()
    yaw_rate = np.linspace(0.01, 0.1, 12) + np.repeat([0.0, 1.0], 6)
    return replace(block, rate_rad_s=np.column_stack([block.rate_rad_s[:, :2], yaw_rate]))


def eventful_blocks() -> list[MotionBlock]:
    """Return consecutive blocks."""
    blocks = [eventful_block()]
    for seed in (1, 2):
        blocks.append(eventful_block(12, seed, seconds(blocks[-1].end_ns)))
    return blocks


def draws(effect: Effect) -> list[Array]:
    """Return values of the coefficients: the prior mean, and values within half a sigma of it."""
    rng = np.random.default_rng(1)
    mean = np.array([item.prior_mean for item in effect.coefficients])
    std = np.array([item.prior_std for item in effect.coefficients])
    return [mean, *(mean + 0.5 * std * rng.uniform(-1.0, 1.0, (3, len(mean))))]


def assert_derivative(
    effect: Effect, function: Callable[[Array], Array], derivative: Callable[[Array], Array]
) -> None:
    """Check the derivative (..., k) of a function at every draw, in steps of the priors."""
    steps = 1e-4 * np.array([item.prior_std or 1e-3 for item in effect.coefficients])
    for values in draws(effect):
        expected = differences(function, values, steps) * steps
        scale = np.abs(expected).max()
        np.testing.assert_allclose(derivative(values) * steps, expected, rtol=1e-6, atol=1e-7 * scale + 1e-15)


class EffectContract:
    """Contract of an effect of any kind: name, explanation, sketch, coefficients and model file."""

    def test_name_is_valid_and_finds_the_effect(self, effect: Effect) -> None:
        assert re.fullmatch(r'[a-z][a-z0-9_]*(:[\w./]+)?', effect.name)
        assert find_effect(effect.name) == effect

    def test_it_has_an_explanation(self, effect: LibraryEffect) -> None:
        about = effect.about
        assert len(about.physics) > 100
        assert about.physics.endswith('.')
        assert all((about.equation, about.usual_size, about.best_motion, about.source))
        assert set(about.twins) <= {*EFFECTS, *COVARIATE_EFFECTS, 'bias'} - {effect.name}
        assert len(about.example) == len(effect.coefficients)

    def test_it_has_a_sketch(self, effect: LibraryEffect) -> None:
        drawn = sketch(effect)
        assert drawn.lines
        for name, line in drawn.lines.items():
            assert line.shape == drawn.x.shape
            assert np.ptp(line) > 0.0 or effect.name in ('principal_point', 'camera_position'), name

    def test_coefficients_are_complete(self, effect: Effect) -> None:
        """A coefficient that is detected in the readings, not estimated, has a prior of zero width."""
        assert effect.coefficients
        names = [item.name for item in effect.coefficients]
        assert len(set(names)) == len(names)
        for item in effect.coefficients:
            assert re.fullmatch(r'[a-z][a-z0-9_]*', item.name)
            assert re.fullmatch(r'\S+', item.unit)
            assert math.isfinite(item.prior_mean)
            assert 0.0 <= item.prior_std < math.inf
            assert 0.0 <= item.walk < math.inf

    def test_nothing_keeps_it_from_being_used(self, effect: Effect) -> None:
        named = replace(effect, name=effect.name.partition(':')[0])  # type: ignore[type-var]
        assert list(faults(named)) == []

    def test_typical_ranges_are_complete(self, effect: Effect) -> None:
        ranges = [item.typical for item in effect.coefficients]
        assert all(item is None for item in ranges) or None not in ranges
        for item in filter(None, ranges):
            assert item.low > 0.0 and item.high > 0.0 and item.low != item.high
            assert item.value(0.0) == item.low and item.value(1.0) == pytest.approx(item.high)
        assert not any(ranges) or any(item.is_strength for item in filter(None, ranges))

    def test_a_model_file_reproduces_it(self, effect: Effect) -> None:
        items = tuple(
            replace(item, prior_mean=item.prior_mean + 0.1, prior_std=2.0 * item.prior_std + 0.01, walk=1e-6)
            for item in effect.coefficients
        )
        changed = replace(effect, coefficients=items)  # type: ignore[type-var]
        first = find_effect('scale_factor')
        effects = (changed,) if effect.name == first.name else (first, changed)
        model = SensorModel('mine', BiasModel(), effects, version=3)
        assert model_from_dict(model_to_dict(model), 'model.yaml') == model


class GyroEffectContract(EffectContract):
    """Contract of an effect on the yaw rate."""

    @staticmethod
    def over_blocks(effect: GyroEffect, values: Array) -> tuple[Array, Array]:
        """Return contribution (N,) and derivative (N, k) over consecutive blocks with their memory."""
        memory: Memory = None
        terms = []
        for block in eventful_blocks():
            terms.append(effect.contribute(block, values, memory))
            memory = terms[-1].memory
        rates = [term.rate_rad_s for term in terms]
        return np.concatenate(rates), np.concatenate([term.by_values for term in terms])

    def test_shapes(self, effect: GyroEffect) -> None:
        for count in (1, 12):
            for values in draws(effect):
                term = effect.contribute(eventful_block(count), values, None)
                assert term.rate_rad_s.shape == (count,)
                assert term.by_values.shape == (count, len(effect.coefficients))
                if term.noise_rad_s is not None:
                    assert term.noise_rad_s.shape == (count,)
                    assert np.all(term.noise_rad_s >= 0.0)

    def test_derivative(self, effect: GyroEffect) -> None:
        if any(item.prior_std == 0.0 for item in effect.coefficients):
            assert not np.any(self.over_blocks(effect, draws(effect)[0])[1])
        else:
            assert_derivative(
                effect,
                lambda values: self.over_blocks(effect, values)[0],
                lambda values: self.over_blocks(effect, values)[1],
            )

    def test_its_contribution_has_a_plausible_size(self, effect: GyroEffect) -> None:
        values = [item.prior_mean + item.prior_std if item.prior_std else 0.7 for item in effect.coefficients]
        block = eventful_block()
        term = effect.contribute(block, np.array(values), None)
        changed = np.abs(term.rate_rad_s) + (0.0 if term.noise_rad_s is None else term.noise_rad_s)
        assert 0.0 < block.dt_s @ changed < math.radians(90.0)

    def test_two_blocks_give_the_same_as_one(self, effect: GyroEffect) -> None:
        whole, values, memory, rates = eventful_block(), draws(effect)[1], None, []
        for part in (slice(0, 5), slice(5, 12)):
            term = effect.contribute(whole.part(part), values, memory)
            memory = term.memory
            rates.append(term.rate_rad_s)
        at_once = effect.contribute(whole, values, None).rate_rad_s
        np.testing.assert_allclose(np.concatenate(rates), at_once, rtol=1e-9, atol=1e-12)

    def test_it_does_not_change_the_block(self, effect: GyroEffect) -> None:
        block, untouched = eventful_block(), eventful_block()
        effect.contribute(block, draws(effect)[1], None)
        assert repr(block) == repr(untouched)


class WheelEffectContract(EffectContract):
    """Contract of an effect on the distance by the wheels."""

    def test_shapes(self, effect: WheelEffect) -> None:
        for count in (1, 12):
            distance, by_values = effect.contribute(eventful_block(count), draws(effect)[1])
            assert distance.shape == (count,)
            assert by_values.shape == (count, len(effect.coefficients))

    def test_derivative(self, effect: WheelEffect) -> None:
        block = eventful_block()
        assert_derivative(
            effect,
            lambda values: effect.contribute(block, values)[0],
            lambda values: effect.contribute(block, values)[1],
        )

    def test_zero_coefficients_change_nothing(self, effect: WheelEffect) -> None:
        assert not np.any(effect.contribute(eventful_block(), np.zeros(len(effect.coefficients)))[0])


class GroundEffectContract(EffectContract):
    """Contract of an effect that moves the robot over the floor."""

    def test_shapes(self, effect: GroundEffect) -> None:
        moved, by_values = effect.contribute(eventful_block(), draws(effect)[1])
        assert moved.shape == (3,) and moved[2] == 0.0
        assert by_values.shape == (3, len(effect.coefficients))

    def test_derivative(self, effect: GroundEffect) -> None:
        block = eventful_block()
        assert_derivative(
            effect,
            lambda values: effect.contribute(block, values)[0],
            lambda values: effect.contribute(block, values)[1],
        )


class NoiseEffectContract(EffectContract):
    """Contract of an effect on the noise of the yaw rate."""

    RATES = np.array([-1.0, 0.0, 0.3, 1.0])

    def test_the_noise_grows_with_its_size(self, effect: NoiseEffect) -> None:
        variances = []
        for size in effect.coefficients[0].scan:
            values = np.array([size])
            density = effect.density(self.RATES, values)
            assert density.shape == self.RATES.shape and np.all(density >= 0.0)
            variances.append(float(np.sum(density**2)) + effect.bias_walk(values) ** 2)
        assert np.all(np.diff(variances) > 0.0)

    def test_size_zero_adds_nothing(self, effect: NoiseEffect) -> None:
        assert not effect.density(self.RATES, np.zeros(1)).any() and effect.bias_walk(np.zeros(1)) == 0.0

    def test_the_filter_adds_it_to_the_noise_of_the_settings(self, effect: NoiseEffect) -> None:
        model = SensorModel('noisy', BiasModel(), (with_means(effect, effect.about.example),))  # type: ignore[attr-defined]
        gyro = GyroConfig()
        bare, noisy = (yaw_noise_of(m, gyro, self.RATES) for m in (replace(model, effects=()), model))
        values = np.array(effect.about.example)  # type: ignore[attr-defined]
        np.testing.assert_allclose(
            noisy.density_rad_s**2 - bare.density_rad_s**2, effect.density(self.RATES, values) ** 2
        )
        added = noisy.bias_walk_rad_s**2 - bare.bias_walk_rad_s**2
        assert added == pytest.approx(effect.bias_walk(values) ** 2)


class ImageEffectContract(EffectContract):
    """Contract of an effect on the camera, or on the stamps of its images."""

    @pytest.fixture(
        params=[form for form in PARAMETRISATIONS.values() if form.rows == 2], ids=lambda f: f.name
    )
    def form(self, request: pytest.FixtureRequest) -> Parametrisation:
        return request.param

    @staticmethod
    def observe(effect: Effect, form: Parametrisation, values: Array) -> tuple[PosedCamera, Prediction]:
        """Return the view of a fixed map by the camera with the effect."""
        first = form.initialise(view_at(FIRST_POSE), PIXELS, NOISE_PX, FEATURES)
        effects = sort_effects((effect,))
        late_s = sum(float(values[place][0]) for _, place in effects.time)
        camera, mount = true_camera(effects, CAMERA, MOUNT, values)
        pose = LATER_POSE - POSE_RATE * late_s
        view = posed_camera(camera, mount, pose[:3], pose[3:])
        return view, as_exposed(
            effects, view, form.predict(view, first.parameters, first.anchors), MOTION, values
        )

    def by_values(self, effect: Effect, form: Parametrisation, values: Array) -> Array:
        view, prediction = self.observe(effect, form, values)
        return measurement_by_values(sort_effects((effect,)), view, prediction, MOTION, values)

    def test_derivative(self, effect: Effect, form: Parametrisation) -> None:
        assert_derivative(
            effect,
            lambda values: self.observe(effect, form, values)[1].expected,
            lambda values: self.by_values(effect, form, values),
        )

    def test_zero_coefficients_change_nothing(self, effect: Effect, form: Parametrisation) -> None:
        seen = self.observe(effect, form, np.zeros(len(effect.coefficients)))[1].expected
        first = form.initialise(view_at(FIRST_POSE), PIXELS, NOISE_PX, FEATURES)
        nominal = form.predict(view_at(LATER_POSE), first.parameters, first.anchors).expected
        np.testing.assert_allclose(seen, nominal, atol=1e-9)

    def test_a_new_feature_keeps_its_pixel(self, effect: Effect, form: Parametrisation) -> None:
        """The derivative of a new feature compensates that of its pixel by the coefficients."""
        view, prediction = self.observe(effect, form, draws(effect)[1])
        by_values = self.by_values(effect, form, draws(effect)[1])
        moved = prediction.by_feature @ first_sight_by_values(prediction, by_values)
        np.testing.assert_allclose(moved, -by_values, atol=1e-7 * np.abs(by_values).max())


class LimitContract:
    """A limit is detected in the readings of a sensor that has it."""

    T_NS = np.arange(20_000) * 5_000_000

    def nominal(self) -> Array:
        """Readings of a sensor without the limit: turns of 100 deg/s, and rests with noise."""
        time_s = self.T_NS / NS_PER_S
        turning = math.radians(100.0) * np.sin(time_s / 3.0) * (time_s % 60.0 < 40.0)
        noise: Array = math.radians(0.5) * np.random.default_rng(0).normal(size=len(time_s))
        return turning + noise

    def limited(self, effect: Any, limit: float) -> GyroReadings:
        dt_s = np.full(len(self.T_NS), 0.005)
        return GyroReadings(self.T_NS, effect.readings(self.nominal(), dt_s, np.array([limit]), 1.0))

    def test_it_is_detected(self, effect: Any) -> None:
        typical = effect.coefficients[0].typical
        for limit in (typical.value(0.3), typical.value(0.7)):
            found = effect.detect(self.limited(effect, limit))
            assert found is not None and found.value == pytest.approx(limit, rel=0.05)
            assert effect.is_plausible(self.limited(effect, limit), found.value)

    def test_it_is_not_detected_in_noise(self, effect: Any) -> None:
        noise = math.radians(20.0) * np.random.default_rng(0).normal(size=len(self.T_NS))
        assert effect.detect(GyroReadings(self.T_NS, noise)) is None
        assert effect.detect(GyroReadings(self.T_NS[:0], noise[:0])) is None

    def test_the_rate_error_has_the_sign_of_the_rate_lost(self, effect: Any) -> None:
        """The sign matters where readings are clipped; inside a dead band the rate is noise."""
        limit = effect.coefficients[0].typical.value(0.5)
        read = self.limited(effect, limit).rate_rad_s
        error, bias_part = effect.rate_error(read, limit)
        assert error.shape == bias_part.shape == read.shape
        clipped = np.abs(self.nominal()) > 1.01 * limit
        lost = (self.nominal() - read)[clipped]
        assert np.all(error[clipped] * lost >= 0.0)
        assert np.any(error) or np.any(bias_part)


class OdometryContract:
    """Contract of a camera effect on odometry: simulator and filter agree on the length unit."""

    def test_the_camera_position_is_in_metres_of_the_odometer(self, effect: Any) -> None:
        for values in draws(effect):
            camera, mount = effect.corrected(CAMERA, MOUNT, values)
            assert camera == CAMERA and np.array_equal(mount.R_bs, MOUNT.R_bs)
            np.testing.assert_allclose(mount.p_bs[:2], effect.odometry(MOUNT.p_bs[:2], values), rtol=1e-12)
            assert mount.p_bs[2] == MOUNT.p_bs[2], 'heights do not change'

    def test_odometry_is_zero_at_rest(self, effect: Any) -> None:
        assert not np.any(effect.odometry(np.zeros(3), draws(effect)[1]))
