"""The prior of a fleet for a robot that it does not know: consistency, and time to a known scale factor."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import EFFECTS, SCALE_FACTOR, default_model, find_effect
from gyrocal_ros.effects.model_file import model_to_dict
from gyrocal_ros.effects.traits import scanned_coefficient
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.fleet.findings import find
from gyrocal_ros.fleet.plan import PlannedBag
from gyrocal_ros.fleet.prior import prior_of
from gyrocal_ros.fleet.result import CALIBRATED, BagResult
from gyrocal_ros.fleet.store import FleetStore
from gyrocal_ros.fleet.table import read_fleet
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.fleet import FleetBag, FleetLaw, SimFleet, draw_fleet, draw_law, is_gentle
from gyrocal_ros.sim.hidden import LIBRARY_RANGES
from gyrocal_ros.sim.scenarios import find_scenario

SCENARIO, DURATION_S = 'lanes', 60.0
ROBOTS, SEED = 40, 1
EFFECT_SIZE = 0.5
"""Size of the effect that the robots have and the model of the fleet contains, see `sim.hidden`."""
TIGHT = 1e-3
"""Standard deviation of the scale factor to which the time is measured."""


@dataclass(frozen=True, slots=True)
class _Calibrated:
    """What the filter made of one simulated bag."""

    row: Mapping[str, Any]
    scale_z: float
    """Error of the scale factor in its standard deviations."""
    time_to_tight_s: float
    """Time until the standard deviation of the scale factor is below `TIGHT`; infinite if it never is."""


def priors() -> Iterator[dict[str, Any]]:
    """Yield how consistent and how much faster the filter is from a prior of the other robots.

    First for the plain model, then with each effect of the gyro in all robots and in the model of the fleet.
    """
    for effects in ([], *([name] for name in sorted(EFFECTS) if _can_be_common(name))):
        yield _prior_figures(draw_law(SEED, DURATION_S, effects, EFFECT_SIZE))


def _can_be_common(name: str) -> bool:
    """Return True for an effect of the gyro that the filter estimates without a first guess from a scan."""
    effect = find_effect(name)
    is_drawn = name in LIBRARY_RANGES and is_gentle(name)
    return is_drawn and effect.acts_on == 'gyro' and scanned_coefficient(effect) is None


def _prior_figures(law: FleetLaw) -> dict[str, Any]:
    effect = law.effect.name if law.effect else None
    drawn = draw_fleet(law, SEED, ROBOTS, 1, find_scenario(SCENARIO), DURATION_S)
    run = partial(_calibrated, effect)
    before = list(in_parallel(run, [(bag, None) for bag in drawn.bags]))
    starts = list(_priors_without_each(drawn, before, _model(effect)))
    after = list(in_parallel(run, list(zip(drawn.bags, starts, strict=True))))
    healthy = np.array([not part.is_faulty for part in drawn.parts])
    prior_z = np.array(
        [
            (bag.scale_factor - 1.0 - start.values[1]) / math.sqrt(start.covariance[1, 1])
            for bag, start in zip(drawn.bags, starts, strict=True)
        ]
    )
    z = np.array([item.scale_z for item in after])
    return {
        'figure': f'prior without the robot, {ROBOTS} robots',
        'effect_in_model': effect or 'none',
        'prior_z_rms': _rms(prior_z[healthy]),
        'z_rms': _rms(z[healthy]),
        'z_faulty_max': float(np.abs(z[~healthy]).max()),
        'to_0.1_percent_s': float(np.median([item.time_to_tight_s for item in before])),
        'with_prior_s': float(np.median([item.time_to_tight_s for item in after])),
    }


def _calibrated(effect: str | None, task: tuple[FleetBag, Start | None]) -> _Calibrated:
    """Run the filter over one simulated bag with the effect in its model."""
    bag, start = task
    config, model = Config(), _model(effect)
    source, config = preload(bag.source(), config, model)
    run = calibrate(source, config, model, start)
    calibration = conclude(run)
    row: dict[str, Any] = {'status': CALIBRATED, 'reason': '', 'converged': calibration.converged}
    row |= {'duration_s': DURATION_S, 'temperature_c': float(np.nanmean(run.history.temperature_c))}
    for name, value, std in zip(calibration.names, calibration.values, calibration.stds, strict=True):
        row |= {name: float(value) + (name == SCALE_FACTOR), f'{name}_std': float(std)}
    tight = np.flatnonzero(run.history.std[:, COEFFICIENTS_START] < TIGHT)
    return _Calibrated(
        row=row,
        scale_z=(calibration.scale_factor - bag.scale_factor) / calibration.scale_factor_std,
        time_to_tight_s=float(run.history.time_s[tight[0]]) if len(tight) else math.inf,
    )


def _priors_without_each(
    drawn: SimFleet, measured: Sequence[_Calibrated], model: SensorModel
) -> Iterator[Start]:
    """Yield the prior of each robot, from the bags of all others."""
    pairs = list(zip(drawn.bags, measured, strict=True))
    with tempfile.TemporaryDirectory() as folder:
        for left_out in drawn.parts:
            kept = [(bag, item) for bag, item in pairs if bag.robot != left_out.robot]
            store = FleetStore(Path(folder) / left_out.robot)
            planned = [PlannedBag(bag.name, bag.robot, {'age_h': bag.age_h}) for bag, _ in kept]
            results = [BagResult(item.row, None) for _, item in kept]
            store.write_tables(planned, results, {'model': model_to_dict(model)})
            yield prior_of(find(read_fleet([store.folder])), Config()).start()


def _model(effect: str | None) -> SensorModel:
    return with_effect(default_model(), find_effect(effect)) if effect else default_model()


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))
