"""What images do not tell is considered, not corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from filter_states import some_state

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.features.considered import (
    combinations_not_told,
    not_told_at_rest,
    stretch_by_values,
    with_considered,
    with_kept,
)
from gyrocal_ros.ekf.history.run import History
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource

COUNT = some_state().coefficient_count
COMBINATIONS = (
    pytest.param(np.eye(COUNT)[[4, 5, 6]], id='coefficients'),
    pytest.param(np.linspace(-1.0, 2.0, COUNT)[None], id='a combination'),
    pytest.param(np.eye(COUNT)[[2, 2]], id='one twice'),
)


@dataclass(frozen=True)
class Update:
    """An optimal update with four measured numbers."""

    before: State
    H: Array
    R: Array
    residual: Array

    @property
    def gain(self) -> Array:
        """Kalman's."""
        P, H = self.before.covariance, self.H
        return P @ H.T @ np.linalg.inv(H @ P @ H.T + self.R)

    @property
    def after(self) -> State:
        """The state after it."""
        lost = self.gain @ self.H
        return replace(
            self.before,
            mean=self.before.mean + self.gain @ self.residual,
            covariance=self.before.covariance - lost @ self.before.covariance,
            sensitivity=self.before.sensitivity - lost @ self.before.sensitivity,
        )

    def assert_is(self, found: State, gain: Array) -> None:
        """Check that a state is that after an update with some gain, by Joseph's form."""
        P, X = self.before.covariance, self.before.sensitivity
        left = np.eye(len(P)) - gain @ self.H
        np.testing.assert_allclose(found.mean, self.before.mean + gain @ self.residual, atol=1e-12)
        np.testing.assert_allclose(found.covariance, left @ P @ left.T + gain @ self.R @ gain.T, atol=1e-12)
        np.testing.assert_allclose(found.sensitivity, left @ X, atol=1e-12)


@pytest.fixture
def update() -> Update:
    rng, state = np.random.default_rng(2), some_state()
    H = rng.normal(size=(4, len(state.mean))) / np.sqrt(state.covariance.diagonal())
    return Update(state, H, 0.1 * np.eye(4), rng.normal(size=4))


@pytest.mark.parametrize('combinations', COMBINATIONS)
def test_the_covariance_is_that_of_the_gain_without_the_considered_ones(
    update: Update, combinations: Array
) -> None:
    state, P, gain = update.before, update.before.covariance, update.gain
    considered = with_considered(state, update.after, combinations)
    k = state.coefficient_columns
    np.testing.assert_allclose(combinations @ considered.mean[k], combinations @ state.mean[k], atol=1e-12)
    C = np.unique(combinations, axis=0)
    np.testing.assert_allclose(C @ considered.covariance[k, k] @ C.T, C @ P[k, k] @ C.T, rtol=1e-9)
    gain[k] -= P[k, k] @ C.T @ np.linalg.solve(C @ P[k, k] @ C.T, C @ gain[k])
    update.assert_is(considered, gain)


def test_what_is_kept_has_no_gain(update: Update) -> None:
    places, gain = np.array([0, 2, 10, 20, len(update.before.mean) - 1]), update.gain
    gain[places] = 0.0
    update.assert_is(with_kept(update.before, update.after, places), gain)


def test_at_rest_no_image_tells_of_places_depths_and_what_moves_the_camera() -> None:
    model = with_effect(with_effect(default_model(), find_effect('gyro_lag')), find_effect('camera_position'))
    slam = EkfSlam(model, Config(), SimSource(find_scenario('cleaning'), 1).rig)
    state = some_state()
    state = replace(slam.state, landmarks=state.landmarks, mean=np.zeros(slam.state.robot_size + 18))
    r = state.robot_size
    expected = [0, 1, 2, 11, 12, *range(r + 2, r + 15, 3), *range(r + 15, r + 18)]
    assert not_told_at_rest(state, slam._image_model()).tolist() == expected


def test_without_combinations_nothing_changes() -> None:
    state, after = some_state(), some_state(seed=1)
    assert with_considered(state, after, np.empty((0, COUNT))) is after


def not_told(
    *effects: str, has_moved: bool, stretch: tuple[float, ...] | None = None, std: float = 0.02
) -> Array:
    """Return the combinations that an image does not tell, of effects beside the scale factor."""
    model = default_model()
    for name in effects:
        model = with_effect(model, find_effect(name))
    slam = EkfSlam(model, Config(), SimSource(find_scenario('cleaning'), 1).rig)
    k = slam.state.coefficient_columns
    covariance = slam.state.covariance.copy()
    covariance[k, k] = std**2 * np.eye(slam.state.coefficient_count)
    by_values = None if stretch is None else np.array(stretch)
    image = replace(slam._image_model(), has_moved=has_moved, stretch_by_values=by_values)
    return combinations_not_told(replace(slam.state, covariance=covariance), image)


