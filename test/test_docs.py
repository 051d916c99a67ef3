"""The documentation: its commands are valid, its links and pictures exist."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from gyrocal_ros.cli.main import COMMANDS, command_parser

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md'), *ROOT.glob('bags/*.md')])
CODE = re.compile(r'^```\w*\n(.*?)^```|^ {4}(\S.*)$|`([^`\n]+)`', re.DOTALL | re.MULTILINE)
"""Code in Markdown: a fenced block, an indented line, or text between backticks."""
COMMAND = re.compile(r'\bgyrocal ([a-z][^`\n)]*)')
TARGET = re.compile(r'^make ([a-z]+)', re.MULTILINE)
LINK = re.compile(r'\]\(([^)\s]+)\)')
MAKEFILE = (ROOT / 'Makefile').read_text(encoding='utf-8')
TARGETS = re.findall(r'^([a-z]+):', MAKEFILE, re.MULTILINE)
MAX_BYTES = 150_000
"""Maximum size of a picture."""


def commands(text: str) -> Iterator[str]:
    """Yield every command line of a page, without the word `gyrocal`."""
    for code in code_of(text):
        yield from COMMAND.findall(code.replace('\\\n', ' '))


def code_of(text: str) -> Iterator[str]:
    """Yield the code of a page."""
    for match in CODE.finditer(text):
        yield next(part for part in match.groups() if part is not None)


def links(page: Path) -> list[str]:
    """Return the links of a page into this repository."""
    targets = [target.partition('#')[0] for target in LINK.findall(page.read_text(encoding='utf-8'))]
    return [target for target in targets if target and '://' not in target]


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page."""
    text = re.sub(r'^```.*?^```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


def check(command: str) -> None:
    """Parse a command line; the name of a command alone is valid."""
    name, *arguments = shlex.split(command, comments=True)
    assert name in COMMANDS, command
    if arguments and '--help' not in arguments:
        command_parser(name).parse_args(arguments)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_command_of_a_page_is_valid(page: Path) -> None:
    for command in commands(page.read_text(encoding='utf-8')):
        check(command)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_make_target_of_a_page_exists(page: Path) -> None:
    named = {target for code in code_of(page.read_text(encoding='utf-8')) for target in TARGET.findall(code)}
    assert named <= set(TARGETS)


def test_make_help_lists_every_target() -> None:
    listed = re.findall(r"@echo 'make ([a-z]+) ", MAKEFILE)
    assert sorted([*listed, 'help']) == sorted(TARGETS)


@pytest.mark.parametrize('name', COMMANDS)
def test_every_example_is_valid(name: str) -> None:
    example: str = importlib.import_module(f'gyrocal_ros.cli.{name}').EXAMPLE
    for line in example.splitlines():
        assert line.startswith('gyrocal ')
        check(line.removeprefix('gyrocal '))


def test_commands_are_found_in_every_kind_of_code() -> None:
    page = 'Say `gyrocal demo`.\n\n    gyrocal check bag  # why\n\n```\nDo: gyrocal add \\\n  gyro_lag\n```\n'
    assert [shlex.split(found, comments=True) for found in commands(page)] == [
        ['demo'],
        ['check', 'bag'],
        ['add', 'gyro_lag'],
    ]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_link_has_a_target(page: Path) -> None:
    missing = [target for target in links(page) if not (page.parent / target).exists()]
    assert not missing


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_link_to_a_heading_has_one(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding='utf-8')):
        name, _, anchor = target.partition('#')
        if anchor and '://' not in name:
            assert anchor in anchors(page.parent / name if name else page), target


def test_the_readme_and_the_site_have_every_page() -> None:
    pages = {f'docs/{page.name}' for page in (ROOT / 'docs').glob('*.md')} - {'docs/index.md'}
    assert pages <= set(links(ROOT / 'README.md'))
    assert {page.removeprefix('docs/') for page in pages} <= set(links(ROOT / 'docs/index.md'))
    site = yaml.safe_load((ROOT / 'mkdocs.yml').read_text(encoding='utf-8'))
    assert pages <= {f'docs/{name}' for name in names_in(site['nav'])}


def names_in(nav: Any) -> Iterator[str]:
    """Yield the pages of the navigation of the site."""
    if isinstance(nav, str):
        yield nav
    else:
        for item in nav.values() if isinstance(nav, dict) else nav:
            yield from names_in(item)


def test_every_picture_is_small_and_used() -> None:
    shown = {(page.parent / target).resolve() for page in PAGES for target in links(page)}
    for picture in (ROOT / 'docs/images').iterdir():
        assert picture in shown, f'no page shows {picture.name}'
        assert picture.stat().st_size < MAX_BYTES, picture.name
