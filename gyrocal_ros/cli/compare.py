"""Compare sensor models on a recording: which predicts it best, how far each drifts, where each fails.

The filter runs over the bag once for each model. Drift is the heading error after 60 s by the gyro
alone, on spans of the second half; each span begins with the estimate of that time. The interval of the
drift is a 90 % interval. Ground truth, if recorded, is only compared with; no estimate uses it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from gyrocal_ros.cli.bag_runs import BagRuns, add_run_options, open_bag_runs, result_folder
from gyrocal_ros.cli.figures import draw_if_requested, print_if_requested
from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.output import print_json, table
from gyrocal_ros.diagnose.analysis.comparison import Comparison, ModelResult, compare
from gyrocal_ros.diagnose.analysis.drift import REFERENCES
from gyrocal_ros.diagnose.json_summary import nis_per_dof, summarise_comparison
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.report.describe import drift_in_words, failures_in_words, with_std

EXAMPLE = """gyrocal compare my_bag
gyrocal compare my_bag --model default.yaml --model model.yaml
gyrocal compare my_bag --model model.yaml -o comparison --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_run_options(parser)
    parser.add_argument(
        '--model',
        type=Path,
        action='append',
        default=[],
        metavar='FILE',
        help='sensor model (model.yaml); may be repeated, the others are compared with the first',
    )
    add_own_effects_option(parser)


def run(args: argparse.Namespace) -> None:
    """Run every model, and print the comparison.

    Raises:
        GyrocalError: the bag or a model cannot be used, or the filter diverges with every model.
    """
    began_s = time.perf_counter()
    load_own_effects(args)
    models = {str(path): load_model(path) for path in args.model} or {'default': load_model(None)}
    with result_folder(args) as folder, open_bag_runs(args, next(iter(models.values()))) as runs:
        comparison = _compare(runs, models)
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.comparison import comparison_sections
            from gyrocal_ros.report.write import fill_comparison

            fill_comparison(folder, comparison, runs.issues)
            draw_if_requested(args.png, folder, comparison_sections(comparison))
            print_if_requested(args.pdf, folder)
    if args.json:
        print_json(summarise_comparison(comparison) | {'wall_s': time.perf_counter() - began_s})
    else:
        print('\n'.join(as_text(comparison)))
        if args.out:
            print(f'\nReport: {args.out / "report.html"}')


def _compare(runs: BagRuns, models: dict[str, SensorModel]) -> Comparison:
    tasks = [partial(_run_or_error, runs, model) for model in models.values()]
    ended = dict(zip(models, runs.workers.side_by_side(tasks), strict=True))
    finished = {label: run for label, run in ended.items() if isinstance(run, Run)}
    diverged = {label: error for label, error in ended.items() if isinstance(error, FilterDivergedError)}
    if not finished:
        raise next(iter(diverged.values()))
    return compare(finished, {label: str(error) for label, error in diverged.items()})


def _run_or_error(runs: BagRuns, model: SensorModel) -> Run | FilterDivergedError:
    try:
        return runs.calibrate(model)
    except FilterDivergedError as error:
        return error


def as_text(comparison: Comparison) -> Iterator[str]:
    """Yield the comparison in lines of text."""
    yield from table(
        ('model', 'drift in 60 s (deg)', 'heading (deg rms)', 'predictive gain', 'NIS/dof', 'scale factor'),
        [_row(result) for result in comparison.results],
    )
    yield f'(drift rms and interval, held out, against {REFERENCES[comparison.drift_reference]})'
    for label, why in comparison.diverged.items():
        yield f'{label}: the filter cannot run with this model: {why}'
    for result in comparison.results:
        yield ''
        yield f'Where {result.label} fails, worst first:'
        yield from failures_in_words(result.fails_where)
        if result.fails_by_truth is not None:
            yield 'and against the ground truth:'
            yield from failures_in_words(result.fails_by_truth)


def _row(result: ModelResult) -> tuple[str, ...]:
    run, heading = result.run, result.heading_rms_deg
    scale = conclude(run)
    return (
        result.label,
        drift_in_words(result.drift),
        '-' if heading is None else f'{heading:.3f}',
        f'{result.gain:+.1f} ({result.gain_sigma:+.1f} sigma)' if result.gain else 'reference',
        f'{nis_per_dof(run):.2f}',
        with_std(scale.scale_factor, scale.scale_factor_std),
    )
