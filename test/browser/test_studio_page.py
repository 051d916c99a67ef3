"""The whole loop in a real browser, as a person does it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from conftest import CHROMIUM
from playwright.sync_api import Browser, Page, expect, sync_playwright
from studio_parts import HIDDEN, SIZE

FLAGS = (
    '--no-sandbox',
    '--disable-gpu',
    '--disable-background-networking',
    '--disable-sync',
    '--no-first-run',
)
LAPTOP, TABLET = {'width': 1440, 'height': 900}, {'width': 820, 'height': 1180}
PATIENCE_MS = 60_000
PICTURES = os.environ.get('GYROCAL_SCREENSHOTS')
"""A folder for pictures of the page, where they are wanted for the documentation."""
expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()


class Studio:
    """A studio in a process of its own, as a person starts it."""

    def __init__(self, bag: Path, out: Path, port: int = 0) -> None:
        self.out = out
        command = [sys.executable, '-m', 'gyrocal_ros.cli.main', 'studio', str(bag), '-o', str(out)]
        self._process = subprocess.Popen(
            [*command, '--port', str(port), '--no-browser'], stderr=subprocess.PIPE, text=True
        )
        assert self._process.stderr is not None
        said = self._process.stderr.readline()
        found = re.search(r'http://127\.0\.0\.1:(\d+)/', said)
        assert found, said
        self.address, self.port = found[0], int(found[1])

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def end(self) -> None:
        self._process.terminate()
        self._process.wait(20)


@pytest.fixture(scope='module')
def studio(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    studio = Studio(uneven_bag, tmp_path_factory.mktemp('studio'))
    yield studio
    studio.end()


@pytest.fixture
def page(browser: Browser, studio: Studio) -> Iterator[Page]:
    page = browser.new_page(viewport=LAPTOP)
    page.set_default_timeout(PATIENCE_MS)
    yield page
    page.close()


def drift_deg(page: Page, label: str) -> float:
    """Held-out drift of a revision, as the page tells it."""
    row = page.locator('#revisions tr', has_text=label)
    return float(row.locator('td').nth(1).inner_text().split()[0])


def picture(page: Page, name: str, part: str = '') -> None:
    """Keep a picture of the page from its top, or of a part of it, where pictures are wanted."""
    if PICTURES:
        page.wait_for_timeout(1500)
        page.evaluate('window.scrollTo(0, 0)')
        path = str(Path(PICTURES) / f'studio_{name}.png')
        page.locator(part).screenshot(path=path) if part else page.screenshot(path=path)


def beyond_the_screen(page: Page) -> list[str]:
    """Parts of the loop that do not end on the screen of a laptop."""
    names = ('bag', 'model', 'residual', 'missing', 'history')
    boxes = {name: page.locator(f'#{name}').bounding_box() for name in names}
    return [name for name, box in boxes.items() if not box or box['y'] + box['height'] > LAPTOP['height']]


def test_the_whole_loop(page: Page, studio: Studio, uneven_bag: Path) -> None:
    hosts: set[str] = set()
    troubles: list[str] = []
    page.on('request', lambda request: hosts.add(urlsplit(request.url).netloc))
    page.on('console', lambda said: troubles.append(said.text) if said.type == 'error' else None)
    page.goto(studio.address)

    # see what is in the bag, and the failing span
    expect(page.locator('#bag-words')).to_contain_text('100 s')
    expect(page.locator('#verdict')).to_contain_text(f'Missing: {HIDDEN}')
    figure = page.locator('#model-figure')
    expect(figure).to_contain_text('gyro less seen')
    expect(figure).to_contain_text('worst without camera')
    expect(figure.locator('.annotation-text', has_text=re.compile('^1$'))).to_have_count(1)
    expect(page.locator('#failures')).to_contain_text('turning')
    assert not beyond_the_screen(page)
    picture(page, 'fails')

    # open a candidate
    candidate = page.locator('.candidate', has_text=HIDDEN)
    candidate.focus()
    page.keyboard.press('Enter')
    expect(candidate).to_have_attribute('aria-pressed', 'true')
    expect(page.locator('#candidate-name')).to_have_text(HIDDEN)
    expect(page.locator('#card')).to_contain_text('equation')
    expect(page.locator('#forecast')).to_contain_text('from')
    foreseen = page.locator('#forecast').inner_text()

    # add it and see the held-out error fall by what the command line gives
    page.locator('#add').click()
    expect(page.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    command = [sys.executable, '-m', 'gyrocal_ros.cli.main', 'improve', str(uneven_bag)]
    said = subprocess.run([*command, '--effect', HIDDEN, '--json'], capture_output=True, check=True)
    wanted = [one['held_out_drift_deg']['rms'] for one in json.loads(said.stdout)['revisions']]
    shown = [drift_deg(page, '0_default'), drift_deg(page, f'1_{HIDDEN}')]
    assert shown == [pytest.approx(one, abs=0.0051) for one in wanted]
    assert foreseen == f'from {shown[0]:.2f} to {shown[1]:.2f} deg' and shown[1] < 0.1 * shown[0]
    expect(page.locator('#history-figure')).to_contain_text('held out')
    expect(figure).to_contain_text('the present model')
    assert not beyond_the_screen(page)
    picture(page, 'added')
    picture(page, 'falling', '#history')

    # undo, and add it again
    page.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('left out')
    expect(page.locator('#undo')).to_be_disabled()
    page.locator('#add').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('present')

    # compare the two
    page.locator('#compare summary').click()
    expect(page.locator('#compare-figure')).to_contain_text('0_default')
    page.locator('#compare-kind input[value=drift]').check()
    expect(page.locator('#compare-figure')).to_contain_text('Drift span by span')

    # write and export
    page.locator('#write').click()
    expect(page.locator('#message')).to_contain_text('model.yaml and calibration.yaml are in')
    page.locator('#export').click()
    expect(page.locator('#message')).to_contain_text('The report is in')
    folder = studio.out / 'uneven'
    assert HIDDEN in (folder / 'model.yaml').read_text()
    assert HIDDEN in (folder / 'report' / 'report.html').read_text()
    if find_spec('kaleido'):
        drawn = (folder / 'report' / 'figures' / 'heading.png').read_bytes()
        assert drawn.startswith(b'\x89PNG') and len(drawn) > 20_000

    # the truth
    page.locator('#guess').click()
    page.get_by_role('option', name=HIDDEN, exact=True).click()
    page.locator('#reveal').click()
    expect(page.locator('#truth')).to_contain_text(f'Hidden: {HIDDEN}. Your guess was right.')
    expect(page.locator('#truth-words table')).to_contain_text(f'{SIZE:g}')
    assert hosts <= {urlsplit(studio.address).netloc, ''}, 'nothing comes from elsewhere'
    assert not troubles


def test_the_rest_can_be_told_by_any_signal(page: Page, studio: Studio) -> None:
    page.goto(studio.address)
    expect(page.locator('#residual-figure')).to_contain_text('error of the')
    page.locator('#signal').click()
    page.get_by_role('option', name='temperature (deg C) - bias').click()
    expect(page.locator('#residual-figure')).to_contain_text('Bias by temperature')
    for kind, words in (
        ('drift', 'Drift span by span'),
        ('innovations', 'NIS'),
        ('coefficients', 'Coefficients'),
    ):
        page.locator(f'#kind input[value={kind}]').check()
        expect(page.locator('#model-figure')).to_contain_text(words)


def test_a_second_tab_shows_the_same_and_a_reload_loses_nothing(
    browser: Browser, page: Page, studio: Studio
) -> None:
    page.goto(studio.address)
    expect(page.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    second = browser.new_page(viewport=TABLET, color_scheme='dark')
    second.goto(studio.address)
    expect(second.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    second.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('left out')
    page.reload()
    expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
    picture(second, 'tablet_dark', '#missing')
    second.close()


def test_light_and_dark_and_no_wider_than_a_tablet(page: Page, studio: Studio) -> None:
    page.set_viewport_size(TABLET)
    page.goto(studio.address)
    expect(page.locator('#revisions')).to_contain_text('0_default')
    paper = 'getComputedStyle(document.body).backgroundColor'
    light = page.evaluate(paper)
    page.locator('#theme-button').click()
    expect(page.locator('html')).to_have_class('dark')
    assert page.evaluate(paper) != light
    assert page.evaluate('document.documentElement.scrollWidth') <= TABLET['width']


def test_everything_is_reached_by_the_keyboard(page: Page, studio: Studio) -> None:
    page.goto(studio.address)
    expect(page.locator('.candidate')).not_to_have_count(0)
    reached = set()
    for _ in range(80):
        page.keyboard.press('Tab')
        reached |= set(page.evaluate('[document.activeElement.id, document.activeElement.className]'))
    wanted = {'theme-button', 'signal', 'candidate', 'write', 'export', 'riddle', 'guess', 'reveal'}
    assert wanted <= reached


def test_a_killed_studio_is_told_and_taken_up_where_it_was(
    browser: Browser, studio: Studio, uneven_bag: Path
) -> None:
    page = browser.new_page()
    page.goto(studio.address)
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('left out')
    expect(page.locator('#gone')).to_be_empty()
    studio.kill()
    expect(page.locator('#gone')).to_contain_text('does not answer')
    again = Studio(uneven_bag, studio.out)
    page.goto(again.address)
    expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('left out')
    page.close()
    again.end()
