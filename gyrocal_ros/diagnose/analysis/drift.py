"""Blind drift: the heading error of the gyro alone after a span without the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.paths import Heading, Trajectory2D, is_known, slam_path, truth_heading
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.history.turn_agreement import knocked_steps
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.model.planar import planar_trajectory
from gyrocal_ros.model.sensor import MovesAgainstBody
from gyrocal_ros.statistics import chi_square_quantile, trigamma

TRUTH = 'ground truth'
REFERENCES = {
    TRUTH: 'the ground truth',
    'slam': 'the heading by SLAM',
    'heading reference': 'the filtered heading reference',
}
"""References that headings are compared with: name and description."""
SPAN_S = 60.0
"""Length of a span without the camera."""
STRIDE_S = 5.0
"""Distance of the beginnings of spans."""
SETTLING_S = 10.0
"""Earliest beginning of a span: before, the gyro is hardly calibrated."""
STEPPED_S = 0.01
"""Difference of the time between two steps with and without steps of the clock, from which there was one."""
SEEN_S = 2.0
"""Longest time without an image or a heading up to which the filter's own heading is a reference: later it is
that of the gyro itself."""
MIN_INDEPENDENT = 2.0
"""Minimum number of independent spans for an upper end of the interval."""
MORE_SIGMA = 0.5
"""Rise of the held-out drift with a noise from which the noise is left out. In recordings of five minutes a
true random walk of the bias has at most 0.4, a bias that jumps to and fro 0.4 to 1.8."""
MAX_DRIFT_RATIO = 4.0
"""Largest blind drift, relative to what noise explains, of a model that fits."""
TAIL = 0.05
"""Probability beyond each end of an interval."""


@dataclass(frozen=True, slots=True, eq=False)
class BlindDrift:
    """Heading errors at the ends of spans without the camera."""

    span_s: float
    start_s: Array
    """(n,) beginnings of the spans, in s since the first step."""
    error_rad: Array
    """(n,) heading by the gyro less heading by the reference, at the end of each span."""
    reference: str
    """One of `REFERENCES`."""
    unseen: int = 0
    """Number of spans left out because neither images nor headings tell the heading at their end."""

    @property
    def rms_deg(self) -> float:
        """Root mean square, NaN where there is no span."""
        return float(np.degrees(np.sqrt(np.mean(self.error_rad**2)))) if len(self.error_rad) else float('nan')

    @property
    def max_deg(self) -> float:
        """Largest magnitude, NaN where there is no span."""
        return float(np.degrees(np.abs(self.error_rad).max())) if len(self.error_rad) else float('nan')

    @property
    def independent(self) -> float:
        """Number of spans without overlap that would determine the rms as well (Satterthwaite 1946)."""
        apart_s = np.abs(self.start_s[:, None] - self.start_s)
        shared = np.maximum(1.0 - apart_s / self.span_s, 0.0)
        return float(len(self.start_s) ** 2 / np.sum(shared**2)) if len(self.start_s) else 0.0

    @property
    def interval_deg(self) -> tuple[float, float]:
        """Interval (90 %) of the rms of very many such spans, by the chi-square distribution.

        The upper end is infinite where all spans together are hardly more than one.
        """
        if not len(self.error_rad):
            return float('nan'), float('nan')
        dof = self.independent
        least, most = (chi_square_quantile(tail, dof) / dof for tail in (TAIL, 1.0 - TAIL))
        high = self.rms_deg / math.sqrt(least) if dof >= MIN_INDEPENDENT else float('inf')
        return self.rms_deg / math.sqrt(most), high


def reference_heading(run: Run) -> tuple[Heading, str]:
    """Return the heading to compare with, and its name in `REFERENCES`: ground truth that can be right.

    It has witnesses against it where the gyro, with nothing fitted, drifts away from it and not from the map.
    """
    truth, slam = truth_heading(run), slam_path(run)
    own = Heading(slam.time_s, slam.yaw_rad), 'slam' if run.rig.camera is not None else 'heading reference'
    if truth is None or is_contradicted((truth, TRUTH), own, run):
        return own
    return truth, TRUTH


def is_contradicted(truth: tuple[Heading, str], own: tuple[Heading, str], run: Run) -> bool:
    """Return True if the gyro drifts from the ground truth far more than from the run's own heading."""
    from_s = held_out_from_s(run)
    by_truth, by_own = (blind_drift(run, reference, from_s) for reference in (truth, own))
    if not (len(by_truth.error_rad) and len(by_own.error_rad)):
        return False
    explained_deg = max(by_own.rms_deg, drift_by_noise_deg(run, by_truth))
    return by_truth.rms_deg > MAX_DRIFT_RATIO * explained_deg


