"""Add missing effects to the sensor model, one by one, while they improve the prediction of the recording.

Each revision is scored on held-out measurements: every measurement by the prediction from those before
it, and the drift on spans that begin with the estimate of that time. An effect that does not help there
is left out and reported. With -o the history is written: for each revision a folder with its model,
calibration and figures of merit, and the final model.yaml and calibration.yaml for the robot.
"""

from __future__ import annotations

import argparse
import shlex
import time
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path

from gyrocal_ros.cli.bag_runs import BagRuns, add_run_options, open_bag_runs, result_folder
from gyrocal_ros.cli.figures import draw_if_requested, print_if_requested
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import print_json, print_message, table
from gyrocal_ros.diagnose.analysis.drift import REFERENCES
from gyrocal_ros.diagnose.analysis.runs import Calibrate, remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.json_summary import nis_per_dof, summarise_improvement
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, summarise_laws
from gyrocal_ros.diagnose.laws.learning import learn
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.elimination import without_harm
from gyrocal_ros.diagnose.search.improvement import Improvement, Revision, improvement
from gyrocal_ros.diagnose.search.search import try_effect
from gyrocal_ros.diagnose.status import improvement_status, missing_sentence
from gyrocal_ros.diagnose.unknown_law import name_unknown
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.report.describe import (
    drift_in_words,
    launch_command,
    status_line,
    with_std,
)
from gyrocal_ros.report.laws import law_in_words

EXAMPLE = """gyrocal improve my_bag -o improved
gyrocal improve my_bag --model model.yaml -o improved
gyrocal improve my_bag --effect gyro_lag
gyrocal improve my_bag --learn -o improved
gyrocal replay another_bag --model improved/model.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_run_options(parser)
    add_model_options(parser)
    which = parser.add_mutually_exclusive_group()
    effect = which.add_argument(
        '--effect', metavar='NAME', help='try this effect only, even if the diagnosis does not find it'
    )
    complete_with(effect, EFFECTS)
    which.add_argument(
        '--learn', action='store_true', help='then learn what no effect of the library explains'
    )


def run(args: argparse.Namespace) -> None:
    """Search, keep the effects that help, and write the history.

    Raises:
        GyrocalError: the bag, the model or the effect cannot be used, or OUT cannot be written.
    """
    began_s = time.perf_counter()
    model = read_model(args)
    effect = _requested_effect(args.effect, model)
    with result_folder(args) as folder, open_bag_runs(args, model) as runs:
        recorded = summarise_recording(runs.source)
        calibrate = remembered(announced(runs), runs.workers)
        laws: list[LearnedLaw] = []
        if effect is None:
            searched = find_missing(model, recorded, calibrate)
            if args.learn:
                learned = learn(searched, recorded, calibrate)
                searched, laws = learned.searched, learned.laws
            else:
                searched = name_unknown(without_harm(searched, recorded, calibrate), recorded, calibrate)
        else:
            searched = try_effect(model, recorded, calibrate, effect)
        improved = improvement(searched, has_learned=effect is None and args.learn)
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.improvement import improvement_sections
            from gyrocal_ros.report.write import fill_improvement

            fill_improvement(folder, improved, runs.issues, laws)
            draw_if_requested(args.png, folder, improvement_sections(improved, laws))
            print_if_requested(args.pdf, folder)
    if args.json:
        summary = summarise_improvement(improved) | ({'learned': summarise_laws(laws)} if args.learn else {})
        print_json(summary | {'wall_s': time.perf_counter() - began_s})
    else:
        print('\n'.join([*as_text(improved), *laws_as_text(laws), *files_as_text(args.out, improved)]))


def _requested_effect(name: str | None, model: SensorModel) -> Effect | None:
    if name is not None and any(effect.name == name for effect in model.effects):
        raise ConfigError('is in the model already', where=f'--effect {name}', todo='name another effect')
    return None if name is None else find_effect(name, '--effect')


def announced(runs: BagRuns) -> Calibrate:
    """Return a function that runs the filter and prints a message before each run."""
    numbers = count(1)

    def calibrate(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        print_message(f'run {next(numbers)}: {", ".join(effect.name for effect in model.effects)}')
        return runs.calibrate(model, candidates)

    return calibrate


def as_text(improved: Improvement) -> Iterator[str]:
    """Yield the improvement in lines of text, with the error of each revision."""
    yield status_line(improvement_status(improved))
    yield ''
    yield from table(
        ('revision', '', 'held-out drift (deg)', 'fitted', 'predictive gain', 'NIS/dof', 'scale factor'),
        [_row(revision) for revision in improved.revisions],
    )
    reference = REFERENCES[improved.drift_reference]
    yield f'(drift in 60 s, rms and interval, against {reference})'
    yield ''
    yield from (f'{revision.label}: {revision.why}' for revision in improved.revisions)
    structure = improved.final.examined.unexplained_structure
    if structure is not None:
        yield missing_sentence({}, structure)


def laws_as_text(laws: Sequence[LearnedLaw]) -> Iterator[str]:
    """Yield what was learned, with closed forms, in lines of text."""
    if laws:
        yield ''
    for law in laws:
        yield from law_in_words(law)


def files_as_text(out: Path | None, improved: Improvement) -> Iterator[str]:
    """Yield the files that were written, and the command that gives a new model to the robot."""
    if out is not None:
        yield ''
        yield f'Model: {out / "model.yaml"}'
        yield f'Report: {out / "report.html"}'
        if improved.final is improved.kept[0]:
            return
        if improvement_status(improved).level == 'red':
            yield 'Not for the robot yet: compare the model on a second recording with `gyrocal compare`.'
        else:
            yield f'On the robot: {launch_command(shlex.quote(str(out.resolve())))}'


def _row(revision: Revision) -> tuple[str, ...]:
    scale = conclude(revision.examined.run)
    return (
        revision.label,
        revision.fate,
        drift_in_words(revision.held_out),
        drift_in_words(revision.fitted),
        f'{revision.gain:+.1f}' if revision.effect is not None else '-',
        f'{nis_per_dof(revision.examined.run):.2f}',
        with_std(scale.scale_factor, scale.scale_factor_std),
    )
