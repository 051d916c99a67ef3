"""A learned law as the Python file of an effect of the user's own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from gyrocal_ros.effects.learned.causes import meaning, meaning_of_memory
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.effects.learned.effect_code import code_of
from gyrocal_ros.effects.learned.forms import Form
from gyrocal_ros.effects.learned.memory import TAUS_S, memory_shown_against
from gyrocal_ros.effects.learned.signals import shown_against, to_record

TEMPLATE = '''"""{title}

Learned from the recording {source}: the {of} {verb} {follows} with the form `{form}`.
What usually causes that: {means}.
Replace these words once the cause is known.
"""

from __future__ import annotations

from dataclasses import dataclass

{imports}{parameter}

@dataclass(frozen=True)
class {class_name}({base}):
    """{equation}"""

    about = Explanation(
        physics=(
            '{says}, with the form {form}: '
            '{quoted}. '
            'Learned from a recording; the cause is not known.'
        ),
        equation='{equation}',
        usual_size='as found',
        best_motion='{best_motion}',
        needs={needs!r},
        source='learned from {source}',
        example={example!r},
        shown_against={shown!r},
    )
    name: str = '{name}'
    coefficients: tuple[Coefficient, ...] = (
{coefficients}
    )

{method}'''
PARAMETER = '''
P = {parameter!r}
"""The parameter in which the form is not linear; fixed as it was found."""
'''


def effect_source(
    of: Of, follows: str, form: Form, parameter: float, values: Sequence[float], source: str
) -> str:
    """Return the text of a Python file with one effect class.

    Args:
        of: what follows.
        follows: name of the signal, or the drive of a memory.
        form: closed form.
        parameter: value of its scanned parameter.
        values: its linear parameters, which become the prior's size.
        source: name of the recording.
    """
    remembers = form.over not in ('signal', 'heading')
    terms = [term.strip() for term in _split(form.equation)]
    code = code_of(of, follows, form, terms)
    verb = 'remembers' if remembers else 'follows'
    name = 'law_' + re.sub(r'[^a-z0-9]+', '_', f'{of}_{follows}_{form.name}'.lower()).strip('_')
    rate = ' * rate' if of == 'scale' else ''
    equation = ' + '.join(f'k{n} ({term}){rate}' for n, term in enumerate(terms, start=1))
    means = meaning_of_memory(of, follows) if remembers else meaning(follows, form.name)
    turns, changes = 'single turns with rests between them', f'what changes {follows} over all of its range'
    needed = '' if remembers and follows in TAUS_S else to_record(follows)
    numpy = 'import numpy as np\n\n' if 'np.' in code.method else ''
    return TEMPLATE.format(
        title=f'The {of} of the yaw gyro {"with a memory" if remembers else "as a function"} of {follows}.',
        source=source,
        of=of,
        verb=verb,
        follows=follows,
        form=form.name,
        means=means,
        says=f'The {of} of the yaw gyro {verb} {follows}',
        quoted=means.replace("'", ''),
        imports=numpy + code.imports,
        parameter=PARAMETER.format(parameter=float(parameter)) if re.search(r'\bP\b', code.method) else '',
        class_name=''.join(part.capitalize() for part in name.split('_')),
        base=code.base,
        equation=f'w = w_n + {equation}; {code.x_is}',
        best_motion=turns if remembers and follows in TAUS_S else f'{changes}, again and again',
        needs=(needed,) if needed else (),
        example=tuple(float(f'{value:.4g}') for value in values),
        shown=memory_shown_against(follows) if remembers else shown_against(follows),
        name=name,
        coefficients='\n'.join(_coefficients(code.units, values)),
        method=code.method,
    )


def _coefficients(units: Sequence[str], values: Sequence[float]) -> Iterator[str]:
    """Yield the coefficients; the prior of each is as large as the largest value of that unit."""
    for number, unit in enumerate(units, start=1):
        std = max(abs(value) for value, other in zip(values, units, strict=True) if other == unit)
        yield f"        Coefficient('k{number}', '{unit}', prior_std={float(f'{std:.3g}')!r}),"


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
