"""Fig. 8: the scale factor on a rate table, and the diagnosis of its linearity.

There are three parts as in the paper, and one with a nonlinearity, for which the paper has no test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.paper.experiment import NOMINAL_VOLT, Claim, Mapper, assess
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, ImuSample
from gyrocal_ros.diagnose.analysis.ranking import estimate, estimate_stds
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.scale import FULL_RATE_RAD_S, scale_power
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.trajectory import Leg
from gyrocal_ros.sim.world import START_NS, SimSource

RATES_DEG_S = np.arange(20.0, 91.0, 10.0)
REST_S, GLIDE_S, HOLD_S = 10.0, 1.0, 30.0
BEND = 0.003
"""Nonlinearity of the last part: 0.3 % of the rate at 100 deg/s."""

CUBIC = scale_power(3).name


@dataclass(frozen=True, slots=True)
class Sample:
    """A gyro on the table."""

    name: str
    volt: float
    """True scale factor at small rates, deg/s/V."""
    bend: float = 0.0
    """Cubic term at 100 deg/s, relative to the rate."""

    @property
    def hidden(self) -> tuple[HiddenEffect, ...]:
        """The nonlinearity as an effect of the simulator."""
        return (HiddenEffect(scale_power(3), (self.bend / FULL_RATE_RAD_S**2,)),) if self.bend else ()

    def in_robot(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this gyro in the robot."""
        errors = replace(scenario.errors, scale_factor=self.volt / NOMINAL_VOLT)
        return replace(scenario, errors=errors)


SAMPLES = (
    Sample('sample 1', 135.40),
    Sample('sample 2', 135.48),
    Sample('sample 3', 135.56),
    Sample('bent', 135.48, BEND),
)
"""Gyros with scale factors in the range of the paper's figure."""


@dataclass(frozen=True, slots=True, eq=False)
class SampleResult:
    """Results of one gyro on the table and in the robot."""

    sample: Sample
    volt: Array
    """(r,) scale factor at each rate of the table, deg/s/V."""
    volt_std: Array
    bend_percent: float
    """Cubic term at 100 deg/s, in per cent of the rate, estimated in five minutes of cleaning."""
    bend_std_percent: float
    verdict: str
    named: tuple[str, ...]
    """Effects that the diagnosis reports as missing."""


@dataclass(frozen=True, slots=True, eq=False)
class RateTable:
    """The figure."""

    rates_deg_s: Array
    samples: tuple[SampleResult, ...]
    claims: tuple[Claim, ...]


def figure_8(each: Mapper, seeds: int) -> RateTable:
    """Examine every sample on the table and in a robot; the seed of each is its index."""
    results = tuple(each(_examine, list(enumerate(SAMPLES))))
    straight, bent = results[:-1], results[-1]
    spread = max(float(np.ptp(result.volt)) for result in straight)
    claims = (
        assess(
            'the scale factor is the same at all rates, 20 to 90 deg/s',
            'almost; drawn between 135.3 and 135.7',
            f'within {spread:.3f} deg/s/V at worst',
            spread < 0.1,
        ),
        assess(
            'so a function of first order is enough, for the diagnosis too',
            'by the figure',
            '; '.join(_describe(result) for result in straight),
            all(result.verdict == 'nothing_missing' for result in straight),
        ),
        assess(
            f'a part bent by {100.0 * BEND:.1f} % at 100 deg/s is found without a rate table',
            'not tried',
            _describe(bent),
            bent.named[:1] == (CUBIC,),
        ),
    )
    return RateTable(RATES_DEG_S, results, claims)


def measure_on_table(sample: Sample, seed: int) -> tuple[Array, Array]:
    """Return the scale factors (r,) in deg/s/V at the rates of the table, with their standard deviations.

    The bias is that of the rests before and after each rate.
    """
    source = SimSource(sample.in_robot(_table_scenario()), seed, hidden=sample.hidden)
    samples = [item for item in source.measurements() if isinstance(item, ImuSample)]
    time_s = np.array([item.t_ns - START_NS for item in samples]) / NS_PER_S
    rate = np.degrees([item.rate_rad_s[2] for item in samples])
    period_s = REST_S + 2.0 * GLIDE_S + HOLD_S
    rests_s = period_s * np.arange(len(RATES_DEG_S) + 1)
    rests = [_mean(time_s, rate, one_s, one_s + REST_S) for one_s in rests_s]
    zeros, zero_stds = np.array(rests).T
    from_s = rests_s[:-1] + REST_S + GLIDE_S
    read, read_std = np.array([_mean(time_s, rate, one_s, one_s + HOLD_S) for one_s in from_s]).T
    nominal = read - 0.5 * (zeros[1:] + zeros[:-1])
    std = np.sqrt(read_std**2 + 0.25 * (zero_stds[1:] ** 2 + zero_stds[:-1] ** 2))
    volt = NOMINAL_VOLT * RATES_DEG_S / nominal
    return volt, volt * std / nominal


def _table_scenario() -> Scenario:
    legs = tuple(
        leg
        for rate in np.radians(RATES_DEG_S).tolist()
        for leg in (Leg(REST_S), Leg(GLIDE_S, 0.0, rate), Leg(HOLD_S, 0.0, rate), Leg(GLIDE_S))
    )
    rounds_s = sum(leg.duration_s for leg in legs)
    return replace(
        find_scenario('standing'),
        legs=legs,
        standing_s=1e-3,
        duration_s=rounds_s + REST_S,
        imu_hz=100,
        camera_until_s=0.0,
        floor_tilt_deg=0.0,
        bumps=0,
    )


def _mean(time_s: Array, values: Array, from_s: float, to_s: float) -> tuple[float, float]:
    """Return the mean over an interval without half a second at both ends, and its standard deviation."""
    inside = values[(time_s > from_s + 0.5) & (time_s < to_s - 0.5)]
    return float(inside.mean()), float(inside.std(ddof=1) / math.sqrt(len(inside)))


def _examine(task: tuple[int, Sample]) -> SampleResult:
    seed, sample = task
    volt, volt_std = measure_on_table(sample, seed)
    scenario = sample.in_robot(find_scenario('cleaning'))
    simulated = SimSource(scenario, seed, hidden=sample.hidden)
    source, config = preload(simulated, Config(), default_model())
    recorded = summarise_recording(source)
    searched = search(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    found = diagnose(searched, recorded)
    cubic = next(item for item in searched.first.ranked if item.effect.name == CUBIC)
    to_percent = 100.0 * FULL_RATE_RAD_S**2
    return SampleResult(
        sample=sample,
        volt=volt,
        volt_std=volt_std,
        bend_percent=to_percent * float(estimate(cubic)[0]),
        bend_std_percent=to_percent * float(estimate_stds(cubic)[0]),
        verdict=found.verdict,
        named=tuple(missing.effect.name for missing in found.missing),
    )


def _describe(result: SampleResult) -> str:
    answer = ', '.join(result.named) or result.verdict.replace('_', ' ')
    return f'{result.sample.name}: {result.bend_percent:+.3f} ± {result.bend_std_percent:.3f} % ({answer})'
