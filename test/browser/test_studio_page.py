"""The page of the studio in a real browser."""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit
from zipfile import ZipFile

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import CHROMIUM
from playwright.sync_api import Browser, Page, expect, sync_playwright
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError
from studio_parts import HIDDEN, SIZE, write_image_bag

FLAGS = (
    '--no-sandbox',
    '--disable-gpu',
    '--disable-background-networking',
    '--disable-sync',
    '--no-first-run',
)
LAPTOP, TABLET = {'width': 1440, 'height': 900}, {'width': 820, 'height': 1180}
SIZES = ((1440, 900), (1920, 1080), (800, 1100))
"""Widths and heights of windows: a laptop, a desk, and a small one."""
THEMES: tuple[Literal['light', 'dark'], ...] = ('light', 'dark')
TIMEOUT_MS = 60_000
GYROCAL = (sys.executable, '-m', 'gyrocal_ros.cli.main')
SCREENSHOTS = os.environ.get('GYROCAL_SCREENSHOTS')
"""Folder for the screenshots of the documentation, if they are to be taken."""
expect.set_options(timeout=TIMEOUT_MS)


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()


class Studio:
    """A studio, started by the command."""

    def __init__(self, *bags: Path, out: Path) -> None:
        self.out = out
        command = [*GYROCAL, 'studio', *map(str, bags), '-o', str(out), '--port', '0', '--no-browser']
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        printed = self._process.stderr.readline()
        found = re.search(r'http://127\.0\.0\.1:\d+/', printed)
        assert found, printed
        self.address = found[0]

    def kill(self) -> None:
        self._end_by(signal.SIGKILL)

    def end(self) -> None:
        self._end_by(signal.SIGTERM)

    def _end_by(self, sent: signal.Signals) -> None:
        with self._process:  # closes what it prints to, too
            self._process.send_signal(sent)
            self._process.wait(20)