@dataclass(frozen=True, slots=True, eq=False)
class HeadingError:
    """Heading by the filter less the ground truth, aligned where the map begins."""

    time_s: Array
    """(s,) steps of the filter with ground truth."""
    error_rad: Array
    std_rad: Array
    """(s,) standard deviation by the filter."""


def heading_error(run: Run) -> HeadingError | None:
    """Return the heading error of the filter against the ground truth; None without ground truth."""
    truth = truth_heading(run)
    if truth is None:
        return None
    slam = slam_path(run)
    inside = (slam.time_s >= truth.time_s[0]) & (slam.time_s <= truth.time_s[-1])
    inside &= is_known(truth, slam.time_s)
    time_s = slam.time_s[inside]
    error = slam.yaw_rad[inside] - np.interp(time_s, truth.time_s, truth.yaw_rad)
    return HeadingError(time_s, error, run.history.std[inside, YAW])


def heading_rms_deg(run: Run) -> float | None:
    """Return the rms heading error of the filter against the ground truth; None without ground truth."""
    error = heading_error(run)
    return None if error is None else float(np.degrees(np.sqrt(np.mean(error.error_rad**2))))


def turns(run: Run, coefficients: Array) -> Array:
    """Return the turn of each step (s,) by the gyro with the given coefficients (k,), without the bias.

    Exact for effects that are linear in their coefficients, first order for the others.
    """
    history = run.history
    changed = np.einsum('sk,sk->s', history.columns, coefficients - history.coefficients)
    return history.turn_rad + history.correction_rad + history.tilt_rad + changed


def dead_reckoning(run: Run, coefficients: Array, bias_rad_s: float) -> Trajectory2D:
    """Return the trajectory by gyro and wheels alone, with fixed coefficients and bias."""
    history = run.history
    increments = turns(run, coefficients) + bias_rad_s * history.gyro_valid_s
    position_m, yaw_rad = planar_trajectory(history.mean[0, YAW], increments, history.distance_m)
    return Trajectory2D(history.time_s, position_m, yaw_rad)


def blind_drift(
    run: Run,
    reference: tuple[Heading, str] | None = None,
    from_s: float = SETTLING_S,
    span_s: float = SPAN_S,
    coefficients: Array | None = None,
) -> BlindDrift:
    """Compute the heading errors at the ends of spans without the camera, all over the run.

    A span starts with the filter's heading, bias and coefficients of that moment, so nothing was fitted on
    what follows. Then the gyro is alone, except at rest, where the robot knows that it does not turn. Spans
    with missing IMU samples or a step of the clock do not count, nor do those at whose end the run's own
    heading is that of the gyro, or in which it is off by a knock of the camera.

    Args:
        run: a finished run.
        reference: heading to compare with, and its name; None for the run's own.
        from_s: earliest beginning of a span.
        span_s: length of a span.
        coefficients: (k,) coefficients in place of those that were known at the beginning of each span: the
            final ones, which were fitted on the spans, too, or those of another recording.
    """
    history = run.history
    time_s, moving = history.time_s, history.resting == 0
    compared, name = reference if reference is not None else reference_heading(run)
    # The turn of a step is (without coefficients) + columns @ coefficients, summed up over spans.
    without = history.turn_rad + history.correction_rad + history.tilt_rad
    without = without - np.einsum('sk,sk->s', history.columns, history.coefficients)
    turned = np.cumsum(np.where(moving, without, 0.0))
    columns = np.cumsum(np.where(moving[:, None], history.columns, 0.0), axis=0)
    gyro_valid_s = np.cumsum(np.where(moving, history.gyro_valid_s, 0.0))
    latest = min(time_s[-1], compared.time_s[-1]) - span_s
    start_s = np.arange(from_s, max(latest, from_s - 1.0), STRIDE_S)
    first, last = np.searchsorted(time_s, start_s), np.searchsorted(time_s, start_s + span_s)
    gap_s, knocks = np.cumsum(history.gap_s), np.cumsum(knocked_steps(run))
    bases = np.cumsum(new_time_bases(history))
    whole = (gap_s[last] == gap_s[first]) & (bases[last] == bases[first])
    seen = is_known(compared, time_s[last])
    if name != TRUTH:
        seen = (time_s[last] - last_seen_s(history)[last] <= SEEN_S) & (knocks[last] == knocks[first])
    counts, unseen = whole & seen, int(np.count_nonzero(whole & ~seen))
    start_s, first, last = start_s[counts], first[counts], last[counts]
    known, bias = history.coefficients[first], history.mean[first, YAW_BIAS]
    if coefficients is not None:
        bias = bias - np.sum(_rate_at_rest(history)[first] * (coefficients - known), axis=1)
        known = np.broadcast_to(coefficients, known.shape)
    by_gyro = turned[last] - turned[first]
    by_gyro += np.sum((columns[last] - columns[first]) * known, axis=1)
    by_gyro += bias * (gyro_valid_s[last] - gyro_valid_s[first])
    heading = np.interp(time_s, compared.time_s, compared.yaw_rad)
    return BlindDrift(span_s, start_s, by_gyro - (heading[last] - heading[first]), name, unseen)


