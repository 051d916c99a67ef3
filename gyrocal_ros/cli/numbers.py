"""Types of numeric arguments that are checked against their bounds while the arguments are parsed."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def whole_number(low: int, high: float = math.inf) -> Callable[[str], int]:
    """Return an argument type for whole numbers from `low` to `high`."""
    return lambda text: int(_checked(text, int, low, high, ''))


def number(low: float, high: float = math.inf, unit: str = '') -> Callable[[str], float]:
    """Return an argument type for finite numbers from `low` to `high`, in `unit`."""
    return lambda text: float(_checked(text, float, low, high, unit))


def _checked(text: str, kind: type[float], low: float, high: float, unit: str) -> float:
    try:
        value = kind(text)
        is_possible = low <= value <= high and math.isfinite(value)
    except (ValueError, OverflowError):
        is_possible = False
    if not is_possible:
        bounds = f'at least {low:.10g}' if math.isinf(high) else f'{low:.10g} to {high:.10g}'
        what = 'a whole number, ' if kind is int else ''
        raise argparse.ArgumentTypeError(f'{text!r} is not possible, give {what}{bounds} {unit}'.rstrip())
    return value
