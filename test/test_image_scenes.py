"""Difficult scenes: ceilings, lenses, image conditions, moving things, and their options."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.camera import in_image, project
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.msgs.images import after_jpeg
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY, OPAQUE, Grid, Layer
from gyrocal_ros.sim.ceilings import CEILINGS, PHOTOGRAPH_M, find_ceiling
from gyrocal_ros.sim.image_conditions import (
    MAX_GAIN,
    TARGET_GREY,
    ExposureControl,
    ImageConditions,
    flicker,
    room_light,
    with_conditions,
)
from gyrocal_ros.sim.image_scenes import FISHEYE, RATIONAL, SCENES, find_scene
from gyrocal_ros.sim.image_sensor import ImageSensor
from gyrocal_ros.sim.image_sequence import ImageSequence, drawn
from gyrocal_ros.sim.moving import MOVING, moving_layers
from gyrocal_ros.sim.render import CameraPose, CeilingRenderer, block_edges
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import SimSource

HEIGHT_M = 2.5
COARSE = Grid(0.02)
SMALL = CameraIntrinsics(160, 120, 60.0, 60.0, 79.5, 59.5)
NOISELESS = ImageConditions(read_noise_grey=0.0, vignetting=0.0)


def dots(places_m: Array, texel_m: float, height_m: float = HEIGHT_M) -> Layer:
    """Return a dark ceiling of 12 m with bright dots of one standard deviation of 4 texels."""
    count = round(12.0 / texel_m)
    axis = texel_m * np.arange(count) - 6.0
    grey = np.full((count, count), 20.0)
    for x, y in places_m:
        near_x, near_y = np.abs(axis - x) < 30 * texel_m, np.abs(axis - y) < 30 * texel_m
        blob = np.exp(-0.5 * ((axis[near_y, None] - y) ** 2 + (axis[near_x] - x) ** 2) / (4 * texel_m) ** 2)
        grey[np.ix_(near_y, near_x)] += 200.0 * blob
    return Layer(height_m, (-6.0, -6.0), texel_m, np.rint(grey * LEVELS_PER_GREY).astype(np.uint16))


def centroid(image: np.ndarray, around: Array, radius: int = 9) -> Array:
    column, row = np.round(around).astype(int)
    part = image[row - radius : row + radius + 1, column - radius : column + radius + 1] - 20.0
    part = np.where(part > 10.0, part, 0.0)
    offset = np.arange(-radius, radius + 1)
    return np.array([column + (part @ offset).sum() / part.sum(), row + (offset @ part).sum() / part.sum()])


class TestCeilings:
    @pytest.mark.parametrize('name', [name for name in CEILINGS if name != 'default'])
    def test_is_the_same_for_a_seed_and_sorted_from_high_to_low(self, name: str) -> None:
        first, again, other = (
            find_ceiling(name).draw(np.random.default_rng(seed), HEIGHT_M, COARSE) for seed in (1, 1, 2)
        )
        assert all(np.array_equal(a.brightness, b.brightness) for a, b in zip(first, again, strict=True))
        assert not np.array_equal(first[0].brightness, other[0].brightness)
        heights = [layer.height_m for layer in first]
        assert heights == sorted(heights, reverse=True) and heights[0] == HEIGHT_M
        assert first[0].opacity is None and all(layer.opacity is not None for layer in first[1:])

    def test_differ_in_what_makes_them_difficult(self) -> None:
        grid = Grid(0.0067)
        ceilings = {
            name: find_ceiling(name).draw(np.random.default_rng(0), HEIGHT_M, grid)
            for name in ('tiles', 'plaster', 'lamps', 'beams', 'pipes')
        }
        grey = {name: layers[0].brightness / LEVELS_PER_GREY for name, layers in ceilings.items()}
        local = {name: np.abs(np.diff(values)).mean() for name, values in grey.items()}
        assert local['plaster'] < 0.5 * local['tiles']
        assert (grey['lamps'] > 255.0).mean() > 0.03
        tile = round(0.6 / grid.texel_m)
        one, other = (grey['tiles'][at : at + tile, at : at + tile] for at in (0, 5 * tile))
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.9
        assert len({layer.height_m for layer in ceilings['beams']}) == 3
        assert len({layer.height_m for layer in ceilings['pipes']}) == 4

    def test_a_photograph_is_a_ceiling_without_seams(self, tmp_path: Path) -> None:
        ramp = np.tile(np.linspace(0, 250, 100).astype(np.uint8), (50, 1))
        cv2.imwrite(str(tmp_path / 'ceiling.png'), ramp)
        ceiling = find_ceiling(str(tmp_path / 'ceiling.png'))
        (layer,) = ceiling.draw(np.random.default_rng(0), HEIGHT_M, COARSE)
        assert layer.texel_m == PHOTOGRAPH_M / 100
        grey = layer.brightness / LEVELS_PER_GREY
        np.testing.assert_array_equal(grey[:50, :100], ramp)
        assert np.abs(np.diff(grey, axis=1)).max() < 4.0 and grey[0, 0] == grey[0, -1]
        (reduced,) = ceiling.draw(np.random.default_rng(0), HEIGHT_M, Grid(0.2))
        assert reduced.texel_m == 4 * layer.texel_m
        np.testing.assert_allclose(
            reduced.brightness[0, :25] / LEVELS_PER_GREY, ramp[0].reshape(25, 4).mean(axis=1), atol=0.5
        )

    def test_one_after_the_other_is_drawn_once_and_a_photograph_is_read_again(self, tmp_path: Path) -> None:
        tiles = drawn(find_ceiling('tiles'), 1, COARSE)
        assert drawn(find_ceiling('tiles'), 1, COARSE) is tiles
        assert drawn(find_ceiling('tiles'), 2, COARSE) is not tiles
        file = tmp_path / 'ceiling.png'
        for grey in (50, 90):
            cv2.imwrite(str(file), np.full((50, 100), grey, np.uint8))
            (photograph,) = drawn(find_ceiling(str(file)), 1, COARSE)
            assert (photograph.brightness == grey * LEVELS_PER_GREY).all()

    def test_unknown_names_and_files_that_are_no_images_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match='tyles'):
            find_ceiling('tyles').draw(np.random.default_rng(0), HEIGHT_M, COARSE)
        (tmp_path / 'text.jpg').write_text('no image')
        with pytest.raises(ConfigError, match='not an image'):
            find_ceiling(str(tmp_path / 'text.jpg')).draw(np.random.default_rng(0), HEIGHT_M, COARSE)


@pytest.mark.slow
@pytest.mark.parametrize('camera', [FISHEYE, RATIONAL], ids=['fisheye', 'rational'])
def test_a_wide_lens_images_points_where_geometry_projects_them(camera: CameraIntrinsics) -> None:
    """The centroid of a dot is shifted outwards in proportion to its size, so the dots are small."""
    places_m = np.array([[0.0, 0.0], [0.8, -0.5], [-1.3, 0.9], [2.6, 0.3], [-2.2, -1.8]])
    renderer = CeilingRenderer(camera, [dots(places_m, 0.0034)], ImageSensor(camera, NOISELESS))
    R_wc, p_wc = rotation_from_euler(np.array([0.01, -0.02, 0.7])), np.array([0.1, -0.1, 0.1])
    image = renderer.render(R_wc, p_wc).astype(float)
    expected = project(camera, (np.column_stack([places_m, np.full(5, HEIGHT_M)]) - p_wc) @ R_wc)
    assert in_image(camera, expected, 12.0).all()
    errors = [centroid(image, place) - place for place in expected]
    assert np.abs(errors).max() < 0.08


def test_the_border_of_a_fisheye_image_is_not_aliased() -> None:
    """A fine checkerboard has the mean of its fields wherever a pixel sees many of them."""
    fields = np.indices((1000, 1000)).sum(axis=0) % 2 * 200 * LEVELS_PER_GREY
    layer = Layer(HEIGHT_M, (-5.0, -5.0), 0.01, fields.astype(np.uint16))
    small = replace(FISHEYE, width_px=160, height_px=120, fx_px=71.0, fy_px=71.0, cx_px=79.5, cy_px=59.5)
    image = CeilingRenderer(small, [layer], ImageSensor(small, NOISELESS)).render(np.eye(3), np.zeros(3))
    assert image[40:80, :12].std() < 6.0
    assert abs(image[40:80, :12].mean() - 100.0) < 3.0


class TestRollingShutter:
    def test_rows_are_exposed_one_after_the_other(self) -> None:
        places_m = np.array([[0.0, -1.6], [0.5, 0.0], [-0.4, 1.6]])
        renderer = CeilingRenderer(SMALL, [dots(places_m, 0.014)], ImageSensor(SMALL, NOISELESS))
        rate_rad_s, readout_s = 2.0, 0.03
        edges = block_edges(SMALL.height_px) / SMALL.height_px - 0.5

        def pose(time_s: float) -> CameraPose:
            return CameraPose(rotation_from_euler(np.array([0.0, 0.0, rate_rad_s * time_s])), np.zeros(3))

        image = renderer.expose([[pose(readout_s * edge) for edge in edges]], 1.0).astype(float)
        world = np.column_stack([places_m, np.full(3, HEIGHT_M)])
        moved = []
        for point in world:
            time_s = 0.0
            for _ in range(10):  # the row of a point decides on its time
                seen = project(SMALL, point[None] @ pose(time_s).R_wc)[0]
                time_s = readout_s * ((seen[1] + 0.5) / SMALL.height_px - 0.5)
            moved.append(np.linalg.norm(seen - project(SMALL, point[None])[0]))
            assert np.abs(centroid(image, seen, 6) - seen).max() < 0.06
        assert max(moved) > 0.7


class TestConditions:
    def test_values_are_given_by_name(self) -> None:
        conditions = with_conditions(
            ImageConditions(), ['readout_s=0.02', 'fan=true', 'dust=3'], '--condition'
        )
        assert conditions == ImageConditions(readout_s=0.02, fan=True, dust=3)
        for wrong in ('readout=1', 'dust=0.5', 'fan=3', 'exposure_s=9', 'jpeg_quality=0', 'light'):
            with pytest.raises(ConfigError):
                with_conditions(ImageConditions(), [wrong], '--condition')

    def test_flicker_is_the_mean_over_the_exposure(self) -> None:
        conditions = ImageConditions(flicker=0.4, flicker_hz=100.0)
        times = np.array([0.0, 0.0031, 0.007])
        fine = times[:, None] + 0.004 * (np.arange(1000) + 0.5) / 1000 - 0.002
        expected = (1.0 + 0.4 * np.cos(2.0 * math.pi * 100.0 * fine)).mean(axis=1)
        np.testing.assert_allclose(flicker(conditions, times, 0.004), expected, atol=1e-6)
        np.testing.assert_allclose(flicker(conditions, times, 0.01), 1.0, atol=1e-12)

    @pytest.mark.parametrize(('light', 'gain'), [(4.0, 1.0), (0.25, 4.0)])
    def test_automatic_exposure_reaches_its_grey_level_with_time_before_gain(
        self, light: float, gain: float
    ) -> None:
        control = ExposureControl(ImageConditions(auto_exposure=True, exposure_s=0.01))
        for _ in range(40):
            control.follow(TARGET_GREY * light * (control.exposure_s / 0.01) * control.gain)
        assert control.gain == pytest.approx(gain, rel=1e-3)
        assert control.exposure_s == pytest.approx(0.01 * min(1.0, 1.0 / light), rel=1e-3)
        for _ in range(100):
            control.follow(0.0)
        assert control.gain == MAX_GAIN

    def test_a_fixed_exposure_stays(self) -> None:
        control = ExposureControl(ImageConditions())
        control.follow(1.0)
        assert (control.exposure_s, control.gain) == (ImageConditions().exposure_s, 1.0)

    def test_noise_grows_with_brightness_and_gain(self) -> None:
        sensor = ImageSensor(SMALL, replace(NOISELESS, read_noise_grey=1.0, shot_noise_grey=3.0))
        for grey, gain in ((100.0, 1.0), (25.0, 1.0), (100.0, 4.0)):
            light = np.full((120, 160), grey * LEVELS_PER_GREY, np.float32)
            image = sensor.read(light, 1.0, gain, np.random.default_rng(0)).astype(float)
            expected = math.sqrt(gain**2 + 9.0 * gain * grey / 100.0 + 1.0 / 12.0)
            assert image.std() == pytest.approx(expected, rel=0.03)

    def test_dust_is_fixed_in_the_image_and_darkens(self) -> None:
        clean, dusty = (ImageSensor(SMALL, replace(NOISELESS, dust=count), 3) for count in (0, 4))
        light = np.full((120, 160), 100.0 * LEVELS_PER_GREY, np.float32)
        loss = clean.read(light.copy(), 1.0).astype(int) - dusty.read(light.copy(), 1.0)
        assert loss.min() == 0 and 8 <= loss.max() < 95 and 0.0 < (loss > 0).mean() < 0.3
        np.testing.assert_array_equal(dusty.read(light.copy(), 1.0), ImageSensor(
            SMALL, replace(NOISELESS, dust=4), 3).read(light, 1.0))  # fmt: skip

    def test_optical_blur_widens_a_dot_by_its_variance(self) -> None:
        layer = dots(np.array([[0.0, 0.0]]), 0.014)
        widths = []
        for blur_px in (0.0, 1.5):
            sensor = ImageSensor(SMALL, NOISELESS)
            image = CeilingRenderer(SMALL, [layer], sensor, optical_blur_px=blur_px).render(
                np.eye(3), np.zeros(3), exposure=1.0
            )
            profile = image.astype(float).sum(axis=0) - 20.0 * 120
            offset = np.arange(160) - 79.5
            widths.append((profile * offset**2).sum() / profile.sum())
        assert widths[1] - widths[0] == pytest.approx(1.5**2, rel=0.1)

    def test_without_antialiasing_detail_below_a_pixel_remains(self) -> None:
        sharp, smooth = (
            find_ceiling('tiles').draw(np.random.default_rng(0), HEIGHT_M, Grid(0.0067, blur))[0].brightness
            for blur in (0.0, 2.4)
        )
        assert (
            np.abs(np.diff(sharp.astype(float))).mean() > 2.0 * np.abs(np.diff(smooth.astype(float))).mean()
        )

    def test_jpeg_of_low_quality_changes_more(self) -> None:
        noise = np.random.default_rng(0).integers(80, 120, (64, 64)).astype(np.uint8)
        errors = [np.abs(after_jpeg(noise, quality).astype(int) - noise).mean() for quality in (40, 95)]
        assert errors[0] > 2.0 * errors[1] > 0.0


class TestMovingThings:
    @pytest.mark.parametrize('name', MOVING)
    def test_moves_while_the_camera_stands_still(self, name: str) -> None:
        conditions = replace(NOISELESS, **{name: True})
        (layer,) = moving_layers(conditions, np.random.default_rng(4), HEIGHT_M, COARSE)
        grey = np.full((64, 64), 100 * LEVELS_PER_GREY, np.uint16)
        background = Layer(HEIGHT_M, (0.0, 0.0), 0.1, grey)
        renderer = CeilingRenderer(SMALL, [background, layer], ImageSensor(SMALL, NOISELESS))
        first, later = (
            renderer.expose([[CameraPose(np.eye(3), np.zeros(3), time_s)]], 1.0).astype(int)
            for time_s in (1.0, 41.03)
        )
        assert ((first != 100).sum() > 50) and (np.abs(first - later) > 8).sum() > 20
        assert (first >= 100).all() == (name == 'sun_patch'), 'only light adds brightness'

    def test_a_moved_layer_is_imaged_where_geometry_projects_it(self) -> None:
        still = dots(np.array([[0.3, 0.1]]), 0.014)
        opaque = np.full_like(still.brightness, OPAQUE)
        moved = replace(still, opacity=opaque, motion=lambda time_s: (0.4 * time_s, -0.2, 0.5 * time_s))
        renderer = CeilingRenderer(SMALL, [moved], ImageSensor(SMALL, NOISELESS))
        image = renderer.expose([[CameraPose(np.eye(3), np.zeros(3), 1.0)]], 1.0).astype(float)
        c, s = math.cos(0.5), math.sin(0.5)
        point = np.array([[0.4 + c * 0.3 - s * 0.1, -0.2 + s * 0.3 + c * 0.1, HEIGHT_M]])
        expected = project(SMALL, point)[0]
        assert np.abs(centroid(image, expected) - expected).max() < 0.1

    def test_nothing_moves_by_default(self) -> None:
        assert moving_layers(ImageConditions(), np.random.default_rng(0), HEIGHT_M, COARSE) == []


def test_the_light_is_off_in_the_middle() -> None:
    time_s = np.arange(100.0, 160.0, 0.5)
    conditions = ImageConditions(light=1.5, darkness_s=10.0)
    is_off = room_light(conditions, time_s) < 0.1
    assert 9.5 <= 0.5 * np.count_nonzero(is_off) <= 10.0
    assert time_s[is_off].mean() == pytest.approx(time_s.mean(), abs=0.5)
    assert np.all(room_light(conditions, time_s)[~is_off] == 1.5)
    assert np.all(room_light(ImageConditions(), time_s) == 1.0)


class TestScenes:
    def test_are_many_and_cover_the_ceilings_lenses_and_conditions(self) -> None:
        assert len(SCENES) >= 10 and all(scene.name == name for name, scene in SCENES.items())
        assert {scene.ceiling for scene in SCENES.values()} == set(CEILINGS)
        assert {scene.camera.lens for scene in SCENES.values()} == {
            'plumb_bob',
            'rational_polynomial',
            'equidistant',
        }
        assert {5, 15, 30} <= {scene.camera_hz for scene in SCENES.values()}
        for name in (
            'flicker',
            'readout_s',
            'dust',
            'optical_blur_px',
            'auto_exposure',
            'darkness_s',
            *MOVING,
        ):
            assert any(getattr(scene.conditions, name) for scene in SCENES.values()), name
        with pytest.raises(ConfigError, match='darc'):
            find_scene('darc')

    def test_the_scenario_keeps_its_drive(self) -> None:
        scenario = SCENES['slow'].applied_to(SCENARIOS['cleaning'])
        assert scenario.camera_hz == 5 and scenario.stages == SCENARIOS['cleaning'].stages

    @pytest.mark.slow
    @pytest.mark.parametrize('name', SCENES)
    def test_can_be_rendered_and_repeated(self, name: str) -> None:
        scenario = SCENES[name].applied_to(replace(SCENARIOS['cleaning'], duration_s=5.0))
        scenario = replace(scenario, camera=quarter(scenario.camera))
        one, again = (SimSource(scenario, 2, images=True).image_sequence() for _ in range(2))
        numbers = (0, 4 * scenario.camera_hz)
        images = [one.render(number) for number in numbers]
        assert all(
            np.array_equal(image, again.render(number)) for image, number in zip(images, numbers, strict=True)
        )
        assert all(image.shape == (120, 160) and image.std() > 1.0 for image in images)


def quarter(camera: CameraIntrinsics) -> CameraIntrinsics:
    """Return the same lens before a sensor of a quarter of the width and height in pixels."""
    return replace(
        camera,
        width_px=camera.width_px // 4,
        height_px=camera.height_px // 4,
        fx_px=camera.fx_px / 4,
        fy_px=camera.fy_px / 4,
        cx_px=(camera.cx_px + 0.5) / 4 - 0.5,
        cy_px=(camera.cy_px + 0.5) / 4 - 0.5,
    )


@pytest.mark.slow
def test_the_images_of_the_default_conditions_do_not_depend_on_the_way_of_rendering() -> None:
    """A block of an image is rendered as the whole image would be: a band of rows agrees with all rows."""
    poses = SimSource(replace(SCENARIOS['filmed'], duration_s=3.0), 0).camera_poses
    sequence = ImageSequence(
        SMALL, 'default', replace(NOISELESS, read_noise_grey=0.0), (), 0, np.array([0.5]), poses
    )
    image = sequence.render(0)
    cropped = replace(SMALL, height_px=60)
    part = ImageSequence(cropped, 'default', replace(NOISELESS), (), 0, np.array([0.5]), poses)
    np.testing.assert_array_equal(part.render(0), image[:60])