def drift_by_noise_deg(run: Run, drift: BlindDrift) -> float:
    """Return the rms blind drift that noise explains; NaN where there is no span.

    It adds the headings at both ends, the white noise and the bias walk of the gyro, turns that it could not
    read, the uncertainty of bias and coefficients at the beginning of each span, and turns of the camera
    against the robot. A bias that walks by more than the settings say is no such noise: an effect may be
    behind it.
    """
    history = run.history
    noise = yaw_noise_of(run.model, run.config.gyro, history.turn_rad / history.dt_s)
    moving = history.resting == 0
    first = np.searchsorted(history.time_s, drift.start_s)
    last = np.searchsorted(history.time_s, drift.start_s + drift.span_s)
    valid_s = np.cumsum(np.where(moving, history.gyro_valid_s, 0.0))
    columns = np.cumsum(np.where(moving[:, None], history.columns, 0.0), axis=0)
    span_s = valid_s[last] - valid_s[first]
    variance = history.std[first, YAW] ** 2 + history.std[last, YAW] ** 2
    white = np.cumsum(np.where(moving, noise.density_rad_s**2 * history.gyro_valid_s, 0.0))
    variance += white[last] - white[first]
    unread = np.cumsum(_unread_variance(np.where(moving, history.unobserved_turn_std_rad, 0.0)))
    variance += unread[last] - unread[first]
    variance += noise.bias_walk_rad_s**2 * span_s**3 / 3.0
    bias_std = history.std[:, YAW_BIAS]
    if (history.bias_walk > 1.0).any():
        bias_std = np.minimum.accumulate(bias_std)
    variance += (bias_std[first] * span_s) ** 2
    by_coefficients = (columns[last] - columns[first]) * history.std[first, COEFFICIENTS_START:]
    variance += np.sum(by_coefficients**2, axis=1) + turn_against_body_rad(run) ** 2
    return float(np.degrees(np.sqrt(np.mean(variance)))) if len(variance) else math.nan


def turn_against_body_rad(run: Run) -> float:
    """Return by how much the camera may turn against the robot, by the effects in the model.

    The heading of the map is that of the camera, and where it lies in its play is not known exactly.
    """
    ends = np.cumsum([len(effect.coefficients) for effect in run.model.effects])
    parts = np.split(run.state.coefficients, ends[:-1])
    pairs = zip(run.model.effects, parts, strict=True)
    moved = [item.turn_against_body_rad(part) for item, part in pairs if isinstance(item, MovesAgainstBody)]
    return float(sum(moved))


def _unread_variance(unread_rad: Array) -> Array:
    """Return the variance (s,) of turns whose error (s,) is one and the same from step to step.

    It is counted at the last step of each stretch of them.
    """
    total_rad, is_unread = np.cumsum(unread_rad), unread_rad > 0.0
    ends = np.flatnonzero(is_unread & ~np.append(is_unread[1:], False))
    variance = np.zeros_like(unread_rad)
    variance[ends] = np.diff(total_rad[ends], prepend=0.0) ** 2
    return variance


