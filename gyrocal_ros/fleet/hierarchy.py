"""Hierarchical model of one coefficient over a fleet: robots and bags differ, errors are known.

    y_rb = x_rb' beta + u_r + w_rb + e_rb,   u_r ~ N(0, tau^2),  w_rb ~ N(0, omega^2),  e_rb ~ N(0, s_rb^2)

with robot r, bag b, regressors x (1, age, temperature), part-to-part standard deviation tau, bag-to-bag
standard deviation omega, and the known standard deviations s of the bags. The variances are estimated by
restricted maximum likelihood (Patterson and Thompson 1971; Harville 1977), the robots by the best linear
unbiased prediction (Henderson 1975; Robinson 1991). Linear mixed models of other libraries have no known
error for each observation, which is the heart of this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.statistics import NORMAL_MAD, chi_square_quantile, robust_std

CONFIDENCE = 0.95
FAMILY_ALPHA = 0.05
"""Probability that any robot of a healthy fleet is called out of family (Bonferroni)."""
MAD_EFFICIENCY = 0.37
"""Efficiency of the median absolute deviation (Rousseeuw and Croux 1993), lowers its degrees of freedom."""
MAX_ROUNDS = 10
"""Limit of the rounds in which robots out of family are set aside."""
LARGEST_SPREAD = 100.0
"""Largest standard deviation that is searched, relative to the scatter of the observations."""
MIN_ROBOTS = 3
"""Minimum number of robots from which a spread is estimated."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Estimates of one coefficient, n bags of m robots."""

    value: Array
    """(n,)"""
    std: Array
    """(n,) known standard deviations."""
    robot: IntArray
    """(n,) index of the robot, 0 to m - 1."""
    regressors: Array
    """(n, q) regressors without the constant, relative to their reference."""
    names: tuple[str, ...]
    """Names of the q regressors."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard deviation and its 95 % interval."""

    value: float
    std: float
    low: float
    high: float

    @property
    def sigma(self) -> float:
        """Distance from zero in standard deviations."""
        return abs(self.value) / self.std if self.std > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FleetEstimate:
    """The hierarchical model of one coefficient, fitted to a fleet."""

    mean: Estimate
    """Fleet mean where all regressors are zero."""
    slopes: dict[str, Estimate]
    """Change per unit of each regressor."""
    spread: Estimate
    """Part-to-part standard deviation tau; its `std` is NaN."""
    bag_spread: float
    """Bag-to-bag standard deviation omega, beyond the known errors."""
    robot_value: Array
    """(m,) estimate of each robot, shrunk towards the mean; NaN without observations."""
    robot_std: Array
    """(m,)"""
    robot_z: Array
    """(m,) distance of each robot from the rest of the fleet, in standard deviations."""
    out_of_family: IntArray
    """Indices of robots that chance does not explain; they do not enter mean, spread and slopes."""
    bags: int
    robots: int


def fit_fleet(observed: Observations, *, has_bag_spread: bool = True, looks: int = 1) -> FleetEstimate | None:
    """Fit the model, and set aside robots that are out of family until no further one is.

    The first round starts from a robust spread (median absolute deviation), because faulty robots widen the
    spread that is to unmask them.

    Args:
        observed: the observations; rows that are not finite do not count.
        has_bag_spread: estimate omega; otherwise it is zero. It needs robots with several bags.
        looks: number of coefficients that are looked at, for the threshold of a robot out of family.

    Returns:
        The fit; None for fewer than `MIN_ROBOTS` robots, or as many regressors as robots.
    """
    robots = int(observed.robot.max(initial=-1)) + 1
    usable = np.isfinite(observed.value) & (observed.std > 0.0) & np.isfinite(observed.std)
    usable &= np.isfinite(observed.regressors).all(axis=1)
    data = _rows(observed, np.flatnonzero(usable)[np.argsort(observed.robot[usable], kind='stable')])
    present = np.unique(data.robot)
    if len(present) < MIN_ROBOTS or len(present) <= data.regressors.shape[1] + 1:
        return None
    dof = len(present) - data.regressors.shape[1] - 1
    tail = 0.5 * FAMILY_ALPHA / (len(present) * looks)
    threshold = float(special.stdtrit(dof, 1.0 - tail))
    first = float(special.stdtrit(max(MAD_EFFICIENCY * dof, 1.0), 1.0 - tail))
    outside = _robustly_outside(data, robots, first)
    seen: set[bytes] = set()
    for _ in range(MAX_ROUNDS):
        inside = _rows(data, ~outside[data.robot])
        if len(np.unique(inside.robot)) <= max(MIN_ROBOTS - 1, data.regressors.shape[1] + 1):
            outside = np.zeros(robots, bool)
            inside = data
        solved = _Solution.of(inside, robots, has_bag_spread)
        z = _deleted_z(solved, data, outside)
        following = np.nan_to_num(np.abs(z)) > threshold
        if (following == outside).all() or following.tobytes() in seen:
            break
        seen.add(following.tobytes())
        outside = following
    return _concluded(solved, data, robots, z, np.flatnonzero(outside))


