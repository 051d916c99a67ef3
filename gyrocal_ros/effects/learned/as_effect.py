"""A learned law as the Python file of an effect of the user's own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gyrocal_ros.effects.base import Stimulus
from gyrocal_ros.effects.learned.causes import meaning, meaning_of_memory
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.effects.learned.effect_code import Closed, code_of
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.formula import Formula
from gyrocal_ros.effects.learned.memory import TAUS_S, memory_shown_against
from gyrocal_ros.effects.learned.signals import shown_against
from gyrocal_ros.effects.learned.wave import Wave

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


def effect_source(effect: Closed, values: Sequence[float], source: str) -> str:
    """Return the text of a Python file with one effect class.

    Args:
        effect: the learned law in its closed form.
        values: its linear coefficients, which become the prior's size.
        source: name of the recording.
    """
    words, code = _words(effect), code_of(effect)
    of, follows = words.of, words.follows
    name = 'law_' + re.sub(r'[^a-z0-9]+', '_', f'{of}_{follows}_{words.form}'.lower()).strip('_')
    rate = ' * rate' if of == 'scale' else ''
    equation = ' + '.join(f'k{n} ({term}){rate}' for n, term in enumerate(code.terms, start=1))
    verb = 'remembers' if words.remembers else 'follows'
    kind = 'with a memory' if words.remembers else 'as a function'
    numpy = 'import numpy as np\n\n' if 'np.' in code.method else ''
    return TEMPLATE.format(
        title=f'The {of} of the yaw gyro {kind} of {follows}.',
        source=source,
        of=of,
        verb=verb,
        follows=follows,
        form=words.form,
        means=words.means,
        says=f'The {of} of the yaw gyro {verb} {follows}',
        quoted=words.means.replace("'", ''),
        imports=numpy + code.imports,
        parameter=code.constants,
        class_name=''.join(part.capitalize() for part in name.split('_')),
        base=code.base,
        equation=f'w = w_n + {equation}; {code.x_is}',
        best_motion=words.best_motion,
        needs=(words.needed,) if words.needed else (),
        example=tuple(float(f'{value:.4g}') for value in values),
        shown=words.shown_against,
        name=name,
        coefficients='\n'.join(_coefficients([item.unit for item in effect.coefficients], values)),
        method=code.method,
    )


@dataclass(frozen=True, slots=True)
class _Words:
    """What the file says of a law."""

    of: Of
    follows: str
    form: str
    means: str
    best_motion: str
    shown_against: Stimulus
    remembers: bool = False
    needed: str = ''
    """Signal that a recording may lack; empty without one."""


def _words(effect: Closed) -> _Words:
    if isinstance(effect, Formula):
        return _words_of_formula(effect)
    about, (kind, _, follows) = effect.about, effect.name.partition(':')
    form = 'wave' if isinstance(effect, Wave) else effect.form
    of: Of = 'scale' if kind.startswith('scale') else 'bias'
    return _Words(of, follows, form, meaning(follows), about.best_motion, about.shown_against)


def _words_of_formula(effect: Formula) -> _Words:
    of, follows, form = effect.learned.of, effect.learned.follows, effect.closed_form
    remembers = form.over not in ('signal', 'heading')
    is_of_motion = remembers and follows in TAUS_S
    event = event_of(follows)
    signal = follows if event is None else event.signal
    turns, changes = 'single turns with rests between them', f'what changes {signal} over all of its range'
    return _Words(
        of,
        follows,
        form.name,
        means=meaning_of_memory(of, follows) if remembers else meaning(follows, form.name),
        best_motion=turns if is_of_motion else f'{changes}, again and again',
        shown_against=memory_shown_against(follows) if remembers else shown_against(follows),
        remembers=remembers,
        needed=effect.signal,
    )


def _coefficients(units: Sequence[str], values: Sequence[float]) -> Iterator[str]:
    """Yield the coefficients; the prior of each is as large as the largest value of that unit."""
    for number, unit in enumerate(units, start=1):
        std = max(abs(value) for value, other in zip(values, units, strict=True) if other == unit)
        yield f"        Coefficient('k{number}', '{unit}', prior_std={float(f'{std:.3g}')!r}),"
