"""Properties of an effect for other rooms: effects declare them, so that no room knows effects by name."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import (
    ConditionallyObservable,
    Effect,
    EffectWithForms,
    LimitEffect,
    SensorModel,
)

NOT_RECORDED = 'not recorded: '
"""Beginning of a reason why an effect is unobservable, where a recording with more signals would show it."""
CEILING_IMAGES = 'images of the ceiling'
MAX_USUAL = 2.5
"""Size of a noise, relative to the largest usual one, beyond which something else is behind it."""
SURE_SIGMA = 3.0
"""Standard deviations from which a sign is sure."""


def required_signals(effect: Effect) -> tuple[str, ...]:
    """Return the signals, other than IMU, wheels and camera, without which the effect contributes nothing."""
    declared = effect.about.needs if isinstance(effect, LibraryEffect) else ()
    followed = getattr(effect, 'signal', None)
    return tuple(dict.fromkeys((*declared, *((followed,) if followed else ()))))


def follows_signal(effect: Effect) -> bool:
    """Return True if the effect follows a recorded signal, whatever law may be behind it."""
    return bool(getattr(effect, 'signal', None))


def follows_power_on(effect: Effect) -> bool:
    """Return True if the effect follows the time since power-on, which no recording tells."""
    return isinstance(effect, LibraryEffect) and effect.about.shown_against == 'time'


def follows_temperature(effect: Effect) -> bool:
    """Return True if the effect follows a recorded temperature."""
    return isinstance(effect, LibraryEffect) and effect.about.shown_against == 'temperature'


def are_twins(one: Effect, other: Effect) -> bool:
    """Return True if one of two effects is easily taken for the other, by what they say of themselves."""
    pairs = ((one, other), (other, one))
    return any(
        isinstance(effect, LibraryEffect) and twin.name.partition(':')[0] in effect.about.twins
        for effect, twin in pairs
    )


def least_shown_part(effect: Effect) -> float:
    """Return the part of its least usual size below which something else looks the same; 0 without any."""
    return float(getattr(effect, 'least_shown_part', 0.0))


def holds_once(effect: Effect) -> bool:
    """Return True for a law that holds for one recording only: another one begins at another time."""
    return getattr(effect, 'holds_once', False)


def followers_by_signal(model: SensorModel) -> dict[str, list[str]]:
    """Return the signals that effects of the model require, each with the names of these effects."""
    followers: dict[str, list[str]] = {}
    for effect in model.effects:
        for signal in required_signals(effect):
            followers.setdefault(signal, []).append(effect.name)
    return followers


def why_unobservable(effect: Effect, recording: RecordingSummary) -> str:
    """Return why the recording cannot show an effect; empty if it may."""
    missing = set(required_signals(effect)) - recording.recorded
    if effect.acts_on in ('camera', 'shutter', 'time') and recording.rig.camera is None:
        missing.add(CEILING_IMAGES)
    if missing:
        return f'{NOT_RECORDED}{", ".join(sorted(missing))}'
    return effect.unobservable(recording) if isinstance(effect, ConditionallyObservable) else ''


def is_unusual(noise: Effect, size: float) -> bool:
    """Return True for a noise that is far larger than that of any usual gyro."""
    usual = noise.coefficients[0].typical
    return usual is not None and size > MAX_USUAL * usual.high


def is_limit(effect: Effect) -> bool:
    """Return True if the effect enters by a limit that is detected instead of estimated."""
    return isinstance(effect, LimitEffect)


def is_noise(effect: Effect) -> bool:
    """Return True if the effect makes the gyro noisier; no reading can be corrected for it."""
    return effect.acts_on == 'noise'


def is_white_noise(effect: Effect) -> bool:
    """Return True for a noise that makes the readings scatter at any rate: no walk of the bias."""
    if not is_noise(effect):
        return False
    return bool(np.any(effect.density(np.zeros(1), _largest(effect)) > 0.0))  # type: ignore[attr-defined]


def is_bias_walk(effect: Effect) -> bool:
    """Return True for a noise that makes the bias wander."""
    return is_noise(effect) and bool(effect.bias_walk(_largest(effect)) > 0.0)  # type: ignore[attr-defined]


def _largest(noise: Effect) -> Array:
    """Return the coefficients (k,) of a noise at its largest size."""
    return np.array([item.scan[-1] if item.scan else item.prior_mean for item in noise.coefficients])


def is_estimated(effect: Effect) -> bool:
    """Return True if the filter estimates the coefficients: not of a limit, and not of a noise."""
    return not is_limit(effect) and not is_noise(effect)


def may_break_the_filter(effect: Effect) -> bool:
    """Return True if the filter may diverge without the effect."""
    return isinstance(effect, LibraryEffect) and effect.about.may_break_the_filter


def shows_in_any_turns(effect: Effect) -> bool:
    """Return True if every recording with turns can judge the effect."""
    return isinstance(effect, LibraryEffect) and effect.about.shows_in_any_turns


def why_disturbed(effect: Effect, by: Effect) -> str:
    """Return why an effect cannot be judged where another one, no fault of a sensor, is there; or nothing."""
    disturbs = isinstance(by, LibraryEffect) and effect.acts_on in by.about.disturbs
    return by.about.in_short if disturbs else ''  # type: ignore[attr-defined]


def is_disturbance(effect: Effect) -> bool:
    """Return True for what images show that is no fault of a sensor."""
    return isinstance(effect, LibraryEffect) and len(effect.about.disturbs) > 0


def is_usual(effect: Effect, values: Array) -> bool:
    """Return True if any of its coefficients (k,) is as large as the smallest usual one."""
    usual = zip(effect.coefficients, values.tolist(), strict=True)
    return any(item.typical is not None and abs(value) >= item.typical.low for item, value in usual)


def scanned_coefficient(effect: Effect) -> int | None:
    """Return the index of the coefficient that has a scan; None where all are linear."""
    return next((place for place, item in enumerate(effect.coefficients) if item.scan), None)


def strengths(effect: Effect) -> IntArray:
    """Return the indices of the coefficients in which the effect is linear; none for a limit or a noise."""
    scanned = scanned_coefficient(effect) if is_estimated(effect) else None
    count = len(effect.coefficients) if is_estimated(effect) else 0
    return np.array([place for place in range(count) if place != scanned], np.int64)


def forms_of(effect: Effect) -> tuple[Effect, ...]:
    """Return the forms in which the diagnosis tries an effect."""
    return effect.forms() if isinstance(effect, EffectWithForms) else (effect,)


def has_impossible_sign(effect: Effect, values: Array, stds: Array) -> bool:
    """Return True if a coefficient is negative that no real sensor has negative: none reads ahead of time.

    Args:
        effect: with k coefficients.
        values: (k,) their estimates.
        stds: (k,) standard deviations of these.
    """
    usual = [item.typical for item in effect.coefficients]
    return any(
        item is not None and not item.signed and value < -SURE_SIGMA * std
        for item, value, std in zip(usual, values.tolist(), stds.tolist(), strict=True)
    )
