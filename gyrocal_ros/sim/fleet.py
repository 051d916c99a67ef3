"""Simulated fleets: many robots whose parts differ, age, and may lack the same effect or be faulty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.traits import is_limit, may_break_the_filter
from gyrocal_ros.sim.hidden import LIBRARY_RANGES, DrawnEffect, draw_values, hide
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.sensors import draw_climate, stream
from gyrocal_ros.sim.world import SimSource

MEAN_SCALE_ERROR = 0.05
"""Largest error of the scale factor's mean."""
SPREAD = (0.002, 0.01)
"""Range of the part-to-part standard deviation of the scale factor, drawn log-uniformly."""
AGEING_PER_1000_H = (2e-4, 1e-3)
AGEING_SPREAD = 0.3
"""Range of the mean drift of the scale factor in 1000 h, and its relative spread from robot to robot."""
OLDEST_H, BETWEEN_BAGS_H = 3000.0, (100.0, 600.0)
"""Largest age at the first bag, and range of the running hours from one bag to the next."""
ROOM_MEAN_C, ROOM_SPREAD_C = 22.0, 5.0
FAULTY_PART = 0.05
"""Share of robots with a faulty gyro, in fleets in which that is at least one robot."""
FAULT_SPREADS = (6.0, 12.0)
"""Range of the error of a faulty gyro, in part-to-part standard deviations."""
P_EFFECT = 0.5
"""Probability of an effect that all robots have."""
SMALL = 0.3
"""Largest strength of that effect, from 0, just visible in a long recording, to 1."""
FIRST_DAY = datetime(2025, 1, 6, 8, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class FleetLaw:
    """Law by which the parts of a fleet are drawn."""

    mean: float
    """Mean scale factor at zero running hours."""
    spread: float
    """Part-to-part standard deviation of the scale factor."""
    ageing_per_h: float
    """Mean drift of the scale factor."""
    ageing_spread_per_h: float
    effect: DrawnEffect | None
    """Effect of all robots."""


@dataclass(frozen=True, slots=True)
class Part:
    """The gyro of one robot."""

    robot: str
    scale_factor: float
    """At zero running hours."""
    ageing_per_h: float
    is_faulty: bool


@dataclass(frozen=True, slots=True)
class FleetBag:
    """One recording to simulate."""

    name: str
    robot: str
    time: str
    age_h: float
    scale_factor: float
    scenario: Scenario
    seed: int
    effect: DrawnEffect | None

    def source(self) -> SimSource:
        """Return the measurements."""
        errors = replace(self.scenario.errors, scale_factor=self.scale_factor)
        hidden = hide([self.effect] if self.effect else [], find_effect)
        return SimSource(replace(self.scenario, errors=errors), self.seed, hidden=hidden)


@dataclass(frozen=True, slots=True)
class SimFleet:
    """A drawn fleet."""

    law: FleetLaw
    parts: tuple[Part, ...]
    bags: tuple[FleetBag, ...]

    def answer(self) -> dict[str, Any]:
        """Return the hidden facts, for the sealed file."""
        law = self.law
        return {
            'fleet': {
                'mean': law.mean,
                'spread': law.spread,
                'ageing_per_1000_h': 1000.0 * law.ageing_per_h,
                'effect': law.effect.name if law.effect else None,
                'effect_values': list(law.effect.values) if law.effect else [],
                'faulty': [part.robot for part in self.parts if part.is_faulty],
            },
            'robots': {part.robot: part.scale_factor for part in self.parts},
        }


def draw_law(
    seed: int, duration_s: float, effects: Sequence[str] | None = None, size: float | None = None
) -> FleetLaw:
    """Draw the law of a fleet.

    Args:
        seed: seed of all draws.
        duration_s: length of the recordings.
        effects: names to draw the effect of all robots from; empty for none, None for any or none.
        size: strength of that effect, 0 to 1; None to draw a small one.
    """
    rng = stream(seed, 'fleet law')
    mean = 1.0 + rng.uniform(-MEAN_SCALE_ERROR, MEAN_SCALE_ERROR)
    spread = float(np.exp(rng.uniform(*np.log(SPREAD))))
    ageing = rng.choice([-1.0, 1.0]) * rng.uniform(*AGEING_PER_1000_H) / 1000.0
    chance, drawn_size = rng.uniform(size=2)
    names = sorted(LIBRARY_RANGES) if effects is None else sorted(effects)
    usable = [name for name in names if effects is not None or is_gentle(name)]
    effect = None
    if usable and (effects is not None or chance < P_EFFECT):
        name = str(rng.choice(usable))
        effect = draw_values(name, rng, duration_s, SMALL * drawn_size if size is None else size)
    return FleetLaw(float(mean), spread, float(ageing), AGEING_SPREAD * abs(float(ageing)), effect)


def draw_fleet(
    law: FleetLaw, seed: int, robots: int, bags: int, scenario: Scenario, duration_s: float
) -> SimFleet:
    """Draw the parts of a fleet and the conditions of its recordings.

    Args:
        law: law of the parts.
        seed: seed of all draws.
        robots: number of robots.
        bags: number of bags of each.
        scenario: motion and sensors of every recording.
        duration_s: length of a recording.
    """
    scenario = replace(scenario, duration_s=duration_s)
    rng = stream(seed, 'fleet parts')
    faulty = set(rng.permutation(robots)[: int(FAULTY_PART * robots)].tolist())
    parts = tuple(_draw_part(law, rng, number, number in faulty) for number in range(robots))
    drawn: list[FleetBag] = []
    for number, part in enumerate(parts):
        drawn += _draw_bags(part, law, rng, (seed, number), bags, scenario)
    return SimFleet(law, parts, tuple(drawn))


def _draw_part(law: FleetLaw, rng: np.random.Generator, number: int, is_faulty: bool) -> Part:
    deviation, ageing = rng.standard_normal(2)
    sign, size = rng.choice([-1.0, 1.0]), rng.uniform(*FAULT_SPREADS)
    return Part(
        robot=f'robot_{number:04d}',
        scale_factor=law.mean + law.spread * float(sign * size if is_faulty else deviation),
        ageing_per_h=law.ageing_per_h + law.ageing_spread_per_h * float(ageing),
        is_faulty=is_faulty,
    )


def _draw_bags(
    part: Part,
    law: FleetLaw,
    rng: np.random.Generator,
    seeds: tuple[int, int],
    count: int,
    scenario: Scenario,
) -> Iterator[FleetBag]:
    age_h = rng.uniform(0.0, OLDEST_H)
    for place in range(count):
        climate = replace(draw_climate(rng), room_c=rng.normal(ROOM_MEAN_C, ROOM_SPREAD_C))
        yield FleetBag(
            name=f'{part.robot}/bag_{place:03d}',
            robot=part.robot,
            time=(FIRST_DAY + timedelta(hours=round(age_h))).strftime('%Y-%m-%dT%H:%M:%SZ'),
            age_h=round(age_h, 1),
            scale_factor=part.scale_factor + part.ageing_per_h * round(age_h, 1),
            scenario=replace(scenario, climate=climate),
            seed=int(np.random.SeedSequence([*seeds, place]).generate_state(1)[0]),
            effect=law.effect,
        )
        age_h += rng.uniform(*BETWEEN_BAGS_H)


def is_gentle(name: str) -> bool:
    """Return True if the filter runs without the effect, and can estimate it."""
    effect = find_effect(name)
    return not is_limit(effect) and not may_break_the_filter(effect)
