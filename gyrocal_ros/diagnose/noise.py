"""Noise as an explanation: the gyro is noisier than the settings say, and nothing else is missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from gyrocal_ros.diagnose.analysis.drift import better_sigma, drift_of_both, drift_of_both_deg
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, wider_model
from gyrocal_ros.diagnose.analysis.heading_filter import heading_log_likelihood
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure
from gyrocal_ros.diagnose.analysis.summarise import scatter_in_turns, walk_of_means, white_noise
from gyrocal_ros.diagnose.laws.learning import is_missing_something, likeliest_law
from gyrocal_ros.diagnose.search.additions import Addition, Search, addition
from gyrocal_ros.diagnose.search.alternatives import best_alternative, searched_again
from gyrocal_ros.diagnose.search.elimination import eliminate
from gyrocal_ros.diagnose.search.noise_fit import NoiseFit, fit_noises, with_noise
from gyrocal_ros.diagnose.search.recovery import first_run
from gyrocal_ros.diagnose.search.search import MAX_ADDITIONS, continued, search_from
from gyrocal_ros.diagnose.search.several import explained_by_several
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.learned.step import Step
from gyrocal_ros.effects.traits import is_unusual, is_white_noise
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import GyroReadings, RecordingSummary
from gyrocal_ros.model.sensor import SensorModel, with_means

MIN_GAIN = 25.0
"""Log-likelihood that a noise, or a law beside it, has to gain: many are tried."""
JUMP_PART = 0.7
"""Part of the gain of a noise above which a single jump of the bias is preferred to it."""
LAW_PART = 0.45
"""Part of the gain of a noise that no gyro has above which what the bias or the scale follows is preferred to
it: the signal need not explain all to be the cause."""
ALIKE_PART = 0.8
"""Part of the gain of a noise from which a law is named beside it: one recording cannot tell them apart."""
RIVAL_PART = 0.85
"""Part of the best gain above which another noise is tried, where the robot drifts more with the best."""
EFFECT_PART = 0.5
"""Part of the gain of a noise from which the best effect, significant or not, gets a run beside it."""
MORE_DRIFT = 2.0
"""Held-out drift with a noise, relative to that with effects, from which it does not take their place: a
filter that follows the bias predicts the next image as well as the law behind it."""
CLEARLY_LESS_SIGMA = 2.0
"""Significance from which the drift with a law is less than that with a noise, whose place it then takes."""
READ_PART = 0.4
"""Part of a white noise that the readings must show: a low-pass filter in the gyro may hide the rest."""
WALK_PART = 0.6
"""Part of a random walk of the bias that the readings must show; no filter hides it."""
SHOWN_NOISE = 3.0
"""Noise of the readings, relative to the settings, from which they show it; twice is common among parts."""


def find_missing(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int = MAX_ADDITIONS,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Search:
    """Find what a model lacks: effects, or noise where nothing else explains the recording; see `search`.

    White noise that the readings themselves show comes first: without it every error that it makes would look
    like something else.

    Raises:
        FilterDivergedError: the filter cannot run with this model.
    """
    first, additions = first_run(model, recording, calibrate, settings)
    shown = None if additions else shown_noise(first, recording, calibrate)
    if shown is None:
        return _effects_or_noise(first, additions, recording, calibrate, most)
    found = _effects_or_noise(shown.after, [], recording, calibrate, most - 1)
    return eliminate(replace(found, first=first, additions=(shown, *found.additions)), recording, calibrate)


def shown_noise(present: ExaminedModel, recording: RecordingSummary, calibrate: Calibrate) -> Addition | None:
    """Add white noise where the readings are far noisier than the model says; return None elsewhere.

    It needs no other proof. The filter takes it over, so nothing may contradict the model.
    """
    known_rad_s = float(yaw_noise_of(present.model, present.run.config.gyro, np.zeros(1)).density_rad_s[0])
    read_rad_s = white_noise(recording.readings)
    if not read_rad_s > SHOWN_NOISE * known_rad_s:
        return None
    noise = next((item for item in fit_noises(present) if is_white_noise(item.effect)), None)
    if noise is None or noise.gain < MIN_GAIN:
        return None
    noise = _no_larger(noise, math.sqrt(read_rad_s**2 - known_rad_s**2))
    with suppress(*CANNOT_RUN):
        found = replace(with_noise(present, noise, recording, calibrate), is_shown=True)
        return found if found.is_kept else None
    return None


def _fits_readings(noise: NoiseFit, readings: GyroReadings) -> bool:
    """Return False for a noise that would make the readings scatter far more than they do."""
    turn_rad_s, in_turns_rad_s = scatter_in_turns(readings)
    effect, size = noise.effect, np.array([noise.size])
    white = effect.density(np.array([0.0, turn_rad_s]), size)  # type: ignore[attr-defined]
    walk = effect.bias_walk(size)  # type: ignore[attr-defined]
    read = np.array([white_noise(readings), in_turns_rad_s])
    return not ((read < READ_PART * white).any() or walk_of_means(readings) < WALK_PART * walk)


def _no_larger(noise: NoiseFit, read_rad_s: float) -> NoiseFit:
    """Return a noise that makes the readings scatter by no more than they do.

    One that is fitted to headings contains what other effects do to these. Readings may scatter more than it,
    for a vibration hardly turns the robot.
    """
    density = noise.effect.density(np.zeros(1), np.array([noise.size]))  # type: ignore[attr-defined]
    size = noise.size * min(1.0, read_rad_s / float(density[0]))
    return replace(noise, effect=with_means(noise.effect, (size,)))


def _effects_or_noise(
    first: ExaminedModel,
    additions: list[Addition],
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> Search:
    """Find effects that a model lacks, or noise where nothing else explains the recording.

    Noise that is the smaller part of what is missing shows beside the effects that were found. A noise that
    is the larger part takes in what an effect does to the headings. So both are tried, noise beside what was
    found and noise in its place, and the one that predicts better is returned; that with the effects, too,
    where the robot drifts far less with them. Neither is tried where the stamps are at fault.
    """
    found = search_from(first, additions, recording, calibrate, most)
    if timing_fault(found.last) is None:
        found = searched_again(found, recording, calibrate, most)
    found = best_alternative(found, recording, calibrate, most)
    if timing_fault(found.last) is not None:
        return eliminate(found, recording, calibrate)
    if is_missing_something(found.last):
        found = explained_by_several(found, recording, calibrate)
    starts = [found, Search(found.last, ())] if found.kept else [found]
    tasks = [partial(or_noise, start, recording, calibrate, most) for start in starts]
    instead, *rest = side_by_side(calibrate, tasks)
    if not rest:
        return eliminate(instead, recording, calibrate)
    (noise,) = rest
    beside = replace(found, additions=(*found.additions, *noise.additions))
    beside = eliminate(beside, recording, calibrate)
    if instead is found:
        return beside
    instead = eliminate(instead, recording, calibrate)
    gain = float(predictive_gain(instead.last.run, beside.last.run).sum())
    noise_deg, beside_deg = drift_of_both_deg(instead.last.run, beside.last.run)
    return beside if gain > MIN_GAIN or noise_deg > MORE_DRIFT * beside_deg else instead


def or_noise(
    searched: Search,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> Search:
    """Return a search in which noise takes the place of what was found, where noise predicts better.

    Noise may be imitated by wrong effects and by process noise, and an unknown law looks like noise as long
    as it is not known. So it has to predict better than everything that was found, and not in one block of
    time alone, as for a jump; with it the model has to fit, and no unknown law may predict better. Then the
    search goes on beside the noise.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try.
    """
    first = searched.first
    is_recovered = bool(searched.additions) and searched.additions[0].before is None
    if is_recovered or not is_missing_something(first):
        return searched
    explained = heading_log_likelihood(searched.last.seen) - heading_log_likelihood(first.seen)
    noises = [noise for noise in fit_noises(first) if _fits_readings(noise, recording.readings)]
    structure = first.unexplained_structure
    if not noises or noises[0].gain < max(MIN_GAIN, explained):
        return searched
    if structure is not None and structure.gain > _part_of_law(structure, noises[0]) * noises[0].gain:
        return searched
    found = _first_kept(first, noises, recording, calibrate)
    if found is None or found.predictive_gain < MIN_GAIN:
        return searched
    rivals = _rivals(found, searched, recording, calibrate)
    if rivals is None or any(_is_better(rival, found) for rival in rivals):
        return searched
    found = replace(found, rival=_alike(rivals, found))
    return Search(first, tuple(continued([found], found.after, recording, calibrate, most)))


def _part_of_law(structure: UnexplainedStructure, noise: NoiseFit) -> float:
    """Return the part of the gain of a noise above which a structure is preferred to it."""
    if structure.at_s is not None:
        return JUMP_PART
    return LAW_PART if is_unusual(noise.effect, noise.size) else math.inf


def _rivals(
    found: Addition, searched: Search, recording: RecordingSummary, calibrate: Calibrate
) -> list[Addition] | None:
    """Return the likeliest law and effect beside a noise; None where what was found does as well as that."""
    gain = predictive_gain(searched.last.run, found.after.run)
    if float(gain.sum() - gain.max()) < MIN_GAIN or model_fit(found.after.run).fits is not True:
        return None
    first = searched.first
    rivals = [likeliest_law(first, recording, calibrate)]
    best = max(first.ranked, key=lambda item: item.fit.gain, default=None)
    if best is not None and best.fit.gain > EFFECT_PART * found.predictive_gain:
        with suppress(*CANNOT_RUN):
            wider = examine(wider_model(first, best.effect), recording, calibrate, first.settings)
            rivals.append(addition(first, wider))
    return [rival for rival in rivals if rival is not None]


def _alike(rivals: Sequence[Addition], found: Addition) -> Addition | None:
    """Return the law that predicts nearly as well as a noise; None without. A jump is one of many."""
    laws = [
        rival
        for rival in rivals
        if rival.effect.name not in EFFECTS
        and not isinstance(rival.effect, Step)
        and rival.predictive_gain > ALIKE_PART * found.predictive_gain
    ]
    return max(laws, key=lambda rival: rival.predictive_gain, default=None)


def _is_better(rival: Addition, found: Addition) -> bool:
    """Return True if a rival predicts better than a noise, or is kept and the robot drifts clearly less.

    A jump explains one moment with one number, where the noise follows whatever else there is. A law that
    itself is not kept has to predict clearly better.
    """
    drifts_less = better_sigma(*drift_of_both(found.after.run, rival.after.run)) > CLEARLY_LESS_SIGMA
    part = JUMP_PART if isinstance(rival.effect, Step) else 1.0
    more = 0.0 if rival.is_kept else MIN_GAIN
    return (rival.is_kept and drifts_less) or rival.predictive_gain >= part * found.predictive_gain + more


def _first_kept(
    first: ExaminedModel, noises: Sequence[NoiseFit], recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    """Run the filter with the likeliest noises; return the first with which it does not drift more."""
    for noise in noises:
        if noise.gain < RIVAL_PART * noises[0].gain:
            break
        with suppress(*CANNOT_RUN):
            found = with_noise(first, noise, recording, calibrate)
            if found.is_kept:
                return found
    return None
