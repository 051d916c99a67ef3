"""What the commands say: results on standard output, all else on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

T = TypeVar('T')


def progress(label: str, items: Iterable[T] = (), *, total: float | None = None, unit: str = 'it') -> tqdm[T]:
    """Show a progress bar with the time left, where a person is watching and the work takes a while.

    Iterate over it to get `items`, or give `total`, use it as a context and call its `update`.

    Args:
        label: what is being done.
        items: what is worked through.
        total: amount of work, where there are no `items` or they have no length.
        unit: unit of `total`.
    """
    return tqdm(
        items,
        desc=label,
        total=total,
        unit=unit,
        delay=2.0,
        leave=False,
        disable=not sys.stderr.isatty(),
    )


def warn(message: str) -> None:
    """Tell a person about something that the command has worked around."""
    print(f'gyrocal: warning: {message}', file=sys.stderr)


def print_json(values: Mapping[str, Any]) -> None:
    """Print one JSON object; numbers that are not finite become null, arrays become lists."""
    print(json.dumps(_plain(values), indent=2, ensure_ascii=False, allow_nan=False))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
