"""Table 1 and Fig. 11: the heading error after ten rotations and after ten minutes, the camera off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.camera_off import Drift, minutes, rotations
from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assess
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.sensors import SensorErrors, stream, with_bias_walk

PAPER_NOMINAL_DEG = np.array([24.73, 23.33, 23.70, 23.61, 24.23, -25.92, -25.78, -25.81, -25.34, -25.63])
PAPER_CALIBRATED_DEG = np.array([-0.17, -1.57, -1.20, -1.29, -0.68, 0.59, 0.76, 0.74, 1.17, 0.91])
"""Table 1 of the paper."""
NOMINAL_ERROR = 24.83 / 3600.0
"""Relative error of the scale factor of the data sheet, as implied by the paper's table: 0.69 %."""
RUNS = 10
"""Number of runs of Table 1."""
PARTS, REPEATS = 4, 3
"""Number of parts of Fig. 11, and of runs with each."""
F_TEST_RATIO = 1.68
"""Ratio of two standard deviations of 12 runs that chance exceeds in five of a hundred cases (F test)."""
SPREAD = 0.01
"""Standard deviation of the scale factors of parts, relative to that of the data sheet."""


@dataclass(frozen=True, slots=True, eq=False)
class HeadingTable:
    """Table 1. Errors in degrees, ten runs, five to each side: heading by the gyro less the truth."""

    nominal_deg: Array
    """(10,)"""
    calibrated_deg: Array
    every_calibrated_deg: Array
    """(2 n,) calibrated errors of all seeds, to both sides."""
    claims: tuple[Claim, ...]


@dataclass(frozen=True, slots=True)
class Gyro:
    """Noise of a gyro by its data sheet."""

    name: str
    noise_deg_s: float
    """Density, deg/s/sqrt(Hz)."""
    stability_deg_h: float
    """In-run bias stability: the minimum of the Allan deviation."""

    def in_robot(self, errors: SensorErrors) -> SensorErrors:
        """Return the errors of a robot with this gyro; the wander of its bias gives the Allan deviation.

        White noise N and a random walk K have the minimum Allan deviation B with B^2 = 2 N K / sqrt(3). Over
        times much shorter than its correlation time the wander of the simulator is such a random walk.
        """
        errors = with_bias_walk(errors, self.walk_deg_s, errors.bias_wander_time_s)
        return replace(errors, rate_noise_deg_s=self.noise_deg_s)

    @property
    def walk_deg_s(self) -> float:
        """Random walk of the bias, deg/s/sqrt(s)."""
        return math.sqrt(3.0) * (self.stability_deg_h / 3600.0) ** 2 / (2.0 * self.noise_deg_s)

    def configure(self, config: Config) -> Config:
        """Return settings with the noise of the data sheet."""
        gyro = replace(config.gyro, rate_noise_deg_s=self.noise_deg_s, bias_walk_deg_s=self.walk_deg_s)
        return replace(config, gyro=gyro)


GYROS = (
    Gyro('BMI088', 0.014, 2.0),
    Gyro('the usual simulated one', SensorErrors().rate_noise_deg_s, 5.3),
    Gyro('ADIS16470', 0.008, 8.0),
)
"""Gyros by the data sheets of Bosch Sensortec and Analog Devices; the second one has the default noise of
`SensorErrors`."""


@dataclass(frozen=True, slots=True, eq=False)
class TenMinutes:
    """Heading errors in degrees after ten minutes of cleaning with one kind of gyro."""

    gyro: Gyro
    wander_deg_h: float
    """Standard deviation of the bias about the turn-on offset."""
    calibrated_deg: Array
    """(12,) errors of four parts with three runs each."""
    nominal_deg: Array
    parts: Array
    """(12,) true scale factor over that of the data sheet."""


@dataclass(frozen=True, slots=True, eq=False)
class Histograms:
    """Fig. 11."""

    kinds: tuple[TenMinutes, ...]
    claims: tuple[Claim, ...]


