"""`model.yaml`: a sensor model that a person can edit.

name: default
version: 1
bias: {form: drift}
effects:
  - scale_factor
  - name: scale_cubic
    prior_std: {a3: 0.001}
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

import yaml

from gyrocal_ros.config.yaml_file import load_yaml, read_yaml
from gyrocal_ros.effects.learned import in_closed_form
from gyrocal_ros.effects.library import SCALE_FACTOR
from gyrocal_ros.effects.registry import default_model, find_effect, load_file, load_installed
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import MAX_VALUE, Effect, SensorModel, is_possible

BIAS_FORMS = ('drift', 'settling')


def load_model(path: Path | None) -> SensorModel:
    """Read a sensor model; without a path, return the default one.

    Raises:
        ConfigError: the file cannot be read, or contains an unknown effect or coefficient.
    """
    return default_model() if path is None else model_from_dict(read_yaml(path), str(path))


def load_model_with_effects(path: str, effects_from: str) -> SensorModel:
    """Register installed effects and those of a file, then read a sensor model that may use them.

    Args:
        path: `model.yaml`; empty for the default model.
        effects_from: Python file with effect classes; empty for none.

    Raises:
        ConfigError: a file cannot be used.
    """
    load_installed()
    if effects_from:
        load_file(Path(effects_from).expanduser())
    return load_model(Path(path).expanduser() if path else None)


def model_from_dict(tree: Mapping[str, Any], where: str) -> SensorModel:
    """Make a sensor model from the content of a `model.yaml`.

    Raises:
        ConfigError: an entry is unknown, duplicate or of the wrong type.
    """
    _only(tree, ('name', 'version', 'bias', 'effects'), where)
    entries = tree.get('effects')
    if not isinstance(entries, list) or not entries:
        raise ConfigError('lists no effects', where=where, todo='begin with `effects: [scale_factor]`')
    effects = tuple(_effect(entry, where) for entry in entries)
    names = [effect.name for effect in effects]
    if names[0] != SCALE_FACTOR:
        raise ConfigError(f'the first effect must be {SCALE_FACTOR}', where=where)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise ConfigError(f'{twice} is listed twice', where=where)
    return SensorModel(
        name=str(tree.get('name', Path(where).stem)),
        bias=_bias(tree.get('bias', {}), where),
        effects=effects,
        version=_integer(tree.get('version', 1), where),
    )


def model_to_dict(model: SensorModel) -> dict[str, Any]:
    """Return the content of a `model.yaml` that reproduces this model, with every prior."""
    bias: dict[str, Any] = {'form': model.bias.form}
    if model.bias.form == 'settling':
        bias |= {
            'time_constant_s': model.bias.time_constant_s,
            'settled_deg_s': math.degrees(model.bias.settled_rad_s),
        }
    effects = [
        {
            'name': effect.name,
            'prior_mean': {item.name: item.prior_mean for item in effect.coefficients},
            'prior_std': {item.name: item.prior_std for item in effect.coefficients},
            'walk': {item.name: item.walk for item in effect.coefficients},
        }
        | options_of(effect)
        for effect in model.effects
    ]
    return {'name': model.name, 'version': model.version, 'bias': bias, 'effects': effects}


def model_to_yaml(model: SensorModel) -> str:
    """Format a sensor model as YAML text."""
    return yaml.safe_dump(model_to_dict(model), sort_keys=False)


def with_entry(text: str, entry: str | Mapping[str, Any], where: str) -> str:
    """Add one effect to the text of a `model.yaml` and increase its version; the rest stays unchanged.

    Args:
        text: a valid `model.yaml`.
        entry: entry for the list of effects.
        where: the file, for error messages.

    Raises:
        ConfigError: the model cannot have that effect, or the style of the text is not supported.
    """
    tree = load_yaml(text)
    tree['effects'].append(entry)
    if 'version' in tree:
        tree['version'] += 1
        old = _nodes(text)['version']
        text = f'{text[: old.start_mark.index]}{tree["version"]}{text[old.end_mark.index :]}'
    wanted = model_from_dict(tree, where)
    line = entry if isinstance(entry, str) else yaml.safe_dump(entry, default_flow_style=True, width=1000)
    added = _after_last(text, _nodes(text)['effects'], line.strip())
    try:
        if model_from_dict(load_yaml(added), where) == wanted:
            return added
    except yaml.YAMLError:
        pass
    todo = f'add `- {line.strip()}` under effects by hand'
    raise ConfigError('is written in a way that cannot be added to', where=where, todo=todo)


def _nodes(text: str) -> dict[str, Any]:
    """Return the top-level nodes of a YAML text, which hold their positions in it."""
    node: Any = yaml.compose(text, yaml.SafeLoader)
    return {key.value: value for key, value in node.value}


def _after_last(text: str, effects: Any, entry: str) -> str:
    """Insert an entry after the last one of the list of effects."""
    last = leaf = effects.value[-1]
    if effects.flow_style:
        place = last.end_mark.index
        return f'{text[:place]}, {entry}{text[place:]}'
    while isinstance(leaf, yaml.MappingNode | yaml.SequenceNode) and not leaf.flow_style:
        leaf = leaf.value[-1][1] if isinstance(leaf, yaml.MappingNode) else leaf.value[-1]
    lines = text.splitlines()
    last_line = lines[last.start_mark.line]
    indent = last_line[: len(last_line) - len(last_line.lstrip())]
    lines.insert(leaf.end_mark.line + 1, f'{indent}- {entry}')
    return '\n'.join(lines) + '\n'


def _effect(entry: Any, where: str) -> Effect:
    if isinstance(entry, str):
        return find_effect(entry, where)
    if not isinstance(entry, Mapping) or 'name' not in entry:
        raise ConfigError(f'{entry!r} is not an effect', where=where, todo='give its name')
    effect = find_effect(str(entry['name']), where)
    if 'form' in entry:
        effect = in_closed_form(effect.name, str(entry['form']), where)
    options = options_of(effect)
    _only(entry, ('name', 'prior_mean', 'prior_std', 'walk', *options), where)
    coefficients = {item.name: item for item in effect.coefficients}
    for field, low in (('prior_mean', -math.inf), ('prior_std', 0.0), ('walk', 0.0)):
        place = f'{where}, {effect.name}.{field}'
        for name, value in _per_coefficient(effect, entry.get(field, {}), place).items():
            number = _number(name, value, place, low)
            item = coefficients[name]
            if not is_possible(item, number) and (field == 'prior_mean' or number > MAX_VALUE):
                raise ConfigError(f'{name} is {value!r}', where=place, todo='give a number that makes sense')
            coefficients[name] = replace(coefficients[name], **{field: number})  # type: ignore[arg-type]
    given = {
        name: _option(effect, name, entry[name], default, where)
        for name, default in options.items()
        if name in entry
    }
    return replace(effect, coefficients=tuple(coefficients.values()), **given)  # type: ignore[type-var]


def options_of(effect: Effect) -> dict[str, Any]:
    """Return the settings of an effect in `model.yaml` other than its coefficients, with their values."""
    fixed = ('name', 'coefficients', 'signal', 'power')
    names = [item.name for item in fields(effect) if item.name not in fixed]  # type: ignore[arg-type]
    return {name: getattr(effect, name) for name in names}


def own_options(effect: Effect) -> dict[str, Any]:
    """Return the settings of an effect that are not those of the usual one of its name."""
    before = options_of(find_effect(effect.name))
    return {name: value for name, value in options_of(effect).items() if value != before[name]}


def _option(effect: Effect, name: str, value: Any, default: Any, where: str) -> Any:
    choices = get_args(get_type_hints(type(effect))[name])  # of a Literal
    if isinstance(default, str) and choices and value not in choices:
        todo = f'choose from {", ".join(choices)}'
        raise ConfigError(f'{name} of {effect.name} is {value!r}', where=where, todo=todo)
    if isinstance(default, float):
        return _number(name, value, where, -math.inf)
    if not isinstance(value, type(default)):
        raise ConfigError(f'{name} is {value!r}', where=where, todo=f'write it as {default!r}')
    return value


def _per_coefficient(effect: Effect, given: Any, where: str) -> Mapping[str, Any]:
    """Return values by the names of the coefficients; a single value is that of the only coefficient."""
    names = [item.name for item in effect.coefficients]
    if not isinstance(given, Mapping):
        if len(names) > 1:
            raise ConfigError('has several coefficients', where=where, todo=f'name them: {", ".join(names)}')
        given = {names[0]: given}
    for name in given:
        if name not in names:
            raise ConfigError(
                f'there is no coefficient {name!r}', where=where, todo=did_you_mean(name, names)
            )
    return given


def _bias(given: Any, where: str) -> BiasModel:
    if not isinstance(given, Mapping):
        raise ConfigError('bias holds no settings', where=where, todo='write `bias: {form: drift}`')
    _only(given, ('form', 'time_constant_s', 'settled_deg_s'), f'{where}, bias')
    form = str(given.get('form', 'drift'))
    if form not in BIAS_FORMS:
        raise ConfigError(f'bias form {form!r}', where=where, todo=did_you_mean(form, list(BIAS_FORMS)))
    time_constant_s = _number('time_constant_s', given.get('time_constant_s', 500.0), f'{where}, bias', 1e-3)
    settled_deg_s = _number('settled_deg_s', given.get('settled_deg_s', 0.0), f'{where}, bias')
    return BiasModel(form, time_constant_s, math.radians(settled_deg_s))


def _only(tree: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for name in tree:
        if name not in known:
            raise ConfigError(
                f'{name!r} is not known', where=where, todo=did_you_mean(str(name), list(known))
            )


def _number(name: str, value: Any, where: str, low: float = -math.inf) -> float:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not known or value < low:
        raise ConfigError(f'{name} is {value!r}', where=where, todo='give a number that makes sense')
    return float(value)


def _integer(value: Any, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise ConfigError(f'version is {value!r}', where=where, todo='give a whole number')
    return value
