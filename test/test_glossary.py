"""The glossary: its page, and the links of terms in the pages of results."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gyrocal_ros.report.glossary import TERMS, anchor, as_markdown, with_terms
from gyrocal_ros.report.html import document, table

PAGE = Path(__file__).resolve().parent.parent / 'docs/glossary.md'


def test_the_page_has_the_terms_of_the_program() -> None:
    assert PAGE.read_text(encoding='utf-8') == as_markdown(), 'write as_markdown() to docs/glossary.md'


@pytest.mark.parametrize('term', TERMS)
def test_a_term_is_linked_at_its_first_use_and_explained_at_the_end(term: str) -> None:
    page = with_terms(f'<p>Here is {term} and again {term}.</p>')
    assert page.count(f'href="#{anchor(term)}"') == 1
    assert page.startswith(
        f'<p>Here is <a class="term" href="#{anchor(term)}">{term}</a> and again {term}.</p>'
    )
    assert page.count(f'id="{anchor(term)}"') == 1


def test_other_spellings_are_linked() -> None:
    page = with_terms('<td>held-out drift</td><td>NIS/dof</td><td>Biases</td><td>indistinguishable from</td>')
    assert re.findall(r'href="#term-([\w-]+)"', page) == ['held-out', 'nis', 'indistinguishable-effects']


def test_code_scripts_headings_and_names_are_left_alone() -> None:
    body = (
        '<h2>Bias</h2><script>var bias = "<p>NIS</p>";</script><pre>effects: []</pre>'
        '<td data-x="sigma">bias_warmup</td><code>gyrocal effects</code>'
    )
    assert with_terms(body) == body


def test_pages_explain_their_terms() -> None:
    page = document('Title', 'about', [table('Revisions', ('name', 'sigma'), [('0_default', '4')])])
    assert f'<a class="term" href="#{anchor("sigma")}">sigma</a>' in page
    assert f'<dt id="{anchor("sigma")}">sigma</dt>' in page and anchor('NEES') not in page
