"""Settings that only the nodes need: board, driver, image input and the live calibrator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from gyrocal_ros.config.board_limits import BoardLimits
from gyrocal_ros.config.declare import setting
from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import STANDARD_GRAVITY_M_S2

Triple: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """Meaning of one count of each converter."""

    gyro_volt: float = setting(1e-5, 'V/count', 'gyro voltage of one count', low=1e-12, high=10.0)
    gyro_scale_factor_volt: Triple = setting(
        (GyroConfig().nominal_scale_factor_volt,) * 3,
        'deg/s/V',
        'scale factor of the data sheet, about x, y and z; negative for an axis mounted in reverse',
        low=-1e6,
        high=1e6,
    )
    gyro_zero: Triple = setting(
        (0.0, 0.0, 0.0), 'count', 'nominal bias: counts of the gyros at rest', low=-(2.0**31), high=2.0**31
    )
    accelerometer_scale: Triple = setting(
        (4.0 * STANDARD_GRAVITY_M_S2 / 2**15,) * 3,
        'm/s^2/count',
        'specific force of one count, along x, y and z; 16 bits over +-4 g',
        low=-100.0,
        high=100.0,
    )
    accelerometer_zero: Triple = setting(
        (0.0, 0.0, 0.0), 'count', 'counts of the accelerometers at zero force', low=-(2.0**15), high=2.0**15
    )
    temperature_scale: float = setting(
        0.01, 'deg C/count', 'temperature of one count', low=-100.0, high=100.0
    )
    temperature_zero_c: float = setting(0.0, 'deg C', 'temperature at 0 counts', low=-273.15, high=1000.0)
    tick_m: float = setting(3e-4, 'm', 'distance of a wheel from one tick to the next', low=1e-7, high=1.0)
    track_m: float = setting(0.23, 'm', 'distance between the wheels', low=0.01, high=10.0)


@dataclass(frozen=True, slots=True)
class DriverConfig:
    """Serial line to the board."""

    port: str = setting('/dev/ttyACM0', '', 'serial port of the board')
    baud_rate: int = setting(
        115200,
        'Bd',
        'speed of the line; 4000000 for a board that is itself a USB device, without a serial wire',
        low=1200,
        high=4_000_000,
    )
    imu_hz: int = setting(200, 'Hz', 'requested rate of the IMU messages', low=1, high=2000, live=True)
    wheels_hz: int = setting(50, 'Hz', 'requested rate of the wheel messages', low=1, high=1000, live=True)
    supply_hz: int = setting(
        10, 'Hz', 'requested rate of the supply messages, 0 for none', low=0, high=100, live=True
    )
    publish_odom_transform: bool = setting(
        False, '', 'publish odom to base_link; only if nothing else on the robot does'
    )


@dataclass(frozen=True, slots=True)
class MessagesConfig:
    """Frames and covariances of the messages of the driver."""

    imu_frame: str = setting('imu_link', '', 'frame of the IMU')
    odom_frame: str = setting('odom', '', 'frame in which the wheel odometry starts at the origin')
    base_frame: str = setting('base_link', '', 'frame of the robot body')
    rate_std_deg_s: float = setting(
        0.1, 'deg/s', 'standard deviation of one reading of the gyro', low=1e-6, high=100.0
    )
    acceleration_std_m_s2: float = setting(
        0.05, 'm/s^2', 'standard deviation of one reading of the accelerometer', low=1e-6, high=100.0
    )
    speed_std_m_s: float = setting(
        0.02, 'm/s', 'standard deviation of the speed by the wheels', low=1e-6, high=10.0
    )
    turn_rate_std_deg_s: float = setting(
        3.0, 'deg/s', 'standard deviation of the turning rate by the wheels', low=1e-6, high=1000.0
    )
    distance_error: float = setting(
        0.02, '', 'error of the pose by the wheels, as a fraction of the distance', low=0.0, high=1.0
    )
    turn_error: float = setting(
        0.05, '', 'error of the heading by the wheels, as a fraction of the turn', low=0.0, high=1.0
    )
    unmeasured_std: float = setting(
        0.01, 'm, rad, m/s', 'standard deviation of height, tilt and sideways motion', low=1e-6, high=10.0
    )


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """The calibrator on the robot."""

    model: str = setting('', '', 'model.yaml with the effects to estimate; empty for the default one')
    effects_from: str = setting('', '', 'Python file with your own effects that the model contains')
    calibration: str = setting('', '', 'calibration.yaml to load at the start and to save; empty for none')
    estimate: bool = setting(True, '', 'start estimating at once, not only on request')
    reorder_window_s: float = setting(
        0.6, 's', 'largest delay of a message that can still be sorted by its stamp', low=0.01, high=10.0
    )
    heading_reference: str = setting(
        '', '', 'heading used in place of the camera: TOPIC, TOPIC.field or tf:PARENT:CHILD'
    )
    save_interval_s: float = setting(
        60.0, 's', 'interval between saves of the calibration', low=1.0, high=86400.0, live=True
    )
    publish_map_transform: bool = setting(True, '', 'publish map to odom; never with a heading reference')

    @property
    def publishes_map(self) -> bool:
        """True if map to odom is published; with a heading reference the navigation does that."""
        return self.publish_map_transform and not self.heading_reference


@dataclass(frozen=True, slots=True)
class ImagesConfig:
    """Image input of the tracker."""

    transport: str = setting(
        'auto',
        '',
        'images to track; auto: raw ones, or compressed ones if no raw ones are published',
        choices=('auto', 'raw', 'compressed'),
    )
    patience_s: float = setting(
        0.01,
        's',
        'timeout of an image waiting for the IMU to reach its stamp and for the search regions; the wait '
        'delays the features',
        low=0.0,
        high=1.0,
        live=True,
    )


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """Settings that only the nodes need."""

    board: BoardConfig = BoardConfig()
    board_limits: BoardLimits = BoardLimits()
    driver: DriverConfig = DriverConfig()
    messages: MessagesConfig = MessagesConfig()
    images: ImagesConfig = ImagesConfig()
    live: LiveConfig = LiveConfig()
