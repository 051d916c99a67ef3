"""Scatter of the estimates over stretches of a run, for standard deviations that survive model errors.

Where the model is right, the changes of an estimate by the measurements are independent, and their variance
is the decrease of the filter's own variance. Where the model lacks an effect, or successive errors are not
independent, the changes over stretches of some seconds are larger. Their ratio is the factor by which the
filter's variance is too small.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW_BIAS
from gyrocal_ros.ekf.watches.scale_watch import NOTICED_S, SETTLE_S
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.statistics import chi_square_tail

STRETCH_S = 10.0
ROUNDING_S = 1e-6
FORMING = 0.75
"""Part of its variance by which a stretch, such as the first turn, forms the estimate. The filter is not
linear there, so the stretch does not count; nor does the first one."""

PRIOR_STRETCHES = 3
"""Stretches for which the filter's own variance counts in the verdict: few are larger by chance."""
MIN_STRETCHES = 3
"""Fewest stretches by which the model is judged."""
MAX_INFLATION = 4.0
CHANCE = 1e-6
"""Inflation, and its probability by chance, from which the model does not fit. Points that slide along edges
inflate by up to 3, effects that cost half a degree of blind drift by 6 and more."""
TRACE = 0.1
"""Part of the least usual size of a coefficient that turns no heading, such as the readout of a camera."""


class Scatter:
    """Compares the changes of estimates with their predicted variance, in constant memory.

    Args:
        traces: (count,) changes of the estimates up to which they do not matter, see `traces`.
    """

    def __init__(self, traces: Array) -> None:
        self._traces, self._stretch = traces, 0
        self._change, self._decrease = np.zeros_like(traces), np.zeros_like(traces)
        self._variance: Array = np.zeros_like(traces)
        self._ratios, self._stretches = np.zeros_like(traces), np.zeros_like(traces)
        self._squares = np.zeros_like(traces)
        self.inflation: Array = np.ones_like(traces)
        """(count,) factors, 1 or more, on the standard deviations of the filter."""

    def add(self, time_s: float, change: Array, decrease: Array, variance: Array) -> None:
        """Add one step of the filter.

        Args:
            time_s: time of the step.
            change: (count,) changes of the estimates by its measurements.
            decrease: (count,) decrease of their variances by them.
            variance: (count,) their variances after the step.
        """
        stretch = int((time_s + ROUNDING_S) / STRETCH_S)
        if stretch != self._stretch:
            self._end_stretch()
            self._stretch = stretch
        self._change += change
        self._decrease += decrease
        self._variance = variance

    @property
    def is_judged(self) -> bool:
        """True if there are enough stretches to tell whether the model fits."""
        return bool(self._stretches.max() >= MIN_STRETCHES)

    @property
    def contradicts(self) -> bool:
        """True if some estimate scatters far more than the filter expects: the model lacks something."""
        ratios, stretches = PRIOR_STRETCHES + self._ratios, PRIOR_STRETCHES + self._stretches
        large = (ratios > MAX_INFLATION**2 * stretches) & (self._stretches >= MIN_STRETCHES)
        large &= self._squares > self._traces**2 * self._stretches
        tails = (
            chi_square_tail(float(self._ratios[i]), float(self._stretches[i])) for i in np.flatnonzero(large)
        )
        return any(tail < CHANCE for tail in tails)

    def _end_stretch(self) -> None:
        before = self._variance + self._decrease
        counts = (self._decrease > 0.0) & (self._decrease < FORMING * before) & (self._stretch > 0)
        self._ratios[counts] += self._change[counts] ** 2 / self._decrease[counts]
        self._squares[counts] += self._change[counts] ** 2
        self._stretches[counts] += 1.0
        self.inflation = inflation(self._ratios, self._stretches)
        self._change, self._decrease = np.zeros_like(self._change), np.zeros_like(self._decrease)


def inflation(ratios: Array, stretches: Array) -> Array:
    """Return the factors (count,), 1 or more, on standard deviations.

    Of the excess of the mean ratio, the part that chance explains is taken away (empirical Bayes, Morris
    1983). It counts from 1.4 times its standard deviation, the price of one more parameter (Akaike 1974), or
    every clean recording would pay.

    Args:
        ratios: (count,) sums of the squared changes over their predicted variances.
        stretches: (count,) numbers of stretches in these sums.
    """
    stretches = np.maximum(stretches, 1.0)
    excess = ratios / stretches - 1.0
    by_chance = 2.0 * (2.0 / stretches)  # 2 / n is the variance of a mean of n ratios
    least = np.sqrt(by_chance)
    factors: Array = np.sqrt(1.0 + np.maximum(0.0, excess - by_chance / np.maximum(excess, least)))
    return factors


