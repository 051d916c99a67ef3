"""The folder that a run leaves behind: for programs, for a later run, and for a person to look at."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gyrocal_ros.config.declare import to_yaml
from gyrocal_ros.data import NS_PER_S, Array, IntArray
from gyrocal_ros.diagnose.comparison import Comparison
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.drift import dead_reckoning
from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.diagnose.search import Search
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.state import EULER, POSITION
from gyrocal_ros.files import json_text, new_folder, write_text_atomic
from gyrocal_ros.pipeline.calibration import Calibration, save_calibration
from gyrocal_ros.report.comparison_page import comparison_page
from gyrocal_ros.report.diagnosis_page import diagnosis_page
from gyrocal_ros.report.figures.png import save_png
from gyrocal_ros.report.history import fill_history
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.improvement_page import improvement_page
from gyrocal_ros.report.page import report_page
from gyrocal_ros.report.series import quaternions
from gyrocal_ros.report.summary import (
    summarise,
    summarise_comparison,
    summarise_diagnosis,
)


def write_report(
    run: Run,
    calibration: Calibration,
    folder: Path,
    findings: Sequence[tuple[str, str]] = (),
    overwrite: bool = False,
) -> None:
    """Write everything a run has to say into one folder, all of it or nothing.

    Args:
        run: a finished run.
        calibration: what it has found.
        folder: where to; made where missing.
        findings: severity and text of what is odd about the recording.
        overwrite: allow a folder that holds files already.

    Raises:
        GyrocalError: the folder holds files and may not be written, or cannot be made.
    """
    with new_folder(folder, overwrite=overwrite) as part:
        fill(part, run, calibration, findings)


def fill(folder: Path, run: Run, calibration: Calibration, findings: Sequence[tuple[str, str]] = ()) -> None:
    """Write the files of a report into an empty folder; for callers who hold a `new_folder` open."""
    save_calibration(calibration, run.config, folder / 'calibration.yaml')
    texts = {
        'model.yaml': model_to_yaml(run.model),
        'settings.yaml': to_yaml(run.config),
        'summary.json': json_text(summarise(run, calibration)),
        'trajectory.txt': slam_trajectory(run),
        'trajectory_gyro.txt': gyro_trajectory(run),
        'report.html': report_page(run, calibration, findings),
    }
    for name, text in texts.items():
        write_text_atomic(folder / name, text)


def fill_diagnosis(
    folder: Path, searched: Search, diagnosis: Diagnosis, findings: Sequence[tuple[str, str]] = ()
) -> None:
    """Write what a diagnosis has found into an empty folder: the page, and the same for programs."""
    texts = {
        'diagnosis.json': json_text(summarise_diagnosis(searched, diagnosis)),
        'report.html': diagnosis_page(searched, diagnosis, findings),
    }
    for name, text in texts.items():
        write_text_atomic(folder / name, text)


def fill_comparison(folder: Path, comparison: Comparison, findings: Sequence[tuple[str, str]] = ()) -> None:
    """Write how models compare into an empty folder: the page, and the same for programs."""
    texts = {
        'comparison.json': json_text(summarise_comparison(comparison)),
        'report.html': comparison_page(comparison, findings),
    }
    for name, text in texts.items():
        write_text_atomic(folder / name, text)


def fill_improvement(folder: Path, improved: Improvement, findings: Sequence[tuple[str, str]] = ()) -> None:
    """Write the history of an improvement into an empty folder, and the page."""
    fill_history(folder, improved)
    write_text_atomic(folder / 'report.html', improvement_page(improved, findings))


def draw_figures(folder: Path, sections: Iterable[Section]) -> None:
    """Draw the figures of a page into `figures/`, `NAME.png` each.

    Raises:
        GyrocalError: this machine has no browser that could draw them.
    """
    (folder / 'figures').mkdir()
    save_png({section.name: section.figure for section in sections}, folder / 'figures')


def slam_trajectory(run: Run) -> str:
    """The path by SLAM in TUM format."""
    mean = run.history.mean
    return _tum(run.history.t_ns, mean[:, POSITION], mean[:, EULER])


def gyro_trajectory(run: Run) -> str:
    """The path by calibrated gyro and wheels alone in TUM format, on a level floor."""
    path = dead_reckoning(run, run.state.coefficients, float(run.state.bias_rad_s[2]))
    zeros = np.zeros(len(path.yaw_rad))
    position, euler = np.column_stack([path.position_m, zeros]), np.column_stack([zeros, zeros, path.yaw_rad])
    return _tum(run.history.t_ns, position, euler)


def _tum(t_ns: IntArray, position_m: Array, euler_rad: Array) -> str:
    """Lines of time (s), position (m) and attitude: t x y z qx qy qz qw."""
    poses = np.concatenate([position_m, quaternions(euler_rad)], axis=1).tolist()
    form = '{}.{:09d} {:.6f} {:.6f} {:.6f} {:.9f} {:.9f} {:.9f} {:.9f}\n'.format
    lines = [form(*divmod(stamp, NS_PER_S), *pose) for stamp, pose in zip(t_ns.tolist(), poses, strict=True)]
    return '# t x y z qx qy qz qw\n' + ''.join(lines)
