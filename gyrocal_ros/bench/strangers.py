"""Blind trials of learning: laws that the library lacks, hidden in recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import first_seeds, in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.drift import blind_drift
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.laws.learning import learn
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.hidden import draw_hidden, draw_scale_factor, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.strangers import STRANGERS
from gyrocal_ros.sim.world import SimSource

NOTHING = 'nothing hidden'
GOOD_RATIO = 1.3
"""Drift after learning, relative to that of the same recording without the law, of a law that was learned."""


@dataclass(frozen=True, slots=True)
class StrangerResult:
    """Result of one recording with a law that the library lacks."""

    law: str
    seed: int
    learned: tuple[str, ...] = ()
    """Everything that was added to the model, of the library and learned."""
    is_right: bool = False
    """True if an effect of the right kind and signal is among it; without a law, if nothing is."""
    drift_before_deg: float = float('nan')
    drift_after_deg: float = float('nan')
    drift_without_deg: float = float('nan')
    """Held-out drift before and after, and that of the same recording without the law."""
    form: str = ''
    """Closed form that comes first of the law that was learned; empty without one."""
    scale_sigma: float = float('nan')
    """Distance of the scale factor from the truth, in its standard deviations."""
    names_library: bool = False
    """True if an effect of the library was claimed and the drift stayed above `GOOD_RATIO`."""

    @property
    def is_good(self) -> bool:
        """True if the drift fell to about that of a recording without the law."""
        return self.drift_after_deg <= GOOD_RATIO * self.drift_without_deg

    @property
    def forms(self) -> tuple[str, ...]:
        """Closed forms that the law is; none without a law."""
        return STRANGERS[self.law].forms if self.law in STRANGERS else ()

    @property
    def holds_scale(self) -> bool:
        """True if the scale factor of the filter means that of the simulation."""
        return self.law not in STRANGERS or STRANGERS[self.law].holds_scale


def strangers(seeds: int, only: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield one row per law as they become ready, and one for all together.

    Args:
        seeds: number of recordings of each law, 300 s each.
        only: labels; empty for all.
    """
    first = first_seeds(labels(), seeds)
    tasks = [(law, first[law] + k) for law in labels() if not only or law in only for k in range(seeds)]
    every: list[StrangerResult] = []
    for law, group in groupby(in_parallel(_run_task, tasks), key=lambda result: result.law):
        results = list(group)
        every += results
        yield row(law, results)
    yield row('all', [result for result in every if result.law != NOTHING] or every)


def labels() -> list[str]:
    """Return the labels of the cases."""
    return [NOTHING, *STRANGERS]


def row(label: str, results: Sequence[StrangerResult]) -> dict[str, Any]:
    """Return the figures of some recordings.

    right: share with the right kind and signal. good: share whose drift is at most 1.3 times that without the
    law. worse: share whose drift rose. library: share with an effect of the library that did not explain it.
    form: share with the correct closed form first, of laws that have one. scale_3_sigma: share whose scale
    factor is within three standard deviations of the truth, of laws of which no part is a scale factor.
    """
    answers = Counter(' + '.join(result.learned) or 'nothing' for result in results)
    return {
        'law': label,
        'bags': len(results),
        'right': float(np.mean([result.is_right for result in results])),
        'good': float(np.mean([result.is_good for result in results])),
        'worse': float(np.mean([result.drift_after_deg > result.drift_before_deg for result in results])),
        'library': float(np.mean([result.names_library for result in results])),
        'form': _share([result.form in result.forms for result in results if result.forms]),
        'scale_3_sigma': _share([result.scale_sigma < 3.0 for result in results if result.holds_scale]),
        'before_deg': float(np.mean([result.drift_before_deg for result in results])),
        'after_deg': float(np.mean([result.drift_after_deg for result in results])),
        'without_deg': float(np.mean([result.drift_without_deg for result in results])),
        'learned': ', '.join(f'{name} {count}' for name, count in answers.most_common()),
    }


def _share(verdicts: Sequence[bool]) -> float | None:
    return float(np.mean(verdicts)) if verdicts else None


def run_stranger(law: str, seed: int) -> StrangerResult:
    """Hide a law of a random size, search the library, learn, and compare with the truth.

    Args:
        law: name in `STRANGERS`, or `NOTHING`.
        seed: seed of the recording.
    """
    scenario = find_scenario('cleaning')
    drawn = draw_hidden(seed, scenario.duration_s, () if law == NOTHING else (law,))
    errors = replace(scenario.errors, scale_factor=draw_scale_factor(seed))
    simulate = partial(SimSource, replace(scenario, errors=errors), seed)
    present = default_model()
    source, config = preload(simulate(hidden=hide(drawn, find_effect)), Config(), present)
    recorded = summarise_recording(source)

    @remembered
    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        return calibrate(source, config, model, candidates=candidates)

    result = StrangerResult(law, seed, drift_without_deg=_drift_deg(simulate(hidden=()), present))
    try:
        searched = find_missing(present, recorded, run)
        known = learn(searched, recorded, run)
    except FilterDivergedError:
        return result
    found = known.searched
    learned = tuple(item.effect.name for item in found.kept)
    calibrated = conclude(found.last.run)
    scale_error = abs(calibrated.scale_factor - errors.scale_factor)
    result = replace(
        result,
        learned=learned,
        form=next((law.forms[0].form.name for law in known.laws if law.forms), ''),
        scale_sigma=scale_error / calibrated.scale_factor_std,
        is_right=not learned if law == NOTHING else _is_right(law, learned),
        drift_before_deg=_held_out_deg(found.first.run),
        drift_after_deg=_held_out_deg(found.last.run),
    )
    claims = any(name in EFFECTS for name in learned)
    return replace(result, names_library=claims and not result.is_good)


def _is_right(law: str, learned: Sequence[str]) -> bool:
    """Return True if an effect of the right kind and signal was learned, an event at any value."""
    return not set(map(_without_value, STRANGERS[law].right)).isdisjoint(map(_without_value, learned))


def _without_value(name: str) -> str:
    kind, _, follows = name.partition(':')
    event = event_of(follows)
    return name if event is None else f'{kind}:{event.kind}:{event.signal}'


def _drift_deg(source: SimSource, model: SensorModel) -> float:
    return _held_out_deg(calibrate(source, Config(), model))


def _held_out_deg(run: Run) -> float:
    """Return the held-out drift: in the second half, each span starts with the estimate of that time."""
    return blind_drift(run, from_s=0.5 * float(run.history.time_s[-1])).rms_deg


def _run_task(task: tuple[str, int]) -> StrangerResult:
    return run_stranger(*task)
