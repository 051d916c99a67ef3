"""Conversion of image messages; the only module of this room that needs OpenCV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import CameraIntrinsics, Frame
from gyrocal_ros.errors import MessageError, RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.image_size import declared_size
from gyrocal_ros.msgs.to_ros import MessageMaker

_PIXEL_FORMATS: dict[str, tuple[type[np.generic], int]] = {
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
"""NumPy type and number of channels of a pixel, by encoding."""

_TO_GREY = {
    'bgr8': cv2.COLOR_BGR2GRAY,
    '8UC3': cv2.COLOR_BGR2GRAY,
    'rgb8': cv2.COLOR_RGB2GRAY,
    'bgra8': cv2.COLOR_BGRA2GRAY,
    '8UC4': cv2.COLOR_BGRA2GRAY,
    'rgba8': cv2.COLOR_RGBA2GRAY,
    # ROS names a Bayer pattern from the first pixel on, OpenCV from the second row and column on.
    'bayer_rggb8': cv2.COLOR_BayerBG2GRAY,
    'bayer_bggr8': cv2.COLOR_BayerRG2GRAY,
    'bayer_gbrg8': cv2.COLOR_BayerGR2GRAY,
    'bayer_grbg8': cv2.COLOR_BayerGB2GRAY,
    'yuv422': cv2.COLOR_YUV2GRAY_UYVY,
    'uyvy': cv2.COLOR_YUV2GRAY_UYVY,
    'yuv422_yuy2': cv2.COLOR_YUV2GRAY_YUY2,
    'yuyv': cv2.COLOR_YUV2GRAY_YUY2,
}
"""OpenCV conversion to grey, by encoding; the other encodings are grey already."""


MAX_PIXELS = 50_000_000
"""Largest number of pixels of an image."""


def frame(message: Any) -> Frame:
    """Convert an Image or a CompressedImage to a grey image.

    Raises:
        MessageError: the image is too large, the encoding is not supported, or the data are damaged.
    """
    t_ns = topics.stamp_ns(message)
    return Frame(t_ns, _raw_image(message) if hasattr(message, 'encoding') else _compressed_image(message))


def jpeg(message: Any, quality: int = 75) -> bytes:
    """Encode an Image as JPEG for a browser: in colour if it is `bgr8`, otherwise in grey.

    Raises:
        RecordingError: the image cannot be decoded.
    """
    is_colour = message.encoding == 'bgr8'
    pixels = _pixels(message) if is_colour else frame(message).image
    return _encoded(pixels, quality).tobytes()


def require_camera_size(frame: Frame, camera: CameraIntrinsics, where: str) -> None:
    """Raise an error unless an image has the size that the camera was calibrated for.

    Args:
        frame: the image.
        camera: intrinsic calibration of the camera.
        where: recording and topic.

    Raises:
        RecordingError: the image has another size.
    """
    height, width = frame.image.shape
    if (width, height) != (camera.width_px, camera.height_px):
        raise RecordingError(
            f'an image has {width}x{height} pixels, '
            f'its camera_info says {camera.width_px}x{camera.height_px}',
            where=where,
            todo='record the camera_info of this camera at this resolution',
        )


def _raw_image(message: Any) -> NDArray[np.uint8]:
    pixels = _pixels(message)
    if message.encoding not in _TO_GREY:
        return pixels
    try:
        return np.asarray(cv2.cvtColor(pixels, _TO_GREY[message.encoding]), np.uint8)
    except cv2.error as error:  # for example YUV of an odd width
        size = f'{message.width}x{message.height}'
        raise MessageError(f'an image of {size} cannot be {message.encoding}') from error


def _pixels(message: Any) -> NDArray[np.uint8]:
    """Return the pixels (height, width) or (height, width, channels) in the channels of the encoding."""
    encoding, height, width = message.encoding, message.height, message.width
    if encoding not in _PIXEL_FORMATS:
        raise MessageError(
            f'images are encoded as {encoding!r}', todo=f'record them as one of {", ".join(_PIXEL_FORMATS)}'
        )
    _require_size(width, height)
    scalar, channels = _PIXEL_FORMATS[encoding]
    row_bytes = width * channels * np.dtype(scalar).itemsize
    step = message.step or row_bytes
    data = np.frombuffer(message.data, np.uint8)
    if step < row_bytes or len(data) < height * step:
        raise MessageError(f'an image of {width}x{height} holds only {len(data)} bytes')
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row_bytes])
    dtype = np.dtype(scalar).newbyteorder('>' if message.is_bigendian else '<')
    pixels = rows.view(dtype).reshape((height, width, channels) if channels > 1 else (height, width))
    if scalar is np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return pixels


def _compressed_image(message: Any) -> NDArray[np.uint8]:
    data = np.frombuffer(message.data, np.uint8)
    _require_size(*declared_size(data.tobytes()))  # before a few bytes become gigabytes
    return _decoded(data)


def _require_size(width: int, height: int) -> None:
    """Raise an error unless an image has pixels, and not too many."""
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        what = f'an image has {width}x{height} pixels, allowed are 1 to {MAX_PIXELS}'
        raise MessageError(what, todo='check the driver of the camera')


def _decoded(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    try:
        pixels = (
            cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION) if len(data) else None
        )
    except cv2.error:
        pixels = None
    if pixels is None:
        raise MessageError('a compressed image cannot be decoded', todo='record jpeg or png images')
    return np.asarray(pixels, np.uint8)


def read_grey_file(file: Path) -> NDArray[np.uint8]:
    """Read an image file as grey values (height, width).

    Raises:
        RecordingError: the file is not an image.
    """
    return _decoded(np.frombuffer(file.read_bytes(), np.uint8))


def after_jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return a grey image (height, width) as it is after storage as JPEG.

    Args:
        image: the image.
        quality: JPEG quality, 1 to 100.
    """
    return _decoded(_encoded(image, quality))


def _encoded(image: NDArray[np.uint8], quality: int | None) -> NDArray[np.uint8]:
    """Encode an image as JPEG, or, without a quality, as PNG."""
    suffix, settings = ('png', []) if quality is None else ('jpg', [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imencode(f'.{suffix}', image, settings)[1], np.uint8).ravel()


def grey_image(make: MessageMaker, frame: Frame) -> Any:
    """Convert a grey image to an Image (mono8)."""
    return _image(make, frame.t_ns, topics.CAMERA_FRAME, frame.image, 'mono8')


def colour_image(make: MessageMaker, t_ns: int, frame_id: str, pixels: NDArray[np.uint8]) -> Any:
    """Make an Image (bgr8) of pixels (height, width, 3)."""
    return _image(make, t_ns, frame_id, pixels, 'bgr8')


def _image(make: MessageMaker, t_ns: int, frame_id: str, pixels: NDArray[np.uint8], encoding: str) -> Any:
    height, width = pixels.shape[:2]
    return make(
        topics.IMAGE,
        header=make.header(t_ns, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels[0].nbytes,
        data=make.sequence(np.ascontiguousarray(pixels).ravel()),
    )


def compressed_image(make: MessageMaker, frame: Frame, quality: int | None = 90) -> Any:
    """Convert a grey image to a CompressedImage.

    Args:
        make: message maker.
        frame: the image.
        quality: JPEG quality, 1 to 100; None for PNG, which is lossless.
    """
    return make(
        topics.COMPRESSED_IMAGE,
        header=make.header(frame.t_ns, topics.CAMERA_FRAME),
        format='png' if quality is None else 'jpeg',
        data=make.sequence(_encoded(frame.image, quality)),
    )