def traces(model: SensorModel) -> Array:
    """Return the changes (1 + k,) of bias and coefficients that do not matter.

    Zero for bias and gyro, whose errors turn the heading. What a camera or wheels have may be known to a
    thousandth, less than the slow errors of a tracker.
    """
    usual = [
        item.typical.low if effect.acts_on != 'gyro' and item.typical is not None else 0.0
        for effect in model.effects
        for item in effect.coefficients
    ]
    return TRACE * np.array([0.0, *usual])


def scatter_of(run: Run) -> tuple[Scatter, Array]:
    """Return the scatter of yaw bias and coefficients over a run, and the inflation (s, 1 + k) of their stds.

    By how much the scale factor has changed adds to its standard deviation, if the filter did not follow; so
    does what is suspected of the camera and of a drift. What contradicted the filter before it followed a
    change, or expected a larger walk of the bias, says nothing of the time after.
    """
    history, least = run.history, traces(run.model)
    begins = begins_again(history)
    variances = history.std[:, YAW_BIAS:] ** 2
    scatter, inflations = Scatter(least), np.ones_like(variances)
    columns = (history.time_s, history.change, history.change_variance, variances)
    for i, step in enumerate(zip(*columns, strict=True)):
        if begins[i]:
            scatter = Scatter(least)
        else:
            scatter.add(*step)
        inflations[i] = scatter.inflation
    left = left_of_changes(history, inflations[:, SCALE])
    changed = np.maximum(np.abs(history.scale_change), left)
    inflations[:, SCALE] = np.hypot(inflations[:, SCALE], changed / history.std[:, COEFFICIENTS_START])
    return scatter, with_suspected(inflations, history.suspected_std, history.std[:, YAW_BIAS:])


def begins_again(history: History) -> np.ndarray:
    """Return (s,) True where the filter follows a change of the scale factor, or expects a larger walk."""
    largest = np.maximum.accumulate(history.bias_walk)
    begins: np.ndarray = (history.scale_followed > 0) | (np.diff(largest, prepend=1.0) > 0.0)
    return begins


def left_of_changes(history: History, inflation: Array) -> Array:
    """Return (s,) root mean square errors of the scale factor by changes that the filter did not follow.

    A change that was significant for less than `SETTLE_S` of measurements, as in a first turn or before the
    light went out, leaves nothing. Any other may have left an error of its own size when it was last
    significant. By the measurements since, the filter corrects all but a share r of it, so the estimate
    moves by 1 - r of the error. How much it has moved therefore measures the error, with the change as
    prior; in the end, only what came later counts. The
    largest of several changes stays: a scale factor that changes again is not constant.

    Args:
        history: s steps.
        inflation: (s,) factors on the standard deviations by the scatter.
    """
    scale, change = COEFFICIENTS_START, np.abs(history.scale_change)
    measured_s = np.cumsum(np.diff(history.time_s, prepend=0.0) * (history.dof > 0))
    unchanged_s = np.maximum.accumulate(np.where(change > 0.0, 0.0, measured_s))
    lasting = np.where(measured_s - unchanged_s >= SETTLE_S - NOTICED_S, change, 0.0)
    last = np.maximum.accumulate(np.where(lasting > 0.0, np.arange(len(lasting)), 0))
    parts = np.split(lasting, np.flatnonzero(begins_again(history)))
    largest = np.concatenate([np.maximum.accumulate(part) for part in parts])
    begins = [(part > 0.0) & (np.roll(part, 1) == 0.0) for part in parts]
    is_repeated = np.concatenate([np.cumsum(begin) > 1 for begin in begins])

    variance, decrease = history.std[:, scale] ** 2, history.change_variance[:, SCALE]
    logarithm = np.cumsum(np.log(variance / (variance + decrease)))
    # An update that considers effects, and does not correct them, may know less than before.
    share = np.minimum(np.exp(logarithm - logarithm[last]), 1.0)
    moved, variance_then = history.mean[:, scale] - history.mean[last, scale], inflation**2 * variance[last]
    gain = largest**2 / (largest**2 * (1.0 - share) + variance_then)
    fading = share * np.sqrt(gain * variance_then + (gain * moved) ** 2)
    errors: Array = np.where(is_repeated, largest, fading)
    return errors


def with_suspected(inflation: Array, suspected_std: Array, std: Array) -> Array:
    """Add standard deviations of suspected errors to factors on standard deviations."""
    relative = np.divide(suspected_std, std, out=np.zeros_like(std), where=std > 0.0)
    total: Array = np.hypot(inflation, relative)
    return total
