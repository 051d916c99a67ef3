"""The page of one session of the studio: figures, windows, keyboard, tabs, and a studio that is killed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from studio_browser import (
    TABLET,
    Studio,
    assert_nothing_overlaps,
    chromium,
    new_page,
    on_a_laptop,
    screenshot,
)
from studio_parts import HIDDEN


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope='module')
def studio(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    with Studio(uneven_bag, out=tmp_path_factory.mktemp('studio')) as studio:
        yield studio


@pytest.fixture(scope='module')
def open_page(browser: Browser, studio: Studio) -> Page:
    """The page, loaded once: that takes the browser several seconds."""
    page = new_page(browser)
    page.goto(studio.address)
    expect(page.locator('#residual-figure')).to_contain_text('error of the')
    return page


@pytest.fixture
def page(open_page: Page) -> Page:
    return on_a_laptop(open_page)


def add_and_remove(page: Page, *, present: bool) -> None:
    """Bring the hidden effect into the present model, or into a revision that was left."""
    row = page.locator('#revisions tr', has_text=f'1_{HIDDEN}')
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


def test_the_error_left_over_is_shown_against_any_signal(page: Page) -> None:
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


def test_the_theme_can_be_changed_and_the_page_fits_a_tablet(page: Page) -> None:
    page.set_viewport_size(TABLET)
    expect(page.locator('#revisions')).to_contain_text('0_default')
    background = 'getComputedStyle(document.body).backgroundColor'
    light = page.evaluate(background)
    page.locator('#theme-button').click()
    expect(page.locator('html')).to_have_class('dark')
    assert page.evaluate(background) != light
    assert page.evaluate('document.documentElement.scrollWidth') <= TABLET['width']
    page.locator('#theme-button').click()
    expect(page.locator('html')).not_to_have_class('dark')
    assert page.evaluate(background) == light


def test_nothing_overlaps_or_is_clipped(page: Page) -> None:
    for name in ('model-figure', 'residual-figure', 'history-figure'):
        expect(page.locator(f'#{name} svg text').first).to_be_visible()
    assert_nothing_overlaps(page, 'feature')


def test_all_controls_can_be_reached_by_the_keyboard(page: Page) -> None:
    expect(page.locator('.candidate')).not_to_have_count(0)
    reached = set()
    for _ in range(80):
        page.keyboard.press('Tab')
        reached |= set(page.evaluate('[document.activeElement.id, document.activeElement.className]'))
    controls = {'theme-button', 'signal', 'candidate', 'write', 'export', 'riddle', 'guess', 'reveal'}
    assert controls <= reached


def test_second_tabs_and_reloads_show_the_same_session(browser: Browser, page: Page, studio: Studio) -> None:
    add_and_remove(page, present=True)
    second = browser.new_page(viewport=TABLET, color_scheme='dark')
    second.goto(studio.address)
    expect(second.locator('#revisions')).to_contain_text(f'1_{HIDDEN}')
    second.locator('#undo').click()
    expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('removed again')
    page.reload()
    expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
    screenshot(second, 'tablet_dark', '#missing')
    second.close()


def test_a_killed_studio_is_reported_and_a_new_one_continues_its_session(
    page: Page, studio: Studio, uneven_bag: Path
) -> None:
    """The last test of this file, since it kills the studio of the others."""
    add_and_remove(page, present=False)
    expect(page.locator('#gone')).to_be_empty()
    studio.kill()
    expect(page.locator('#gone')).to_contain_text('does not answer')
    with Studio(uneven_bag, out=studio.out) as again:
        page.goto(again.address)
        expect(page.locator('#revisions tr', has_text='0_default')).to_contain_text('present')
        expect(page.locator('#revisions tr', has_text=f'1_{HIDDEN}')).to_contain_text('removed again')
