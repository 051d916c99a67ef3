"""Fits of noise to the headings of a run: the size of each that makes them likeliest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, with_effect
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, heading_log_likelihood
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.search.additions import NONE, Addition
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import follows_signal, is_bias_walk, is_noise
from gyrocal_ros.ekf.noise.process_noise import YawNoise, yaw_noise_of
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.statistics import chi_square_tail, sigma_of

MIN_GAIN_OVER_WALK = 10.0
"""Log-likelihood of the headings that an effect which follows a recorded signal has to gain over a walk of
the bias, and the least of a walk that counts: many signals are recorded, and one that changes steadily looks
like most walks."""
STRIDES = (8, 4, 2, 1)
"""Distances between sizes of a scan that are tried, one after the other: the likelihood has one maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFit:
    """A noise of the size that makes the headings likeliest."""

    effect: Effect
    gain: float
    """Log-likelihood of the headings gained."""
    std: float
    """Standard deviation of the size, by the curvature of the log-likelihood."""

    @property
    def size(self) -> float:
        """Size of the noise, in the unit of its coefficient."""
        return self.effect.coefficients[0].prior_mean


def fit_noises(present: ExaminedModel) -> list[NoiseFit]:
    """Fit each noise that a model lacks to the headings of its run, the likeliest first."""
    return sorted(_fits(present), key=lambda item: item.gain, reverse=True)


def with_noise(
    present: ExaminedModel, noise: NoiseFit, recording: RecordingSummary, calibrate: Calibrate
) -> Addition:
    """Run the filter with a noise."""
    after = examine(with_effect(present.model, noise.effect), recording, calibrate, present.settings)
    p_value = chi_square_tail(2.0 * noise.gain, 1)
    return Addition(
        noise.effect, present, after, noise.gain, sigma_of(p_value), p_value, np.array([noise.std]), NONE
    )


def unless_a_walk_explains(added: Addition) -> Addition:
    """Return an addition with an objection where a walk of the bias explains what a recorded signal does."""
    if added.before is None or not follows_signal(added.effect):
        return added
    if not a_walk_explains(added.before, added.after):
        return added
    return replace(added, objection='a bias that walks more than the settings say explains as much')


def a_walk_explains(before: ExaminedModel, after: ExaminedModel) -> bool:
    """Return True if a walk of the bias explains the headings as well as what a model has beyond another."""
    explained = heading_log_likelihood(after.seen) - heading_log_likelihood(before.seen)
    walks = [item.gain for item in fit_noises(before) if is_bias_walk(item.effect)]
    by_walk = max(walks, default=0.0)
    return by_walk >= MIN_GAIN_OVER_WALK and explained <= by_walk + MIN_GAIN_OVER_WALK


def _fits(present: ExaminedModel) -> Iterator[NoiseFit]:
    have = {effect.name for effect in present.model.effects}
    without = heading_log_likelihood(present.seen)
    for effect in EFFECTS.values():
        if is_noise(effect) and effect.name not in have:
            yield _fitted(present, effect, without)


def _fitted(present: ExaminedModel, effect: Effect, without: float) -> NoiseFit:
    """Climb to the likeliest size of the scan in ever smaller strides, from the best of a coarse grid."""
    sizes = effect.coefficients[0].scan
    gains: dict[int, float] = {}
    places = [*range(0, len(sizes), STRIDES[0])]
    for finer in (*STRIDES[1:], 0):
        gains |= {place: _gain(present, effect, sizes[place]) - without for place in places}
        best = max(gains, key=lambda place: gains[place])
        near = (best - finer, best + finer)
        places = [place for place in near if 0 <= place < len(sizes) and place not in gains]
    return _at_maximum(effect, np.array(sizes), gains)


def _gain(present: ExaminedModel, effect: Effect, size: float) -> float:
    """Return the log-likelihood of the headings with a noise of a size beside those of the model."""
    model = with_effect(present.model, with_means(effect, (size,)))  # type: ignore[type-var]
    noise = _noise(present.seen, model, present)
    return heading_log_likelihood(
        replace(
            present.seen,
            rate_noise_rad_s=noise.density_rad_s,
            bias_walk_rad_s=noise.bias_walk_rad_s,
        )
    )


def _noise(seen: Headings, model: SensorModel, present: ExaminedModel) -> YawNoise:
    return yaw_noise_of(model, present.run.config.gyro, seen.turn_rad / seen.dt_s)


def _at_maximum(effect: Effect, sizes: Array, gains: Mapping[int, float]) -> NoiseFit:
    """Return the maximum of the parabola through the best size and its neighbours, on a logarithmic scale."""
    best = max(gains, key=lambda place: gains[place])
    place = min(max(best, 1), len(sizes) - 2)
    below, middle, above = (gains.get(near, -math.inf) for near in (place - 1, place, place + 1))
    step = math.log(sizes[place + 1] / sizes[place])
    curvature = max(2.0 * middle - below - above, 1e-9)
    shift = float(np.clip(0.5 * (above - below) / curvature, -1.0, 1.0))
    size = float(sizes[place]) * math.exp(shift * step)
    return NoiseFit(with_means(effect, (size,)), gains[best], size * step / math.sqrt(curvature))  # type: ignore[type-var]
