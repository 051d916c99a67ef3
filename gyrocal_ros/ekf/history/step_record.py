"""Record of one step of the filter: its measurements, and the estimate after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock, quickly_filled
from gyrocal_ros.ekf.equations.predict import Transition
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, UpdateStats
from gyrocal_ros.ekf.features.track_noise import TrackNoise
from gyrocal_ros.ekf.state.layout import YAW, YAW_BIAS, State
from gyrocal_ros.ekf.watches.calibration_watch import Suspicions
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.gyro import Correction


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class StepRecord:
    """One step of the filter."""

    t_ns: int
    mean: Array
    """(9 + k,) robot part of the state after the step."""
    std: Array
    """(9 + k,) its standard deviations."""
    change: Array
    """(1 + k,) change of yaw bias and coefficients by the measurements of the step."""
    change_variance: Array
    """(1 + k,) decrease of their variances by them."""
    update: MeasurementUpdate
    """Update by an image or a heading."""
    resting: UpdateStats
    """Statistics of the zero-rate update."""
    block: MotionBlock
    """Motion up to this step."""
    correction_rad: float
    """Correction of the turn by the coefficients after the step, to first order, without bias."""
    tilt_rad: float
    """Change of heading beyond the turn about the body's own z axis, because that is tilted."""
    suspected_std: Array
    """(1 + k,) standard deviations of their errors by what is suspected of the camera and of a drift."""
    columns: Array
    """(k,) derivative of the correction with respect to the coefficients, rad per unit."""
    gyro_valid_s: float
    """Time in this block with a valid gyro reading (not saturated, not in the dead band); only then the bias
    acts."""
    unobserved_turn_std_rad: float
    """Standard deviation of the turn that the gyro could not measure, for example beyond its range."""
    pixel_noise_px: float
    """Present estimate of the pixel noise."""
    stamp_noise_s: float
    """Present estimate of the noise of the stamps of the images; 0 while nothing is known of it."""
    event: str = ''
    """Event to report to the user."""
    scale_change: float = 0.0
    """Significant change of the scale factor that the filter did not follow, see `ekf.watches.scale_watch`;
    zero without one."""
    scale_followed: bool = False
    """True if the filter followed such a change."""
    bias_walk: float = 1.0
    """Random walk of the bias that the filter expects, relative to the settings (`ekf.noise.noise_bank`)."""


def step_record(
    before: State,
    predicted: State,
    after: State,
    block: MotionBlock,
    transition: Transition,
    update: MeasurementUpdate,
    resting: UpdateStats,
    noise: TrackNoise,
    event: str,
    suspicions: Suspicions,
) -> StepRecord:
    """Describe a step from the state before over the predicted one to the state after."""
    correction = transition.contribution.correction
    std, change, change_variance, columns, correction_rad, tilt_rad = step_numbers(
        before, predicted, after, block.dt_s, correction, transition.rate_rad_s, transition.motion.euler_rad
    )
    return StepRecord(
        t_ns=block.end_ns,
        mean=after.mean[: after.robot_size],
        std=std,
        change=change,
        change_variance=change_variance,
        suspected_std=suspicions.std,
        update=update,
        resting=resting,
        block=block,
        correction_rad=correction_rad,
        tilt_rad=tilt_rad,
        columns=columns,
        gyro_valid_s=correction.valid_s(block.dt_s),
        unobserved_turn_std_rad=correction.unread_rad(block.dt_s),
        pixel_noise_px=noise.pixel.std,
        stamp_noise_s=noise.learned_stamp_std_s,
        event=event,
        scale_change=0.0 if suspicions.change is None or suspicions.followed else suspicions.change.value,
        scale_followed=suspicions.followed,
        bias_walk=suspicions.bias_walk,
    )


@compiled
def step_numbers(
    before: State,
    predicted: State,
    after: State,
    dt_s: Array,
    correction: Correction,
    rate_rad_s: Array,
    euler_rad: Array,
) -> tuple[Array, Array, Array, Array, float, float]:
    """Return the fields of `StepRecord` that follow from three states and the prediction.

    Args:
        before: state before the step.
        predicted: the predicted one.
        after: the one after it.
        dt_s: (N,) lengths of its intervals.
        correction: contributions of the gyro effects.
        rate_rad_s: (N, 3) corrected body rates.
        euler_rad: (3,) predicted.

    Returns:
        `std`, `change`, `change_variance`, `columns`, `correction_rad` and `tilt_rad`.
    """
    variance, learned = after.covariance.diagonal()[: after.robot_size], slice(YAW_BIAS, after.robot_size)
    columns = dt_s @ correction.by_values
    by_values = columns @ (after.coefficients - before.coefficients)
    return (
        np.sqrt(variance),
        after.mean[learned] - predicted.mean[learned],
        predicted.covariance.diagonal()[learned] - variance[learned],
        columns,
        float(dt_s @ correction.rate_rad_s + by_values),
        float(euler_rad[2] - before.mean[YAW] - dt_s @ rate_rad_s[:, 2]),
    )
