"""The tracker as a process: images go in, features come out."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import Graph
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import (
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    ImuSample,
    SearchRegions,
    nanoseconds,
)
from gyrocal_ros.model.camera import mount_from_yaw
from gyrocal_ros.msgs import images, to_ros, topics
from gyrocal_ros.msgs.transforms import IDENTITY
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT, STATIC
from gyrocal_ros.sim.render import ceiling_renderer

CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (-0.05, 0.01, 5e-4, -3e-4, 0.0))
START_NS = 1_700_000_000_000_000_000
MAKE = to_ros.live_maker(get_message)
BEST_EFFORT = SENSOR_IN
TOPIC = 'ceiling_camera/image_raw'


@cache
def ceiling() -> np.ndarray:
    """What the camera sees while it stands still."""
    renderer = ceiling_renderer(CAMERA, 1, objects=0)
    return renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]), rng=np.random.default_rng(0))


class Robot:
    """A robot that stands still: it publishes what its tracker wants."""

    def __init__(
        self, graph: Graph, namespace: str = '', *, compressed: bool = False, qos: QoSProfile = SENSOR_OUT
    ) -> None:
        self.graph = graph
        self._compressed = compressed
        self._step = 0
        before = f'/{namespace}/' if namespace else ''
        self.features: list[PointCloud2] = graph.listen(PointCloud2, f'{before}ceiling_camera/features')
        kind, ending = (CompressedImage, '/compressed') if compressed else (Image, '')
        self._images = graph.node.create_publisher(kind, f'{before}{TOPIC}{ending}', qos)
        self._infos = graph.node.create_publisher(
            CameraInfo, f'{before}ceiling_camera/camera_info', SENSOR_OUT
        )
        self._imu = graph.node.create_publisher(Imu, f'{before}imu/data_raw', SENSOR_OUT)
        self.regions = graph.node.create_publisher(
            PointCloud2, f'{before}ceiling_camera/search_regions', SENSOR_OUT
        )
        links = graph.node.create_publisher(TFMessage, '/tf_static', STATIC)
        mounts = {topics.CAMERA_FRAME: mount_from_yaw(0.1, 0.0, 0.1, -90.0), topics.IMU_FRAME: IDENTITY}
        links.publish(to_ros.static_transforms(MAKE, mounts, START_NS))

    @property
    def publishers(self) -> list[Publisher]:
        return [self._images, self._infos, self._imu, self.regions]

    def is_heard(self) -> bool:
        """Whether the tracker listens to all of it; it finds the images by itself."""
        return all(publisher.get_subscription_count() for publisher in self.publishers)

    def show(self, image: np.ndarray | None = None) -> int:
        """Publish the next image, 0.1 s later, and what the IMU has measured till then; return its stamp."""
        self._step += 1
        t_ns = START_NS + nanoseconds(0.1 * self._step)
        frame = Frame(t_ns, ceiling() if image is None else image)
        self._infos.publish(to_ros.camera_info(MAKE, CAMERA, t_ns))
        for k in range(10, -1, -1):
            sample = ImuSample(t_ns - nanoseconds(0.01 * k), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
            self._imu.publish(to_ros.imu(MAKE, sample))
        convert = images.compressed_image if self._compressed else images.grey_image
        self._images.publish(convert(MAKE, frame))
        return t_ns

    def see(self, image: np.ndarray | None = None) -> FeatureObservations:
        """Show images until one is followed; return the features in it."""
        shown: set[int] = set()
        heard = len(self.features)

        def answered() -> Any:
            new = [item for item in self.features[heard:] if topics.stamp_ns(item) in shown]
            if not new:
                shown.add(self.show(image))
            return new

        return topics.features(self.graph.wait(answered, 'the features of an image')[-1])


@pytest.fixture
def graph() -> Iterator[Graph]:
    with Graph() as graph:
        yield graph


def started(graph: Graph, **more: Any) -> Robot:
    graph.start('tracker')
    robot = Robot(graph, **more)
    graph.wait(robot.is_heard, 'the tracker to listen')
    return robot


def said(health: list[DiagnosticArray]) -> str:
    return health[-1].status[0].message if health else ''


@pytest.mark.parametrize('qos', [SENSOR_OUT, BEST_EFFORT], ids=['reliable', 'best effort'])
@pytest.mark.parametrize('compressed', [False, True], ids=['raw', 'compressed'])
def test_images_go_in_and_features_come_out(graph: Graph, compressed: bool, qos: QoSProfile) -> None:
    robot = started(graph, compressed=compressed, qos=qos)
    first, second = robot.see(), robot.see()
    assert len(first.ids) == 15
    assert robot.features[-1].header.frame_id == topics.CAMERA_FRAME
    np.testing.assert_array_equal(first.ids, second.ids)
    np.testing.assert_allclose(first.pixels, second.pixels, atol=0.05)


def test_the_picture_of_the_tracks_is_made_for_those_who_look(graph: Graph) -> None:
    robot = started(graph)
    robot.see()
    pictures = graph.listen(Image, 'ceiling_camera/tracks_image')
    graph.wait(lambda: pictures or not robot.show(), 'a picture')
    picture = pictures[-1]
    assert (picture.width, picture.height, picture.encoding) == (640, 480, 'bgr8')
    pixels = np.frombuffer(picture.data, np.uint8).reshape(480, 640, 3)
    assert np.ptp(pixels, axis=2).max() > 100, 'the tracks are coloured'


def test_a_tracker_that_was_killed_takes_up_other_ids(graph: Graph) -> None:
    process = graph.start('tracker')
    robot = Robot(graph)
    graph.wait(robot.is_heard, 'the tracker to listen')
    before = robot.see()
    process.stop(signal.SIGKILL)
    graph.start('tracker')
    after = robot.see()
    assert len(after.ids) == 15 and not np.intersect1d(before.ids, after.ids).size


def test_the_calibrator_guides_it(graph: Graph) -> None:
    robot = started(graph)
    health = graph.listen(DiagnosticArray, '/diagnostics')
    seen = robot.see()
    covariances = np.tile(np.eye(2), (len(seen.ids), 1, 1))

    def is_guided() -> bool:
        now = robot.see()
        robot.regions.publish(
            to_ros.search_regions(MAKE, SearchRegions(now.t_ns, seen.ids, seen.pixels, covariances))
        )
        return said(health).endswith('guided by the calibrator')

    graph.wait(is_guided, 'the regions to be used')


def test_it_says_what_is_wrong_while_it_is(graph: Graph) -> None:
    robot = started(graph)
    health = graph.listen(DiagnosticArray, '/diagnostics')
    graph.wait(lambda: 'ceiling_camera/image_raw: nothing' in said(health), 'the missing images to be named')
    graph.wait(lambda: robot.see() and said(health).startswith('following 15 features'), 'health')
    dark = np.full_like(ceiling(), 5)
    graph.wait(lambda: robot.see(dark) and 'the images are dark' in said(health), 'the dark to be named')
    graph.wait(lambda: robot.see() and said(health).startswith('following'), 'health again')
    small = np.zeros((240, 320), np.uint8)
    graph.wait(lambda: robot.show(small) and 'of no use' in said(health), 'the wrong size to be named')
    assert 'an image is 320 x 240 pixels' in said(health)
    numbers = {item.key: item.value for item in health[-1].status[0].values}
    assert int(numbers['followed']) > 3 and float(numbers['latency_ms_p99']) > 0.0


def test_settings_can_be_changed_and_wrong_ones_are_refused(graph: Graph) -> None:
    robot = started(graph)
    assert len(robot.see().ids) == 15
    assert graph.set_parameter('tracker', 'tracker.features', 5).successful
    refused = graph.set_parameter('tracker', 'tracker.features', 0)
    assert not refused.successful and 'features' in refused.reason
    assert not graph.set_parameter('tracker', 'tracker.patch_px', 21).successful, 'read at the start'
    assert graph.get_parameters('tracker', 'tracker.features', 'tracker.patch_px') == [5, 15]


def test_two_robots_do_not_mix(graph: Graph) -> None:
    for name in ('one', 'two'):
        graph.start('tracker', namespace=name)
    robots = [Robot(graph, name) for name in ('one', 'two')]
    graph.wait(lambda: all(robot.is_heard() for robot in robots), 'both trackers to listen')
    assert len(robots[0].see().ids) == 15
    assert not robots[1].features
    assert len(robots[1].see().ids) == 15