def table_1(each: Mapper, seeds: int) -> HeadingTable:
    """Reproduce the table with ten runs, hence at least ten seeds; more seeds give the error of the mean."""
    drifts = list(each(_spin, list(range(seeds))))
    rows = [_heading_errors(pair, 1.0 if run < RUNS // 2 else -1.0) for run, pair in enumerate(drifts[:RUNS])]
    calibrated, nominal = np.degrees(rows).T
    every = np.degrees(np.concatenate([drift.heading_rad for drift, _ in drifts]))
    mean = float(np.abs(every).mean())
    mean_std = float(np.abs(every).std(ddof=1) / math.sqrt(len(every)))
    share = float(np.abs(calibrated).mean() / np.abs(nominal).mean())
    claims = (
        assess(
            'nominal scale factor: mean absolute error after ten rotations',
            f'{np.abs(PAPER_NOMINAL_DEG).mean():.2f} deg (printed: 24.83)',
            f'{np.abs(nominal).mean():.2f} deg, with the error of {100.0 * NOMINAL_ERROR:.2f} % that the '
            'table implies',
            abs(float(np.abs(nominal).mean()) - 24.83) < 1.0,
        ),
        assess(
            'calibrated: mean absolute error',
            f'{np.abs(PAPER_CALIBRATED_DEG).mean():.2f} deg (printed: 0.99)',
            f'{np.abs(calibrated).mean():.2f} deg, worst {np.abs(calibrated).max():.2f}; over '
            f'{len(every)} spins {mean:.2f} ± {mean_std:.2f}, worst {np.abs(every).max():.2f}',
            float(np.abs(calibrated).mean()) < 0.99,
        ),
        assess(
            'the error falls to 0.4 % of what it was',
            '0.4 % in the text, 4.0 % by its table',
            f'{100.0 * share:.1f} %',
            share < 0.004,
        ),
    )
    return HeadingTable(nominal, calibrated, every, claims)


def figure_11(each: Mapper, seeds: int) -> Histograms:
    """Reproduce the figure with four parts and three runs each, for any number of seeds."""
    tasks = [(gyro, number) for gyro in GYROS for number in range(PARTS * REPEATS)]
    rows = np.array(list(each(_clean, tasks))).reshape(len(GYROS), PARTS * REPEATS, 2)
    wanders = [gyro.in_robot(SensorErrors()).bias_wander_deg_h for gyro in GYROS]
    parts = np.array([part_of(number) for number in range(PARTS * REPEATS)])
    kinds = tuple(
        TenMinutes(gyro, wander, np.degrees(found[:, 0]), np.degrees(found[:, 1]), parts)
        for gyro, wander, found in zip(GYROS, wanders, rows, strict=True)
    )
    calibrated = tuple(_after_ten_minutes(kind) for kind in kinds)
    nominal = kinds[0].nominal_deg
    uncalibrated = assess(
        'uncalibrated: varies much from part to part',
        'histogram within ±10 deg',
        f'mean {nominal.mean():.1f}, sd {nominal.std(ddof=1):.1f} deg',
        float(nominal.std(ddof=1)) > 3.0 * float(kinds[0].calibrated_deg.std(ddof=1)),
    )
    return Histograms(kinds, (*calibrated, uncalibrated))


def part_of(number: int) -> float:
    """Return the true scale factor over that of the data sheet, for the part in run 0 to 11."""
    return 1.0 + SPREAD * float(stream(number // REPEATS, 'part').standard_normal())


def _after_ten_minutes(kind: TenMinutes) -> Claim:
    mean, sd = float(kind.calibrated_deg.mean()), float(kind.calibrated_deg.std(ddof=1))
    return assess(
        f'calibrated, with the noise of {kind.gyro.name} ({kind.gyro.noise_deg_s:g} deg/s/sqrt(Hz), '
        f'{kind.gyro.stability_deg_h:g} deg/h)',
        'mean -0.18, sd 0.91 deg',
        f'mean {mean:+.2f}, sd {sd:.2f} deg, worst {np.abs(kind.calibrated_deg).max():.2f}',
        abs(mean) < 0.5 and sd < F_TEST_RATIO * 0.91,
    )


def _heading_errors(pair: Sequence[Drift], side: float) -> tuple[float, ...]:
    """Return the errors, calibrated and nominal, of the spins to one side, left being positive."""
    interval = int(np.flatnonzero(np.sign(pair[0].turned_rad) == side)[0])
    return tuple(float(drift.heading_rad[interval]) for drift in pair)


def _spin(seed: int) -> tuple[Drift, Drift]:
    spins = find_scenario('blind_spins')
    return rotations(_with_errors(spins, replace(spins.errors, scale_factor=1.0 - NOMINAL_ERROR)), seed)


def _clean(task: tuple[Gyro, int]) -> tuple[float, float]:
    gyro, number = task
    cleaning = find_scenario('blind_cleaning')
    errors = replace(gyro.in_robot(cleaning.errors), scale_factor=part_of(number))
    calibrated, nominal = minutes(_with_errors(cleaning, errors), number, gyro.configure(Config()))
    return float(calibrated.heading_rad[0]), float(nominal.heading_rad[0])


def _with_errors(scenario: Scenario, errors: SensorErrors) -> Scenario:
    return replace(scenario, errors=errors)
