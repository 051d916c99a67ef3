"""Sensor models: true signals to readings, one function per sensor with its own random stream.

Every function draws its random numbers in the same order whatever the sizes of the errors are, so that
two recordings of one seed differ only in what was changed. Hidden effects are simulated in `forward`.

Noise convention: a density d (unit / sqrt(Hz)) gives each sample at f Hz the standard deviation d
sqrt(f), so that the integral over a time t has the standard deviation d sqrt(t).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields, replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.sim.trajectory import HALF_TRACK_M, TrueMotion


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Sizes of the sensor errors. The fields in `NOISE` are zero in a recording without noise."""

    scale_factor: float = 135.5 / 146.4
    """True yaw rate over nominal yaw rate."""
    x_scale_error: float = 0.0
    y_scale_error: float = 0.0
    """Relative errors of the readings of the x and y gyros."""
    turn_on_bias_deg_s: float = 0.2
    """Standard deviation of the constant bias of each axis."""
    bias_wander_deg_h: float = 10.0
    """In-run bias instability: standard deviation about the turn-on offset, deg/h."""
    bias_wander_time_s: float = 250.0
    """Correlation time of the bias wander; over shorter times it is a random walk of 2.5e-4 deg/s/sqrt(s)."""
    rate_noise_deg_s: float = 0.0075
    """Noise density of the recorded rate, deg/s/sqrt(Hz)."""
    rate_step_deg_s: float = 0.002
    """Resolution of the recorded rate."""
    force_noise_m_s2: float = 0.002
    """Noise density of the specific force, m/s^2/sqrt(Hz)."""
    vibration_m_s2: float = 0.15
    """Standard deviation of a force sample at full fan speed; driving causes as much."""
    force_bias_m_s2: float = 0.05
    """Standard deviation of the constant bias of each axis."""
    force_step_m_s2: float = 0.0012
    """Resolution of the recorded force: 16 bits over +-4 g."""
    wheel_noise_m: float = 0.005
    """Random error of the distance travelled, m/sqrt(m)."""
    tick_m: float = 3e-4
    """Wheel travel from one encoder tick to the next."""
    track_error: float = 0.02
    """Relative error of the assumed track of the wheels, which is wider than the true one."""
    pixel_noise_px: float = 0.4
    outliers: float = 0.0
    """Share of the observations with an error of many pixels."""
    outlier_px: float = 15.0
    """Standard deviation of the outliers."""
    temperature_noise_c: float = 0.03
    temperature_step_c: float = 0.0625
    """Resolution of the recorded temperature."""
    covariate_noise: float = 1.0
    """Factor of noise and resolution of the other recorded signals, relative to `COVARIATE_ERRORS`."""


NOISE = (
    'bias_wander_deg_h',
    'rate_noise_deg_s',
    'rate_step_deg_s',
    'force_noise_m_s2',
    'vibration_m_s2',
    'force_step_m_s2',
    'wheel_noise_m',
    'tick_m',
    'pixel_noise_px',
    'outliers',
    'temperature_noise_c',
    'temperature_step_c',
    'covariate_noise',
)


def without_noise(errors: SensorErrors) -> SensorErrors:
    """Return only the constant errors (scale factor, biases, track)."""
    assert set(NOISE) <= {item.name for item in fields(errors)}
    return replace(errors, **dict.fromkeys(NOISE, 0.0))


def with_bias_walk(errors: SensorErrors, walk_deg_s: float, bounded_s: float) -> SensorErrors:
    """Return the errors with a bias that walks at random.

    Args:
        errors: the others.
        walk_deg_s: random walk of the bias, deg/s/sqrt(s).
        bounded_s: correlation time from which the wander is bounded, long beside the recording.
    """
    wander = 3600.0 * walk_deg_s / np.sqrt(2.0 / bounded_s)
    return replace(errors, bias_wander_deg_h=float(wander), bias_wander_time_s=bounded_s)


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of a sensor, which depends only on the seed and the name."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


# --- gyro and accelerometer ---------------------------------------------------------------------


