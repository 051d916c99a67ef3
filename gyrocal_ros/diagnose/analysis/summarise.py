"""Summary of a recording: its signals and its raw gyro readings."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CovariateSample,
    FeatureObservations,
    ImuSample,
    Source,
    TemperatureSample,
    WheelSample,
)
from gyrocal_ros.diagnose.analysis.signal_ranges import signal_ranges
from gyrocal_ros.model.image_turn import turn_between
from gyrocal_ros.model.recording import (
    SPEED_SIGNAL,
    TEMPERATURE,
    GyroReadings,
    ImageTurns,
    RecordingSummary,
    Signal,
)
from gyrocal_ros.pipeline.in_memory import known_reference
from gyrocal_ros.statistics import robust_std

MAX_SIGNALS = 24
"""Maximum number of recorded signals to try; those that vary most relative to their mean are taken."""
MIN_VARIATION = 1e-6
"""Standard deviation, relative to the mean, above which a signal varies."""
SLOW_RAD_S = math.radians(2.0)
"""Rates below this are used to estimate the quantisation step."""
MIN_SLOW, MIN_DISTINCT = 200, 10
"""Minimum number of slow readings, and of distinct values, for estimating the quantisation step."""
ROUNDING = 1e-6
"""Distances of readings below this part of the largest one are rounding errors of arithmetic."""
UNEVEN, EVEN_PART = 0.02, 0.99
"""Largest distance of a gap from a whole number of steps, and the part of the gaps that must keep it."""
REPEATED, MOST_STEPS = 0.5, 1.5
"""Part of slow readings that repeat the one before where the noise is below a third of a step, and bound of
the median change of the others, in steps."""

TURNING_RAD_S = math.radians(20.0)
"""Rate from which a robot turns."""
MEAN_S, MIN_MEANS = 1.0, 40
"""Time over which a vibration averages out, and the minimum number of such means."""
SLOWEST_PART = 0.25
"""Part of the means that tells of a walk of the bias."""
VIBRATES = 0.5
"""Noise of means over that time, relative to that of the readings, below which these vibrate."""


def coarse_step(readings: GyroReadings) -> float | None:
    """Return the quantisation step (rad/s) of the gyro where it is wider than the noise, else None.

    With noise, the mean of many readings resolves far less than a step; without, a rate between two steps
    is read as the same wrong number throughout.
    """
    rate = readings.rate_rad_s
    slow = np.abs(rate) < SLOW_RAD_S
    steps = np.abs(np.diff(rate))[slow[1:] & slow[:-1]]
    gaps = np.diff(np.unique(rate))
    gaps = gaps[gaps > ROUNDING * gaps.max(initial=0.0)]
    if len(steps) < MIN_SLOW or len(gaps) < MIN_DISTINCT:
        return None
    step = float(gaps.min())
    is_even = np.abs(gaps / step - np.round(gaps / step)) < UNEVEN
    repeats = steps < 0.5 * step
    # A dead band repeats its zeros as well, but what it lets through has noise of many steps.
    is_wide = repeats.all() or float(np.median(steps[~repeats])) < MOST_STEPS * step
    return step if is_even.mean() > EVEN_PART and repeats.mean() > REPEATED and is_wide else None


def white_noise(readings: GyroReadings) -> float:
    """Return the density of the white noise of the readings, rad/s/sqrt(Hz); NaN for a few readings.

    A vibration is no white noise: its means over a second scatter far less than single readings say.
    """
    rate = readings.rate_rad_s
    if len(rate) < MIN_SLOW:
        return math.nan
    interval_s = float(np.median(np.diff(readings.t_ns))) / NS_PER_S
    density, count = _density(rate, interval_s), _readings_per_mean(readings)
    if count < 2 or len(rate) < MIN_MEANS * count:
        return density
    weights = np.hanning(count + 2)[1:-1]  # leaves less of a vibration than equal ones
    weights /= weights.sum()
    means = rate[: len(rate) // count * count].reshape(-1, count) @ weights
    of_means = _density(means, interval_s / float(weights @ weights))
    return of_means if of_means < VIBRATES * density else density


def walk_of_means(readings: GyroReadings) -> float:
    """Return the largest random walk of the bias, rad/s/sqrt(s), that readings show; NaN for a few readings.

    Second differences of successive means over T of a walk q have the variance `q^2 T`. The slowest quarter
    counts; what the robot does there makes them larger, never smaller.
    """
    count = _readings_per_mean(readings) if len(readings.rate_rad_s) >= MIN_SLOW else 0
    if count < 1 or len(readings.rate_rad_s) < MIN_MEANS * count:
        return math.nan
    rate = readings.rate_rad_s
    bends, speeds = _bends(rate[: len(rate) // count * count].reshape(-1, count).mean(axis=1))
    slow = bends[speeds <= np.quantile(speeds, SLOWEST_PART)]
    return math.sqrt(float(np.mean(slow**2)) / MEAN_S)


def scatter_in_turns(readings: GyroReadings) -> tuple[float, float]:
    """Return the median rate of turns (rad/s), and the density of the scatter of the readings in them.

    The density is in rad/s/sqrt(Hz) as if the scatter were white noise; NaN for a few readings.
    """
    rate = readings.rate_rad_s
    bends, speeds = _bends(rate)
    turning = speeds > TURNING_RAD_S
    if np.count_nonzero(turning) < MIN_SLOW:
        return math.nan, math.nan
    interval_s = float(np.median(np.diff(readings.t_ns))) / NS_PER_S
    return float(np.median(speeds[turning])), robust_std(bends[turning]) * math.sqrt(interval_s / 6.0)


def _density(rate_rad_s: Array, interval_s: float) -> float:
    """Return the density of the white noise of a rate (N,).

    That of the slower or of the faster half counts, which is smaller: noise may grow with the rate, and a
    robot that keeps correcting its way turns by jerks while it drives straight on.
    """
    bends, speeds = _bends(rate_rad_s)
    is_slow = speeds <= np.median(speeds)
    halves = [bends[half] for half in (is_slow, ~is_slow) if half.any()]
    return min(robust_std(half) for half in halves) * math.sqrt(interval_s / 6.0)


def _readings_per_mean(readings: GyroReadings) -> int:
    """Return the number of readings of a mean over `MEAN_S`."""
    return int(len(readings.rate_rad_s) * MEAN_S * NS_PER_S / np.ptp(readings.t_ns))


def _bends(rate_rad_s: Array) -> tuple[Array, Array]:
    """Return the second differences (N - 2,) of a rate (N,), and the magnitude of the rate there.

    They contain neither the rate nor its steady change; their median leaves out the jerks.
    """
    before, middle, after = rate_rad_s[:-2], rate_rad_s[1:-1], rate_rad_s[2:]
    return after - 2.0 * middle + before, np.abs(after + middle + before) / 3.0


def summarise_recording(source: Source) -> RecordingSummary:
    """Read a source once and summarise what it holds."""
    values: dict[str, list[float]] = defaultdict(list)
    rates: list[tuple[int, float]] = []
    recorded = set()
    turns: list[tuple[int, int, float]] = []
    image: FeatureObservations | None = None
    for sample in source.measurements():
        if isinstance(sample, ImuSample):
            rates.append((sample.t_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, CovariateSample):
            values[sample.name].append(sample.value)
        elif isinstance(sample, WheelSample):
            values[SPEED_SIGNAL].append(sample.speed_m_s)
        elif isinstance(sample, TemperatureSample):
            recorded.add(TEMPERATURE)
        elif isinstance(sample, FeatureObservations):
            turn_rad = turn_between(image, sample) if image is not None else None
            if image is not None and turn_rad is not None:
                turns.append((image.t_ns, sample.t_ns, turn_rad))
            image = sample
    signals = [Signal(name, float(np.mean(column)), float(np.std(column))) for name, column in values.items()]
    varying = [signal for signal in signals if signal.spread > MIN_VARIATION * abs(signal.mean)]
    if len(varying) > MAX_SIGNALS:
        varying.sort(key=lambda signal: abs(signal.mean) / signal.spread)
    t_ns, rate = zip(*rates, strict=True) if rates else ((), ())
    reference = known_reference(source)
    return RecordingSummary(
        rig=source.rig,
        signals=tuple(varying[:MAX_SIGNALS]),
        left_out=tuple(signal.name for signal in varying[MAX_SIGNALS:]),
        recorded=frozenset(recorded | values.keys()),
        duration_s=source.span.duration_s,
        readings=GyroReadings(np.array(t_ns, np.int64), np.array(rate)),
        ranges=signal_ranges(source),
        image_turns=_as_turns(turns) if turns else None,
        certain=frozenset() if reference is None else reference.certain_effects,
    )


def _as_turns(turns: Sequence[tuple[int, int, float]]) -> ImageTurns:
    start_ns, end_ns, turn_rad = zip(*turns, strict=True)
    return ImageTurns(np.array(start_ns, np.int64), np.array(end_ns, np.int64), np.array(turn_rad))
