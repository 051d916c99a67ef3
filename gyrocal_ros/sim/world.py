"""A simulated recording: all measurements of a robot in one scenario with one seed."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CameraIntrinsics,
    CovariateSample,
    FeatureObservations,
    Frame,
    ImuSample,
    IntArray,
    Measurement,
    Mount,
    Rig,
    Span,
    TemperatureSample,
    TruthSample,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.model.camera import mount_from_yaw
from gyrocal_ros.sim.forward import (
    HiddenEffect,
    at_readings,
    between,
    ground_displacement,
    hidden_noise,
    nominal_yaw_rate,
    odometry_shortfall,
    readout_s,
    referred_to_means,
    stamp_error_s,
    true_camera,
)
from gyrocal_ros.sim.manoeuvres import plan_legs, repeated_legs
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.scene import Scene, draw_scene, project_corners, track_corners
from gyrocal_ros.sim.sensors import (
    Climate,
    Fan,
    covariates,
    draw_climate,
    draw_fan,
    gyro_bias,
    pixel_errors,
    read_accelerometer,
    read_covariate,
    read_gyro,
    read_temperature,
    read_wheels,
    stream,
    vibration,
    vibration_std,
)
from gyrocal_ros.sim.trajectory import Trajectory, rough_floor

if TYPE_CHECKING:
    from gyrocal_ros.sim.image_sequence import ImageSequence

START_NS = 1_700_000_000 * NS_PER_S
TEMPERATURE_HZ, COVARIATE_HZ = 1, 5
WHEEL_PHASE_S, CAMERA_PHASE_S, SLOW_PHASE_S = 0.003, 0.011, 0.017
"""Sampling phases: no two sensors of a real robot are sampled at the same time."""
SHUTTER_ITERATIONS = 4
"""A row decides when a pixel is exposed, and that by how much it has moved to other rows."""


@dataclass(frozen=True, slots=True, eq=False)
class SimTruth:
    """The truth known only to the simulator, for comparison in benches and tests."""

    trajectory: Trajectory
    scene: Scene
    climate: Climate
    fan: Fan
    scale_factor: float
    """True yaw rate over nominal yaw rate."""
    camera: CameraIntrinsics
    """True intrinsics; the rig has the nominal ones."""
    camera_mount: Mount
    ground_displacement_m: Array
    """(n, 3) displacement of the robot by the ground, at the times of the IMU."""
    bias_time_s: Array
    """(n,) seconds since the first sample."""
    bias_rad_s: Array
    """(n, 3) true bias at those times; the z component is without the hidden effects."""

    def position(self, time_s: Array) -> Array:
        """Return the true positions (n, 3) of the body in the world at times (n,)."""
        displacement = [
            np.interp(time_s, self.bias_time_s, column) for column in self.ground_displacement_m.T
        ]
        return self.trajectory.position(time_s) + np.stack(displacement, axis=1)


class SimSource:
    """A source of measurements simulated from a scenario and a seed.

    The same seed yields bit-identical measurements, however often and in whatever order `measurements`
    is called.

    Args:
        scenario: motion, environment and sensors.
        seed: seed of all randomness.
        images: yield images of the ceiling instead of tracked features.
        hidden: physical effects in the recording that its rig does not contain.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int = 0,
        *,
        images: bool = False,
        hidden: tuple[HiddenEffect, ...] = (),
    ) -> None:
        self.scenario, self.seed = scenario, seed
        self._images = images
        self._hidden = hidden

    @property
    def name(self) -> str:
        """Scenario and seed."""
        return f'{self.scenario.name}-{self.seed}'

    @cached_property
    def hidden(self) -> tuple[HiddenEffect, ...]:
        """The hidden effects; those of recorded signals count from the means of the signals."""
        if not self._hidden:
            return ()
        _, signals = self._true_covariates()
        return referred_to_means(
            self._hidden, {name: float(values.mean()) for name, values in signals.items()}
        )

    @property
    def rig(self) -> Rig:
        """Nominal camera and mounting."""
        scenario = self.scenario
        return Rig(scenario.camera, mount_from_yaw(*scenario.mount_xyz_m, scenario.mount_yaw_deg))

    @property
    def span(self) -> Span:
        """Interval from the first IMU sample to the end."""
        return Span(START_NS, START_NS + nanoseconds(self.scenario.duration_s))

    @cached_property
    def truth(self) -> SimTruth:
        """The truth of this recording."""
        scenario, rig = self.scenario, self.rig
        assert rig.camera is not None
        camera, mount = true_camera(rig.camera, rig.camera_mount, self.hidden)
        bias_s = _times(scenario.imu_hz, scenario.duration_s)
        return SimTruth(
            trajectory=self._trajectory,
            scene=draw_scene(
                stream(self.seed, 'scene'),
                scenario.room_m,
                scenario.mount_xyz_m[2],
                scenario.furniture,
                scenario.corners,
            ),
            climate=scenario.climate or draw_climate(stream(self.seed, 'climate')),
            fan=self._fan,
            scale_factor=scenario.errors.scale_factor,
            camera=camera,
            camera_mount=mount,
            ground_displacement_m=ground_displacement(between(self._trajectory.motion(bias_s)), self.hidden),
            bias_time_s=bias_s,
            bias_rad_s=gyro_bias(bias_s, scenario.errors, stream(self.seed, 'gyro bias')),
        )

    @cached_property
    def _trajectory(self) -> Trajectory:
        scenario = self.scenario
        rng = stream(self.seed, 'trajectory')
        if scenario.legs:
            legs, start = repeated_legs(scenario.legs, scenario.standing_s, scenario.duration_s)
        else:
            legs, start = plan_legs(
                scenario.stages, scenario.standing_s, scenario.duration_s, scenario.driving_style, rng
            )
        path_m = scenario.duration_s * scenario.driving_style.speed_m_s / 2.0
        floor = rough_floor(stream(self.seed, 'floor'), scenario.floor_tilt_deg, scenario.bumps, path_m)
        return Trajectory(legs, floor, start)

    @cached_property
    def _fan(self) -> Fan:
        scenario = self.scenario
        return scenario.fan or draw_fan(stream(self.seed, 'fan'), scenario.standing_s, scenario.duration_s)

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements in the order of their stamps."""
        parts = (
            self._imu(), self._wheels(), self._frames() if self._images else self._features(),
            self._temperature(), self._covariates(), self.truth_poses(),
        )  # fmt: skip
        return heapq.merge(*parts, key=attrgetter('t_ns'))

    def board_measurements(self) -> Iterator[Measurement]:
        """Yield the measurements of the IMU and encoder board, in the order of their stamps."""
        parts = (self._imu(), self._wheels(), self._temperature(), self._covariates())
        return heapq.merge(*parts, key=attrgetter('t_ns'))

    def image_sequence(self) -> ImageSequence:
        """Return the images that the camera takes at `image_times`."""
        from gyrocal_ros.sim.image_sequence import ImageSequence  # OpenCV is loaded only for images

        scenario, conditions = self.scenario, self.scenario.image_conditions
        return ImageSequence(
            self.truth.camera,
            scenario.ceiling,
            replace(conditions, readout_s=conditions.readout_s + readout_s(self.hidden)),
            scenario.furniture,
            self.seed,
            self.image_times(),
            self.camera_poses,
        )

    def camera_poses(self, time_s: Array) -> tuple[Array, Array]:
        """Return the true R_wc (n, 3, 3) and p_wc (n, 3) of the camera at times (n,)."""
        mount, R_wb = self.truth.camera_mount, self.truth.trajectory.motion(time_s).R_wb
        return R_wb @ mount.R_bs, self.truth.position(time_s) + R_wb @ mount.p_bs

    def _imu(self) -> Iterator[ImuSample]:
        scenario, truth = self.scenario, self.truth
        errors, hz, time_s = scenario.errors, scenario.imu_hz, truth.bias_time_s
        motion, fan_speed = truth.trajectory.motion(time_s), truth.fan.speed(time_s)
        vibration_m_s2 = vibration_std(motion, fan_speed, errors)
        force = motion.specific_force_m_s2 + vibration(vibration_m_s2, stream(self.seed, 'vibration'))
        rate = motion.rate_rad_s - truth.bias_rad_s
        block = replace(
            at_readings(motion),
            rate_rad_s=rate,
            specific_force_m_s2=force,
            vibration_m2_s4=3.0 * vibration_m_s2**2,
            temperature_c=truth.climate.temperature_c(time_s),
            covariates=covariates(motion, fan_speed),
            heading_rad=motion.euler_rad[:, 2],
            position_m=truth.position(time_s)[:, :2],
        )
        rate[:, :2] *= [1.0 + errors.x_scale_error, 1.0 + errors.y_scale_error]
        rate[:, 2] = nominal_yaw_rate(rate[:, 2], truth.scale_factor, block, self.hidden)
        rate[:, 2] += hidden_noise(block, self.hidden, stream(self.seed, 'hidden noise'))
        rates = read_gyro(rate, hz, errors, stream(self.seed, 'gyro'))
        forces = read_accelerometer(force, hz, errors, stream(self.seed, 'accelerometer'))
        yield from map(ImuSample, _stamps(time_s), map(tuple, rates.tolist()), map(tuple, forces.tolist()))

    def _wheels(self) -> Iterator[WheelSample]:
        scenario = self.scenario
        time_s = _times(scenario.wheel_hz, scenario.duration_s, WHEEL_PHASE_S)
        motion = self.truth.trajectory.motion(time_s)
        shortfall = odometry_shortfall(between(motion), self.hidden)
        rolled, yaw = motion.travelled_m - shortfall, motion.euler_rad[:, 2]
        distance, turned = read_wheels(rolled, yaw, scenario.errors, stream(self.seed, 'wheels'))
        hz = scenario.wheel_hz
        yield from map(WheelSample, _stamps(time_s[1:]), (distance * hz).tolist(), (turned * hz).tolist())

    def _features(self) -> Iterator[FeatureObservations]:
        scenario = self.scenario
        time_s = self.image_times()
        truth = self.truth
        pixels, seen = project_corners(truth.scene, truth.camera, *self.camera_poses(time_s))
        pixels += self._shutter_shift(time_s, pixels)
        pixels = pixels + pixel_errors(seen.shape, scenario.errors, stream(self.seed, 'pixels'))
        seen &= ~_random_losses(seen.shape, scenario, stream(self.seed, 'tracker'))
        tracks = track_corners(seen, time_s, scenario.features, scenario.reacquire_s)
        for t_ns, places, (ids, corners) in zip(self._image_stamps(), pixels, tracks, strict=True):
            yield FeatureObservations(t_ns, ids, places[corners])

    def _shutter_shift(self, time_s: Array, pixels: Array) -> Array:
        """Return by how much corners (n, m, 2) move until their rows are exposed.

        They move as a parabola in time through three projections, which leaves less than 0.01 px.
        """
        half_s = 0.5 * readout_s(self.hidden)
        if half_s == 0.0:
            return np.zeros(2)
        truth, shift = self.truth, np.zeros_like(pixels)
        before, after = (
            project_corners(truth.scene, truth.camera, *self.camera_poses(time_s + side * half_s))[0]
            for side in (-1.0, 1.0)
        )
        for _ in range(SHUTTER_ITERATIONS):
            part = 2.0 * ((pixels[..., 1:] + shift[..., 1:] + 0.5) / truth.camera.height_px - 0.5)
            shift = 0.5 * part * (after - before) + 0.5 * part**2 * (after + before - 2.0 * pixels)
        return shift

    def _frames(self) -> Iterator[Frame]:
        yield from map(Frame, self._image_stamps(), self.image_sequence())

    def _temperature(self) -> Iterator[TemperatureSample]:
        time_s = _times(TEMPERATURE_HZ, self.scenario.duration_s, SLOW_PHASE_S)
        rng = stream(self.seed, 'temperature')
        values = read_temperature(time_s, self.truth.climate, self.scenario.errors, rng)
        yield from map(TemperatureSample, _stamps(time_s), values.tolist())

    def _true_covariates(self) -> tuple[Array, dict[str, Array]]:
        time_s = _times(COVARIATE_HZ, self.scenario.duration_s, SLOW_PHASE_S)
        return time_s, covariates(self._trajectory.motion(time_s), self._fan.speed(time_s))

    def _covariates(self) -> Iterator[CovariateSample]:
        time_s, signals = self._true_covariates()
        errors = self.scenario.errors
        readings = {
            name: read_covariate(name, values, errors, stream(self.seed, name)).tolist()
            for name, values in signals.items()
        }
        for row, t_ns in enumerate(_stamps(time_s)):
            for name, values in readings.items():
                yield CovariateSample(t_ns, name, values[row])

    def truth_poses(self) -> Iterator[TruthSample]:
        """Yield the ground truth."""
        time_s = _times(self.scenario.truth_hz, self.scenario.duration_s)
        positions = map(tuple, self.truth.position(time_s).tolist())
        yaw = self.truth.trajectory.motion(time_s).euler_rad[:, 2].tolist()
        yield from map(TruthSample, _stamps(time_s), positions, yaw)

    def image_times(self) -> Array:
        """Return the middle of the exposure of each image, (n,) s since the start."""
        scenario = self.scenario
        return _times(scenario.camera_hz, min(scenario.duration_s, scenario.camera_until_s), CAMERA_PHASE_S)

    def _image_stamps(self) -> list[int]:
        return _stamps(self.image_times() + stamp_error_s(self.hidden))


def _times(rate_hz: int, duration_s: float, phase_s: float = 0.0) -> Array:
    """Return the sampling times (n,) of a sensor, rounded to nanoseconds."""
    count = int((duration_s - phase_s) * rate_hz + 1e-9) + 1
    return np.round((phase_s + np.arange(count) / rate_hz) * NS_PER_S) / NS_PER_S


def _stamps(time_s: Array) -> list[int]:
    stamps: IntArray = START_NS + np.round(time_s * NS_PER_S).astype(np.int64)
    return stamps.tolist()


def _random_losses(shape: tuple[int, int], scenario: Scenario, rng: np.random.Generator) -> np.ndarray:
    """Draw which corners (n, m) the tracker has lost at random."""
    starts = rng.random(shape) < scenario.track_loss
    length = rng.exponential(scenario.track_loss_s * scenario.camera_hz, shape)
    frame = np.arange(shape[0])[:, None]
    until = np.maximum.accumulate(np.where(starts, frame + length, -1.0), axis=0)
    return frame < until
