"""Image messages: the one place of this room that needs OpenCV."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import CameraIntrinsics, Frame
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.to_ros import MessageMaker

_SHAPES: dict[str, tuple[type[np.generic], int]] = {
    'mono8': (np.uint8, 1),
    '8UC1': (np.uint8, 1),
    'mono16': (np.uint16, 1),
    '16UC1': (np.uint16, 1),
    'bgr8': (np.uint8, 3),
    '8UC3': (np.uint8, 3),
    'rgb8': (np.uint8, 3),
    'bgra8': (np.uint8, 4),
    '8UC4': (np.uint8, 4),
    'rgba8': (np.uint8, 4),
    'bayer_rggb8': (np.uint8, 1),
    'bayer_bggr8': (np.uint8, 1),
    'bayer_gbrg8': (np.uint8, 1),
    'bayer_grbg8': (np.uint8, 1),
    'yuv422': (np.uint8, 2),
    'uyvy': (np.uint8, 2),
    'yuv422_yuy2': (np.uint8, 2),
    'yuyv': (np.uint8, 2),
}
"""Type of the numbers and how many to a pixel, by encoding."""

_TO_GREY = {
    'bgr8': cv2.COLOR_BGR2GRAY,
    '8UC3': cv2.COLOR_BGR2GRAY,
    'rgb8': cv2.COLOR_RGB2GRAY,
    'bgra8': cv2.COLOR_BGRA2GRAY,
    '8UC4': cv2.COLOR_BGRA2GRAY,
    'rgba8': cv2.COLOR_RGBA2GRAY,
    # ROS names the first two pixels of the first row, OpenCV those from the second row and column on.
    'bayer_rggb8': cv2.COLOR_BayerBG2GRAY,
    'bayer_bggr8': cv2.COLOR_BayerRG2GRAY,
    'bayer_gbrg8': cv2.COLOR_BayerGR2GRAY,
    'bayer_grbg8': cv2.COLOR_BayerGB2GRAY,
    'yuv422': cv2.COLOR_YUV2GRAY_UYVY,
    'uyvy': cv2.COLOR_YUV2GRAY_UYVY,
    'yuv422_yuy2': cv2.COLOR_YUV2GRAY_YUY2,
    'yuyv': cv2.COLOR_YUV2GRAY_YUY2,
}


def frame(message: Any) -> Frame:
    """Convert an Image or a CompressedImage to grey.

    Raises:
        RecordingError: the encoding is not known, or the data are damaged.
    """
    t_ns = topics.stamp_ns(message)
    return Frame(t_ns, _raw_image(message) if hasattr(message, 'encoding') else _compressed_image(message))


def jpeg(message: Any, quality: int = 75) -> bytes:
    """An Image as JPEG, in colour where it is `bgr8`, for a browser.

    Raises:
        RecordingError: it cannot be decoded.
    """
    colours = message.encoding == 'bgr8'
    pixels = _pixels(message) if colours else frame(message).image
    return bytes(cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def refuse_other_size(seen: Frame, camera: CameraIntrinsics, where: str) -> None:
    """Refuse an image that the calibration is not made for.

    Args:
        seen: the image.
        camera: the calibration.
        where: recording and topic.

    Raises:
        RecordingError: its size is not that of the camera.
    """
    height, width = seen.image.shape
    if (width, height) != (camera.width_px, camera.height_px):
        raise RecordingError(
            f'an image has {width}x{height} pixels, '
            f'its camera_info says {camera.width_px}x{camera.height_px}',
            where=where,
            todo='record the camera_info of this camera at this resolution',
        )


def _raw_image(message: Any) -> NDArray[np.uint8]:
    pixels = _pixels(message)
    if message.encoding in _TO_GREY:
        return np.asarray(cv2.cvtColor(pixels, _TO_GREY[message.encoding]), np.uint8)
    return pixels


def _pixels(message: Any) -> NDArray[np.uint8]:
    """(height, width) or (height, width, channels), in the colours of the encoding."""
    encoding, height, width = message.encoding, message.height, message.width
    if encoding not in _SHAPES:
        raise RecordingError(
            f'images are encoded as {encoding!r}', todo=f'record them as one of {", ".join(_SHAPES)}'
        )
    number, channels = _SHAPES[encoding]
    row = width * channels * np.dtype(number).itemsize
    step = message.step or row
    data = np.frombuffer(message.data, np.uint8)
    if step < row or len(data) < height * step:
        raise RecordingError(f'an image of {width}x{height} holds only {len(data)} bytes')
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    kind = np.dtype(number).newbyteorder('>' if message.is_bigendian else '<')
    pixels = rows.view(kind).reshape((height, width, channels) if channels > 1 else (height, width))
    if number is np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return pixels


def _compressed_image(message: Any) -> NDArray[np.uint8]:
    data = np.frombuffer(message.data, np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION) if len(data) else None
    if pixels is None:
        raise RecordingError('a compressed image cannot be decoded', todo='record jpeg or png images')
    return np.asarray(pixels, np.uint8)


def image(make: MessageMaker, seen: Frame) -> Any:
    """Convert to an Image (mono8)."""
    return _image(make, seen.t_ns, topics.CAMERA_FRAME, seen.image, 'mono8')


def picture(make: MessageMaker, t_ns: int, frame: str, pixels: NDArray[np.uint8]) -> Any:
    """Make an Image (bgr8) of a picture (height, width, 3)."""
    return _image(make, t_ns, frame, pixels, 'bgr8')


def _image(make: MessageMaker, t_ns: int, frame: str, pixels: NDArray[np.uint8], encoding: str) -> Any:
    height, width = pixels.shape[:2]
    return make(
        topics.IMAGE,
        header=make.header(t_ns, frame),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels[0].nbytes,
        data=make.sequence(np.ascontiguousarray(pixels).ravel()),
    )


def compressed_image(make: MessageMaker, seen: Frame, quality: int | None = 90) -> Any:
    """Convert to a CompressedImage.

    Args:
        make: the maker.
        seen: the image.
        quality: of the jpeg, 1 to 100; None for png, which loses nothing.
    """
    suffix, settings = ('png', []) if quality is None else ('jpg', [cv2.IMWRITE_JPEG_QUALITY, quality])
    _, encoded = cv2.imencode(f'.{suffix}', seen.image, settings)
    return make(
        topics.COMPRESSED_IMAGE,
        header=make.header(seen.t_ns, topics.CAMERA_FRAME),
        format='png' if quality is None else 'jpeg',
        data=make.sequence(np.asarray(encoded, np.uint8).ravel()),
    )
