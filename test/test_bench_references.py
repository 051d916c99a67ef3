"""The bench of heading references: its bound, its arithmetic, and a short recording."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.bench import references as bench
from gyrocal_ros.bench.reference_bound import reference_bound, white_information
from gyrocal_ros.bench.references import (
    ReferenceResult,
    cases,
    clean_row,
    drift_rad,
    effects_row,
    run_reference,
)
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import HeadingSample
from gyrocal_ros.effects import find_effect
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.references import OUTLIER_FACTOR, DrawnReference, ReferenceSource, is_at_rest
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.sensors import gyro_bias
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource

SHORT = replace(find_scenario('cleaning'), duration_s=40.0, imu_hz=50)
NORMAL = DrawnReference(10.0, 0.01, 0.001, 0.0, 0.0, (), (), holds_at_rest=False)


def test_the_information_of_normal_noise_is_the_inverse_of_its_variance() -> None:
    assert white_information(NORMAL) == pytest.approx(1.0 / NORMAL.white_rad**2, rel=1e-6)


def test_outliers_cost_less_information_than_their_variance_says() -> None:
    information = white_information(replace(NORMAL, outliers=0.1)) * NORMAL.white_rad**2
    assert 1.0 / (0.9 + 0.1 * OUTLIER_FACTOR**2) < information < 1.0
    assert information > 0.8, 'nine tenths of the headings are as good as before'


def test_the_bound_follows_the_noise() -> None:
    def bound(**changed: float) -> tuple[float, float]:
        source = ReferenceSource(SimSource(SHORT, 3), 'mocap')
        source.reference = replace(NORMAL, **changed)  # type: ignore[arg-type]
        found = reference_bound(source, Config())
        return found.scale_std, found.bias_std_rad_s

    usual, walking, coarse = bound(), bound(walk_rad=0.01), bound(white_rad=0.1)
    assert walking[0] > usual[0] and coarse[0] > usual[0]
    assert walking[1] > usual[1], 'the rest at the start is short'
    assert walking[1] < math.radians(0.0075) / math.sqrt(2.5) * 1.5, 'at rest the gyro reads its bias'


def test_only_rests_that_last_count_as_known() -> None:
    """A robot that turns back stands still for an instant, which its wheels cannot show."""

    def bias_std(settle_s: float) -> float:
        source = ReferenceSource(SimSource(SHORT, 3), 'mocap')
        source.reference = replace(NORMAL, walk_rad=1.0)
        config = replace(Config(), rest=replace(Config().rest, settle_s=settle_s))
        return reference_bound(source, config).bias_std_rad_s

    known_s, walked_rad_s = SHORT.standing_s - 0.3, math.radians(2.5e-4) * math.sqrt(37.0)
    noise_rad_s = SHORT.errors.scale_factor * math.radians(0.0075)  # that of the true rate
    expected = math.hypot(noise_rad_s / math.sqrt(known_s), walked_rad_s)
    assert bias_std(0.3) == pytest.approx(expected, rel=0.02)
    assert bias_std(0.0) < 0.95 * bias_std(0.3)


def test_every_recording_has_its_own_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[tuple[str, int]] = []

    def task(case: str, seed: int, *, varied: bool) -> ReferenceResult:
        seeds.append((case, seed))
        return result(0.0)

    monkeypatch.setattr(bench, 'run_reference', task)
    monkeypatch.setattr(bench, 'in_parallel', map)
    list(bench.references(3))
    clean = [seed for case, seed in seeds if case != bench.EFFECTS_CASE]
    assert sorted(clean) == list(range(15))


def test_the_bias_walks_as_the_settings_say_unless_the_robot_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robots: list[SimSource] = []

    def calibrated(source: ReferenceSource, result: ReferenceResult) -> ReferenceResult:
        robots.append(source.robot)
        return result

    monkeypatch.setattr(bench, '_calibrated', calibrated)
    for case, varied in (('mocap', False), ('mocap', True), (bench.EFFECTS_CASE, False)):
        run_reference(case, 5, 30.0, varied=varied)
    walking, drawn, hiding = (robot.scenario.errors for robot in robots)
    assert drawn.bias_wander_time_s == varied_scenario(5).errors.bias_wander_time_s
    assert hiding.bias_wander_time_s == find_scenario('cleaning').errors.bias_wander_time_s
    time_s = np.linspace(0.0, 400.0, 101)
    biases = np.stack([gyro_bias(time_s, walking, np.random.default_rng(seed)) for seed in range(200)])
    changes = np.degrees(biases[:, -1] - biases[:, 0])
    expected = Config().gyro.bias_walk_deg_s * math.sqrt(400.0)
    assert np.sqrt(np.mean(changes**2)) == pytest.approx(expected, rel=0.1)


def test_encoders_hold_their_heading_at_rest() -> None:
    source = ReferenceSource(SimSource(SHORT, 3), 'encoders')
    headings = [sample for sample in source.measurements() if isinstance(sample, HeadingSample)]
    true_s = np.array([sample.t_ns - source.span.start_ns for sample in headings]) * 1e-9
    rests = is_at_rest(source.truth.trajectory.motion(true_s - source.reference.offset_s))
    changes = np.diff([sample.yaw_rad for sample in headings])
    at_rest = rests[1:] & rests[:-1]
    assert at_rest.sum() > 20 and np.abs(changes[at_rest]).max() < 1e-5 < np.median(np.abs(changes[~at_rest]))
    held = reference_bound(source, Config())
    source.reference = replace(source.reference, holds_at_rest=False)
    walking = reference_bound(source, Config())
    assert held.scale_std < walking.scale_std


def test_a_varied_reference_is_that_of_the_robot_of_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    robots: list[Scenario] = []

    def calibrated(source: ReferenceSource, result: ReferenceResult) -> ReferenceResult:
        robots.append(source.robot.scenario)
        return result

    monkeypatch.setattr(bench, '_calibrated', calibrated)
    for varied in (False, True):
        run_reference('lidar', 5, 30.0, varied=varied)
    assert robots[1] == replace(varied_scenario(5), duration_s=30.0, errors=robots[1].errors)
    assert robots[0].imu_hz == find_scenario('cleaning').imu_hz != robots[1].imu_hz


def test_a_hidden_effect_drifts_in_proportion_to_its_size() -> None:
    clean = SimSource(SHORT, 3)
    effect = find_effect('scale_asymmetry')
    small, large = (
        drift_rad(SimSource(SHORT, 3, hidden=(HiddenEffect(effect, (size,)),)), clean)
        for size in (0.005, 0.01)
    )
    assert drift_rad(clean, clean) == pytest.approx(0.0, abs=1e-9)
    assert large == pytest.approx(2.0 * small, rel=0.05) and small > 0.0


def result(scale_z: float, verdict: str = 'nothing_missing', **changed: object) -> ReferenceResult:
    known = ReferenceResult(
        'lidar', '', False, '', scale_z, 0.5, 1e-3, 1.2, 1.3, converged=True, verdict=verdict
    )
    return replace(known, **changed)  # type: ignore[arg-type]


def test_rows_of_recordings_that_hide_nothing() -> None:
    failed = ReferenceResult('lidar', failure='no turns')
    claimed = result(3.0, 'effect_found', named=('scale_cubic',))
    row = clean_row('lidar', [result(-1.0), result(1.0), claimed, failed])
    assert (row['bags'], row['failed']) == (4, 1)
    assert row['scale_z_rms'] == pytest.approx(math.sqrt(11.0 / 3.0))
    assert row['scale_inside'] == pytest.approx(2.0 / 3.0) and row['bias_inside'] == 1.0
    assert row['false_claims'] == pytest.approx(1.0 / 3.0) and row['claimed'] == 'scale_cubic 1'
    assert row['scale_by_bound'] == pytest.approx(1.2)
    assert clean_row('lidar', [failed])['scale_z_rms'] is None
    assert effects_row([result(0.0)])['named_first'] is None


def test_rows_of_hidden_effects_count_the_large_ones() -> None:
    def hidden(name: str, is_large: bool, *named: str, twins: tuple[str, ...] = ()) -> ReferenceResult:
        return result(0.0, 'effect_found', hidden=name, is_large=is_large, named=named, twins=twins)

    row = effects_row(
        [
            hidden('scale_cubic', True, 'scale_cubic'),
            hidden('bias_warmup', True, 'bias_temperature', twins=('bias_warmup',)),
            hidden('bias_warmup', True, 'scale_cubic'),
            hidden('scale_cubic', False),
        ]
    )
    assert (row['bags'], row['large']) == (4, 3)
    assert row['named_first'] == pytest.approx(1.0 / 3.0) and row['or_twin'] == pytest.approx(2.0 / 3.0)
    assert row['missed'] == 'bias_warmup as scale_cubic 1'


@pytest.mark.slow
def test_a_recording_is_honest() -> None:
    found = run_reference('encoders', 1, 30.0)
    assert not found.failure and found.verdict in ('nothing_missing', 'cannot_tell')
    assert abs(found.scale_z) < 3.0 and abs(found.bias_z) < 3.0
    assert 0.7 < found.scale_by_bound < 2.0 and 0.7 < found.bias_by_bound < 2.5
    assert np.isfinite(found.scale_std) and 'effects' in cases()
