"""One simulated recording, one run of the filter, and its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.drift import heading_rms_deg
from gyrocal_ros.effects import SCALE_FACTOR, default_model
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.sensors import without_noise
from gyrocal_ros.sim.world import START_NS, SimSource
from gyrocal_ros.statistics import nis_per_dof

EARLY_S, SETTLED_S = 5.0, 20.0
"""Times after the end of the first turn at which convergence is assessed."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant of the filter, with its name in the tables."""

    name: str
    parametrisation: str = 'inverse_depth'
    motion_gate: bool = True
    settling_bias: bool = False
    map_size: int | None = None

    def config(self, config: Config) -> Config:
        """Return the settings of this variant."""
        features = replace(config.features, parametrisation=self.parametrisation)
        if not self.motion_gate:
            features = replace(features, motion_gate_m=0.0, motion_gate_deg=0.0)
        if self.map_size is not None:
            features = replace(features, map_size=self.map_size)
        return replace(config, features=features)

    def model(self) -> SensorModel:
        """Return the sensor model of this variant."""
        if not self.settling_bias:
            return default_model()
        return SensorModel('paper', BiasModel('settling'), (scale_power(1),))


@dataclass(frozen=True, slots=True)
class BenchRun:
    """Result of one seed. Errors are relative to the true scale factor."""

    seed: int
    early_error: float
    """Error 5 s after the end of the first turn."""
    settled_error: float
    """Error 20 s after the end of the first turn."""
    final_error: float
    final_std: float
    nis_per_dof: float
    heading_rms_rad: float
    bound_std: float = math.nan
    """Cramer-Rao bound of the final standard deviation."""
    diverged: bool = False

    @property
    def nees(self) -> float:
        """Normalised estimation error squared: squared final error over its variance."""
        return (self.final_error / self.final_std) ** 2


def run_bench(
    scenario: Scenario,
    seed: int,
    variant: Variant,
    *,
    images: bool = False,
    with_bound: bool = False,
    config: Config | None = None,
) -> BenchRun:
    """Simulate a scenario, run the filter on it and compare with the truth."""
    source = SimSource(scenario, seed, images=images)
    try:
        run = calibrate(source, variant.config(config or Config()), variant.model())
    except FilterDivergedError:
        return BenchRun(seed, *(math.nan,) * 6, diverged=True)
    true_scale = source.truth.scale_factor
    scale = 1.0 + run.history.coefficients[:, 0]
    time_s = (run.history.t_ns - START_NS) / NS_PER_S
    turned_s = end_of_first_turn_s(source)

    def error_at(moment_s: float) -> float:
        return float(scale[min(int(np.searchsorted(time_s, moment_s)), len(scale) - 1)]) / true_scale - 1.0

    return BenchRun(
        seed=seed,
        early_error=error_at(turned_s + EARLY_S),
        settled_error=error_at(turned_s + SETTLED_S),
        final_error=float(scale[-1]) / true_scale - 1.0,
        final_std=float(run.history.std[-1, COEFFICIENTS_START]) / true_scale,
        nis_per_dof=nis_per_dof(run.history.nis, run.history.dof) or math.nan,
        heading_rms_rad=math.radians(heading_rms_deg(run) or math.nan),
        bound_std=bound_std(scenario, seed) if with_bound else math.nan,
    )


def bound_std(scenario: Scenario, seed: int) -> float:
    """Compute the Cramer-Rao bound of the relative standard deviation of the scale factor at the end.

    The posterior bound (Tichavsky, Muravchik, Nehorai 1998) obeys the covariance recursion with all
    Jacobians at the truth. That is the case for the same recording without noise, where the filter starts at
    the true coefficients with unchanged noise settings. The map keeps every feature that may reappear, so no
    information is discarded.
    """
    source = SimSource(replace(scenario, errors=without_noise(scenario.errors)), seed)
    model, config = default_model(), Variant('bound', map_size=100).config(Config())
    config = replace(config, camera=replace(config.camera, estimate_pixel_noise=False))
    prior = model.coefficients[0].prior_std
    true_scale = source.truth.scale_factor
    truth = Start((SCALE_FACTOR,), np.array([true_scale - 1.0]), np.array([[prior**2]]))
    run = calibrate(source, config, model, truth)
    return float(run.history.std[-1, COEFFICIENTS_START]) / true_scale


def end_of_first_turn_s(source: SimSource) -> float:
    """Return the time at which the robot has finished its first turn of at least 45 deg."""
    time_s = np.arange(0.0, source.scenario.duration_s, 0.02)
    rate = source.truth.trajectory.motion(time_s).rate_rad_s[:, 2]
    turning = np.abs(rate) > math.radians(2.0)
    starts = np.flatnonzero(np.diff(turning.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(turning.astype(int), append=0) == -1)
    for start, end in zip(starts, ends, strict=True):
        if abs(float(rate[start : end + 1].sum())) * 0.02 > math.radians(45.0):
            return float(time_s[end])
    return source.scenario.duration_s


def settled_after_s(time_s: Array, errors: Array, within: float) -> float:
    """Return the time from which an error (n,) stays within bounds to the end; NaN if it ends outside."""
    outside = np.flatnonzero(~(np.abs(errors) <= within))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return float(time_s[first]) if first < len(errors) else math.nan
