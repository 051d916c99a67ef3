"""All parts of the page of the studio in a real browser, from the diagnosis to the report."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit
from zipfile import ZipFile

import pytest
from playwright.sync_api import Page, expect
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError
from studio_browser import (
    THEMES,
    Studio,
    barriers,
    chromium,
    drift_deg,
    new_page,
    parts_below_the_screen,
    screenshot,
)
from studio_parts import HIDDEN, SIZE

PLACES_MARKED = """
() => ['model-figure', 'residual-figure'].every((name) =>
  document.querySelector(`#${name} .js-plotly-plot`).layout.shapes.some((shape) => shape.name === 'place'))
"""
"""True if a place is marked in both figures."""
SAME_ZOOM = """
() => {
  const [[from, to], other] = ['model-figure', 'compare-figure'].map(
    (name) => document.querySelector(`#${name} .js-plotly-plot`).layout.xaxis.range);
  return from > 10 && to < 70 && Math.abs(from - other[0]) < 0.01 && Math.abs(to - other[1]) < 0.01;
}
"""
"""True if the figures of the model and of the comparison show the same part of the recording."""


def hover_until(page: Page, selector: str, condition: str) -> None:
    """Point at an element until a condition holds: while a page loads it is redrawn under the pointer."""
    for _ in range(5):
        page.mouse.move(0, 0)
        page.locator(selector).hover()
        with suppress(PlaywrightTimeoutError):
            page.wait_for_function(condition, timeout=10_000)
            return
    raise AssertionError(f'nothing happens where the pointer is on {selector}')


def test_all_parts_of_the_page(uneven_bag: Path, tmp_path: Path) -> None:
    with chromium() as browser, Studio(uneven_bag, out=tmp_path) as studio:
        look_at_all_parts(new_page(browser), studio)


def look_at_all_parts(page: Page, studio: Studio) -> None:
    hosts: set[str] = set()
    errors: list[str] = []
    page.on('request', lambda request: hosts.add(urlsplit(request.url).netloc))
    page.on('console', lambda entry: errors.append(entry.text) if entry.type == 'error' else None)
    page.goto(studio.address)

    # contents of the bag, and the worst stretch
    expect(page.locator('#bag-words')).to_contain_text('100 s')
    expect(page.locator('#verdict')).to_contain_text(f'Missing: {HIDDEN}')
    figure = page.locator('#model-figure')
    expect(figure).to_contain_text('less the observed heading')
    expect(figure).to_contain_text('worst without camera')
    expect(figure.locator('.annotation-text', has_text=re.compile('^1$'))).to_have_count(1)
    expect(page.locator('#failures')).to_contain_text('turning')
    expect(page.locator('#residual-figure')).to_be_visible()
    assert not parts_below_the_screen(page)
    screenshot(page, 'fails')

    # the worst place is marked in all figures while the pointer is on it
    hover_until(page, '#failures summary', PLACES_MARKED)
    page.mouse.move(0, 0)
    page.wait_for_function(f'() => !({PLACES_MARKED})()')

    # description of a candidate
    candidate = page.locator('.candidate', has_text=HIDDEN)
    candidate.focus()
    page.keyboard.press('Enter')
    expect(candidate).to_have_attribute('aria-pressed', 'true')
    expect(page.locator('#candidate-name')).to_have_text(HIDDEN)
    expect(page.locator('#card')).to_contain_text('equation')
    expect(page.locator('#forecast')).to_contain_text('from')
    forecast = page.locator('#forecast').inner_text()

    # adding it reduces the held-out error; test_studio_session.py compares it with that of the command
    page.locator('#add').click()
    expect(page.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    labels, folder = ('0_default', f'1_{HIDDEN}'), studio.out / 'uneven'
    merits = [json.loads((folder / label / 'merit.json').read_text()) for label in labels]
    expected = [one['held_out_drift_deg']['rms'] for one in merits]
    shown = [drift_deg(page, label) for label in labels]
    assert shown == [pytest.approx(one, abs=0.0051) for one in expected]
    assert forecast == f'from {shown[0]:.2f} to {shown[1]:.2f} deg' and shown[1] < 0.1 * shown[0]
    expect(page.locator('#history-figure')).to_contain_text('held out')
    expect(figure).to_contain_text('the present model')
    assert not parts_below_the_screen(page)
    screenshot(page, 'added')
    screenshot(page, 'falling', '#history')

    # undo, and adding it again
    page.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('removed again')
    expect(page.locator('#undo')).to_be_disabled()
    expect(page.locator('#add')).to_have_text(f'Add {HIDDEN}')
    page.locator('#add').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('present')

    # comparison of the two revisions
    page.locator('#compare summary').click()
    expect(page.locator('#compare-figure')).to_contain_text('0_default')
    page.locator('#compare-figure').scroll_into_view_if_needed()
    box = page.locator('#compare-figure .nsewdrag').first.bounding_box()
    assert box is not None
    middle = box['y'] + 0.5 * box['height']
    page.mouse.move(box['x'] + 0.2 * box['width'], middle)
    page.mouse.down()
    page.mouse.move(box['x'] + 0.6 * box['width'], middle, steps=3)
    page.mouse.up()
    page.wait_for_function(SAME_ZOOM)
    page.locator('#compare-kind input[value=drift]').check()
    expect(page.locator('#compare-figure')).to_contain_text('Drift span by span')

    # results and report
    page.locator('#write').click()
    expect(page.locator('#message')).to_contain_text('model.yaml and calibration.yaml are in')
    page.locator('#export').click()
    expect(page.locator('#message')).to_contain_text('The report is in')
    with page.expect_download() as packed:
        page.locator('#downloads a', has_text='report.zip').click()
    assert packed.value.suggested_filename == 'uneven_report.zip'
    with ZipFile(packed.value.path()) as archive:
        assert 'report/report.pdf' in archive.namelist() and archive.testzip() is None
    expect(page.locator('#downloads')).to_contain_text('report.pdf')
    assert HIDDEN in (folder / 'model.yaml').read_text()
    assert HIDDEN in (folder / 'report' / 'report.html').read_text()
    if find_spec('kaleido'):
        png = (folder / 'report' / 'figures' / 'heading.png').read_bytes()
        assert png.startswith(b'\x89PNG') and len(png) > 20_000

    # the answer
    page.locator('#guess').click()
    page.get_by_role('option', name=HIDDEN, exact=True).click()
    page.locator('#reveal').click()
    expect(page.locator('#truth')).to_contain_text(f'Hidden: {HIDDEN}. Your guess was right.')
    expect(page.locator('#truth-words table')).to_contain_text(f'{SIZE:g}')
    assert hosts <= {urlsplit(studio.address).netloc, ''}, 'the page needs no other server'
    assert not errors

    # for everybody: the page and its report
    for theme in THEMES:
        page.emulate_media(color_scheme=theme)
        assert not barriers(page), theme
    page.goto((folder / 'report' / 'report.html').as_uri())
    assert not barriers(page)
