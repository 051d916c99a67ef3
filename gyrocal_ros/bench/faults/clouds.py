"""Damage to point clouds, camera_info, static transforms and images."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from gyrocal_ros.bench.faults.bag_bytes import damaged_bytes
from gyrocal_ros.bench.faults.contents import STRANGE_NUMBERS, changed_message, damaged_copy
from gyrocal_ros.msgs import topics

HUGE = 2**32 - 1


def damage_clouds(random: Random, base: Path, folder: Path) -> Path:
    """Damage the layout and the data of feature lists."""
    kind = random.randrange(12)
    return damaged_copy(
        random, base, folder, (topics.POINT_CLOUD,), changed_message(lambda r, m: _cloud(r, m, kind))
    )


def _cloud(random: Random, cloud: Any, kind: int) -> None:
    field = random.choice(cloud.fields)
    if kind == 0:
        cloud.data = cloud.data[: random.randrange(len(cloud.data) + 1)]
    elif kind == 1:
        field.datatype = random.choice((0, 1, 2, 5, 8, 9, 255))
    elif kind == 2:
        field.name = random.choice(('u', 'v', 'id', '', 'x', 'ü' * 100))
    elif kind == 3:
        cloud.point_step = random.choice((0, 1, 11, 13, 4096, HUGE))
    elif kind == 4:
        field.offset = random.choice((1, 9, 4000, HUGE, HUGE - 3))
    elif kind == 5:
        field.count = random.choice((0, 2, 10**6, HUGE))
    elif kind == 6:
        cloud.width, cloud.height = random.choice(((HUGE, HUGE), (0, 0), (HUGE, 1), (1, 100), (3, 7)))
    elif kind == 7:
        cloud.is_bigendian = not cloud.is_bigendian
    elif kind == 8:
        cloud.fields = random.sample(cloud.fields, random.randrange(len(cloud.fields)))
    elif kind == 9:
        cloud.fields = [*cloud.fields, field]
    elif kind == 10:
        cloud.data = np.frombuffer(damaged_bytes(random, cloud.data.tobytes()), np.uint8)
    elif len(cloud.data) >= 4:
        data = bytearray(cloud.data.tobytes())
        with np.errstate(over='ignore'):
            value = np.float32(random.choice(STRANGE_NUMBERS)).tobytes()
        place = random.randrange(len(data) // 4) * 4
        data[place : place + 4] = value
        cloud.data = np.frombuffer(bytes(data), np.uint8)


def damage_camera_info(random: Random, base: Path, folder: Path) -> Path:
    """Damage the intrinsic calibration: numbers, sizes, lens model, number of coefficients."""

    def change(random: Random, info: Any) -> None:
        kind = random.randrange(5)
        if kind == 0:
            info.k = info.k.copy()  # the decoded one cannot be written
            info.k[random.randrange(9)] = random.choice(STRANGE_NUMBERS)
        elif kind == 1:
            info.d = np.array([random.choice(STRANGE_NUMBERS) for _ in range(random.randrange(15))])
        elif kind == 2:
            info.distortion_model = random.choice(('', 'fisheye', 'equidistant', 'rational_polynomial', 'ä'))
        elif kind == 3:
            info.width, info.height = random.choice(((0, 0), (HUGE, HUGE), (1, 1), (info.height, info.width)))
        else:
            info.k = np.full(9, random.choice(STRANGE_NUMBERS))

    return damaged_copy(random, base, folder, (topics.CAMERA_INFO,), changed_message(change))


def damage_transforms(random: Random, base: Path, folder: Path) -> Path:
    """Damage the static transforms: numbers, zero quaternions, frames, loops, none at all."""

    def change(random: Random, message: Any) -> None:
        kind = random.randrange(5)
        item = random.choice(message.transforms)
        if kind == 0:
            setattr(item.transform.rotation, random.choice('xyzw'), random.choice(STRANGE_NUMBERS))
        elif kind == 1:
            setattr(item.transform.translation, random.choice('xyz'), random.choice(STRANGE_NUMBERS))
        elif kind == 2:
            rotation = item.transform.rotation
            rotation.x = rotation.y = rotation.z = rotation.w = 0.0
        elif kind == 3:
            item.child_frame_id, item.header.frame_id = item.header.frame_id, item.child_frame_id
        else:
            message.transforms = [] if random.random() < 0.5 else [*message.transforms, *message.transforms]

    return damaged_copy(random, base, folder, (topics.TRANSFORMS,), changed_message(change))


def damage_images(random: Random, base: Path, folder: Path) -> Path:
    """Damage compressed images: bytes, other contents, and headers that declare huge sizes."""
    kind = random.randrange(4)

    def change(random: Random, message: Any) -> None:
        data = message.data.tobytes()
        if kind == 0:
            data = damaged_bytes(random, data)
        elif kind == 1:
            data = random.choice(
                (b'', b'\xff\xd8', b'BM' + bytes(100), b'\x89PNG\r\n\x1a\n' + bytes(40), b'GIF89a')
            )
        elif kind == 2 and (place := data.find(b'\xff\xc0')) >= 0:
            size = struct.pack('>HH', *random.choice(((30000, 30000), (65535, 65535), (0, 0), (1, 1))))
            data = data[: place + 5] + size + data[place + 9 :]
        else:
            message.format = random.choice(('', 'png', 'x' * 1000))
            data = data[: math.ceil(len(data) * random.random())]
        message.data = np.frombuffer(data, np.uint8)

    return damaged_copy(random, base, folder, (topics.COMPRESSED_IMAGE,), changed_message(change))
