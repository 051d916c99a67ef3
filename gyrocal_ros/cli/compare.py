"""Hold sensor models against a recording: which foresees it best, how far each drifts, where each fails.

Every model runs over the bag by itself. Drift is the heading error after 60 s by the gyro alone, on
spans of the second half, each begun with what was known by then; its interval holds in 90 of 100
recordings. Ground truth is compared with where it is recorded, never estimated from.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

from gyrocal_ros.cli.figures import draw_if_wanted
from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.output import print_json, table
from gyrocal_ros.cli.passes import Passes, add_pass_options, open_passes, result_folder
from gyrocal_ros.diagnose.comparison import Comparison, ModelResult, compare
from gyrocal_ros.diagnose.drift import REFERENCES
from gyrocal_ros.diagnose.json_summary import nis_per_dof, summarise_comparison
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.report.describe import drift_in_words, failures_in_words, with_std

EXAMPLE = """gyrocal compare my_bag
gyrocal compare my_bag --model default.yaml --model model.yaml
gyrocal compare my_bag --model model.yaml -o comparison --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_pass_options(parser)
    parser.add_argument(
        '--model',
        type=Path,
        action='append',
        default=[],
        metavar='FILE',
        help='sensor model (model.yaml); may be repeated, the first is what others are measured by',
    )
    add_own_effects_option(parser)


def run(args: argparse.Namespace) -> None:
    """Run every model, and say how they compare.

    Raises:
        GyrocalError: the bag or a model cannot be used, or the filter runs with none of them.
    """
    began_s = time.perf_counter()
    load_own_effects(args)
    models = {str(path): load_model(path) for path in args.model} or {'default': load_model(None)}
    with result_folder(args) as folder:
        passes = open_passes(args, next(iter(models.values())))
        comparison = _compare(passes, models)
        if folder is not None:
            # Only a page needs the plotting library.
            from gyrocal_ros.report.comparison import comparison_sections
            from gyrocal_ros.report.write import fill_comparison

            fill_comparison(folder, comparison, passes.findings)
            draw_if_wanted(args.png, folder, comparison_sections(comparison))
    if args.json:
        print_json(summarise_comparison(comparison) | {'wall_s': time.perf_counter() - began_s})
    else:
        print('\n'.join(in_words(comparison)))
        if args.out:
            print(f'\nReport: {args.out / "report.html"}')


def _compare(passes: Passes, models: dict[str, SensorModel]) -> Comparison:
    runs: dict[str, Run] = {}
    diverged: dict[str, FilterDivergedError] = {}
    for label, model in models.items():
        try:
            runs[label] = passes.calibrate(model)
        except FilterDivergedError as error:
            diverged[label] = error
    if not runs:
        raise next(iter(diverged.values()))
    return compare(runs, {label: str(error) for label, error in diverged.items()})


def in_words(comparison: Comparison) -> Iterator[str]:
    """The comparison in lines for a person."""
    yield from table(
        ('model', 'drift in 60 s (deg)', 'heading (deg rms)', 'predictive gain', 'NIS/dof', 'scale factor'),
        [_row(rival) for rival in comparison.results],
    )
    yield f'(drift rms and interval, held out, against {REFERENCES[comparison.drift_reference]})'
    for label, why in comparison.diverged.items():
        yield f'{label}: the filter cannot run with it: {why}'
    for rival in comparison.results:
        yield ''
        yield f'Where {rival.label} fails, worst first:'
        yield from failures_in_words(rival.fails_where)
        if rival.fails_by_truth is not None:
            yield 'and against the ground truth:'
            yield from failures_in_words(rival.fails_by_truth)


def _row(rival: ModelResult) -> tuple[str, ...]:
    run, heading = rival.run, rival.heading_rms_deg
    scale = conclude(run)
    return (
        rival.label,
        drift_in_words(rival.drift),
        '-' if heading is None else f'{heading:.3f}',
        f'{rival.gain:+.1f} ({rival.gain_sigma:+.1f} sigma)' if rival.gain else 'reference',
        f'{nis_per_dof(run):.2f}',
        with_std(scale.scale_factor, scale.scale_factor_std),
    )
