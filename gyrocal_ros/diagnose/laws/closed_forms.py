"""From a learned curve or memory to its law: the closed forms that fit within its uncertainty, best first.

Of a memory, the curve is its response: to a unit step of its drive, after a turn, or to the start of a turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, coefficient_places
from gyrocal_ros.diagnose.analysis.heading_filter import misfits
from gyrocal_ros.effects.learned.causes import library_effect, meaning, meaning_of_memory
from gyrocal_ros.effects.learned.curve import Curve
from gyrocal_ros.effects.learned.drives import START
from gyrocal_ros.effects.learned.forms import FORMS, Form
from gyrocal_ros.effects.learned.memory import ExponentialBank
from gyrocal_ros.effects.learned.memory_forms import MEMORY_FORMS, physical
from gyrocal_ros.effects.learned.signals import HEADING
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.sensor import Coefficient, Effect
from gyrocal_ros.statistics import chi_square_quantile, robust_std

GRID = 401
"""Points over the range at which forms and curve are compared."""
DYNAMICS_S, SLOWEST = 1.0, 2.0
"""Time over which a response is known: of the dynamics, and of others in largest time constants."""
FITS = 0.999
"""Probability of a smaller distance for a form that fits."""
NEGLIGIBLE = 0.003
"""Part of the log-likelihood that a form may miss and still fit: no form is exact to more than that."""
SINGULAR = 1e-9
"""Information, relative to the largest, below which the data say nothing."""
LARGEST = 1e15
"""Largest number that a form may have: products of several are still finite."""
UNSEEN = 1e-3
"""Information of the data, relative to that of the prior, below which they do not determine a direction."""
MAX_LOST = 0.5
"""Part of a form, in mean square, that the directions which the data determine may lack."""
REFINED, REFINEMENTS = 11, 3
"""Number of values between two neighbours of a scanned parameter, and how often."""


class Functions(Protocol):
    """A learned effect that is a sum of fixed functions."""

    @property
    def coefficients(self) -> tuple[Coefficient, ...]: ...

    def basis(self, values: Array) -> Array: ...

    def present(self, values: Array) -> Array: ...


class Estimated(Protocol):
    """A learned effect at some places (n, ...), with the estimates of its coefficients: a curve, or a map."""

    @property
    def effect(self) -> Functions: ...

    @property
    def x(self) -> Array: ...

    @property
    def values(self) -> Array: ...

    @property
    def covariance(self) -> Array: ...

    @property
    def scatter(self) -> float: ...


@dataclass(frozen=True, slots=True, eq=False)
class LearnedCurve:
    """A curve, or the response of a memory, with its uncertainty."""

    effect: Curve | ExponentialBank
    x: Array
    """(n,) values of the signal, or times in s."""
    y: Array
    std: Array
    """(n,) curve and its standard deviation: rad/s of bias or 1 of scale, of a response per unit of drive."""
    values: Array
    covariance: Array
    """(k,), (k, k) estimates of its coefficients, by the filter."""
    scatter: float
    """Factor by which the rate errors that the model leaves exceed what the filter expects; `std` has it."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedForm:
    """One form, fitted to a curve or a response."""

    form: Form
    parameter: float
    """Value of the scanned parameter; 0 without."""
    values: Array
    stds: Array
    """(q,) linear parameters and their standard deviations."""
    explained: float
    """Part of the log-likelihood of the curve that the form gains."""
    description_length: float
    """Log-likelihood that it misses, and half the logarithm of the number of data for each parameter, free or
    set equal to another."""
    fits: bool
    """True if what it misses may be chance."""
    library: str
    """Effect of the library with this form; empty without one."""
    means: str

    @property
    def physical(self) -> str:
        """What the parameters are in physical terms, where that is something else; else empty."""
        return physical(self.form, self.values.tolist())


def learned_curve(examined: ExaminedModel, effect: Curve | ExponentialBank) -> LearnedCurve:
    """Return a curve or response with its uncertainty, widened by the scatter that the model leaves."""
    return curve_by(effect, *estimate_in(examined, effect), float(examined.run.history.time_s[-1]))


