"""Result folders of the commands: pages for people, files for programs and for a later run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shutil import rmtree

from gyrocal_ros.config.declare import to_yaml
from gyrocal_ros.data import NS_PER_S, IntArray
from gyrocal_ros.diagnose.analysis.comparison import Comparison
from gyrocal_ros.diagnose.analysis.drift import dead_reckoning
from gyrocal_ros.diagnose.diagnosis import Diagnosis
from gyrocal_ros.diagnose.json_summary import (
    merit,
    summarise,
    summarise_comparison,
    summarise_diagnosis,
    summarise_improvement,
)
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import Improvement, Revision
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import EULER, POSITION
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import json_text, write_text_atomic
from gyrocal_ros.msgs.transforms import quaternion_from_euler
from gyrocal_ros.pipeline.calibration import Calibration, conclude, save_calibration
from gyrocal_ros.report.calibration import calibration_page
from gyrocal_ros.report.comparison import comparison_page
from gyrocal_ros.report.diagnosis import diagnosis_page
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.improvement import improvement_page
from gyrocal_ros.report.png import save_png

Rows = Sequence[Sequence[float]]
Findings = Sequence[tuple[str, str]]
"""Severity and text of the issues of the recording."""


def fill_calibration(folder: Path, run: Run, calibration: Calibration, findings: Findings = ()) -> None:
    """Write the results of a calibration into an empty folder, such as an open `new_folder`."""
    save_calibration(calibration, run.config, folder / 'calibration.yaml')
    texts = {
        'model.yaml': model_to_yaml(run.model),
        'settings.yaml': to_yaml(run.config),
        'summary.json': json_text(summarise(run, calibration)),
        'trajectory.txt': slam_trajectory(run),
        'trajectory_gyro.txt': gyro_trajectory(run),
        'report.html': calibration_page(run, calibration, findings),
    }
    _write(folder, texts)


def fill_diagnosis(folder: Path, searched: Search, diagnosis: Diagnosis, findings: Findings = ()) -> None:
    """Write the results of a diagnosis into an empty folder."""
    summary = summarise_diagnosis(searched, diagnosis)
    page = diagnosis_page(searched, diagnosis, findings)
    _write(folder, {'diagnosis.json': json_text(summary), 'report.html': page})


def fill_comparison(folder: Path, comparison: Comparison, findings: Findings = ()) -> None:
    """Write the results of a comparison into an empty folder."""
    summary, page = summarise_comparison(comparison), comparison_page(comparison, findings)
    _write(folder, {'comparison.json': json_text(summary), 'report.html': page})


def fill_improvement(
    folder: Path, improved: Improvement, findings: Findings = (), laws: Sequence[LearnedLaw] = ()
) -> None:
    """Write the page, every revision, kept or left out, and the final model into an empty folder."""
    for revision in improved.revisions:
        fill_revision(folder / revision.label, revision)
    fill_result(folder, improved)
    _write(folder, {'report.html': improvement_page(improved, findings, laws)})


def fill_revision(folder: Path, revision: Revision) -> None:
    """Write one revision into an empty folder: its model, calibration and figures of merit."""
    _write_model(folder, revision.examined.run)
    _write(folder, {'merit.json': json_text(merit(revision))})


def fill_result(folder: Path, improved: Improvement) -> None:
    """Write the final model, its calibration, and the figures of merit of all revisions."""
    _write_model(folder, improved.final.examined.run)
    _write(folder, {'history.json': json_text(summarise_improvement(improved))})


def draw_figures(folder: Path, sections: Iterable[Section]) -> None:
    """Draw the figures of a page into `figures/`, `NAME.png` each.

    Raises:
        GyrocalError: this machine has no browser that can draw them.
    """
    figures = folder / 'figures'
    figures.mkdir()
    try:
        save_png({section.name: section.figure for section in sections}, figures)
    except GyrocalError:
        rmtree(figures)
        raise


def slam_trajectory(run: Run) -> str:
    """Return the trajectory by SLAM in TUM format."""
    mean = run.history.mean
    return _tum(run.history.t_ns, mean[:, POSITION].tolist(), mean[:, EULER].tolist())


def gyro_trajectory(run: Run) -> str:
    """Return the trajectory by calibrated gyro and wheels alone in TUM format, on a level floor."""
    path = dead_reckoning(run, run.state.coefficients, float(run.state.bias_rad_s[2]))
    positions = [[x, y, 0.0] for x, y in path.position_m.tolist()]
    return _tum(run.history.t_ns, positions, [[0.0, 0.0, yaw] for yaw in path.yaw_rad.tolist()])


def _tum(t_ns: IntArray, positions_m: Rows, eulers_rad: Rows) -> str:
    """Format lines of time (s), position (m) and attitude: t x y z qx qy qz qw."""
    form = '{}.{:09d} {:.6f} {:.6f} {:.6f} {:.9f} {:.9f} {:.9f} {:.9f}\n'.format
    lines = [
        form(*divmod(stamp, NS_PER_S), *position, *quaternion_from_euler(*euler))
        for stamp, position, euler in zip(t_ns.tolist(), positions_m, eulers_rad, strict=True)
    ]
    return '# t x y z qx qy qz qw\n' + ''.join(lines)


def _write_model(folder: Path, run: Run) -> None:
    _write(folder, {'model.yaml': model_to_yaml(run.model)})
    save_calibration(conclude(run), run.config, folder / 'calibration.yaml')


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        write_text_atomic(folder / name, text)
