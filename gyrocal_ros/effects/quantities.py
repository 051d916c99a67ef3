"""Values of coefficients as people write them: a number, with or without its deviation and unit."""

from __future__ import annotations

import re

from gyrocal_ros.effects.base import shown_in
from gyrocal_ros.effects.model_file import own_options
from gyrocal_ros.effects.registry import find_effect
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.sensor import Coefficient, Effect, is_possible

NUMBER = r'(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
QUANTITY = re.compile(rf'([-+]?{NUMBER})(?:\s*(?:±|\+-|\+/-)\s*({NUMBER}))?\s*(.*)')


def coefficient_value(item: Coefficient, text: str, where: str) -> float:
    """Read the value of a coefficient, in its unit, or in degrees where results show it in degrees.

    Args:
        item: the coefficient.
        text: such as `-0.01`, `-0.01 rad/s` or `-0.57deg/s`.
        where: option that contains the text, for the error message.

    Returns:
        The value in the unit of the coefficient.

    Raises:
        ConfigError: it is not a number, has another unit, or a standard deviation.
    """
    value, std = coefficient_prior(item, text, where)
    if not is_possible(item, value):
        raise ConfigError(f'{item.name} is {text!r}', where=where, todo='give a number that makes sense')
    if std is not None:
        raise ConfigError(f'{item.name} is {text!r}', where=where, todo='give the value alone, without ±')
    return value


def coefficient_prior(item: Coefficient, text: str, where: str) -> tuple[float, float | None]:
    """Read value and standard deviation of a coefficient, as results show them.

    Args:
        item: the coefficient.
        text: such as `-0.01`, `-0.57deg/s`, `-0.57 ± 0.02 deg/s` or `-0.57+-0.02deg/s`.
        where: option that contains the text, for the error message.

    Returns:
        Both in the unit of the coefficient; None for a standard deviation that is not given.

    Raises:
        ConfigError: one is not a number, or has another unit.
    """
    units = accepted_units(item)
    match = QUANTITY.fullmatch(text.strip().replace('\N{MINUS SIGN}', '-'))
    if match is None:
        todo = f'give a number in {" or ".join(units)}' if units else 'give a number'
        raise ConfigError(f'{item.name} is {text!r}', where=where, todo=todo)
    value, unit = float(match.group(1)), match.group(3)
    std = None if match.group(2) is None else float(match.group(2))
    if unit and unit not in units:
        todo = f'give it in {" or ".join(units)}' if units else 'give a number without a unit'
        raise ConfigError(f'{item.name} is {text!r}, a value in {unit!r}', where=where, todo=todo)
    if std == 0.0:
        todo = 'leave the deviation out, or give one above zero'
        raise ConfigError(f'{item.name} is {text!r}', where=where, todo=todo)
    shown, factor = shown_in(item.unit)
    factor = factor if unit == shown else 1.0
    return value / factor, None if std is None else std / factor


def accepted_units(item: Coefficient) -> tuple[str, ...]:
    """Return the units in which a value may be given: that of the coefficient, and deg in place of rad."""
    if item.unit.startswith('rad'):
        return item.unit, shown_in(item.unit)[0]
    return () if item.unit == '1' else (item.unit,)


def add_words(effect: Effect) -> list[str]:
    """Return the words of the command that adds an effect to a model, with its priors and options.

    The model that it makes runs as one with the effect itself.
    """
    usual = find_effect(effect.name)
    settings = [
        f'{name}={value:.8g}' if isinstance(value, float) else f'{name}={value}'
        for name, value in own_options(effect).items()
    ]
    settings += [
        f'{item.name}={_prior_text(item)}'
        for item, known in zip(effect.coefficients, usual.coefficients, strict=True)
        if (item.prior_mean, item.prior_std) != (known.prior_mean, known.prior_std)
    ]
    return ['gyrocal', 'add', effect.name, *(word for text in settings for word in ('--set', text))]


def _prior_text(item: Coefficient) -> str:
    """Return a prior as `coefficient_prior` reads it; all digits of a limit, which no run corrects."""
    unit, factor = shown_in(item.unit)
    unit = '' if unit == '1' else f' {unit}' if unit[0].isdigit() else unit
    if item.prior_std == 0.0:
        return f'{factor * item.prior_mean:.8g}{unit}'
    std = float(f'{factor * item.prior_std:.2g}')
    return f'{factor * item.prior_mean:.4g}+-{std:g}{unit}'
