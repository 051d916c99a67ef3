"""Calibrate the gyro from a recorded bag, with the estimator of the robot and without ROS."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.figures import add_picture_options, check_pictures, draw_if_requested, print_if_requested
from gyrocal_ros.cli.model_options import add_model_options, load_own_effects
from gyrocal_ros.cli.options import (
    BagOptions,
    add_bag_options,
    add_images_option,
    bag_options,
    read_config,
)
from gyrocal_ros.cli.output import print_json, progress, warn
from gyrocal_ros.cli.warned_bag import warned_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Source
from gyrocal_ros.diagnose.json_summary import summarise
from gyrocal_ros.diagnose.status import Status
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.files import new_folder
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude, load_calibration
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.report.describe import events_in_words, quantity, status_line, with_std

EXAMPLE = """gyrocal replay my_bag -o result
gyrocal replay my_bag --json
gyrocal replay xsens.bag -r imu/data_raw:=/xsens/imu_data --heading-reference /stereo/odometry"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_bag_options(parser)
    add_model_options(parser)
    parser.add_argument(
        '--start-from',
        type=Path,
        metavar='FILE',
        help='calibration.yaml of an earlier run to start with; its model is used unless --model is given',
    )
    add_images_option(parser)
    parser.add_argument('-o', '--out', type=Path, metavar='OUT', help='folder for the report and the results')
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')
    add_picture_options(parser)
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Calibrate, print the result, and write the report if requested."""
    check_pictures(args)
    config = read_config(args)
    load_own_effects(args)
    known = load_calibration(args.start_from) if args.start_from else None
    model = load_model(args.model) if known is None or args.model else known.model
    summary = replay(
        args.bag,
        config,
        model,
        bag_options(args),
        start=None if known is None else known.start(),
        out=args.out,
        overwrite=args.overwrite,
        png=args.png,
        pdf=args.pdf,
    )
    if args.json:
        print_json(summary)
    else:
        print(as_text(summary))
        if args.out:
            print(f'\nReport: {args.out / "report.html"}')


def replay(
    bag: Path,
    config: Config,
    model: SensorModel,
    options: BagOptions,
    *,
    start: Start | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    png: bool = False,
    pdf: bool = False,
) -> dict[str, Any]:
    """Check a bag, calibrate from it, write the report, and return the values for `--json`."""
    began_s = time.perf_counter()
    with ExitStack() as stack:
        folder = stack.enter_context(new_folder(out, overwrite=overwrite)) if out else None
        with_covariates = bool(followers_by_signal(model))
        with warned_bag(bag, config, with_covariates=with_covariates, **options) as checked:
            finished = _calibrate(checked.source, config, model, start)
        calibration = conclude(finished)
        for _, event in events_in_words(finished):
            warn(event)
        if folder is not None:
            _write(folder, finished, calibration, checked.issues, png)
            print_if_requested(pdf, folder)
    return summarise(finished, calibration) | {'wall_s': time.perf_counter() - began_s}


def as_text(summary: dict[str, Any]) -> str:
    """Return the result in a few lines of text."""
    scale = with_std(summary['scale_factor'], summary['scale_factor_std'])
    rows = [
        ('scale factor', f'{scale}   ({summary["scale_factor_volt"]:.3f} deg/s/V)'),
        *(
            (name, quantity(entry['value'], entry['std'], entry['unit']))
            for name, entry in summary['coefficients'].items()
            if name != 'scale_factor'
        ),
        ('converged', _convergence(summary)),
    ]
    if 'mount_tilt_deg' in summary:
        tilt = summary['mount_tilt_deg']
        rows.append(
            ('mount tilt', f'{tilt["value"]:.1f} ± {tilt["std"]:.1f} deg against the vertical, corrected')
        )
    if 'blind_drift_deg' in summary:
        drift = summary['blind_drift_deg']
        rows.append(('heading', f'{summary["heading_rms_deg"]:.3f} deg rms against the ground truth'))
        is_early = drift['from_s'] < (summary['convergence_time_s'] or 0.0)
        if is_early and summary['converged']:
            rows.append(('blind drift', 'no 60 s are left after the gyro was calibrated'))
        elif math.isfinite(drift['rms']):
            after = 'after 60 s without the camera, held out'
            if drift['rms'] == drift['max']:  # a short recording has a single span
                size = f'{drift["rms"]:.2f} deg in one span'
            else:
                size = f'{drift["rms"]:.2f} deg rms, {drift["max"]:.2f} at worst'
            rows.append(('blind drift', f'{size}, {after}'))
            if is_early:
                rows.append(('', f'(spans from {drift["from_s"]:.0f} s on, before the gyro was calibrated)'))
    width = max(len(label) for label, _ in rows)
    lines = [f'{label:{width}}  {text}' for label, text in rows]
    status = Status(**summary['status'])
    ending = ['', f'Next: {status.next_step}'] if status.next_step else []
    return '\n'.join([status_line(status), '', *lines, *ending])


def _convergence(summary: dict[str, Any]) -> str:
    if summary['converged']:
        return f'after {summary["convergence_time_s"]:.1f} s of {summary["duration_s"]:.0f} s'
    return 'no'


def _calibrate(source: Source, config: Config, model: SensorModel, start: Start | None) -> Run:
    with progress('calibrating', total=round(source.span.duration_s), unit='s') as bar:

        def report(state: Progress) -> None:
            bar.update(round(state.done_s) - bar.n)

        try:
            return calibrate(source, config, model, start, report, follows_changes=True)
        except FilterDivergedError as error:
            if start is None:
                raise
            todo = 'try without --start-from: it may be the calibration of another gyro'
            raise FilterDivergedError(error.what, where=error.where, todo=todo) from error


def _write(
    folder: Path, finished: Run, calibration: Calibration, issues: Sequence[BagIssue], png: bool
) -> None:
    # Only a page needs the plotting library.
    from gyrocal_ros.report.calibration import calibration_sections
    from gyrocal_ros.report.write import fill_calibration

    fill_calibration(folder, finished, calibration, [(issue.severity, str(issue)) for issue in issues])
    draw_if_requested(png, folder, calibration_sections(finished, calibration))
