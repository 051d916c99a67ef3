"""Comparison of the turns of gyro, wheels and images, which shows what is mounted or wired wrongly.

The scale factor compares the images with the gyro. A mirrored image or an inverted gyro makes it negative,
with innovations as small as ever. The wheels tell which of the two is wrong.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.ekf.features.knock_watch import knock
from gyrocal_ros.ekf.features.way_agreement import turned_camera, wrong_yaw
from gyrocal_ros.ekf.history.convergence import is_plausible
from gyrocal_ros.ekf.history.run import History, Run, step_by_step
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START

INTERVAL_S = 0.5
"""Time over which turns are added up: in that of an image the noise of the wheels is larger than a turn."""
SLOW_RAD_S = 0.1
"""Rate of the wheels below which they are not said to turn: a straight lane is no reason to forget a turn."""
MIN_TURN_RAD = 2.0
"""Turn of the wheels from which turns are compared."""
MEMORY_RAD = 6.0
"""Turn of the wheels over which the comparison is averaged."""
MIN_RATIO = 0.5
"""Rate of the gyro, per rate of the wheels, from which both turn the same way; below its negative, opposite
ways."""
VARIED = 0.25
"""Variance of the rate of the wheels, per mean square, below which they turn one way only. Their noise
is then most of the variance, and a bias of the gyro would explain all that it reads."""
SURE = 0.8
"""Correlation of gyro and wheels from which they turn together, or against each other: with an encoder that
stands, the wheels turn wherever the robot drives."""
UNIT_PART = 0.1
"""Largest deviation from the ratio of radians to degrees that is taken for it."""
DEAF_RATIO = 0.2
"""Rate of the gyro, per rate of the wheels, below which it does not follow turns."""
STUCK_RAD, STUCK_RAD_S = 1.0, 1e-6
"""Turn of the wheels in which a working gyro changes its reading, by more than this."""


class TurnAgreement:
    """Regresses the rate of the gyro on that of the wheels, and forgets while the wheels turn."""

    def __init__(self) -> None:
        self._turn_rad = self._constant_rad = self._last_rad_s = 0.0
        self._time_s = self._gyro_rad = self._wheels_rad = 0.0
        self._product = self._square = self._gyro_square = 0.0
        self._gyro_now_rad = self._wheels_now_rad = self._now_s = 0.0

    def add(self, gyro_rad: float, wheels_rad: float, duration_s: float) -> None:
        """Add the turns of one step by the nominal gyro and by the wheels."""
        self._gyro_now_rad += gyro_rad
        self._wheels_now_rad += wheels_rad
        self._now_s += duration_s
        if self._now_s >= INTERVAL_S:
            self._add_interval(self._gyro_now_rad, self._wheels_now_rad, self._now_s)
            self._gyro_now_rad = self._wheels_now_rad = self._now_s = 0.0

    def _add_interval(self, gyro_rad: float, wheels_rad: float, duration_s: float) -> None:
        rate_rad_s = gyro_rad / duration_s
        turn_rad = abs(wheels_rad) if abs(wheels_rad) > SLOW_RAD_S * duration_s else 0.0
        is_constant = abs(rate_rad_s - self._last_rad_s) < STUCK_RAD_S
        self._constant_rad = self._constant_rad + turn_rad if is_constant else 0.0
        self._last_rad_s = rate_rad_s
        self._turn_rad += turn_rad
        kept = math.exp(-turn_rad / MEMORY_RAD)
        self._time_s = kept * self._time_s + duration_s
        self._gyro_rad = kept * self._gyro_rad + gyro_rad
        self._wheels_rad = kept * self._wheels_rad + wheels_rad
        self._product = kept * self._product + gyro_rad * wheels_rad / duration_s
        self._square = kept * self._square + wheels_rad**2 / duration_s
        self._gyro_square = kept * self._gyro_square + gyro_rad**2 / duration_s

    @property
    def is_known(self) -> bool:
        """True if the wheels have turned enough."""
        return self._turn_rad >= MIN_TURN_RAD

    @property
    def ratio(self) -> float:
        """Rate of the gyro per rate of the wheels; NaN while unknown.

        It is without biases, unless the wheels turn one way all the time.
        """
        if not self.is_known:
            return math.nan
        covariance, by_wheels, _ = self._moments()
        return covariance / by_wheels

    @property
    def correlation(self) -> float:
        """Correlation of the rates of gyro and wheels; NaN while unknown."""
        if not self.is_known:
            return math.nan
        covariance, by_wheels, by_gyro = self._moments()
        return covariance / math.sqrt(by_wheels * by_gyro) if by_gyro > 0.0 else 0.0

    def _is_quiet(self) -> bool:
        """Return True unless the gyro turns about as much as the wheels, but at other times."""
        _, by_wheels, by_gyro = self._moments()
        return by_gyro < MIN_RATIO**2 * by_wheels

    def _moments(self) -> tuple[float, float, float]:
        """Return covariance and variances of wheels and gyro; about zero where the wheels turn one way."""
        variation = self._square - self._wheels_rad**2 / self._time_s
        if variation < VARIED * self._square:
            return self._product, self._square, self._gyro_square
        covariance = self._product - self._gyro_rad * self._wheels_rad / self._time_s
        return covariance, variation, self._gyro_square - self._gyro_rad**2 / self._time_s

    def fault(self, scale_factor: float, scale_std: float) -> str:
        """Return what is wrong, with its likely cause and remedy; empty where nothing is.

        Args:
            scale_factor: turn by the images per turn of the gyro.
            scale_std: its standard deviation; a scale factor that is not known yet is not judged.
        """
        is_impossible = not is_plausible(scale_factor) and scale_std < 0.1
        if self._constant_rad > STUCK_RAD:
            return (
                f'the gyro reads {math.degrees(self._last_rad_s):.4g} deg/s whatever the robot does: it is '
                'stuck, or at the end of its range; check its wiring and supply'
            )
        if self.is_known and abs(self.ratio) < DEAF_RATIO and self._is_quiet():
            if abs(math.degrees(self.ratio) - 1.0) < UNIT_PART and self.correlation > SURE:
                return (
                    'the wheels turn 57 times as far as the gyro, as degrees would; give '
                    'twist.twist.angular.z and the rates of the gyro in rad/s'
                )
            return (
                'the gyro does not follow the turns of the wheels: its axes are swapped, or the wheels slip; '
                'check the transform to imu_link'
            )
        if is_impossible and scale_factor < 0.0 and self.ratio > MIN_RATIO:
            return (
                'the images turn opposite to gyro and wheels: the image is mirrored, or the mounting of the '
                'camera is upside down; check the flip options of the camera driver and its transform'
            )
        if self.ratio < -MIN_RATIO and self.correlation < -SURE:
            who = 'wheels and images' if is_impossible and scale_factor < 0.0 else 'the wheels'
            return (
                f'the gyro turns opposite to {who}: it is mounted upside down, its sign is inverted, or the '
                'wheels are swapped; check its transform and the sign of driver and board'
            )
        if is_impossible:
            return (
                f'no gyro has a scale factor of {scale_factor:.3g}: an axis is mirrored or swapped, or a '
                'unit is wrong, or the images are late; check the transforms, the camera calibration and the '
                'unit of the gyro (rad/s), and let `gyrocal diagnose` look for late images'
            )
        return ''


def mounting_fault(run: Run) -> str:
    """Return what is mounted or wired wrongly, by turns and way of a run; empty where nothing is."""
    history, agreement = run.history, TurnAgreement()
    for step in step_by_step(history.turn_rad, history.wheel_turn_rad, history.dt_s):
        agreement.add(*step)
    if not len(history.std):
        return ''
    fault = agreement.fault(_scale_in_turns(history), float(history.std[-1, COEFFICIENTS_START]))
    return fault or next(filter(None, (turned_camera(event.text) for event in run.events)), '')


def camera_yaw_fault(run: Run) -> str:
    """Return what is wrong with the yaw of the camera in its transform; empty where nothing is."""
    return next(filter(None, (wrong_yaw(event.text) for event in run.events)), '')


def camera_knock(run: Run) -> str:
    """Return what an event of a run says of a knock of the camera, as a clause; empty for none."""
    return next(filter(None, (knock(event.text) for event in run.events)), '')


def knocked_steps(run: Run) -> np.ndarray:
    """Return True (s,) for the steps of a run at which the camera was knocked."""
    found: np.ndarray = np.isin(run.history.t_ns, [item.t_ns for item in run.events if knock(item.text)])
    return found


def _scale_in_turns(history: History) -> float:
    """Return by how much the robot turns by all coefficients of the model, per turn of the nominal gyro.

    The scale factor alone may be that at a speed at which the robot never turns.
    """
    added_rad = history.columns @ history.mean[-1, COEFFICIENTS_START:]
    square = float(history.turn_rad @ history.turn_rad)
    return 1.0 + float(history.turn_rad @ added_rad) / square if square else 1.0
