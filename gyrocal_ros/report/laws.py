"""Learned laws in words."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrocal_ros.diagnose.laws.bump_fit import BumpFit
from gyrocal_ros.diagnose.laws.closed_forms import ClosedForm
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, unit_of
from gyrocal_ros.effects.learned.drives import ABS_RATE, ANY_TURN, LAST_REST, LAST_TURN, MOVING, SIDE, START
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.memory import ExponentialBank
from gyrocal_ros.report.describe import with_std

KINDS = {
    'bias_curve': 'the bias is a smooth function of {follows}',
    'scale_curve': 'the scale factor is a smooth function of {follows}',
    'bias_memory': 'the bias remembers {follows}',
    'scale_memory': 'the scale factor remembers {follows}',
    'bias_map': 'the bias depends on the place in the room; valid in the map of this recording only',
    'bias_step': 'the bias jumps at {at_s:.1f} s; valid for this recording only',
    'scale_step': 'the scale factor jumps at {at_s:.1f} s; valid for this recording only',
    'bias_wave': 'the bias swings with a period of {period_s:.1f} s; its phase is that of this recording',
    'scale_wave': 'the scale factor swings with a period of {period_s:.1f} s; its phase is that of this '
    'recording',
}
DRIVES = {
    'dynamics': 'fast changes of the rate (a lag or a resonance)',
    'rate': 'the rate',
    'abs_rate': 'the magnitude of the rate',
    'turn_side': 'the side of the turns',
    'last_turn': 'the side of the last turn, and fades after it',
    'any_turn': 'the last turn, to any side, and fades after it',
    'last_rest': 'the last rest, and fades after it',
    'moving': 'whether the robot moves',
    'start': 'the start',
}


def law_in_words(law: LearnedLaw) -> Iterator[str]:
    """Yield a learned law in lines of text, with its closed forms."""
    remembers = law.kind.endswith('memory')
    event = event_of(law.follows)
    follows = DRIVES.get(law.follows, law.follows) if remembers else law.follows
    follows = follows if event is None else f'{event.in_words}, and fades after it'
    parameters = {name: getattr(law.effect, name, 0.0) for name in ('at_s', 'period_s')}
    what = KINDS[law.kind].format(follows=follows, **parameters)
    yield f'Learned {law.effect.name}: {what} ({math.degrees(law.rms):.3g} deg/s rms).'
    if law.forms:
        yield f'  closed forms ({variable_of(law)}):'
    for found in law.forms:
        yield f'    {form_in_words(found)}'
    if law.bump is not None:
        yield f'  closed form: {bump_in_words(law.bump)}'
    if law.in_model_as:
        yield f'  in the model as: {law.in_model_as}'
    if law.forms:
        yield f'  what usually causes that: {law.forms[0].means}'
    if law.closest:
        yield f'  closest in the library: {law.closest}'


def variable_of(law: LearnedLaw) -> str:
    """Return what x is in the closed forms of a law."""
    learned = law.curve.effect if law.curve is not None else law.effect
    if not isinstance(learned, ExponentialBank):
        return f'x is {law.follows}, {unit_of(law.follows)}'
    if learned.over == 'dynamics':
        return 'w is the yaw rate, rad/s'
    since = dict.fromkeys((LAST_TURN, ANY_TURN), 'the last turn ended')
    since |= {LAST_REST: 'the last rest ended', START: 'the start'}
    if (event := event_of(law.follows)) is not None:
        return f'x is the time since {event.in_words}, s'
    return f'x is the time since {since.get(law.follows, f"a unit step of {drive_in_words(law.follows)}")}, s'


def drive_in_words(drive: str) -> str:
    """Return the drive of a memory whose response is that to a step."""
    words = {
        SIDE: 'the side of the turn',
        ABS_RATE: 'the magnitude of the rate',
        MOVING: 'the motion (0 or 1)',
    }
    return words.get(drive, drive)


def nothing_learned(contradicts: bool) -> str:
    """Return why nothing was learned.

    Args:
        contradicts: True if the recording contradicts the model.
    """
    if contradicts:
        return 'Nothing was learned: no law predicts the recording better without more drift.'
    return 'No law was learned: the recording does not contradict the model.'


def bump_in_words(found: BumpFit) -> str:
    """Return the closed form of a map in one line."""
    height = with_std(math.degrees(found.height), math.degrees(found.std))
    place = f'x = {found.x_m:.2f} m, y = {found.y_m:.2f} m in the map'
    return f'bump of {height} deg/s at {place}, width {found.width_m:.2f} m; {100.0 * found.explained:.1f} %'


def form_in_words(found: ClosedForm) -> str:
    """Return a closed form with its parameters in one line."""
    values = ', '.join(
        with_std(value, std) for value, std in zip(found.values.tolist(), found.stds.tolist(), strict=True)
    )
    unit = '' if found.form.over == 'signal' else ' s'
    scanned = f', p = {found.parameter:.3g}{unit}' if found.parameter else ''
    scanned += f', a {found.physical}' if found.physical else ''
    verdict = 'fits' if found.fits else 'does not fit'
    library = f'; the library has it as {found.library}' if found.library else ''
    share = f'{100.0 * found.explained:.1f} %'
    return f'{found.form.name}: {values} times ({found.form.equation}){scanned}; {verdict}, {share}{library}'
