"""Noise as an explanation: the gyro is noisier than the settings say, and nothing else is missing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.additions import Addition, Search
from gyrocal_ros.diagnose.elimination import eliminate
from gyrocal_ros.diagnose.examined import Calibrate, ExaminedModel, examine, with_effect
from gyrocal_ros.diagnose.heading_filter import Headings, heading_log_likelihood
from gyrocal_ros.diagnose.learning import is_missing_something, likeliest_law
from gyrocal_ros.diagnose.model_fit import model_fit
from gyrocal_ros.diagnose.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.search import MAX_ADDITIONS, continued, search
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.diagnose.summarise import white_noise
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import is_noise
from gyrocal_ros.ekf.process_noise import YawNoise, yaw_noise_of
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.statistics import chi_square_tail, sigma_of

MIN_GAIN = 25.0
"""Log-likelihood that a noise, or a law beside it, has to gain: many are tried."""
JUMP_PART = 0.7
"""Part of the gain of a noise above which a single jump of the bias is preferred to it."""
RIVAL_PART = 0.85
"""Part of the best gain above which another noise is tried, where the robot drifts more with the best."""
SHOWN_NOISE = 3.0
"""Noise of the readings, relative to the settings, from which they show it; twice is common among parts."""
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


def find_missing(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int = MAX_ADDITIONS,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Search:
    """Find what a model lacks: effects, or noise where nothing else explains the recording; see `search`."""
    searched = or_noise(search(model, recording, calibrate, most, settings), recording, calibrate, most)
    return eliminate(searched, recording, calibrate)


def fit_noises(present: ExaminedModel) -> list[NoiseFit]:
    """Fit each noise that a model lacks to the headings of its run, the likeliest first."""
    return sorted(_fits(present), key=lambda item: item.gain, reverse=True)


def or_noise(
    searched: Search,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> Search:
    """Return a search in which noise takes the place of what was found, where noise predicts better.

    Noise that the readings themselves show needs no other proof. All other noise may be imitated by wrong
    effects and by process noise, and an unknown law looks like noise as long as it is not known. So it has to
    predict better than everything that was found, and not in one block of time alone, as for a jump; with it
    the model has to fit, and no unknown law may predict better. Then the search goes on beside the noise.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try.
    """
    first = searched.first
    is_shown = _reads_noisily(first, recording)
    is_recovered = bool(searched.additions) and searched.additions[0].before is None
    if is_recovered or not (is_shown or is_missing_something(first)):
        return searched
    explained = heading_log_likelihood(searched.last.seen) - heading_log_likelihood(first.seen)
    noises, structure = fit_noises(first), first.unexplained_structure
    if not noises or noises[0].gain < max(MIN_GAIN, 0.0 if is_shown else explained):
        return searched
    jump_gain = structure.gain if structure is not None and structure.at_s is not None else 0.0
    if not is_shown and jump_gain > JUMP_PART * noises[0].gain:
        return searched
    found = _first_kept(first, noises, recording, calibrate)
    if found is None or found.predictive_gain < MIN_GAIN:
        return searched
    if not is_shown and not _is_proven(found, searched, recording, calibrate):
        return searched
    return Search(first, tuple(continued([found], found.after, recording, calibrate, most)))


def _is_proven(found: Addition, searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> bool:
    """Return True if neither what was found, nor an unknown law, predicts as well as a noise."""
    gain = predictive_gain(searched.last.run, found.after.run)
    if float(gain.sum() - gain.max()) < MIN_GAIN or model_fit(found.after.run).fits is False:
        return False
    law = likeliest_law(searched.first, recording, calibrate)
    return law is None or float(predictive_gain(found.after.run, law.after.run).sum()) < MIN_GAIN


def _first_kept(
    first: ExaminedModel, noises: Sequence[NoiseFit], recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    """Run the filter with the likeliest noises; return the first with which it does not drift more."""
    for noise in noises:
        if noise.gain < RIVAL_PART * noises[0].gain:
            break
        with suppress(FilterDivergedError):
            found = _with_noise(first, noise, recording, calibrate)
            if found.is_kept:
                return found
    return None


def _reads_noisily(present: ExaminedModel, recording: RecordingSummary) -> bool:
    """Return True if the readings themselves are far noisier than the settings say.

    The filter takes such noise over, so nothing may contradict the model.
    """
    expected_rad_s = math.radians(present.run.config.gyro.rate_noise_deg_s)
    return white_noise(recording.readings) > SHOWN_NOISE * expected_rad_s


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


def _with_noise(
    first: ExaminedModel, noise: NoiseFit, recording: RecordingSummary, calibrate: Calibrate
) -> Addition:
    """Run the filter with a noise."""
    after = examine(with_effect(first.model, noise.effect), recording, calibrate, first.settings)
    p_value = chi_square_tail(2.0 * noise.gain, 1)
    none = np.empty(0, np.int64)
    return Addition(
        noise.effect, first, after, noise.gain, sigma_of(p_value), p_value, np.array([noise.std]), none
    )
