"""A scale factor that depends on the rate or the side is found, and its shift counts in the deviations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.status import calibration_status
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, State
from gyrocal_ros.ekf.state.normal_equations import normal_equations
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.ekf.watches.camera_watch import TIME, CameraWatch
from gyrocal_ros.ekf.watches.law_watch import (
    BLOCK_S,
    CHANCE_SIGMA,
    LAWS,
    PRIOR_STD,
    RATES,
    SETTLE_S,
    SIDES,
    SIGNIFICANT_SIGMA,
    LawWatch,
)
from gyrocal_ros.ekf.watches.told_faults import told_fault
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.forward import HiddenEffect

CUBIC, BY_CUBIC = 0, -2.0


def some_state() -> State:
    """Return a state whose scale factor depends on the cubic law."""
    state = initial_state(default_model(), Config(), None, len(LAWS))
    state.sensitivity[COEFFICIENTS_START, CUBIC] = BY_CUBIC
    return state


def stats_of(value: float, sigma: float, nis: float = 0.0, dof: int = 100) -> UpdateStats:
    """Return updates, in one, that show a cubic law of a size with a significance."""
    information = np.zeros(len(LAWS))
    information[CUBIC] = (sigma / value) ** 2
    return UpdateStats(sigma**2 + nis, dof, information=np.diag(information), score=information * value)


def watch_of(*updates: UpdateStats, estimated: tuple[str, ...] = ()) -> LawWatch:
    watch = LawWatch(0, estimated)
    watch.add(0.1, updates)
    return watch


@pytest.mark.parametrize(('sigma', 'part'), [(0.9 * CHANCE_SIGMA, 0.0), (2.0 * CHANCE_SIGMA, 0.75**0.5)])
def test_what_chance_does_not_explain_of_a_law_counts(sigma: float, part: float) -> None:
    std = watch_of(stats_of(1e-4, sigma)).suspected_std(some_state())
    assert SCALE == 1
    np.testing.assert_allclose(std, [0.0, part * abs(BY_CUBIC) * 1e-4], rtol=0.01)


def test_innovations_that_no_law_explains_are_noise() -> None:
    shown = stats_of(1e-4, 5.0)
    assert watch_of(shown, stats_of(1e-4, 1e-3, nis=10.0)).explained > 0.0
    assert watch_of(shown, stats_of(1e-4, 1e-3, nis=500.0)).explained == 0.0


def test_images_of_something_else_hardly_count() -> None:
    right, other = stats_of(1e-4, 2.0), stats_of(-1e-4, 30.0, nis=1e6, dof=10)
    assert watch_of(other).explained == 0.0
    assert watch_of(right, other).sums.values[CUBIC] > 0.0


def test_what_the_model_estimates_is_no_law_that_it_lacks() -> None:
    assert watch_of(stats_of(1e-4, 10.0)).explained == pytest.approx(100.0, rel=0.01)
    assert watch_of(stats_of(1e-4, 10.0), estimated=('scale_cubic',)).explained == 0.0


def test_a_law_is_told_once_it_has_been_certain_for_some_time() -> None:
    uncertain, certain = (watch_of(stats_of(1e-4, sigma)) for sigma in (0.9 * SIGNIFICANT_SIGMA, 10.0))
    assert not any(uncertain.finding(0.6 * SETTLE_S) for _ in range(3))
    told = [certain.finding(0.6 * SETTLE_S) for _ in range(2)]
    assert told[0] == '' and told[1] == f'{RATES} (10 sigma); a diagnosis tells the law'
    certain.restart()
    assert certain.finding(2.0 * SETTLE_S) == ''


@pytest.mark.parametrize('agree', [True, False])
def test_a_law_upon_which_the_blocks_do_not_agree_is_not_told(agree: bool) -> None:
    """A bias that walks more than is expected makes scores of either sign."""
    watch = LawWatch(0)
    for value in [1e-4] * 6 if agree else (9e-4, -3e-4, 2e-4, -3e-4):
        watch.add(BLOCK_S, (stats_of(value, 8.0 * abs(value) / 1e-4, dof=10_000),))
    assert watch.explained > 0.0
    assert bool(watch.finding(2.0 * SETTLE_S)) == agree


def model_with(*names: str) -> SensorModel:
    model = default_model()
    for name in names:
        model = with_effect(model, find_effect(name))
    return model


@cache
def driven(name: str, value: float, *added: str) -> tuple[Run, float]:
    """Return a run with a hidden law and some effects added, and the error of the scale factor in sigma."""
    hidden = (HiddenEffect(find_effect(name), (value,)),)
    source = recording('cleaning', 2, 120.0, hidden=hidden)
    run = calibrate(source, Config(), model_with(*added), follows_changes=True)
    found = conclude(run)
    return run, (found.scale_factor - source.truth.scale_factor) / found.scale_factor_std


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [('scale_cubic', -0.0015, RATES), ('scale_quadratic', 0.001, SIDES), ('scale_asymmetry', 0.001, SIDES)],
)
def test_a_law_of_the_rate_is_no_change_of_the_scale_factor(name: str, value: float, words: str) -> None:
    run, z = driven(name, value)
    assert not run.history.scale_followed.any() and abs(z) < 2.5
    assert [fault for fault, _ in map(told_fault, (event.text for event in run.events)) if words in fault]
    status = calibration_status(conclude(run), run, model_fit(run))
    assert status.level != 'green'
    assert not driven(name, value, name)[0].events, 'the model has it'


def test_the_noise_is_not_blamed_for_a_law() -> None:
    run, _ = driven('scale_cubic', -0.0015)
    assert (run.history.bias_walk == 1.0).all()


def shown_by(errors: np.ndarray, dof: int = 40_000) -> UpdateStats:
    """Return updates, in one, by errors of the camera and laws; the cubic law goes with the time offset."""
    rng = np.random.default_rng(4)
    by_errors = rng.normal(size=(400, len(errors)))
    by_errors[:, CameraWatch.count + CUBIC] += 3.0 * by_errors[:, TIME]
    information = 3e5 * by_errors.T @ by_errors
    score = information @ errors
    return UpdateStats(float(errors @ score) + dof, dof, information=information, score=score)


@pytest.mark.parametrize('law', [0.0, 0.003])
def test_an_error_of_the_camera_is_no_law(law: float) -> None:
    errors = np.zeros(CameraWatch.count + len(LAWS))
    errors[TIME], errors[CameraWatch.count + CUBIC] = 0.005, law
    camera = CameraWatch(0)
    watch, alone = LawWatch(CameraWatch.count, (), camera), LawWatch(CameraWatch.count)
    stats = shown_by(errors)
    for each in (camera, watch, alone):
        each.add(0.1, (stats,))
    assert camera.is_significant and alone.explained > 0.0
    assert (watch.explained > 0.0) == (law > 0.0)


def test_the_shift_by_a_law_is_that_beside_the_camera() -> None:
    errors = np.zeros(CameraWatch.count + len(LAWS))
    errors[TIME], errors[CameraWatch.count + CUBIC] = 0.005, 0.003
    camera = CameraWatch(0)
    watch, stats = LawWatch(CameraWatch.count, (), camera), shown_by(errors)
    camera.add(0.1, (stats,))
    watch.add(0.1, (stats,))
    state = initial_state(default_model(), Config(), None, len(errors))
    state.sensitivity[COEFFICIENTS_START, [TIME, CameraWatch.count + CUBIC]] = 1.0, BY_CUBIC
    prior_std = np.concatenate([camera.prior_std, PRIOR_STD])
    before = camera.shift(state)
    assert before is not None and stats.information is not None and stats.score is not None
    both = normal_equations(stats.information + np.diag(prior_std**-2.0), stats.score).values
    total = float(both @ state.sensitivity[COEFFICIENTS_START, : len(errors)])
    assert watch.suspected_std(state)[SCALE] == pytest.approx(abs(total - before[SCALE]), rel=0.05)


@pytest.mark.parametrize('seed', [0, 1])
def test_a_rolling_shutter_does_not_leave_the_scale_factor_unknown(seed: int) -> None:
    """In lanes of one speed it looks like a cubic of a size that no gyro has."""
    hidden = (HiddenEffect(find_effect('rolling_shutter'), (0.018,)),)
    source = recording('lanes', seed, 120.0, hidden=hidden, camera_hz=10)
    found = conclude(calibrate(source, Config(), default_model(), follows_changes=True))
    assert found.converged
    assert abs(found.scale_factor - source.truth.scale_factor) < 2.5 * found.scale_factor_std
