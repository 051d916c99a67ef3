"""Is the gyro noisier than the settings say? Filters with other noise, side by side with the filter.

The filter believes the noise of its settings, and its standard deviations are as wrong as these. What the
measurements of a few seconds say of yaw bias and coefficients follows from the estimates before and after
them. Small filters of these alone take it in, one for each of several alternatives of the white noise and of
the random walk of the bias (multiple-model estimation, Magill 1965). The expected squared error of the
estimate over the alternatives, each as likely as it predicts the measurements, tells by how much its variance
is too small. A larger random walk that is certain may be told to the filter, which then expects it.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.state.layout import YAW_BIAS, State
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.kernels import compiled
from gyrocal_ros.statistics import chi_square_quantile

WINDOW_S = 5.0
"""Time whose measurements count together: errors of the heading at its ends hardly matter then."""
WHITE, WALK = (0.25, 0.5, 1.0, 2.0, 4.0), (1.0 / 16.0, 0.25, 1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
"""Variances of the white noise and of the random walk of the bias, relative to those of the settings."""
USUAL_FACTOR = 2.0
"""Factor on a standard deviation of the settings within which most gyros are: one standard deviation."""
FORMING = 0.75
"""Part of a variance by which a window, such as the first turn, forms an estimate. The filter is not linear
there, so it says nothing of the noise."""
LEAST_TOLD = 1e-6
"""Part of a variance that a window has to take away to say anything."""
OUTLYING = 1e-4
"""Probability by chance of what the measurements of a window say, from which they count no more."""
CERTAIN = 0.99
"""Probability from which the bias is said to walk more than the settings say."""
MUCH_WALK = 4.0
"""Random walk of the bias, relative to the settings, that a user should know of: gyros differ by two."""
GROWN = 1.5
"""Variance, relative to the expected one, from which the filter has let an estimate go."""

_WHITE, _WALK = (axis.ravel() for axis in np.meshgrid(WHITE, WALK))
_AS_SET = int(np.flatnonzero((_WHITE == 1.0) & (_WALK == 1.0))[0])
_LOG_PRIOR = -0.5 * sum((0.5 * np.log(ratio) / math.log(USUAL_FACTOR)) ** 2 for ratio in (_WHITE, _WALK))


def walks_more(relative: float, qualifier: str = '') -> str:
    """Return what is wrong with the setting of the walk, as a clause, with words such as `at least `."""
    times = f'{qualifier}{relative:.0f} times'
    return f'the bias of the gyro walks {times} as much as the setting gyro.bias_walk_deg_s'


class NoiseBank:
    """Compares a = 40 alternatives of the noise of the gyro.

    Args:
        state: initial state of the filter.
        follows: True if the filter expects the `walk` that is found.
    """

    def __init__(self, state: State, *, follows: bool = False) -> None:
        self._log_likelihoods = np.zeros(len(_WHITE))
        self.least_walk = self.walk = 1.0
        """Random walk of the bias, relative to that of the settings, that is certain, and the likeliest; 1 or
        more."""
        self._follows = follows
        self._relative_std: Array = np.zeros(1 + state.coefficient_count)
        self._places = YAW_BIAS + np.flatnonzero(state.covariance.diagonal()[YAW_BIAS : state.robot_size])
        self._last: Array = self._variances(state)
        self._grown: Array = np.zeros_like(self._last)
        self.begin(state)

    @property
    def weights(self) -> Array:
        """(a,) probabilities of the alternatives."""
        log_weights = _LOG_PRIOR + self._log_likelihoods
        weights: Array = np.exp(log_weights - log_weights.max())
        return weights / weights.sum()

    def begin(self, state: State) -> None:
        """Begin with an estimate of the filter that holds whatever the noise is."""
        mean, covariance = self._learned(state)
        self._expect(mean, covariance)
        self._means: Array = np.tile(mean, (len(_WHITE), 1))
        self._covariances: Array = np.tile(covariance, (len(_WHITE), 1, 1))
        self._relative_std[:] = 0.0
        self._time_s = 0.0

    def add(self, predicted: State, state: State, duration_s: float, explained: float = 0.0) -> None:
        """Take a step of the filter.

        Args:
            predicted: the predicted state.
            state: after the measurements.
            duration_s: length of the step.
            explained: part of the NIS that another error explains: a walk that explains less is none.
        """
        # Random walks, and what ageing and warming add at the start.
        self._grown = variances_grown(self._grown, self._last, predicted.covariance, self._places)
        self._last = self._variances(state)
        self._time_s += duration_s
        if self._time_s < WINDOW_S:
            return
        mean, covariance = self._learned(state)
        expected = self._covariance + np.diag(self._grown)
        if (covariance.diagonal() > GROWN * expected.diagonal()).any():
            self.begin(state)
            return
        self._update(mean - self._mean, covariance, expected)
        self._expect(mean, covariance)
        self._time_s = 0.0
        errors = self._covariances.diagonal(axis1=1, axis2=2) + (self._means - mean) ** 2
        weights = self.weights
        if self.explained >= explained:
            self.least_walk = self._walk_by(weights, CERTAIN)
        if self._follows and self.explained >= explained:
            self.walk = self._walk_by(weights, 0.5) if self.least_walk > 1.0 else 1.0
        excess = weights @ errors / covariance.diagonal() - 1.0
        self._relative_std[self._places - YAW_BIAS] = np.sqrt(np.maximum(excess, 0.0))

    def unexpected_std(self, state: State) -> Array:
        """Return the standard deviations (1 + k,) of the errors by noise that the filter does not expect."""
        std: Array = self._relative_std * np.sqrt(state.covariance.diagonal()[YAW_BIAS : state.robot_size])
        return std

    @property
    def explained(self) -> float:
        """Part of the NIS that the likeliest noise explains beyond that of the settings."""
        return 2.0 * float(self._log_likelihoods.max() - self._log_likelihoods[_AS_SET])

    @staticmethod
    def _walk_by(weights: Array, probability: float) -> float:
        """Return the largest walk that is exceeded, or met, with a probability; at least 1."""
        return math.sqrt(max(1.0, *(walk for walk in WALK if weights[walk <= _WALK].sum() >= probability)))

    def _learned(self, state: State) -> tuple[Array, Array]:
        """Return mean (d,) and covariance of yaw bias and coefficients that are not known exactly."""
        places = self._places
        return state.mean[places], state.covariance[np.ix_(places, places)]

    def _variances(self, state: State) -> Array:
        """Return the variances (d,) of the same."""
        return state.covariance.diagonal()[self._places]

    def _expect(self, mean: Array, covariance: Array) -> None:
        """Remember the estimate of the filter before the measurements of a window."""
        self._mean: Array = mean
        self._covariance: Array = covariance
        self._last = covariance.diagonal()
        self._grown = np.zeros_like(mean)

    def _update(self, change: Array, covariance: Array, expected: Array) -> None:
        """Update all alternatives by what the measurements of a window say.

        In coordinates T x in which `expected` is the unit matrix and `covariance` is diagonal, with b < 1 on
        the diagonal, each is measured by itself: with variance b / (1 - b), and the value that moves the
        estimate of the filter by its change.

        Args:
            change: (d,) of that estimate.
            covariance: (d, d) after the measurements.
            expected: (d, d) before them.

        Raises:
            FilterDivergedError: `expected` is not positive definite.
        """
        whitening = whitener(expected)
        left, axes = np.linalg.eigh(whitening @ covariance @ whitening.T)
        told = left < 1.0 - LEAST_TOLD
        left, T = np.maximum(left[told], LEAST_TOLD), axes.T[told] @ whitening

        grown, each = np.tile(self._grown, (len(_WALK), 1)), np.arange(len(change))
        grown[:, 0] *= _WALK / self.walk**2  # the bias is the first
        self._covariances[:, each, each] += grown
        residual = T @ change / (1.0 - left) - (self._means - self._mean) @ T.T
        numerator = T @ self._covariances
        S = numerator @ T.T + (_WHITE[:, None] * left / (1.0 - left))[:, :, None] * np.eye(len(left))
        precision = np.linalg.inv(S)
        gain = numerator.transpose(0, 2, 1) @ precision
        self._means = self._means + (gain @ residual[:, :, None])[:, :, 0]
        self._covariances = self._covariances - gain @ numerator

        if len(left) and (left > 1.0 - FORMING).all():
            distances = np.einsum('ai,aij,aj->a', residual, precision, residual)
            largest = chi_square_quantile(1.0 - OUTLYING, len(left))
            log_determinants = np.linalg.slogdet(S)[1]
            self._log_likelihoods -= 0.5 * (np.minimum(distances, largest) + log_determinants)


@compiled
def variances_grown(grown: Array, before: Array, expected: Array, places: IntArray) -> Array:
    """Return by how much variances (d,) have grown, after one more prediction.

    Args:
        grown: (d,) so far.
        before: (d,) variances before the prediction.
        expected: (n, n) predicted covariance.
        places: (d,) indices in it.
    """
    return grown + np.maximum(expected[places, places] - before, 0.0)
