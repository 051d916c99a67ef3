"""One simulated recording, one run of the filter, and how far that is from the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.drift import heading_rms_deg
from gyrocal_ros.effects import SCALE_FACTOR, default_model
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.ekf.run import History
from gyrocal_ros.ekf.start import Start
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.sensors import without_noise
from gyrocal_ros.sim.world import START_NS, SimSource

EARLY_S, SETTLED_S = 5.0, 20.0
"""When convergence is looked at, after the end of the first turn."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A way of running the filter, by the name that stands in the table."""

    name: str
    parametrisation: str = 'inverse_depth'
    motion_gate: bool = True
    settling_bias: bool = False
    map_size: int | None = None

    def config(self, config: Config) -> Config:
        """The settings of this variant."""
        features = replace(config.features, parametrisation=self.parametrisation)
        if not self.motion_gate:
            features = replace(features, motion_gate_m=0.0, motion_gate_deg=0.0)
        if self.map_size is not None:
            features = replace(features, map_size=self.map_size)
        return replace(config, features=features)

    def model(self) -> SensorModel:
        """The sensor model of this variant."""
        if not self.settling_bias:
            return default_model()
        return SensorModel('paper', BiasModel('settling'), (scale_power(1),))


@dataclass(frozen=True, slots=True)
class BenchRun:
    """What one seed shows. Errors are relative to the true scale factor."""

    seed: int
    early_error: float
    """5 s after the end of the first turn."""
    settled_error: float
    """20 s after it."""
    final_error: float
    final_std: float
    nis_per_dof: float
    heading_rms_rad: float
    bound_std: float = math.nan
    """Cramer-Rao bound of the final standard deviation."""
    diverged: bool = False

    @property
    def nees(self) -> float:
        """Squared final error by its variance."""
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
    """Simulate a scenario, run the filter on it and compare."""
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
        nis_per_dof=nis_per_dof(run.history),
        heading_rms_rad=math.radians(heading_rms_deg(run) or math.nan),
        bound_std=bound_std(scenario, seed) if with_bound else math.nan,
    )


def bound_std(scenario: Scenario, seed: int) -> float:
    """Cramer-Rao bound of the scale factor's relative standard deviation at the end.

    The posterior bound (Tichavsky, Muravchik, Nehorai 1998) obeys the covariance recursion with all
    Jacobians at the truth. They are there when the same recording is made without noise and the
    filter starts at the true coefficients, its noise settings being as they are. The map keeps
    every feature that can come back, so no information is thrown away.
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
    """When the robot has finished its first turn of at least 45 deg."""
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
    """From when on an error (n,) stays within bounds to the end; NaN if it ends outside."""
    outside = np.flatnonzero(~(np.abs(errors) <= within))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return float(time_s[first]) if first < len(errors) else math.nan


def nis_per_dof(history: History) -> float:
    """Normalised innovation squared by its degrees of freedom, over the whole run."""
    return float(history.nis.sum() / max(history.dof.sum(), 1.0))
