"""Thresholds of the diagnosis, declared once: value, unit, statistical meaning, and what guards them.

`gyrocal bench blind --set NAME=VALUE` tries another value on recordings with hidden effects. The table of
docs/diagnosis_settings.md is the output of `markdown_table`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any

from gyrocal_ros.errors import ConfigError, did_you_mean


def threshold(default: float, unit: str, meaning: str, guard: str) -> Any:
    """Declare a threshold.

    Args:
        default: its value.
        unit: its unit; `sigma`, `nat` (log-likelihood), `1` (a ratio) or an SI unit.
        meaning: definition and reason of the value.
        guard: cases of `gyrocal bench blind` that get worse with a wrong value.
    """
    return field(default=default, metadata={'unit': unit, 'meaning': meaning, 'guard': guard})


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of the diagnosis."""

    # --- significance of an effect
    significant_sigma: float = threshold(
        4.0,
        'sigma',
        'significance from which an estimate is not chance: some forty candidates are tried',
        'none',
    )
    coefficient_price: float = threshold(
        4.0,
        'nat',
        'log-likelihood that a coefficient must gain: half the logarithm of the number of images in some '
        'minutes (Schwarz 1978)',
        'none; pairs of effects',
    )
    pair_part: float = threshold(
        0.02,
        '1',
        'part by which two effects together must explain more than the best one alone',
        'pairs of effects',
    )
    signals_part: float = threshold(
        0.15,
        '1',
        'the same for two effects that follow recorded signals, in place of one that does not',
        'vibration_rectification; signals',
    )
    residual_part: float = threshold(
        0.004,
        '1',
        'part of the gain of the effects found below which a further one is tried only after a run from the '
        'estimates of those: less may be due to inexact coefficients',
        'single effects',
    )
    min_predictive_gain: float = threshold(
        3.0, 'nat', 'predictive log-likelihood that an effect must gain to be kept: odds of 20 to 1', 'none'
    )
    max_drift_rise: float = threshold(
        1.5,
        '1',
        'largest held-out drift with an effect that is kept, relative to that without; a rise by chance does '
        'not count against a clear gain',
        'none; recordings of another simulator',
    )
    nonzero_sigma: float = threshold(
        3.0, 'sigma', 'distance from zero that a coefficient must keep in the final model', 'pairs of effects'
    )
    min_usual_part: float = threshold(
        0.1,
        '1',
        'part of the least usual size below which an effect is not named: signals that are recorded late or '
        'seldom leave such traces. What fades counts with strength times time constant; what takes two '
        'thirds of a drift away is none',
        'pairs of effects',
    )
    min_usual_part_camera: float = threshold(
        0.3,
        '1',
        'the same for an effect on the camera: no camera is calibrated exactly, slow errors of tracks look '
        'like such effects, and the scale factor does not suffer from them',
        'recordings of images',
    )
    min_judgeable_part: float = threshold(
        0.5,
        '1',
        'part of the effects that show in any turns which a recording must be able to judge for the verdict '
        '`nothing_missing`',
        'none',
    )

    uneven_view_gain: float = threshold(
        100.0,
        'nat',
        'log-likelihood that an effect which does not act on the gyro must gain to be tried in a run though '
        'its estimates scatter, and any effect for runs to decide about its time constant: slow errors of '
        'images gain up to some forty',
        'none; single effects',
    )
    uneven_sigma: float = threshold(
        3.0,
        'sigma',
        'significance by the scatter of its estimates that an effect must have, if it is to be tried because '
        'it gains much',
        'none; single effects',
    )

    # --- effects that look alike
    indistinguishable_sigma: float = threshold(
        3.0,
        'sigma',
        'preference below which two effects are not distinguished (Vuong 1989)',
        'single effects',
    )
    indistinguishable_correlation: float = threshold(
        0.87,
        '1',
        'correlation above which two effects look alike; its square is the part that one explains of the '
        'other',
        'single effects',
    )
    max_rivals: int = threshold(
        2,
        '1',
        'number of effects that look like the last one found and get a run of their own',
        'single effects',
    )
    rival_sigma: float = threshold(
        2.0,
        'sigma',
        'preference (Vuong 1989) for the run with one from which it takes the place of the one found',
        'single effects',
    )

    # --- starting an effect in the filter
    start_sigma: float = threshold(
        3.0,
        'sigma',
        'smallest prior standard deviation of a coefficient, in standard deviations of its estimate',
        'single effects',
    )
    start_part: float = threshold(
        0.2,
        '1',
        'smallest prior standard deviation of a coefficient, as a part of its estimate',
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
        45.0,
        'nat',
        'log-likelihood that a limit must gain by the headings alone to be tried in a run, with the bias '
        'that shows outside of a dead band; the band gains some on straight drives, where it removes noise',
        'limits; none',
    )
    limit_wheel_part: float = threshold(
        0.005,
        '1',
        'part of a limit by which the wheels must turn faster there than the gyro reads; a robot that likes '
        'one speed of turning shows none',
        'limits; none',
    )
    limit_margin: float = threshold(
        25.0,
        'nat',
        'predictive log-likelihood that a limit must gain beyond a run with the best other effect: its '
        'process noise improves any model',
        'limits',
    )
    limit_alike_part: float = threshold(
        0.8,
        '1',
        'part of the predictive log-likelihood gained with the best other effect from which a limit is '
        'listed as indistinguishable from it',
        'limits',
    )
    limit_leftover_part: float = threshold(
        0.25,
        '1',
        'largest part of the excess of the NIS that may be left with a limit, where nothing else explains it '
        'and the recording still contradicts the model',
        'limits; pairs of effects',
    )

    # --- unexplained structure
    structure_sigma: float = threshold(
        6.0,
        'sigma',
        'significance from which structure is not chance: the functions are many and flexible',
        'none; effects out of the library',
    )
    structure_margin: float = threshold(
        1.25,
        '1',
        'factor over the gain of the best effect from which structure is not explained by it',
        'effects out of the library',
    )
    structure_shown_part: float = threshold(
        0.1,
        '1',
        'part of the structure that some effect of the gyro must explain in the full filter: the headings '
        'alone cannot distinguish it from errors of the map',
        'none',
    )
    structure_shown_gain: float = threshold(
        40.0,
        'nat',
        'gain of an effect of the gyro in the full filter that is enough, whatever part of the structure '
        'it is',
        'effects out of the library',
    )
    leftover_part: float = threshold(
        0.2,
        '1',
        'part of the gain of the effects found below which structure does not change the verdict',
        'single effects',
    )
    oscillation_part: float = threshold(
        0.8,
        '1',
        'part of the gain of an oscillation from which a recorded signal is preferred to it',
        'effects out of the library',
    )
    min_inflation: float = threshold(
        2.0,
        '1',
        'smallest factor on the variance of chance: the bias drifts by itself',
        'none; none, noise set too low',
    )

    # --- where the model fails
    failure_sigma: float = threshold(
        4.5, 'sigma', 'significance from which a failure is not chance: many places are tried', 'none'
    )
    failure_length_s: float = threshold(
        5.0, 's', 'shortest total duration of a regime that is judged', 'none'
    )
    outlier_sigma: float = threshold(
        3.0,
        'sigma',
        'heading innovation above which its variance is enlarged: few features, a new map',
        'no case; recordings with images',
    )
    map_walk_deg: float = threshold(
        0.005, 'deg/sqrt(s)', "random walk of the map's own heading", 'none; recordings with images'
    )

    @property
    def significant_gain(self) -> float:
        """Log-likelihood that an effect of the least significance gains, in nat."""
        return 0.5 * self.significant_sigma**2


