"""Damaged point clouds are refused with a clear message; implausible points are left out."""

from __future__ import annotations

from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from gyrocal_ros.errors import MessageError
from gyrocal_ros.msgs import clouds

LAYOUT = (('u', 0, 7), ('v', 4, 7), ('id', 8, 6))


def cloud(count: int = 3, **changes: Any) -> Message:
    points = np.zeros(count, np.dtype([('u', '<f4'), ('v', '<f4'), ('id', '<u4')]))
    points['u'], points['v'], points['id'] = 1.0, 2.0, np.arange(count)
    fields = [Message(name=name, offset=at, datatype=kind, count=1) for name, at, kind in LAYOUT]
    values = {
        'header': Message(stamp=Message(sec=1, nanosec=2), frame_id='camera'),
        'height': 1,
        'width': count,
        'fields': fields,
        'is_bigendian': False,
        'point_step': 12,
        'data': points.tobytes(),
    }
    return Message(**{**values, **changes})


def with_field(number: int, **changes: Any) -> list[Message]:
    fields = cloud().fields
    fields[number] = Message(**{**vars(fields[number]), **changes})
    return fields


def test_a_sound_cloud_is_read() -> None:
    seen = clouds.features(cloud())
    assert (seen.t_ns, seen.ids.tolist(), seen.pixels.tolist()) == (10**9 + 2, [0, 1, 2], [[1.0, 2.0]] * 3)


DAMAGED: dict[str, dict[str, Any]] = {
    'short data': {'data': b'\0' * 35},
    'no data': {'data': b''},
    'more points than data': {'width': 4},
    'far too many points': {'width': 2**32 - 1, 'height': 2**32 - 1},
    'unknown datatype': {'fields': with_field(0, datatype=99)},
    'datatype 0': {'fields': with_field(2, datatype=0)},
    'several numbers in a field': {'fields': with_field(1, count=1000)},
    'duplicate field': {'fields': with_field(1, name='u')},
    'overlapping fields': {'fields': with_field(1, offset=2)},
    'one id twice': {'data': cloud(1).data * 3},
    'no fields': {'fields': []},
    'point_step 0': {'point_step': 0},
    'point_step huge': {'point_step': 2**32 - 1},
    'point_step too small': {'point_step': 11},
    'offset out of range': {'fields': with_field(2, offset=2**32 - 1)},
    'id not a number': {
        'fields': with_field(2, datatype=7),
        'data': np.tile(np.array([1.0, 2.0, np.nan], '<f4'), 3).tobytes(),
    },
}


@pytest.mark.parametrize('fault', DAMAGED)
def test_a_damaged_cloud_is_refused(fault: str) -> None:
    with pytest.raises(MessageError):
        clouds.features(cloud(**DAMAGED[fault]))


@pytest.mark.parametrize('value', [np.nan, np.inf, -1e30, 1e38])
def test_implausible_points_are_left_out(value: float) -> None:
    data = bytearray(cloud().data)
    data[12:16] = np.float32(value).tobytes()
    assert clouds.features(cloud(data=bytes(data))).ids.tolist() == [0, 2]
