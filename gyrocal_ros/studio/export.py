"""The report of a session, to be sent to a colleague: pages that need nothing else, pictures, the models."""

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


def export(view: StudioState, folder: Path) -> str:
    """Write `report/` into the folder of a session; returns what a person should know of it.

    It holds the history with all models, `report.html` about it, `present/report.html` about what the
    present model still lacks, and `figures/` as pictures where this machine can draw them.

    Raises:
        GyrocalError: nothing has run yet, or it cannot be written.
    """
    improved, contents, recorded = view.improvement, view.contents, view.recorded
    if improved is None or contents is None or recorded is None:
        raise GyrocalError('the model has not run yet', where='report', todo='wait a moment')
    remark = ''
    with new_folder(folder / NAME, overwrite=True) as part:
        fill_improvement(part, improved, contents.findings)
        searched = Search(improved.final.examined, ())
        (part / 'present').mkdir()
        fill_diagnosis(part / 'present', searched, diagnose(searched, recorded), contents.findings)
        (part / 'figures').mkdir()
        try:
            save_png(pictures.all_of(view), part / 'figures')
        except GyrocalError as error:
            remark = f' {error}.'
    return f'The report is in {folder / NAME}.{remark}'
