"""Sketch of an effect: its contribution against the quantity that it depends on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, nanoseconds
from gyrocal_ros.effects.base import LibraryEffect, with_unit
from gyrocal_ros.effects.describe import place_of
from gyrocal_ros.effects.traits import required_signals
from gyrocal_ros.model.camera import mount_from_yaw, project
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import CameraEffectOnOdometry, GyroEffectOnReadings

COUNT = 401
MAX_LINES = 7
TURNING_RAD_S = np.radians(60.0)
"""Yaw rate at which effects on the scale factor are shown."""
CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 319.5, 239.5)
MOUNT = mount_from_yaw(0.09, 0.0, 0.10, -90.0)
CEILING_M = 2.4
TURNING = ', turning at 60 deg/s'
ROW_PX = 400.0
"""Row of the image whose pixels are shown."""


@dataclass(frozen=True, slots=True, eq=False)
class Sketch:
    """Some curves over one axis."""

    x_label: str
    y_label: str
    x: Array
    """(n,)"""
    lines: Mapping[str, Array]
    """Name to (n,)."""


def sketch(effect: LibraryEffect, shown: Sequence[tuple[float, ...]] | None = None) -> Sketch:
    """Draw an effect, one curve for each set of values of its coefficients.

    Args:
        effect: an effect of the library or of the user.
        shown: sets of values; with None, each coefficient that is a strength has its example value in turn,
            the first `MAX_LINES` of them.
    """
    every = list(_examples(effect))[:MAX_LINES] if shown is None else list(shown)
    if place_of(effect) == 'camera':
        return _shift_of_pixels(effect, every)
    if effect.acts_on == 'noise':
        return _heading_by_noise(effect, every)
    if effect.acts_on == 'shutter':
        return _shear(effect, every)
    if effect.acts_on == 'time':
        rate_deg_s = np.linspace(-100.0, 100.0, COUNT)
        label = 'shift of a pixel 200 px from the centre (px)'
        lines = {_named(effect, values): 200.0 * np.radians(rate_deg_s) * values[0] for values in every}
        return Sketch('yaw rate (deg/s)', label, rate_deg_s, lines)
    x_label, x, block = _STIMULI[effect.about.shown_against](effect)
    if isinstance(effect, GyroEffectOnReadings):
        true = block.rate_rad_s[:, 2]
        lines = {'true': np.degrees(true)} | {
            f'read, {_named(effect, values)}': np.degrees(
                effect.readings(true, block.dt_s, np.array(values), 1.0)
            )
            for values in every
        }
        return Sketch(x_label, 'yaw rate (deg/s)', x, lines)
    return Sketch(
        x_label,
        _Y_LABELS[place_of(effect)],
        x,
        {_named(effect, values): _added(effect, block, np.array(values)) for values in every},
    )


_Y_LABELS = {
    'gyro': 'added to the yaw rate (deg/s)',
    'wheels': 'added to the distance (mm)',
    'ground': 'carried along (mm)',
}


def _shear(effect: Any, every: Sequence[tuple[float, ...]]) -> Sketch:
    """Return the shift of a pixel half-way to the last row, in the middle of the row."""
    rate_deg_s = np.linspace(-100.0, 100.0, COUNT)
    distance_px = 0.25 * CAMERA.height_px
    lines = {
        _named(effect, values): distance_px
        * np.radians(rate_deg_s)
        * 0.25
        * effect.readout_s(np.array(values))[0]
        for values in every
    }
    label = f'shift of a pixel {distance_px:.0f} px below the centre (px)'
    return Sketch('yaw rate (deg/s)', label, rate_deg_s, lines)


def motion_of_sketch(effect: LibraryEffect) -> MotionBlock:
    """Return the motion that a sketch of a gyro effect shows."""
    return _STIMULI[effect.about.shown_against](effect)[2]


def _heading_by_noise(effect: Any, every: Sequence[tuple[float, ...]]) -> Sketch:
    """Return the standard deviation of the heading by noise alone, over time."""
    x = np.linspace(0.0, 60.0, COUNT)
    lines = {}
    for values in every:
        density = effect.density(np.full(COUNT, TURNING_RAD_S), np.array(values))
        variance = density**2 * x + effect.bias_walk(np.array(values)) ** 2 * x**3 / 3.0
        lines[_named(effect, values)] = np.degrees(np.sqrt(variance))
    return Sketch(f'time (s){TURNING}', 'standard deviation of the heading (deg)', x, lines)


def _examples(effect: LibraryEffect) -> Iterator[tuple[float, ...]]:
    """Yield the example values with one strength at a time, the other strengths at zero."""
    example = effect.about.example
    strengths = [i for i, item in enumerate(effect.coefficients) if item.prior_mean == 0.0]
    for strength in strengths:
        yield tuple(0.0 if i in strengths and i != strength else value for i, value in enumerate(example))


def _named(effect: LibraryEffect, values: tuple[float, ...]) -> str:
    named = zip(effect.coefficients, values, strict=True)
    return ', '.join(f'{item.name} = {with_unit(value, item.unit, 3)}' for item, value in named if value)


def _added(effect: Any, block: MotionBlock, values: Array) -> Array:
    if effect.acts_on == 'gyro':
        # Learned effects take the mean of the force over a block, so each point is a block of its own.
        whole = effect.about.shown_against != 'force'
        parts = [block] if whole else [block.part(slice(i, i + 1)) for i in range(len(block.dt_s))]
        added = [effect.contribute(part, values, None).rate_rad_s for part in parts]
        return np.degrees(np.concatenate(added))
    if isinstance(effect, CameraEffectOnOdometry):
        return 1e3 * (block.distance_m - effect.odometry(block.distance_m, values))
    if effect.acts_on == 'wheels':
        return 1e3 * effect.contribute(block, values)[0]
    carried = [effect.contribute(block.part(slice(i, i + 1)), values)[0] for i in range(len(block.dt_s))]
    return 1e3 * np.linalg.norm(carried, axis=1)


def _shift_of_pixels(effect: Any, every: Sequence[tuple[float, ...]]) -> Sketch:
    """Return the distance of the pixels of one row between the true camera and the assumed one."""
    u = np.linspace(0.0, CAMERA.width_px - 1.0, COUNT)
    across = np.array(
        [(u - CAMERA.cx_px) / CAMERA.fx_px, np.full(COUNT, (ROW_PX - CAMERA.cy_px) / CAMERA.fy_px)]
    )
    points_b = CEILING_M * np.append(across, np.ones((1, COUNT)), axis=0).T @ MOUNT.R_bs.T + MOUNT.p_bs
    lines = {}
    for values in every:
        camera, mount = effect.corrected(CAMERA, MOUNT, np.array(values))
        moved = project(camera, (points_b - mount.p_bs) @ mount.R_bs) - np.column_stack(
            [u, np.full(COUNT, ROW_PX)]
        )
        lines[_named(effect, values)] = np.linalg.norm(moved, axis=1)
    return Sketch(f'column of the image, in row {ROW_PX:.0f} (px)', 'shift of the pixel (px)', u, lines)


# --- stimuli: label and values of the quantity that varies, and the motion ------------------------


def _rate(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(-100.0, 100.0, COUNT)
    return 'yaw rate (deg/s)', x, _block(yaw_rate_rad_s=np.radians(x))


def _slow_rate(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(-1.0, 1.0, COUNT)
    return 'yaw rate (deg/s)', x, _block(yaw_rate_rad_s=np.radians(x))


def _turn(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    """Return a quarter turn to the left, with enough time to show what follows."""
    duration_s = 3.0 if isinstance(effect, GyroEffectOnReadings) else 60.0
    x = np.linspace(0.0, duration_s, 10 * COUNT)
    rate = np.interp(x, [0.5, 0.7, 2.0, 2.2], [0.0, TURNING_RAD_S, TURNING_RAD_S, 0.0])
    dt_s = np.gradient(x)
    return 'time (s)', x, _block(yaw_rate_rad_s=rate, dt_s=dt_s, wheel_turn_rad=rate * dt_s)


def _time(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(0.0, 1200.0, COUNT)
    return f'time since the first sample (s){TURNING}', x, _turning(time_s=x, dt_s=np.gradient(x))


def _temperature(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(10.0, 50.0, COUNT)
    return f'temperature (deg C){TURNING}', x, _turning(temperature_c=x)


def _force(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(-2.0, 2.0, COUNT)
    return (
        f'acceleration along the axis (m/s^2){TURNING}',
        x,
        _turning(specific_force_m_s2=np.column_stack([x, x, x])),
    )


def _roll(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(-20.0, 20.0, COUNT)
    rates = np.column_stack([np.radians(x), np.radians(x), np.zeros(COUNT)])
    return 'roll or pitch rate (deg/s)', x, _block(rate_rad_s=rates)


def _vibration(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(0.0, 0.3, COUNT)
    return f'variance of the specific force ((m/s^2)^2){TURNING}', x, _turning(vibration_m2_s4=x)


def _distance(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(0.0, 10.0, COUNT)
    return 'distance travelled (m)', x, _block(distance_m=x)


def _heading(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(-180.0, 180.0, COUNT)
    return 'heading (deg)', x, _turning(heading_rad=np.radians(x))


def _place(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    x = np.linspace(0.0, 1.0, COUNT)
    return 'way along the diagonal of the first square metre', x, _block(position_m=np.column_stack([x, x]))


def _signal(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    (signal,) = required_signals(effect)
    x = np.linspace(-2.0, 2.0, COUNT)
    return f'{signal} less its mean{TURNING}', x, _turning(covariates={signal: x})


def _event(effect: LibraryEffect) -> tuple[str, Array, MotionBlock]:
    """Return a signal that is high, low and high, beyond any value."""
    (signal,) = required_signals(effect)
    x = np.linspace(0.0, 60.0, COUNT)
    high = np.where((x > 5.0) & (x < 30.0), -np.inf, np.inf)
    recorded = {'temperature_c': high} if signal == TEMPERATURE else {'covariates': {signal: high}}
    label = f'time, with a fall of {signal} at 5 s and a rise at 30 s (s){TURNING}'
    return label, x, _turning(dt_s=np.gradient(x), **recorded)


_STIMULI: dict[str, Callable[[LibraryEffect], tuple[str, Array, MotionBlock]]] = {
    'rate': _rate,
    'slow rate': _slow_rate,
    'turn': _turn,
    'time': _time,
    'temperature': _temperature,
    'force': _force,
    'roll': _roll,
    'vibration': _vibration,
    'distance': _distance,
    'heading': _heading,
    'place': _place,
    'signal': _signal,
    'event': _event,
}


def _turning(**columns: Any) -> MotionBlock:
    return _block(yaw_rate_rad_s=np.full(COUNT, TURNING_RAD_S), **columns)


def _block(*, yaw_rate_rad_s: Array | None = None, **columns: Any) -> MotionBlock:
    """Return a block at rest except for the given columns; its intervals are one second long."""
    given = [*(item for item in columns.values() if isinstance(item, np.ndarray)), yaw_rate_rad_s]
    count = len(next(item for item in given if item is not None))
    rest: dict[str, Any] = {
        item.name: np.zeros(count) for item in fields(MotionBlock) if item.type == 'Array'
    }
    rates = np.zeros((count, 3))
    if yaw_rate_rad_s is not None:
        rates[:, 2] = yaw_rate_rad_s
    rest |= {'dt_s': np.ones(count), 'rate_rad_s': rates, 'specific_force_m_s2': np.zeros((count, 3))}
    block = MotionBlock(start_ns=0, end_ns=nanoseconds(count), **{**rest, **columns})
    acceleration = np.gradient(block.rate_rad_s[:, 2]) / block.dt_s
    return replace(block, yaw_acceleration_rad_s2=acceleration)
