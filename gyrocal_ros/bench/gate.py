"""Regression gate: quick figures of accuracy and consistency are compared with those of a baseline.

The same seeds give the same figures, up to rounding; a harmless change of the code moves them a little. The
tolerances follow from the scatter over the seeds. Time is not compared.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros import __version__
from gyrocal_ros.bench.accuracy import OURS
from gyrocal_ros.bench.bench_run import run_bench
from gyrocal_ros.bench.camera_off import rotations
from gyrocal_ros.bench.paper.experiment import Mapper
from gyrocal_ros.bench.paper.landmark import NOISE_PX, landmark_errors_cm
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import examine
from gyrocal_ros.diagnose.analysis.ranking import estimate
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.scale import FULL_RATE_RAD_S, scale_power
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

BASELINE = Path(__file__).with_name('kept.json')
SCATTER = 4
"""Number of seeds for the scatter, relative to that of the gate."""
STANDARD_ERRORS = 2.0
"""Tolerance of a figure, in standard errors of its mean over the seeds of the gate."""
HIDDEN_CUBIC = 0.003 / FULL_RATE_RAD_S**2
"""Hidden cubic coefficient: 0.3 % of the rate at 100 deg/s."""

Measure = Callable[[int], dict[str, float]]
"""Function that returns the figures of one seed by name."""


@dataclass(frozen=True, slots=True)
class Check:
    """Figures that are measured together."""

    name: str
    seeds: int
    measure: Measure


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the baseline."""

    value: float
    """Mean over the seeds of the gate."""
    tolerance: float
    both_sides: bool
    """True if a smaller value is a regression, too."""

    def allows(self, value: float) -> bool:
        """Return True if a new value is within the tolerance."""
        if not math.isfinite(value):
            return False
        return value <= self.value + self.tolerance and (
            not self.both_sides or value >= self.value - self.tolerance
        )


@dataclass(frozen=True, slots=True)
class Outcome:
    """A figure of the present code, with that of the baseline."""

    name: str
    value: float
    baseline: Figure

    @property
    def passes(self) -> bool:
        """True if the value is within the tolerance."""
        return self.baseline.allows(self.value)


def lanes(seed: int) -> dict[str, float]:
    """Measure scale factor, consistency and heading after 100 s of lanes."""
    found = run_bench(replace(find_scenario('lanes'), duration_s=100.0), seed, OURS)
    return {
        'scale_error_percent': 100.0 * abs(found.final_error),
        'scale_std_percent': 100.0 * found.final_std,
        'scale_nees': found.nees,
        'nis_per_dof': found.nis_per_dof,
        'heading_rms_deg': math.degrees(found.heading_rms_rad),
        'settled_error_percent': 100.0 * abs(found.settled_error),
    }


def images(seed: int) -> dict[str, float]:
    """Measure scale factor and heading from images, up to the first turn."""
    scenario = replace(find_scenario('filmed'), duration_s=20.0)
    found = run_bench(scenario, seed, OURS, images=True)
    return {
        'scale_error_percent': 100.0 * abs(found.final_error),
        'heading_rms_deg': math.degrees(found.heading_rms_rad),
    }


def spins(seed: int) -> dict[str, float]:
    """Measure the heading error after ten rotations without the camera."""
    short = replace(
        find_scenario('blind_spins'),
        stages=(('lanes', 60.0), ('spins', 0.0)),
        duration_s=180.0,
        camera_until_s=60.0,
    )
    calibrated, _ = rotations(short, seed)
    return {'heading_error_deg': float(np.degrees(np.abs(calibrated.heading_rad)).mean())}


def landmark(seed: int) -> dict[str, float]:
    """Measure the errors of the paper's Fig. 15 after 50 cm, by its parametrisation and by inverse depth."""
    forms = {'proposed_cm': 'camera_frame', 'inverse_depth_cm': 'inverse_depth'}
    return {
        name: float(landmark_errors_cm(PARAMETRISATIONS[form], NOISE_PX, seed)[-1])
        for name, form in forms.items()
    }


def bent(seed: int) -> dict[str, float]:
    """Measure the estimate of a nonlinear gyro after two minutes, and the significance with a linear one."""
    cubic = HiddenEffect(scale_power(3), (HIDDEN_CUBIC,))
    value, sigma = _cubic(seed, (cubic,))
    _, nothing_sigma = _cubic(seed, ())
    return {
        'found_percent_of_it': 100.0 * value / HIDDEN_CUBIC,
        'sigma': sigma,
        'sigma_where_there_is_nothing': nothing_sigma,
    }


CHECKS = (
    Check('lanes', 8, lanes),
    Check('images', 2, images),
    Check('spins', 4, spins),
    Check('landmark', 200, landmark),
    Check('bent', 2, bent),
)
BOTH_SIDES = ('scale_std_percent', 'scale_nees', 'nis_per_dof', 'found_percent_of_it', 'sigma')
"""Figures of consistency, which must not become smaller either."""


def gate(each: Mapper, baseline: Mapping[str, Figure], checks: Sequence[Check] = CHECKS) -> list[Outcome]:
    """Measure all figures of the baseline."""
    return [
        Outcome(name, mean, baseline[name])
        for check in checks
        for name, (mean, _) in _measured(each, check, check.seeds).items()
    ]


def measure_baseline(each: Mapper, checks: Sequence[Check] = CHECKS) -> dict[str, Figure]:
    """Measure the figures of the present code, with tolerances by the scatter over more seeds."""
    found = {}
    for check in checks:
        for name, (mean, sd) in _measured(each, check, SCATTER * check.seeds).items():
            tolerance = STANDARD_ERRORS * sd / math.sqrt(check.seeds)
            found[name] = Figure(mean, tolerance, name.partition('.')[2] in BOTH_SIDES)
    return found


def load_baseline(path: Path = BASELINE) -> dict[str, Figure]:
    """Read a baseline."""
    tree = json.loads(path.read_text(encoding='utf-8'))
    return {name: Figure(**figure) for name, figure in tree['figures'].items()}


def baseline_to_dict(figures: Mapping[str, Figure]) -> dict[str, Any]:
    """Return the content of the file of a baseline."""
    return {
        'version': __version__,
        'seeds': {check.name: check.seeds for check in CHECKS},
        'figures': {
            name: {
                'value': float(f'{figure.value:.6g}'),
                'tolerance': float(f'{figure.tolerance:.3g}'),
                'both_sides': figure.both_sides,
            }
            for name, figure in figures.items()
        },
    }


def _measured(each: Mapper, check: Check, seeds: int) -> dict[str, tuple[float, float]]:
    """Return the mean over the seeds of the gate, and the standard deviation over all seeds."""
    rows = list(each(check.measure, list(range(seeds))))
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return {
        f'{check.name}.{name}': (float(values[: check.seeds].mean()), float(values.std(ddof=1)))
        for name, values in columns.items()
    }


def _cubic(seed: int, hidden: Iterable[HiddenEffect]) -> tuple[float, float]:
    """Return the estimate of the cubic coefficient by the score statistics, and its significance."""
    scenario = replace(find_scenario('cleaning'), duration_s=120.0, imu_hz=100, camera_hz=10)
    simulated = SimSource(scenario, seed, hidden=tuple(hidden))
    source, config = preload(simulated, Config(), default_model())
    stage = examine(
        default_model(),
        summarise_recording(source),
        lambda model, tried: calibrate(source, config, model, candidates=tried),
    )
    cubic = next(item for item in stage.ranked if item.effect.name == scale_power(3).name)
    return float(estimate(cubic)[0]), cubic.fit.sigma
