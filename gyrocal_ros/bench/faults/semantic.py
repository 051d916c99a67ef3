"""Sensors that are wrong while every message is valid: the calibration must be right, or not converged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any, Protocol, TypeAlias

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CameraIntrinsics,
    FeatureObservations,
    ImuSample,
    IntArray,
    Measurement,
    Rig,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S = 60.0
"""Length of the recordings; drifts end and jumps happen in relation to it."""
NO_SCALE = math.nan
"""True scale factor where no value is right, as for a mirrored image: such a run must not converge."""


@dataclass(frozen=True, slots=True)
class Moment:
    """Arguments of a change."""

    time_s: float
    """Time since the start."""
    size: float
    """Size of the fault."""
    random: np.random.Generator
    memory: dict[str, Any] = field(default_factory=dict)
    """Values that a change keeps from one sample to the next."""


RateChange: TypeAlias = Callable[[Array, Moment], Array]
"""Function from the true readings (3,) of gyro or accelerometer to the wrong ones."""
PixelChange: TypeAlias = Callable[[Array, Moment], Array]
"""Function from pixels (n, 2), relative to the principal point, to wrong ones."""


@dataclass(frozen=True, slots=True)
class SemanticFault:
    """One way in which sensors are wrong. All functions leave what is not concerned unchanged."""

    sizes: tuple[float, ...]
    rates: RateChange = lambda rate, at: rate
    forces: RateChange = lambda force, at: force
    pixels: PixelChange = lambda pixels, at: pixels
    ids: Callable[[IntArray, Moment], IntArray] = lambda ids, at: ids
    wheels: Callable[[float, float, Moment], tuple[float, float]] = lambda speed, turn, at: (speed, turn)
    imu_delay_s: Callable[[Moment], float] = lambda at: 0.0
    image_delay_s: Callable[[Moment], float] = lambda at: 0.0
    lost_imu: Callable[[Moment], bool] = lambda at: False
    lost_wheels: Callable[[Moment], bool] = lambda at: False
    lost_image: Callable[[Moment], bool] = lambda at: False
    rig: Callable[[Rig, float], Rig] = lambda rig, size: rig
    scale: Callable[[float], float] = lambda size: 1.0
    """Factor on the true scale factor at the end of the recording."""


def _camera(rig: Rig, change: Callable[[CameraIntrinsics], CameraIntrinsics]) -> Rig:
    assert rig.camera is not None
    return replace(rig, camera=change(rig.camera))


def _turned(rig: Rig, roll: float, pitch: float, yaw: float) -> Rig:
    R = rotation_from_euler(np.radians([roll, pitch, yaw]))
    return replace(rig, camera_mount=replace(rig.camera_mount, R_bs=R @ rig.camera_mount.R_bs))


def _stuck(rate: Array, at: Moment) -> Array:
    """Return a constant rate from half of the recording on, for `size` seconds."""
    return np.array([0.0, 0.0, 0.123]) if _is_faulty(at) else rate


def _elapsed(at: Moment) -> float:
    """Return the share of the recording that has passed."""
    return min(at.time_s / DURATION_S, 1.0)


def _since_half(at: Moment) -> float:
    return 1.0 if at.time_s > DURATION_S / 2.0 else 0.0


def _dead(rate: Array, at: Moment) -> Array:
    return np.where(np.abs(rate) < at.size, 0.0, rate)


def _low_passed(rate: Array, at: Moment) -> Array:
    """Return the rates (3,) behind a filter of first order with time constant `size`, at 200 Hz."""
    before: Array = at.memory.setdefault('rate', rate)
    passed = before + (rate - before) * (1.0 - math.exp(-0.005 / at.size))
    at.memory['rate'] = passed
    return passed


def _is_faulty(at: Moment) -> bool:
    """Return True for `size` seconds from the middle of the recording on."""
    return 0.0 <= at.time_s - DURATION_S / 2.0 < at.size


def _frozen(name: str, value: Any, at: Moment) -> Any:
    """Return the last value before the middle of the recording, from there on for `size` seconds."""
    if not _is_faulty(at):
        at.memory[name] = value
    return at.memory.setdefault(name, value)


def _old_picture(pixels: Array, at: Moment) -> Array:
    """Return the features of an earlier picture, with other noise."""
    old: Array = _frozen('pixels', pixels, at)
    return old + at.random.normal(0.0, 0.3, old.shape) if _is_faulty(at) else pixels


def _dust(pixels: Array, at: Moment) -> Array:
    """Return specks on the lens in the dark: they stay in the image."""
    if not _is_faulty(at):
        return pixels
    specks = np.random.default_rng(0).uniform(-200.0, 200.0, (100, 2))[: len(pixels)]
    return specks + at.random.normal(0.0, 0.1, specks.shape)


def _other_ids(ids: IntArray, at: Moment) -> IntArray:
    return 1_000_000 + np.arange(len(ids)) if _is_faulty(at) else ids


def _wandering(pixels: Array, at: Moment) -> Array:
    """Return features that wander, each by itself, as on water."""
    steps: Array = at.memory.setdefault('steps', np.zeros((100, 2)))
    if not _is_faulty(at):
        return pixels
    at.memory['steps'] = steps + at.random.normal(0.0, 4.0, steps.shape)
    return _dust(pixels, at) + steps[: len(pixels)]


def _is_paused(at: Moment) -> bool:
    """Return True for `size` seconds after a third of the recording."""
    return 0.0 <= at.time_s - DURATION_S / 3.0 < at.size


FAULTS: dict[str, SemanticFault] = {
    # --- gyro
    'gyro scale drifts': SemanticFault(
        (0.001, 0.003, 0.01),
        rates=lambda rate, at: rate / (1.0 + at.size * _elapsed(at)),
        scale=lambda size: 1.0 + size,
    ),
    'gyro scale jumps': SemanticFault(
        (0.005, 0.02, 0.05),
        rates=lambda rate, at: rate / (1.0 + at.size * _since_half(at)),
        scale=lambda size: 1.0 + size,
    ),
    'gyro bias jumps': SemanticFault(
        (0.005, 0.02, 0.1), rates=lambda rate, at: rate + at.size * _since_half(at)
    ),
    'gyro bias drifts': SemanticFault(
        (0.005, 0.02, 0.1), rates=lambda rate, at: rate + at.size * _elapsed(at)
    ),
    'gyro noise': SemanticFault(
        (0.005, 0.02, 0.05), rates=lambda rate, at: rate + at.random.normal(0.0, at.size, 3)
    ),
    'gyro outliers': SemanticFault(
        (0.5, 5.0, 30.0), rates=lambda rate, at: rate + (at.random.random() < 0.01) * at.size
    ),
    'gyro inverted': SemanticFault((1.0,), rates=lambda rate, at: -rate, scale=lambda size: NO_SCALE),
    'gyro axes exchanged': SemanticFault(
        (1.0, 2.0), rates=lambda rate, at: np.roll(rate, int(at.size)), scale=lambda size: NO_SCALE
    ),
    'gyro in deg/s': SemanticFault(
        (1.0,), rates=lambda rate, at: np.degrees(rate), scale=lambda size: math.radians(1.0)
    ),
    'gyro saturates': SemanticFault((0.3, 0.6, 1.0), rates=lambda rate, at: np.clip(rate, -at.size, at.size)),
    'gyro sticks': SemanticFault((2.0, 10.0, 90.0), rates=_stuck),
    'gyro dead band': SemanticFault((0.01, 0.05, 0.1), rates=_dead),
    'gyro cubic': SemanticFault(
        (0.01, 0.03, 0.1), rates=lambda rate, at: rate / (1.0 + at.size * rate**2), scale=lambda size: 1.0
    ),
    'gyro depends on the sign': SemanticFault(
        (0.002, 0.01, 0.03), rates=lambda rate, at: np.where(rate > 0.0, rate * (1.0 + at.size), rate)
    ),
    'gyro reads in steps': SemanticFault(
        (0.0005, 0.005, 0.03), rates=lambda rate, at: at.size * np.round(rate / at.size)
    ),
    'two gyros on one topic': SemanticFault(
        (0.002, 0.02, 0.2),
        rates=lambda rate, at: rate * (1.0 + at.size * (at.random.random() < 0.5)),
        scale=lambda size: 1.0 / (1.0 + 0.5 * size),
    ),
    'gyro low pass': SemanticFault((0.02, 0.1, 1.0), rates=_low_passed),
    'specific force in g': SemanticFault((9.81,), forces=lambda force, at: force / at.size),
    'specific force turned': SemanticFault((1.0, 2.0), forces=lambda force, at: np.roll(force, int(at.size))),
    # --- times
    'imu late': SemanticFault((0.01, 0.05, 0.2), imu_delay_s=lambda at: at.size),
    'imu stamps jitter': SemanticFault(
        (0.005, 0.02, 0.05), imu_delay_s=lambda at: at.random.normal(0.0, at.size)
    ),
    'imu clock drifts and jumps back': SemanticFault(
        (0.02, 0.06, 0.12), imu_delay_s=lambda at: at.size * (at.time_s / 3.0 % 1.0)
    ),
    'imu clock runs fast': SemanticFault((0.0005, 0.002, 0.01), imu_delay_s=lambda at: at.size * at.time_s),
    'images late': SemanticFault((-0.2, -0.03, 0.01, 0.05, 0.2), image_delay_s=lambda at: at.size),
    'image stamps jitter': SemanticFault(
        (0.005, 0.02, 0.05), image_delay_s=lambda at: at.random.normal(0.0, at.size)
    ),
    'imu lost': SemanticFault((0.1, 0.3, 0.7), lost_imu=lambda at: at.random.random() < at.size),
    'imu gaps': SemanticFault((0.3, 1.0, 3.0), lost_imu=lambda at: at.time_s % 10.0 < at.size),
    'images lost': SemanticFault((0.3, 0.7, 0.95), lost_image=lambda at: at.random.random() < at.size),
    'all sensors pause': SemanticFault(
        (1.5, 5.0, 20.0), lost_imu=_is_paused, lost_wheels=_is_paused, lost_image=_is_paused
    ),
    'imu pauses': SemanticFault((1.5, 5.0, 20.0), lost_imu=_is_paused),
    'camera dark': SemanticFault((3.0, 7.0, 9.0), lost_image=lambda at: at.time_s % 10.0 < at.size),
    # --- images
    'image mirrored': SemanticFault(
        (1.0,), pixels=lambda pixels, at: pixels * (-1.0, 1.0), scale=lambda size: NO_SCALE
    ),
    'image turned': SemanticFault(
        (5.0, 90.0, 180.0),
        pixels=lambda pixels, at: pixels @ rotation_from_euler(np.radians([0.0, 0.0, at.size]))[:2, :2],
    ),
    'image noise': SemanticFault(
        (0.5, 2.0, 8.0), pixels=lambda pixels, at: pixels + at.random.normal(0.0, at.size, pixels.shape)
    ),
    'image outliers': SemanticFault(
        (0.05, 0.2, 0.5),
        pixels=lambda pixels, at: (
            pixels
            + (at.random.random((len(pixels), 1)) < at.size) * at.random.normal(0.0, 40.0, pixels.shape)
        ),
    ),
    'image still': SemanticFault(
        (1.0,), pixels=lambda pixels, at: np.zeros_like(pixels) + np.arange(len(pixels))[:, None]
    ),
    'camera frozen': SemanticFault(
        (2.0, 20.0, 90.0),
        pixels=lambda pixels, at: _frozen('pixels', pixels, at),
        ids=lambda ids, at: _frozen('ids', ids, at),
    ),
    'old picture with new noise': SemanticFault(
        (2.0, 10.0),
        pixels=_old_picture,
        ids=lambda ids, at: _frozen('ids', ids, at),
    ),
    'dust in the dark': SemanticFault((2.0, 10.0), pixels=_dust, ids=_other_ids),
    'features wander': SemanticFault((2.0, 10.0), pixels=_wandering, ids=_other_ids),
    'ids exchanged for a while': SemanticFault(
        (2.0, 10.0), ids=lambda ids, at: at.random.permutation(ids) if _is_faulty(at) else ids
    ),
    'features without numbers': SemanticFault(
        (0.02, 0.5),
        pixels=lambda pixels, at: np.where(at.random.random((len(pixels), 1)) < at.size, math.nan, pixels),
    ),
    'ids exchanged': SemanticFault(
        (0.02, 0.1, 1.0),
        ids=lambda ids, at: at.random.permutation(ids) if at.random.random() < at.size else ids,
    ),
    'ids constant': SemanticFault((1.0,), ids=lambda ids, at: np.arange(len(ids))),
    # --- camera_info and mounting
    'focal length wrong': SemanticFault(
        (0.02, 0.1, 0.5),
        rig=lambda rig, size: _camera(
            rig,
            lambda camera: replace(camera, fx_px=camera.fx_px * (1 + size), fy_px=camera.fy_px * (1 + size)),
        ),
    ),
    'principal point wrong': SemanticFault(
        (10.0, 30.0, 100.0),
        rig=lambda rig, size: _camera(rig, lambda camera: replace(camera, cx_px=camera.cx_px + size)),
    ),
    'distortion wrong': SemanticFault(
        (0.01, 0.05, 0.2),
        rig=lambda rig, size: _camera(
            rig, lambda camera: replace(camera, distortion=(size, size, 0.0, 0.0, size), lens='plumb_bob')
        ),
    ),
    'camera tilted': SemanticFault((2.0, 5.0, 15.0), rig=lambda rig, size: _turned(rig, size, 0.0, 0.0)),
    'camera turned': SemanticFault((5.0, 45.0, 180.0), rig=lambda rig, size: _turned(rig, 0.0, 0.0, size)),
    # --- wheels
    'wheels scaled': SemanticFault((1.05, 1.3, 3.0), wheels=lambda speed, turn, at: (speed * at.size, turn)),
    'wheels inverted': SemanticFault((1.0,), wheels=lambda speed, turn, at: (-speed, -turn)),
    'one wheel inverted': SemanticFault(
        (0.25,), wheels=lambda speed, turn, at: (0.5 * at.size * turn, 2.0 * speed / at.size)
    ),
    'one wheel dead': SemanticFault(
        (0.25,),
        wheels=lambda speed, turn, at: (0.5 * speed + 0.25 * at.size * turn, speed / at.size + 0.5 * turn),
    ),
    'encoder overflows': SemanticFault(
        (30.0, 600.0),
        wheels=lambda speed, turn, at: (
            (speed - at.size, turn + 8.0 * at.size) if at.time_s % 7.0 < 0.02 else (speed, turn)
        ),
    ),
    'wheels stand': SemanticFault(
        (0.2, 0.5, 1.0),
        wheels=lambda speed, turn, at: (0.0, 0.0) if at.time_s % 10.0 < 10.0 * at.size else (speed, turn),
    ),
    'wheels turn wrongly': SemanticFault(
        (0.5, -1.0, 5.0), wheels=lambda speed, turn, at: (speed, turn * at.size)
    ),
}
"""The faults by name."""


class Sized(Protocol):
    """A fault of several sizes."""

    @property
    def sizes(self) -> tuple[float, ...]:
        """Sizes that are tried."""
        ...


def sized(faults: Mapping[str, Sized]) -> Iterator[tuple[str, float]]:
    """Yield name and size of every fault of a table."""
    for name, fault in faults.items():
        for size in fault.sizes:
            yield name, size


def write_faulty_recording(name: str, size: float, seed: int, folder: Path) -> tuple[Path, float]:
    """Simulate a recording, make one of its sensors wrong, and write it.

    Args:
        name: one of `FAULTS`; empty for a sound recording.
        size: its size.
        seed: seed of the simulation.
        folder: folder of the new bag.

    Returns:
        The bag, and the true scale factor at its end; NaN where no value is right.
    """
    source = SimSource(replace(find_scenario('cleaning'), duration_s=DURATION_S), seed)
    fault = FAULTS[name] if name else SemanticFault(())
    random = np.random.default_rng(Random(f'{name} {size} {seed}').getrandbits(64))
    start_ns, rig = source.span.start_ns, fault.rig(source.rig, size)
    with new_bag(folder / 'bag') as bag:
        bag.write_rig(rig, start_ns, R_bi=np.eye(3))
        for sample in _changed(source, fault, size, random):
            bag.write(sample)
    return folder / 'bag', source.truth.scale_factor * fault.scale(size)


def _changed(
    source: SimSource, fault: SemanticFault, size: float, random: np.random.Generator
) -> Iterator[Measurement]:
    memory: dict[str, Any] = {}
    for sample in source.measurements():
        time_s = (sample.t_ns - source.span.start_ns) / NS_PER_S
        changed = faulty(sample, fault, Moment(time_s, size, random, memory), source.rig)
        if changed is not None:
            yield changed


def faulty(sample: Measurement, fault: SemanticFault, at: Moment, rig: Rig) -> Measurement | None:
    """Return what a faulty sensor measures in place of a sample; None where it is lost."""
    assert rig.camera is not None
    if isinstance(sample, ImuSample):
        if fault.lost_imu(at):
            return None
        rates = fault.rates(np.array(sample.rate_rad_s), at)
        t_ns = sample.t_ns + nanoseconds(fault.imu_delay_s(at))
        force = fault.forces(np.array(sample.specific_force_m_s2), at)
        return ImuSample(t_ns, (rates[0], rates[1], rates[2]), (force[0], force[1], force[2]))
    if isinstance(sample, FeatureObservations):
        if fault.lost_image(at):
            return None
        center = np.array([rig.camera.cx_px, rig.camera.cy_px])
        pixels = center + fault.pixels(sample.pixels - center, at)
        t_ns = sample.t_ns + nanoseconds(fault.image_delay_s(at))
        return replace(sample, t_ns=t_ns, ids=fault.ids(sample.ids, at), pixels=pixels)
    if isinstance(sample, WheelSample):
        if fault.lost_wheels(at):
            return None
        return WheelSample(sample.t_ns, *fault.wheels(sample.speed_m_s, sample.yaw_rate_rad_s, at))
    return sample
