"""What a model leaves unexplained, in words: the likeliest law that the library lacks, confirmed by a run."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import reduce
from itertools import combinations

import numpy as np

from gyrocal_ros.diagnose.analysis import shapes
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, unusual_noises, without_effect
from gyrocal_ros.diagnose.analysis.heading_filter import heading_log_likelihood, headings
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.analysis.shapes import ErrorShape, UnexplainedStructure, unexplained_structure
from gyrocal_ros.diagnose.laws.closed_forms import learned_curve
from gyrocal_ros.diagnose.laws.learning import MIN_GAIN, is_missing_something, likeliest_law
from gyrocal_ros.diagnose.noise import LAW_PART
from gyrocal_ros.diagnose.search.additions import Addition, Search
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.effects.learned.curve import Curve
from gyrocal_ros.effects.learned.drives import DYNAMICS, START
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.memory import ExponentialBank, drive_as_noun
from gyrocal_ros.effects.learned.place_map import PlaceMap
from gyrocal_ros.effects.learned.signals import CENTRIPETAL, GROWING_LAG, HEADING, RATE
from gyrocal_ros.effects.learned.step import Step
from gyrocal_ros.effects.learned.wave import Wave
from gyrocal_ros.effects.traits import are_twins, follows_signal, is_limit, is_noise
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.model.recording import TEMPERATURE, RecordingSummary
from gyrocal_ros.model.sensor import TypicalRange

UNUSUAL = 3.0
"""Factor beyond the usual values of a coefficient from which it is unusual."""
SHOWN = 10
"""Distance of the points of a curve that are shown."""
PLACE = 'the place in the map'
SIGNALS = {
    RATE: shapes.RATE,
    HEADING: shapes.HEADING,
    TEMPERATURE: shapes.TEMPERATURE_C,
    'time': shapes.TIME,
    'force_x': shapes.FORCE,
    'force_y': 'sideways acceleration (m/s^2)',
    'force_z': 'vertical acceleration (m/s^2)',
    'yaw_acceleration': 'yaw acceleration (rad/s^2)',
    GROWING_LAG: 'rate times yaw acceleration (rad^2/s^3)',
    'vibration': 'vibration ((m/s^2)^2)',
    CENTRIPETAL: 'centripetal acceleration (m/s^2)',
    START: shapes.TIME,
    DYNAMICS: shapes.DYNAMICS,
}
"""Signals that laws follow, in words; others have the name of topic and field."""


def name_unknown(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Return a search whose last model says which law explains best what it leaves unexplained.

    The headings of a run that lacks a law are bent by it, so what they seem to follow may be anything. The
    full filter weighs every law in one run, and one more run confirms the likeliest. Several wrong effects
    together may imitate a law: where it predicts as well without them, they are given up. So are an effect of
    a size that no gyro has, and two that look alike, where a law alone predicts better; where they need a law
    beside them, as well.

    Args:
        searched: a finished search in the library.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    last = searched.last
    is_missing = is_missing_something(last) and not (mounting_fault(last.run) or _is_explained(searched))
    is_doubtful = _are_twins(searched) or (not is_missing and _is_unusual(searched))
    is_doubtful = is_doubtful or any(item.together_with for item in searched.kept)
    if not (is_missing or is_doubtful or _may_imitate(searched)):
        return searched
    beside = likeliest_law(last, recording, calibrate) if is_missing else None
    alone = likeliest_law(searched.first, recording, calibrate) if last is not searched.first else None
    needed = beside if beside is not None and beside.is_kept else None
    best = _without_leftover(searched) if needed is None else needed.after.run
    least = MIN_GAIN if is_doubtful and needed is None else -MIN_GAIN
    if alone is not None and alone.is_kept and _gain(best, alone.after.run) > least:
        recovered = [item for item in searched.additions if item.before is None]
        return _saying(Search(searched.first, tuple(recovered)), alone)
    # Where the headings show structure, a law that explains but a part of it is nearer to the cause.
    has_structure = last.unexplained_structure is not None
    if beside is not None and (beside.is_kept or (has_structure and beside.predictive_gain > MIN_GAIN)):
        return _saying(searched, beside)
    behind = _behind_noise(last) if is_missing else None
    return searched if behind is None else searched.with_last(replace(last, unexplained_structure=behind))


def _behind_noise(examined: ExaminedModel) -> UnexplainedStructure | None:
    """Return what the bias follows in a run with a noise that no gyro has; None where no signal does.

    With the noise the filter follows a slow law as well as with the law, but the headings of the run are
    right, and with the usual noise they show it.
    """
    noises = unusual_noises(examined.model)
    usual = reduce(without_effect, [effect.name for effect in noises], examined.model)
    seen, settings = headings(replace(examined.run, model=usual), examined.settings), examined.settings
    found = unexplained_structure(examined.run, seen, settings) if noises else None
    gain = heading_log_likelihood(examined.seen) - heading_log_likelihood(seen)
    is_law = found is not None and found.at_s is None and found.gain > LAW_PART * gain
    return found if is_law else None


def _is_explained(searched: Search) -> bool:
    """Return True if with the effects that were found the model fits, and owes that to no noise."""
    last = searched.last
    is_strange = bool(unusual_noises(last.model))
    return len(searched.kept) > 0 and not is_strange and model_fit(last.run).fits is not False


def _is_unusual(searched: Search) -> bool:
    """Return True if an effect that was found has a size, or a time constant, that hardly any sensor has."""
    return any(
        _is_unusual_value(usual, value)
        for item in searched.kept
        if not (is_noise(item.effect) or is_limit(item.effect))
        for usual, value in zip(
            (coefficient.typical for coefficient in item.effect.coefficients),
            searched.last.estimate_of(item.effect.name)[0].tolist(),
            strict=True,
        )
        if usual is not None
    )


def _is_unusual_value(usual: TypicalRange, value: float) -> bool:
    is_short = not usual.is_strength and abs(value) < usual.low / UNUSUAL
    return is_short or abs(value) > UNUSUAL * usual.high


def _may_imitate(searched: Search) -> bool:
    """Return True for several effects that together may imitate a law that none of them shows.

    These are effects that follow signals, and several with a noise, which takes what they leave.
    """
    kept = [item.effect for item in searched.kept]
    laws = [effect for effect in kept if not is_noise(effect)]
    are_suspect = all(map(follows_signal, laws)) or len(laws) < len(kept)
    return len(laws) > 1 and are_suspect and timing_fault(searched.last) is None


def _are_twins(searched: Search) -> bool:
    """Return True if two effects were found of which one, of the gyro, is easily taken for the other.

    Each may stand for a part of one law: a low-pass of second order looks like a lag and a time offset.
    """
    kept = [item.effect for item in searched.kept]
    pairs = [pair for pair in combinations(kept, 2) if 'gyro' in (effect.acts_on for effect in pair)]
    return any(are_twins(*pair) for pair in pairs) and timing_fault(searched.last) is None


def _without_leftover(searched: Search) -> Run:
    """Return the run with all that was found, but for a noise that took what several effects had left."""
    *effects, last = searched.kept or (None,)
    if len(effects) < 2 or last is None or last.before is None or not is_noise(last.effect):
        return searched.last.run
    return last.before.run


def _gain(before: Run, after: Run) -> float:
    """Return the predictive log-likelihood that one run gains over another."""
    return float(predictive_gain(before, after).sum())


def _saying(searched: Search, law: Addition) -> Search:
    """Return a search whose last model leaves a law unexplained."""
    return searched.with_last(replace(searched.last, unexplained_structure=structure_of(law)))


def structure_of(law: Addition) -> UnexplainedStructure:
    """Describe a law that a run confirmed."""
    effect = law.effect
    kind, _, follows = effect.name.partition(':')
    of = kind.partition('_')[0]
    signal = PLACE if isinstance(effect, PlaceMap) else SIGNALS.get(follows, drive_as_noun(follows))
    at_s, shape = None, ErrorShape(signal, of == 'scale', *np.empty((3, 0)))
    what = f'the {of} goes with {signal}'
    values = law.after.estimate_of(effect.name)[0]
    if isinstance(effect, Step):
        at_s = effect.at_s
        what = f'the {of} jumped by {_in_words(of, float(values[0]), "+")} at {at_s:.0f} s'
    elif isinstance(effect, Wave):
        amplitude = _in_words(of, float(np.hypot(values[0], values[len(values) // 2])))
        what = f'the {of} oscillates with an amplitude of {amplitude} and a period of {effect.period_s:.1f} s'
    elif (event := event_of(follows)) is not None:
        what = f'the {of} changes after {event.in_words}, and fades'
    elif isinstance(effect, ExponentialBank) and effect.over == 'response':
        what = f'the {of} goes with earlier values of {signal}'
    if isinstance(effect, Curve):
        learned = learned_curve(law.after, effect)
        every = slice(None, None, SHOWN)
        shape = replace(shape, knots=learned.x[every], values=learned.y[every], stds=learned.std[every])
    return UnexplainedStructure(what, law.predictive_gain, law.sigma, shape, at_s, is_confirmed=True)


def _in_words(of: str, size: float, sign: str = '') -> str:
    """Return the size of a change of the scale (1), or of the bias (rad/s)."""
    return f'{100.0 * size:{sign}.2f} %' if of == 'scale' else f'{math.degrees(size):{sign}.3f} deg/s'
