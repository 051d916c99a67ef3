"""Learning of unknown laws: rank them, run the filter with the likeliest, keep what predicts better."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from gyrocal_ros.diagnose.analysis.drift import (
    better_sigma,
    blind_drift,
    drift_of_both,
    held_out_from_s,
    reference_heading,
)
from gyrocal_ros.diagnose.analysis.examined import (
    ExaminedModel,
    contradicts,
    examine,
    unusual_noises,
    with_effect,
)
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.laws.hypotheses import (
    Law,
    RankedLaw,
    carried_by,
    fine_steps,
    laws,
    rank_laws,
)
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, learned_laws
from gyrocal_ros.diagnose.laws.rewriting import rewrite, size_of
from gyrocal_ros.diagnose.search.additions import CHANCE_SIGMA, CLEAR_SIGMA, Addition, Search, addition
from gyrocal_ros.diagnose.search.elimination import eliminate, without_harm
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.effects.learned.step import Step
from gyrocal_ros.effects.traits import required_signals
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.statistics import chi_square_tail, sigma_of, vuong_sigma

MAX_LEARNED = 2
"""Number of laws that are learned at most."""
MIN_GAIN = 25.0
"""Marginal and predictive log-likelihood that a law has to gain: of a hundred laws with a dozen priors each,
the best gains half of that by chance."""
ALIKE_PART = 0.01
"""Part of all that is gained by which a simpler model may predict worse: with other priors, the same law does
so."""
PROOF = 100.0
"""Predictive log-likelihood beyond which a block of time proves no more."""
MIN_SIGMA = 2.0
"""Significance of the predictive gain over the blocks of the recording, or of the decrease of the drift."""
MAX_DRIFT = 1.02
"""Largest held-out drift with the law, relative to that without."""
FITTED_PART = 2.0 / 3.0
"""Largest drift with a law, relative to that without, both with their final coefficients, where the held-out
one rises by chance."""
RIVAL_PART, MAX_RIVALS = 0.85, 3
"""Part of the best marginal gain above which a law gets a run of its own, and the number of such runs."""
COARSE_PART = 0.6
"""The same part for a step whose moment is known to some seconds only: at the true one it gains more."""


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """What was learned beside a search in the library."""

    searched: Search
    """The search, with the learned effects as its last additions."""
    ranked: tuple[RankedLaw, ...]
    """Laws that were considered first, the likeliest first, each with its best prior."""
    given_up: tuple[str, ...] = ()
    """Effects that the library had added and that the laws make superfluous."""

    @property
    def laws(self) -> list[LearnedLaw]:
        """The learned laws of the final model, with the curves that they were learned as."""
        curves = {
            item.effect.name: (item.effect, item.after)
            for item in self.searched.additions
            if item.is_kept and not item.is_rewritten
        }
        return list(learned_laws(self.searched.last, curves))


def learn(
    searched: Search,
    recording: RecordingSummary,
    calibrate: Calibrate,
    only: Sequence[str] = (),
    most: int = MAX_LEARNED,
) -> Learned:
    """Learn what the library leaves unexplained.

    What the library has added is given up where laws alone predict clearly better, or as well while they are
    fewer or simpler: several wrong effects may together imitate one law. In the end laws are written in
    closed form, and a noise that only raises the drift is removed.

    Args:
        searched: a finished search in the library.
        recording: summary of the recording.
        calibrate: runs the filter.
        only: names of laws; with any, they are tried even where nothing is missing.
        most: number of laws that are learned at most.
    """
    found = _learned(searched, recording, calibrate, only, most)
    return replace(found, searched=rewrite(found.searched, recording, calibrate))


def _learned(
    searched: Search, recording: RecordingSummary, calibrate: Calibrate, only: Sequence[str], most: int
) -> Learned:
    is_doubtful = searched.kept and searched.kept[0].before is not None and not only
    starts = [searched.last, searched.first] if is_doubtful else [searched.last]
    tasks = [partial(_learned_beside, start, recording, calibrate, only, most) for start in starts]
    (last, ranked), *rest = side_by_side(calibrate, tasks)
    wider = replace(searched, additions=(*searched.additions, *last))
    kept = without_harm(eliminate(wider, recording, calibrate), recording, calibrate)
    found = Learned(kept, tuple(ranked))
    if not rest:
        return found
    first, ranked = rest[0]
    given_up = tuple(item.effect.name for item in searched.kept)
    alone = Learned(Search(searched.first, tuple(first)), tuple(ranked), given_up)
    return alone if _is_better(alone.searched, found.searched) else found


def is_missing_something(present: ExaminedModel) -> bool:
    """Return True if a model lacks something, whatever it is; not where stamps are at fault.

    Where the recording does not contradict it, it may owe that to a noise that no gyro has.
    """
    lacks = bool(unusual_noises(present.model)) or contradicts(present)
    return lacks and timing_fault(present) is None


def likeliest_law(
    present: ExaminedModel, recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    """Run the filter with the likeliest laws; return the one that predicts best, kept or not.

    Beside a noise that no gyro has, a jump is no law: it is one of many that the noise stands for.
    """
    may_jump = not unusual_noises(present.model)
    found = laws(present.run, recording.ranges)
    tried = [law for law in found if may_jump or not isinstance(law.effect, Step)]
    if not tried:
        return None
    return _best(_rivals(present, _rank(present, tried, calibrate), recording, calibrate))


def _is_better(alone: Search, found: Search) -> bool:
    if not alone.kept:
        return False
    if _complexity(alone) < _complexity(found):
        gained = float(predictive_gain(found.first.run, found.last.run).sum())
        most_lost = max(MIN_GAIN, ALIKE_PART * gained)
        return float(predictive_gain(found.last.run, alone.last.run).sum()) > -most_lost
    return _helps(found.last.run, alone.last.run)


def _complexity(found: Search) -> tuple[int, int, int]:
    """Return the number of effects that were found, that of parameters of the learned laws, and of signals.

    What is recorded may go with the time since the start, or with the motion, by chance.
    """
    learned = list(learned_laws(found.last))
    signals = sum(bool(required_signals(law.effect)) for law in learned)
    return len(found.kept), sum(size_of(law, found.last) for law in learned), signals


def _helps(before: Run, after: Run) -> bool:
    """Return True if a run predicts the recording better by more than chance.

    Where the filter adapts to a wrong model, as after a jump, only a few stretches show it by their
    innovations, which alone is hardly more than chance. The drift shows it, too.
    """
    gain = predictive_gain(before, after)
    if float(gain.sum()) < MIN_GAIN:
        return False
    return vuong_sigma(gain, PROOF) > MIN_SIGMA or better_sigma(*drift_of_both(before, after)) > MIN_SIGMA


def _learned_beside(
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    only: Sequence[str],
    most: int,
) -> tuple[list[Addition], list[RankedLaw]]:
    """Learn one law after the other; return them with the ranking that the first was taken from."""
    found: list[Addition] = []
    first: list[RankedLaw] = []
    while len(found) < most and (only or is_missing_something(present)):
        tried = laws(present.run, recording.ranges, only)
        if not tried:
            break
        ranked = _rank(present, tried, calibrate)
        first = first or ranked
        following = _simplest(_rivals(present, ranked, recording, calibrate))
        if following is None:
            break
        found.append(following)
        if not following.is_kept:
            break
        present = following.after
    return found, first


def _rank(present: ExaminedModel, tried: Sequence[Law], calibrate: Calibrate) -> list[RankedLaw]:
    """Rank laws by one run that carries all of them; of the moments of a step only the best remains."""
    run = calibrate(present.model, carried_by(tried))
    assert run.scores is not None
    ranked = rank_laws(tried, run.scores)
    names = [item.effect.name for item in ranked]
    return [item for place, item in enumerate(ranked) if item.effect.name not in names[:place]]


def _rivals(
    present: ExaminedModel, ranked: Sequence[RankedLaw], recording: RecordingSummary, calibrate: Calibrate
) -> list[Addition]:
    """Run the filter with each of the likeliest laws."""
    if not ranked or ranked[0].gain < MIN_GAIN:
        return []
    contenders = _contenders(present, ranked, calibrate)
    tasks = [partial(_with_law, present, law, recording, calibrate) for law in contenders]
    return [added for added in side_by_side(calibrate, tasks) if added is not None]


def _with_law(
    present: ExaminedModel, law: RankedLaw, recording: RecordingSummary, calibrate: Calibrate
) -> Addition | None:
    with suppress(*CANNOT_RUN):
        after = examine(with_effect(present.model, law.effect), recording, calibrate, present.settings)
        return _judged(replace(addition(present, after), gain=law.gain))
    return None


def _contenders(present: ExaminedModel, ranked: Sequence[RankedLaw], calibrate: Calibrate) -> list[RankedLaw]:
    """Return the likeliest laws, steps at their best moments."""
    likely = [item for item in ranked if item.gain > COARSE_PART * ranked[0].gain]
    tasks = [partial(_at_the_moment, present, law, calibrate) for law in likely]
    finest = sorted(side_by_side(calibrate, tasks), key=lambda law: -law.gain)
    return [item for item in finest if item.gain > RIVAL_PART * finest[0].gain][:MAX_RIVALS]


def _best(tried: Sequence[Addition]) -> Addition | None:
    """Return the addition that predicts best, one that is kept before others; None without any."""
    return max(tried, key=lambda item: (item.is_kept, item.predictive_gain), default=None)


def _simplest(tried: Sequence[Addition]) -> Addition | None:
    """Return the best addition, or one with fewer parameters or signals that predicts nearly as well."""
    best = _best(tried)
    if best is None or not best.is_kept:
        return best
    alike = [
        item for item in tried if item.is_kept and item.predictive_gain > best.predictive_gain - MIN_GAIN
    ]
    return min(
        alike, key=lambda item: (_size(item), len(required_signals(item.effect)), -item.predictive_gain)
    )


def _size(found: Addition) -> int:
    """Return the number of parameters of a law that was added, in its closed form where there is one."""
    added = next(law for law in learned_laws(found.after) if law.effect.name == found.effect.name)
    return size_of(added, found.after)


def _at_the_moment(present: ExaminedModel, law: RankedLaw, calibrate: Calibrate) -> RankedLaw:
    """Return a step at its best moment; any other law unchanged."""
    if not isinstance(law.effect, Step):
        return law
    duration_s = float(present.run.history.time_s[-1])
    half_s = max(10.0, duration_s / 20.0)
    return _rank(present, fine_steps(law.effect.of, law.effect.at_s, half_s), calibrate)[0]


def _judged(added: Addition) -> Addition:
    """Return the addition with its significance, rejected unless it predicts better and drifts no more."""
    assert added.before is not None
    p_value = chi_square_tail(2.0 * max(added.gain, 0.0), len(added.effect.coefficients))
    objection = ''
    if not _helps(added.before.run, added.after.run):
        objection = 'the recording is not predicted clearly better'
    elif _drifts_more(added.before.run, added.after.run):
        objection = 'it drifts more'
    return replace(added, sigma=sigma_of(p_value), p_value=p_value, objection=objection)


def _drifts_more(before: Run, after: Run) -> bool:
    """Return True if the held-out drift rises, unless that may be chance and that of the final models falls.

    The spans of a short recording begin while a law is hardly known yet. Where the gain is clear, it need not
    fall by much.
    """
    earlier, later = drift_of_both(before, after)
    if not later.rms_deg > MAX_DRIFT * earlier.rms_deg:
        return False
    reference, from_s = reference_heading(after), held_out_from_s(after)
    fitted_deg = [
        blind_drift(run, reference, from_s, coefficients=run.history.coefficients[-1]).rms_deg
        for run in (before, after)
    ]
    is_chance = better_sigma(earlier, later) > -CHANCE_SIGMA
    is_clear = vuong_sigma(predictive_gain(before, after), PROOF) > CLEAR_SIGMA
    return not (is_chance and fitted_deg[1] < (1.0 if is_clear else FITTED_PART) * fitted_deg[0])
