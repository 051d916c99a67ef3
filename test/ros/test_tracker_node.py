"""The tracker as a process: it receives images and publishes features."""

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
from gyrocal_ros.msgs import clouds, images, to_ros, topics
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
    """Return the image of the camera at rest."""
    renderer = ceiling_renderer(CAMERA, 1, objects=0)
    return renderer.render(np.eye(3), np.array([0.0, 0.0, 0.1]), rng=np.random.default_rng(0))


class Robot:
    """A robot at rest that publishes the inputs of its tracker."""

    def __init__(
        self, graph: Graph, namespace: str = '', *, compressed: bool = False, qos: QoSProfile = SENSOR_OUT
    ) -> None:
        self.graph = graph
        self._compressed = compressed
        self._step = 0
        prefix = f'/{namespace}/' if namespace else ''
        self.features: list[PointCloud2] = graph.listen(PointCloud2, f'{prefix}ceiling_camera/features')
        kind, ending = (CompressedImage, '/compressed') if compressed else (Image, '')
        self._images = graph.node.create_publisher(kind, f'{prefix}{TOPIC}{ending}', qos)
        self._infos = graph.node.create_publisher(
            CameraInfo, f'{prefix}ceiling_camera/camera_info', SENSOR_OUT
        )
        self._imu = graph.node.create_publisher(Imu, f'{prefix}imu/data_raw', SENSOR_OUT)
        self.regions = graph.node.create_publisher(
            PointCloud2, f'{prefix}ceiling_camera/search_regions', SENSOR_OUT
        )
        links = graph.node.create_publisher(TFMessage, '/tf_static', STATIC)
        mounts = {topics.CAMERA_FRAME: mount_from_yaw(0.1, 0.0, 0.1, -90.0), topics.IMU_FRAME: IDENTITY}
        links.publish(to_ros.static_transforms(MAKE, mounts, START_NS))

    @property
    def publishers(self) -> list[Publisher]:
        return [self._images, self._infos, self._imu, self.regions]

    def has_subscribers(self) -> bool:
        """Return True if the tracker has subscribed to all inputs, images included."""
        return all(publisher.get_subscription_count() for publisher in self.publishers)

    def publish(self, image: np.ndarray | None = None) -> int:
        """Publish the next image, 0.1 s later, and the IMU samples until then; return its stamp."""
        self._step += 1
        t_ns = START_NS + nanoseconds(0.1 * self._step)
        if image is None:
            image = ceiling().copy()
            image[0, 0] = self._step % 256  # no two images of a camera that works are the same
        frame = Frame(t_ns, image)
        self._infos.publish(to_ros.camera_info(MAKE, CAMERA, t_ns))
        for k in range(10, -1, -1):
            sample = ImuSample(t_ns - nanoseconds(0.01 * k), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
            self._imu.publish(to_ros.imu(MAKE, sample))
        convert = images.compressed_image if self._compressed else images.grey_image
        self._images.publish(convert(MAKE, frame))
        return t_ns

    def track(self, image: np.ndarray | None = None) -> FeatureObservations:
        """Publish images until one is tracked; return its features."""
        published: set[int] = set()
        count = len(self.features)

        def tracked() -> Any:
            new = [item for item in self.features[count:] if topics.stamp_ns(item) in published]
            if not new:
                published.add(self.publish(image))
            return new

        return clouds.features(self.graph.wait(tracked, 'the features of an image')[-1])


@pytest.fixture
def graph() -> Iterator[Graph]:
    with Graph() as graph:
        yield graph


def started(graph: Graph, **more: Any) -> Robot:
    graph.start('tracker')
    robot = Robot(graph, **more)
    graph.wait(robot.has_subscribers, 'the subscriptions of the tracker')
    return robot


def last_message(health: list[DiagnosticArray]) -> str:
    return health[-1].status[0].message if health else ''


@pytest.mark.parametrize('qos', [SENSOR_OUT, BEST_EFFORT], ids=['reliable', 'best effort'])
@pytest.mark.parametrize('compressed', [False, True], ids=['raw', 'compressed'])
def test_features_of_images_are_published(graph: Graph, compressed: bool, qos: QoSProfile) -> None:
    robot = started(graph, compressed=compressed, qos=qos)
    first, second = robot.track(), robot.track()
    assert len(first.ids) == 15
    assert robot.features[-1].header.frame_id == topics.CAMERA_FRAME
    np.testing.assert_array_equal(first.ids, second.ids)
    np.testing.assert_allclose(first.pixels, second.pixels, atol=0.05)


@pytest.mark.parametrize('compressed', [False, True], ids=['raw', 'compressed'])
def test_a_camera_that_comes_back_with_other_settings_is_received_again(
    graph: Graph, compressed: bool
) -> None:
    """First reliable raw images, then best-effort ones, perhaps compressed."""
    first = started(graph)
    assert len(first.track().ids) == 15
    for publisher in first.publishers:
        graph.node.destroy_publisher(publisher)
    second = Robot(graph, compressed=compressed, qos=BEST_EFFORT)
    graph.wait(second.has_subscribers, 'a new subscription')
    assert len(second.track().ids) == 15


def test_the_image_with_tracks_is_published_for_subscribers(graph: Graph) -> None:
    robot = started(graph)
    robot.track()
    pictures = graph.listen(Image, 'ceiling_camera/tracks_image')
    graph.wait(lambda: pictures or not robot.publish(), 'a picture')
    picture = pictures[-1]
    assert (picture.width, picture.height, picture.encoding) == (640, 480, 'bgr8')
    pixels = np.frombuffer(picture.data, np.uint8).reshape(480, 640, 3)
    assert np.ptp(pixels, axis=2).max() > 100, 'the tracks are coloured'


def test_a_killed_tracker_uses_other_ids_after_its_restart(graph: Graph) -> None:
    process = graph.start('tracker')
    robot = Robot(graph)
    graph.wait(robot.has_subscribers, 'the subscriptions of the tracker')
    before = robot.track()
    process.stop(signal.SIGKILL)
    graph.start('tracker')
    after = robot.track()
    assert len(after.ids) == 15 and not np.intersect1d(before.ids, after.ids).size


def test_the_search_regions_of_the_calibrator_are_used(graph: Graph) -> None:
    robot = started(graph)
    health = graph.listen(DiagnosticArray, '/diagnostics')
    seen = robot.track()
    covariances = np.tile(np.eye(2), (len(seen.ids), 1, 1))

    def is_guided() -> bool:
        now = robot.track()
        robot.regions.publish(
            to_ros.search_regions(MAKE, SearchRegions(now.t_ns, seen.ids, seen.pixels, covariances))
        )
        return last_message(health).endswith('guided by the calibrator')

    graph.wait(is_guided, 'the use of the regions')


def test_problems_are_reported_while_they_last(graph: Graph) -> None:
    robot = started(graph)
    health = graph.listen(DiagnosticArray, '/diagnostics')
    graph.wait(
        lambda: 'ceiling_camera/image_raw: no message' in last_message(health), 'the report of missing images'
    )
    graph.wait(lambda: robot.track() and last_message(health).startswith('tracking 15 features'), 'health')
    dark = np.full_like(ceiling(), 5)
    graph.wait(
        lambda: robot.track(dark) and 'the images are dark' in last_message(health),
        'the report of dark images',
    )
    graph.wait(lambda: robot.track() and last_message(health).startswith('tracking'), 'health again')
    small = np.zeros((240, 320), np.uint8)
    graph.wait(
        lambda: robot.publish(small) and 'cannot be used' in last_message(health),
        'the report of the wrong size',
    )
    assert 'an image is 320 x 240 pixels' in last_message(health)
    printed = graph.processes[0].output
    for text in (
        'ceiling_camera/image_raw: no message',
        'the images are dark',
        'an image is 320 x 240 pixels',
    ):
        assert text in printed, 'problems are logged, too'
    numbers = {item.key: item.value for item in health[-1].status[0].values}
    assert int(numbers['followed']) > 3 and float(numbers['latency_ms_p99']) > 0.0


def test_settings_can_be_changed_and_invalid_ones_are_refused(graph: Graph) -> None:
    robot = started(graph)
    assert len(robot.track().ids) == 15
    assert graph.set_parameter('tracker', 'tracker.features', 5).successful
    refused = graph.set_parameter('tracker', 'tracker.features', 0)
    assert not refused.successful and 'features' in refused.reason
    assert not graph.set_parameter('tracker', 'tracker.patch_px', 21).successful, (
        'it is only read at the start'
    )
    assert graph.get_parameters('tracker', 'tracker.features', 'tracker.patch_px') == [5, 15]


def test_two_robots_are_separate(graph: Graph) -> None:
    for name in ('one', 'two'):
        graph.start('tracker', namespace=name)
    robots = [Robot(graph, name) for name in ('one', 'two')]
    graph.wait(lambda: all(robot.has_subscribers() for robot in robots), 'the subscriptions of both trackers')
    assert len(robots[0].track().ids) == 15
    assert not robots[1].features
    assert len(robots[1].track().ids) == 15
