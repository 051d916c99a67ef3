"""Messages of bags and of live nodes are converted to the values of `data`, and back."""

from __future__ import annotations

import math
from array import array
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from small_bags import CAMERA

from gyrocal_ros.bag.fields import field_reader
from gyrocal_ros.config.robot_sections import MessagesConfig
from gyrocal_ros.data import (
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    HeadingSample,
    ImuSample,
    Mount,
    SearchRegions,
    TemperatureSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import clouds, images, to_ros, topics
from gyrocal_ros.msgs.headings import heading_conversion
from gyrocal_ros.msgs.to_ros import MessageMaker, live_maker
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import (
    Transform,
    find_mount,
    quaternion_from_rotation,
    rotation_from_quaternion,
    upright_rotation,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
T_NS = 1_700_000_000_123_456_789


class LiveMessage(SimpleNamespace):
    """Imitation of a message of rclpy."""

    def get_fields_and_field_types(self) -> dict[str, str]:
        return dict.fromkeys(vars(self), '')


MAKERS = {
    'bag': MessageMaker(STORE.types.__getitem__),
    'live': live_maker(lambda name: LiveMessage),
}


@pytest.fixture(params=MAKERS)
def make(request: pytest.FixtureRequest) -> MessageMaker:
    return MAKERS[request.param]


def test_imu(make: MessageMaker) -> None:
    sample = ImuSample(T_NS, (0.1, -0.2, 0.3), (1.0, 2.0, 9.8))
    message = to_ros.imu(make, sample)
    assert topics.IMU_SAMPLE.value(message) == sample
    assert message.orientation_covariance[0] == -1.0
    np.testing.assert_allclose(message.angular_velocity_covariance[::4], math.radians(0.1) ** 2)
    np.testing.assert_allclose(message.linear_acceleration_covariance[::4], 0.05**2)


def test_an_imu_message_is_used_again(make: MessageMaker) -> None:
    first = ImuSample(T_NS, (0.1, -0.2, 0.3), (1.0, 2.0, 9.8))
    second = ImuSample(T_NS + 987_654_321, (0.4, 0.5, -0.6), (-1.0, -2.0, 9.7))
    message = to_ros.imu(make, first)
    to_ros.set_imu(message, second)
    assert topics.IMU_SAMPLE.value(message) == second
    assert message.header.frame_id == 'imu_link'
    assert message.orientation_covariance[0] == -1.0


def test_wheels(make: MessageMaker) -> None:
    sample = WheelSample(T_NS, 0.3, -0.4)
    message = to_ros.wheels(make, sample, 1.0, 2.0, 0.5)
    assert topics.WHEEL_SAMPLE.value(message) == sample
    assert (message.header.frame_id, message.child_frame_id) == ('odom', 'base_link')
    assert min(*message.pose.covariance[::7], *message.twist.covariance[::7]) > 0.0
    assert message.twist.covariance[0] == pytest.approx(0.02**2)
    own = MessagesConfig(imu_frame='gyro', odom_frame='r1/odom', base_frame='r1/base', distance_error=0.1)
    far = to_ros.wheels(make, sample, 1.0, 2.0, 0.5, travelled_m=100.0, config=own)
    assert (far.header.frame_id, far.child_frame_id) == ('r1/odom', 'r1/base')
    assert far.pose.covariance[0] == pytest.approx(10.0**2, rel=1e-3)


def test_temperature(make: MessageMaker) -> None:
    sample = TemperatureSample(T_NS, 31.5)
    assert topics.TEMPERATURE_SAMPLE.value(to_ros.temperature(make, sample)) == sample


@pytest.mark.parametrize('yaw_rad', [-3.0, -0.5, 0.0, 2.5])
def test_truth_and_heading(make: MessageMaker, yaw_rad: float) -> None:
    truth = to_ros.truth(make, TruthSample(T_NS, (1.0, 2.0, 3.0), yaw_rad))
    back = topics.truth_sample(topics.ODOMETRY).value(truth)
    assert (back.t_ns, back.position_m) == (T_NS, (1.0, 2.0, 3.0))
    assert back.yaw_rad == pytest.approx(yaw_rad)
    heading = to_ros.heading(make, HeadingSample(T_NS, yaw_rad))
    assert heading_conversion(topics.POSE_STAMPED).value(heading).yaw_rad == pytest.approx(yaw_rad)
    assert heading_conversion(topics.ODOMETRY).value(truth).yaw_rad == pytest.approx(yaw_rad)


def test_features(make: MessageMaker) -> None:
    seen = FeatureObservations(T_NS, np.array([3, 2**32 - 1]), np.array([[1.5, 2.5], [639.0, 0.25]]))
    back = clouds.features(to_ros.features(make, seen))
    assert back.t_ns == T_NS
    assert back.ids.dtype == np.int64
    np.testing.assert_array_equal(back.ids, seen.ids)
    np.testing.assert_array_equal(back.pixels, seen.pixels)


def test_features_with_covariances(make: MessageMaker) -> None:
    covariances = np.array([[[0.25, 0.125], [0.125, 0.5]], [[1.0, 0.0], [0.0, 1.0]]])
    seen = FeatureObservations(T_NS, np.array([3, 4]), np.array([[1.5, 2.5], [639.0, 0.25]]), covariances)
    back = clouds.features(to_ros.features(make, seen))
    np.testing.assert_array_equal(back.covariances_px2, covariances)
    assert clouds.features(to_ros.features(make, replace(seen, covariances_px2=None))).covariances_px2 is None


@pytest.mark.parametrize('bad', [np.nan, 0.0, -1.0], ids=['not a number', 'zero', 'negative'])
def test_covariances_that_are_none_are_ignored(make: MessageMaker, bad: float) -> None:
    covariances = np.array([[[bad, 0.0], [0.0, 0.5]], [[1.0, 0.0], [0.0, 1.0]]])
    seen = FeatureObservations(T_NS, np.array([3, 4]), np.ones((2, 2)), covariances)
    back = clouds.features(to_ros.features(make, seen))
    assert len(back.ids) == 2 and back.covariances_px2 is None


def test_an_image_without_features(make: MessageMaker) -> None:
    nothing = FeatureObservations(T_NS, np.zeros(0, np.int64), np.zeros((0, 2)))
    back = clouds.features(to_ros.features(make, nothing))
    assert (back.ids.shape, back.pixels.shape) == ((0,), (0, 2))


def test_search_regions(make: MessageMaker) -> None:
    covariances = np.array([[[4.0, 0.5], [0.5, 9.0]]])
    regions = SearchRegions(T_NS, np.array([7]), np.array([[1.0, 2.0]]), covariances)
    back = clouds.search_regions(to_ros.search_regions(make, regions))
    np.testing.assert_array_equal(back.covariances_px2, covariances)
    np.testing.assert_array_equal(back.pixels, regions.pixels)


@pytest.mark.parametrize('order', ['<', '>'])
def test_point_clouds_with_another_layout(order: str) -> None:
    formats = {'id': 'u4', 'z': 'f4', 'v': 'f8', 'u': 'f4'}
    kind = np.dtype(
        {
            'names': list(formats),
            'formats': [order + code for code in formats.values()],
            'offsets': [0, 4, 8, 20],
            'itemsize': 32,
        }
    )
    points = np.zeros(2, kind)
    points['id'], points['u'], points['v'] = [5, 6], [1.0, 2.0], [3.0, 4.0]
    types = {'id': 6, 'z': 7, 'v': 8, 'u': 7}
    layout = [
        LiveMessage(name=name, offset=offset, datatype=types[name], count=1)
        for name, offset in zip(formats, [0, 4, 8, 20], strict=True)
    ]
    cloud = LiveMessage(
        header=MAKERS['live'].header(T_NS, ''),
        height=1,
        width=2,
        fields=layout,
        is_bigendian=order == '>',
        point_step=32,
        data=array('B', points.tobytes()),
    )
    seen = clouds.features(cloud)
    np.testing.assert_array_equal(seen.ids, [5, 6])
    np.testing.assert_array_equal(seen.pixels, [[1.0, 3.0], [2.0, 4.0]])
    with pytest.raises(RecordingError, match='cov_uu'):
        clouds.search_regions(cloud)


LENSES = {
    'plumb_bob': CAMERA,
    'rational_polynomial': replace(
        CAMERA, lens='rational_polynomial', distortion=(0.4, 0.1, 1e-3, 2e-3, 0.01, 0.7, 0.2, 0.02)
    ),
    'equidistant': replace(CAMERA, lens='equidistant', distortion=(-0.02, 0.006, -0.004, 5e-4)),
}


@pytest.mark.parametrize('camera', LENSES.values(), ids=list(LENSES))
def test_camera_info(make: MessageMaker, camera: CameraIntrinsics) -> None:
    assert topics.camera_intrinsics(to_ros.camera_info(make, camera, T_NS)) == camera


def test_camera_info_without_a_usable_calibration() -> None:
    message = to_ros.camera_info(MAKERS['live'], CAMERA, T_NS)
    message.distortion_model = 'omnidirectional'
    with pytest.raises(RecordingError, match='omnidirectional'):
        topics.camera_intrinsics(message)
    message.distortion_model, message.d = 'plumb_bob', np.full(6, 0.01)
    with pytest.raises(RecordingError, match='6 coefficients'):
        topics.camera_intrinsics(message)
    message.k = np.zeros(9)
    with pytest.raises(RecordingError, match='not calibrated'):
        topics.camera_intrinsics(message)


@pytest.mark.parametrize('factor', [0.01, 1000.0])
def test_a_focal_length_of_other_images_is_refused(factor: float) -> None:
    message = to_ros.camera_info(MAKERS['live'], CAMERA, T_NS)
    message.k = message.k * np.array([factor, 1, 1, 1, 1, 1, 1, 1, 1])
    with pytest.raises(RecordingError, match='focal length'):
        topics.camera_intrinsics(message)


def test_camera_info_with_missing_or_zero_coefficients() -> None:
    message = to_ros.camera_info(MAKERS['live'], CAMERA, T_NS)
    message.distortion_model, message.d = 'plumb_bob', np.array([0.1, 0.0, 0.0, 0.0])
    assert topics.camera_intrinsics(message).distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    message.d = np.array([0.01, 0.01, 0.01])
    with pytest.raises(RecordingError, match='3 coefficients'):
        topics.camera_intrinsics(message)
    message.distortion_model, message.d = 'none', np.zeros(14)
    assert topics.camera_intrinsics(message).lens == 'plumb_bob'


def test_camera_info_of_a_part_of_the_sensor(make: MessageMaker) -> None:
    """Calibration and size are those of the whole sensor (sensor_msgs/CameraInfo)."""
    message = to_ros.camera_info(make, CameraIntrinsics(640, 480, 250.0, 260.0, 319.5, 239.5), T_NS)
    message.roi.x_offset, message.roi.y_offset, message.roi.width, message.roi.height = 100, 40, 400, 300
    assert topics.camera_intrinsics(message) == CameraIntrinsics(400, 300, 250.0, 260.0, 219.5, 199.5)
    message.binning_x = message.binning_y = 2
    halved = topics.camera_intrinsics(message)
    assert halved == CameraIntrinsics(200, 150, 125.0, 130.0, 109.5, 99.5)
    message.roi.width = 541
    with pytest.raises(RecordingError, match='region of interest'):
        topics.camera_intrinsics(message)


def test_static_transforms(make: MessageMaker) -> None:
    mount = Mount(rotation_from_quaternion(0.1, 0.2, -0.3, 0.9), np.array([0.1, 0.2, 0.3]))
    (link,) = topics.transforms(to_ros.static_transforms(make, {'camera': mount}, T_NS))
    assert (link.parent, link.child) == ('base_link', 'camera')
    np.testing.assert_allclose(link.mount.R_bs, mount.R_bs, atol=1e-15)
    np.testing.assert_array_equal(link.mount.p_bs, mount.p_bs)


def test_numeric_fields_of_messages(make: MessageMaker) -> None:
    battery = to_ros.battery(make, T_NS, {'current': -1.5})
    names = list(topics.numeric_fields(battery))
    states = ['power_supply_status', 'power_supply_health', 'power_supply_technology', 'present']
    assert names == [*to_ros.BATTERY_NUMBERS, *states]
    assert 'angular_velocity.z' in list(
        topics.numeric_fields(to_ros.imu(make, ImuSample(0, (0, 0, 0), (0, 0, 0))))
    )
    assert topics.covariate_name('/base/battery_state', 'current') == 'base.battery_state.current'


def test_images_are_not_read_field_by_field() -> None:
    with pytest.raises(ValueError, match='image_raw'):
        topics.field_conversion(Role.IMAGE, topics.IMAGE)


class TestChainsOfFrames:
    LINKS = (
        Transform(
            'base_link', 'mast', Mount(rotation_from_quaternion(0, 0, 1, 1), np.array([1.0, 0.0, 0.0]))
        ),
        Transform('mast', 'camera', Mount(rotation_from_quaternion(1, 0, 0, 0), np.array([0.0, 2.0, 0.0]))),
        Transform('footprint', 'base_link', Mount(np.eye(3), np.array([0.0, 0.0, 0.5]))),
        Transform('footprint', 'laser', Mount(np.eye(3), np.array([0.0, 0.0, 0.7]))),
    )

    def test_down_the_chain(self) -> None:
        mount = find_mount(self.LINKS, 'camera', 'base_link')
        assert mount
        np.testing.assert_allclose(mount.p_bs, [-1.0, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(mount.R_bs @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0], atol=1e-15)

    def test_over_a_common_parent(self) -> None:
        mount = find_mount(self.LINKS, 'laser', 'base_link')
        assert mount
        np.testing.assert_allclose(mount.p_bs, [0.0, 0.0, 0.2], atol=1e-15)

    def test_no_chain(self) -> None:
        assert find_mount(self.LINKS, 'sonar', 'base_link') is None

    def test_a_cycle_of_frames_terminates(self) -> None:
        cycle = [
            Transform('a', 'b', Mount(np.eye(3), np.zeros(3))),
            Transform('b', 'a', Mount(np.eye(3), np.zeros(3))),
        ]
        assert find_mount(cycle, 'a', 'base_link') is None


@pytest.mark.parametrize('seed', range(10))
def test_rotation_matrices_and_quaternions(seed: int) -> None:
    quaternion = np.random.default_rng(seed).standard_normal(4)
    rotation = rotation_from_quaternion(*quaternion)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    back = np.array(quaternion_from_rotation(rotation))
    np.testing.assert_allclose(abs(back @ quaternion), np.linalg.norm(quaternion))


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_every_orientation_of_an_imu_is_made_upright(axis: int, sign: float) -> None:
    force = np.array([0.3, -0.4, 0.5])
    force[axis] = sign * 9.8
    rotation = upright_rotation(force)
    assert rotation
    assert (rotation.R_bs @ force)[2] == pytest.approx(9.8)
    assert np.linalg.det(rotation.R_bs) == pytest.approx(1.0)


def test_a_tilted_imu_has_no_upright_rotation() -> None:
    assert upright_rotation(np.array([5.7, 5.7, 5.6])) is None
    assert upright_rotation(np.zeros(3)) is None


# --- reading a few fields ------------------------------------------------------------------------


def random_value(kind: Any, details: Any, rng: np.random.Generator) -> Any:
    if kind == Nodetype.NAME:
        return random_message(details, rng)
    if kind == Nodetype.BASE:
        if details[0] == 'string':
            return 'x' * int(rng.integers(0, 9))
        if details[0] == 'bool':
            return bool(rng.integers(2))
        if details[0].startswith('float'):
            return float(np.float32(rng.standard_normal()))
        return int(rng.integers(0, 100))
    (item_kind, item_about), length = details
    length = length if kind == Nodetype.ARRAY else int(rng.integers(0, 4))
    values = [random_value(item_kind, item_about, rng) for _ in range(length)]
    if item_kind == Nodetype.NAME or item_about[0] == 'string':
        return values
    return np.array(values, {'byte': 'int8', 'char': 'uint8'}.get(item_about[0], item_about[0]))


def random_message(type_name: str, rng: np.random.Generator) -> Any:
    values = [random_value(kind, details, rng) for _, (kind, details) in STORE.fielddefs[type_name][1]]
    return STORE.types[type_name](*values)


FLAT_TYPES = [
    'sensor_msgs/msg/Imu',
    'nav_msgs/msg/Odometry',
    'sensor_msgs/msg/BatteryState',
    'sensor_msgs/msg/CameraInfo',
    'sensor_msgs/msg/Image',
    'sensor_msgs/msg/NavSatFix',
    'sensor_msgs/msg/Range',
    'sensor_msgs/msg/LaserScan',
    'sensor_msgs/msg/MultiDOFJointState',
    'std_msgs/msg/Float64',
    'std_msgs/msg/Int8MultiArray',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'diagnostic_msgs/msg/DiagnosticArray',
    'trajectory_msgs/msg/JointTrajectoryPoint',
    'actionlib_msgs/msg/GoalStatus',
]


@pytest.mark.parametrize('type_name', FLAT_TYPES)
@pytest.mark.parametrize('wire', ['cdr', 'cdr big-endian', 'ros1'])
def test_selected_fields_equal_those_of_the_decoded_message(type_name: str, wire: str) -> None:
    rng = np.random.default_rng(len(type_name))
    for _ in range(20):
        message = random_message(type_name, rng)
        paths = list(all_numbers(message))
        if wire == 'ros1':
            raw = STORE.serialize_ros1(message, type_name)
        else:
            raw = STORE.serialize_cdr(message, type_name, little_endian=wire == 'cdr')
        wanted = [path for path in paths if rng.random() < 0.7] or paths[-1:]
        if wanted:
            read = field_reader(STORE, type_name, wanted, cdr=wire != 'ros1')
            assert read(bytes(raw)) == tuple(value_at(message, path) for path in wanted)


def all_numbers(message: Any, prefix: str = '') -> list[str]:
    paths = []
    for item in fields(message):
        value = getattr(message, item.name)
        if isinstance(value, bool | int | float):
            paths.append(prefix + item.name)
        elif hasattr(value, '__dataclass_fields__'):
            paths += all_numbers(value, f'{prefix}{item.name}.')
    return paths


def value_at(message: Any, path: str) -> Any:
    for name in path.split('.'):
        message = getattr(message, name)
    return message


# --- images --------------------------------------------------------------------------------------

GREY = (np.arange(48)[:, None] * 2 + np.arange(64)[None, :] * 2).astype(np.uint8)


def raw_image(encoding: str, pixels: np.ndarray, padding: int = 0, **more: Any) -> LiveMessage:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    values = {'is_bigendian': 0, 'step': rows.shape[1]} | more
    return LiveMessage(
        header=MAKERS['live'].header(T_NS, ''),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        data=array('B', rows.tobytes()),
        **values,
    )


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('encoding', ['mono8', '8UC1', 'bgr8', 'rgb8', 'bgra8', 'rgba8'])
def test_grey_pixels_are_unchanged(encoding: str, padding: int) -> None:
    channels = {'8': 1, 'mono8': 1, '8UC1': 1, 'bgr8': 3, 'rgb8': 3}.get(encoding, 4)
    pixels = GREY if channels == 1 else np.repeat(GREY[:, :, None], channels, axis=2)
    frame = images.frame(raw_image(encoding, pixels, padding))
    assert frame.t_ns == T_NS
    np.testing.assert_array_equal(frame.image, GREY)


def test_red_and_blue_are_not_confused() -> None:
    red = np.zeros((4, 4, 3), np.uint8)
    red[:, :, 0] = 200
    assert images.frame(raw_image('rgb8', red)).image[0, 0] == pytest.approx(0.299 * 200, abs=1)
    assert images.frame(raw_image('bgr8', red)).image[0, 0] == pytest.approx(0.114 * 200, abs=1)


@pytest.mark.parametrize('encoding', ['bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8', 'bayer_grbg8'])
def test_bayer_patterns(encoding: str) -> None:
    pattern = encoding[6:10]
    mosaic = np.zeros((8, 8), np.uint8)
    for index, colour in enumerate(pattern):
        mosaic[index // 2 :: 2, index % 2 :: 2] = 200 if colour == 'r' else 0
    assert images.frame(raw_image(encoding, mosaic)).image[4, 4] == pytest.approx(0.299 * 200, abs=2)


@pytest.mark.parametrize('big_endian', [0, 1])
def test_sixteen_bits(big_endian: int) -> None:
    pixels = (GREY.astype(np.uint16) << 8).astype('>u2' if big_endian else '<u2')
    np.testing.assert_array_equal(
        images.frame(raw_image('mono16', pixels, is_bigendian=big_endian)).image, GREY
    )


def test_luminance_of_yuv() -> None:
    yuyv = np.stack([GREY, np.full_like(GREY, 128)], axis=2)
    np.testing.assert_array_equal(images.frame(raw_image('yuv422_yuy2', yuyv)).image, GREY)
    np.testing.assert_array_equal(images.frame(raw_image('uyvy', yuyv[:, :, ::-1])).image, GREY)


def test_the_format_of_compressed_images_is_detected_from_their_content(make: MessageMaker) -> None:
    jpeg, png = (images.compressed_image(make, Frame(T_NS, GREY), quality) for quality in (95, None))
    assert bytes(jpeg.data[:2]) == b'\xff\xd8' and bytes(png.data[1:4]) == b'PNG'
    jpeg.format, png.format = 'png', 'mono8; jpeg compressed'
    np.testing.assert_array_equal(images.frame(png).image, GREY)
    assert np.abs(images.frame(jpeg).image.astype(int) - GREY).max() < 12


def test_image_round_trip(make: MessageMaker) -> None:
    np.testing.assert_array_equal(images.frame(images.grey_image(make, Frame(T_NS, GREY))).image, GREY)


def test_images_that_cannot_be_decoded() -> None:
    with pytest.raises(RecordingError, match='32FC1'):
        images.frame(raw_image('32FC1', GREY))
    with pytest.raises(RecordingError, match='64x99'):
        images.frame(raw_image('mono8', GREY).__class__(**vars(raw_image('mono8', GREY)) | {'height': 99}))
    with pytest.raises(RecordingError, match='cannot be decoded'):
        images.frame(
            LiveMessage(header=MAKERS['live'].header(T_NS, ''), format='jpeg', data=array('B', b'\xff\xd8no'))
        )


def test_battery_fields_that_are_not_given_are_nan() -> None:
    assert math.isnan(to_ros.battery(MAKERS['bag'], T_NS, {'current': 1.0}).voltage)
