"""The page that a person looks at: one HTML file that needs nothing else, on light and on dark."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape

from gyrocal_ros import __version__
from gyrocal_ros.calibration import Calibration
from gyrocal_ros.config import to_yaml
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.diagnose.drift import blind_drift
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.report import figures, series
from gyrocal_ros.report.sections import Section, sections
from gyrocal_ros.report.tables import Row, Verdict, coefficient_rows, verdict


def report_page(run: Run, calibration: Calibration, findings: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page as HTML text.

    Args:
        run: a finished run.
        calibration: what it has found.
        findings: severity and text of what is odd about the recording.
    """
    before, after = blind_drift(series.uncorrected(run)), blind_drift(run)
    parts = [
        _verdict(verdict(calibration, run.config, before, after)),
        _warnings([*findings, *_events(run)]),
        _table(coefficient_rows(calibration, run.history)),
        _figures(sections(run, calibration, before, after)),
        _details('Sensor model (model.yaml)', model_to_yaml(run.model)),
        _details('Settings (settings.yaml)', to_yaml(run.config)),
    ]
    about = f'{calibration.duration_s:.0f} s recorded, model {run.model.name}, gyrocal {__version__}'
    return PAGE.format(
        title=escape(f'Gyro calibration of {run.source}'),
        about=escape(about),
        style=STYLE,
        library=figures.library(),
        body='\n'.join(parts),
    )


def _events(run: Run) -> Iterator[tuple[str, str]]:
    for event in run.events:
        yield 'warning', f'{(event.t_ns - run.span.start_ns) / NS_PER_S:.1f} s after the start: {event.text}'


def _verdict(words: Verdict) -> str:
    kind = 'good' if words.good else 'bad'
    sign = '✓' if words.good else '✗'
    sentences = ''.join(f'<p>{escape(sentence)}</p>' for sentence in words.sentences)
    return f'<section class="verdict {kind}"><h2>{sign} {escape(words.headline)}</h2>{sentences}</section>'


def _warnings(findings: Iterable[tuple[str, str]]) -> str:
    items = ''.join(f'<li><b>{escape(severity)}</b> {escape(text)}</li>' for severity, text in findings)
    return f'<h2>Warnings and notes</h2><ul>{items}</ul>' if items else '<p>No warnings.</p>'


def _table(rows: Iterable[Row]) -> str:
    lines = ''.join(
        f'<tr><th scope="row">{escape(row.name)}</th><td>{escape(row.value)}</td><td>{escape(row.unit)}</td>'
        f'<td>{escape(row.known_before)}</td><td>{escape(row.meaning)}</td></tr>'
        for row in rows
    )
    heads = ''.join(
        f'<th scope="col">{head}</th>' for head in ('coefficient', 'value', 'unit', 'before', 'which means')
    )
    return (
        '<h2>Coefficients</h2><div class="wide"><table>'
        f'<thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table></div>'
        '<p class="note">± is one standard deviation, here and above.</p>'
    )


def _figures(parts: Iterable[Section]) -> str:
    drawn = '\n'.join(
        f'<figure class="{"half" if part.half else "full"}">{figures.fragment(part.figure, part.name)}'
        f'<figcaption>{escape(part.caption)}</figcaption></figure>'
        for part in parts
    )
    hint = 'In the figures: drag to zoom in, double-click to see all, click a name to hide it.'
    return f'<p class="note">{hint}</p><div class="figures">{drawn}</div>'


def _details(title: str, text: str) -> str:
    return f'<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>'


STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --card: #f4f6f8; --ink: #1d2127; --faint: #59616b;
  --rule: #d5dae0; --good: #00795a; --bad: #b84a00; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14171b; --card: #1e2329; --ink: #e8eaed; --faint: #a3abb5;
    --rule: #39414a; --good: #2fc49a; --bad: #ff9a52; }
  .scatterlayer, .legend .layers { filter: brightness(1.4); }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem clamp(1rem, 3vw, 2.5rem) 4rem; max-width: 1280px;
  background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
.about, .note, figcaption { color: var(--faint); font-size: .9rem; }
.about { margin: .2rem 0 1.2rem; }
.verdict { background: var(--card); border-left: 6px solid; padding: 1rem 1.3rem; border-radius: 6px; }
.verdict h2 { margin: 0 0 .4rem; font-size: 1.25rem; }
.verdict p { margin: .3rem 0; max-width: 80ch; }
.good, .good h2 { border-color: var(--good); } .good h2 { color: var(--good); }
.bad, .bad h2 { border-color: var(--bad); } .bad h2 { color: var(--bad); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem 1.2rem .35rem 0; border-bottom: 1px solid var(--rule); }
td:not(:last-child) { white-space: nowrap; }
thead th { color: var(--faint); font-weight: 500; }
tbody th { font-weight: 600; }
.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 2rem 2.5rem;
  margin: 1rem 0 2.5rem; }
figure { margin: 0; grid-column: 1 / -1; min-width: 0; }
@media (min-width: 1000px) { figure.half { grid-column: auto; } }
figcaption { max-width: 95ch; margin-top: .4rem; }
details { border-top: 1px solid var(--rule); padding: .6rem 0; }
summary { cursor: pointer; }
pre { overflow-x: auto; font-size: .85rem; }
.infolayer text, .cartesianlayer text { fill: var(--ink) !important; }
"""

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
<h1>{title}</h1>
<p class="about">{about}</p>
{body}
</body>
</html>
"""
