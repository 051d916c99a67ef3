"""Pages: one HTML file that needs no other file and no network, readable on light and on dark."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from typing import Any

from gyrocal_ros.report.describe import Verdict
from gyrocal_ros.report.glossary import with_terms
from gyrocal_ros.report.plot import plotly_js, to_fragment

FIGURE_HELP = 'In the figures: drag to zoom in, double-click to see all, click a name to hide it.'
PAPER_ZOOM = 0.75
PAPER_WIDTH_PX = round((210 - 2 * 12) / 25.4 * 96 / PAPER_ZOOM)
"""Width of the page on A4 paper with margins of 12 mm, in CSS pixels before the zoom."""
SENTENCE = 60
"""Number of characters from which the text of a cell is a sentence."""
SIGNS = {'green': '✓', 'yellow': '→', 'red': '✗'}


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A figure with its caption."""

    name: str
    figure: Any
    caption: str
    half: bool = False
    """True to place two of them side by side on a wide screen."""


def document(title: str, about: str, parts: Iterable[str]) -> str:
    """Assemble a page.

    Args:
        title: its heading, plain text.
        about: one line below it, plain text.
        parts: pieces of HTML in their order.
    """
    body = with_terms('\n'.join(part for part in parts if part))
    return PAGE.format(title=escape(title), about=escape(about), style=STYLE, library=plotly_js(), body=body)


def verdict_box(verdict: Verdict) -> str:
    """Return the verdict, its reasons and the next steps in a coloured box."""
    sentences = ''.join(f'<p>{with_code(sentence)}</p>' for sentence in verdict.sentences)
    todo = ''.join(f'<li>{with_code(sentence)}</li>' for sentence in verdict.steps)
    next_steps = f'<p><b>What to do next</b></p><ul>{todo}</ul>' if todo else ''
    return (
        f'<section class="verdict {verdict.status.level}">'
        f'<h2>{SIGNS[verdict.status.level]} {with_code(verdict.headline)}</h2>'
        f'{sentences}{next_steps}</section>'
    )


def with_code(text: str) -> str:
    """Convert plain text to HTML; text between backticks becomes code."""
    return re.sub(r'`([^`]+)`', r'<code>\1</code>', escape(text))


def warnings(findings: Iterable[tuple[str, str]]) -> str:
    """Return a list of severities and texts."""
    items = ''.join(f'<li><b>{escape(severity)}</b> {escape(text)}</li>' for severity, text in findings)
    return f'<h2>Warnings and notes</h2><ul>{items}</ul>' if items else '<p>No warnings.</p>'


def table(
    title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], note: str = '', wrap: bool = False
) -> str:
    """Return a table under a heading; the first cell of a row is its name. With `wrap`, cells wrap.

    Sentences in the last cells get room on a narrow screen, where the table scrolls.
    """
    rows = list(rows)
    has_sentences = any(len(row[-1]) > SENTENCE for row in rows)
    names = [escape(row[0]).replace('_', '_<wbr>') if has_sentences else escape(row[0]) for row in rows]
    lines = ''.join(
        f'<tr><th scope="row">{name}</th>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row[1:]) + '</tr>'
        for name, row in zip(names, rows, strict=True)
    )
    top = ''.join(f'<th scope="col">{escape(head)}</th>' for head in heads)
    below = f'<p class="note">{escape(note)}</p>' if note else ''
    kind = ' class="words"' if wrap else ' class="reasons"' if has_sentences else ''
    return (
        f'<h2>{escape(title)}</h2><div class="wide"><table{kind}>'
        f'<thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table></div>{below}'
    )


def bar_table(title: str, heads: tuple[str, str], rows: Sequence[tuple[str, float]], note: str) -> str:
    """Return a table of names and sizes with a bar behind each size."""
    most = max(size for _, size in rows)
    lines = ''.join(
        f'<tr><th scope="row">{escape(name)}</th><td class="meter">'
        f'<span style="width:{100.0 * size / most:.0f}%"></span>{size:.1f}</td></tr>'
        for name, size in rows
    )
    return (
        f'<h2>{escape(title)}</h2><div class="wide"><table><thead><tr><th scope="col">{escape(heads[0])}</th>'
        f'<th scope="col">{escape(heads[1])}</th></tr></thead><tbody>{lines}</tbody></table></div>'
        f'<p class="note">{escape(note)}</p>'
    )


def gallery(sections: Iterable[Section], title: str = '', note: str = FIGURE_HELP) -> str:
    """Return figures with their captions, under a heading and a note; nothing without figures."""
    drawn = '\n'.join(
        f'<figure class="{width}">{to_fragment(part.figure, part.name)}'
        f'<figcaption>{escape(part.caption)}</figcaption></figure>'
        for part, width in _widths(list(sections))
    )
    heading = f'<h2>{escape(title)}</h2>' if title else ''
    return f'{heading}<p class="note">{escape(note)}</p><div class="figures">{drawn}</div>' if drawn else ''


