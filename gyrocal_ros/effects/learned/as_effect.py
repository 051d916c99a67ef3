"""A learned law as the Python file of an effect of the user's own."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gyrocal_ros.effects.learned.curve import UNIT, Of
from gyrocal_ros.effects.learned.forms import Form, meaning
from gyrocal_ros.effects.learned.signals import UNITS, shown_against

TEMPLATE = '''"""{title}

Learned from the recording {source}: the {of} follows {follows} with the form `{form}`.
What usually causes that: {means}. Replace these words once the cause is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column, recorded
from gyrocal_ros.effects.learned.signals import values_of
from gyrocal_ros.model.sensor import Coefficient

P = {parameter!r}
"""The parameter in which the form is not linear; fixed as it was found."""


@dataclass(frozen=True)
class {class_name}(LinearGyroEffect):
    """{equation}"""

    about = Explanation(
        physics='{means_sentence}',
        equation='{equation}',
        usual_size='{usual}',
        best_motion='what changes {follows} over all of its range, again and again',
        needs={needs!r},
        source='learned from {source}',
        example={example!r},
        shown_against={shown!r},
    )
    name: str = '{name}'
    coefficients: tuple[Coefficient, ...] = (
{coefficients}
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the terms of the form (N, {count}), zero where the signal is not recorded."""
        x, p = values_of({signal}, block), P
        terms = (
{equation_terms}
        )
        return column(*(recorded({rate}term) for term in terms))
'''


def effect_source(
    of: Of, follows: str, form: Form, parameter: float, values: Sequence[float], source: str
) -> str:
    """Return the text of a Python file with one effect class.

    Args:
        of: what follows the signal.
        follows: name of the signal.
        form: closed form.
        parameter: value of its scanned parameter.
        values: its linear parameters, which become the prior's size.
        source: name of the recording.
    """
    name = 'law_' + re.sub(r'[^a-z0-9]+', '_', f'{of}_{follows}_{form.name}'.lower()).strip('_')
    terms = [term.strip() for term in _split(form.equation)]
    needs = () if follows in UNITS and follows != 'temperature' else (follows,)
    rate = ' * rate' if of == 'scale' else ''
    equation = ' + '.join(f'k{n} ({term}){rate}' for n, term in enumerate(terms, start=1))
    largest = float(f'{max(abs(value) for value in values):.3g}')
    lines = [
        f"        Coefficient('k{number}', '{UNIT[of]}', prior_std={largest!r}),"
        for number in range(1, len(terms) + 1)
    ]
    return TEMPLATE.format(
        title=f'The {of} of the yaw gyro as a function of {follows}.',
        source=source,
        of=of,
        follows=follows,
        form=form.name,
        means=meaning(follows),
        means_sentence=f'{meaning(follows)}; learned, the cause is not known.'.replace("'", ''),
        parameter=float(parameter),
        class_name=''.join(part.capitalize() for part in name.split('_')),
        equation=f'w = w_n + {equation}; x is {follows}',
        usual='as found',
        needs=needs,
        example=tuple(float(f'{value:.4g}') for value in values),
        shown=shown_against(follows),
        name=name,
        coefficients='\n'.join(lines),
        count=len(terms),
        signal=repr(follows),
        rate='block.rate_rad_s[:, 2] * ' if of == 'scale' else '',
        equation_terms='\n'.join(f'            {term},' for term in terms),
    )


def _split(equation: str) -> list[str]:
    """Split an equation at the commas outside of brackets."""
    terms, depth = [''], 0
    for letter in equation:
        depth += (letter == '(') - (letter == ')')
        if letter == ',' and depth == 0:
            terms.append('')
        else:
            terms[-1] += letter
    return terms
