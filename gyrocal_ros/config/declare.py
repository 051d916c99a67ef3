"""Declaration, checks, input and output of settings, which are fields of dataclasses called sections.

A setting is declared with its default, unit, bounds and description in one place. YAML files, ROS
parameters and the settings saved with every result all derive from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import chain
from typing import Any, TypeVar

import yaml

from gyrocal_ros.errors import ConfigError, did_you_mean

T = TypeVar('T')
Sections = TypeVar('Sections')
"""A dataclass whose fields are sections, which are dataclasses whose fields are settings."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Unit, bounds and description of a setting."""

    unit: str
    help: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False
    """True if a change takes effect while a node runs; other settings are read at its start."""


def setting(
    default: T,
    unit: str,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> T:
    """Declare a dataclass field together with its unit, bounds and description."""
    metadata = {'setting': Setting(unit, help, low, high, choices, live)}
    return field(default=default, metadata=metadata)  # type: ignore[return-value]


def flat_settings(config: Any) -> Iterator[tuple[str, Any, Setting]]:
    """Yield name (`section.setting`), value and declaration of every setting, in order."""
    for section in fields(config):
        values = getattr(config, section.name)
        for item in fields(values):
            yield f'{section.name}.{item.name}', getattr(values, item.name), item.metadata['setting']


def to_dict(config: Any) -> dict[str, dict[str, Any]]:
    """Return the settings as nested plain values, as they are saved with every result."""
    return {
        section.name: {item.name: plain(getattr(values, item.name)) for item in fields(values)}
        for section in fields(config)
        for values in [getattr(config, section.name)]
    }


def plain(value: Any) -> Any:
    """Return the value of a setting as YAML and ROS parameters represent it: a tuple becomes a list."""
    return list(value) if isinstance(value, tuple) else value


def to_yaml(*configs: Any) -> str:
    """Return the settings as a commented ROS 2 parameter file for any node; `parameter_file` reads it."""
    lines = ['/**:', '  ros__parameters:']
    section = ''
    for name, value, spec in chain.from_iterable(map(flat_settings, configs)):
        new_section, item = name.split('.')
        if new_section != section:
            section = new_section
            lines.append(f'    {section}:')
        bounds = '' if spec.low is None else f', {spec.low:g} to {spec.high:g}'
        unit = f' [{spec.unit}]' if spec.unit else ''
        lines.append(f'      # {spec.help}{unit}{bounds}')
        text = yaml.safe_dump(plain(value), width=math.inf, default_flow_style=True).splitlines()[0]
        lines.append(f'      {item}: {text}')
    return '\n'.join(lines) + '\n'


def with_settings(config: Sections, nested: Mapping[str, Any], where: str = 'settings') -> Sections:
    """Return `config` with the values of `{section: {setting: value}}`.

    Raises:
        ConfigError: a name is unknown, or a value has the wrong type or is out of bounds.
    """
    assert is_dataclass(config) and not isinstance(config, type)
    sections = {item.name: getattr(config, item.name) for item in fields(config)}
    for section_name, entries in nested.items():
        section = sections.get(_known(section_name, list(sections), where))
        if not isinstance(entries, Mapping):
            raise ConfigError(f'section {section_name!r} contains no settings', where=where)
        assert is_dataclass(section) and not isinstance(section, type)
        known = {item.name: item for item in fields(section)}
        values = {}
        for name, value in entries.items():
            item = known[_known(name, list(known), f'{where}, section {section_name}')]
            default = getattr(section, name)
            values[name] = _checked(f'{section_name}.{name}', value, default, item.metadata['setting'], where)
        sections[section_name] = replace(section, **values)
    return replace(config, **sections)


def _known(name: str, known: list[str], where: str) -> str:
    if name not in known:
        raise ConfigError(f'{name!r} is not known', where=where, todo=did_you_mean(name, known))
    return name


def _checked(name: str, value: Any, default: Any, spec: Setting, where: str) -> Any:
    kind = type(default)
    if kind is tuple:
        return _checked_several(name, value, default, spec, where)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise ConfigError(f'{name} must be a {kind.__name__}, not {value!r}', where=where)
    if spec.choices and value not in spec.choices:
        raise ConfigError(f'{name} is {value!r}', where=where, todo=f'choose from {", ".join(spec.choices)}')
    if kind in (int, float):
        too_low = spec.low is not None and value < spec.low
        too_high = spec.high is not None and value > spec.high
        if too_low or too_high or not math.isfinite(value):
            raise ConfigError(
                f'{name} is {value}',
                where=where,
                todo=f'give {spec.low} to {spec.high} {spec.unit}'.rstrip(),
            )
    return value


def _checked_several(
    name: str, value: Any, default: tuple[Any, ...], spec: Setting, where: str
) -> tuple[Any, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != len(default):
        raise ConfigError(f'{name} must be {len(default)} numbers, not {value!r}', where=where)
    pairs = zip(value, default, strict=True)
    return tuple(_checked(f'{name}[{i}]', item, other, spec, where) for i, (item, other) in enumerate(pairs))
