"""The status of a result: green, yellow or red, with one sentence and the next step.

Command line, JSON, pages and studio show the same status. It is never green where the model does not fit.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from gyrocal_ros.diagnose.advice import (
    FINER_STEPS,
    MEND_STAMPS,
    RECORD,
    join,
    limits_in_words,
    twins_in_words,
)
from gyrocal_ros.diagnose.analysis.comparison import Comparison
from gyrocal_ros.diagnose.analysis.drift import SPAN_S, held_out_from_s
from gyrocal_ros.diagnose.analysis.ground_truth import truth_fault
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit, model_fit
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure
from gyrocal_ros.diagnose.diagnosis import BY_YAW, Diagnosis
from gyrocal_ros.diagnose.search.improvement import CHANCE_SIGMA, Improvement, change_in_words
from gyrocal_ros.diagnose.search.timing import TimingFault, timing_fault
from gyrocal_ros.effects.quantities import add_words
from gyrocal_ros.effects.traits import holds_once
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.turn_agreement import camera_knock, camera_yaw_fault
from gyrocal_ros.ekf.noise.noise_bank import MUCH_WALK, walks_more
from gyrocal_ros.ekf.watches.told_faults import told_fault
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.pipeline.calibration import Calibration

Level: TypeAlias = Literal['green', 'yellow', 'red']
TURNING_RAD_S = math.radians(1.0)
"""Rate above which the robot counts as turning: wide arcs have 2 deg/s."""
MIN_TURN_DEG, ENOUGH_TURN_DEG = 90.0, 360.0
"""Total turn to each side below which a recording shows one side only, and from which more of them are no
remedy."""
NOTHING_MISSING = 'Nothing is missing: all measurements agree with the model within chance.'
CANNOT_TELL = (
    'This recording cannot tell whether an effect is missing: '
    'too few effects of the library would show in it.'
)
DOES_NOT_FIT = 'the model does not fit this recording.'
"""The last words on a calibration that its own recording contradicts."""
TOO_SHORT = 'the recording is too short to judge the model'
MANY_GAPS = 3
"""Number of gaps of the gyro from which they are why a recording cannot tell."""
KNOWN_LATE = 'the scale factor was known too late to judge the heading without the camera'
SEE_LIMITS = 'Look at the settings of the gyro: a limit hides its bias, or its rate in fast turns.'
REPEAT = 'Diagnose a second recording: what is off there, too, is not chance.'
DIAGNOSE = 'Run `gyrocal diagnose` on this recording.'
ADD_NOISE = 'Add it with `gyrocal add` where right standard deviations count more than drift without images.'
LEARN = 'Run `gyrocal learn` on this recording: it learns what no effect of the library explains.'
OWN = (
    'No law of one recorded signal explains it either: record more signals, or write what the sensor does '
    'as an effect of your own (docs/your_own_effect.md).'
)
WHAT_HAPPENED = (
    'Find what swings or is switched at those times, and record it: then other recordings gain, too.'
)
LAW_OR_NOISE = (
    'Diagnose a second recording: a law shows there again, and `gyrocal learn --follows` finds it; noise '
    'differs. Until then let `gyrocal improve` add the noise.'
)
TEST = 'Test the model on another recording.'
LARGE_DRIFT_DEG = 1.0
"""Blind drift in a minute that is large, though noise or a limit of the gyro explains it."""
FIND_NOISE = (
    'Trust the heading only with the ceiling or the heading reference in view; look for what disturbs the '
    'gyro, and turn more slowly if it has a limit.'
)
MEND_KNOCK = 'Fasten the camera, measure its yaw again, and record again.'
MEND_YAW = 'Subtract that from the yaw of the camera in its transform, and record again.'
MORE_TURNS = 'Record more turns, both ways, with the ceiling or the heading reference in view.'


@dataclass(frozen=True, slots=True)
class Status:
    """A result in one sentence."""

    level: Level
    """green: can be used as it is; yellow: there is something to do first; red: not to be trusted."""
    sentence: str
    next_step: str = ''
    """Empty where nothing is left to do."""


@dataclass(frozen=True, slots=True)
class NextSteps:
    """What a user can do after a diagnosis, in the words of a command or of the studio."""

    add: str
    """Adds the effect `{name}`; on the command line with `{command}`."""
    add_several: str
    """Adds the effects `{names}`."""
    learn: str
    add_limit: str


COMMANDS = NextSteps(
    add='Add it with `{command}`, or let `gyrocal improve` add it and show the gain.',
    add_several='Let `gyrocal improve` add {names} and show the gain.',
    learn=LEARN,
    add_limit='Try it with `gyrocal improve`.',
)


def calibration_status(calibration: Calibration, run: Run, fit: ModelFit) -> Status:
    """Return whether a calibration can be used.

    Args:
        calibration: the result.
        run: the run that it is from.
        fit: whether the model fits the run.
    """
    criteria, converged_s = run.config.convergence, calibration.convergence_time_s
    threshold, (fault, remedy) = f'{100.0 * criteria.scale_std:g} %', _fault(run)
    if fit.misfits:
        return Status('red', f'Not to be trusted: {"; ".join(fit.misfits)}; {DOES_NOT_FIT}', DIAGNOSE)
    if converged_s is None:
        known = f'{100.0 * calibration.scale_factor_std:.3g} %'
        sentence = f'Not calibrated yet: the scale factor is known to {known} only, not to {threshold}'
        if fault:
            return Status('yellow', f'{sentence}; {fault}.', remedy)
        if fit.unseen:
            return Status('yellow', f'{sentence}; {fit.unseen}.', RECORD)
        if fit.drift_deg > LARGE_DRIFT_DEG:
            sentence += f'; {_drifts(fit)}'
        turned_enough = min(turned_deg(run)) > ENOUGH_TURN_DEG
        return Status('yellow', f'{sentence}.', DIAGNOSE if turned_enough else MORE_TURNS)
    if not calibration.converged and calibration.doubt:
        sentence = f'Not calibrated yet: {"; ".join(filter(None, (calibration.doubt, fault)))}.'
        return Status('yellow', sentence, remedy if fault else RECORD)
    if not calibration.converged:
        sentence = 'Not to be trusted: the innovations are larger than the filter expects.'
        return Status('red', sentence, 'Look at the warnings, the camera calibration and the time stamps.')
    sentence = f'Calibrated: the scale factor was known to {threshold} after {converged_s:.0f} s'
    left_deg, right_deg = turned_deg(run)
    if min(left_deg, right_deg) < MIN_TURN_DEG:
        side = 'right' if left_deg > right_deg else 'left'
        sentence += f', but the robot hardly turned to the {side}, so that an asymmetry cannot show.'
        return Status('yellow', sentence, f'Record turns to the {side}, too.')
    wrong, mend = (fault, remedy) if fault else truth_fault(run)
    if wrong:
        return Status('yellow', f'{sentence}, but {wrong}.', mend)
    if (walk := run.history.bias_walk[-1]) >= MUCH_WALK:
        return Status('yellow', f'{sentence}, but {walks_more(walk)}.', DIAGNOSE)
    is_large = fit.drift_deg > LARGE_DRIFT_DEG
    if fit.fits is None or (is_large and held_out_from_s(run) < converged_s):  # its spans began before
        return Status('yellow', f'{sentence}, but {_why_unsure(fit, run)}.', RECORD)
    if is_large:
        drifts = f'{_drifts(fit)}, which its noise and limits explain'
        return Status('yellow', f'{sentence}, but {drifts}.', FIND_NOISE)
    return Status('green', f'{sentence}.')


def _drifts(fit: ModelFit) -> str:
    return f'the heading drifts by {fit.drift_deg:.1f} deg in {SPAN_S:.0f} s without the camera'


def _why_unsure(fit: ModelFit, run: Run) -> str:
    """Return why the drift says little of a calibration, as a clause."""
    if fit.fits is not None:
        return KNOWN_LATE
    followed_s = run.history.time_s[run.history.scale_followed > 0]
    if fit.unseen or not len(followed_s):
        return _why_unjudged(fit)
    changed = f'the estimate of the scale factor changed at {followed_s[-1]:.0f} s'
    return f'{changed}, and too little was recorded since then to judge the model'


def _why_unjudged(fit: ModelFit) -> str:
    """Return why a recording cannot tell whether the model fits, as a clause."""
    without = (
        TOO_SHORT if fit.gaps < MANY_GAPS else f'the gyro has {fit.gaps} gaps, too many to judge the model'
    )
    return fit.unseen or without


def _fault(run: Run) -> tuple[str, str]:
    """Return what is wrong with camera or gyro, and what to do about it; both empty without."""
    found = [fault for fault in (told_fault(event.text) for event in run.events) if fault[0]]
    return (found[-1][0], _sentence(found[-1][1])) if found else ('', '')


def _sentence(clause: str) -> str:
    return f'{clause[:1].upper()}{clause[1:]}.'


def turned_deg(run: Run) -> tuple[float, float]:
    """Return the total turn to the left and to the right, in degrees, by the gyro while the robot turned."""
    left, right = map(math.degrees, run.history.turned_rad(TURNING_RAD_S))
    return left, right


def diagnosis_status(diagnosis: Diagnosis, steps: NextSteps = COMMANDS) -> Status:
    """Return the verdict of a diagnosis, and the next step in the words of those who ask."""
    if diagnosis.fit.mounting:
        fault, _, remedy = diagnosis.fit.mounting.partition('; ')
        sentence = f'Mounted or wired wrongly: {fault}. Effects cannot be judged until that is mended.'
        return Status('red', sentence, _sentence(remedy))
    if diagnosis.timing is not None:
        return _timing_status(diagnosis.timing)
    status = _status_of_effects(diagnosis, steps)
    imitated = all(item.effect.acts_on in BY_YAW for item in diagnosis.missing)
    is_all = diagnosis.verdict == 'cannot_tell' and imitated and diagnosis.fit.fits is not False
    if diagnosis.wrong_yaw and is_all:  # the yaw is why
        status = replace(status, sentence='')
    return _with_faults(status, diagnosis.wrong_yaw, diagnosis.knock)


def _with_faults(status: Status, wrong_yaw: str, knock: str) -> Status:
    """Return a status that tells first of a wrong yaw of the camera, and of a knock; itself without."""
    unjudged = ' Neither camera, wheels nor noise can be judged until that is mended.'
    for fault, then, next_step in ((knock, '', MEND_KNOCK), (wrong_yaw, unjudged, MEND_YAW)):
        if fault:
            level: Level = 'yellow' if status.level == 'green' else status.level
            status = Status(level, f'{_sentence(fault)}{then} {status.sentence}'.rstrip(), next_step)
    return status


def _status_of_effects(diagnosis: Diagnosis, steps: NextSteps) -> Status:
    sentence = _diagnosis_sentence(diagnosis)
    if diagnosis.verdict == 'nothing_missing':
        next_step = REPEAT if diagnosis.fails_where else (SEE_LIMITS if diagnosis.proven_limits else '')
        return Status('yellow' if next_step else 'green', sentence, next_step)
    if diagnosis.only_steps:
        return Status('red' if diagnosis.fit.fits is False else 'yellow', sentence, FINER_STEPS)
    if not diagnosis.is_open and (diagnosis.verdict == 'unexplained' or diagnosis.fit.fits is False):
        return Status('red', sentence, steps.learn)
    if diagnosis.verdict == 'noise' and (diagnosis.unusual_noise or diagnosis.harmful_noise):
        return Status('yellow', sentence, steps.learn)
    if diagnosis.verdict == 'noise' and diagnosis.rival_law:
        return Status('yellow', sentence, LAW_OR_NOISE)
    if diagnosis.missing:
        return Status('yellow', sentence, _adding([item.effect for item in diagnosis.missing], steps))
    if diagnosis.limits:
        return Status('yellow', sentence, steps.add_limit)
    return Status('yellow', sentence, RECORD)


def _adding(effects: Sequence[Effect], steps: NextSteps) -> str:
    """Return the step that adds effects."""
    if len(effects) > 1:
        return steps.add_several.format(names=join([effect.name for effect in effects]))
    return steps.add.format(name=effects[0].name, command=shlex.join(add_words(effects[0])))


def _timing_status(fault: TimingFault) -> Status:
    if fault.is_allowed_for:
        allowed = 'The filter allows for that, and nothing else is missing.'
        return Status('yellow', f'The time stamps are at fault: {fault}. {allowed}', MEND_STAMPS)
    return Status(
        'red',
        f'The time stamps are at fault: {fault}. Effects cannot be judged until that is mended.',
        MEND_STAMPS,
    )


def _diagnosis_sentence(diagnosis: Diagnosis) -> str:
    missing = {item.effect.name: item.confused_with for item in diagnosis.missing}
    is_unexplained = diagnosis.verdict == 'unexplained'
    if (missing or diagnosis.unexplained) and not is_unexplained and diagnosis.coarse_step_rad_s is not None:
        step = f'steps of {math.degrees(diagnosis.coarse_step_rad_s):.2g} deg/s'
        causes = join(['these', *missing], 'or')
        return f'The gyro reads in {step}, wider than its noise; {causes} cause the errors.'
    if diagnosis.verdict == 'noise' and (unusual := diagnosis.unusual_noise):
        return (
            f'The gyro seems noisier than any usual one ({join(unusual)}): a loose contact, or a law that '
            'nothing recorded shows.'
        )
    if diagnosis.verdict == 'noise' and (harmful := diagnosis.harmful_noise):
        return (
            f'It looks like noise ({join(harmful)}), but the robot drifts more with it: a loose contact, or '
            'a law that nothing recorded shows.'
        )
    if diagnosis.verdict == 'noise':
        noisy = f'the gyro is noisier than the settings say ({join([*missing])})'
        if diagnosis.rival_law:
            return f'Noise, or a law: {noisy}, or {diagnosis.rival_law}, which explains nearly as much.'
        return f'Only noise: {noisy}; no law is left.'
    otherwise = CANNOT_TELL if diagnosis.fit.fits is not None else _sentence(_why_unjudged(diagnosis.fit))
    if diagnosis.verdict == 'nothing_missing':
        otherwise = _nothing_missing(len(diagnosis.fails_where))
        if limits := diagnosis.proven_limits:
            otherwise = f'The readings prove {limits_in_words(limits)}, which costs little here. {otherwise}'
    elif diagnosis.limits:
        otherwise = f'The readings suggest a limit: {join([*diagnosis.limits], "or")}.'
    elif diagnosis.uneven:
        otherwise = (
            f'Something is missing: {diagnosis.uneven} would explain much of it, but not in all stretches of '
            'the recording alike.'
        )
    elif diagnosis.fit.misfits:
        otherwise = f'The model does not fit, for a reason not found: {"; ".join(diagnosis.fit.misfits)}.'
    sentence = missing_sentence(missing, diagnosis.unexplained if is_unexplained else None, otherwise)
    still = missing and not is_unexplained and not diagnosis.is_open and diagnosis.fit.fits is False
    return f'{sentence} The model still does not fit with it: see the next steps.' if still else sentence


def _nothing_missing(count: int) -> str:
    """Return the sentence for a model that lacks nothing but is off in some places by more than chance."""
    if count == 0:
        return NOTHING_MISSING
    places = 'one place, listed below, is' if count == 1 else f'{count} places, listed below, are'
    return f'The model fits as a whole; {places} off by more than chance.'


def missing_sentence(
    missing: Mapping[str, Sequence[str]],
    structure: UnexplainedStructure | None = None,
    otherwise: str = NOTHING_MISSING,
) -> str:
    """Return which effects a model lacks, in one or two sentences.

    Args:
        missing: names of missing effects, that which explains most first, each with the effects that this
            recording cannot distinguish from it.
        structure: unexplained structure, if there is any.
        otherwise: sentence for a model that lacks nothing.
    """
    listed = join([_with_twins(name, twins) for name, twins in missing.items()])
    sentences = [f'Missing: {listed}.'] if missing else []
    if structure is not None:
        what = f'{structure.what} ({structure.sigma:.0f} sigma)'
        sentences.append(f'No effect of the library explains this: {what}.')
    return ' '.join(sentences) or otherwise


def improvement_status(improved: Improvement) -> Status:
    """Return what was added to a model, and whether the error fell by more than chance."""
    run = improved.final.examined.run
    return _with_faults(_status_of_revisions(improved), camera_yaw_fault(run), camera_knock(run))


def _status_of_revisions(improved: Improvement) -> Status:
    names = [revision.effect.name for revision in improved.kept if revision.effect is not None]
    added = f'Added {join(names)}' if names else 'Nothing was added'
    timing = timing_fault(improved.final.examined)
    if timing is not None and not names:
        return _timing_status(timing)
    if improved.harmful:
        noise = f'the gyro has {join(list(improved.harmful))}, with which the robot drifts more'
        return Status('yellow', f'{added}: {noise}.', ADD_NOISE)
    final = improved.final.examined
    if model_fit(final.run).fits is False or final.unexplained_structure is not None:
        next_step = OWN if improved.has_learned else LEARN
        return Status('red', f'{added}, and the model still does not fit.', next_step)
    if not names:
        return Status('green', f'{added}: no effect improves the prediction of the recording.')
    once = [item.effect.name for item in improved.kept if item.effect is not None and holds_once(item.effect)]
    if once:
        return Status('yellow', f'{added}: {join(once)} holds for this recording only.', WHAT_HAPPENED)
    first, last = improved.kept[0].held_out, improved.final.held_out
    if len(improved.kept) == 1 or not math.isfinite(first.rms_deg) or not math.isfinite(last.rms_deg):
        return Status('green', f'{added}.')
    if improved.fell_sigma > CHANCE_SIGMA:
        change = f'from {first.rms_deg:.2f} to {last.rms_deg:.2f} deg'
        return Status('green', f'{added}: the held-out drift went {change}.')
    by_chance = ', which may be chance' if improved.fell_sigma > 0.0 else ''
    change = f'{change_in_words(first, last)}{by_chance}'
    return Status('yellow', f'{added}: the recording is predicted better; {change}.', TEST)


def comparison_status(comparison: Comparison) -> Status:
    """Return which model is best, and whether that is more than chance."""
    best, first = comparison.best, comparison.results[0]
    ask = f'Ask `gyrocal diagnose` what {best.label} lacks.' if best.fails_where else ''
    level: Level = 'yellow' if ask else 'green'
    if model_fit(best.run).fits is False:
        level, ask = 'red', f'Ask `gyrocal diagnose` what {best.label} lacks.'
    if len(comparison.results) == 1:
        if not best.fails_where:
            return Status(level, f'{best.label} fits this recording: all differences are within chance.', ask)
        count = len(best.fails_where)
        places = 'one place' if count == 1 else f'{count} places'
        return Status(
            level, f'{best.label} does not fit in {places}: the errors are larger than chance.', ask
        )
    if best is first:
        return Status(level, f'No other model is better than {first.label}.', ask)
    gain = f'log-likelihood +{best.gain:.1f}, {best.gain_sigma:.1f} sigma'
    level = 'red' if level == 'red' else 'yellow'
    use = ask or f'Use {best.label}.'
    if best.gain_sigma < CHANCE_SIGMA:
        sentence = f'{best.label} is best, but not significantly better than {first.label} ({gain}).'
        return Status(level, sentence, ask or 'Compare them on a longer recording.')
    return Status(level, f'{best.label} predicts the recording better than {first.label} ({gain}).', use)


def _with_twins(name: str, twins: Sequence[str]) -> str:
    return f'{name} (not distinguishable here from {twins_in_words(twins, "or")})' if twins else name
