"""The calibration applied at once: true rates for every IMU sample, and the pose carried on to now.

The filter is some tenths of a second behind, for it waits for those that are late, and it may stand
still altogether. From its last good state the robot is carried on here by gyro and wheels.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

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
from gyrocal_ros.ekf.effects_by_place import sort_effects
from gyrocal_ros.ekf.motion import GAP_NS, SPEED_SIGNAL, MotionBuffer
from gyrocal_ros.ekf.predict import predict
from gyrocal_ros.ekf.slam import MAX_BLOCK_NS
from gyrocal_ros.ekf.start import inflate_after_gap
from gyrocal_ros.ekf.state import BIAS, COEFFICIENTS_START, EULER, POSE, YAW_BIAS, State
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.sensor import Memory, SensorModel

Three: TypeAlias = tuple[float, float, float]
Pose: TypeAlias = tuple[float, float, float, float, float, float]
"""Position (m) and Euler angles (rad)."""

LEAP_NS = NS_PER_S // 2
"""Stamps that leap by more, to either side, are not reckoned over: a gap, or another time base."""
SLACK_S = 1.0
"""How much later than it should the filter may come and still be carried on from."""
SMALLEST_VARIANCE = 1e-12
"""Of a speed (m^2/s^2): a robot at rest is not infinitely so."""


@dataclass(frozen=True, slots=True)
class _Step:
    """What the IMU measured between two samples."""

    t_ns: int
    """Of the later one."""
    dt_s: float
    rate_rad_s: Three
    """Mean of the two, calibrated."""


class DeadReckoning:
    """Dead reckoning with the calibration, a sample at a time, in the order of arrival.

    Args:
        model: the sensor model.
        config: settings; may be exchanged for others at any time.
        state: with the calibration, at pose zero.
        lag_s: how far the filter is behind at most.
    """

    def __init__(self, model: SensorModel, config: Config, state: State, lag_s: float) -> None:
        self.config = config
        self.ahead = state
        """The last good state of the filter, predicted to where gyro and wheels are known."""
        self._model, self._parts = model, sort_effects(model.effects)
        self._kept_ns = nanoseconds(lag_s + SLACK_S)
        self._buffer = MotionBuffer()
        self._base, self._base_memories = state, self._parts.no_memories()
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
        self._use(state)

    def imu(self, sample: ImuSample) -> CalibratedSample:
        """Take one sample in body axes and return what it should have been."""
        gone_ns = 0 if self._last is None else sample.t_ns - self._last.t_ns
        if self._last is None or abs(gone_ns) > LEAP_NS:
            self._begin_time_base(sample.t_ns)
            gone_ns = 0
        self._buffer.add(sample)
        mean = self._rate
        self._calibrate(sample, min(max(seconds(gone_ns), 1e-4), 0.1))
        if gone_ns > 0:
            (ax, ay, az), (bx, by, bz) = mean, self._rate
            middle = (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
            self._go_on(_Step(sample.t_ns, seconds(gone_ns) if gone_ns <= GAP_NS else 0.0, middle))
        if gone_ns >= 0:
            self._last = sample
        if sample.t_ns - self.ahead.t_ns > 2 * MAX_BLOCK_NS:
            self._look_ahead()
        return CalibratedSample(
            t_ns=sample.t_ns,
            rate_rad_s=self._rate,
            rate_variances=self._rate_variances,
            specific_force_m_s2=sample.specific_force_m_s2,
            euler_rad=self._track[-1][1][3:],
            euler_covariance=self.ahead.covariance[EULER, EULER],
        )

    def wheels(self, sample: WheelSample) -> OdometryEstimate | None:
        """Take one reading of the encoders and return where the robot was then; None without an IMU."""
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
            pose_covariance=self.ahead.covariance[POSE, POSE],
            speed_m_s=sample.speed_m_s,
            speed_variances=self._speed_variances(min(max(interval_s, 1e-3), 1.0)),
            rate_rad_s=self._rate,
            rate_variances=self._rate_variances,
        )

    def add(self, sample: TemperatureSample | CovariateSample) -> None:
        """Take in what effects may follow."""
        if self._is_near(sample.t_ns):
            self._buffer.add(sample)
        if isinstance(sample, TemperatureSample):
            self._temperature_c = np.array([sample.temperature_c])
        else:
            self._signals[sample.name] = np.array([sample.value])

    def anchor(self, state: State, memories: Sequence[Memory]) -> bool:
        """Carry on from a newer state of the filter; False where it is of another time base or too old."""
        if self._last is None or not self._base.t_ns <= state.t_ns <= self._last.t_ns:
            return False
        if state.t_ns > self._base.t_ns:
            self._buffer.cut(self._base.t_ns, state.t_ns)
        self._base, self._base_memories = state, tuple(memories)
        self._look_ahead()
        return True

    def recalibrate(self, state: State) -> None:
        """Use the calibration in another state from now on; the pose stays."""
        own, size = self._base, state.robot_size
        mean, covariance = own.mean.copy(), own.covariance.copy()
        place = slice(BIAS.start, size)
        mean[place] = state.mean[place]
        covariance[place], covariance[:, place] = 0.0, 0.0
        covariance[place, place] = state.covariance[place, place]
        self._base = replace(own, mean=mean, covariance=covariance)
        self._look_ahead()

    def _is_near(self, t_ns: int) -> bool:
        """Whether a stamp fits those of the IMU; what comes while that is silent is not kept."""
        return self._last is not None and abs(t_ns - self._last.t_ns) <= LEAP_NS

    def _speed_variances(self, interval_s: float) -> Three:
        """m^2/s^2 along body x, y, z: the noise of the way of one interval of the encoders."""
        wheels, speed_m_s = self.config.wheels, abs(self._speed_m_s)
        slip = wheels.turn_noise_m**2 * abs(self._rate[2])
        x, y, z = (
            (noise**2 * speed_m_s + more) / interval_s + SMALLEST_VARIANCE
            for noise, more in (
                (wheels.distance_noise_m, slip),
                (wheels.lateral_noise_m, slip),
                (wheels.vertical_noise_m, 0.0),
            )
        )
        return x, y, z

    def _calibrate(self, sample: ImuSample, dt_s: float) -> None:
        """Apply bias and effects to one sample."""
        state, gyro = self.ahead, self.config.gyro
        correction = correct(self._parts.gyro, self._alone(sample, dt_s), state.coefficients, self._memories)
        self._memories = correction.memories
        sees = float(np.max(correction.sees))
        x, y, z = sample.rate_rad_s
        bx, by, bz = state.bias_rad_s.tolist()
        self._rate = (x + bx, y + by, z + float(correction.rate_rad_s[0]) + sees * bz)
        white = math.radians(gyro.rate_noise_deg_s) ** 2 / dt_s
        gain = np.concatenate([[sees], correction.by_values[0]])
        own = float(gain @ self._of_yaw @ gain) + float(np.max(correction.noise_rad_s)) ** 2
        self._rate_variances = (white + self._of_x, white + self._of_y, white + own)

    def _alone(self, sample: ImuSample, dt_s: float) -> MotionBlock:
        """One sample as a block of one interval."""
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
        )

    def _go_on(self, step: _Step) -> None:
        self._steps.append(step)
        pose = _carried(self._track[-1][1], step.rate_rad_s, step.dt_s, self._speed_m_s)
        self._track.append((step.t_ns, pose))

    def _pose_at(self, t_ns: int) -> Pose:
        """The pose at a moment near now, linear between samples and a little beyond the last one."""
        later = len(self._track) - 1
        while later > 1 and self._track[later - 1][0] >= t_ns:
            later -= 1
        if later < 1:
            return self._track[-1][1]
        (t0_ns, first), (t1_ns, second) = self._track[later - 1], self._track[later]
        part = min((t_ns - t0_ns) / (t1_ns - t0_ns), 1.0 + GAP_NS / (t1_ns - t0_ns))
        x, y, z, roll, pitch, yaw = (a + part * (b - a) for a, b in zip(first, second, strict=True))
        return x, y, z, roll, pitch, yaw

    def _look_ahead(self) -> None:
        """Predict the last good state to where gyro and wheels are known, and on from there to now."""
        covered_ns = self._buffer.covered_until_ns()
        if covered_ns is None:
            return
        while covered_ns - self._base.t_ns > self._kept_ns:
            end_ns = self._base.t_ns + MAX_BLOCK_NS
            self._base, self._base_memories = self._predicted(self._buffer.cut(self._base.t_ns, end_ns))
        state = self._base
        if covered_ns > state.t_ns:
            block = self._buffer.look(state.t_ns, covered_ns)
            self._vibration = block.vibration_m2_s4[-1:]
            state, _ = self._predicted(block)
        self._use(state)

    def _predicted(self, block: MotionBlock) -> tuple[State, tuple[Memory, ...]]:
        state, transition = predict(
            self._base,
            block,
            self._model,
            self._parts,
            self._base_memories,
            self.config.gyro,
            self.config.wheels,
        )
        return state, transition.contribution.correction.memories

    def _use(self, state: State) -> None:
        """Calibrate by a state from now on, and go on from its pose."""
        self.ahead = state
        places = [YAW_BIAS, *range(COEFFICIENTS_START, state.robot_size)]
        self._of_yaw = state.covariance[np.ix_(places, places)]
        self._of_x, self._of_y = np.diagonal(state.covariance)[BIAS][:2].tolist()
        while self._steps and self._steps[0].t_ns <= state.t_ns:
            self._steps.popleft()
        x, y, z, roll, pitch, yaw = state.mean[POSE].tolist()
        pose: Pose = (x, y, z, roll, pitch, yaw)
        self._track = deque([(state.t_ns, pose)])
        for step in self._steps:
            rest_s = min(step.dt_s, seconds(step.t_ns - self._track[-1][0]))
            pose = _carried(pose, step.rate_rad_s, rest_s, self._speed_m_s)
            self._track.append((step.t_ns, pose))

    def _begin_time_base(self, t_ns: int) -> None:
        """Go on from here with other stamps."""
        moved_on = self._base.t_ns > 0
        self._buffer = MotionBuffer(self._buffer.running_s(self._base.t_ns) if moved_on else 0.0)
        mean = self.ahead.mean.copy()
        mean[POSE] = self._track[-1][1]
        state = replace(self.ahead, t_ns=t_ns, mean=mean)
        self._base = inflate_after_gap(state, t_ns) if moved_on else state
        self._base_memories = self._memories
        self._last = None
        self._steps.clear()
        self._use(self._base)


def _carried(pose: Pose, rate_rad_s: Three, dt_s: float, speed_m_s: float) -> Pose:
    """A pose carried on over one short step; plain floats are fastest here."""
    x, y, z, roll, pitch, yaw = pose
    wx, wy, wz = rate_rad_s
    sr, cr, tp = math.sin(roll), math.cos(roll), math.tan(pitch)
    level = sr * wy + cr * wz
    turn = level * math.sqrt(1.0 + tp * tp) * dt_s
    middle, way = yaw + 0.5 * turn, speed_m_s * math.cos(pitch) * dt_s
    return (
        x + way * math.cos(middle),
        y + way * math.sin(middle),
        z - speed_m_s * math.sin(pitch) * dt_s,
        roll + (wx + tp * level) * dt_s,
        pitch + (cr * wy - sr * wz) * dt_s,
        yaw + turn,
    )
