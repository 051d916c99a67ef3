"""The history that an improvement leaves behind: one folder a revision, and the final model."""

from __future__ import annotations

from pathlib import Path

from gyrocal_ros.calibration import conclude, save_calibration
from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.files import json_text, write_text_atomic
from gyrocal_ros.report.summary import merit, summarise_improvement


def fill_history(folder: Path, improved: Improvement) -> None:
    """Write every revision, kept or not, and the final model into an empty folder.

    For callers who hold a `new_folder` open.
    """
    for revision in improved.revisions:
        _write_model(folder / revision.label, revision.stage.run)
        write_text_atomic(folder / revision.label / 'merit.json', json_text(merit(revision)))
    _write_model(folder, improved.final.stage.run)
    write_text_atomic(folder / 'history.json', json_text(summarise_improvement(improved)))


def _write_model(folder: Path, run: Run) -> None:
    write_text_atomic(folder / 'model.yaml', model_to_yaml(run.model))
    save_calibration(conclude(run), run.config, folder / 'calibration.yaml')
