"""Applies the calibration at once: the true rate of every IMU sample, and the present pose.

The filter lags by some tenths of a second, because it waits for late messages, and it may be stopped. From
its last trusted state, the pose is predicted here to the present by gyro and wheels.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CalibratedSample,
    CovariateSample,
    ImuSample,
    MotionBlock,
    OdometryEstimate,
    TemperatureSample,
    WheelSample,
    nanoseconds,
    seconds,
)
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.predict import FilterModel, predict, with_pose
from gyrocal_ros.ekf.motion import GAP_NS, MotionBuffer
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, EULER, POSE, YAW_BIAS, State
from gyrocal_ros.ekf.state.map_frame import pose_covariance
from gyrocal_ros.ekf.state.pauses import inflate_after_gap
from gyrocal_ros.ekf.stream import MAX_BLOCK_NS
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.planar import Pose, Three, step_pose
from gyrocal_ros.model.recording import SPEED_SIGNAL
from gyrocal_ros.model.sensor import Memory, SensorModel

MAX_JUMP_NS = NS_PER_S // 2
"""Largest jump of the stamps, to either side, that is integrated; a larger one is a gap or a clock step."""
SLACK_S = 1.0
"""Additional lag of the filter, beyond its usual maximum, at which its states are still accepted."""
MIN_VARIANCE = 1e-12
"""Lower bound of the variance of a speed (m^2/s^2), so that it is positive at rest."""


@dataclass(frozen=True, slots=True)
class _Step:
    """The motion between two IMU samples."""

    t_ns: int
    """Stamp of the later sample."""
    dt_s: float
    rate_rad_s: Three
    """Mean of the two calibrated rates."""


class DeadReckoning:
    """Dead reckoning with the calibration, one sample at a time in the order of arrival.

    Args:
        model: the sensor model.
        config: settings; may be replaced at any time.
        state: initial state, with the calibration, at pose zero.
        lag_s: usual maximum lag of the filter.
    """

    def __init__(self, model: SensorModel, config: Config, state: State, lag_s: float) -> None:
        self.config = config
        self.predicted = state
        """Last trusted state of the filter, predicted as far as both gyro and wheels have arrived."""
        self._model, self._effects = model, sort_effects(model.effects)
        self._max_lag_ns = nanoseconds(lag_s + SLACK_S)
        self._buffer = MotionBuffer()
        self._base, self._base_memories = state, self._effects.no_memories()
        self._memories = self._base_memories
        self._last: ImuSample | None = None
        self._rate, self._rate_variances = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
        self._wheels: WheelSample | None = None
        self._speed_m_s = self._wheel_rate_rad_s = 0.0
        self._temperature_c: Array = np.array([np.nan])
        self._vibration: Array = np.zeros(1)
        self._signals: dict[str, Array] = {}
        self._steps: deque[_Step] = deque()
        self._track: deque[tuple[int, Pose]] = deque()
        self._set_prediction(state)

    def imu(self, sample: ImuSample) -> CalibratedSample:
        """Take in one sample in body axes; return it calibrated."""
        elapsed_ns = 0 if self._last is None else sample.t_ns - self._last.t_ns
        if self._last is None or abs(elapsed_ns) > MAX_JUMP_NS:
            self._restart_at(sample.t_ns)
            elapsed_ns = 0
        self._buffer.add(sample)
        before = self._rate
        self._calibrate(sample, min(max(seconds(elapsed_ns), 1e-4), 0.1))
        if elapsed_ns > 0:
            (ax, ay, az), (bx, by, bz) = before, self._rate
            mean = (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
            self._integrate(_Step(sample.t_ns, seconds(elapsed_ns) if elapsed_ns <= GAP_NS else 0.0, mean))
        if elapsed_ns >= 0:
            self._last = sample
        if sample.t_ns - self.predicted.t_ns > 2 * MAX_BLOCK_NS:
            self._predict()
        return CalibratedSample(
            t_ns=sample.t_ns,
            rate_rad_s=self._rate,
            rate_variances=self._rate_variances,
            specific_force_m_s2=sample.specific_force_m_s2,
            euler_rad=self._track[-1][1][3:],
            euler_covariance=self.predicted.covariance[EULER, EULER],
        )

    def wheels(self, sample: WheelSample) -> OdometryEstimate | None:
        """Take in an encoder reading; return the pose at its stamp, None without recent IMU samples."""
        before, self._wheels = self._wheels, sample
        self._speed_m_s, self._wheel_rate_rad_s = sample.speed_m_s, sample.yaw_rate_rad_s
        self._signals[SPEED_SIGNAL] = np.array([sample.speed_m_s])
        if not self._is_near(sample.t_ns):
            return None
        self._buffer.add(sample)
        interval_s = seconds(sample.t_ns - before.t_ns) if before is not None else 0.1
        pose = self._pose_at(sample.t_ns)
        return OdometryEstimate(
            t_ns=sample.t_ns,
            position_m=pose[:3],
            euler_rad=pose[3:],
            pose_covariance=self.predicted.covariance[POSE, POSE]
            + pose_covariance(np.array(pose[:3]), pose[5], self.config.wheels),
            speed_m_s=sample.speed_m_s,
            speed_variances=self._speed_variances(min(max(interval_s, 1e-3), 1.0)),
            rate_rad_s=self._rate,
            rate_variances=self._rate_variances,
        )

    def add(self, sample: TemperatureSample | CovariateSample) -> None:
        """Take in a signal that effects may depend on."""
        if self._is_near(sample.t_ns):
            self._buffer.add(sample)
        if isinstance(sample, TemperatureSample):
            self._temperature_c = np.array([sample.temperature_c])
        else:
            self._signals[sample.name] = np.array([sample.value])

    def anchor(self, state: State, memories: Sequence[Memory]) -> bool:
        """Predict from a newer state of the filter; return False if it is of another time base or too old."""
        if self._last is None or not self._base.t_ns <= state.t_ns <= self._last.t_ns:
            return False
        if state.t_ns > self._base.t_ns:
            self._buffer.cut(self._base.t_ns, state.t_ns)
        self._base, self._base_memories = state, tuple(memories)
        self._predict()
        return True

    def recalibrate(self, state: State) -> None:
        """Use the calibration of another state from now on, and keep the pose."""
        base, size = self._base, state.robot_size
        mean, covariance = base.mean.copy(), base.covariance.copy()
        block = slice(BIAS.start, size)
        mean[block] = state.mean[block]
        covariance[block], covariance[:, block] = 0.0, 0.0
        covariance[block, block] = state.covariance[block, block]
        self._base = replace(base, mean=mean, covariance=covariance)
        self._predict()

    def _is_near(self, t_ns: int) -> bool:
        """Return True if a stamp is near that of the last IMU sample; other readings are not buffered."""
        return self._last is not None and abs(t_ns - self._last.t_ns) <= MAX_JUMP_NS

    def _speed_variances(self, interval_s: float) -> Three:
        """Return the variances (m^2/s^2) along body x, y, z: the distance noise of one encoder interval."""
        wheels, speed_m_s = self.config.wheels, abs(self._speed_m_s)
        slip = wheels.turn_noise_m**2 * abs(self._rate[2])
        x, y, z = (
            (noise**2 * speed_m_s + turning) / interval_s + MIN_VARIANCE
            for noise, turning in (
                (wheels.distance_noise_m, slip),
                (wheels.lateral_noise_m, slip),
                (wheels.vertical_noise_m, 0.0),
            )
        )
        return x, y, z

    def _calibrate(self, sample: ImuSample, dt_s: float) -> None:
        """Apply bias and effects to one sample."""
        state, gyro = self.predicted, self.config.gyro
        correction = correct(
            self._effects.gyro, self._block_of(sample, dt_s), state.coefficients, self._memories
        )
        self._memories = correction.memories
        validity = _single(correction.valid)
        x, y, z = sample.rate_rad_s
        bx, by, bz = state.bias_rad_s.tolist()
        self._rate = (x + bx, y + by, z + float(correction.rate_rad_s[0]) + validity * bz)
        white = math.radians(gyro.rate_noise_deg_s) ** 2 / dt_s
        gain = np.concatenate([[validity], correction.by_values[0]])
        yaw = float(gain @ self._yaw_covariance @ gain) + _single(correction.noise_rad_s) ** 2
        self._rate_variances = (white + self._x_variance, white + self._y_variance, white + yaw)

    def _block_of(self, sample: ImuSample, dt_s: float) -> MotionBlock:
        """Return a block of one interval that ends with a sample."""
        rate = np.array([sample.rate_rad_s])
        before = self._last.rate_rad_s[2] if self._last is not None else sample.rate_rad_s[2]
        dt = np.array([dt_s])
        return MotionBlock(
            start_ns=sample.t_ns - nanoseconds(dt_s),
            end_ns=sample.t_ns,
            time_s=np.array([self._buffer.running_s(sample.t_ns)]),
            dt_s=dt,
            rate_rad_s=rate,
            yaw_acceleration_rad_s2=(rate[:, 2] - before) / dt,
            specific_force_m_s2=np.array([sample.specific_force_m_s2]),
            vibration_m2_s4=self._vibration,
            distance_m=self._speed_m_s * dt,
            wheel_turn_rad=self._wheel_rate_rad_s * dt,
            temperature_c=self._temperature_c,
            covariates=self._signals,
            wheels_at_rest=self._speed_m_s == self._wheel_rate_rad_s == 0.0,
            heading_rad=np.array([self._track[-1][1][5]]),
            position_m=np.array([self._track[-1][1][:2]]),
            bias_rad_s=float(self.predicted.bias_rad_s[2]),
        )

    def _integrate(self, step: _Step) -> None:
        self._steps.append(step)
        pose = step_pose(self._track[-1][1], step.rate_rad_s, step.dt_s, self._speed_m_s)
        self._track.append((step.t_ns, pose))

    def _pose_at(self, t_ns: int) -> Pose:
        """Return the pose at a recent moment, linear between samples and for one gap beyond the last one."""
        later = len(self._track) - 1
        while later > 1 and self._track[later - 1][0] >= t_ns:
            later -= 1
        if later < 1:
            return self._track[-1][1]
        (t0_ns, first), (t1_ns, second) = self._track[later - 1], self._track[later]
        fraction = min((t_ns - t0_ns) / (t1_ns - t0_ns), 1.0 + GAP_NS / (t1_ns - t0_ns))
        x, y, z, roll, pitch, yaw = (a + fraction * (b - a) for a, b in zip(first, second, strict=True))
        return x, y, z, roll, pitch, yaw

    def _predict(self) -> None:
        """Predict the last trusted state as far as gyro and wheels have arrived, and integrate onwards."""
        covered_ns = self._buffer.covered_until_ns()
        if covered_ns is None:
            return
        while covered_ns - self._base.t_ns > self._max_lag_ns:
            end_ns = self._base.t_ns + MAX_BLOCK_NS
            self._base, self._base_memories = self._predicted(self._buffer.cut(self._base.t_ns, end_ns))
        state = self._base
        if covered_ns > state.t_ns:
            block = self._buffer.look(state.t_ns, covered_ns)
            self._vibration = block.vibration_m2_s4[-1:]
            state, _ = self._predicted(block)
        self._set_prediction(state)

    def _predicted(self, block: MotionBlock) -> tuple[State, tuple[Memory, ...]]:
        model = FilterModel(self._model, self._effects, self.config.gyro, self.config.wheels)
        state, transition = predict(self._base, with_pose(block, self._base), model, self._base_memories)
        return state, transition.contribution.correction.memories

    def _set_prediction(self, state: State) -> None:
        """Use the calibration of a predicted state, and integrate the pose from there to the present."""
        self.predicted = state
        yaw = [YAW_BIAS, *range(COEFFICIENTS_START, state.robot_size)]
        self._yaw_covariance = state.covariance[np.ix_(yaw, yaw)]
        self._x_variance, self._y_variance = np.diagonal(state.covariance)[BIAS][:2].tolist()
        while self._steps and self._steps[0].t_ns <= state.t_ns:
            self._steps.popleft()
        x, y, z, roll, pitch, heading = state.mean[POSE].tolist()
        pose: Pose = (x, y, z, roll, pitch, heading)
        self._track = deque([(state.t_ns, pose)])
        for step in self._steps:
            rest_s = min(step.dt_s, seconds(step.t_ns - self._track[-1][0]))
            pose = step_pose(pose, step.rate_rad_s, rest_s, self._speed_m_s)
            self._track.append((step.t_ns, pose))

    def _restart_at(self, t_ns: int) -> None:
        """Continue at the present pose with stamps of another time base."""
        has_started = self._base.t_ns > 0
        self._buffer = MotionBuffer(self._buffer.running_s(self._base.t_ns) if has_started else 0.0)
        mean = self.predicted.mean.copy()
        mean[POSE] = self._track[-1][1]
        state = replace(self.predicted, t_ns=t_ns, mean=mean)
        self._base = inflate_after_gap(state, t_ns) if has_started else state
        self._base_memories = self._memories
        self._last = None
        self._steps.clear()
        self._set_prediction(self._base)


def _single(value: Array | float) -> float:
    """Return a value of a block of one interval."""
    return float(value[0] if isinstance(value, np.ndarray) else value)
