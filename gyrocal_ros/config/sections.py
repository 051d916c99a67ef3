"""Settings of the estimator: default, unit, bounds and description, declared once.

A settings file is a ROS 2 parameter file, so that one file serves the nodes and the command line.
"""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.config.declare import setting


@dataclass(frozen=True, slots=True)
class GyroConfig:
    """Nominal values of the yaw gyro from its data sheet, and their uncertainty."""

    nominal_scale_factor_volt: float = setting(
        146.4, 'deg/s/V', 'scale factor of the data sheet, already applied to the samples', low=1e-6, high=1e6
    )
    bias_prior_std_deg_s: float = setting(
        1.0, 'deg/s', 'prior standard deviation of the bias of each axis at the start', low=1e-6, high=50.0
    )
    rate_noise_deg_s: float = setting(
        0.0075, 'deg/s/sqrt(Hz)', 'white noise density of the rate', low=1e-5, high=1.0, live=True
    )
    bias_walk_deg_s: float = setting(
        2.5e-4,
        'deg/s/sqrt(s)',
        'random walk of the bias; ten times larger it would absorb warm-up and temperature',
        low=0.0,
        high=1.0,
        live=True,
    )
    tilt_scale_std: float = setting(
        0.1,
        '1',
        'standard deviation of the scale factors of the x and y gyros, which are not estimated: over a door '
        'sill they miss a part of the tilt; about twice the tolerance, since several images in a row miss '
        'the same part',
        low=0.0,
        high=1.0,
        live=True,
    )
    scale_walk: float = setting(
        1e-6,
        '1/sqrt(s)',
        'random walk of the scale factor, also while the robot is off: 0.006 % in an hour, 0.6 % in a year, '
        'about what data sheets of MEMS gyros give for the lifetime',
        low=0.0,
        high=0.1,
        live=True,
    )
    scale_turn_on_std: float = setting(
        2e-4,
        '1',
        'standard deviation of the change of the scale factor from one start to the next',
        low=0.0,
        high=1.0,
    )
    scale_temperature_std: float = setting(
        1e-4,
        '1/K',
        'standard deviation of the dependence of the scale factor on temperature, for the time between an '
        'earlier calibration and the start; data sheets give 1 % over 100 K',
        low=0.0,
        high=0.1,
    )
    gap_rate_std_deg_s: float = setting(
        40.0, 'deg/s', 'standard deviation of the yaw rate in gaps of the IMU', low=0.0, high=1e3, live=True
    )


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Noise of the wheel odometry."""

    distance_noise_m: float = setting(
        0.005, 'm/sqrt(m)', 'random error of the distance travelled', low=1e-5, high=0.5, live=True
    )
    lateral_noise_m: float = setting(
        0.005, 'm/sqrt(m)', 'random sideways motion while travelling', low=1e-5, high=0.5, live=True
    )
    vertical_noise_m: float = setting(
        0.001, 'm/sqrt(m)', 'random vertical motion while travelling', low=1e-6, high=0.5, live=True
    )
    turn_noise_m: float = setting(
        0.002,
        'm/sqrt(rad)',
        'random motion of the turning centre while turning',
        low=0.0,
        high=0.5,
        live=True,
    )
    scale_std: float = setting(
        0.005,
        '1',
        'standard deviation of the error of all distances, from which the map has its scale; only for the '
        'published covariances of pose and map',
        low=0.0,
        high=0.5,
        live=True,
    )
    floor_tilt_deg: float = setting(
        0.1,
        'deg',
        'standard deviation of the slope of the floor at the start, about each axis; a usual tolerance is '
        '4 mm over 1 m, 0.2 deg; only for the published covariances of pose and map',
        low=0.0,
        high=10.0,
        live=True,
    )


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """Mounting of the ceiling camera (used if no transform is available) and its noise."""

    mount_x_m: float = setting(
        0.10, 'm', 'position of the camera ahead of the turning centre', low=-5.0, high=5.0
    )
    mount_y_m: float = setting(
        0.0, 'm', 'position of the camera to the left of the turning centre', low=-5.0, high=5.0
    )
    mount_z_m: float = setting(0.10, 'm', 'height of the camera above base_link', low=-5.0, high=5.0)
    mount_yaw_deg: float = setting(
        -90.0,
        'deg',
        'yaw of the image x axis in base_link; -90: image right is robot right',
        low=-360.0,
        high=360.0,
    )
    pixel_noise_px: float = setting(
        0.4,
        'px',
        'noise of a recorded feature in each coordinate; initial value of its estimate',
        low=0.005,
        high=20.0,
    )
    estimate_pixel_noise: bool = setting(
        True, '', 'estimate the pixel noise from the median innovation', live=True
    )


@dataclass(frozen=True, slots=True)
class FeatureConfig:
    """Landmarks on the ceiling."""

    parametrisation: str = setting(
        'inverse_depth',
        '',
        'inverse_depth: anchored, the default; camera_frame: the paper; pixel: conventional EKF',
        choices=('inverse_depth', 'camera_frame', 'pixel'),
    )
    prior_depth_m: float = setting(
        2.5, 'm', 'prior depth (inverse_depth) or range (other forms) of a new feature', low=0.05, high=100.0
    )
    prior_inverse_depth_std: float = setting(
        0.3, '1/m', 'prior standard deviation of the inverse depth (inverse_depth)', low=1e-3, high=20.0
    )
    ray_std_m: float = setting(
        100.0,
        'm',
        'e_ct of eq. (19): standard deviation of the depth along the ray (camera_frame, pixel)',
        low=0.1,
        high=1e5,
    )
    calibration_noise_px: float = setting(
        0.0, 'px', 'e_cal of eq. (21): error of the camera calibration (camera_frame)', low=0.0, high=50.0
    )
    motion_gate_m: float = setting(
        0.03,
        'm',
        'camera_frame: no updates until the robot has moved this far',
        low=0.0,
        high=10.0,
        live=True,
    )
    motion_gate_deg: float = setting(
        5.0, 'deg', 'camera_frame: or has turned this far', low=0.0, high=180.0, live=True
    )
    map_size: int = setting(30, '', 'features kept in the map, visible or not', low=3, high=1000, live=True)
    outlier_probability: float = setting(
        1e-4,
        '',
        'probability that a good observation is rejected as an outlier',
        low=1e-9,
        high=0.2,
        live=True,
    )
    drop_after_rejections: int = setting(
        8, '', 'consecutive rejections after which a feature is dropped', low=1, high=1000, live=True
    )


@dataclass(frozen=True, slots=True)
class RestConfig:
    """Detection of rest and the noise of the zero-rate update."""

    settle_s: float = setting(
        0.3, 's', 'rest of the wheels before the zero-rate update is used', low=0.0, high=60.0, live=True
    )
    rotation_noise_deg: float = setting(
        0.005,
        'deg',
        'standard deviation of the rotation between two frames at rest',
        low=1e-6,
        high=5.0,
        live=True,
    )
    rate_noise_deg_s: float = setting(
        0.0075,
        'deg/s/sqrt(Hz)',
        'white noise density of the yaw rate at rest, sway included, beside a heading reference; that of a '
        'recording is measured, and a robot learns it',
        low=1e-6,
        high=100.0,
    )


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """An external heading reference instead of the ceiling camera."""

    estimate_noise: bool = setting(False, '', 'learn noise and time offset while running, as on the robot')
    heading_noise_deg: float = setting(
        0.5, 'deg', 'white noise of the reference heading', low=1e-4, high=90.0
    )
    heading_walk_deg: float = setting(
        0.02, 'deg/sqrt(s)', 'random walk of the reference heading', low=0.0, high=10.0, live=True
    )
    tail_dof: float = setting(
        6.0, '', 'Student t degrees of freedom of heading errors; few for many outliers', low=1.0, high=1e3
    )
    stamp_noise_s: float = setting(
        0.0, 's', 'standard deviation of the stamps of the reference headings', low=0.0, high=1.0
    )


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """Feature tracker."""

    features: int = setting(
        15, '', 'features tracked at a time; the paper uses 5', low=1, high=500, live=True
    )
    patch_px: int = setting(15, 'px', 'side of a patch, odd', low=7, high=61)
    min_distance_px: float = setting(
        40.0,
        'px',
        'minimum distance between features, to distribute them over the image',
        low=2.0,
        high=500.0,
        live=True,
    )
    border_px: int = setting(
        14, 'px', 'minimum distance of features from the edge of the image', low=2, high=200
    )
    detect_interval: int = setting(
        10,
        'frames',
        'frames between detections of new corners, earlier if few features are left',
        low=1,
        high=1000,
        live=True,
    )
    corner_quality: float = setting(
        0.001,
        '',
        'minimum Harris response of a corner relative to the best in the image',
        low=1e-6,
        high=1.0,
        live=True,
    )
    min_correlation: float = setting(
        0.8, '', 'normalised correlation below which a match is rejected', low=-1.0, high=1.0, live=True
    )
    max_reprojection_px: float = setting(
        0.3, 'px', 'forward-backward error above which a match is rejected', low=0.01, high=20.0, live=True
    )
    noise_px: float = setting(
        0.1, 'px', 'noise of a feature of this tracker; initial value of its estimate', low=0.005, high=20.0
    )
    reacquire_s: float = setting(
        20.0,
        's',
        'time for which a lost feature is searched for before its id is dropped',
        low=0.0,
        high=3600.0,
        live=True,
    )


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """Reading of bags."""

    reorder_window_s: float = setting(
        1.0,
        's',
        'largest delay of a recorded message that can still be sorted by its stamp',
        low=0.0,
        high=60.0,
    )
    clock_step_s: float = setting(
        5.0, 's', 'a persistent jump of the stamps larger than this starts a new time base', low=0.1, high=1e6
    )
    use_images: bool = setting(False, '', 'track the images even if the bag contains features')
    remap: str = setting('', '', 'renamed topics: NAME:=TOPIC, several separated by blanks')
    heading_reference: str = setting(
        '', '', 'topic of a heading reference, used instead of the ceiling camera'
    )


@dataclass(frozen=True, slots=True)
class ConvergenceConfig:
    """Criteria for a finished calibration."""

    scale_std: float = setting(
        5e-4,
        '1',
        'standard deviation of the scale factor below which it has converged',
        low=1e-7,
        high=1.0,
        live=True,
    )
    heading_scale_std: float = setting(
        5e-3, '1', 'the same with a heading reference in place of the camera', low=1e-7, high=1.0
    )
    nis_low: float = setting(
        0.5,
        '',
        'smallest NIS per degree of freedom of a healthy filter, as long as it learns the noise',
        low=0.0,
        high=1.0,
        live=True,
    )
    nis_high: float = setting(
        3.0, '', 'largest NIS per degree of freedom of a healthy filter', low=1.0, high=100.0, live=True
    )


@dataclass(frozen=True, slots=True)
class Config:
    """All settings of the estimator."""

    gyro: GyroConfig = GyroConfig()
    wheels: WheelConfig = WheelConfig()
    camera: CameraConfig = CameraConfig()
    features: FeatureConfig = FeatureConfig()
    rest: RestConfig = RestConfig()
    reference: ReferenceConfig = ReferenceConfig()
    tracker: TrackerConfig = TrackerConfig()
    recording: RecordingConfig = RecordingConfig()
    convergence: ConvergenceConfig = ConvergenceConfig()
