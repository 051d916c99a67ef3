"""Damage to the YAML files that a user gives: sensor models, settings and calibrations."""

from __future__ import annotations

from pathlib import Path
from random import Random

from gyrocal_ros.bench.faults.bag_bytes import STRANGE_VALUES, damaged_bytes


def damaged_document(random: Random, text: str) -> bytes:
    """Return a YAML text with another value, a missing or repeated line, or other bytes."""
    lines = text.splitlines()
    kind = random.randrange(6)
    place = random.randrange(len(lines))
    if kind == 0:
        return damaged_bytes(random, text.encode())
    if kind == 1:
        del lines[place : place + random.choice((1, 1, 5))]
    elif kind == 2:
        lines.insert(random.randrange(len(lines) + 1), lines[place])
    elif kind == 3:
        lines[place] = ' ' * random.randrange(8) + lines[place].strip()
    else:
        key, colon, _ = lines[place].partition(':')
        value = random.choice(STRANGE_VALUES)
        lines[place] = f'{key}: {value}' if colon else f'{lines[place]} {value}'
    return ('\n'.join(lines) + '\n').encode('utf-8', errors='surrogateescape')


def damage_document(random: Random, original: Path, folder: Path) -> Path:
    """Copy a YAML file and damage the copy."""
    file = folder / original.name
    file.write_bytes(damaged_document(random, original.read_text(encoding='utf-8')))
    return file
