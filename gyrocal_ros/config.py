"""Settings, declared once: default, unit, bounds and meaning stand beside each other.

The YAML files, the ROS parameters and the dump that goes with every result all derive from the
dataclasses below. A settings file is a ROS 2 parameter file, so one file serves the nodes and
the command line.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from gyrocal_ros.errors import ConfigError

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class Setting:
    """What is known of one setting beside its value."""

    unit: str
    help: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()


def setting(
    default: T,
    unit: str,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> T:
    """Declare a dataclass field together with its unit, its bounds and what it means."""
    metadata = {'setting': Setting(unit, help, low, high, choices)}
    return field(default=default, metadata=metadata)  # type: ignore[return-value]


@dataclass(frozen=True, slots=True)
class GyroConfig:
    """The yaw gyro as its data sheet has it, and how far that is trusted."""

    nominal_scale_factor_volt: float = setting(
        146.4, 'deg/s/V', 'scale factor of the data sheet, already applied to the samples', low=1e-6, high=1e6
    )
    bias_prior_std_deg_s: float = setting(
        1.0, 'deg/s', 'how large the bias of each axis may be at the start (1 sigma)', low=1e-6, high=50.0
    )
    rate_noise_deg_s: float = setting(
        0.0075, 'deg/s/sqrt(Hz)', 'white noise of the rate, as a density', low=1e-5, high=1.0
    )
    bias_walk_deg_s: float = setting(
        2.5e-4,
        'deg/s/sqrt(s)',
        'random walk of the bias; set ten times too large it swallows warm-up and temperature',
        low=0.0,
        high=1.0,
    )
    gap_rate_std_deg_s: float = setting(
        40.0,
        'deg/s',
        'how fast the robot may turn, unseen, while IMU samples are missing',
        low=0.0,
        high=1000.0,
    )


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """How far the wheel encoders are trusted."""

    distance_noise_m: float = setting(
        0.005, 'm/sqrt(m)', 'random error of the distance travelled', low=1e-5, high=0.5
    )
    lateral_noise_m: float = setting(
        0.005, 'm/sqrt(m)', 'random sideways motion while travelling', low=1e-5, high=0.5
    )
    vertical_noise_m: float = setting(
        0.001, 'm/sqrt(m)', 'random vertical motion while travelling', low=1e-6, high=0.5
    )
    turn_noise_m: float = setting(
        0.002, 'm/sqrt(rad)', 'random motion of the turning centre while turning', low=0.0, high=0.5
    )


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """The ceiling camera's mounting (used where no transform says it) and its noise."""

    mount_x_m: float = setting(0.10, 'm', 'camera ahead of the turning centre', low=-5.0, high=5.0)
    mount_y_m: float = setting(0.0, 'm', 'camera left of the turning centre', low=-5.0, high=5.0)
    mount_z_m: float = setting(0.10, 'm', 'camera above base_link', low=-5.0, high=5.0)
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
        'noise of a recorded feature, each coordinate; the start of its estimation',
        low=0.005,
        high=20.0,
    )
    estimate_pixel_noise: bool = setting(True, '', 'follow the true pixel noise by the median innovation')


@dataclass(frozen=True, slots=True)
class FeatureConfig:
    """The landmarks on the ceiling."""

    parametrisation: str = setting(
        'inverse_depth',
        '',
        'inverse_depth: anchored, the default; camera_frame: the paper; pixel: conventional EKF',
        choices=('inverse_depth', 'camera_frame', 'pixel'),
    )
    prior_depth_m: float = setting(
        2.5, 'm', 'depth (inverse_depth) or range (other forms) at first sight', low=0.05, high=100.0
    )
    prior_inverse_depth_std: float = setting(
        0.3, '1/m', 'doubt of the inverse of that depth (inverse_depth)', low=1e-3, high=20.0
    )
    ray_std_m: float = setting(
        100.0,
        'm',
        'e_ct of eq. (19): doubt of the depth along the ray (camera_frame, pixel)',
        low=0.1,
        high=1e5,
    )
    calibration_noise_px: float = setting(
        0.0, 'px', 'e_cal of eq. (21): error of the camera calibration (camera_frame)', low=0.0, high=50.0
    )
    motion_gate_m: float = setting(
        0.03, 'm', 'camera_frame: no updates until the robot has moved so far', low=0.0, high=10.0
    )
    motion_gate_deg: float = setting(5.0, 'deg', 'camera_frame: or has turned so far', low=0.0, high=180.0)
    map_size: int = setting(30, '', 'features kept in the map, seen and unseen', low=3, high=1000)
    outlier_probability: float = setting(
        1e-4, '', 'chance that a good observation is thrown away as an outlier', low=1e-9, high=0.2
    )
    drop_after_rejections: int = setting(
        8, '', 'rejections in a row after which a feature is forgotten', low=1, high=1000
    )