@dataclass(frozen=True, slots=True, eq=False)
class _Grouped:
    """The bags sorted by robot, as the sums over each robot need them."""

    columns: Array
    """(n, p + 1) design X, a one first, and y."""
    variance: Array
    """(n,) s^2"""
    robot: IntArray
    """(g,) indices of the robots that have bags."""
    first: IntArray
    """(g,) first bag of each."""
    robots: int
    """m"""

    def by_robot(self, columns: Array) -> Array:
        """Return the sums (m, q) of columns (n, q) over the bags of each robot."""
        sums = np.zeros((self.robots, columns.shape[1]))
        sums[self.robot] = np.add.reduceat(columns, self.first, axis=0)
        return sums


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums over the bags of each robot, for given variances."""

    weight: Array
    """(m,) W = sum w."""
    x: Array
    """(m, p) sum w x."""
    y: Array
    """(m,) sum w y."""
    kappa: Array
    """(m,) tau^2 / (1 + tau^2 W)."""
    normal: Array
    """(p, p) X' V^-1 X."""
    right: Array
    """(p,) X' V^-1 y."""
    square: float
    """y' V^-1 y."""
    log_det: float
    """log |V|."""


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Estimates of variances and fixed effects."""

    bags: _Grouped
    tau: float
    omega: float
    beta: Array
    covariance: Array
    sums: _Sums
    scale: float

    @classmethod
    def of(cls, data: Observations, robots: int, has_bag_spread: bool) -> _Solution:
        """Maximise the restricted likelihood over both standard deviations."""
        bags = _grouped(data, robots)
        count = np.bincount(data.robot, minlength=robots)
        free = has_bag_spread and int((count > 1).sum()) > 1
        scale = max(robust_std(data.value - np.median(data.value)), float(np.median(data.std)), 1e-300)

        def loss(tau: float, omega: float) -> float:
            return _restricted(_sums(bags, (scale * tau) ** 2, (scale * omega) ** 2))

        if free:
            found = optimize.minimize(
                lambda x: loss(math.exp(x[0]), math.exp(x[1])),
                np.log([0.7, 0.3]),
                method='Nelder-Mead',
                bounds=[(-12.0, math.log(LARGEST_SPREAD))] * 2,
                options={'xatol': 1e-3, 'fatol': 1e-4},
            )
            tau, omega = np.exp(found.x).tolist()
            omega = 0.0 if loss(tau, 0.0) <= found.fun else omega
        else:
            tau, omega = _minimum(lambda tau: loss(tau, 0.0)), 0.0
        tau = 0.0 if loss(0.0, omega) <= loss(tau, omega) else tau
        sums = _sums(bags, (scale * tau) ** 2, (scale * omega) ** 2)
        covariance = np.linalg.inv(sums.normal)
        beta = covariance @ sums.right
        return cls(bags, scale * tau, scale * omega, beta, covariance, sums, scale)

    def interval_of_tau(self) -> tuple[float, float]:
        """Return the profile likelihood interval of tau, omega at its estimate.

        Twice the fall of the restricted log-likelihood has a chi-square distribution with one degree of
        freedom (Hardy and Thompson 1996).
        """

        def loss(tau: float) -> float:
            return _restricted(_sums(self.bags, tau**2, self.omega**2))

        limit = loss(self.tau) + chi_square_quantile(CONFIDENCE, 1.0)

        def above(tau: float) -> float:
            return loss(tau) - limit

        most = LARGEST_SPREAD * self.scale
        low = 0.0 if above(0.0) <= 0.0 else optimize.brentq(above, 0.0, self.tau, xtol=1e-4 * self.scale)
        high = most if above(most) <= 0.0 else optimize.brentq(above, self.tau, most, xtol=1e-4 * self.scale)
        return float(low), float(high)

    def robust_covariance(self) -> Array:
        """Return the covariance of beta by the scatter of the robots, whatever their true distribution.

        The sandwich of Liang and Zeger 1986 with robots as clusters, the scores of each multiplied by
        m / (m - p); it also holds where robots age differently.
        """
        bags, sums, (used, p) = self.bags, self.sums, self._size()
        design, value = bags.columns[:, :-1], bags.columns[:, -1]
        weighted = (value - design @ self.beta) / (bags.variance + self.omega**2)
        plain = bags.by_robot(weighted[:, None] * design)
        scores = plain - (sums.kappa * plain[:, 0])[:, None] * sums.x
        middle = (used / (used - p)) ** 2 * scores.T @ scores
        return self.covariance @ middle @ self.covariance

    def _size(self) -> tuple[int, int]:
        return len(self.bags.robot), len(self.beta)


def _minimum(loss: Callable[[float], float]) -> float:
    """Return the place of the least loss over a standard deviation, on a logarithmic scale."""
    bounds = (-9.0, math.log(LARGEST_SPREAD))
    found = optimize.minimize_scalar(lambda x: loss(math.exp(x)), bounds=bounds, method='bounded')
    return math.exp(float(found.x))


def _rows(data: Observations, kept: np.ndarray) -> Observations:
    return Observations(data.value[kept], data.std[kept], data.robot[kept], data.regressors[kept], data.names)


def _design(data: Observations) -> Array:
    return np.column_stack([np.ones(len(data.value)), data.regressors])


def _grouped(data: Observations, robots: int) -> _Grouped:
    """Return bags that are sorted by robot with the first one of each."""
    robot, first = np.unique(data.robot, return_index=True)
    return _Grouped(np.column_stack([_design(data), data.value]), data.std**2, robot, first, robots)


def _sums(bags: _Grouped, tau2: float, omega2: float) -> _Sums:
    """Return what the likelihood needs, without a matrix larger than p x p.

    With D = diag(s^2 + omega^2) and w = 1 / D of the bags of one robot, V = D + tau^2 1 1' has the inverse
    diag(w) - kappa w w', kappa = tau^2 / (1 + tau^2 W), and the determinant |D| (1 + tau^2 W) (Sherman and
    Morrison 1950).
    """
    variance = bags.variance + omega2
    weighted = bags.columns / variance[:, None]
    by_robot = bags.by_robot(weighted)
    weight = by_robot[:, 0]
    kappa = tau2 / (1.0 + tau2 * weight)
    products = weighted.T @ bags.columns - (by_robot * kappa[:, None]).T @ by_robot
    return _Sums(
        weight=weight,
        x=by_robot[:, :-1],
        y=by_robot[:, -1],
        kappa=kappa,
        normal=products[:-1, :-1],
        right=products[:-1, -1],
        square=float(products[-1, -1]),
        log_det=float(np.log(variance).sum() + np.log1p(tau2 * weight).sum()),
    )


def _restricted(sums: _Sums) -> float:
    """Return minus twice the restricted log-likelihood, up to a constant (Harville 1977, eq. 4.2)."""
    beta = np.linalg.solve(sums.normal, sums.right)
    misfit = sums.square - float(beta @ sums.right)
    return sums.log_det + float(np.linalg.slogdet(sums.normal)[1]) + misfit


def _robustly_outside(data: Observations, robots: int, threshold: float) -> np.ndarray:
    """Return which robots are outside by the median and the median absolute deviation of all."""
    weight = np.bincount(data.robot, data.std**-2.0, robots)
    slopes = np.linalg.lstsq(_design(data), data.value, rcond=None)[0][1:]
    level = data.value - data.regressors @ slopes
    with np.errstate(invalid='ignore'):
        mean = np.bincount(data.robot, level * data.std**-2.0, robots) / weight
    deviation = np.abs(mean - np.nanmedian(mean))
    spread = NORMAL_MAD * float(np.nanmedian(deviation))
    outside: np.ndarray = np.nan_to_num(deviation) > threshold * max(spread, 1e-300)
    return outside


def _deleted_z(solved: _Solution, data: Observations, outside: np.ndarray) -> Array:
    """Return the distance of each robot from a prediction by all others, in standard deviations.

    The residual mean of robot r, weighted by w, has the variance tau^2 + 1 / W -+ x' C x with the covariance
    C of beta: less for a robot in the fit, more for one that was set aside. Divided by its own standard
    deviation the first equals the deleted residual (Cook and Weisberg 1982, section 2.2.2).
    """
    sums = _sums(_grouped(data, solved.bags.robots), solved.tau**2, solved.omega**2)
    with np.errstate(invalid='ignore', divide='ignore'):
        x, y = sums.x / sums.weight[:, None], sums.y / sums.weight
        leverage = np.einsum('mi,ij,mj->m', x, solved.covariance, x)
        variance = solved.tau**2 + 1.0 / sums.weight + np.where(outside, leverage, -leverage)
        z: Array = (y - x @ solved.beta) / np.sqrt(np.maximum(variance, 1e-9 / sums.weight))
    return z


def _concluded(
    solved: _Solution, data: Observations, robots: int, z: Array, outside: IntArray
) -> FleetEstimate:
    """Return mean, slopes and spread with their intervals, and the robots."""
    used, p = solved._size()
    robust, model = solved.robust_covariance(), solved.covariance
    stds = np.sqrt(np.maximum(np.diagonal(robust), np.diagonal(model)))
    reach = float(special.stdtrit(used - p, 0.5 + 0.5 * CONFIDENCE)) * stds
    fixed = [
        Estimate(float(value), float(std), float(value - width), float(value + width))
        for value, std, width in zip(solved.beta, stds, reach, strict=True)
    ]
    low, high = solved.interval_of_tau()
    value, std = _predicted(solved, data, robots)
    return FleetEstimate(
        mean=fixed[0],
        slopes=dict(zip(data.names, fixed[1:], strict=True)),
        spread=Estimate(solved.tau, math.nan, low, high),
        bag_spread=solved.omega,
        robot_value=value,
        robot_std=std,
        robot_z=z,
        out_of_family=outside,
        bags=len(data.value),
        robots=len(np.unique(data.robot)),
    )


def _predicted(solved: _Solution, data: Observations, robots: int) -> tuple[Array, Array]:
    """Return the value of each robot where the regressors are zero, and its standard deviation.

    The best linear unbiased prediction beta_0 + kappa sum w (y - x' beta), with the variance
    tau^2 / (1 + tau^2 W) + g' C g, g = (1, 0, ..) - kappa sum w x (Robinson 1991, section 5.4).
    """
    sums = _sums(_grouped(data, robots), solved.tau**2, solved.omega**2)
    shrunk = sums.kappa * (sums.y - sums.x @ solved.beta)
    constant = np.eye(len(solved.beta))[0]
    g = constant - sums.kappa[:, None] * sums.x
    variance = sums.kappa + np.einsum('mi,ij,mj->m', g, solved.covariance, g)
    seen = sums.weight > 0.0
    return np.where(seen, solved.beta[0] + shrunk, math.nan), np.where(seen, np.sqrt(variance), math.nan)


def indexed(robots: Sequence[str]) -> tuple[tuple[str, ...], IntArray]:
    """Return the sorted names of the robots, and the index of each entry among them."""
    names, index = np.unique(np.array(robots, str), return_inverse=True)
    return tuple(map(str, names)), index.astype(np.int64)
