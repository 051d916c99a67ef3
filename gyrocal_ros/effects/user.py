"""Effects of the user's own: from a Python file, or from an installed package.

Whatever is wrong with one is said at once and in words, before a filter runs with it.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np

from gyrocal_ros.data import Array, MotionBlock, nanoseconds
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.base import Explanation, LibraryEffect
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.sensor import Coefficient, Place

ENTRY_POINTS = 'gyrocal_ros.effects'
"""Group of entry points in which an installed package names its effect classes."""
GUIDE = 'docs/your_own_effect.md shows a complete one'
METHODS = {
    'gyro': ('contribute',),
    'wheels': ('contribute',),
    'ground': ('contribute',),
    'camera': ('corrected', 'pixels_by_values'),
    'time': (),
}
NEEDED_WORDS = ('physics', 'equation', 'usual_size', 'best_motion')


def load_file(path: Path) -> tuple[LibraryEffect, ...]:
    """Register every effect class of a Python file; a file that is loaded already is not read again.

    Raises:
        ConfigError: the file cannot be read, defines no effect, or one that is not complete.
    """
    name = f'gyrocal_effects_{re.sub(r"[^0-9a-zA-Z]", "_", str(path.resolve()))}'
    if name not in sys.modules:
        module = _imported(name, path)
        try:
            for made in _effects_of(module, str(path)):
                register(made, str(path))
        except ConfigError:
            del sys.modules[name]
            raise
    return tuple(effect for effect in EFFECTS.values() if type(effect).__module__ == name)


def load_installed() -> None:
    """Register the effects that installed packages name as entry points.

    Raises:
        ConfigError: one of them cannot be loaded or is not complete.
    """
    for entry in entry_points(group=ENTRY_POINTS):
        where = f'entry point {entry.value}'
        if entry.name in EFFECTS and type(EFFECTS[entry.name]).__module__ == entry.module:
            continue
        try:
            kind = entry.load()
        except Exception as error:
            raise ConfigError(f'cannot be loaded ({error})', where=where, todo='reinstall it') from error
        register(_made(kind, where), where)


def register(effect: Any, where: str) -> None:
    """Put an effect into the table, for this process.

    Raises:
        ConfigError: there is one of that name, or it is not complete.
    """
    wrong = next(_faults(effect), None)
    if wrong:
        raise ConfigError(wrong, where=f'{where}, {type(effect).__name__}', todo=GUIDE)
    if effect.name in EFFECTS:
        raise ConfigError(f'there is an effect {effect.name!r} already', where=where, todo='rename yours')
    EFFECTS[effect.name] = effect


def _imported(name: str, path: Path) -> ModuleType:
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigError('is no Python file', where=str(path), todo=GUIDE)
    module = module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look their own module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        what = f'{type(error).__name__}: {error}'
        raise ConfigError(what, where=str(path), todo='mend the file') from error
    return module


def _effects_of(module: ModuleType, where: str) -> list[Any]:
    kinds = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and kind.__module__ == module.__name__ and hasattr(kind, 'acts_on')
    ]
    kinds = [kind for kind in kinds if not inspect.isabstract(kind) and not kind.__name__.startswith('_')]
    if not kinds:
        raise ConfigError('defines no effect', where=where, todo=GUIDE)
    return [_made(kind, where) for kind in kinds]


def _made(kind: Any, where: str) -> Any:
    try:
        return kind()
    except Exception as error:
        what = f'{getattr(kind, "__name__", kind)} cannot be made without arguments ({error})'
        raise ConfigError(what, where=where, todo=GUIDE) from error


# --- what may be wrong with an effect -------------------------------------------------------------


def _faults(effect: Any) -> Iterator[str]:
    """What keeps an effect from being used; each test may rely on those before."""
    name, place = getattr(effect, 'name', None), getattr(effect, 'acts_on', None)
    if not isinstance(name, str) or not re.fullmatch(r'[a-z][a-z0-9_]*', name):
        yield f'name is {name!r}, not small letters, digits and underscores'
    if place not in get_args(Place):
        yield f'acts_on is {place!r}, not one of {", ".join(get_args(Place))}'
    items = getattr(effect, 'coefficients', None)
    if not isinstance(items, tuple) or not items or not all(isinstance(item, Coefficient) for item in items):
        yield 'coefficients is no tuple of Coefficient'
        return
    if len({item.name for item in items}) < len(items):
        yield 'two coefficients have the same name'
    if not is_dataclass(effect) or 'coefficients' not in {item.name for item in fields(effect)}:
        yield 'is no dataclass with a field coefficients, so that priors could be set'
    yield from _faults_of_words(effect, len(items))
    missing = [method for method in METHODS[str(place)] if not callable(getattr(effect, method, None))]
    if missing:
        yield f'lacks {" and ".join(missing)}'
    elif 'contribute' in METHODS[str(place)]:
        yield from _faults_of_contribution(effect)


def _faults_of_words(effect: Any, count: int) -> Iterator[str]:
    about = getattr(effect, 'about', None)
    if not isinstance(about, Explanation):
        yield 'about is no Explanation'
        return
    for word in NEEDED_WORDS:
        if not getattr(about, word).strip():
            yield f'about says nothing of {word}'
    if len(about.example) != count:
        yield f'about.example has {len(about.example)} values for {count} coefficients'


def _faults_of_contribution(effect: Any) -> Iterator[str]:
    """Shapes, numbers and derivative, tried on a short motion; signals may be missing in a bag."""
    values = np.array(effect.about.example, float)
    shape = {'gyro': (6,), 'wheels': (6,), 'ground': (3,)}[effect.acts_on]
    block = _trial_block()
    try:
        added, by_values = _contribution(effect, block, values)
        bare, _ = _contribution(effect, replace(block, temperature_c=np.full(6, np.nan)), values)
    except Exception as error:
        yield f'contribute fails: {type(error).__name__}: {error}'
        return
    found, wanted = (np.shape(added), np.shape(by_values)), (shape, (*shape, len(values)))
    if found != wanted:
        yield f'contribute gives arrays of the shapes {found}, not {wanted}'
        return
    if not np.all(np.isfinite(added)) or not np.all(np.isfinite(bare)):
        yield 'contribute is not a number where no temperature is recorded; use `recorded`'
    for place, item in enumerate(effect.coefficients):
        step = 1e-4 * (abs(values[place]) or item.prior_std)
        nudge = step * np.eye(len(values))[place]
        after, before = (_contribution(effect, block, values + side * nudge)[0] for side in (1, -1))
        expected = (after - before) / (2.0 * step)
        wrong = np.abs(by_values[..., place] - expected).max() > 1e-3 * np.abs(expected).max() + 1e-12
        if item.prior_std > 0.0 and wrong:
            yield f'contribute gives a wrong derivative by {item.name}'


def _contribution(effect: Any, block: MotionBlock, values: Array) -> tuple[Array, Array]:
    if effect.acts_on == 'gyro':
        term = effect.contribute(block, values, None)
        return term.rate_rad_s, term.by_values
    added, by_values = effect.contribute(block, values)
    return added, by_values


def _trial_block() -> MotionBlock:
    """Six intervals in which everything moves."""
    rng = np.random.default_rng(0)
    dt_s = np.full(6, 0.005)
    rates = rng.uniform(-1.0, 1.0, (6, 3))
    return MotionBlock(
        start_ns=nanoseconds(30.0),
        end_ns=nanoseconds(30.03),
        time_s=30.0025 + np.arange(6) * 0.005,
        dt_s=dt_s,
        rate_rad_s=rates,
        yaw_acceleration_rad_s2=rng.uniform(-5.0, 5.0, 6),
        specific_force_m_s2=rng.uniform(-1.0, 1.0, (6, 3)),
        vibration_m2_s4=rng.uniform(0.01, 0.1, 6),
        distance_m=rng.uniform(1e-3, 2e-3, 6),
        wheel_turn_rad=rates[:, 2] * dt_s,
        temperature_c=rng.uniform(30.0, 40.0, 6),
    )
