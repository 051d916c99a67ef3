"""True motion of the simulated robot: legs of smooth speed and yaw rate on an uneven floor.

Everything is known in closed form except the position, which is a Gauss-Legendre integral accurate to
rounding. The rates, the attitude and the specific force that the sensors measure are therefore
consistent at any time, whatever the sampling rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array

GRAVITY_M_S2 = 9.80665
HALF_TRACK_M = 0.115
_GRID_STEP_S = 0.02
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True)
class Leg:
    """An interval in which speed and yaw rate change smoothly to the given values."""

    duration_s: float
    speed_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Tilt of the robot as a smooth function of the path of its wheels: waves and single bumps."""

    wavenumbers_rad_m: Array
    """(k,) wavenumbers of the waves along the path."""
    roll_rad: Array
    """(2, k) sine and cosine amplitudes."""
    pitch_rad: Array
    """(2, k) sine and cosine amplitudes."""
    bumps_m: Array
    """(b,) positions of the thresholds along the path."""
    bump_height_m: float = 0.008
    bump_width_m: float = 0.12
    """Standard deviation of the Gaussian height profile of a threshold."""

    def tilt(self, path_m: Array) -> tuple[Array, Array, Array, Array]:
        """Return roll, pitch (rad) and their derivatives by the path (rad/m), each (n,)."""
        k = self.wavenumbers_rad_m
        phase = np.multiply.outer(path_m, k)
        sine, cosine = np.sin(phase), np.cos(phase)

        def waves(of_sine: Array, of_cosine: Array) -> Array:
            # `@` is avoided because the sums of a threaded BLAS depend on the number of threads.
            return np.einsum('nk,k->n', sine, of_sine) + np.einsum('nk,k->n', cosine, of_cosine)

        (roll_sine, roll_cosine), (pitch_sine, pitch_cosine) = self.roll_rad, self.pitch_rad
        roll, d_roll = waves(roll_sine, roll_cosine), waves(-k * roll_cosine, k * roll_sine)
        pitch, d_pitch = waves(pitch_sine, pitch_cosine), waves(-k * pitch_cosine, k * pitch_sine)
        for bump_m in self.bumps_m:
            z = (path_m - bump_m) / self.bump_width_m
            rise = self.bump_height_m / self.bump_width_m * np.exp(-0.5 * z**2)
            pitch = pitch + rise * z  # nose up while climbing is negative pitch
            d_pitch = d_pitch + rise * (1.0 - z**2) / self.bump_width_m
        return roll, pitch, d_roll, d_pitch


def rough_floor(
    rng: np.random.Generator, tilt_rms_deg: float, bumps: int, path_length_m: float, waves: int = 10
) -> Floor:
    """Draw a floor whose roll and pitch each have the given root mean square."""
    wavenumbers = 2.0 * np.pi / np.geomspace(0.12, 2.0, waves) * rng.uniform(0.9, 1.1, waves)
    roll, pitch = np.radians(tilt_rms_deg) / np.sqrt(waves) * rng.standard_normal((2, 2, waves))
    return Floor(wavenumbers, roll, pitch, np.sort(rng.uniform(1.0, max(path_length_m, 2.0), bumps)))