def _widths(sections: list[Section]) -> Iterator[tuple[Section, str]]:
    """Pair the halves; one without a partner takes the whole width."""
    for is_half, group in groupby(sections, key=lambda part: part.half):
        parts = list(group)
        for place, part in enumerate(parts):
            alone = place == len(parts) - 1 and len(parts) % 2 == 1
            yield part, 'half' if is_half and not alone else 'full'


def details(title: str, text: str) -> str:
    """Return preformatted text that is folded at first."""
    return f'<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>'


STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --card: #f4f6f8; --ink: #1d2127; --faint: #59616b;
  --rule: #d5dae0; --good: #00795a; --found: #00619b; --bad: #b84a00; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14171b; --card: #1e2329; --ink: #e8eaed; --faint: #a3abb5;
    --rule: #39414a; --good: #2fc49a; --found: #6bbcf0; --bad: #ff9a52; }
  .scatterlayer, .barlayer, .legend .layers { filter: brightness(1.4); }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem clamp(1rem, 3vw, 2.5rem) 4rem; max-width: 1280px;
  background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
.note { max-width: 110ch; }
.term { color: inherit; text-decoration: underline dotted; text-underline-offset: .2em; }
dt { font-weight: 600; margin-top: .6rem; } dd { margin: 0; max-width: 90ch; }
dt:target { outline: 2px solid var(--found); }
.about, .note, figcaption { color: var(--faint); font-size: .9rem; }
.about { margin: .2rem 0 1.2rem; }
.verdict { background: var(--card); border-left: 6px solid; padding: 1rem 1.3rem; border-radius: 6px; }
.verdict h2 { margin: 0 0 .4rem; font-size: 1.25rem; }
.verdict ul { margin: .3rem 0; max-width: 80ch; }
.verdict p { margin: .3rem 0; max-width: 80ch; }
.green, .green h2 { border-color: var(--good); } .green h2 { color: var(--good); }
.yellow, .yellow h2 { border-color: var(--found); } .yellow h2 { color: var(--found); }
.red, .red h2 { border-color: var(--bad); } .red h2 { color: var(--bad); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem 1.2rem .35rem 0; border-bottom: 1px solid var(--rule); }
td:not(:last-child) { white-space: nowrap; }
.meter { position: relative; min-width: 14rem; padding-left: .4rem; }
.meter span { position: absolute; inset: .25rem auto .25rem 0; background: var(--rule); z-index: -1; }
table.words td { white-space: normal; }
@media screen {
  table.reasons td:last-child { min-width: 24rem; }
  table.reasons tbody th { min-width: 12rem; }
}
.physics { max-width: 80ch; }
thead th { color: var(--faint); font-weight: 500; }
tbody th { font-weight: 600; }
.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 2rem 2.5rem;
  margin: 1rem 0 2.5rem; }
figure { margin: 0; grid-column: 1 / -1; min-width: 0; }
@media (min-width: 1000px) { figure.half { grid-column: auto; } }
code { font-size: .92em; background: var(--paper); padding: .05em .3em; border-radius: 3px; }
figcaption { max-width: 95ch; margin-top: .4rem; }
details { border-top: 1px solid var(--rule); padding: .6rem 0; }
summary { cursor: pointer; }
pre { overflow-x: auto; font-size: .85rem; }
.infolayer text, .cartesianlayer text { fill: var(--ink) !important; }
.paper-only { display: none; }
@media print {
  @page { size: A4; margin: 12mm; }
  :root { color-scheme: light; --paper: #ffffff; --card: #f4f6f8; --ink: #1d2127; --faint: #59616b;
    --rule: #d5dae0; --good: #00795a; --found: #00619b; --bad: #b84a00; }
  body { zoom: ZOOM; max-width: none; padding: 0; print-color-adjust: exact; }
  .paper-only { display: block; } .paper-only h2 { margin-top: 1.2rem; }
  .paper-only + * { break-before: page; }
  .verdict, figure, tr { break-inside: avoid; } h2, .note { break-after: avoid; }
  .figures { display: block; } figure { margin-bottom: 2rem; } .wide { overflow: visible; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; line-height: 1.3; } .paper-only pre { columns: 2; }
  .modebar { display: none; }
}
""".replace('ZOOM', str(PAPER_ZOOM))

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
<script>{library}</script>
</head>
<body>
<main>
<h1>{title}</h1>
<p class="about">{about}</p>
{body}
</main>
<script>
addEventListener('beforeprint', () => document.querySelectorAll('details').forEach(part => part.open = true));
</script>
</body>
</html>
"""