@pytest.fixture(scope='module')
def studio(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    studio = Studio(uneven_bag, out=tmp_path_factory.mktemp('studio'))
    yield studio
    studio.end()


@pytest.fixture
def page(browser: Browser, studio: Studio) -> Iterator[Page]:
    page = browser.new_page(viewport=LAPTOP)
    page.set_default_timeout(TIMEOUT_MS)
    yield page
    page.close()


def open_with_effect(page: Page, studio: Studio, *, present: bool) -> None:
    """Open the page with the hidden effect in the present model, or in a revision that was left."""
    row = page.locator('#revisions tr', has_text=f'1_{HIDDEN}')
    page.goto(studio.address)
    expect(page.locator('#revisions')).to_contain_text('0_default')
    if row.count() and present == ('present' in row.inner_text()):
        return
    if not row.count() or present:
        expect(page.locator('#add')).to_have_text(f'Add {HIDDEN}')
        page.locator('#add').click()
        expect(row).to_contain_text('present')
    if not present:
        page.locator('#undo').click()
        expect(row).to_contain_text('removed again')


def drift_deg(page: Page, label: str) -> float:
    """Return the held-out drift of a revision on the page."""
    row = page.locator('#revisions tr', has_text=label)
    return float(row.locator('td').nth(1).inner_text().split()[0])


def screenshot(page: Page, name: str, part: str = '') -> None:
    """Take a screenshot of the page from its top, or of a part of it, if screenshots are to be taken."""
    if SCREENSHOTS:
        page.wait_for_timeout(1500)
        page.evaluate('window.scrollTo(0, 0)')
        path = str(Path(SCREENSHOTS) / f'studio_{name}.png')
        page.locator(part).screenshot(path=path) if part else page.screenshot(path=path)


BELOW_THE_SCREEN = """
([names, height]) => names.filter((name) => {
  const part = document.querySelector(name);
  if (!part) return false;
  const box = part.getBoundingClientRect();
  return box.height === 0 || box.bottom > height;
})
"""
"""Those of some parts that are not on a screen of this height; read at once, since the page may change."""


def parts_below_the_screen(page: Page) -> list[str]:
    """Return what decides about an effect and is not on the screen of a laptop without scrolling."""
    names = ['#bag', '#model-figure', '#residual-figure', '#verdict', '#add', '#forecast', '#history-figure']
    found: list[str] = page.evaluate(BELOW_THE_SCREEN, [names, LAPTOP['height']])
    return found


OVERLAPS = """
() => {
  const found = [];
  for (const name of ['model-figure', 'residual-figure', 'history-figure']) {
    const texts = [...document.querySelectorAll(`#${name} svg text`)].filter(
      (text) => text.textContent.trim() && text.getBoundingClientRect().width > 0);
    const boxes = texts.map((text) => [text.textContent, text.getBoundingClientRect()]);
    const frame = document.querySelector(`#${name}`).getBoundingClientRect();
    boxes.forEach(([first, a], number) => {
      if (a.left < frame.left - 2 || a.right > frame.right + 2) found.push(`${name}: ${first} is clipped`);
      for (const [second, b] of boxes.slice(number + 1)) {
        const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (wide > 3 && high > 4) found.push(`${name}: ${first} over ${second}`);
      }
    });
  }
  for (const table of document.querySelectorAll('#revisions .wide')) {
    if (table.scrollWidth > table.clientWidth + 1) found.push('a column of the revisions is cut off');
  }
  if (document.documentElement.scrollWidth > window.innerWidth) found.push('the page is too wide');
  return found;
}
"""
"""Texts of the figures that overlap or are clipped, and tables that are cut off."""


def assert_nothing_overlaps(page: Page, name: str) -> None:
    """Look at the page in windows of all sizes, light and dark."""
    for width, height in SIZES:
        page.set_viewport_size({'width': width, 'height': height})
        page.wait_for_timeout(500)  # the figures follow the window
        for theme in THEMES:
            page.emulate_media(color_scheme=theme)
            assert page.evaluate(OVERLAPS) == [], (width, theme)
            chart = page.locator('#history-figure').bounding_box()
            assert chart is not None and chart['height'] >= 200.0, (width, theme)
            screenshot(page, f'{name}_{width}_{theme}')


DROP = """
([name, content]) => {
  const bytes = Uint8Array.from(atob(content), (one) => one.charCodeAt(0));
  const dropped = new DataTransfer();
  dropped.items.add(new File([bytes], name));
  document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: dropped, bubbles: true }));
}
"""
"""Drops a file on the page."""
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


def barriers(page: Page) -> list[str]:
    """Return what serious obstacles to people with disabilities axe-core finds on the page.

    Left out is the hidden field of a menu of Dash: it hands the focus on to the button of the menu.
    """
    found = Axe().run(page, context={'exclude': ['.dash-dropdown-focus-target']}).response['violations']
    return [
        f'{one["id"]}: {one["nodes"][0]["html"]}' for one in found if one['impact'] in ('serious', 'critical')
    ]


def hover_until(page: Page, selector: str, condition: str) -> None:
    """Point at an element until a condition holds: while a page loads it is redrawn under the pointer."""
    for _ in range(5):
        page.mouse.move(0, 0)
        page.locator(selector).hover()
        with suppress(PlaywrightTimeoutError):
            page.wait_for_function(condition, timeout=10_000)
            return
    raise AssertionError(f'nothing happens where the pointer is on {selector}')


def test_all_parts_of_the_page(page: Page, studio: Studio) -> None:
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


def test_an_unknown_law_is_learned_shown_added_and_removed(
    browser: Browser, strange_bag: Path, uneven_bag: Path, tmp_path: Path
) -> None:
    law, studio = 'bias_curve:heading', Studio(strange_bag, uneven_bag, out=tmp_path)
    page = browser.new_page(viewport=LAPTOP)
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(studio.address)
    expect(page.locator('#learn')).to_be_enabled()
    page.locator('#learn').click()
    expect(page.locator('#verdict')).to_contain_text(f'Learned {law}')
    expect(page.locator('#residual-figure')).to_contain_text(f'by {law}, if added')
    expect(page.locator('#residual-figure')).to_contain_text('closed form that fits')
    expect(page.locator('#card')).to_contain_text('sine of the heading')
    expect(page.locator('#learn')).to_be_disabled()
    assert not parts_below_the_screen(page)
    screenshot(page, 'learned')
    page.locator('#add').click()
    expect(page.locator('#revisions')).to_contain_text('1_bias_curve_heading')
    assert drift_deg(page, '1_bias_curve_heading') < 0.1 * drift_deg(page, '0_default')

    # on the recording of another robot
    page.locator('#test summary').click()
    page.locator('#other').click()
    page.get_by_role('option', name='uneven', exact=True).click()
    page.locator('#validate').click()
    expect(page.locator('#validation')).to_contain_text('training: strange; test: uneven')
    expect(page.locator('#validation')).to_contain_text('1_bias_curve_heading')
    assert_nothing_overlaps(page, 'learned')
    assert not barriers(page)
    screenshot(page, 'validated', '#history')
    page.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text='1_bias_curve_heading')).to_contain_text('removed again')
    page.close()
    studio.end()


