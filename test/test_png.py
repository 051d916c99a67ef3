"""Figures as PNG pictures; a machine without kaleido gets a message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli.figures import draw_if_requested
from gyrocal_ros.cli.main import main
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.report import png
from gyrocal_ros.report.effect import curves
from gyrocal_ros.report.html import Section

FIGURE = curves('A line', 'x (s)', 'y (deg)', np.arange(3.0), {'it': np.arange(3.0)})


def test_without_kaleido_the_error_names_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(png, 'find_spec', lambda _: None)
    with pytest.raises(GyrocalError, match='pip install') as caught:
        png.save_png({'line': FIGURE}, tmp_path)
    assert 'button that saves it' in str(caught.value) and not any(tmp_path.iterdir())


def test_a_command_continues_without_pictures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(png, 'find_spec', lambda _: None)
    draw_if_requested(True, tmp_path, [Section('line', FIGURE, '')])
    assert 'warning: figures cannot be drawn' in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize('command', ['replay', 'diagnose', 'improve'])
def test_pictures_that_cannot_be_drawn_are_refused_before_the_work(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(png, 'find_spec', lambda _: None)
    out = tmp_path / 'out'
    assert main([command, 'no_bag', '--png', '-o', str(out)]) == 2
    assert 'kaleido is missing; `pip install' in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_pictures_need_a_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['replay', 'no_bag', '--png']) == 2
    assert '--png: needs a folder for the pictures; give one with -o' in capsys.readouterr().err


def test_nothing_is_drawn_unless_requested(tmp_path: Path) -> None:
    def never() -> list[Section]:
        raise AssertionError

    draw_if_requested(False, tmp_path, (section for _ in (1,) for section in never()))
    assert not any(tmp_path.iterdir())


def test_a_picture_has_the_name_and_height_of_its_figure(tmp_path: Path) -> None:
    (order,) = png._orders({'line': FIGURE}, tmp_path)
    assert order['path'] == str(tmp_path / 'line.png') and order['opts']['height'] == FIGURE.layout.height
    assert order['fig'].layout.paper_bgcolor == 'white' != FIGURE.layout.paper_bgcolor
