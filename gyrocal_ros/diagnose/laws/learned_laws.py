"""The laws that a model has learned, for people: their curves, their closed forms, their sizes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.laws.bump_fit import BumpFit, bump_fit
from gyrocal_ros.diagnose.laws.closed_forms import ClosedForm, LearnedCurve, closed_forms, learned_curve
from gyrocal_ros.effects import LEARNED_EFFECTS
from gyrocal_ros.effects.learned.causes import closest_effect
from gyrocal_ros.effects.learned.curve import Curve
from gyrocal_ros.effects.learned.drives import START
from gyrocal_ros.effects.learned.memory import ExponentialBank
from gyrocal_ros.effects.learned.place_map import PlaceMap
from gyrocal_ros.effects.learned.signals import UNITS
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.sensor import Effect

NO_CURVES: Mapping[str, tuple[Effect, ExaminedModel]] = MappingProxyType({})
SHOWN, MIN_EXPLAINED = 4, 0.9
"""Number of closed forms that are listed, and the part of a curve that all but the best explain at least."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnedLaw:
    """One learned effect of a model."""

    effect: Effect
    curve: LearnedCurve | None
    """Its curve, or the response of a memory, as it was learned; None for a map, a step and a wave."""
    forms: tuple[ClosedForm, ...]
    """Closed forms, the best first."""
    rms: float
    """Root mean square of its contribution to the yaw rate over the recording, rad/s."""
    bump: BumpFit | None = None
    """Closed form of a map."""

    @property
    def kind(self) -> str:
        """What is learned: `bias_curve`, `bias_memory`, ..."""
        return self.effect.name.partition(':')[0]

    @property
    def follows(self) -> str:
        """What it follows."""
        return self.effect.name.partition(':')[2]

    @property
    def in_model_as(self) -> str:
        """Closed form in which the model has it; empty where it has the curve, the memory or the map."""
        return getattr(self.effect, 'form', '')

    @property
    def is_over_a_signal(self) -> bool:
        """True if its curve is over a recorded signal or the time since the start."""
        is_curve = self.curve is not None and isinstance(self.curve.effect, Curve)
        return is_curve or self.follows == START

    @property
    def closest(self) -> str:
        """Effect of the library that resembles a memory most; empty for any other law."""
        if self.curve is None or not isinstance(self.curve.effect, ExponentialBank):
            return ''
        return closest_effect(self.curve.effect.of, self.follows)


def learned_laws(
    examined: ExaminedModel, curves: Mapping[str, tuple[Effect, ExaminedModel]] = NO_CURVES
) -> Iterator[LearnedLaw]:
    """Yield the learned effects of a model.

    Args:
        examined: the model on a recording.
        curves: curves and memories that the model has in closed form, by name, each with the model that it
            was learned in.
    """
    history, start = examined.run.history, 0
    for effect in examined.model.effects:
        places = slice(start, start + len(effect.coefficients))
        start = places.stop
        if effect.name.partition(':')[0] not in LEARNED_EFFECTS:
            continue
        values = history.mean[-1, COEFFICIENTS_START:][places]
        rate = (history.columns[:, places] @ values) / history.dt_s
        learned, model = curves.get(effect.name, (effect, examined))
        curve = learned_curve(model, learned) if isinstance(learned, Curve | ExponentialBank) else None
        forms = closed_forms(curve, len(history.dt_s)) if curve is not None else []
        forms = [*forms[:1], *(item for item in forms[1:SHOWN] if item.explained > MIN_EXPLAINED)]
        bump = bump_fit(model, learned) if isinstance(learned, PlaceMap) else None
        yield LearnedLaw(effect, curve, tuple(forms), float(np.sqrt(np.mean(rate**2))), bump)


def unit_of(signal: str) -> str:
    """Return the unit of a signal; `as recorded` where it is not known."""
    return UNITS.get(signal, 'as recorded')


def summarise_laws(laws: list[LearnedLaw]) -> list[dict[str, Any]]:
    """Return the laws for JSON."""
    return [
        {
            'effect': law.effect.name,
            'kind': law.kind,
            'follows': law.follows,
            'rms_rad_s': law.rms,
            'closest_library_effect': law.closest or None,
            'in_model_as': law.in_model_as or None,
            'bump': None if law.bump is None else asdict(law.bump),
            'curve': None
            if law.curve is None
            else {'x': law.curve.x[::10], 'y': law.curve.y[::10], 'std': law.curve.std[::10]},
            'closed_forms': [
                {
                    'form': found.form.name,
                    'equation': found.form.equation,
                    'p': found.parameter,
                    'values': found.values,
                    'stds': found.stds,
                    'physical': found.physical or None,
                    'explained': found.explained,
                    'fits': found.fits,
                    'library_effect': found.library or None,
                    'meaning': found.means,
                }
                for found in law.forms
            ],
        }
        for law in laws
    ]
