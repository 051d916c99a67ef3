"""Description of an effect in lines of text."""

from __future__ import annotations

from collections.abc import Iterator

from gyrocal_ros.effects.base import LibraryEffect, shown_in, with_unit
from gyrocal_ros.effects.traits import required_signals
from gyrocal_ros.model.sensor import CameraEffectOnOdometry, Coefficient, Effect, Place

PLACES = {
    'gyro': 'in the gyro',
    'wheels': 'in the wheels',
    'ground': 'in the floor',
    'camera': 'in the camera',
    'time': 'in the stamps of the images',
    'shutter': 'in the shutter of the camera',
    'noise': 'in the noise of the gyro',
}
MAX_ROWS = 7
"""Number of coefficients above which they share one row."""
NOT_ESTIMATED = 'found in the readings, not estimated'


def place_of(effect: Effect) -> Place:
    """Return the place of the physical cause; the filter may be corrected at another place."""
    return 'wheels' if isinstance(effect, CameraEffectOnOdometry) else effect.acts_on


def effect_rows(effect: LibraryEffect) -> Iterator[tuple[str, str]]:
    """Yield name and text of each property of an effect, except its physics."""
    about = effect.about
    yield 'equation', about.equation
    yield 'usual size', about.usual_size
    yield from _coefficient_rows(effect)
    yield 'best motion', about.best_motion
    yield 'easily taken for', ', '.join(about.twins) or 'nothing else in the library'
    yield 'needs', ', '.join(('gyro, wheels, camera', *required_signals(effect)))
    yield 'source', about.source


def _coefficient_rows(effect: LibraryEffect) -> Iterator[tuple[str, str]]:
    items = effect.coefficients
    if len(items) > MAX_ROWS:
        smallest, *_, largest = sorted(items, key=lambda item: item.prior_std)
        priors = (
            f'{with_unit(smallest.prior_std, smallest.unit)} to {with_unit(largest.prior_std, largest.unit)}'
        )
        yield (
            'coefficients',
            f'{len(items)}, {items[0].name} to {items[-1].name}, each 0 ± {priors} before any measurement',
        )
        return
    for item, example in zip(items, effect.about.example, strict=True):
        yield item.name, f'{prior_in_words(item)}; for example {with_unit(example, item.unit)}'


def prior_in_words(item: Coefficient) -> str:
    """Describe the prior of a coefficient."""
    if item.prior_std == 0.0:
        return NOT_ESTIMATED
    mean = shown_in(item.unit)[1] * item.prior_mean
    return f'{mean:g} ± {with_unit(item.prior_std, item.unit)} before any measurement'
