"""The feature tracker on rendered, blank and real images."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal_ros.bench.tracker import Conditions, tracker_accuracy
from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations, Frame, SearchRegions, nanoseconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.sim.render import CeilingRenderer, ceiling_renderer
from gyrocal_ros.vision.corners import find_corners, is_of_blocks, shows_blocks
from gyrocal_ros.vision.draw import draw_tracks
from gyrocal_ros.vision.patches import (
    MATCHING_PX,
    Alignment,
    align,
    extract_patches,
    grid,
    node_offsets,
    patch_points,
    sample_image,
)
from gyrocal_ros.vision.search_region import ceiling_coordinates, ceiling_pixels
from gyrocal_ros.vision.tracker import Tracker

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (-0.05, 0.01, 5e-4, -3e-4, 0.0))
CONFIG = TrackerConfig()
CEILING_M = 2.5


def attitude(yaw_rad: float) -> Array:
    return rotation_from_euler(np.array([0.0, 0.0, yaw_rad]))


class RenderedDrive:
    """A camera below a rendered ceiling with its tracker."""

    def __init__(self, renderer: CeilingRenderer, config: TrackerConfig = CONFIG) -> None:
        self.tracker = Tracker(CAMERA, config)
        self.renderer = renderer
        self.rng = np.random.default_rng(0)
        self.points_w: dict[int, Array] = {}

    def step(
        self, t_s: float, yaw_rad: float, *, x_m: float = 0.0, exposure: float = 1.0, covered: bool = False
    ) -> FeatureObservations:
        R_wc, p_wc = attitude(yaw_rad), np.array([x_m, 0.0, 0.1])
        image = self.renderer.render(R_wc, p_wc, exposure=exposure, rng=self.rng)
        if covered:
            image[:, :320] = 30
        tracked = self.tracker.track(Frame(nanoseconds(t_s), image), R_wc, self.regions(t_s, R_wc, p_wc))
        rays_w = np.column_stack([bearing(CAMERA, tracked.pixels), np.ones(len(tracked.ids))]) @ R_wc.T
        for id_, point_w in zip(tracked.ids.tolist(), p_wc + rays_w * (CEILING_M - p_wc[2]), strict=True):
            self.points_w.setdefault(id_, point_w)
        return tracked

    def regions(self, t_s: float, R_wc: Array, p_wc: Array) -> SearchRegions:
        points_w = np.array(list(self.points_w.values())).reshape(-1, 3)
        covariances = np.tile(0.25 * np.eye(2), (len(points_w), 1, 1))
        ids = np.array(list(self.points_w), np.int64)
        return SearchRegions(nanoseconds(t_s), ids, project(CAMERA, (points_w - p_wc) @ R_wc), covariances)


@pytest.fixture(scope='module')
def renderer() -> CeilingRenderer:
    return ceiling_renderer(CAMERA, 1, ceiling_height_m=CEILING_M, objects=0)


# --- patches ------------------------------------------------------------------------------------


def smooth_image(shift: tuple[float, float] = (0.0, 0.0), turn_rad: float = 0.0) -> np.ndarray:
    """Return a pattern that is known at any fraction of a pixel, moved and turned about pixel (60, 60)."""
    v, u = np.mgrid[:121, :121] - 60.0
    u, v = u - shift[0], v - shift[1]
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    x, y = c * u + s * v, c * v - s * u
    bumps = [(0.0, 1.0, 60.0), (3.5, -3.0, -45.0), (-4.5, -2.5, 40.0), (-2.0, 5.5, -35.0), (6.5, 5.0, 30.0)]
    grey = 120.0 + sum(a * np.exp(-((x - p) ** 2 + (y - q) ** 2) / (2.0 * 1.8**2)) for p, q, a in bumps)
    return np.rint(grey).astype(np.uint8)


@pytest.mark.parametrize(('shift', 'turn_deg'), [((0.0, 0.0), 0.0), ((0.31, -0.77), 0.0), ((1.4, 1.1), 6.0)])
def test_lucas_kanade_finds_shift_and_twist_to_a_hundredth_of_a_pixel(
    shift: tuple[float, float], turn_deg: float
) -> None:
    patches = extract_patches(smooth_image(), np.array([[60, 60]]), 15)
    image = smooth_image(shift, math.radians(turn_deg))
    found = align(image, patches, 60.0 + node_offsets(15)[None], 0.75)
    assert np.abs(found.pixels[0] - 60.0 - shift).max() < 0.01
    assert math.degrees(found.twist_rad) == pytest.approx(turn_deg, abs=0.2)
    assert found.correlation[0] > 0.995
    assert found.backward_px[0] < 0.02


def test_the_covariance_of_a_match_is_that_of_its_errors() -> None:
    rng, first = np.random.default_rng(0), smooth_image()
    patches = extract_patches(first, np.array([[60, 60]]), 15)

    def noisy(std: float) -> Alignment:
        image = np.clip(first + rng.normal(0.0, std, first.shape), 0, 255).round().astype(np.uint8)
        return align(image, patches, 60.0 + node_offsets(15)[None], 0.75)

    matches = [noisy(8.0) for _ in range(200)]
    errors = np.array([match.pixels[0] - 60.0 for match in matches])
    told = np.mean([match.covariances_px2[0] for match in matches], axis=0) - MATCHING_PX**2 * np.eye(2)
    assert np.sqrt(np.diagonal(told)) == pytest.approx(errors.std(axis=0), rel=0.35)
    assert np.sqrt(np.diagonal(noisy(0.5).covariances_px2[0])) == pytest.approx(MATCHING_PX, rel=0.1)


def test_the_standard_deviation_of_the_twist_is_that_of_its_errors() -> None:
    rng, first = np.random.default_rng(0), smooth_image()
    patches = extract_patches(first, np.array([[60, 60], [57, 61]]), 15)
    nodes = np.array([[[60.0, 60.0]], [[57.0, 61.0]]]) + node_offsets(15)

    def noisy(std: float) -> Alignment:
        image = np.clip(first + rng.normal(0.0, std, first.shape), 0, 255).round().astype(np.uint8)
        return align(image, patches, nodes, 0.75)

    matches = [noisy(8.0) for _ in range(200)]
    told = np.mean([match.twist_std_rad for match in matches])
    assert told == pytest.approx(np.std([match.twist_rad for match in matches]), rel=0.35)
    assert noisy(1.0).twist_std_rad < 0.3 * told
    assert math.isinf(align(np.zeros_like(first), patches, nodes, 0.75).twist_std_rad)


def test_gain_offset_and_gradient_of_the_brightness_do_not_shift_a_patch() -> None:
    patches = extract_patches(smooth_image(), np.array([[60, 60]]), 15)
    slope = 0.4 * (np.arange(121) - 60.0)
    image = np.rint(0.7 * smooth_image((0.4, 0.3)) + 25.0 + slope).astype(np.uint8)
    found = align(image, patches, 60.0 + node_offsets(15)[None], 0.75)
    assert np.abs(found.pixels[0] - [60.4, 60.3]).max() < 0.015


def test_sampling_reproduces_a_gradient_everywhere() -> None:
    v, u = np.mgrid[:40, :50]
    points = np.random.default_rng(0).uniform(3.0, 30.0, (100, 2))
    values = sample_image((2 * u + 3 * v).astype(np.uint8), points[:, 0], points[:, 1])
    assert values == pytest.approx(2.0 * points[:, 0] + 3.0 * points[:, 1], abs=1e-4)


def test_ceiling_coordinates_and_pixels_are_inverse() -> None:
    R_wc = rotation_from_euler(np.array([0.05, -0.1, 2.0]))
    pixels = np.random.default_rng(0).uniform([20, 20], [620, 460], (50, 2))
    ceiling = ceiling_coordinates(CAMERA, pixels, R_wc)
    assert ceiling_pixels(CAMERA, ceiling, R_wc) == pytest.approx(pixels, abs=1e-6)


@pytest.mark.parametrize('centre', [(320.0, 240.0), (620.0, 22.0), (20.0, 460.0)])
def test_the_points_between_the_nodes_of_a_patch_follow_the_lens(centre: tuple[float, float]) -> None:
    before = rotation_from_euler(np.array([0.02, 0.01, 0.3]))
    now = rotation_from_euler(np.array([-0.01, 0.03, 2.0]))
    offsets = ceiling_coordinates(CAMERA, np.array(centre) + grid(15), before)
    points = ceiling_pixels(CAMERA, offsets - offsets[112] + [0.6, -0.5], now)
    nodes = points.reshape(15, 15, 2)[::7, ::7].reshape(1, 9, 2)
    error_px = patch_points(nodes, 15)[:, 0] - points.T
    assert np.abs(error_px).max() < 1e-3
    assert np.abs(error_px.mean(axis=1)).max() < 1e-5, 'a common shift would move the feature'


# --- accuracy -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_turn_of_the_tracks_is_true_despite_a_prediction_error() -> None:
    rows = list(tracker_accuracy(1, (20.0, 100.0), Conditions(frames=25, attitude_error=0.08)))
    for row in rows:
        assert abs(row['turn_error_percent']) < 0.03
        assert row['rms_px'] < 0.05
        assert row['slow_95_px'] < 0.08
        assert row['features'] > 10


@pytest.mark.slow
def test_the_noise_of_a_track_is_white(renderer: CeilingRenderer) -> None:
    drive = RenderedDrive(renderer)
    tracked = [drive.step(0.1 * k, 0.02 * k, exposure=1.0 + 0.01 * k) for k in range(25)]
    steady = set.intersection(*(set(each.ids.tolist()) for each in tracked))
    assert len(steady) >= 8
    errors = []
    for k, each in enumerate(tracked[1:], start=1):
        points_w = np.array([drive.points_w[id_] for id_ in sorted(steady)])
        where = project(CAMERA, (points_w - [0.0, 0.0, 0.1]) @ attitude(0.02 * k))
        errors.append(each.pixels[np.isin(each.ids, list(steady))] - where)
    noise = np.array(errors) - np.mean(errors, axis=0)
    assert math.sqrt((noise**2).mean()) < 0.03
    assert abs((noise[1:] * noise[:-1]).mean() / (noise**2).mean()) < 0.2


# --- losing and reacquiring features --------------------------------------------------------------


@pytest.mark.slow
def test_an_occluded_feature_is_reacquired_with_its_id_and_ids_are_unique(renderer: CeilingRenderer) -> None:
    drive = RenderedDrive(renderer)
    before = [drive.step(0.1 * k, 0.01 * k, x_m=0.01 * k) for k in range(4)][-1]
    hidden = [drive.step(0.1 * k, 0.01 * k, x_m=0.01 * k, covered=True) for k in range(4, 10)][-1]
    after = [drive.step(0.1 * k, 0.01 * k, x_m=0.01 * k) for k in range(10, 13)][-1]
    left = set(before.ids[before.pixels[:, 0] < 280].tolist())
    assert len(left) >= 3
    assert not left & set(hidden.ids.tolist())
    assert hidden.pixels[:, 0].min() > 300
    assert len(left & set(after.ids.tolist())) >= 4
    assert len(set(after.ids.tolist())) == len(after.ids)
    common, first, second = np.intersect1d(before.ids, after.ids, return_indices=True)
    assert len(common) >= 8


@pytest.mark.slow
def test_a_feature_lost_for_long_is_dropped(renderer: CeilingRenderer) -> None:
    drive = RenderedDrive(renderer, replace(CONFIG, reacquire_s=1.0))
    before = drive.step(0.0, 0.0)
    drive.step(0.1, 0.0, covered=True)
    for k in range(2, 15):
        drive.step(0.1 * k, 0.0, covered=True)
    after = drive.step(1.6, 0.0)
    left = set(before.ids[before.pixels[:, 0] < 280].tolist())
    assert left
    assert not left & set(after.ids.tolist())
    assert after.ids.min() >= 0
    assert set(after.ids.tolist()) - set(before.ids.tolist()) > set()


def test_a_feature_that_the_filter_does_not_use_is_replaced_but_keeps_its_place(
    renderer: CeilingRenderer,
) -> None:
    drive = RenderedDrive(renderer)
    first = drive.step(0.0, 0.0)
    assert len(first.ids) == CONFIG.features
    unused = first.ids[:3]

    def track(t_s: float) -> FeatureObservations:
        for feature in unused.tolist():
            drive.points_w.pop(feature, None)
        return drive.step(t_s, 0.0)

    tracked = [track(0.2 * (k + 1)).ids for k in range(2 * CONFIG.detect_interval)]
    for ids in tracked:
        assert np.isin(unused, ids).all(), 'no other is found where they are'
    counts = [len(ids) for ids in tracked]
    assert counts[:5] == [CONFIG.features] * 5, 'they may find their place in the map again'
    assert counts[-1] == max(counts) == CONFIG.features + len(unused)


@pytest.mark.parametrize(
    'regions', [None, SearchRegions(0, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))]
)
def test_without_a_map_features_are_not_replaced_without_end(
    renderer: CeilingRenderer, regions: SearchRegions | None
) -> None:
    tracker, image = Tracker(CAMERA, CONFIG), renderer.render(np.eye(3), np.zeros(3))
    counts = [
        len(tracker.track(Frame(nanoseconds(0.2 * k), image), np.eye(3), regions).ids)
        for k in range(4 * CONFIG.detect_interval)
    ]
    assert counts[0] == CONFIG.features
    assert max(counts) == CONFIG.features + (0 if regions is None else CONFIG.features // 2)


def test_no_two_features_track_one_corner(renderer: CeilingRenderer) -> None:
    drive = RenderedDrive(renderer)
    for k in range(15):
        tracked = drive.step(0.1 * k, 0.05 * k, x_m=0.03 * k)
        distances_px = np.linalg.norm(tracked.pixels[:, None] - tracked.pixels, axis=2) + 1e3 * np.eye(
            len(tracked.ids)
        )
        assert distances_px.min() > 0.5 * CONFIG.patch_px


def test_wrong_regions_do_not_lose_the_tracks(renderer: CeilingRenderer) -> None:
    tracker = Tracker(CAMERA, CONFIG)
    image = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]), rng=np.random.default_rng(0))
    first = tracker.track(Frame(0, image), np.eye(3), None)
    off = SearchRegions(
        nanoseconds(0.1), first.ids, first.pixels + 9.0, np.tile(0.04 * np.eye(2), (len(first.ids), 1, 1))
    )
    second = tracker.track(Frame(nanoseconds(0.1), image), np.eye(3), off)
    common, then, now = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(common) >= 0.9 * len(first.ids)
    assert np.abs(second.pixels[now] - first.pixels[then]).max() < 0.01


@pytest.mark.parametrize('turn_deg', [-12.0, 8.0])
def test_a_turn_that_the_gyro_does_not_show_at_this_time_is_followed(
    renderer: CeilingRenderer, turn_deg: float
) -> None:
    """As where images are late, or a gyro is at its limit: prediction and regions are wrong."""
    drive = RenderedDrive(renderer)
    first = [drive.step(0.1 * k, 0.0) for k in range(3)][-1]
    true, p_wc = attitude(math.radians(turn_deg)), np.array([0.03, 0.0, 0.1])
    image = renderer.render(true, p_wc, exposure=1.0, rng=drive.rng)
    wrong = attitude(0.0)
    seen = drive.tracker.track(Frame(nanoseconds(0.3), image), wrong, drive.regions(0.3, wrong, p_wc))
    _, before, after = np.intersect1d(first.ids, seen.ids, return_indices=True)
    expected = project(CAMERA, (np.array([drive.points_w[i] for i in first.ids[before]]) - p_wc) @ true)
    inside = np.all((expected > 40.0) & (expected < [600.0, 440.0]), axis=1)
    assert len(before) >= 8
    assert np.abs(seen.pixels[after] - expected)[inside].max() < 0.5
    assert math.degrees(drive.tracker.yaw_error_rad) == pytest.approx(-turn_deg, abs=0.3)


def test_one_match_outside_its_region_is_rejected(renderer: CeilingRenderer) -> None:
    tracker = Tracker(CAMERA, CONFIG)
    image = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]), rng=np.random.default_rng(0))
    first = tracker.track(Frame(0, image), np.eye(3), None)
    pixels = first.pixels.copy()
    pixels[2] += 12.0
    regions = SearchRegions(
        nanoseconds(0.1), first.ids, pixels, np.tile(0.04 * np.eye(2), (len(first.ids), 1, 1))
    )
    second = tracker.track(Frame(nanoseconds(0.1), image), np.eye(3), regions)
    assert first.ids[2] not in second.ids
    assert set(np.delete(first.ids, 2).tolist()) <= set(second.ids.tolist())


def test_the_same_images_give_the_same_bits(renderer: CeilingRenderer) -> None:
    def pixels() -> bytes:
        drive = RenderedDrive(renderer)
        return b''.join(drive.step(0.1 * k, 0.1 * k, x_m=0.05 * k).pixels.tobytes() for k in range(8))

    assert pixels() == pixels()


@pytest.mark.parametrize('wanted', [1, 5, 60, 200])
def test_any_number_of_features_can_be_tracked(renderer: CeilingRenderer, wanted: int) -> None:
    drive = RenderedDrive(renderer, replace(CONFIG, features=wanted, min_distance_px=16.0))
    counts = [len(drive.step(0.1 * k, 0.02 * k).ids) for k in range(3)]
    assert max(counts) <= wanted
    assert min(counts) >= min(wanted, 30)


# --- images without features --------------------------------------------------------------------


def blank_images() -> Iterator[np.ndarray]:
    rng = np.random.default_rng(0)
    shape = (CAMERA.height_px, CAMERA.width_px)
    for grey in (0, 127, 255):
        yield np.full(shape, grey, np.uint8)
    yield np.clip(rng.normal(3.0, 2.0, shape), 0, 255).astype(np.uint8)
    yield np.clip(rng.normal(120.0, 6.0, shape), 0, 255).astype(np.uint8)
    yield np.tile(np.linspace(20, 200, CAMERA.width_px).astype(np.uint8), (CAMERA.height_px, 1))


@pytest.mark.parametrize(
    'image', list(blank_images()), ids=['dark', 'grey', 'bright', 'dark noise', 'noise', 'slope']
)
def test_an_image_without_features_gives_an_empty_observation(
    image: np.ndarray, renderer: CeilingRenderer
) -> None:
    tracker = Tracker(CAMERA, CONFIG)
    for k in range(3):
        tracked = tracker.track(Frame(nanoseconds(0.1 * k), image), np.eye(3), None)
        assert len(tracked.ids) == 0
        assert tracked.pixels.shape == (0, 2)
    ceiling = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]))
    assert len(tracker.track(Frame(nanoseconds(0.4), ceiling), np.eye(3), None).ids) > 12
    assert len(tracker.track(Frame(nanoseconds(0.5), image), np.eye(3), None).ids) == 0


def compressed(image: np.ndarray, quality: int) -> np.ndarray:
    """Return what JPEG leaves of an image."""
    encoded = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), np.uint8)


@pytest.mark.parametrize('quality', [20, 30, 40, 50])
def test_the_blocks_of_jpeg_are_no_features(renderer: CeilingRenderer, quality: int) -> None:
    """Of a dark ceiling nothing else is left, and they stay in the image while the camera turns."""
    rng = np.random.default_rng(quality)
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    dark = 3.0 + 6.0 * np.exp(-((u - 300.0) ** 2 + (v - 200.0) ** 2) / 200.0**2)
    dark = np.clip(dark + rng.normal(0.0, 1.5, dark.shape), 0, 255).astype(np.uint8)
    lit = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]), rng=rng)
    found = [
        len(Tracker(CAMERA, CONFIG).track(Frame(0, compressed(image, quality)), np.eye(3), None).ids)
        for image in (dark, lit)
    ]
    assert found[0] == 0 and found[1] >= 14


def test_hardly_any_sharp_texture_is_taken_for_blocks() -> None:
    rng = np.random.default_rng(5)
    corners = rng.integers(20, 440, (300, 2)).astype(np.intp)

    def cells(side: int, count: int, levels: int) -> NDArray[np.uint8]:
        values = rng.integers(0, levels, (count, count))
        return np.kron(values, np.ones((side, side))).astype(np.uint8)

    for side in (3, 5, 7):
        image = cells(side, 490 // side, 255)
        assert not shows_blocks(image)
        assert np.mean([is_of_blocks(image, corner, CONFIG.patch_px) for corner in corners]) < 0.06
    blocks = cells(8, 60, 3)
    assert shows_blocks(blocks)
    assert all(is_of_blocks(blocks, corner, CONFIG.patch_px) for corner in corners)


def test_slats_and_edges_are_rejected() -> None:
    image = np.full((480, 640), 100, np.uint8)
    image[100:300, 100:300:8] = 180
    image[100:300, 101:300:8] = 180
    image[350:, 400:] = 200
    tracker = Tracker(CAMERA, CONFIG)
    tracked = tracker.track(Frame(0, image), np.eye(3), None)
    assert len(tracked.ids) >= 1
    inner = ((tracked.pixels > 125) & (tracked.pixels < 275)).all(axis=1)
    assert not inner.any()
    assert np.linalg.norm(tracked.pixels - [400, 350], axis=1).min() < 8


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(RecordingError, match='320 x 240.*640 x 480'):
        Tracker(CAMERA, CONFIG).track(Frame(0, np.zeros((240, 320), np.uint8)), np.eye(3), None)


def test_tracks_can_be_drawn(renderer: CeilingRenderer) -> None:
    drive = RenderedDrive(renderer)
    drive.step(0.0, 0.0)
    image = renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]))
    regions = drive.regions(0.1, np.eye(3), np.array([0.0, 0.0, 0.1]))
    tracked = drive.tracker.track(Frame(nanoseconds(0.1), image), np.eye(3), regions)
    picture = draw_tracks(image, tracked, regions)
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert (picture[..., 0] != picture[..., 1]).any()
    assert draw_tracks(
        image, FeatureObservations(0, np.zeros(0, np.int64), np.zeros((0, 2))), None
    ).shape == (
        480,
        640,
        3,
    )


# --- real pixels ----------------------------------------------------------------------------------


def test_corners_of_a_real_ceiling_are_distributed_over_it() -> None:
    photo = DATA / 'ubiquity-ceiling' / 'ceiling3-6-02.jpg'
    if not photo.exists():
        pytest.skip(f'no {photo.name} beside the project')
    image = np.asarray(cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE), np.uint8)
    corners = find_corners(image, np.zeros((0, 2)), np.zeros((0, 2), np.intp), 14, CONFIG)[:15]
    assert len(corners) == 15
    distances_px = np.linalg.norm(corners[:, None] - corners, axis=2) + 1e3 * np.eye(15)
    assert distances_px.min() >= CONFIG.min_distance_px - 2.0
    quarters = {(u > 320, v > 240) for u, v in corners.tolist()}
    assert len(quarters) == 4
    tracked = Tracker(CAMERA, CONFIG).track(Frame(0, image), np.eye(3), None)
    assert len(tracked.ids) >= 8


class Fisheye:
    """Lens of the cycloid recording: equidistant, restricted to the part that a pinhole camera can model."""

    focal_px, centre = 765.0 / 4.05, np.array([1280.0, 920.0]) / 4.05
    half_px = 180

    def __init__(self) -> None:
        x = np.linspace(0.01, 1.5, 200)
        angle = np.arctan(x)
        powers = np.stack([x**3, x**5, x**7], axis=1)
        k1, k2, k3 = np.linalg.lstsq(powers, angle * (1 + 0.015 * angle**2) - x, rcond=None)[0].tolist()
        self.corner = self.centre.astype(int) - self.half_px
        cx, cy = (self.centre - self.corner).tolist()
        size = 2 * self.half_px + 1
        self.camera = CameraIntrinsics(
            size, size, self.focal_px, self.focal_px, cx, cy, (k1, k2, 0.0, 0.0, k3)
        )

    def cropped(self, image: np.ndarray) -> np.ndarray:
        left, top = self.corner
        return np.ascontiguousarray(
            image[top : top + self.camera.height_px, left : left + self.camera.width_px]
        )

    def on_ceiling(self, pixels: Array, R_wc: Array) -> Array:
        offset = (pixels + self.corner - self.centre) / self.focal_px
        radius = np.linalg.norm(offset, axis=1, keepdims=True)
        angle = radius.copy()
        for _ in range(8):
            angle -= (angle * (1 + 0.015 * angle**2) - radius) / (1 + 0.045 * angle**2)
        rays_w = np.column_stack([offset * np.tan(angle) / radius, np.ones(len(pixels))]) @ R_wc.T
        return rays_w[:, :2] / rays_w[:, 2:]


def turn_between(before: Array, after: Array) -> float:
    """Return the angle of the rigid motion from points to points, without the outliers."""
    keep = np.ones(len(before), bool)
    angle = 0.0
    for _ in range(4):
        a, b = before - before[keep].mean(axis=0), after - after[keep].mean(axis=0)
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        angle = math.atan2(cross[keep].sum(), (a[keep] * b[keep]).sum())
        misfit = np.linalg.norm(b - a @ attitude(angle)[:2, :2].T, axis=1)
        fitting = misfit <= max(3.0 * float(np.median(misfit)), 0.002)
        keep = fitting if fitting.sum() >= 2 else keep
    return angle


@pytest.mark.slow
def test_the_heading_of_a_real_drive_agrees_with_another_tracker() -> None:
    """Track black and white images of lamps without a motion prediction, the hardest case of the tracker."""
    folder = DATA / 'cycloid-ceiling'
    if not folder.exists():
        pytest.skip('no cycloid-ceiling beside the project')
    frames = np.frombuffer(gzip.decompress((folder / 'data.raw.gz').read_bytes()), np.uint8).reshape(
        -1, 480, 640
    )
    reference = np.unwrap(np.loadtxt(folder / 'golden.txt')[: len(frames), 2])
    lens = Fisheye()
    R_wc = rotation_from_euler(np.array([0.0, math.radians(22.0), 0.0]))
    config = replace(CONFIG, min_distance_px=20.0, detect_interval=2)  # few lamps: use both ends of each
    tracker = Tracker(lens.camera, config)
    heading = [0.0]
    before: FeatureObservations | None = None
    for k, image in enumerate(frames):
        tracked = tracker.track(Frame(nanoseconds(k / 30), lens.cropped(image)), R_wc, None)
        if before is not None:
            _, first, second = np.intersect1d(before.ids, tracked.ids, return_indices=True)
            a, b = lens.on_ceiling(before.pixels[first], R_wc), lens.on_ceiling(tracked.pixels[second], R_wc)
            heading.append(heading[-1] + (turn_between(a, b) if len(first) >= 2 else 0.0))
        before = tracked
    difference = np.degrees(np.array(heading) - (reference - reference[0]))
    assert math.degrees(reference[-1] - reference[0]) == pytest.approx(193.0, abs=1.0)
    assert np.abs(difference).max() < 6.0
    assert math.sqrt((difference**2).mean()) < 3.5
