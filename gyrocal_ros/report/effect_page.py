"""One page about one effect: its picture, and all that the library says of it."""

from __future__ import annotations

from html import escape

from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.describe import PLACES, effect_rows, place_of
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.report.figures import drawing
from gyrocal_ros.report.html import document


def effect_page(effect: LibraryEffect) -> str:
    """The page as HTML text, which needs nothing else."""
    drawn = sketch(effect)
    figure = drawing.curves('', drawn.x_label, drawn.y_label, drawn.x, drawn.lines)
    rows = ''.join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>'
        for name, text in effect_rows(effect)
    )
    return document(
        effect.name,
        PLACES[place_of(effect)],
        [
            f'<p class="physics">{escape(effect.about.physics)}</p>',
            f'<figure>{drawing.fragment(figure, "effect")}</figure>',
            f'<div class="wide"><table class="words"><tbody>{rows}</tbody></table></div>',
        ],
    )