def new_time_bases(history: History) -> Array:
    """Return True (s,) for the first steps after steps of the clock, at which pose and map begin again."""
    apart_s = np.diff(history.t_ns) / NS_PER_S - np.diff(history.time_s)
    return np.append(False, np.abs(apart_s) > STEPPED_S)[: len(history.t_ns)]


def last_seen_s(history: History) -> Array:
    """Return the time (s,) at which an image or a heading last told the heading; -inf before the first."""
    tells = (history.in_view > history.rejected) | (history.dof > 0)
    latest: Array = np.maximum.accumulate(np.where(tells, history.time_s, -np.inf))
    return latest


def _rate_at_rest(history: History) -> Array:
    """Return the rate (s, k) that each coefficient gives per unit at the last rest before each step.

    There bias and coefficients together are known: with other coefficients the bias is another one. Zero
    before the first rest.
    """
    is_known = (history.resting != 0) & (history.gyro_valid_s > 0.0)
    rates = history.columns / np.where(is_known, history.gyro_valid_s, np.inf)[:, None]
    latest = np.maximum.accumulate(np.where(is_known, np.arange(len(is_known)), 0))
    latest_rates: Array = rates[latest]
    return latest_rates


def held_out_from_s(run: Run) -> float:
    """Return the beginning of the held-out spans: the second half, or earlier in a short run.

    Before a change of the scale factor that the filter followed, another one was believed. Without ground
    truth nothing tells the heading once the images have ended.
    """
    history = run.history
    end_s = float(history.time_s[-1] if run.truth is not None else max(last_seen_s(history)[-1], 0.0))
    followed = history.scale_followed.nonzero()[0]
    changed_s = float(history.time_s[followed[-1]]) if len(followed) else 0.0
    return max(SETTLING_S, changed_s, min(0.5 * end_s, end_s - SPAN_S - 3.0 * STRIDE_S))


def calibrated_from_s(run: Run, convergence_time_s: float | None) -> float:
    """Return where the held-out spans of a calibrated gyro begin, or all of them if there are none.

    Args:
        run: a finished run.
        convergence_time_s: since when its gyro is calibrated; None if it is not.
    """
    from_s = held_out_from_s(run)
    since_s = max(from_s, convergence_time_s or 0.0)
    return since_s if len(blind_drift(run, from_s=since_s).start_s) else from_s


def drift_of_both_deg(before: Run, after: Run, from_s: float = 0.0) -> tuple[float, float]:
    """Return the held-out blind drift of two runs against one reference, that of the second; NaN without.

    Args:
        before: a finished run.
        after: another one of the same recording.
        from_s: earliest beginning of a span, where it is later than that of all held-out spans.
    """
    earlier, later = drift_of_both(before, after, from_s)
    return earlier.rms_deg, later.rms_deg


def drift_of_both(before: Run, after: Run, from_s: float = 0.0) -> tuple[BlindDrift, BlindDrift]:
    """Compute what `drift_of_both_deg` returns the rms of."""
    reference, start_s = reference_heading(after), max(held_out_from_s(after), from_s)
    return blind_drift(before, reference, start_s), blind_drift(after, reference, start_s)


def better_sigma(before: BlindDrift, after: BlindDrift) -> float:
    """Return by how many sigma the drift became smaller; NaN where there is no span.

    The logarithm of a mean of squares over n spans has the variance trigamma(n / 2). Errors of the same
    spans are correlated, so this is conservative.
    """
    if not len(before.error_rad) or not len(after.error_rad) or not after.rms_deg > 0.0:
        return float('nan')
    scatter = sum(trigamma(0.5 * drift.independent) for drift in (before, after)) ** 0.5
    return 2.0 * float(np.log(before.rms_deg / after.rms_deg)) / scatter


def drifts_more(before: BlindDrift, after: BlindDrift) -> bool:
    """Return True if the drift is more likely than not to be larger after a noise was added."""
    return better_sigma(before, after) < -MORE_SIGMA
