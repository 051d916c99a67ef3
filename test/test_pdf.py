"""The report as PDF, printed by an installed browser, and its first page."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest
from conftest import CHROMIUM

from gyrocal_ros.cli.figures import print_if_requested
from gyrocal_ros.cli.main import main
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.report import pdf

PAGE = b'/Type /Page\n'
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason='needs Chromium')


@pytest.fixture
def no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('shutil.which', lambda _: None)


@pytest.fixture(scope='module')
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a short simulated recording."""
    folder = tmp_path_factory.mktemp('pdf')
    assert (
        main(['simulate', str(folder / 'bag'), '--scenario', 'cleaning', '--duration', '20', '--seed', '3'])
        == 0
    )
    assert main(['replay', str(folder / 'bag'), '-o', str(folder / 'result')]) == 0
    return folder / 'result'


@pytest.mark.usefixtures('no_browser')
@pytest.mark.parametrize('command', ['replay', 'diagnose', 'compare', 'improve', 'learn'])
def test_a_missing_browser_is_reported_before_the_work(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, 'no_bag', '--pdf', '-o', str(tmp_path / 'out')]) == 2
    assert 'there is no Chromium or Chrome; install Chromium' in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_pdf_needs_a_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['replay', 'no_bag', '--pdf']) == 2
    assert '--pdf: needs a folder for the report; give one with -o' in capsys.readouterr().err


def test_a_browser_that_fails_leaves_the_earlier_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(pdf.VARIABLE, 'false')
    (tmp_path / 'report.html').write_text('<p>page</p>')
    (tmp_path / 'report.pdf').write_bytes(b'earlier')
    with pytest.raises(GyrocalError, match='cannot print the page'):
        pdf.save_pdf(tmp_path / 'report.html', tmp_path / 'report.pdf')
    print_if_requested(True, tmp_path)
    assert 'warning: ' in capsys.readouterr().err
    assert (tmp_path / 'report.pdf').read_bytes() == b'earlier'
    assert {path.name for path in tmp_path.iterdir()} == {'report.html', 'report.pdf'}


def test_the_values_on_the_first_page_are_a_calibration(result: Path, tmp_path: Path) -> None:
    page = (result / 'report.html').read_text(encoding='utf-8')
    first = re.search(r'<section class="paper-only">(.*?)</section>', page, re.DOTALL)
    assert first is not None and '20 s' in first[1]
    values = re.search(r'<pre>(.*?)</pre>', first[1], re.DOTALL)
    assert values is not None
    copied = tmp_path / 'calibration.yaml'
    copied.write_text(html.unescape(values[1]), encoding='utf-8')
    given, written = load_calibration(copied), load_calibration(result / 'calibration.yaml')
    assert given.names == written.names and (given.values == written.values).all()
    assert (given.covariance == written.covariance).all()


@needs_browser
def test_a_page_is_printed_with_its_figures(result: Path, tmp_path: Path) -> None:
    pdf.save_pdf(result / 'report.html', tmp_path / 'report.pdf')
    content = (tmp_path / 'report.pdf').read_bytes()
    assert content.startswith(b'%PDF') and content.rstrip().endswith(b'%%EOF')
    assert content.count(PAGE) >= 4 and len(content) > 100_000
    assert [path.name for path in tmp_path.iterdir()] == ['report.pdf']
