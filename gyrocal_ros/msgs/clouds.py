"""Point clouds of features and of search regions; the layout is checked before it is used."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, FeatureObservations, SearchRegions
from gyrocal_ros.errors import MessageError
from gyrocal_ros.msgs.topics import stamp_ns

COVARIANCES = ('cov_uu', 'cov_uv', 'cov_vv')
"""Fields with the covariance of each pixel."""
SCALARS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy type of each `datatype` of a PointField."""
MAX_POINTS = 10_000
"""Largest number of points of a cloud; a tracker follows tens of features."""
MAX_PIXEL = 1e5
"""Largest plausible size of a pixel coordinate; larger ones are left out, as those that are not finite."""
MAX_POINT_BYTES = 4096
"""Largest size of one point."""
REMEDY = 'check the tracker that publishes this topic'


def features(message: Any) -> FeatureObservations:
    """Convert a PointCloud2 of tracked features; points without a plausible pixel are left out.

    Raises:
        MessageError: the layout of the cloud is invalid, or it lacks one of the fields u, v, id.
    """
    points = _points(message, ('u', 'v', 'id'))
    with np.errstate(invalid='ignore'):
        plausible = (np.abs(_pairs(points, 'u', 'v')) < MAX_PIXEL).all(axis=1)
    if not plausible.all():
        points = points[plausible]
    pixels, covariances = _pairs(points, 'u', 'v'), _valid_covariances(points)
    return FeatureObservations(stamp_ns(message), _ids(points), pixels, covariances)


def search_regions(message: Any) -> SearchRegions:
    """Convert a PointCloud2 of search regions.

    Raises:
        MessageError: the layout of the cloud is invalid, or it lacks one of the fields u, v, id, cov_uu,
            cov_uv, cov_vv, or a number is not finite.
    """
    points = _points(message, ('u', 'v', 'id', *COVARIANCES))
    pixels, covariances = _pairs(points, 'u', 'v'), _covariances(points)
    if not (np.isfinite(pixels).all() and np.isfinite(covariances).all()):
        raise MessageError('a search region is not finite', todo='check the calibrator')
    return SearchRegions(stamp_ns(message), _ids(points), pixels, covariances)


def _ids(points: NDArray[Any]) -> NDArray[np.int64]:
    ids = points['id']
    if len(set(ids.tolist())) < len(ids):
        raise MessageError('a point cloud has two points with one id', todo=REMEDY)
    if ids.dtype.kind == 'f' and not (np.abs(ids) < 2.0**53).all():
        raise MessageError('an id of a point cloud is not a whole number', todo=REMEDY)
    return ids.astype(np.int64)


def _covariances(points: NDArray[Any]) -> Array:
    rows = _pairs(points, 'cov_uu', 'cov_uv'), _pairs(points, 'cov_uv', 'cov_vv')
    return np.stack(rows, axis=1)


def _valid_covariances(points: NDArray[Any]) -> Array | None:
    """Return the covariances of a cloud; None if it has none, or one that is not positive definite."""
    if not set(COVARIANCES) <= set(points.dtype.names or ()):
        return None
    covariances = _covariances(points)
    if not (np.abs(covariances) < MAX_PIXEL**2).all():
        return None
    is_valid = (covariances[:, 0, 0] > 0.0) & (np.linalg.det(covariances) > 0.0)
    return covariances if is_valid.all() else None


def _pairs(points: NDArray[Any], first: str, second: str) -> Array:
    pairs = np.empty((len(points), 2))
    pairs[:, 0], pairs[:, 1] = points[first], points[second]
    return pairs


def _points(message: Any, names: tuple[str, ...]) -> NDArray[Any]:
    """Return the points as a structured array (n,); only fields in `names` and covariances are in it."""
    wanted = {*names, *COVARIANCES}
    layout = tuple(
        (str(item.name), int(item.offset), int(item.datatype), int(item.count))
        for item in message.fields
        if item.name in wanted
    )
    dtype = _point_type(layout, int(message.point_step), bool(message.is_bigendian))
    missing = [name for name in names if name not in (dtype.names or ())]
    if missing:
        raise MessageError(
            f'a point cloud lacks the field {missing[0]}', todo=f'its points need {", ".join(names)}'
        )
    count = int(message.width) * int(message.height)
    if count > MAX_POINTS:
        raise MessageError(f'a point cloud has {count} points, more than {MAX_POINTS}', todo=REMEDY)
    if count * dtype.itemsize > len(message.data):
        what = f'a point cloud of {count} points of {dtype.itemsize} bytes holds {len(message.data)} bytes'
        raise MessageError(what, todo=REMEDY)
    return np.frombuffer(message.data, dtype, count=count)


@lru_cache
def _point_type(layout: tuple[tuple[str, int, int, int], ...], size: int, big_endian: bool) -> np.dtype[Any]:
    """Return the type of one point.

    Raises:
        MessageError: a field appears twice, overlaps another one, is not one number of a known type, or
            exceeds the point.
    """
    order = '>' if big_endian else '<'
    names = [name for name, _, _, _ in layout]
    if size > MAX_POINT_BYTES:
        raise MessageError(f'a point of a cloud has {size} bytes, more than {MAX_POINT_BYTES}', todo=REMEDY)
    for name, offset, datatype, count in layout:
        if names.count(name) > 1:
            raise MessageError(f'a point cloud has the field {name} twice', todo=REMEDY)
        if datatype not in SCALARS or count not in (0, 1):  # some publishers leave the count 0
            what = f'the field {name} of a point cloud has datatype {datatype} and count {count}'
            raise MessageError(what, todo=REMEDY)
        if offset + np.dtype(SCALARS[datatype]).itemsize > size:
            what = f'the field {name} of a point cloud lies beyond its points of {size} bytes'
            raise MessageError(what, todo=REMEDY)
    ends = sorted(
        (offset, offset + np.dtype(SCALARS[datatype]).itemsize) for _, offset, datatype, _ in layout
    )
    if any(end > offset for (_, end), (offset, _) in pairwise(ends)):
        raise MessageError('fields of a point cloud overlap', todo=REMEDY)
    formats = [order + SCALARS[datatype] for _, _, datatype, _ in layout]
    offsets = [offset for _, offset, _, _ in layout]
    return np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': size})
