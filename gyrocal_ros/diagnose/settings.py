"""Thresholds of the diagnosis, declared once: value, unit, statistical meaning, and what guards them.

`gyrocal bench blind --set NAME=VALUE` tries another value on recordings with hidden effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any

from gyrocal_ros.errors import ConfigError, did_you_mean


def threshold(default: float, unit: str, meaning: str, guard: str) -> Any:
    """Declare a threshold.

    Args:
        default: its value.
        unit: its unit; `sigma`, `nat` (log-likelihood), `1` (a ratio) or an SI unit.
        meaning: what it separates, and why it lies where it lies.
        guard: cases of `gyrocal bench blind` that get worse when it is wrong.
    """
    return field(default=default, metadata={'unit': unit, 'meaning': meaning, 'guard': guard})


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of the diagnosis."""

    # --- significance of an effect
    significant_sigma: float = threshold(
        4.0, 'sigma', 'smaller estimates count as chance: some forty candidates are tried', 'none'
    )
    coefficient_price: float = threshold(
        4.0,
        'nat',
        'log-likelihood that a coefficient must gain: half the logarithm of the number of images in some '
        'minutes (Schwarz 1978)',
        'none; pairs of effects',
    )
    pair_part: float = threshold(
        0.02, '1', 'part by which two effects must explain more than one alone', 'pairs of effects'
    )
    residual_part: float = threshold(
        0.004,
        '1',
        'what gains less than this part of what was found before is due to that not being exact',
        'every single effect',
    )
    min_predictive_gain: float = threshold(
        3.0, 'nat', 'predictive log-likelihood that an effect must gain to be kept: odds of 20', 'none'
    )
    nonzero_sigma: float = threshold(
        3.0, 'sigma', 'distance from zero that a coefficient must keep in the final model', 'pairs of effects'
    )
    min_judgeable_part: float = threshold(
        0.5,
        '1',
        'part of the effects that any turns show which a recording must be able to judge before '
        'nothing counts as missing',
        'none',
    )

    # --- effects that look alike
    indistinguishable_sigma: float = threshold(
        3.0,
        'sigma',
        'an effect preferred by less is not told from the other (Vuong 1989)',
        'every single effect',
    )
    indistinguishable_correlation: float = threshold(
        0.87,
        '1',
        'correlation from which on two effects look alike; squared, the part explained',
        'every single effect',
    )
    max_rivals: int = threshold(
        2,
        '1',
        'number of effects that look like the last one found and get a run of their own',
        'single effects',
    )

    # --- starting an effect in the filter
    start_sigma: float = threshold(
        3.0,
        'sigma',
        'least prior standard deviation of a coefficient, in those of its estimate',
        'single effects',
    )
    start_part: float = threshold(
        0.2,
        '1',
        'least prior standard deviation of a coefficient, as a part of its estimate',
        'single effects',
    )
    scan_start_part: float = threshold(
        0.4,
        '1',
        'prior standard deviation of a scanned coefficient, as a part of its value',
        'effects with a scan',
    )

    # --- effects that enter by a limit
    limit_heading_gain: float = threshold(
        40.0,
        'nat',
        'gain by the headings that makes a limit worth a run; straight drives gain some by a dead band, '
        'which removes noise',
        'limits; none',
    )
    limit_unexplained_part: float = threshold(
        0.4,
        '1',
        'part of the unexplained structure that a hidden limit must explain by the headings',
        'limits',
    )
    limit_rival_part: float = threshold(
        0.5,
        '1',
        'part of what the best other effect explains that a limit must explain by the headings',
        'limits',
    )
    limit_margin: float = threshold(
        1.05,
        '1',
        'factor by which a limit must beat every other effect: its process noise helps any model',
        'limits',
    )
    widest_limit_part: float = threshold(
        0.97,
        '1',
        'the largest limit that gains this part of the best is taken: noise blurs the edge inwards',
        'limits',
    )

    # --- unexplained structure
    structure_sigma: float = threshold(
        6.0,
        'sigma',
        'less is chance: free functions are many and bend freely',
        'none; effects out of the library',
    )
    structure_margin: float = threshold(
        1.25,
        '1',
        'factor by which structure must exceed the best effect to be unexplained',
        'out of the library',
    )
    structure_shown_part: float = threshold(
        0.1,
        '1',
        'part of the structure that an effect must explain in the full filter: the headings alone cannot '
        'tell it from errors of the map',
        'none',
    )
    structure_shown_gain: float = threshold(
        40.0,
        'nat',
        'gain of an effect in the full filter that is enough whatever the part',
        'out of the library',
    )
    leftover_part: float = threshold(
        0.2, '1', 'structure below this part of what was found does not change the verdict', 'single effects'
    )
    oscillation_part: float = threshold(
        0.8,
        '1',
        'recorded signals that explain this part of an oscillation are preferred to it',
        'out of the library',
    )
    min_inflation: float = threshold(
        2.0,
        '1',
        'least factor on the variance of chance: the bias wanders by itself',
        'none, noise set too low',
    )

    # --- where the model fails
    failure_sigma: float = threshold(
        4.5, 'sigma', 'smaller failures count as chance: many places are tried', 'none'
    )
    failure_length_s: float = threshold(
        5.0, 's', 'shortest total duration of a regime that is judged', 'none'
    )
    outlier_sigma: float = threshold(
        3.0,
        'sigma',
        'larger heading innovations get a larger variance: few features, a new map',
        'image bags',
    )
    map_walk_deg: float = threshold(
        0.005, 'deg/sqrt(s)', "random walk of the map's own heading", 'none; image bags'
    )


DEFAULT_SETTINGS = DiagnosisSettings()


def described(settings: DiagnosisSettings = DEFAULT_SETTINGS) -> Iterator[dict[str, Any]]:
    """Yield name, value, unit, meaning and guard of every threshold."""
    for item in fields(settings):
        yield {'name': item.name, 'value': getattr(settings, item.name), **item.metadata}


def with_thresholds(assignments: Iterable[str], where: str) -> DiagnosisSettings:
    """Return the settings with values given as `NAME=VALUE`.

    Raises:
        ConfigError: a name is not known or a value is not a number of the right kind.
    """
    known: dict[str, Field[Any]] = {item.name: item for item in fields(DiagnosisSettings)}
    values: dict[str, float] = {}
    for text in assignments:
        name, _, value = text.partition('=')
        if name not in known:
            raise ConfigError(f'{name!r} is not known', where=where, todo=did_you_mean(name, known))
        try:
            values[name] = float(value)
        except ValueError as error:
            raise ConfigError(f'{name} is {value!r}', where=where, todo='give NAME=NUMBER') from error
    return replace(DEFAULT_SETTINGS, **values)  # type: ignore[arg-type]