@dataclass(frozen=True, slots=True)
class RestConfig:
    """When the robot counts as standing still, and how still that is."""

    settle_s: float = setting(
        0.3, 's', 'wheels quiet for so long before the zero-rate update is used', low=0.0, high=60.0
    )
    rotation_noise_deg: float = setting(
        0.005, 'deg', 'rotation between two frames that still counts as none (1 sigma)', low=1e-6, high=5.0
    )


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """Another heading reference in place of the ceiling camera."""

    heading_noise_deg: float = setting(
        0.5, 'deg', 'white noise of the reference heading', low=1e-4, high=90.0
    )
    heading_walk_deg: float = setting(
        0.02, 'deg/sqrt(s)', 'slow drift of the reference heading', low=0.0, high=10.0
    )


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """The feature tracker."""

    features: int = setting(15, '', 'features tracked at a time; the paper uses 5', low=1, high=500)
    patch_px: int = setting(15, 'px', 'side of a patch, odd', low=7, high=61)
    min_distance_px: float = setting(
        40.0, 'px', 'distance between features, so that they spread over the image', low=2.0, high=500.0
    )
    border_px: int = setting(14, 'px', 'no features closer to the edge of the image', low=2, high=200)
    detect_interval: int = setting(
        10, 'frames', 'look for new corners every so many frames, or when few are left', low=1, high=1000
    )
    corner_quality: float = setting(
        0.001, '', 'Harris response of a corner against the best in the image', low=1e-6, high=1.0
    )
    min_correlation: float = setting(
        0.8, '', 'normalised correlation below which a match is refused', low=-1.0, high=1.0
    )
    max_reprojection_px: float = setting(
        0.3, 'px', 'forward-backward error above which a match is refused', low=0.01, high=20.0
    )
    noise_px: float = setting(
        0.1, 'px', 'noise of a feature tracked here, the start of its estimation', low=0.005, high=20.0
    )
    reacquire_s: float = setting(
        20.0, 's', 'a lost feature is looked for so long before its id is dropped', low=0.0, high=3600.0
    )


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """Reading bags."""

    reorder_window_s: float = setting(
        1.0, 's', 'how late a message may be recorded and still be sorted in by its stamp', low=0.0, high=60.0
    )
    clock_step_s: float = setting(
        5.0, 's', 'a lasting jump of the stamps larger than this starts a new time base', low=0.1, high=1e6
    )
    use_images: bool = setting(False, '', 'track the images even where the bag holds features')
    remap: str = setting('', '', 'topics under other names: NAME:=TOPIC, several separated by blanks')
    heading_reference: str = setting('', '', 'topic to take the heading from, in place of the ceiling camera')


