"""The history that an improvement leaves behind: one folder a revision, and the final model."""

from __future__ import annotations

from pathlib import Path

from gyrocal_ros.diagnose.improvement import Improvement, Revision
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.files import json_text, write_text_atomic
from gyrocal_ros.pipeline.calibration import conclude, save_calibration
from gyrocal_ros.report.summary import merit, summarise_improvement


def fill_history(folder: Path, improved: Improvement) -> None:
    """Write every revision, kept or not, and the final model into an empty folder.

    For callers who hold a `new_folder` open.
    """
    for revision in improved.revisions:
        fill_revision(folder / revision.label, revision)
    fill_result(folder, improved)


def fill_result(folder: Path, improved: Improvement) -> None:
    """Write the final model, what was found of it, and the figures of the revisions for programs."""
    _fill_model(folder, improved.final.examined.run)
    write_text_atomic(folder / 'history.json', json_text(summarise_improvement(improved)))


def fill_revision(folder: Path, revision: Revision) -> None:
    """Write one revision into an empty folder: its model, calibration and figures of merit."""
    _fill_model(folder, revision.examined.run)
    write_text_atomic(folder / 'merit.json', json_text(merit(revision)))


def _fill_model(folder: Path, run: Run) -> None:
    write_text_atomic(folder / 'model.yaml', model_to_yaml(run.model))
    save_calibration(conclude(run), run.config, folder / 'calibration.yaml')