def estimate_in(examined: ExaminedModel, effect: Effect) -> tuple[Array, Array, float]:
    """Return the coefficients (k,) of an effect by the filter, their covariance (k, k), and the scatter.

    The scatter is the factor by which rate errors that the model leaves exceed what the filter expects.
    """
    within, state = coefficient_places(examined.model, effect.name), examined.run.state
    places = slice(COEFFICIENTS_START + within.start, COEFFICIENTS_START + within.stop)
    scatter = max(1.0, robust_std(misfits(examined.seen, np.empty((len(examined.seen.time_s), 0)))))
    return state.mean[places], state.covariance[places, places], scatter


def curve_by(
    effect: Curve | ExponentialBank, values: Array, covariance: Array, scatter: float, duration_s: float
) -> LearnedCurve:
    """Return the curve or response of an effect.

    Args:
        effect: the effect.
        values: (k,) its coefficients.
        covariance: (k, k) theirs, by the filter.
        scatter: factor by which errors exceed what the filter expects.
        duration_s: duration of the recording.
    """
    x = np.linspace(*_range(effect, duration_s), GRID)
    basis = effect.basis(x)
    std = scatter * np.sqrt(np.einsum('nk,kl,nl->n', basis, covariance, basis))
    return LearnedCurve(effect, x, basis @ values, std, values, covariance, scatter)


def _range(effect: Curve | ExponentialBank, duration_s: float) -> tuple[float, float]:
    """Return the range over which a curve or response is known."""
    if isinstance(effect, Curve):
        return (-np.pi, np.pi) if effect.follows == HEADING else (effect.low, effect.high)
    if effect.over == 'dynamics':
        return 0.0, DYNAMICS_S
    return 0.0, duration_s if effect.follows == START else min(
        SLOWEST * float(effect.tau_s.max()), duration_s
    )


def without_present(curve: Estimated, functions: Array) -> Array:
    """Return functions over the range (n, q) without what constant bias and scale factor explain of them."""
    present = curve.effect.present(curve.x)
    left: Array = functions - present @ np.linalg.lstsq(present, functions, rcond=None)[0]
    return left


