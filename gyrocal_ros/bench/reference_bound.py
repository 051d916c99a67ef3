"""Cramer-Rao bound of a calibration against a simulated heading reference."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, HeadingSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.sim.references import OUTLIER_FACTOR, DrawnReference, ReferenceSource, is_at_rest
from gyrocal_ros.sim.world import START_NS

HEADING, BIAS, SCALE, OFFSET = range(4)
PRIOR_HEADING_RAD, PRIOR_OFFSET_S = math.pi, 0.5
"""Prior standard deviations of the heading, which a jump restores, and of the time offset."""
DENSITY_POINTS = 2001


@dataclass(frozen=True, slots=True)
class Bound:
    """Smallest standard deviations that an unbiased estimate can have at the end of a recording."""

    scale_std: float
    bias_std_rad_s: float


def reference_bound(source: ReferenceSource, config: Config) -> Bound:
    """Compute the posterior Cramer-Rao bound (Tichavsky, Muravchik, Nehorai 1998) for the true noise.

    It is the covariance recursion with all Jacobians at the truth, in which the Fisher information of the
    noise takes the place of the inverse of its variance. The robot is known to be at rest once it has been
    for as long as the settings require: no wheel shows the instants between two motions. Jumps are known.
    Uneven floors and the tilt are not part of it.
    """
    scenario, truth, drawn = source.robot.scenario, source.truth, source.reference
    q_gyro = (truth.scale_factor * math.radians(scenario.errors.rate_noise_deg_s)) ** 2
    q_bias = math.radians(config.gyro.bias_walk_deg_s) ** 2
    variance = 1.0 / white_information(drawn)
    time_s = _true_times(source)
    nodes_s = truth.bias_time_s
    motion = truth.trajectory.motion(nodes_s)
    rate, is_rest = motion.rate_rad_s[:, 2], is_at_rest(motion)
    dt_s = np.diff(nodes_s, prepend=nodes_s[0])
    turned = np.cumsum(rate * dt_s) / truth.scale_factor
    held_s = np.cumsum(is_rest * dt_s) if drawn.holds_at_rest else np.zeros(len(dt_s))
    rested_s = np.cumsum(_known_rest(nodes_s, is_rest, config.rest.settle_s) * dt_s)
    columns = (turned, held_s, rested_s, rate / truth.scale_factor)
    turned_at, held_at, rested_at, rate_at = (np.interp(time_s, nodes_s, column) for column in columns)
    jumps = np.searchsorted(time_s, [at_s for at_s, _ in drawn.jumps])
    P = np.diag(_prior_stds(config)) ** 2
    steps = zip(
        np.diff(time_s, prepend=0.0).tolist(),
        np.diff(turned_at, prepend=0.0).tolist(),
        np.diff(held_at, prepend=0.0).tolist(),
        np.diff(rested_at, prepend=0.0).tolist(),
        rate_at.tolist(),
        strict=True,
    )
    for number, (interval_s, turn, unmoved_s, rest_s, nominal_rate) in enumerate(steps):
        moving_s = interval_s - rest_s
        F = np.eye(4)
        F[HEADING, BIAS], F[HEADING, SCALE] = moving_s, turn
        P = F @ P @ F.T
        P[HEADING, HEADING] += drawn.walk_rad**2 * (interval_s - unmoved_s) + q_gyro * moving_s
        P[BIAS, BIAS] += q_bias * interval_s
        if number in jumps:
            P[HEADING, HEADING] += PRIOR_HEADING_RAD**2
        if rest_s > 0.0:  # the gyro at rest reads its bias
            P = _updated(P, np.eye(4)[BIAS], q_gyro / rest_s)
        P = _updated(P, np.array([1.0, 0.0, 0.0, -nominal_rate]), variance)
    return Bound(math.sqrt(P[SCALE, SCALE]), math.sqrt(P[BIAS, BIAS]))


def white_information(drawn: DrawnReference) -> float:
    """Return the Fisher information (1/rad^2) of a heading with white noise and outliers: E[(p'/p)^2]."""
    widest = OUTLIER_FACTOR if drawn.outliers > 0.0 else 1.0
    x = np.linspace(-8.0 * widest, 8.0 * widest, DENSITY_POINTS)
    shares, widths = (1.0 - drawn.outliers, drawn.outliers), (1.0, OUTLIER_FACTOR)
    density, slope = np.zeros(len(x)), np.zeros(len(x))
    for share, width in zip(shares, widths, strict=True):
        part = share * np.exp(-0.5 * (x / width) ** 2) / (width * math.sqrt(2.0 * math.pi))
        density += part
        slope -= part * x / width**2
    integrand = np.where(density > 0.0, slope**2 / np.maximum(density, 1e-300), 0.0)
    return float(integrand.sum() * (x[1] - x[0])) / drawn.white_rad**2


def _known_rest(time_s: Array, is_rest: NDArray[np.bool_], settle_s: float) -> NDArray[np.bool_]:
    """Return (n,) True where a rest has lasted for `settle_s`."""
    since_s = np.maximum.accumulate(np.where(is_rest, time_s[0], time_s))
    return is_rest & (time_s - since_s > settle_s)


def _true_times(source: ReferenceSource) -> Array:
    """Return the true times (n,) of the headings in s since the start."""
    stamps = [item.t_ns for item in source.measurements() if isinstance(item, HeadingSample)]
    return (np.array(stamps) - START_NS) / NS_PER_S - source.reference.offset_s


def _prior_stds(config: Config) -> Array:
    bias = math.radians(config.gyro.bias_prior_std_deg_s)
    return np.array([PRIOR_HEADING_RAD, bias, default_model().coefficients[0].prior_std, PRIOR_OFFSET_S])


def _updated(P: Array, h: Array, variance: float) -> Array:
    gain = P @ h / (h @ P @ h + variance)
    return P - np.outer(gain, h @ P)
