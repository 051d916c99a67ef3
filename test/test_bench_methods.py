"""Comparison with other methods of calibration, and the bound by batch least squares."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.bench import methods
from gyrocal_ros.bench.batch import solve
from gyrocal_ros.bench.bench_run import bound_std, settled_after_s
from gyrocal_ros.bench.methods import MethodResult, compare_on, row
from gyrocal_ros.bench.naive import bias_at_rest, fit_to_wheels, spins_against_wall
from gyrocal_ros.config.sections import Config
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import without_noise
from gyrocal_ros.sim.world import SimSource

LANES = replace(find_scenario('lanes'), duration_s=25.0)


def test_an_error_of_the_wheels_becomes_an_error_of_the_scale_factor() -> None:
    quiet = replace(without_noise(LANES.errors), track_error=0.03)
    source = SimSource(replace(LANES, errors=quiet, floor_tilt_deg=0.0, bumps=0), 0)
    found = fit_to_wheels(list(source.measurements()))
    assert found.scale[-1] * 1.03 == pytest.approx(source.truth.scale_factor, rel=2e-3)
    assert found.bias_rad_s[-1] == pytest.approx(source.truth.bias_rad_s[0, 2], abs=2e-4)
    assert found.time_s[-1] == pytest.approx(24.0, abs=0.1)


def test_spins_against_a_wall_determine_the_scale_factor() -> None:
    scale, took_s = spins_against_wall(replace(LANES, errors=without_noise(LANES.errors)), 0)
    assert scale == pytest.approx(LANES.errors.scale_factor, rel=1e-6)
    assert 45.0 < took_s < 60.0


def test_rest_determines_the_bias() -> None:
    source = SimSource(replace(LANES, duration_s=3.0), 0)
    expected = source.truth.bias_rad_s[0, 2] / source.truth.scale_factor
    assert bias_at_rest(list(source.measurements()), 3.0) == pytest.approx(expected, abs=3e-4)


@pytest.mark.slow
def test_the_batch_estimate_reaches_the_bound() -> None:
    source = SimSource(LANES, 0)
    found = solve(source.measurements(), source.rig, Config())
    truth = source.truth.scale_factor
    assert found.scale_factor_std / truth == pytest.approx(bound_std(LANES, 0), rel=0.02)
    assert abs(found.scale_factor - truth) < 4.0 * found.scale_factor_std
    assert found.rounds < 6, 'it converges'


@pytest.mark.slow
def test_without_noise_the_batch_estimate_is_exact() -> None:
    source = SimSource(replace(LANES, errors=without_noise(LANES.errors)), 0)
    found = solve(source.measurements(), source.rig, Config())
    assert found.scale_factor == pytest.approx(source.truth.scale_factor, rel=2e-5)


@pytest.mark.slow
def test_every_method_is_compared_on_one_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(methods, 'OFF_S', 25.0)
    monkeypatch.setattr(methods, 'SPINS_UNTIL_S', 130.0)
    monkeypatch.setattr(methods, 'DURATION_S', 170.0)
    monkeypatch.setattr(methods, 'TEN_MINUTES_S', 20.0)
    found = {result.method: result for result in compare_on(0)}
    nominal, wheels, wall = (
        found[method] for method in ('nominal scale', 'wheel headings', 'spins against a wall')
    )
    ours, bound = found['this package'], found['batch of everything']
    assert abs(nominal.scale_error) > abs(wheels.scale_error) > 0.01 > abs(ours.scale_error)
    assert math.isnan(nominal.settled_s) and math.isnan(wheels.settled_s)
    assert wall.settled_s > ours.settled_s > 5.0
    assert ours.scale_std / bound.scale_std == pytest.approx(1.0, abs=0.05)
    assert math.degrees(max(map(abs, nominal.spins_rad))) > 200.0
    assert math.degrees(max(map(abs, ours.spins_rad))) < 10.0
    assert all(math.isfinite(result.cleaning_rad) for result in found.values())


def test_a_row_summarises_the_seeds() -> None:
    found = [
        MethodResult('some', 1e-4, 2e-4, 10.0, (0.01, -0.02), 0.01),
        MethodResult('some', -1e-4, 2e-4, 14.0, (0.03, 0.0), -0.01),
        MethodResult('some'),
    ]
    figures = row(found, np.array([1e-4, 1e-4, 1e-4]))
    assert figures['seeds'] == 3 and figures['diverged'] == 1
    assert figures['scale_rms_percent'] == pytest.approx(0.01)
    assert figures['error_by_std'] == pytest.approx(0.5) and figures['std_by_bound'] == pytest.approx(2.0)
    assert figures['spins_mean_abs_deg'] == pytest.approx(math.degrees(0.015))
    assert figures['minutes_rms_deg'] == pytest.approx(math.degrees(0.01))
    assert (figures['settled_seeds'], figures['settled_median_s']) == (2, 12.0)


def test_an_error_settles_when_it_stays_within_bounds() -> None:
    time_s = np.arange(5.0)
    assert settled_after_s(time_s, np.array([3.0, 0.1, 3.0, 0.1, -0.2]), 1.0) == 3.0
    assert settled_after_s(time_s, np.zeros(5), 1.0) == 0.0
    assert math.isnan(settled_after_s(time_s, np.array([0.0, 0.0, 0.0, 0.0, 2.0]), 1.0))
