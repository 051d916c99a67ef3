"""On what machine and with which version figures were measured."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np

from gyrocal_ros import __version__

CPU_INFO = Path('/proc/cpuinfo')


def provenance() -> dict[str, str]:
    """Version and machine, to stand beside every figure."""
    software = f'{platform.system()}, Python {platform.python_version()}, NumPy {np.__version__}'
    return {'version': __version__, 'machine': f'{_processor()}, {os.cpu_count()} cores, {software}'}


def _processor() -> str:
    """Its name where the system tells, else its kind."""
    if CPU_INFO.is_file():
        for line in CPU_INFO.read_text(encoding='utf-8').splitlines():
            name, _, value = line.partition(':')
            if name.strip() == 'model name':
                return value.strip()
    return platform.machine()