def gyro_bias(time_s: Array, errors: SensorErrors, rng: np.random.Generator) -> Array:
    """Draw the true bias (n, 3) in rad/s: turn-on offset and wander.

    The wander is a first-order Gauss-Markov process that starts at zero, computed as the sum of its
    steps, each decayed by the time since.
    """
    turn_on = errors.turn_on_bias_deg_s * rng.standard_normal(3)
    decay = np.exp(-(time_s - time_s[0]) / errors.bias_wander_time_s)[:, None]
    step = errors.bias_wander_deg_h / 3600.0 * np.sqrt(2.0 / errors.bias_wander_time_s)
    steps = rng.standard_normal((len(time_s), 3)) * np.sqrt(np.diff(time_s, prepend=time_s[0]))[:, None]
    bias = turn_on + step * decay * np.cumsum(steps / decay, axis=0)
    return np.radians(bias)


def read_gyro(nominal_rad_s: Array, rate_hz: float, errors: SensorErrors, rng: np.random.Generator) -> Array:
    """Return the recorded body rates (n, 3): the nominal ones with noise, quantised."""
    sigma = np.radians(errors.rate_noise_deg_s) * np.sqrt(rate_hz)
    noise = sigma * rng.standard_normal(nominal_rad_s.shape)
    return _quantised(nominal_rad_s + noise, np.radians(errors.rate_step_deg_s))


def vibration_std(motion: TrueMotion, fan_speed: Array, errors: SensorErrors) -> Array:
    """Return the standard deviation (n,) of the vibration in m/s^2 that fan and floor cause."""
    return errors.vibration_m_s2 * np.hypot(fan_speed, motion.speed_m_s / 0.3)


def vibration(vibration_std_m_s2: Array, rng: np.random.Generator) -> Array:
    """Draw the specific force (n, 3) of the vibration."""
    return vibration_std_m_s2[:, None] * rng.standard_normal((len(vibration_std_m_s2), 3))


def read_accelerometer(
    force_m_s2: Array, rate_hz: float, errors: SensorErrors, rng: np.random.Generator
) -> Array:
    """Return the readings (n, 3) of a specific force (n, 3), with bias, noise and quantisation."""
    bias = errors.force_bias_m_s2 * rng.standard_normal(3)
    noise = errors.force_noise_m_s2 * np.sqrt(rate_hz) * rng.standard_normal(force_m_s2.shape)
    return _quantised(force_m_s2 + bias + noise, errors.force_step_m_s2)


# --- wheels -------------------------------------------------------------------------------------