FLAT_FLOOR = Floor(np.zeros(0), np.zeros((2, 0)), np.zeros((2, 0)), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotion:
    """The true motion at n times."""

    time_s: Array
    """(n,) seconds since the start of the trajectory."""
    speed_m_s: Array
    """(n,) speed along body x, the only direction of motion."""
    acceleration_m_s2: Array
    """(n,) derivative of the speed."""
    travelled_m: Array
    """(n,) integral of the speed."""
    euler_rad: Array
    """(n, 3) roll, pitch, yaw (z-y-x); the yaw is not wrapped."""
    rate_rad_s: Array
    """(n, 3) body rates."""

    @property
    def R_wb(self) -> Array:
        """(n, 3, 3) attitude."""
        return rotation_matrices(self.euler_rad)

    @property
    def specific_force_m_s2(self) -> Array:
        """(n, 3) reading of an ideal accelerometer at the body's origin."""
        gravity = GRAVITY_M_S2 * self.R_wb[:, 2, :]
        _, wy, wz = self.rate_rad_s.T
        own = np.stack([self.acceleration_m_s2, self.speed_m_s * wz, -self.speed_m_s * wy], axis=1)
        return gravity + own


class Trajectory:
    """Consecutive legs from a start pose; after the last leg the robot keeps its final state.

    Args:
        legs: the legs in order.
        floor: tilt of the floor.
        start: x (m), y (m) and yaw (rad) at time zero.
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        floor: Floor = FLAT_FLOOR,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.floor = floor
        self._length_s = np.array([leg.duration_s for leg in legs])
        self._start_s = np.concatenate([[0.0], np.cumsum(self._length_s)])
        self._speed = np.array([0.0, *(leg.speed_m_s for leg in legs)])
        self._yaw_rate = np.array([0.0, *(leg.yaw_rate_rad_s for leg in legs)])
        travelled = self._length_s * (self._speed[:-1] + self._speed[1:]) / 2.0
        turned = self._length_s * (self._yaw_rate[:-1] + self._yaw_rate[1:]) / 2.0
        self._travelled = np.concatenate([[0.0], np.cumsum(travelled)])
        self._yaw = start[2] + np.concatenate([[0.0], np.cumsum(turned)])
        path = np.abs(travelled) + HALF_TRACK_M * np.abs(turned)
        self._path = np.concatenate([[0.0], np.cumsum(path)])
        self._grid_s, self._grid_position = self._integrate(np.array([start[0], start[1], 0.0]))

    @property
    def duration_s(self) -> float:
        """Time until the last leg ends."""
        return float(self._start_s[-1])

    @property
    def end(self) -> tuple[float, float, float]:
        """Pose at the end of the last leg: x (m), y (m) and yaw (rad)."""
        x, y, _ = self._grid_position[-1]
        return float(x), float(y), float(self._yaw[-1])

    def motion(self, time_s: Array) -> TrueMotion:
        """Return everything but the position at times (n,)."""
        leg, u = self._locate(time_s)
        length = self._length_s[leg]
        ramp, ramp_rate = u**2 * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / length
        ramp_integral = length * (u**3 - 0.5 * u**4)  # integral of the ramp over the elapsed time

        d_speed = self._speed[leg + 1] - self._speed[leg]
        d_yaw_rate = self._yaw_rate[leg + 1] - self._yaw_rate[leg]
        speed = self._speed[leg] + d_speed * ramp
        yaw_rate = self._yaw_rate[leg] + d_yaw_rate * ramp
        travelled = self._speed[leg] * length * u + d_speed * ramp_integral
        turned = self._yaw_rate[leg] * length * u + d_yaw_rate * ramp_integral

        # No leg changes the sign of speed or yaw rate, so that the path of the wheels is also exact.
        path = self._path[leg] + np.abs(travelled) + HALF_TRACK_M * np.abs(turned)
        path_rate = np.abs(speed) + HALF_TRACK_M * np.abs(yaw_rate)
        roll, pitch, d_roll, d_pitch = self.floor.tilt(path)
        euler = np.stack([roll, pitch, self._yaw[leg] + turned], axis=1)
        euler_rate = np.stack([d_roll * path_rate, d_pitch * path_rate, yaw_rate], axis=1)
        return TrueMotion(
            time_s=time_s,
            speed_m_s=speed,
            acceleration_m_s2=d_speed * ramp_rate,
            travelled_m=self._travelled[leg] + travelled,
            euler_rad=euler,
            rate_rad_s=body_rates(euler, euler_rate),
        )

    def position(self, time_s: Array) -> Array:
        """Return the positions (n, 3) of the body in the world at times (n,)."""
        cell = np.clip(np.searchsorted(self._grid_s, time_s, side='right') - 1, 0, len(self._grid_s) - 2)
        within = np.clip(time_s, 0.0, self.duration_s)
        return self._grid_position[cell] + self._displacement(self._grid_s[cell], within)

    def _locate(self, time_s: Array) -> tuple[np.ndarray, Array]:
        """Return the leg (n,) of each time and the elapsed fraction of it, 0 to 1."""
        leg = np.clip(np.searchsorted(self._start_s, time_s, side='right') - 1, 0, len(self._length_s) - 1)
        return leg, np.clip((time_s - self._start_s[leg]) / self._length_s[leg], 0.0, 1.0)

    def _displacement(self, from_s: Array, to_s: Array) -> Array:
        """Integrate the velocity over n intervals of at most a grid step within one leg, (n, 3)."""
        half = (to_s - from_s) / 2.0
        times = (from_s + half)[:, None] + half[:, None] * _NODES
        motion = self.motion(times.ravel())
        velocity = motion.speed_m_s[:, None] * motion.R_wb[:, :, 0]
        return np.einsum('n,k,nki->ni', half, _WEIGHTS, velocity.reshape(len(half), len(_NODES), 3))

    def _integrate(self, start: Array) -> tuple[Array, Array]:
        """Return a grid of times that contains the ends of the legs, and the positions on it."""
        regular = np.arange(0.0, self.duration_s, _GRID_STEP_S)
        grid_s = np.union1d(self._start_s, regular)
        steps = self._displacement(grid_s[:-1], grid_s[1:])
        return grid_s, start + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def rotation_matrices(euler_rad: Array) -> Array:
    """Return R_wb (n, 3, 3) of z-y-x Euler angles (n, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(euler_rad).T, np.cos(euler_rad).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def body_rates(euler_rad: Array, euler_rate_rad_s: Array) -> Array:
    """Return the body rates (n, 3) that change Euler angles (n, 3) at the given rates (n, 3)."""
    roll, pitch, _ = euler_rad.T
    d_roll, d_pitch, d_yaw = euler_rate_rad_s.T
    sr, cr, cp = np.sin(roll), np.cos(roll), np.cos(pitch)
    return np.stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * cr + d_yaw * cp * sr,
            -d_pitch * sr + d_yaw * cp * cr,
        ],
        axis=1,
    )
