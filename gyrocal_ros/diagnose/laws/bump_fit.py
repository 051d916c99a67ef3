"""From a learned map of the bias to its closed form: the place of a disturbance and its width."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.laws.closed_forms import SINGULAR, Seen, estimate_in, seen_in, without_present
from gyrocal_ros.effects.learned.bump import bumps
from gyrocal_ros.effects.learned.place_map import PlaceMap

POINTS = 600
"""Number of positions of the path at which map and bump are compared."""
PLACES, WIDTHS = 15, np.array([0.05, 0.08, 0.12, 0.2, 0.3])
"""Number of places along x and along y that are tried, and the widths, as parts of the room."""
REFINEMENTS, AROUND = 6, np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""How often the neighbourhood of the best bump is searched, each time half as wide, and where."""


@dataclass(frozen=True, slots=True)
class BumpFit:
    """A bump that was fitted to a map."""

    height: float
    std: float
    """Height and its standard deviation at this place and width, rad/s."""
    x_m: float
    y_m: float
    width_m: float
    explained: float
    """Part of the log-likelihood of the map that the bump gains."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnedMap:
    """A map on the path of the robot, with the estimates of its coefficients."""

    effect: PlaceMap
    x: Array
    """(n, 2) positions."""
    values: Array
    covariance: Array
    """(k,), (k, k) of its coefficients, by the filter."""
    scatter: float


def bump_fit(examined: ExaminedModel, effect: PlaceMap) -> BumpFit:
    """Fit a bump to a learned map: only the data count, see `closed_forms`.

    Args:
        examined: a model with the map.
        effect: the map.
    """
    path = examined.run.history.mean[:, :2]
    found = LearnedMap(effect, path[:: max(len(path) // POINTS, 1)], *estimate_in(examined, effect))
    seen = seen_in(found)
    low, high = np.array([effect.x_low_m, effect.y_low_m]), np.array([effect.x_high_m, effect.y_high_m])
    size = float(np.max(high - low))
    places = [np.linspace(*ends, PLACES) for ends in zip(low.tolist(), high.tolist(), strict=True)]
    tried = np.array(list(product(*places, WIDTHS * size)))
    steps = np.array([size / PLACES, size / PLACES, 0.0])
    best = _best(found, seen, tried)
    for _ in range(REFINEMENTS):
        steps[2] = steps[2] or 0.4 * best.width_m
        at = np.array([best.x_m, best.y_m, best.width_m])
        tried = at + np.array(list(product(*(AROUND * step for step in steps))))
        best = _best(found, seen, tried[tried[:, 2] > 0.0])
        steps *= 0.5
    return best


def _best(found: LearnedMap, seen: Seen, tried: Array) -> BumpFit:
    """Return the best of some bumps (q, 3)."""
    mixing = seen.directions(without_present(found, bumps(found.x, tried)))
    information = np.einsum('sq,s,sq->q', mixing, seen.information, mixing)
    along = mixing.T @ seen.score
    known = information > SINGULAR * information.max()
    gains = np.where(known, 0.5 * np.square(along) / np.where(known, information, 1.0), 0.0)
    best = int(np.argmax(gains))
    most = 0.5 * float(np.sum(seen.score**2 / seen.information))
    x_m, y_m, width_m = tried[best].tolist()
    return BumpFit(
        height=float(along[best] / information[best]),
        std=float(information[best] ** -0.5),
        x_m=x_m,
        y_m=y_m,
        width_m=width_m,
        explained=float(gains[best]) / most,
    )