DEFAULT_SETTINGS = DiagnosisSettings()


def differing(settings: DiagnosisSettings) -> dict[str, float]:
    """Return the thresholds that differ from the default, by name."""
    values = {item.name: getattr(settings, item.name) for item in fields(settings)}
    return {name: value for name, value in values.items() if value != getattr(DEFAULT_SETTINGS, name)}


def markdown_table(settings: DiagnosisSettings = DEFAULT_SETTINGS) -> str:
    """Return the table of all thresholds in Markdown."""
    rows = [('threshold', 'value', 'unit', 'meaning', 'guard'), ('---',) * 5]
    for item in described(settings):
        rows.append((f'`{item["name"]}`', f'{item["value"]:g}', item['unit'], item['meaning'], item['guard']))
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows)


def described(settings: DiagnosisSettings = DEFAULT_SETTINGS) -> Iterator[dict[str, Any]]:
    """Yield name, value, unit, meaning and guard of every threshold."""
    for item in fields(settings):
        yield {'name': item.name, 'value': getattr(settings, item.name), **item.metadata}


def with_thresholds(assignments: Iterable[str], where: str) -> DiagnosisSettings:
    """Return the settings with values given as `NAME=VALUE`.

    Args:
        assignments: thresholds; the last one of a name counts.
        where: option that gives them, for the error message.

    Raises:
        ConfigError: a name is not known or a value is not a number of the right kind.
    """
    known = {item.name: getattr(DEFAULT_SETTINGS, item.name) for item in fields(DiagnosisSettings)}
    values: dict[str, Any] = {}
    for text in assignments:
        name, _, value = text.partition('=')
        if name not in known:
            raise ConfigError(f'{name!r} is not known', where=where, todo=did_you_mean(name, known))
        kind = type(known[name])
        try:
            values[name] = kind(value)
        except ValueError as error:
            todo = f'give NAME={"WHOLE_NUMBER" if kind is int else "NUMBER"}'
            raise ConfigError(f'{name} is {value!r}', where=where, todo=todo) from error
        if not 0.0 <= values[name] < math.inf:
            raise ConfigError(f'{name} is {value!r}', where=where, todo='give a finite number, 0 or more')
    return replace(DEFAULT_SETTINGS, **values)
