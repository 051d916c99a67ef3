"""A small filter that compares the heading by the camera with the heading by the gyro.

Its state is the difference of the two headings, and the bias. It takes almost no time, so hundreds of
hypotheses can be tested: by how much is the gyro off in this regime, in these ten seconds, at that
temperature? Its log-likelihood of a rate error agrees with that of the full filter within a few per cent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import turns
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S, ScoreStatistics
from gyrocal_ros.ekf.history.turn_agreement import knocked_steps
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.kernels import compiled

TURNING_RAD_S = math.radians(5.0)
"""Rate above which the robot counts as turning; on a straight line the rate is noise."""
INITIAL_BIAS_STD_RAD_S = math.radians(1.0)
"""Prior standard deviation of the bias."""
MIN_FEATURES = 3
"""Features of an image below which one of them that is wrong cannot show."""


@dataclass(frozen=True, slots=True, eq=False)
class Headings:
    """Turns by the gyro and headings by the camera, one for each step of the filter (s,)."""

    time_s: Array
    dt_s: Array
    gyro_valid_s: Array
    """Time with a valid gyro reading."""
    unobserved_turn_std_rad: Array
    """Standard deviation of the turn that no sensor observed."""
    turn_rad: Array
    """Turn by the gyro with the final coefficients, without the bias."""
    seen_rad: Array
    """Heading by the camera; NaN where it saw nothing."""
    std_rad: Array
    rate_noise_rad_s: Array
    """White noise of the gyro, a density."""
    bias_walk_rad_s: float
    """Random walk of the bias, rad/s/sqrt(s)."""
    map_walk_rad: float
    """Random walk of the heading of the map, or of the heading reference, rad/sqrt(s)."""
    outlier_sigma: float
    """Innovations beyond this count less, the larger they are."""


def headings(run: Run, settings: DiagnosisSettings = DEFAULT_SETTINGS) -> Headings:
    """Separate a run into turns by the gyro and headings by the camera."""
    history, gyro = run.history, run.config.gyro
    earlier = np.concatenate([history.mean[:1], history.mean[:-1]])
    learned = np.einsum('sk,sk->s', history.columns, (history.mean - earlier)[:, COEFFICIENTS_START:])
    by_gyro = (
        history.turn_rad + history.correction_rad - learned + earlier[:, YAW_BIAS] * history.gyro_valid_s
    )
    expected = earlier[:, YAW] + np.where(history.resting > 0, 0.0, by_gyro + history.tilt_rad)
    noise = yaw_noise_of(run.model, gyro, history.turn_rad / history.dt_s)
    is_sure = (history.used >= MIN_FEATURES) | (run.rig.camera is None)
    return Headings(
        time_s=history.time_s,
        dt_s=history.dt_s,
        gyro_valid_s=history.gyro_valid_s,
        unobserved_turn_std_rad=history.unobserved_turn_std_rad
        + math.radians(gyro.gap_rate_std_deg_s) * history.gap_s
        + math.pi * knocked_steps(run),
        turn_rad=turns(run, run.state.coefficients),
        seen_rad=np.where(is_sure, expected + history.heading_innovation_rad, np.nan),
        std_rad=history.heading_innovation_std_rad,
        rate_noise_rad_s=noise.density_rad_s,
        bias_walk_rad_s=noise.bias_walk_rad_s,
        map_walk_rad=math.radians(
            settings.map_walk_deg if run.rig.camera is not None else run.config.reference.heading_walk_deg
        ),
        outlier_sigma=settings.outlier_sigma,
    )


def heading_scores(seen: Headings, columns: Array) -> ScoreStatistics:
    """Compute the score statistics of errors of the rate from the headings.

    Args:
        seen: s steps.
        columns: (s, c) rate error (rad/s) of each step per unit of each of c coefficients.

    Returns:
        Score statistics by block of time; the candidates have no names.
    """
    sensitivity, innovation, variance = _innovations(seen, columns * seen.dt_s[:, None])
    weighted = sensitivity / variance[:, None]
    block = (seen.time_s / BLOCK_S).astype(int)
    edges = np.searchsorted(block, np.arange(block[-1] + 2))
    parts = [slice(first, last) for first, last in zip(edges, edges[1:], strict=False)]
    return ScoreStatistics(
        candidates=(),
        start_s=BLOCK_S * np.arange(len(parts)),
        information=np.array([weighted[part].T @ sensitivity[part] for part in parts]),
        score=np.array([weighted[part].T @ innovation[part] for part in parts]),
    )


def heading_log_likelihood(seen: Headings) -> float:
    """Return the log-likelihood of the headings, up to a constant."""
    _, innovation, variance = _innovations(seen, np.zeros((len(seen.dt_s), 0)))
    return float(-0.5 * np.sum(np.log(variance) + innovation**2 / variance))


def misfits(seen: Headings, columns: Array) -> Array:
    """Return the rate error left in each block of time (B,), in sigma, when columns (s, q) are fitted.

    Excess noise of the gyro hardly shows in a single innovation, for images come often; over a block it
    does. Blocks without information are left out.
    """
    block = (seen.time_s / BLOCK_S).astype(int)
    blocks = (block[:, None] == np.arange(block[-1] + 1)).astype(float)
    scores = heading_scores(seen, np.concatenate([blocks, columns], axis=1))
    own, count = np.arange(blocks.shape[1]), blocks.shape[1]
    score, information = scores.score.sum(axis=0), scores.information.sum(axis=0)
    values = np.linalg.lstsq(information[count:, count:], score[count:], rcond=None)[0]
    score = scores.score[own, own] - scores.information[own, own, count:] @ values
    information = scores.information[own, own, own]
    known = information > 0.0
    left: Array = score[known] / np.sqrt(information[known])
    return left


def _innovations(seen: Headings, added_rad: Array) -> tuple[Array, Array, Array]:
    """Return sensitivity (s, c), innovation (s,) and its variance (s,); (0, 0, 1) where nothing is seen."""
    white = (seen.rate_noise_rad_s**2 + seen.map_walk_rad**2) * seen.dt_s
    return compare_headings(
        seen.seen_rad - np.cumsum(seen.turn_rad),
        np.square(seen.std_rad),
        seen.gyro_valid_s,
        white + np.square(seen.unobserved_turn_std_rad),
        INITIAL_BIAS_STD_RAD_S**2,
        seen.bias_walk_rad_s**2 * seen.dt_s,
        seen.outlier_sigma,
        added_rad,
    )


@compiled
def compare_headings(
    measured_rad: Array,
    noise: Array,
    gyro_valid_s: Array,
    away_walk: Array,
    bias_variance: float,
    bias_walk: Array,
    outlier_sigma: float,
    added_rad: Array,
) -> tuple[Array, Array, Array]:
    """Filter the heading by the camera less that by the gyro: its state is this difference and the bias.

    A Kalman filter with two states, written out.

    Args:
        measured_rad: (s,) the difference; NaN where nothing is seen.
        noise: (s,) its variance.
        gyro_valid_s: (s,) time with a valid gyro reading.
        away_walk: (s,) variance that the difference gains in each step.
        bias_variance: variance of the bias at the start.
        bias_walk: (s,) variance that the bias gains in each step.
        outlier_sigma: innovations beyond this count less, the larger they are.
        added_rad: (s, c) turns of each step per unit of each of c coefficients.

    Returns:
        Sensitivity (s, c), innovation (s,) and its variance (s,); (0, 0, 1) where nothing is seen.
    """
    steps, count = added_rad.shape
    sensitivities, innovations, variances = np.zeros((steps, count)), np.zeros(steps), np.ones(steps)
    away, bias = 0.0, 0.0
    p_away, p_both, p_bias = math.inf, 0.0, bias_variance
    x_away, x_bias = np.zeros(count), np.zeros(count)
    columns = (measured_rad, noise, gyro_valid_s, away_walk, bias_walk)
    for step, (measured, white, valid_s, walk, bias_gained) in enumerate(
        zip(*(column.tolist() for column in columns), strict=True)
    ):
        away += bias * valid_s
        x_away += x_bias * valid_s
        x_away += added_rad[step]
        p_away += (2.0 * p_both + p_bias * valid_s) * valid_s + walk
        p_both += p_bias * valid_s
        p_bias += bias_gained
        if math.isnan(measured):
            continue
        if math.isinf(p_away):  # the first heading: nothing to compare with
            away, p_away, p_both = measured, white, 0.0
            x_away[:] = 0.0
            continue
        innovation, variance = measured - away, p_away + white
        variance = max(variance, (innovation / outlier_sigma) ** 2)
        sensitivities[step], innovations[step], variances[step] = x_away, innovation, variance
        gain_away, gain_bias = p_away / variance, p_both / variance
        away += gain_away * innovation
        bias += gain_bias * innovation
        x_bias -= gain_bias * x_away
        x_away *= 1.0 - gain_away
        p_bias -= gain_bias * p_both
        p_both -= gain_away * p_both
        p_away -= gain_away * p_away
    return sensitivities, innovations, variances