def read_wheels(
    rolled_m: Array, yaw_rad: Array, errors: SensorErrors, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return the steps (n - 1, each) of distance (m) and yaw (rad) between n readings of the ticks.

    Each wheel slips independently, so that a spin on the spot also causes an error of distance.

    Args:
        rolled_m: (n,) distance rolled by the middle of the axle.
        yaw_rad: (n,) true heading.
        errors: sizes of the errors.
        rng: random stream of the wheels.
    """
    sides = np.array([-HALF_TRACK_M, HALF_TRACK_M])
    wheels = rolled_m[:, None] + sides * yaw_rad[:, None]
    moved = np.abs(np.diff(wheels, axis=0, prepend=wheels[:1]))
    slip = errors.wheel_noise_m * np.sqrt(2.0 * moved) * rng.standard_normal(wheels.shape)
    ticks = _quantised(wheels + np.cumsum(slip, axis=0), errors.tick_m)
    steps = np.diff(ticks, axis=0)
    track = 2.0 * HALF_TRACK_M * (1.0 + errors.track_error)
    return steps.mean(axis=1), (steps[:, 1] - steps[:, 0]) / track


# --- camera -------------------------------------------------------------------------------------


def pixel_errors(shape: tuple[int, int], errors: SensorErrors, rng: np.random.Generator) -> Array:
    """Draw the error (n, m, 2) in pixels of every corner in every image."""
    noise = errors.pixel_noise_px * rng.standard_normal((*shape, 2))
    wrong = rng.random(shape) < errors.outliers
    return noise + np.where(wrong[..., None], errors.outlier_px * rng.standard_normal((*shape, 2)), 0.0)


# --- slow signals -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Climate:
    """Temperature of the gyro: that of the room plus self-heating of the robot."""

    room_c: float
    drift_c: float
    drift_phase_rad: float
    rise_c: float
    rise_time_s: float

    def temperature_c(self, time_s: Array) -> Array:
        """Return the true temperature (n,) at times (n,) since power-on."""
        drift = self.drift_c * np.sin(2.0 * np.pi * time_s / 900.0 + self.drift_phase_rad)
        return self.room_c + drift - self.rise_c * np.expm1(-time_s / self.rise_time_s)


def draw_climate(rng: np.random.Generator) -> Climate:
    """Draw the climate of a recording."""
    return Climate(
        room_c=rng.normal(22.0, 2.0),
        drift_c=rng.uniform(0.3, 1.0),
        drift_phase_rad=rng.uniform(0.0, 2.0 * np.pi),
        rise_c=rng.uniform(8.0, 14.0),
        rise_time_s=rng.uniform(200.0, 500.0),
    )


def read_temperature(
    time_s: Array, climate: Climate, errors: SensorErrors, rng: np.random.Generator
) -> Array:
    """Return the readings (n,) of the temperature in deg C, quantised as by a sensor chip."""
    noise = errors.temperature_noise_c * rng.standard_normal(len(time_s))
    return _quantised(climate.temperature_c(time_s) + noise, errors.temperature_step_c)


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Speed of the suction fan: off at first, then on, with intervals of full power on carpets."""

    start_s: float
    boosts_s: Array
    """(k, 2) start and end of the intervals of full power."""

    def speed(self, time_s: Array) -> Array:
        """Return the speed (n,), 0 to 1, at times (n,)."""

        def ramp(from_s: float, length_s: float) -> Array:
            return np.clip((time_s - from_s) / length_s, 0.0, 1.0)

        speed = 0.6 * ramp(self.start_s, 2.0)
        for from_s, to_s in self.boosts_s:
            speed = speed + 0.35 * (ramp(from_s, 1.0) - ramp(to_s, 1.0))
        return speed


def draw_fan(rng: np.random.Generator, start_s: float, duration_s: float) -> Fan:
    """Draw the intervals of full power: about a third of the time, 10 to 30 s each."""
    gaps_and_boosts = rng.uniform([20.0, 10.0], [70.0, 30.0], (int(duration_s / 30.0) + 1, 2))
    ends = start_s + np.cumsum(gaps_and_boosts.ravel()).reshape(-1, 2)
    return Fan(start_s, ends)


def covariates(motion: TrueMotion, fan_speed: Array) -> dict[str, Array]:
    """Return the true values (n,) of the other recorded signals: V, A (discharging: negative), 1/min."""
    driving = 0.5 * np.abs(motion.speed_m_s) / 0.3 + 0.4 * np.abs(motion.rate_rad_s[:, 2])
    accelerating = 0.8 * np.maximum(motion.acceleration_m_s2, 0.0)
    current = -(0.5 + 1.4 * fan_speed**2 + driving + accelerating)
    discharged_ah = np.cumsum(-current * np.diff(motion.time_s, prepend=motion.time_s[0])) / 3600.0
    return {
        'battery_state.voltage': 16.4 - 0.9 * discharged_ah + 0.12 * current,
        'battery_state.current': current,
        'fan_speed.data': 18000.0 * fan_speed,
    }


COVARIATE_ERRORS = {
    'battery_state.voltage': (0.004, 0.001),
    'battery_state.current': (0.03, 0.001),
    'fan_speed.data': (40.0, 10.0),
}
"""Standard deviation of the noise, and resolution."""


def read_covariate(name: str, values: Array, errors: SensorErrors, rng: np.random.Generator) -> Array:
    """Return the readings (n,) of one of the `covariates`."""
    noise, step = errors.covariate_noise * np.array(COVARIATE_ERRORS[name])
    return _quantised(values + noise * rng.standard_normal(len(values)), step)


def _quantised(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step > 0.0 else values
