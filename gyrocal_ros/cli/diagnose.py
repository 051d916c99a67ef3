"""Find the physical effect that the sensor model lacks, with its significance, and what to do next.

The filter runs over the bag with every effect of the library as a candidate, then once more for each
effect found. An effect counts as missing if it raises the predictive log-likelihood of the recording:
each measurement is scored by the prediction from the measurements before it.
"""

from __future__ import annotations

import argparse
import math
import shlex
import time
from collections.abc import Iterator

from gyrocal_ros.cli.bag_runs import add_run_options, bag_arguments, open_bag_runs, result_folder
from gyrocal_ros.cli.figures import draw_if_requested, print_if_requested
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.output import print_json, table
from gyrocal_ros.diagnose.advice import advice, grouped, join, twins_in_words
from gyrocal_ros.diagnose.analysis.drift import REFERENCES
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import BY_YAW, Diagnosis, MissingEffect, diagnose
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.status import LAW_OR_NOISE, MEND_KNOCK, MEND_YAW, diagnosis_status
from gyrocal_ros.diagnose.unknown_law import name_unknown
from gyrocal_ros.effects.quantities import add_words
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.report.describe import (
    coefficients_in_words,
    failures_in_words,
    number,
    sigma_in_words,
    status_line,
)

EXAMPLE = """gyrocal diagnose my_bag
gyrocal diagnose my_bag --model model.yaml -o diagnosis
gyrocal diagnose my_bag --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_run_options(parser)
    add_model_options(parser)


def run(args: argparse.Namespace) -> None:
    """Search for missing effects, and print the diagnosis.

    Raises:
        GyrocalError: the bag or the model cannot be used, or OUT cannot be written.
    """
    began_s = time.perf_counter()
    model = read_model(args)
    with result_folder(args) as folder, open_bag_runs(args, model) as runs:
        recorded, calibrate = summarise_recording(runs.source), remembered(runs.calibrate, runs.workers)
        searched = name_unknown(find_missing(model, recorded, calibrate), recorded, calibrate)
        diagnosis = diagnose(searched, recorded)
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.diagnosis import diagnosis_sections
            from gyrocal_ros.report.write import fill_diagnosis

            fill_diagnosis(folder, searched, diagnosis, runs.issues)
            draw_if_requested(args.png, folder, diagnosis_sections(searched, diagnosis))
            print_if_requested(args.pdf, folder)
    if args.json:
        print_json(summarise_diagnosis(searched, diagnosis) | {'wall_s': time.perf_counter() - began_s})
    else:
        print('\n'.join([*as_text(diagnosis), *next_steps(diagnosis, args)]))
        if args.out:
            print(f'\nReport: {args.out / "report.html"}')


def as_text(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the diagnosis in lines of text, the verdict first."""
    yield status_line(diagnosis_status(diagnosis))
    yield ''
    yield from _missing_effects(diagnosis)
    if diagnosis.fails_where:
        yield ''
        yield 'Where the model fails, worst first:'
        yield from failures_in_words(diagnosis.fails_where)
    if diagnosis.not_judged:
        yield ''
        yield 'Not judged:'
        for why, names in grouped(diagnosis.not_judged).items():
            yield f'  {join(names)}: {why}'


def _missing_effects(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.missing:
        yield from table(
            (
                'missing',
                'coefficients',
                'sigma',
                'log-likelihood',
                'drift in 60 s, held out',
                'indistinguishable from',
            ),
            [
                (
                    item.effect.name,
                    coefficients_in_words(item.effect, item.values, item.stds),
                    sigma_in_words(item.sigma),
                    number(item.gain, '+.0f'),
                    _drift_change(item),
                    twins_in_words(item.confused_with) or '-',
                )
                for item in diagnosis.missing
            ],
        )
        yield f'(drift against {REFERENCES[diagnosis.drift_reference]})'
        return
    for best in diagnosis.ranked:
        if best.effect.name not in diagnosis.not_judged:
            yield f'The most significant effect was {best.effect.name}, at {best.fit.sigma:.1f} sigma.'
            return


def _drift_change(missing: MissingEffect) -> str:
    if not math.isfinite(missing.drift_after_deg):
        return '-'
    return f'{number(missing.drift_before_deg)} -> {missing.drift_after_deg:.2f} deg'


def next_steps(diagnosis: Diagnosis, args: argparse.Namespace) -> Iterator[str]:
    """Yield the next steps, with the commands to copy."""
    steps = advice(diagnosis)
    usual = [item for item in diagnosis.missing if not (item.is_unusual_noise or item.raises_drift)]
    if diagnosis.wrong_yaw:  # what is found of camera and wheels may be that
        usual, steps = [item for item in usual if item.effect.acts_on not in BY_YAW], [MEND_YAW, *steps]
    has_a_cause = diagnosis.only_steps or (diagnosis.wrong_yaw and not usual)
    if diagnosis.knock:
        steps = [MEND_KNOCK, *steps]
    is_judged = diagnosis.timing is None and not diagnosis.fit.mounting and not has_a_cause
    if is_judged and (
        diagnosis.unexplained is not None or diagnosis.fit.misfits or len(usual) < len(diagnosis.missing)
    ):
        words = ['gyrocal', 'learn', *bag_arguments(args), *_model_arguments(args), '-o', 'learned']
        steps = [f'Learn what no effect of the library explains: {shlex.join(words)}', *steps]
    if usual:
        improve = shlex.join(
            ['gyrocal', 'improve', *bag_arguments(args), *_model_arguments(args), '-o', 'improved']
        )
        steps = [
            *(f'Add it to the model: {add_command(item.effect, args)}' for item in usual),
            f'Or add it and measure the error: {improve}',
            *steps,
        ]
    if diagnosis.rival_law and usual:
        steps = [LAW_OR_NOISE, *steps]
    if steps:
        yield ''
        yield 'Next:'
        yield from (f'  {step}' for step in steps)


def add_command(effect: Effect, args: argparse.Namespace) -> str:
    """Return the command that adds an effect, with the values that were found."""
    model = _model_arguments(args) if args.model else ['--model', 'model.yaml', *_model_arguments(args)]
    return shlex.join([*add_words(effect), *model])


def _model_arguments(args: argparse.Namespace) -> list[str]:
    """Return the model and the file of the user's effects, as arguments for another command."""
    options = (('--model', args.model), ('--effects-from', args.effects_from))
    return [word for option, value in options if value for word in (option, str(value))]