def test_before_the_camera_has_moved_no_effect_of_the_view_is_told() -> None:
    effects = ('gyro_lag', 'camera_position', 'lateral_drift')
    np.testing.assert_array_equal(not_told(*effects, has_moved=False), np.eye(6)[2:])
    assert not_told('gyro_lag', has_moved=False).shape == (0, 2)
    assert not_told(*effects, has_moved=True).shape == (0, 6)


@pytest.mark.parametrize(('std', 'is_told'), [(0.02, False), (0.0005, True)])
def test_a_stretch_is_not_told_until_it_is_known(std: float, is_told: bool) -> None:
    found = not_told('lateral_drift', has_moved=True, stretch=(0.0, 0.8, 0.6), std=std)
    np.testing.assert_array_equal(found, np.empty((0, 3)) if is_told else [[0.0, 0.8, 0.6]])


def test_a_stretch_is_what_lengthens_the_way() -> None:
    drift = 0.3 * np.eye(3)[:, :2]
    for way_m, expected in (([0.0, 0.3, 0.0], [0.0, 1.0]), ([-0.3, 0.0, 0.0], [-1.0, 0.0])):
        stretch = stretch_by_values(np.array(way_m), drift)
        assert stretch is not None
        np.testing.assert_allclose(stretch, expected)
    assert stretch_by_values(np.zeros(3), drift) is None


@pytest.mark.parametrize('effect', ['principal_point', 'camera_position', 'focal_length'])
def test_spins_do_not_tell_where_the_camera_is(effect: str) -> None:
    """A robot that spins for a minute and then drives; its spins alone gave up to 50 sigma."""
    scenario = replace(varied_scenario(7012), duration_s=110.0, furniture=())
    config = Config()
    config = replace(config, camera=replace(config.camera, pixel_noise_px=scenario.errors.pixel_noise_px))
    model = with_effect(default_model(), find_effect(effect))
    history = calibrate(SimSource(scenario, 7012), config, model).history
    spun = int(np.searchsorted(history.time_s, 60.0))
    columns = slice(10, 9 + history.coefficients.shape[1])
    assert (history.std[spun, columns] > 0.95 * history.std[0, columns]).all()
    assert (history.std[-1, columns] < 0.2 * history.std[0, columns]).all()
    assert (np.abs(history.coefficients[-1, 1:]) < 3.0 * history.std[-1, columns]).all()


class TestDriftAcrossTheFloor:
    """The first leg of `cleaning` goes along the x axis of the map, until 17 s; y comes next, for a metre."""

    SIZE = 0.015

    @pytest.fixture(scope='class')
    def histories(self) -> list[History]:
        pixel_px, config = 0.05, Config()
        config = replace(config, camera=replace(config.camera, pixel_noise_px=pixel_px))
        drive = find_scenario('cleaning')
        errors = replace(drive.errors, pixel_noise_px=pixel_px)
        drive = replace(drive, duration_s=40.0, imu_hz=100, camera_hz=6, errors=errors)
        effect = find_effect('lateral_drift')
        hidden = (HiddenEffect(effect, (self.SIZE, self.SIZE)),)
        model = with_effect(default_model(), effect)
        return [calibrate(SimSource(drive, seed, hidden=hidden), config, model).history for seed in (1, 2, 3)]

    def test_one_leg_does_not_tell_how_much_longer_it_is(self, histories: list[History]) -> None:
        for history in histories:
            leg = int(np.searchsorted(history.time_s, 15.0))
            std = history.std[leg, 10:12] / history.std[0, 10:12]
            assert std[0] > 0.9 and std[1] < 0.2

    def test_across_the_leg_and_along_the_next_one_it_is_known(self, histories: list[History]) -> None:
        """By the present depth alone, along the first leg was 3 to 11 sigma off."""
        for history in histories:
            error, std = history.coefficients[-1, 1:] - self.SIZE, history.std[-1, 10:12]
            assert (np.abs(error) < 2.0 * std).all()
            assert (np.abs(error) < 0.3 * self.SIZE).all() and (std < 0.6 * self.SIZE).all()


def test_images_count_for_no_model_while_coefficients_wait_for_the_camera_to_move() -> None:
    """Each would pay for coefficients that it may not correct, and a true effect would predict worse."""
    scenario = replace(find_scenario('lanes'), duration_s=30.0, imu_hz=100, camera_hz=5)
    source, model = SimSource(scenario, 1), default_model()
    before, after = (
        calibrate(source, Config(), each) for each in (model, with_effect(model, find_effect('focal_length')))
    )
    history = after.history
    waits, seen = history.waits > 0, history.dof > 0
    assert not before.history.waits.any() and 0 < np.count_nonzero(waits & seen) < np.count_nonzero(seen)
    assert np.all(np.diff(waits[seen].astype(int)) <= 0), 'once the camera has moved, nothing waits any more'
    for where, counts in ((waits, False), (~waits, True)):
        worse = replace(history, log_likelihood=history.log_likelihood - 9.0 * where)
        lost = predictive_gain(before, after) - predictive_gain(before, replace(after, history=worse))
        assert lost.sum() == pytest.approx(9.0 * np.count_nonzero(where) if counts else 0.0)
