"""The effects known to this process: those of the library, of the user's files and of installed packages.

An incomplete effect is refused with one line that says what is wrong, before a filter runs with it.
"""

from __future__ import annotations

import inspect
import re
import sys
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.checks import faults
from gyrocal_ros.effects.learned import LEARNED_EFFECTS
from gyrocal_ros.effects.library import COVARIATE_EFFECTS, SCALE_FACTOR, SHIPPED
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import SensorModel

ENTRY_POINTS = 'gyrocal_ros.effects'
"""Group of entry points in which an installed package names its effect classes."""
GUIDE = 'docs/your_own_effect.md shows a complete one'

EFFECTS: dict[str, LibraryEffect] = {effect.name: effect for effect in SHIPPED}
"""All effects by name; `register` adds to them."""


def find_effect(name: str, where: str = '') -> LibraryEffect:
    """Return the effect of that name with its usual priors.

    Args:
        name: a key of `EFFECTS`, `scale_power_N` for a power above the third, or the name of a covariate
            or learned effect followed by a colon and its signal.
        where: file that contains the name, for the error message.

    Raises:
        ConfigError: there is no such effect.
    """
    if name not in EFFECTS and ':' not in name:
        load_installed()
    if name in EFFECTS:
        return EFFECTS[name]
    power = re.fullmatch(r'scale_power_([4-9])', name)
    if power:
        return scale_power(int(power.group(1)))
    kind, _, signal = name.partition(':')
    following = COVARIATE_EFFECTS | LEARNED_EFFECTS
    if kind in following and signal:
        return following[kind](signal)
    known = [*EFFECTS, 'scale_power_4', *(f'{kind}:SIGNAL' for kind in following)]
    raise ConfigError(f'there is no effect {name!r}', where=where, todo=did_you_mean(name, known))


def default_model() -> SensorModel:
    """Return the model that a robot starts with: one scale factor, and a bias that drifts."""
    return SensorModel('default', BiasModel(), (find_effect(SCALE_FACTOR),))


def load_file(path: Path) -> tuple[LibraryEffect, ...]:
    """Register every effect class of a Python file; a file that was loaded before is not read again.

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
    """Add an effect to `EFFECTS`, for this process.

    Raises:
        ConfigError: there is one of that name, or it is not complete.
    """
    wrong = next(faults(effect), None)
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
    sys.modules[name] = module  # dataclasses look up their own module there
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        what = f'{type(error).__name__}: {error}'
        raise ConfigError(what, where=str(path), todo='fix the file') from error
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
