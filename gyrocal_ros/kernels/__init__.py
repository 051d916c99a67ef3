"""Compiled twins of the inner loops of the filter and of the diagnosis.

A function marked `@compiled` is the NumPy form of its equations: the reference, and what runs where the twins
were not built. Its twin of the same name and arguments is written in Cython, one file here for each subject,
and is built with the package where there is a C compiler. Both agree to rounding; a test compares them.
`GYROCAL_KERNELS=numpy` in the environment selects the references.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec('P')
R = TypeVar('R')

CHOICE = 'GYROCAL_KERNELS'
"""Name of the environment variable that selects the NumPy forms."""
SUBJECTS = (
    'cameras',
    'headings',
    'innovations',
    'landmarks',
    'motion',
    'records',
    'references',
    'robust',
    'samples',
    'watches',
)
"""Files of twins in this room."""
REFERENCES: dict[str, Callable[..., Any]] = {}
"""NumPy forms by name, as they are marked."""


def _load() -> dict[str, Callable[..., Any]]:
    """Return the twins by name; none where they were not built, or are not wanted."""
    if os.environ.get(CHOICE) == 'numpy':
        return {}
    try:
        modules = [importlib.import_module(f'{__name__}.{subject}') for subject in SUBJECTS]
    except ImportError:
        return {}
    return {name: getattr(module, name) for module in modules for name in module.TWINS}


TWINS = _load()
"""Twins by name; empty where the NumPy forms are used."""
IN_USE = 'compiled' if TWINS else 'numpy'
"""Which form is used."""


def compiled(reference: Callable[P, R]) -> Callable[P, R]:
    """Mark the NumPy form of a kernel, and return its twin where that was built."""
    REFERENCES[reference.__name__] = reference
    twin = TWINS.get(reference.__name__)
    return reference if twin is None else twin