def test_a_bag_with_images_is_dropped_on_the_page_and_diagnosed(
    browser: Browser, strange_bag: Path, tmp_path: Path
) -> None:
    (file,) = write_image_bag(tmp_path).glob('*.mcap')
    studio = Studio(strange_bag, out=tmp_path / 'out')
    page = browser.new_page(viewport=LAPTOP)
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(studio.address)
    expect(page.locator('#title')).to_have_text('strange')
    with page.expect_file_chooser() as chooser:
        page.locator('#upload').click()
    chooser.value.set_files({'name': 'notes.mcap', 'mimeType': '', 'buffer': b'no bag'})
    expect(page.locator('#upload-state')).to_contain_text('notes.mcap')
    page.evaluate(DROP, [file.name, base64.b64encode(file.read_bytes()).decode()])
    expect(page.locator('#title')).to_have_text(file.name)
    expect(page.locator('#bag-words')).to_contain_text('image_raw')
    expect(page.locator('#verdict')).to_contain_text(f'Missing: {HIDDEN}')
    page.locator('#add').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('present')
    assert drift_deg(page, f'1_{HIDDEN}') < 0.2 * drift_deg(page, '0_default')
    assert_nothing_overlaps(page, 'images')
    page.close()
    studio.end()


def test_the_error_left_over_is_shown_against_any_signal(page: Page, studio: Studio) -> None:
    page.goto(studio.address)
    expect(page.locator('#residual-figure')).to_contain_text('error of the')
    page.locator('#signal').click()
    page.get_by_role('option', name='temperature (deg C) - bias').click()
    expect(page.locator('#residual-figure')).to_contain_text('temperature (deg C)')
    for kind, text in (
        ('drift', 'Drift span by span'),
        ('innovations', 'NIS'),
        ('coefficients', 'Coefficients'),
    ):
        page.locator(f'#kind input[value={kind}]').check()
        expect(page.locator('#model-figure')).to_contain_text(text)


def test_second_tabs_and_reloads_show_the_same_session(browser: Browser, page: Page, studio: Studio) -> None:
    open_with_effect(page, studio, present=True)
    second = browser.new_page(viewport=TABLET, color_scheme='dark')
    second.goto(studio.address)
    expect(second.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    second.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('removed again')
    page.reload()
    expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
    screenshot(second, 'tablet_dark', '#missing')
    second.close()


def test_the_theme_can_be_changed_and_the_page_fits_a_tablet(page: Page, studio: Studio) -> None:
    page.set_viewport_size(TABLET)
    page.goto(studio.address)
    expect(page.locator('#revisions')).to_contain_text('0_default')
    background = 'getComputedStyle(document.body).backgroundColor'
    light = page.evaluate(background)
    page.locator('#theme-button').click()
    expect(page.locator('html')).to_have_class('dark')
    assert page.evaluate(background) != light
    assert page.evaluate('document.documentElement.scrollWidth') <= TABLET['width']


def test_nothing_overlaps_or_is_clipped(page: Page, studio: Studio) -> None:
    page.goto(studio.address)
    for name in ('model-figure', 'residual-figure', 'history-figure'):
        expect(page.locator(f'#{name} svg text').first).to_be_visible()
    assert_nothing_overlaps(page, 'feature')


def test_all_controls_can_be_reached_by_the_keyboard(page: Page, studio: Studio) -> None:
    page.goto(studio.address)
    expect(page.locator('.candidate')).not_to_have_count(0)
    reached = set()
    for _ in range(80):
        page.keyboard.press('Tab')
        reached |= set(page.evaluate('[document.activeElement.id, document.activeElement.className]'))
    controls = {'theme-button', 'signal', 'candidate', 'write', 'export', 'riddle', 'guess', 'reveal'}
    assert controls <= reached


def test_a_killed_studio_is_reported_and_a_new_one_continues_its_session(
    browser: Browser, uneven_bag: Path, tmp_path: Path
) -> None:
    studio, page = Studio(uneven_bag, out=tmp_path), browser.new_page()
    page.set_default_timeout(TIMEOUT_MS)
    open_with_effect(page, studio, present=False)
    expect(page.locator('#gone')).to_be_empty()
    studio.kill()
    expect(page.locator('#gone')).to_contain_text('does not answer')
    again = Studio(uneven_bag, out=tmp_path)
    page.goto(again.address)
    expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('removed again')
    page.close()
    again.end()
