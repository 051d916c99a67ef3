"""What follows the events of a recorded signal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.learned import formula, memory
from gyrocal_ros.effects.learned.as_effect import effect_source
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.effects.learned.events import Event, count_events, event_of, events_in, since_event
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.effects.registry import load_file
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.effects.traits import required_signals

PUMP = 'pump/current.data'
DT_S = 0.25


def switched(*changes_s: float, end_s: float = 60.0) -> Array:
    """Return a signal of 2 that is 5 from the first to the second change, and so on."""
    time_s = np.arange(0.0, end_s, DT_S)
    return 2.0 + 3.0 * (np.searchsorted(changes_s, time_s, side='right') % 2)


def block_of(values: Array) -> MotionBlock:
    block = eventful_block(len(values))
    return replace(block, dt_s=np.full(len(values), DT_S), covariates={PUMP: values})


@pytest.mark.parametrize(
    'event', [Event(PUMP, 3.5, True), Event('a:b', -0.002, False), Event('x', 12820.0, True)]
)
def test_the_name_of_a_drive_tells_the_event(event: Event) -> None:
    assert event_of(event.drive) == event
    assert '+' not in event.drive, 'a name that a shell or a file system takes for something else'


@pytest.mark.parametrize('drive', ['rate', PUMP, 'above_:x', 'above_1', 'over_1:x', 'above_1.2.3:x'])
def test_other_drives_are_no_events(drive: str) -> None:
    assert event_of(drive) is None


def test_the_time_is_that_since_the_last_rise() -> None:
    values = switched(10.0, 20.0, 30.0, 31.0)
    has_been, since_s, _ = since_event(f'above_3.5:{PUMP}', block_of(values), None)
    time_s = DT_S * np.arange(len(values))
    assert np.array_equal(has_been, (time_s >= 10.0).astype(float))
    np.testing.assert_allclose(since_s[time_s < 30.0], np.maximum(time_s[time_s < 30.0] - 10.0, 0.0))
    np.testing.assert_allclose(since_s[time_s >= 30.0], time_s[time_s >= 30.0] - 30.0)


def test_it_does_not_depend_on_how_the_samples_are_cut() -> None:
    values, kept, parts = switched(7.0, 20.0, 33.0), None, []
    for part in np.array_split(values, 17):
        _, since_s, kept = since_event(f'below_3.5:{PUMP}', block_of(part), kept)
        parts.append(since_s)
    whole = since_event(f'below_3.5:{PUMP}', block_of(values), None)[1]
    np.testing.assert_allclose(np.concatenate(parts), whole)


def test_noise_about_the_value_is_no_event() -> None:
    values = switched(10.0)
    values[-80::2] = 2.0
    _, since_s, _ = since_event(f'above_3.5:{PUMP}', block_of(values), None)
    np.testing.assert_allclose(since_s[-1], 50.0 - DT_S)


def test_the_side_at_the_start_is_no_event() -> None:
    has_been, _, _ = since_event(f'above_3.5:{PUMP}', block_of(switched(0.0, 30.0)), None)
    assert not has_been.any()


def test_a_signal_that_is_not_recorded_has_no_events() -> None:
    columns = memory('bias', f'above_3.5:{PUMP}').contribute(
        replace(block_of(switched(10.0)), covariates={}), np.ones(6), None
    )
    assert not columns.by_values.any()


def test_the_bank_fades_after_the_event() -> None:
    bank = memory('bias', f'above_3.5:{PUMP}')
    columns = bank.contribute(block_of(switched(10.0)), np.zeros(6), None).by_values
    np.testing.assert_allclose(columns[-1], np.exp(-(50.0 - DT_S) / bank.tau_s))
    assert bank.signal == PUMP, 'the recording has to have it'


@pytest.mark.usefixtures('library')
@pytest.mark.parametrize(
    'form', ['fading exponential', 'fading of the second order', 'fading hyperbola', 'lasting']
)
@pytest.mark.parametrize(('of', 'drive'), [('bias', f'above_3.5:{PUMP}'), ('scale', f'below_3.5:{PUMP}')])
def test_a_closed_form_is_that_of_the_time_since_the_event(
    of: Of, drive: str, form: str, tmp_path: Path
) -> None:
    effect, block = formula(f'{of}_memory:{drive}', form, 4.0), block_of(switched(10.0, 30.0))
    found = effect.contribute(block, np.ones(1), None).by_values[:, 0]
    has_been, since_s, _ = since_event(drive, block, None)
    rate = block.rate_rad_s[:, 2] if of == 'scale' else 1.0
    np.testing.assert_allclose(found, has_been * rate * effect.closed_form.columns(since_s, 4.0)[:, 0])
    assert np.abs(found).max() > 0.0 and not found[:40].any()
    path = tmp_path / 'law.py'
    path.write_text(effect_source(effect, (0.01,), 'a recording'))
    (written,) = load_file(path)
    by_value = written.contribute(block, np.ones(1), None).by_values  # type: ignore[attr-defined]
    assert by_value[:, 0] == pytest.approx(found)
    assert required_signals(written) == (PUMP,)


@pytest.mark.parametrize('drive', [f'above_3.5:{PUMP}', f'below_3.5:{PUMP}', 'above_30:temperature'])
def test_a_sketch_shows_the_event(drive: str) -> None:
    drawn = sketch(formula(f'bias_memory:{drive}', 'fading exponential', 4.0))
    (curve,) = drawn.lines.values()
    began_s = 30.0 if drive.startswith('above') else 5.0
    assert not curve[drawn.x < began_s].any() and curve[drawn.x > began_s][0] > 0.0


def test_a_model_keeps_it() -> None:
    names = [
        f'scale_memory:below_-0.002:{PUMP}',
        {'name': f'bias_memory:above_12820:{PUMP}', 'form': 'lasting'},
    ]
    tree = {'effects': ['scale_factor', *names]}
    model = model_from_dict(tree, 'a test')
    assert model_from_dict(model_to_dict(model), 'a test') == model


@pytest.mark.parametrize(
    ('changes_s', 'rises', 'falls'),
    [
        ((10.0, 20.0, 30.0, 40.0), 2, 2),
        ((10.0, 20.0, 20.5, 30.0), 1, 2),
        ((30.0,), 1, 0),
        ((58.0, 59.0), 0, 0),
    ],
)
def test_events_are_counted(changes_s: tuple[float, ...], rises: int, falls: int) -> None:
    """A pause of half a second is no fall and rise; a signal that is hardly ever high has no events."""
    values = switched(*changes_s)
    dt_s = np.full(len(values), DT_S)
    counts = [count_events(Event(PUMP, 3.5, up), values, dt_s) for up in (True, False)]
    assert counts == [rises, falls]


def test_unknown_values_are_left_out() -> None:
    values = switched(10.0, 20.0, 30.0, 40.0)
    values[::3] = np.nan
    assert count_events(Event(PUMP, 3.5, True), values, np.full(len(values), DT_S)) == 2


def test_a_range_is_divided() -> None:
    found = events_in(PUMP, 2.0, 5.0)
    assert {event.value for event in found} == {2.75, 3.5, 4.25}
    assert found[0] == Event(PUMP, 3.5, rises=True), 'the middle is taken where all are as frequent'
