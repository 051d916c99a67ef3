"""The page of the studio in a real browser: a law is learned, and another bag is dropped on the page."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from studio_browser import (
    Studio,
    assert_nothing_overlaps,
    barriers,
    chromium,
    drift_deg,
    new_page,
    on_a_laptop,
    parts_below_the_screen,
    screenshot,
)
from studio_parts import HIDDEN, write_image_bag

DROP = """
([name, content]) => {
  const bytes = Uint8Array.from(atob(content), (one) => one.charCodeAt(0));
  const dropped = new DataTransfer();
  dropped.items.add(new File([bytes], name));
  document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: dropped, bubbles: true }));
}
"""
"""Drops a file on the page."""


@pytest.fixture(scope='module')
def image_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_image_bag(tmp_path_factory.mktemp('images'))


@pytest.fixture(scope='module')
def open_page(
    image_bag: Path, strange_bag: Path, uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    """The page, loaded once; the images are drawn before, since an open page works all the time."""
    out = tmp_path_factory.mktemp('studio')
    with chromium() as browser, Studio(strange_bag, uneven_bag, out=out) as studio:
        page = new_page(browser)
        page.goto(studio.address)
        yield page


@pytest.fixture
def page(open_page: Page) -> Page:
    return on_a_laptop(open_page)


def test_an_unknown_law_is_learned_shown_added_and_removed(page: Page) -> None:
    law = 'bias_curve:heading'
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


def test_a_bag_with_images_is_dropped_on_the_page_and_diagnosed(page: Page, image_bag: Path) -> None:
    (file,) = image_bag.glob('*.mcap')
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
