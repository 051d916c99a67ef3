"""The report of a session: pages that need no other file, figures as PNG, models and calibrations."""

from __future__ import annotations

from pathlib import Path

from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search import Search
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import new_folder
from gyrocal_ros.report.png import save_png
from gyrocal_ros.report.write import fill_diagnosis, fill_improvement
from gyrocal_ros.studio import pictures
from gyrocal_ros.studio.state import StudioState

NAME = 'report'


def export(state: StudioState, folder: Path) -> str:
    """Write `report/` into the folder of a session; return a message to the user.

    It contains the history with all models, `report.html` about it, `present/report.html` about the
    effects that the present model still lacks, and `figures/` as PNG if this machine can draw them.

    Raises:
        GyrocalError: the model has not run yet, or the report cannot be written.
    """
    improved, contents, recorded = state.improvement, state.contents, state.recorded
    if improved is None or contents is None or recorded is None:
        raise GyrocalError('the model has not run yet', where='report', todo='wait a moment')
    remark = ''
    with new_folder(folder / NAME, overwrite=True) as part:
        fill_improvement(part, improved, contents.issues)
        searched = Search(improved.final.examined, ())
        (part / 'present').mkdir()
        fill_diagnosis(part / 'present', searched, diagnose(searched, recorded), contents.issues)
        (part / 'figures').mkdir()
        try:
            save_png(pictures.all_figures(state), part / 'figures')
        except GyrocalError as error:
            remark = f' {error}.'
    return f'The report is in {folder / NAME}.{remark}'
