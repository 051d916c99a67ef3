"""Damage to the bytes of the files of a bag."""

from __future__ import annotations

import shutil
from pathlib import Path
from random import Random

from gyrocal_ros.bag.rewrite import rewrite_bag

MAX_LENGTH = 4000
"""Longest damaged stretch, in bytes."""


def damaged_bytes(random: Random, content: bytes) -> bytes:
    """Return a content with one to three kinds of damage: flipped, zeroed, removed, added, cut, exchanged."""
    data = bytearray(content)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        start = random.randrange(len(data) + 1)
        length = random.randint(1, random.choice((1, 8, 100, MAX_LENGTH)))
        kind = random.randrange(6)
        if kind == 0 and start < len(data):
            data[start] ^= 1 << random.randrange(8)
        elif kind == 1:
            data[start : start + length] = bytes(len(data[start : start + length]))
        elif kind == 2:
            del data[start : start + length]
        elif kind == 3:
            data[start:start] = random.randbytes(length)
        elif kind == 4:
            del data[start:]
        else:
            data[start : start + length] = random.randbytes(len(data[start : start + length]))
    return bytes(data)


def damage_bag_file(random: Random, base: Path, folder: Path) -> Path:
    """Copy a bag and damage its data file, in either storage format."""
    bag = folder / 'bag'
    rewrite_bag(base, bag, lambda message: [message], 'mcap' if random.random() < 0.5 else 'sqlite3')
    file = next(item for item in bag.iterdir() if item.suffix in ('.mcap', '.db3'))
    file.write_bytes(damaged_bytes(random, file.read_bytes()))
    return bag


def damage_metadata(random: Random, base: Path, folder: Path) -> Path:
    """Copy a bag and damage its metadata: bytes, values of another type, missing lines, deep nesting."""
    bag = folder / 'bag'
    shutil.copytree(base, bag)
    file = bag / 'metadata.yaml'
    lines = file.read_text(encoding='utf-8').splitlines()
    place = random.randrange(len(lines))
    kind = random.randrange(4)
    if kind == 0:
        file.write_bytes(damaged_bytes(random, file.read_bytes()))
        return bag
    if kind == 1:
        del lines[place : place + random.choice((1, 1, 3))]
    elif kind == 2:
        key, _, _ = lines[place].partition(':')
        lines[place] = f'{key}: {random.choice(STRANGE_VALUES)}'
    else:
        lines[place : place + 1] = [lines[place]] * random.choice((2, 3))
    file.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    return bag


STRANGE_VALUES = (
    *('', '~', '[]', '{}', '-1', '0', '1e400', '.nan', '.inf', 'yes', '2001-99-99', '2001-01-01', '"', "''"),
    *('9' * 400, '[' * 20000, '{a: ' * 3000, '&a [*a]', '!!python/object:os.system x', '\t', '../../x', 'ä'),
    *('1e308', '-.inf', '0x1F', '[1, 2', 'null', '- a', '? [b]', '1:2:3', '!!binary a', '|', 'a' * 5000),
)
"""Texts in place of a value in YAML."""
