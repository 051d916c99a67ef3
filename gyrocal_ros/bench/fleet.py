"""Fleets with known truth: coverage of the statistics, effects found, priors, engine, interruptions, size.

Coverage and effects use results of the filter drawn from their measured distribution: a few recordings
are run in full for it, and each drawn bag takes the errors and the score statistics of one of them. `in_full`
says how many recordings the filter ran over.
"""

from __future__ import annotations

import math
import resource
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.bench.fleet_engine import engine
from gyrocal_ros.bench.fleet_prior import priors
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidates import candidates_for
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.effects import SCALE_FACTOR, default_model
from gyrocal_ros.effects.model_file import model_to_dict
from gyrocal_ros.fleet.findings import AGE, find
from gyrocal_ros.fleet.plan import PlannedBag
from gyrocal_ros.fleet.pooling import Pooled, pool
from gyrocal_ros.fleet.result import CALIBRATED, BagResult, BagScores
from gyrocal_ros.fleet.store import FleetStore
from gyrocal_ros.fleet.table import ScoreTable, read_fleet
from gyrocal_ros.fleet.work import bag_scores
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.fleet import FAULTY_PART, FleetBag, SimFleet, draw_fleet, draw_law
from gyrocal_ros.sim.scenarios import find_scenario

SCENARIO, DURATION_S = 'lanes', 60.0
ROBOTS, BAGS = 40, 3
MEASURED = 40
"""Number of recordings that are run in full for the distribution of the results."""
PER_BAG_SIGMA = 1.5
"""Size of a hidden effect of the fleet in standard deviations of one bag."""
ROWS, ROWS_PER_ROBOT = 100_000, 4
BAGS_PER_SEED = 10


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What the filter made of one simulated bag."""

    scale_error: float
    scale_std: float
    bias: float
    bias_std: float
    converged: bool
    temperature_c: float
    scores: BagScores


def fleet(fleets: int, only: Collection[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield the figures one after the other.

    Args:
        fleets: number of drawn fleets for coverage and effects; the engine works on ten times as many bags.
        only: names of figures to measure; all if it is empty.
    """
    figures: dict[str, Callable[[], Iterable[dict[str, Any]]]] = {
        'coverage': lambda: [coverage(fleets)],
        'effects': lambda: effects(fleets),
        'prior': priors,
        'size': lambda: [large(ROWS)],
        'engine': lambda: engine(BAGS_PER_SEED * fleets),
    }
    for name in only or figures:
        yield from figures[name]()


def measure(bag: FleetBag) -> Measured:
    """Run the filter over one simulated bag, with all candidates."""
    config, model = Config(), default_model()
    source, config = preload(bag.source(), config, model)
    carried = candidates_for(model, summarise_recording(source)).carried
    run = calibrate(source, config, model, candidates=carried)
    calibration, scores = conclude(run), bag_scores(run)
    assert scores is not None
    return Measured(
        scale_error=calibration.scale_factor - bag.scale_factor,
        scale_std=calibration.scale_factor_std,
        bias=float(calibration.values[0]),
        bias_std=float(calibration.stds[0]),
        converged=calibration.converged,
        temperature_c=float(np.nanmean(run.history.temperature_c)),
        scores=scores,
    )


def coverage(fleets: int) -> dict[str, Any]:
    """Return how often mean, spread and ageing of drawn fleets lie in their 95 % intervals."""
    pool_of = _measured()
    inside, called, wrong = np.zeros(3), 0, 0
    for seed in range(fleets):
        drawn = draw_fleet(
            draw_law(seed, DURATION_S, []), seed, ROBOTS, BAGS, find_scenario(SCENARIO), DURATION_S
        )
        with tempfile.TemporaryDirectory() as folder:
            found = find(read_fleet([_write(drawn, pool_of, seed, Path(folder) / 'fleet')]))
        fitted, law = found.coefficients[SCALE_FACTOR], drawn.law
        pairs = (
            (fitted.mean, law.mean),
            (fitted.spread, law.spread),
            (fitted.slopes[AGE], 1000.0 * law.ageing_per_h),
        )
        inside += [item.low <= truth <= item.high for item, truth in pairs]
        faulty = {part.robot for part in drawn.parts if part.is_faulty}
        flagged = {found.robots[place] for place in fitted.out_of_family.tolist()}
        called += len(flagged & faulty)
        wrong += len(flagged - faulty)
    mean, spread, ageing = (inside / fleets).tolist()
    return {
        'figure': f'{fleets} fleets of {ROBOTS} x {BAGS}',
        'in_full': len(pool_of),
        'mean_inside': mean,
        'spread_inside': spread,
        'ageing_inside': ageing,
        'faulty_found': f'{called} of {fleets * int(ROBOTS * FAULTY_PART)}',
        'falsely_called': wrong,
    }


