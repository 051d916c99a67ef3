"""What a report says in words and in tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.diagnosis import MissingEffect
from gyrocal_ros.diagnose.drift import REFERENCES, BlindDrift
from gyrocal_ros.effects.base import with_unit
from gyrocal_ros.effects.describe import NOT_ESTIMATED
from gyrocal_ros.ekf.run import History
from gyrocal_ros.ekf.state import YAW_BIAS
from gyrocal_ros.pipeline.calibration import Calibration

Kind: TypeAlias = Literal['good', 'found', 'bad']


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a technician wants to know first."""

    kind: Kind
    """All is well; something was found that wants doing; not to be relied on."""
    headline: str
    sentences: tuple[str, ...]
    todo: tuple[str, ...] = ()
    """What to do next."""

    @property
    def good(self) -> bool:
        """Whether all is well."""
        return self.kind == 'good'


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table of coefficients."""

    name: str
    value: str
    unit: str
    """Value with its standard deviation, in the unit of the effect library."""
    known_before: str
    meaning: str
    """The same as people are used to it."""


def verdict(calibration: Calibration, config: Config, before: BlindDrift, after: BlindDrift) -> Verdict:
    """Sum a calibration up in a few sentences.

    Args:
        calibration: the result.
        config: the settings it was made with.
        before: blind drift of the nominal gyro.
        after: blind drift of the calibrated gyro.
    """
    good, headline = _headline(calibration, config)
    sentences = [_scale_sentence(calibration), _bias_sentence(calibration)]
    if len(after.error_rad):
        spread = 'rms' if len(after.error_rad) > 1 else 'in the one span that there is room for,'
        sentences.append(
            f'With the camera covered, the heading drifts {after.rms_deg:.3g} deg in {after.span_s:.0f} s '
            f'({spread} against {REFERENCES[after.reference]}; worst {after.max_deg:.3g} deg). '
            f'With the nominal scale factor it was {before.rms_deg:.3g} deg.'
        )
    return Verdict('good' if good else 'bad', headline, tuple(sentences))


def coefficient_rows(calibration: Calibration, history: History) -> list[Row]:
    """Bias and coefficients, each with what was known of it before the recording."""
    before = zip(history.mean[0, YAW_BIAS:], history.std[0, YAW_BIAS:], strict=True)
    after = zip(calibration.names, calibration.values, calibration.stds, calibration.units, strict=True)
    return [
        Row(name, with_std(value, std), unit, with_std(*prior), meaning(name, value, std, unit))
        for (name, value, std, unit), prior in zip(after, before, strict=True)
    ]


def estimate_rows(finding: MissingEffect) -> Iterator[tuple[str, str, str, str]]:
    """Name, value and unit of each coefficient of an effect that was found, and what that means."""
    items = zip(finding.effect.coefficients, finding.names, finding.values, finding.stds, strict=True)
    for item, name, value, std in items:
        if std == 0.0:
            yield name, f'{value:.4g}', item.unit, f'{with_unit(float(value), item.unit)}, {NOT_ESTIMATED}'
        elif item.unit == '1' and finding.effect.acts_on == 'gyro':
            yield name, with_std(value, std), '1', f'{with_std(100.0 * value, 100.0 * std)} % of the rate'
        else:
            yield name, with_std(value, std), item.unit, meaning(name, value, std, item.unit)


def with_std(value: float, std: float) -> str:
    """A number and its standard deviation, to two digits of the latter: `0.92555 ± 0.00021`."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f'{value:g} ± {std:g}'
    decimals = 1 - math.floor(math.log10(std))
    if decimals > 8:
        return f'{value:.4g} ± {std:.2g}'
    shown = max(decimals, 0)
    return f'{round(value, decimals):.{shown}f} ± {round(std, decimals):.{shown}f}'


def with_gain(gain: float, sigma: float) -> str:
    """A gain of log-likelihood, and by how many sigma it is more than chance where that is known."""
    if not math.isfinite(gain):
        return 'runs at all'
    return f'{gain:+.1f} ({sigma:.1f} sigma)' if math.isfinite(sigma) else f'{gain:+.1f}'


def _headline(calibration: Calibration, config: Config) -> tuple[bool, str]:
    threshold = f'{100.0 * config.convergence.scale_std:g} %'
    if calibration.converged:
        return True, (
            f'Calibrated: the scale factor was known to {threshold} after '
            f'{calibration.convergence_time_s:.0f} s.'
        )
    if calibration.convergence_time_s is None:
        return False, (
            f'Not calibrated yet: the scale factor is known to {100.0 * calibration.scale_factor_std:.2g} % '
            f'only, not to {threshold}. Record more turns, both ways, while the camera sees the ceiling.'
        )
    return False, (
        'Not to be trusted: at the end the measurements differ from what the filter expects, as the figure '
        'of the innovations shows. Look at the warnings, the camera calibration and the time stamps.'
    )


def _scale_sentence(calibration: Calibration) -> str:
    nominal = calibration.nominal_scale_factor_volt
    volt = with_std(calibration.scale_factor_volt, calibration.scale_factor_std * nominal)
    excess = 100.0 * (1.0 / abs(calibration.scale_factor) - 1.0)
    how = f'{abs(excess):.2f} % too {"much" if excess > 0.0 else "little"}'
    if calibration.scale_factor < 0.0:
        how += ', and turns the wrong way round'
    return (
        f'The scale factor is {with_std(calibration.scale_factor, calibration.scale_factor_std)}, that is '
        f'{volt} deg/s/V instead of the nominal {nominal:g}: uncalibrated, the gyro reports {how}.'
    )


def _bias_sentence(calibration: Calibration) -> str:
    bias = with_std(math.degrees(calibration.values[0]), math.degrees(calibration.stds[0]))
    return f'The bias at the end is {bias} deg/s, to be added to the scaled rate.'


def meaning(name: str, value: float, std: float, unit: str) -> str:
    """A coefficient as people are used to it; empty where it is that already."""
    if name == 'scale_factor':
        return f'true rate = ({with_std(1.0 + value, std)}) times the nominal rate'
    if unit.startswith('rad'):
        return f'{with_std(math.degrees(value), math.degrees(std))} deg{unit.removeprefix("rad")}'
    return ''