@dataclass(frozen=True, slots=True)
class ConvergenceConfig:
    """When the calibration counts as done."""

    scale_std: float = setting(
        5e-4, '1', 'standard deviation of the scale factor below which it has converged', low=1e-7, high=1.0
    )
    nis_low: float = setting(
        0.5, '', 'smallest NIS per degree of freedom of a healthy filter', low=0.0, high=1.0
    )
    nis_high: float = setting(
        3.0, '', 'largest NIS per degree of freedom of a healthy filter', low=1.0, high=100.0
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


def flat_settings(config: Config) -> Iterator[tuple[str, Any, Setting]]:
    """Yield name (`section.setting`), value and description of every setting, in order."""
    for section in fields(config):
        values = getattr(config, section.name)
        for item in fields(values):
            yield f'{section.name}.{item.name}', getattr(values, item.name), item.metadata['setting']


def to_dict(config: Config) -> dict[str, dict[str, Any]]:
    """Return the settings as nested plain values, as they are written beside every result."""
    return {
        section.name: {item.name: getattr(values, item.name) for item in fields(values)}
        for section in fields(config)
        for values in [getattr(config, section.name)]
    }


def to_yaml(config: Config) -> str:
    """The settings as a commented ROS 2 parameter file for any node; `load_config` reads it."""
    lines = ['/**:', '  ros__parameters:']
    section = ''
    for name, value, about in flat_settings(config):
        new_section, item = name.split('.')
        if new_section != section:
            section = new_section
            lines.append(f'    {section}:')
        bounds = '' if about.low is None else f', {about.low:g} to {about.high:g}'
        unit = f' [{about.unit}]' if about.unit else ''
        lines.append(f'      # {about.help}{unit}{bounds}')
        lines.append(f'      {item}: {yaml.safe_dump(value, width=math.inf).splitlines()[0]}')
    return '\n'.join(lines) + '\n'


def with_settings(config: Config, nested: Mapping[str, Any], where: str = 'settings') -> Config:
    """Return `config` with the given `{section: {setting: value}}` put in.

    Raises:
        ConfigError: a name is unknown, or a value has the wrong type or is out of bounds.
    """
    sections = {item.name: getattr(config, item.name) for item in fields(config)}
    for section_name, entries in nested.items():
        section = sections.get(_known(section_name, list(sections), where))
        if not isinstance(entries, Mapping):
            raise ConfigError(f'section {section_name!r} holds no settings', where=where)
        assert is_dataclass(section) and not isinstance(section, type)
        known = {item.name: item for item in fields(section)}
        values = {}
        for name, value in entries.items():
            item = known[_known(name, list(known), f'{where}, section {section_name}')]
            default = getattr(section, name)
            values[name] = _checked(f'{section_name}.{name}', value, default, item.metadata['setting'], where)
        sections[section_name] = replace(section, **values)
    return Config(**sections)


def load_config(path: Path | None) -> Config:
    """Read a ROS 2 parameter file; without one, return the defaults.

    Raises:
        ConfigError: the file cannot be read, or a setting in it is unknown or out of bounds.
    """
    config = Config()
    for node_name, node in read_yaml(path).items() if path else ():
        parameters = node.get('ros__parameters') if isinstance(node, Mapping) else None
        if not isinstance(parameters, Mapping):
            raise ConfigError(
                f'{node_name!r} has no ros__parameters', where=str(path), todo='write a ROS 2 parameter file'
            )
        config = with_settings(config, _estimator_settings(parameters), str(path))
    return config


def _estimator_settings(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The settings among the parameters of a node, which may also be written `section.setting`."""
    nested = {name: dict(value) for name, value in parameters.items() if isinstance(value, Mapping)}
    for name, value in parameters.items():
        section, _, item = str(name).partition('.')
        if item and hasattr(Config, section):
            nested.setdefault(section, {})[item] = value
    return nested


class YamlLoader(yaml.SafeLoader):
    """Takes `1e-3` for a number, as ROS does; PyYAML insists on `1.0e-3`."""


YamlLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?\d+[eE][-+]?\d+$'), list('-+0123456789')
)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises:
        ConfigError: there is no such file, or it is not YAML, or holds something else.
    """
    try:
        tree = yaml.load(path.read_text(encoding='utf-8'), YamlLoader)
    except OSError as error:
        raise ConfigError(
            f'cannot be read ({error.strerror})', where=str(path), todo='check the path'
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = str(error).replace('\n', ' ')
        raise ConfigError(f'is not valid YAML ({line})', where=str(path)) from error
    if not isinstance(tree, dict):
        raise ConfigError('holds no settings', where=str(path), todo='write `name: value` lines')
    return tree


def nearest(name: str, known: list[str]) -> str:
    """Return the known names that look like `name`, as words for an error message."""
    close = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    return f'did you mean {close[0]!r}?' if close else f'known are {", ".join(known)}'


def _known(name: str, known: list[str], where: str) -> str:
    if name not in known:
        raise ConfigError(f'{name!r} is not known', where=where, todo=nearest(name, known))
    return name


def _checked(name: str, value: Any, default: Any, about: Setting, where: str) -> Any:
    kind = type(default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise ConfigError(f'{name} must be a {kind.__name__}, not {value!r}', where=where)
    if about.choices and value not in about.choices:
        raise ConfigError(f'{name} is {value!r}', where=where, todo=f'choose from {", ".join(about.choices)}')
    if kind in (int, float):
        too_low = about.low is not None and value < about.low
        too_high = about.high is not None and value > about.high
        if too_low or too_high or not math.isfinite(value):
            raise ConfigError(
                f'{name} is {value}',
                where=where,
                todo=f'give {about.low} to {about.high} {about.unit}'.rstrip(),
            )
    return value
