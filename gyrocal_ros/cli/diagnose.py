"""Say which physical effect the sensor model lacks, how sure that is, and what to do about it.

The filter runs over the bag with every effect of the library on trial, then once more with each that
it finds. An effect counts as missing when the recording is foreseen better with it than without:
each measurement is judged by what was known before it.
"""

from __future__ import annotations

import argparse
import math
import shlex
import time
from collections.abc import Iterator

from gyrocal_ros.cli.figures import draw_if_wanted
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.output import print_json, table
from gyrocal_ros.cli.passes import add_pass_options, open_passes, result_folder, same_bag
from gyrocal_ros.diagnose.advice import advice, grouped, join
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect, diagnose
from gyrocal_ros.diagnose.drift import REFERENCES
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.search import search
from gyrocal_ros.diagnose.summarise import summarise_recording
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.model_file import options_of
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.report.describe import (
    coefficients_in_words,
    diagnosis_headline,
    failures_in_words,
    number,
    sigma_in_words,
)

EXAMPLE = """gyrocal diagnose my_bag
gyrocal diagnose my_bag --model model.yaml -o diagnosis
gyrocal diagnose my_bag --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_pass_options(parser)
    add_model_options(parser)


def run(args: argparse.Namespace) -> None:
    """Search for what is missing, and say it."""
    began_s = time.perf_counter()
    model = read_model(args)
    with result_folder(args) as folder:
        passes = open_passes(args, model)
        recorded = summarise_recording(passes.source)
        searched = search(model, recorded, passes.calibrate)
        diagnosis = diagnose(searched, recorded)
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.diagnosis import diagnosis_sections
            from gyrocal_ros.report.write import fill_diagnosis

            fill_diagnosis(folder, searched, diagnosis, passes.findings)
            draw_if_wanted(args.png, folder, diagnosis_sections(searched, diagnosis))
    if args.json:
        print_json(summarise_diagnosis(searched, diagnosis) | {'wall_s': time.perf_counter() - began_s})
    else:
        print('\n'.join([*in_words(diagnosis), *next_steps(diagnosis, args)]))
        if args.out:
            print(f'\nReport: {args.out / "report.html"}')


def in_words(diagnosis: Diagnosis) -> Iterator[str]:
    """The diagnosis in lines for a person, the verdict first."""
    yield diagnosis_headline(diagnosis)
    yield ''
    yield from _evidence(diagnosis)
    if diagnosis.fails_where:
        yield ''
        yield 'Where the model fails, worst first:'
        yield from failures_in_words(diagnosis.fails_where)
    if diagnosis.not_judged:
        yield ''
        yield 'Not judged:'
        for why, names in grouped(diagnosis.not_judged).items():
            yield f'  {join(names)}: {why}'


def _evidence(diagnosis: Diagnosis) -> Iterator[str]:
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
                    finding.effect.name,
                    coefficients_in_words(finding.effect, finding.values, finding.stds),
                    sigma_in_words(finding.sigma),
                    number(finding.gain, '+.0f'),
                    _drift_change(finding),
                    ', '.join(finding.confused_with) or '-',
                )
                for finding in diagnosis.missing
            ],
        )
        yield f'(drift against {REFERENCES[diagnosis.drift_reference]})'
    elif diagnosis.ranked:
        best = diagnosis.ranked[0]
        yield f'The most significant effect was {best.effect.name}, at {best.fit.sigma:.1f} sigma.'


def _drift_change(finding: MissingEffect) -> str:
    if not math.isfinite(finding.drift_after_deg):
        return '-'
    return f'{number(finding.drift_before_deg)} -> {finding.drift_after_deg:.2f} deg'


def next_steps(diagnosis: Diagnosis, args: argparse.Namespace) -> Iterator[str]:
    """What to do, with the very commands."""
    steps = advice(diagnosis)
    if diagnosis.missing:
        improve = shlex.join(['gyrocal', 'improve', *same_bag(args), *_same_model(args), '-o', 'improved'])
        steps = [
            *(f'Put it into the model: {add_command(item.effect, args)}' for item in diagnosis.missing),
            f'Or have that done and measured: {improve}',
            *steps,
        ]
    if steps:
        yield ''
        yield 'Next:'
        yield from (f'  {step}' for step in steps)


def add_command(effect: Effect, args: argparse.Namespace) -> str:
    """How to add an effect, with what was found of it."""
    usual = find_effect(effect.name)
    before = options_of(usual)
    settings = {name: value for name, value in options_of(effect).items() if value != before[name]}
    for item, known in zip(effect.coefficients, usual.coefficients, strict=True):
        if item.prior_std == 0.0 or item.prior_std != known.prior_std:
            settings[item.name] = item.prior_mean
    texts = [
        f'{name}={value:.4g}' if isinstance(value, float) else f'{name}={value}'
        for name, value in settings.items()
    ]
    model = _same_model(args) if args.model else ['--model', 'model.yaml', *_same_model(args)]
    return shlex.join(
        ['gyrocal', 'add', effect.name, *(word for text in texts for word in ('--set', text)), *model]
    )


def _same_model(args: argparse.Namespace) -> list[str]:
    """The model and the effects of the user's own, as they were given."""
    named = (('--model', args.model), ('--effects-from', args.effects_from))
    return [word for option, value in named if value for word in (option, str(value))]
