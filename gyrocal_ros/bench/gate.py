"""The gate: a few quick figures of accuracy and consistency, held against those that are kept.

The same seeds give the same figures, but for rounding; a change of the code that means no harm moves
them a little. How far they may go comes from how they scatter from seed to seed. Time is not looked at.
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
from gyrocal_ros.bench.paper.landmark import NOISE_PX, follow
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.ranking import estimate
from gyrocal_ros.diagnose.search import examine
from gyrocal_ros.diagnose.summarise import summarise_recording
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.scale import FULL_RATE_RAD_S, scale_power
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

KEPT = Path(__file__).with_name('kept.json')
SCATTER = 4
"""The scatter is taken over so many times as many seeds as the gate uses."""
STANDARD_ERRORS = 2.0
"""A figure may move by so many standard errors of its mean over the seeds of the gate."""
HIDDEN_CUBIC = 0.003 / FULL_RATE_RAD_S**2

Measure = Callable[[int], dict[str, float]]
"""Figures of one seed by name."""


@dataclass(frozen=True, slots=True)
class Check:
    """Figures that are measured together."""

    name: str
    seeds: int
    measure: Measure


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure as it is kept."""

    value: float
    """Mean over the seeds of the gate."""
    tolerance: float
    both_sides: bool
    """Whether it is wrong for it to become smaller, too."""

    def allows(self, value: float) -> bool:
        """Whether a new value is as good as the one that is kept."""
        if not math.isfinite(value):
            return False
        return value <= self.value + self.tolerance and (
            not self.both_sides or value >= self.value - self.tolerance
        )


@dataclass(frozen=True, slots=True)
class Outcome:
    """A figure measured now beside the kept one."""

    name: str
    value: float
    kept: Figure

    @property
    def passes(self) -> bool:
        """Whether it stays within its tolerance."""
        return self.kept.allows(self.value)


def lanes(seed: int) -> dict[str, float]:
    """Scale factor, consistency and heading after 100 s of lanes."""
    trial = run_bench(replace(find_scenario('lanes'), duration_s=100.0), seed, OURS)
    return {
        'scale_error_percent': 100.0 * abs(trial.final_error),
        'scale_std_percent': 100.0 * trial.final_std,
        'scale_nees': trial.nees,
        'nis_per_dof': trial.nis_per_dof,
        'heading_rms_deg': math.degrees(trial.heading_rms_rad),
        'settled_error_percent': 100.0 * abs(trial.settled_error),
    }


def images(seed: int) -> dict[str, float]:
    """The same from images, up to the first turn."""
    scenario = replace(find_scenario('filmed'), duration_s=20.0)
    trial = run_bench(scenario, seed, OURS, images=True)
    return {
        'scale_error_percent': 100.0 * abs(trial.final_error),
        'heading_rms_deg': math.degrees(trial.heading_rms_rad),
    }


def spins(seed: int) -> dict[str, float]:
    """Heading after ten rotations without the camera."""
    short = replace(
        find_scenario('blind_spins'),
        stages=(('lanes', 60.0), ('spins', 0.0)),
        duration_s=180.0,
        camera_until_s=60.0,
    )
    calibrated, _ = rotations(short, seed)
    return {'heading_error_deg': float(np.degrees(np.abs(calibrated.heading_rad)).mean())}


def landmark(seed: int) -> dict[str, float]:
    """The paper's Fig. 15 after 50 cm, by its own form and by ours."""
    forms = {'proposed_cm': 'camera_frame', 'inverse_depth_cm': 'inverse_depth'}
    return {name: float(follow(PARAMETRISATIONS[form], NOISE_PX, seed)[-1]) for name, form in forms.items()}


def bent(seed: int) -> dict[str, float]:
    """What a robot with a bent gyro is told after two minutes, beside one without fault."""
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
"""Figures that tell of consistency rather than of error."""


def gate(each: Mapper, kept: Mapping[str, Figure], checks: Sequence[Check] = CHECKS) -> list[Outcome]:
    """Measure every figure that is kept."""
    return [
        Outcome(name, mean, kept[name])
        for check in checks
        for name, (mean, _) in _measured(each, check, check.seeds).items()
    ]


def measure_to_keep(each: Mapper, checks: Sequence[Check] = CHECKS) -> dict[str, Figure]:
    """The figures of the present code, with what their scatter over more seeds allows."""
    found = {}
    for check in checks:
        for name, (mean, sd) in _measured(each, check, SCATTER * check.seeds).items():
            tolerance = STANDARD_ERRORS * sd / math.sqrt(check.seeds)
            found[name] = Figure(mean, tolerance, name.partition('.')[2] in BOTH_SIDES)
    return found


def load_kept(path: Path = KEPT) -> dict[str, Figure]:
    """Read the kept figures."""
    tree = json.loads(path.read_text(encoding='utf-8'))
    return {name: Figure(**figure) for name, figure in tree['figures'].items()}


def to_keep(figures: Mapping[str, Figure]) -> dict[str, Any]:
    """What to write into the file of the kept figures."""
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
    """Mean over the seeds of the gate, and scatter from seed to seed over all that were run."""
    rows = list(each(check.measure, list(range(seeds))))
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return {
        f'{check.name}.{name}': (float(values[: check.seeds].mean()), float(values.std(ddof=1)))
        for name, values in columns.items()
    }


def _cubic(seed: int, hidden: Iterable[HiddenEffect]) -> tuple[float, float]:
    """What the evidence says of a cubic part, and its significance."""
    scenario = replace(find_scenario('cleaning'), duration_s=120.0, imu_hz=100, camera_hz=10)
    simulated = SimSource(scenario, seed, hidden=tuple(hidden))
    source, config = preload(simulated, Config(), default_model())
    stage = examine(
        default_model(),
        summarise_recording(source),
        lambda model, tried: calibrate(source, config, model, candidates=tried),
    )
    ranked_effect = next(item for item in stage.ranked if item.effect.name == scale_power(3).name)
    return float(estimate(ranked_effect)[0]), ranked_effect.fit.sigma
