"""Sentences and numbers that pages, commands and the studio share. Each verdict has its one phrasing here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.advice import join
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.drift import BlindDrift
from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.diagnose.shapes import UnexplainedStructure
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.sensor import Effect

Kind: TypeAlias = Literal['good', 'found', 'bad']
MAX_SIGMA = 30.0
"""Significance above which the exact number does not matter."""
NOTHING_MISSING = 'Nothing is missing: gyro, wheels and camera agree with the model within chance.'
CANNOT_TELL = (
    'This recording cannot tell whether an effect is missing: '
    'too few effects of the library would show in it.'
)
NO_FAILURE = 'Nowhere: chance and a slowly wandering bias explain all differences.'
FAILURE_HEADS = ('place, and the correction needed there', 'sigma')
DOES_NOT_FIT = 'the model does not fit this recording: run gyrocal diagnose'
"""The last words on a calibration that its own recording contradicts."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result in a few sentences, which come first on a page."""

    kind: Kind
    """`good`: no action needed; `found`: there is something to do; `bad`: the result is not reliable."""
    headline: str
    sentences: tuple[str, ...]
    todo: tuple[str, ...] = ()
    """Next steps."""

    @property
    def good(self) -> bool:
        """True if no action is needed."""
        return self.kind == 'good'


def calibration_headline(
    is_converged: bool,
    convergence_time_s: float | None,
    scale_std: float,
    config: Config,
    misfits: Sequence[str] = (),
) -> str:
    """State whether a calibration can be used, in one or two sentences.

    Args:
        is_converged: True if the scale factor reached its accuracy and the filter is consistent.
        convergence_time_s: time at which the scale factor reached its accuracy; None if it never did.
        scale_std: standard deviation of the scale factor at the end.
        config: settings of the run.
        misfits: what contradicts the model, as clauses.
    """
    threshold = f'{100.0 * config.convergence.scale_std:g} %'
    if misfits:
        return f'Not to be trusted: {"; ".join(misfits)}; {DOES_NOT_FIT}'
    if convergence_time_s is None:
        return (
            f'Not calibrated yet: the scale factor is known to {100.0 * scale_std:.2g} % only, not to '
            f'{threshold}. Record more turns, both ways, while the camera sees the ceiling.'
        )
    if is_converged:
        return f'Calibrated: the scale factor was known to {threshold} after {convergence_time_s:.0f} s.'
    return (
        'Not to be trusted: at the end the innovations are not as large as the filter expects. '
        'Look at the warnings, the camera calibration and the time stamps.'
    )


def missing_headline(
    missing: Mapping[str, Sequence[str]],
    structure: UnexplainedStructure | None = None,
    otherwise: str = NOTHING_MISSING,
) -> str:
    """State which effects a model lacks, in one or two sentences.

    Args:
        missing: names of missing effects, each with the effects that this recording cannot distinguish
            from it.
        structure: unexplained structure, if there is any.
        otherwise: sentence for a model that lacks nothing.
    """
    clear_first = sorted(missing, key=lambda name: bool(missing[name]))
    listed = join([_with_twins(name, missing[name]) for name in clear_first])
    sentences = [f'Missing: {listed}.'] if missing else []
    if structure is not None:
        what = f'{structure.what} ({structure.sigma:.0f} sigma)'
        sentences.append(f'No effect of the library explains this: {what}.')
    return ' '.join(sentences) or otherwise


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """State the verdict of a diagnosis, in one or two sentences."""
    missing = {item.effect.name: item.confused_with for item in diagnosis.missing}
    is_unexplained = diagnosis.verdict == 'unexplained'
    if missing and not is_unexplained and diagnosis.coarse_step_rad_s is not None:
        step = f'steps of {math.degrees(diagnosis.coarse_step_rad_s):.2g} deg/s'
        causes = join(['these', *missing], 'or')
        return f'The gyro reads in {step}, wider than its noise; {causes} cause the errors.'
    if diagnosis.verdict == 'noise':
        noises = join([item.effect.name for item in diagnosis.missing])
        return f'Only noise: the gyro is noisier than the settings say ({noises}), and no law is left over.'
    otherwise = NOTHING_MISSING if diagnosis.verdict == 'nothing_missing' else CANNOT_TELL
    headline = missing_headline(missing, diagnosis.unexplained if is_unexplained else None, otherwise)
    still = missing and not is_unexplained and diagnosis.fit.fits is False
    return f'{headline} The model still does not fit with it: see the next steps.' if still else headline


