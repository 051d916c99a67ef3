"""For tests of the page of the studio: a browser, a studio started by the command, and looks at the page."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Literal

from axe_playwright_python.sync_playwright import Axe
from conftest import CHROMIUM
from playwright.sync_api import Browser, Page, expect, sync_playwright

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


@contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()


def new_page(browser: Browser) -> Page:
    page = browser.new_page(viewport=LAPTOP)
    page.set_default_timeout(TIMEOUT_MS)
    return page


def on_a_laptop(page: Page) -> Page:
    """Return a page as a test expects it that shares it with others: on the screen of a laptop, light."""
    page.set_viewport_size(LAPTOP)
    page.emulate_media(color_scheme='light')
    return page


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

    def __enter__(self) -> Studio:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_by(signal.SIGTERM)

    def kill(self) -> None:
        self._end_by(signal.SIGKILL)

    def _end_by(self, sent: signal.Signals) -> None:
        with self._process:  # closes what it prints to, too
            self._process.send_signal(sent)
            self._process.wait(20)


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


FITTED = """
() => [...document.querySelectorAll('.js-plotly-plot')].every((plot) =>
  plot.clientWidth === 0 || Math.abs(plot._fullLayout.width - plot.clientWidth) <= 1)
"""
"""True if the figures have the width that the window leaves them."""


def assert_nothing_overlaps(page: Page, name: str) -> None:
    """Look at the page in windows of all sizes, light and dark."""
    for width, height in SIZES:
        page.set_viewport_size({'width': width, 'height': height})
        page.wait_for_function(FITTED)
        for theme in THEMES:
            page.emulate_media(color_scheme=theme)
            assert page.evaluate(OVERLAPS) == [], (width, theme)
            chart = page.locator('#history-figure').bounding_box()
            assert chart is not None and chart['height'] >= 200.0, (width, theme)
            screenshot(page, f'{name}_{width}_{theme}')


def barriers(page: Page) -> list[str]:
    """Return what serious obstacles to people with disabilities axe-core finds on the page.

    Left out is the hidden field of a menu of Dash: it hands the focus on to the button of the menu.
    """
    found = Axe().run(page, context={'exclude': ['.dash-dropdown-focus-target']}).response['violations']
    return [
        f'{one["id"]}: {one["nodes"][0]["html"]}' for one in found if one['impact'] in ('serious', 'critical')
    ]