def form_over(curve: LearnedCurve, found: ClosedForm) -> Array:
    """Return a form (n,) over the range, less what constant bias and scale factor explain, as the curve."""
    drawn: Array = without_present(curve, found.form.columns(curve.x, found.parameter)) @ found.values
    return drawn


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the data say of a curve, in the directions of its coefficients that they determine.

    The coefficients c are relative to their prior standard deviations D: those of short wavelengths have so
    small a prior that Sigma^-1 - P^-1 would otherwise be rounding.
    """

    basis: Array
    """(n, k) basis functions over the range, times D."""
    axes: Array
    """(k, s) the directions."""
    information: Array
    score: Array
    """(s,) Lambda, which is diagonal in them, and b."""

    def directions(self, functions: Array) -> Array:
        """Return functions over the range (n, q) as combinations (s, q) of the directions."""
        combinations: Array = self.axes.T @ np.linalg.lstsq(self.basis, functions, rcond=None)[0]
        return combinations


def seen_in(curve: Estimated) -> Seen:
    """Return what the data say of a curve or map, without its prior."""
    prior = np.array([item.prior_std for item in curve.effect.coefficients], float)
    inverse, variance = np.linalg.inv(curve.covariance / np.outer(prior, prior)), curve.scatter**2
    information, axes = np.linalg.eigh((inverse - np.eye(len(prior))) / variance)
    seen = information > max(SINGULAR * information[-1], UNSEEN / variance)
    score = axes[:, seen].T @ inverse @ (curve.values / prior) / variance
    return Seen(curve.effect.basis(curve.x) * prior, axes[:, seen], information[seen], score)


def closed_forms(curve: LearnedCurve, count: int) -> list[ClosedForm]:
    """Fit every form to a curve; the shortest description comes first.

    Only the data count, not the prior: with the information Lambda = Sigma^-1 - P^-1 and b = Sigma^-1 c of
    the coefficients c, a form A p gains `b^T A p - 1/2 p^T A^T Lambda A p`, see `Seen`.

    Args:
        curve: the curve.
        count: number of data, for the cost of a parameter.
    """
    seen = seen_in(curve)
    most = 0.5 * float(np.sum(seen.score**2 / seen.information))
    found = []
    for form in _forms_of(curve):
        best = _best_parameter(curve, form, seen)
        if best is None:
            continue
        gain, parameter, values, stds = best
        missed = max(most - gain, 0.0)
        dof = max(len(seen.score) - form.size, 1)
        of, follows = curve.effect.of, curve.effect.follows
        is_memory = isinstance(curve.effect, ExponentialBank)
        found.append(
            ClosedForm(
                form=form,
                parameter=parameter,
                values=values,
                stds=stds,
                explained=gain / most,
                description_length=missed + 0.5 * (form.size + form.chosen) * math.log(count),
                fits=missed < max(0.5 * chi_square_quantile(FITS, dof), NEGLIGIBLE * most),
                library=library_effect(of, follows, form.name),
                means=meaning_of_memory(of, follows) if is_memory else meaning(follows, form.name),
            )
        )
    return sorted(found, key=_order)


def _forms_of(curve: LearnedCurve) -> Iterator[Form]:
    """Yield the forms that a curve or response may have."""
    low, high = float(curve.x[0]), float(curve.x[-1])
    for form in (*FORMS, *MEMORY_FORMS):
        if form.over == curve.effect.over and form.suits(curve.effect.follows, low, high):
            yield form


def _order(found: ClosedForm) -> tuple[bool, int, float]:
    """Return the order: those that fit first and by their parameters, then by the description."""
    return not found.fits, found.form.size if found.fits else 0, found.description_length


def _best_parameter(curve: LearnedCurve, form: Form, seen: Seen) -> tuple[float, float, Array, Array] | None:
    """Return the fit with the best scanned parameter: of its values, then between the neighbours of that."""
    tried, best = form.values(float(curve.x[0]), float(curve.x[-1])), None
    for _ in range(REFINEMENTS + 1):
        fits = [_fitted(curve, form, float(p), seen) for p in tried]
        best = max((item for item in fits if item is not None), key=lambda item: item[0], default=None)
        if best is None or len(tried) == 1:
            break
        place = int(np.argmin(np.abs(tried - best[1])))
        around = tried[[max(place - 1, 0), min(place + 1, len(tried) - 1)]]
        tried = np.linspace(around[0], around[1], REFINED)
    return best


def _fitted(
    curve: LearnedCurve, form: Form, p: float, seen: Seen
) -> tuple[float, float, Array, Array] | None:
    """Return gain, parameter, values and deviations.

    None where bias and scale factor explain the form, where the curve is too smooth to have it, or where the
    form is too large or small for numbers, such as an exponential of a signal far from zero.
    """
    with np.errstate(over='ignore'):
        columns = form.columns(curve.x, p)
    largest = np.abs(columns).max(axis=0)
    if not np.all((largest > 1.0 / LARGEST) & (largest < LARGEST)):
        return None
    new = without_present(curve, columns)
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    if np.any(np.sqrt(np.mean(new**2, axis=0)) < 1e-6 * sizes):
        return None
    mixing = seen.directions(new)
    lost = new - seen.basis @ (seen.axes @ mixing)
    if np.any(np.mean(lost**2, axis=0) > MAX_LOST * np.mean(new**2, axis=0)):
        return None
    normal = mixing.T @ (seen.information[:, None] * mixing)
    scale = np.sqrt(np.diagonal(normal))
    if not np.all(scale > 0.0) or np.linalg.cond(normal / np.outer(scale, scale)) > 1.0 / SINGULAR:
        return None
    inverse = np.linalg.inv(normal)
    values = inverse @ (mixing.T @ seen.score)
    gain = 0.5 * float(values @ mixing.T @ seen.score)
    return gain, p, values, np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