def effects(fleets: int) -> Iterator[dict[str, Any]]:
    """Yield how often an effect of 1.5 sigma per bag is found and named, and findings in clean fleets.

    An effect theta adds Lambda theta to the score of a bag, to first order.
    """
    names = _measured()[0].scores.names
    rng = np.random.default_rng(0)
    shown = [column for column, name in enumerate(names) if '@' not in name]
    hidden = rng.choice(shown, fleets).tolist()
    results = [_pooled(column, seed) for seed, column in enumerate(hidden)]
    truth = [names[column].rsplit('.', 1)[0] for column in hidden]
    found = [
        next((item for item in result.found if item.effect == name), None)
        for result, name in zip(results, truth, strict=True)
    ]
    first = [
        bool(result.found) and result.found[0].effect == name
        for result, name in zip(results, truth, strict=True)
    ]
    among = [
        bool(result.found) and name in (result.found[0].effect, *result.found[0].confused_with)
        for result, name in zip(results, truth, strict=True)
    ]
    sigmas = [item.sigma for item in found if item is not None]
    yield {
        'figure': f'effect of {PER_BAG_SIGMA} sigma in {ROBOTS} bags',
        'in_full': len(_measured()),
        'fleets': fleets,
        'found': sum(bool(result.found) for result in results),
        'named_first': sum(first),
        'named_or_alike': sum(among),
        'sigma_median': float(np.median(sigmas)) if sigmas else None,
    }
    clean = [_pooled(None, seed) for seed in range(2 * fleets)]
    yield {
        'figure': f'clean fleets of {ROBOTS} bags',
        'in_full': len(_measured()),
        'fleets': len(clean),
        'found': sum(bool(result.found) for result in clean),
    }


def large(rows: int) -> dict[str, Any]:
    """Return the time of all statistics on a large fleet, and its size."""
    measured, robots = _measured(), rows // ROWS_PER_ROBOT
    drawn = draw_fleet(
        draw_law(1, DURATION_S, []), 1, robots, ROWS_PER_ROBOT, find_scenario(SCENARIO), DURATION_S
    )
    with tempfile.TemporaryDirectory() as folder:
        path = _write(drawn, measured, 1, Path(folder) / 'fleet')
        size = sum(file.stat().st_size for file in path.glob('*.parquet'))
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        find(read_fleet([path]))
        return {
            'figure': f'statistics on {rows} bags',
            'in_full': len(measured),
            'wall_s': time.perf_counter() - began_s,
            'cpu_s': time.process_time() - began_cpu_s,
            'peak_mb_of_process': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            'bytes_per_bag': size / rows,
        }


@cache
def _measured() -> tuple[Measured, ...]:
    """Run the filter over one bag of each of some robots without a hidden effect."""
    return tuple(in_parallel(measure, _fleet_to_measure().bags))


def _fleet_to_measure() -> SimFleet:
    scenario = find_scenario(SCENARIO)
    return draw_fleet(draw_law(1, DURATION_S, []), 1, MEASURED, 1, scenario, DURATION_S)


def _write(drawn: SimFleet, measured: tuple[Measured, ...], seed: int, folder: Path) -> Path:
    """Write the tables of a fleet whose results are drawn from measured ones."""
    rng = np.random.default_rng(seed)
    chosen = rng.integers(len(measured), size=len(drawn.bags)).tolist()
    planned = [PlannedBag(bag.name, bag.robot, {'age_h': bag.age_h}) for bag in drawn.bags]
    results = (_result(bag, measured[place]) for bag, place in zip(drawn.bags, chosen, strict=True))
    FleetStore(folder).write_tables(planned, results, {'model': model_to_dict(default_model())})
    return folder


def _result(bag: FleetBag, measured: Measured) -> BagResult:
    """Return the result of a bag with the errors and the score statistics of a measured one."""
    row = {
        'status': CALIBRATED,
        'reason': '',
        SCALE_FACTOR: bag.scale_factor + measured.scale_error,
        'scale_factor_std': measured.scale_std,
        'bias': measured.bias,
        'bias_std': measured.bias_std,
        'converged': measured.converged,
        'temperature_c': measured.temperature_c,
        'duration_s': DURATION_S,
    }
    return BagResult(row, measured.scores)


def _pooled(column: int | None, seed: int) -> Pooled:
    """Pool the score statistics of drawn bags, with the effect of one column hidden in all of them."""
    rng = np.random.default_rng(seed)
    measured = _measured()
    bags = [measured[place].scores for place in rng.integers(len(measured), size=ROBOTS).tolist()]
    information = np.array([item.information for item in bags])
    score: Array = np.array([item.score for item in bags])
    diagonal = np.einsum('bii->bi', information)
    if column is not None:
        theta = PER_BAG_SIGMA / math.sqrt(float(np.median(diagonal[:, column])))
        score = score + theta * information[:, :, column]
    table = ScoreTable(
        bags=tuple(map(str, range(ROBOTS))),
        robots=tuple(map(str, range(ROBOTS))),
        names=bags[0].names,
        units=bags[0].units,
        information=diagonal,
        score=score,
        std=np.array([item.std for item in bags]),
    )
    return pool(table, lambda columns: information[:, columns[:, None], columns])
