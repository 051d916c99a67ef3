"""Values of coefficients as people write them: a number, with or without its unit."""

from __future__ import annotations

import math
import re

from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.sensor import Coefficient

QUANTITY = re.compile(r'([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)')


def coefficient_value(item: Coefficient, text: str, where: str) -> float:
    """Read the value of a coefficient, in its unit, or in degrees where results show it in degrees.

    Args:
        item: the coefficient.
        text: such as `-0.01`, `-0.01 rad/s` or `-0.57deg/s`.
        where: option that contains the text, for the error message.

    Returns:
        The value in the unit of the coefficient.

    Raises:
        ConfigError: it is not a number, or has another unit.
    """
    units = accepted_units(item)
    match = QUANTITY.fullmatch(text.strip().replace('\N{MINUS SIGN}', '-'))
    if match is None:
        todo = f'give a number in {" or ".join(units)}' if units else 'give a number'
        raise ConfigError(f'{item.name} is {text!r}', where=where, todo=todo)
    value, unit = float(match.group(1)), match.group(2)
    if unit and unit not in units:
        todo = f'give it in {" or ".join(units)}' if units else 'give a number without a unit'
        raise ConfigError(f'{item.name} is {text!r}, a value in {unit!r}', where=where, todo=todo)
    return math.radians(value) if unit.startswith('deg') and item.unit.startswith('rad') else value


def accepted_units(item: Coefficient) -> tuple[str, ...]:
    """Return the units in which a value may be given: that of the coefficient, and deg in place of rad."""
    if item.unit.startswith('rad'):
        return item.unit, item.unit.replace('rad', 'deg', 1)
    return () if item.unit == '1' else (item.unit,)
