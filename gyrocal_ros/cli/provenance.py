"""Version and machine with which figures were measured."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np

from gyrocal_ros import __version__

CPU_INFO = Path('/proc/cpuinfo')


def provenance() -> dict[str, str]:
    """Return version and machine, for output beside measured figures."""
    software = f'{platform.system()}, Python {platform.python_version()}, NumPy {np.__version__}'
    return {'version': __version__, 'machine': f'{_processor()}, {os.cpu_count()} cores, {software}'}


def _processor() -> str:
    """Return the name of the processor if the system reports it, otherwise its architecture."""
    if CPU_INFO.is_file():
        for line in CPU_INFO.read_text(encoding='utf-8').splitlines():
            name, _, value = line.partition(':')
            if name.strip() == 'model name':
                return value.strip()
    return platform.machine()
