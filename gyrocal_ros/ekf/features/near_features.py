"""Features nearer than their prior depth: below tables and beds.

The prior of an inverse depth is that of a ceiling. A robot below a table sees a board at a fifth of that
distance, which is six standard deviations off: its features would contradict the map and bend the pose. The
prior has a heavy tail to the near side: where a feature of which hardly more than the prior is known is not
where the map expects it, and a smaller depth explains that, the depth is unknown.
"""

from __future__ import annotations

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import IntArray
from gyrocal_ros.ekf.equations.update import Innovation, own_precisions
from gyrocal_ros.ekf.features.judged import mahalanobis
from gyrocal_ros.ekf.state.layout import State, with_further_errors
from gyrocal_ros.kernels import compiled
from gyrocal_ros.statistics import chi_square_quantile

NEAR_STD_1_M = 2.0
"""Standard deviation of the inverse depth of a near feature: from 0.2 m on."""
HARDLY_KNOWN = 0.5
"""Standard deviation of an inverse depth, relative to its prior, from which it is hardly known."""
DEPTH = 2
"""Place of the inverse depth among the parameters of a feature."""


def with_near_features(state: State, innovation: Innovation, config: FeatureConfig) -> State:
    """Return the state in which features that are nearer than expected have unknown depths; itself without.

    Args:
        state: predicted.
        innovation: of m features, anchored inverse depths.
        config: prior of an inverse depth, and probability of a gate.
    """
    uncertain = hardly_known(state, innovation.rows, HARDLY_KNOWN * config.prior_inverse_depth_std)
    if not len(uncertain):
        return state
    precisions = own_precisions(innovation)
    residual, by_depth = innovation.residual, innovation.prediction.by_feature[:, :, DEPTH]
    distances = mahalanobis(residual, precisions)
    weighted = (precisions @ by_depth[:, :, None])[:, :, 0]
    score, information = (residual * weighted).sum(axis=1), (by_depth * weighted).sum(axis=1)
    # The lemma of Woodbury gives what is left of a distance where the depth is uncertain by that much more.
    left = distances - score**2 / (information + NEAR_STD_1_M**-2)
    gate = chi_square_quantile(1.0 - config.outlier_probability, residual.shape[1])
    are_near = (distances > gate) & (score > 0.0) & (left <= gate)
    near = innovation.rows[uncertain[are_near[uncertain]]]
    places = state.robot_size + 3 * near + DEPTH
    return with_further_errors(state, places, NEAR_STD_1_M) if len(near) else state


@compiled
def hardly_known(state: State, rows: IntArray, least: float) -> IntArray:
    """Return which of m features have an inverse depth with at least this standard deviation, as indices.

    Args:
        state: features are anchored inverse depths.
        rows: (m,) their indices in the map.
        least: 1/m
    """
    places = state.robot_size + 3 * rows + DEPTH
    uncertain: IntArray = (state.covariance[places, places] > least**2).nonzero()[0]
    return uncertain
