"""Several runs of the filter over one bag, for the commands that compare models, and the options of these."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gyrocal_ros.cli.figures import add_picture_options, check_pictures
from gyrocal_ros.cli.numbers import whole_number
from gyrocal_ros.cli.options import add_bag_options, add_images_option, bag_options, read_config
from gyrocal_ros.cli.output import draw_on_line, progress
from gyrocal_ros.cli.warned_bag import warned_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.files import new_folder
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.workers import Workers, usable_cores


@dataclass(frozen=True, slots=True)
class BagRuns:
    """A bag that is kept for several runs of the filter."""

    source: Source
    config: Config
    issues: tuple[tuple[str, str], ...]
    """Severity and text of each issue of the recording."""
    workers: Workers
    """The processes that run the filter."""

    def calibrate(self, model: SensorModel, candidates: tuple[Effect, ...] = ()) -> Run:
        """Run the filter once.

        Raises:
            GyrocalError: the filter cannot run with this bag or this model.
        """
        run: Run = self.workers.call(model, candidates)
        return run


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Declare the bag and the form of the results."""
    add_bag_options(parser)
    add_images_option(parser)
    parser.add_argument(
        '-o', '--out', type=Path, metavar='OUT', help='folder for the page and the result files'
    )
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')
    add_picture_options(parser)
    parser.add_argument(
        '--jobs',
        type=whole_number(1),
        default=usable_cores(),
        metavar='N',
        help='runs of the filter at the same time, where they do not need each other (default: one for each '
        'core); the result does not depend on it',
    )
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def bag_arguments(args: argparse.Namespace) -> list[str]:
    """Return the bag and the options for reading it, as arguments for another command."""
    options = [
        *(('-r', text) for text in args.remap),
        ('--namespace', args.namespace),
        ('--heading-reference', args.heading_reference),
        ('--config', args.config),
    ]
    words = [word for option, value in options if value for word in (option, str(value))]
    return [str(args.bag), *words, *(['--from-images'] if args.from_images else [])]


@contextmanager
def result_folder(args: argparse.Namespace) -> Iterator[Path | None]:
    """Provide the folder for the results; None if none is requested.

    The folder appears when the block ends without an error. Enter it before the work starts.

    Raises:
        GyrocalError: the folder is not empty and may not be overwritten, or cannot be made, or figures are
            requested that cannot be drawn.
    """
    check_pictures(args)
    if args.out is None:
        yield None
    else:
        with new_folder(args.out, overwrite=args.overwrite) as folder:
            yield folder


@contextmanager
def open_bag_runs(args: argparse.Namespace, model: SensorModel) -> Iterator[BagRuns]:
    """Check the bag given by the arguments, read it, and track features in its images.

    Raises:
        GyrocalError: it cannot be used for a calibration.
    """
    config, options = read_config(args), bag_options(args)
    with (
        warned_bag(args.bag, config, with_covariates=True, **options) as checked,
        _progress_bar('reading', checked.source) as report,
    ):
        preloaded, config = preload(checked.source, config, model, report)
    issues = tuple((issue.severity, str(issue)) for issue in checked.issues)

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        with _progress_bar(f'running with {model.effects[-1].name}', preloaded) as report:
            return calibrate(preloaded, config, model, report=report, candidates=candidates)

    with Workers(run, args.jobs, begin=draw_on_line) as processes:
        yield BagRuns(preloaded, config, issues, processes)


@contextmanager
def _progress_bar(label: str, source: Source) -> Iterator[Callable[[Progress], None]]:
    with progress(label, total=round(source.span.duration_s), unit='s') as bar:

        def report(state: Progress) -> None:
            bar.update(round(state.done_s) - bar.n)

        yield report
