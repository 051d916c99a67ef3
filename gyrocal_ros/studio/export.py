"""The report of a session: pages that need no other file, figures as PNG, models and calibrations."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.laws.learned_laws import learned_laws
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import new_folder
from gyrocal_ros.report.pdf import save_pdf
from gyrocal_ros.report.png import save_png
from gyrocal_ros.report.write import fill_diagnosis, fill_improvement
from gyrocal_ros.studio import pictures
from gyrocal_ros.studio.state import StudioState

NAME, PDF, ARCHIVE = 'report', 'report.pdf', 'report.zip'


def export(state: StudioState, folder: Path) -> str:
    """Write `report/` into the folder of a session; return a message to the user.

    It contains the history with all models, `report.html` about it, `present/report.html` about the
    effects that the present model still lacks, `figures/` as PNG and `report.pdf` if this machine can draw
    them. `report.zip`, beside it, contains all of it.

    Raises:
        GyrocalError: the model has not run yet, or the report cannot be written.
    """
    improved, contents, recorded = state.improvement, state.contents, state.recorded
    if improved is None or contents is None or recorded is None:
        raise GyrocalError('the model has not run yet', where='report', todo='wait a moment')
    remark = ''
    with new_folder(folder / NAME, overwrite=True) as part:
        laws = list(learned_laws(improved.final.examined))
        fill_improvement(part, improved, contents.issues, laws)
        searched = Search(improved.final.examined, ())
        (part / 'present').mkdir()
        fill_diagnosis(part / 'present', searched, diagnose(searched, recorded), contents.issues)
        (part / 'figures').mkdir()
        try:
            save_png(pictures.all_figures(state), part / 'figures')
        except GyrocalError as error:
            remark = f' {error}.'
        try:
            save_pdf(part / 'report.html', part / PDF)
        except GyrocalError as error:
            remark += f' {error}.'
    _pack(folder)
    return f'The report is in {folder / NAME}.{remark}'


def _pack(folder: Path) -> None:
    """Write the report as one file, which appears completely or not at all."""
    try:
        with TemporaryDirectory(dir=folder, prefix='.zip_') as work:
            packed = shutil.make_archive(f'{work}/{NAME}', 'zip', root_dir=folder, base_dir=NAME)
            Path(packed).replace(folder / ARCHIVE)
    except OSError as error:
        raise GyrocalError(f'cannot be written ({error.strerror})', where=str(folder / ARCHIVE)) from error
