"""Rendered ceiling images: geometry, exposure, noise, blur and reproducibility."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY, OPAQUE, Grid, Layer
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.image_sensor import ImageSensor
from gyrocal_ros.sim.render import TEXELS_PER_PIXEL, CeilingRenderer, ceiling_renderer
from gyrocal_ros.sim.texture import ceiling_layers

CAMERA = CameraIntrinsics(320, 240, 140.0, 138.0, 161.3, 118.2, (-0.06, 0.01, 8e-4, -5e-4, 0.0))
PINHOLE = CameraIntrinsics(320, 240, 140.0, 138.0, 161.3, 118.2)
HEIGHT_M = 2.4
TEXEL_M = HEIGHT_M / (TEXELS_PER_PIXEL * 140.0)


def even(camera: CameraIntrinsics) -> ImageSensor:
    """Return a sensor without vignetting."""
    return ImageSensor(camera, ImageConditions(vignetting=0.0))


def even_layer(grey: int) -> Layer:
    """Return a ceiling without any texture."""
    brightness = np.full((64, 64), grey * LEVELS_PER_GREY, dtype=np.uint16)
    return Layer(HEIGHT_M, (0.0, 0.0), TEXEL_M, brightness)


def dotted(
    dots_m: Array, size: int, height_m: float, base: float = 20.0, opacity: np.ndarray | None = None
) -> Layer:
    """Return a layer with Gaussian dots at known positions."""
    texel_m = TEXEL_M * height_m / HEIGHT_M
    origin = -0.5 * (size - 1) * texel_m
    rows, columns = np.mgrid[:size, :size]
    grey = np.full((size, size), base)
    for x, y in dots_m:
        column, row = (x - origin) / texel_m, (y - origin) / texel_m
        grey += 220.0 * np.exp(-0.5 * ((columns - column) ** 2 + (rows - row) ** 2) / 5.0**2)
    brightness = np.rint(grey * LEVELS_PER_GREY).astype(np.uint16)
    return Layer(height_m, (origin, origin), texel_m, brightness, opacity)


def centroid_errors(image: np.ndarray, expected: Array, base: float) -> Array:
    errors = []
    for u, v in expected:
        column, row = round(u), round(v)
        window = np.maximum(image[row - 6 : row + 7, column - 6 : column + 7].astype(float) - base, 0.0)
        window /= window.sum()
        offset = np.arange(-6, 7)
        errors.append([column + (window @ offset).sum() - u, row + (offset @ window).sum() - v])
    return np.array(errors)


def spread_dots(rng: np.random.Generator, extent_m: float) -> Array:
    axis = np.arange(-extent_m, extent_m, 0.45)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + rng.uniform(
        -0.03, 0.03, (axis.size**2, 2)
    )


@pytest.mark.slow
@pytest.mark.parametrize(('camera', 'max_px'), [(PINHOLE, 0.012), (CAMERA, 0.02)])
def test_a_point_of_the_ceiling_is_imaged_where_geometry_projects_it(
    camera: CameraIntrinsics, max_px: float
) -> None:
    """Compare centroids; a distorted dot of finite size has its centroid slightly further inside."""
    rng = np.random.default_rng(0)
    dots_m = spread_dots(rng, 2.2)
    renderer = CeilingRenderer(camera, [dotted(dots_m, 900, HEIGHT_M)], even(camera))
    errors = np.zeros((0, 2))
    for _ in range(5):
        R_wc = rotation_from_euler(np.array([*rng.uniform(-0.02, 0.02, 2), rng.uniform(-3.0, 3.0)]))
        p_wc = np.array([*rng.uniform(-0.2, 0.2, 2), 0.1])
        pixels = project(camera, (np.column_stack([dots_m, np.full(len(dots_m), HEIGHT_M)]) - p_wc) @ R_wc)
        inside = (pixels > 12).all(axis=1) & (pixels < [307, 227]).all(axis=1)
        errors = np.concatenate([errors, centroid_errors(renderer.render(R_wc, p_wc), pixels[inside], 20.0)])
    assert len(errors) > 200
    assert np.abs(errors).max() < max_px  # rounding to whole grey levels contributes 0.01
    assert np.sqrt((errors**2).mean()) < 0.4 * max_px
    assert np.abs(errors.mean(axis=0)).max() < 0.001


def test_a_lower_layer_has_parallax_and_occludes_the_ceiling() -> None:
    low_m = 1.8
    dot = np.array([[0.1, -0.05]])
    piece = dotted(dot, 150, low_m, 20.0, np.full((150, 150), OPAQUE, dtype=np.uint16))
    ceiling = even_layer(200)
    renderer = CeilingRenderer(PINHOLE, [ceiling, piece], even(PINHOLE))
    for x in (-0.3, 0.0, 0.4):
        p_wc = np.array([x, 0.1, 0.1])
        image = renderer.render(np.eye(3), p_wc)
        expected = project(PINHOLE, np.array([[0.1, -0.05, low_m]]) - p_wc)
        assert np.abs(centroid_errors(image, expected, 20.0)).max() < 0.012
        assert image[5, 5] == 200
    assert (renderer.render(np.eye(3), np.array([9.0, 9.0, 0.1])) == 200).all()


@pytest.mark.slow
def test_the_same_seed_yields_the_same_bytes() -> None:
    R_wc, p_wc = np.eye(3), np.array([0.3, 0.2, 0.1])
    one, again, other = (
        ceiling_renderer(CAMERA, seed).render(R_wc, p_wc, rng=np.random.default_rng(1)) for seed in (5, 5, 6)
    )
    assert one.tobytes() == again.tobytes()
    assert one.tobytes() != other.tobytes()
    assert one.dtype == np.uint8
    assert one.shape == (240, 320)


@pytest.fixture(scope='module')
def plain() -> CeilingRenderer:
    return CeilingRenderer(
        CAMERA, [even_layer(100)], ImageSensor(CAMERA, ImageConditions(read_noise_grey=2.0))
    )


def test_exposure_scales_and_clips(plain: CeilingRenderer) -> None:
    pose = np.eye(3), np.zeros(3)
    middle = [plain.render(*pose, exposure=exposure)[120, 160] for exposure in (0.5, 1.0, 2.0, 4.0)]
    assert middle == [50, 100, 200, 255]


def test_vignetting_darkens_the_corners(plain: CeilingRenderer) -> None:
    image = plain.render(np.eye(3), np.zeros(3))
    assert image[0, 0] == 75
    assert image[120, 160] == 100


def test_read_noise_has_the_requested_size(plain: CeilingRenderer) -> None:
    clean = plain.render(np.eye(3), np.zeros(3))
    noisy = plain.render(np.eye(3), np.zeros(3), rng=np.random.default_rng(3))
    difference = noisy.astype(float) - clean
    assert difference.std() == pytest.approx(np.sqrt(2.0**2 + 1 / 6), rel=0.02)
    assert abs(difference.mean()) < 0.03


def test_motion_blur_is_the_mean_of_the_exposure() -> None:
    renderer = CeilingRenderer(CAMERA, [dotted(spread_dots(np.random.default_rng(1), 1.0), 500, HEIGHT_M)])
    poses = [
        (rotation_from_euler(np.array([0.0, 0.0, yaw])), np.array([0.0, 0.0, 0.1]))
        for yaw in (0.0, 0.01, 0.02)
    ]
    blurred = renderer.render(*poses[1], blur=poses).astype(float)
    mean = np.mean([renderer.render(*pose) for pose in poses], axis=0)
    assert np.abs(blurred - mean).max() <= 1.0
    assert np.abs(blurred - renderer.render(*poses[1])).max() > 3.0


def test_layers_are_sorted_from_high_to_low_and_are_smooth() -> None:
    layers = ceiling_layers(np.random.default_rng(2), HEIGHT_M, Grid(TEXEL_M), size_m=5.0, objects=4)
    heights = [layer.height_m for layer in layers]
    assert heights == sorted(heights, reverse=True)
    spectrum = np.abs(np.fft.rfft2(layers[0].brightness.astype(float)))
    beyond_a_pixel = np.fft.rfftfreq(layers[0].brightness.shape[1]) > 1.0 / TEXELS_PER_PIXEL
    assert spectrum[:, beyond_a_pixel].max() < 1e-3 * spectrum[:, 1:][:, :50].max()
