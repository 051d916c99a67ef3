"""The sealed answer of a recording with hidden effects: an encoded file beside the bag.

The encoding only prevents accidental reading.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.files import write_text_atomic
from gyrocal_ros.sim.world import SimSource

HEADER = 'The sealed answer of a simulated bag. Open it with `gyrocal reveal BAG`.'


def sealed_path(bag: Path) -> Path:
    """Return the path of the answer of a bag, given its folder or a file in it."""
    folder = bag.parent if bag.is_file() else bag
    return folder.resolve().parent / f'{folder.resolve().name}.sealed'


def answer_of(source: SimSource) -> dict[str, Any]:
    """Return the hidden facts of a simulated recording: hidden effects, scale factor, bias."""
    bias = source.truth.bias_rad_s[:, 2]
    return {
        'scenario': source.scenario.name,
        'seed': source.seed,
        'duration_s': source.scenario.duration_s,
        SCALE_FACTOR: source.truth.scale_factor,
        'bias': {'start': float(bias[0]), 'end': float(bias[-1]), 'unit': 'rad/s'},
        'effects': [
            {
                'effect': item.effect.name,
                'coefficients': {
                    coefficient.name: {'value': value, 'unit': coefficient.unit}
                    for coefficient, value in zip(item.effect.coefficients, item.values, strict=True)
                },
            }
            for item in source.hidden
        ],
    }


def seal(bag: Path, answer: dict[str, Any], *, overwrite: bool = False) -> Path:
    """Write the answer beside a complete bag; return the file.

    Raises:
        GyrocalError: the file exists and may not be replaced, or cannot be written.
    """
    content = json.dumps({'bag': _fingerprint(bag), 'answer': answer})
    packed = base64.encodebytes(zlib.compress(content.encode())).decode()
    path = sealed_path(bag)
    write_text_atomic(path, f'{HEADER}\n{packed}', overwrite=overwrite)
    return path


def unseal(bag: Path) -> dict[str, Any]:
    """Read the answer of a bag.

    Raises:
        RecordingError: there is none, it is damaged, or it belongs to another bag.
    """
    path = sealed_path(bag)
    if not bag.exists():
        raise RecordingError('does not exist', where=str(bag), todo='give the folder of a bag')
    if not path.is_file():
        raise RecordingError(
            f'has no sealed answer ({path.name})',
            where=str(bag),
            todo='`gyrocal simulate OUT --hidden` writes bags that have one',
        )
    try:
        _, _, packed = path.read_text(encoding='ascii').partition('\n')
        content = json.loads(zlib.decompress(base64.b64decode(packed)))
        fingerprint, answer = content['bag'], dict(content['answer'])
    except (OSError, ValueError, KeyError, TypeError, zlib.error) as error:
        raise RecordingError(
            'cannot be opened, it is damaged', where=str(path), todo='make the bag again'
        ) from error
    if fingerprint != _fingerprint(bag):
        raise RecordingError(
            'belongs to another bag', where=str(path), todo='the bag was changed or made again since'
        )
    return answer


def _fingerprint(bag: Path) -> str:
    """Return the SHA-256 of the recorded files, without the metadata of the bag."""
    folder = bag.parent if bag.is_file() else bag
    digest = hashlib.sha256()
    for file in sorted(item for item in folder.iterdir() if item.suffix != '.yaml' and item.is_file()):
        with file.open('rb') as stream:
            while part := stream.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()