def improvement_headline(improved: Improvement) -> str:
    """State what was added to a model, in one sentence."""
    names = [revision.effect.name for revision in improved.kept if revision.effect is not None]
    if not names:
        return 'Nothing was added: no effect improves the prediction of the recording.'
    first, last = improved.kept[0].held_out.rms_deg, improved.final.held_out.rms_deg
    change = (
        f': the held-out drift went from {first:.2f} to {last:.2f} deg'
        if math.isfinite(first) and math.isfinite(last) and len(improved.kept) > 1
        else ''
    )
    return f'Added {join(names)}{change}.'


def events_in_words(run: Run) -> Iterator[tuple[str, str]]:
    """Yield the events of a run as warnings with their times."""
    for event in run.events:
        yield 'warning', f'{(event.t_ns - run.span.start_ns) / NS_PER_S:.1f} s after the start: {event.text}'


def failures_in_words(failures: Sequence[Failure], most: int = 5) -> Iterator[str]:
    """Yield a line for each of the worst failures, or one that says that there is none."""
    if not failures:
        yield '  nowhere: all differences are within chance'
    for failure in failures[:most]:
        yield f'  {failure.what} ({failure.sigma:.0f} sigma)'
    if len(failures) > most:
        yield f'  and {len(failures) - most} more'


def coefficients_in_words(effect: Effect, values: Array, stds: Array) -> str:
    """Return `c = 0.0101 ± 0.0002` for each coefficient, angles in degrees."""
    items = zip(effect.coefficients, values.tolist(), stds.tolist(), strict=True)
    return ', '.join(f'{item.name} = {quantity(value, std, item.unit)}' for item, value, std in items)


def meaning(name: str, value: float, std: float, unit: str) -> str:
    """Return a coefficient in a customary unit; empty where its own unit is customary."""
    if name == 'scale_factor':
        return f'true rate = ({with_std(1.0 + value, std)}) times the nominal rate'
    if unit.startswith('rad'):
        return f'{with_std(math.degrees(value), math.degrees(std))} deg{unit.removeprefix("rad")}'
    return ''


def quantity(value: float, std: float, unit: str) -> str:
    """Return `0.0101 ± 0.0002 1/K`, angles in degrees; without the deviation where it is zero."""
    if unit.startswith('rad'):
        value, std, unit = math.degrees(value), math.degrees(std), unit.replace('rad', 'deg', 1)
    text = with_std(value, std) if std > 0.0 else f'{value:.4g}'
    return f'{text} {unit}'.removesuffix(' 1')


def with_std(value: float, std: float) -> str:
    """Return a number and its standard deviation, to two digits of the latter: `0.92555 ± 0.00021`."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f'{value:g} ± {std:g}'
    decimals = 1 - math.floor(math.log10(std))
    if decimals > 8:
        return f'{value:.4g} ± {std:.2g}'
    shown = max(decimals, 0)
    return f'{round(value, decimals):.{shown}f} ± {round(std, decimals):.{shown}f}'


def with_gain(gain: float, sigma: float) -> str:
    """Return a gain of log-likelihood with its significance where that is known."""
    if not math.isfinite(gain):
        return 'diverges without it'
    return f'{gain:+.1f} ({sigma:.1f} sigma)' if math.isfinite(sigma) else f'{gain:+.1f}'


def drift_in_words(drift: BlindDrift) -> str:
    """Return `0.21 (0.12 to 0.80)`, rms and its interval in deg, or a dash where no span is long enough."""
    if not len(drift.error_rad):
        return '-'
    low, high = drift.interval_deg
    above = f'to {high:.2f}' if math.isfinite(high) else 'or more'
    return f'{drift.rms_deg:.2f} ({low:.2f} {above})'


def launch_command(folder: str) -> str:
    """Return the command that starts the robot with the model and the calibration in a folder."""
    files = f'model:={folder}/model.yaml calibration:={folder}/calibration.yaml'
    return f'ros2 launch gyrocal_ros robot.launch.py {files}'


def number(value: float, form: str = '.2f') -> str:
    """Return a number, or a dash where it is not finite."""
    return f'{value:{form}}' if math.isfinite(value) else '-'


def sigma_in_words(sigma: float) -> str:
    """Return `7.5`, `> 30` above `MAX_SIGMA`, or a dash where it is unknown."""
    return number(sigma, '.1f') if not sigma > MAX_SIGMA else f'> {MAX_SIGMA:.0f}'


def _with_twins(name: str, twins: Sequence[str]) -> str:
    return f'{name} (not distinguishable here from {join([*twins], "or")})' if twins else name
