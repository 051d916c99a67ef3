"""A page as PDF, printed by a Chromium or Chrome of this machine. How it looks is in the style of `html`."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.report.html import PAPER_WIDTH_PX

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome')
VARIABLE = 'BROWSER_PATH'
"""Environment variable with the path of the browser, which kaleido reads too."""
FLAGS = (
    '--headless',
    '--disable-gpu',
    '--disable-dev-shm-usage',
    '--disable-background-networking',
    '--disable-sync',
    '--no-first-run',
    '--no-sandbox',  # it fails in containers, and the page is ours and loads nothing
    '--no-pdf-header-footer',
    f'--window-size={PAPER_WIDTH_PX},1300',  # as wide as the paper, so that figures keep their size
)
TIMEOUT_S = 180.0
REMEDY = f'install Chromium, or set {VARIABLE}; or omit --pdf, and print report.html from any browser'


def find_browser() -> str:
    """Return the path of an installed browser that can print.

    Raises:
        GyrocalError: there is none.
    """
    for name in (os.environ.get(VARIABLE), *BROWSERS):
        found = shutil.which(name) if name else None
        if found is not None:
            return found
    raise GyrocalError('a page cannot be printed as PDF: there is no Chromium or Chrome', todo=REMEDY)


def save_pdf(page: Path, pdf: Path) -> None:
    """Print a page to a file, which appears complete or not at all.

    Args:
        page: HTML file.
        pdf: file to write or to replace.

    Raises:
        GyrocalError: there is no browser, or it cannot print the page.
    """
    browser = find_browser()
    with TemporaryDirectory(dir=pdf.parent, prefix='.pdf_') as folder:
        printed = Path(folder) / 'page.pdf'
        places = (f'--user-data-dir={folder}/profile', f'--print-to-pdf={printed}', page.resolve().as_uri())
        try:
            subprocess.run([browser, *FLAGS, *places], capture_output=True, timeout=TIMEOUT_S, check=True)
        except (OSError, subprocess.SubprocessError) as error:
            raise GyrocalError(
                f'cannot print the page as PDF ({error})', where=browser, todo=REMEDY
            ) from error
        if not printed.is_file():
            raise GyrocalError('has printed nothing', where=browser, todo=REMEDY)
        printed.replace(pdf)
