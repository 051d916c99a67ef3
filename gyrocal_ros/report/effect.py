"""The page about one effect of the library: its curves and its description."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from gyrocal_ros.data import Array
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.describe import PLACES, effect_rows, place_of
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.report.html import document
from gyrocal_ros.report.plot import BLUE, GREEN, VERMILLION, line, panels, to_fragment

STYLES = ((BLUE, 'solid'), (VERMILLION, 'dash'), (GREEN, 'dot'))


def effect_page(effect: LibraryEffect) -> str:
    """Return the page as HTML text."""
    drawn = sketch(effect)
    figure = curves('', drawn.x_label, drawn.y_label, drawn.x, drawn.lines)
    rows = ''.join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>'
        for name, text in effect_rows(effect)
    )
    return document(
        effect.name,
        PLACES[place_of(effect)],
        [
            f'<p class="physics">{escape(effect.about.physics)}</p>',
            f'<figure>{to_fragment(figure, "effect")}</figure>',
            f'<div class="wide"><table class="words"><tbody>{rows}</tbody></table></div>',
        ],
    )


def curves(title: str, x_label: str, y_label: str, x: Array, lines: Mapping[str, Array]) -> Any:
    """Draw up to three curves over one axis."""
    figure = panels(title, [y_label], 320)
    for (name, value), (colour, dash) in zip(lines.items(), STYLES, strict=False):
        line(figure, x, value, name, '.4g', colour=colour, dash=dash)
    figure.update_xaxes(title_text=x_label, hoverformat='.4g')
    return figure
