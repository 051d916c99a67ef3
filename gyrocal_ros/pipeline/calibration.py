"""The result of a run, the calibration of the gyro, and its file `calibration.yaml`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gyrocal_ros import __version__
from gyrocal_ros.config.declare import to_dict
from gyrocal_ros.config.sections import Config
from gyrocal_ros.config.yaml_file import read_yaml
from gyrocal_ros.data import Array
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.ekf.history.convergence import Convergence, is_plausible
from gyrocal_ros.ekf.history.run import Run, step_by_step
from gyrocal_ros.ekf.history.scatter import scatter_of
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.ekf.map_watch import loses_its_map
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW_BIAS, State
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.files import write_text_atomic
from gyrocal_ros.model.sensor import SensorModel

BIAS_UNIT = 'rad/s'
MAX_TEMPERATURE_C = 1e3
"""Bound of the temperature of a gyro."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Bias and coefficients with their joint covariance and their provenance."""

    model: SensorModel
    names: tuple[str, ...]
    """`bias`, then the coefficients in the model's order."""
    units: tuple[str, ...]
    values: Array
    """(1 + k,)"""
    covariance: Array
    """(1 + k, 1 + k)"""
    nominal_scale_factor_volt: float
    converged: bool
    convergence_time_s: float | None
    """Time of convergence since the first sample; None without convergence."""
    duration_s: float
    source: str
    end_ns: int
    temperature_c: float = math.nan
    """Temperature of the gyro at the end; NaN where unknown."""
    doubt: str = ''
    """Why it is too early to call the innovations consistent, as a clause; empty where it is not."""

    @property
    def stds(self) -> Array:
        """(1 + k,) standard deviations."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def scale_factor(self) -> float:
        """True rate over nominal rate at small rates, 1 + a1."""
        return 1.0 + float(self.values[1])

    @property
    def scale_factor_std(self) -> float:
        """Standard deviation of the scale factor."""
        return float(self.stds[1])

    @property
    def scale_factor_volt(self) -> float:
        """Scale factor in the unit of a data sheet, deg/s/V."""
        return self.scale_factor * self.nominal_scale_factor_volt

    def start(self) -> Start:
        """Return the initial values for a later run."""
        return Start(self.names, self.values, self.covariance, self.end_ns, self.temperature_c)


def conclude(run: Run) -> Calibration:
    """Return the calibration at the end of a run.

    It has converged if the scale factor is known well enough, and neither the innovations nor the scatter of
    the estimates nor whole images contradict the filter, and gyro, wheels and images turn the same way. By
    how much the scale factor has changed during the run adds to its standard deviation, as do suspected
    errors of the camera; where the filter followed a change, only what came after counts. Innovations that
    are larger than expected enlarge the standard deviations.
    """
    history, criteria = run.history, run.config.convergence
    convergence, (scatter, inflations) = Convergence(), scatter_of(run)
    scale_stds = history.std[:, COEFFICIENTS_START] * inflations[:, SCALE]
    columns = (history.scale_followed, history.time_s, scale_stds, history.nis, history.dof)
    for followed, time_s, std, nis, dof in step_by_step(*columns):
        convergence = Convergence(after_change=True) if followed else convergence
        convergence.add(time_s, std, nis, dof, criteria)
    is_known = convergence.since_s is not None
    has_fault = bool(mounting_fault(run))
    is_contradicted = scatter.contradicts or loses_its_map(run) or has_fault
    return calibration_of(
        run.state,
        run.model,
        run.config,
        converged=is_known and convergence.is_consistent(criteria) and not is_contradicted,
        convergence_time_s=convergence.since_s,
        duration_s=run.span.duration_s,
        source=run.source,
        end_ns=run.span.end_ns,
        temperature_c=_last_finite(history.temperature_c),
        inflation=np.maximum(inflations[-1], convergence.inflation),
        doubt=convergence.doubt(criteria),
    )


def calibration_of(
    state: State,
    model: SensorModel,
    config: Config,
    *,
    converged: bool,
    convergence_time_s: float | None,
    duration_s: float,
    source: str,
    end_ns: int,
    temperature_c: float,
    inflation: Array,
    doubt: str = '',
) -> Calibration:
    """Return the calibration by a state of the filter.

    Args:
        inflation: (1 + k,) factors on the standard deviations of bias and coefficients
            (`ekf.history.scatter`).

    The other keyword arguments are fields of `Calibration`.
    """
    places = [YAW_BIAS, *range(COEFFICIENTS_START, state.robot_size)]
    return Calibration(
        model=model,
        names=('bias', *model.coefficient_names),
        units=(BIAS_UNIT, *(item.unit for item in model.coefficients)),
        values=state.mean[places],
        covariance=state.covariance[np.ix_(places, places)] * np.outer(inflation, inflation),
        nominal_scale_factor_volt=config.gyro.nominal_scale_factor_volt,
        converged=converged,
        convergence_time_s=convergence_time_s,
        duration_s=duration_s,
        source=source,
        end_ns=end_ns,
        temperature_c=temperature_c,
        doubt=doubt,
    )


def _last_finite(values: Array) -> float:
    """Return the last finite value; NaN without one."""
    finite = values[np.isfinite(values)]
    return float(finite[-1]) if len(finite) else math.nan


def save_calibration(
    calibration: Calibration, config: Config, path: Path, *, overwrite: bool = False
) -> None:
    """Write `calibration.yaml` atomically, with model, settings and provenance."""
    write_text_atomic(path, calibration_to_yaml(calibration, config), overwrite=overwrite)


def calibration_to_yaml(calibration: Calibration, config: Config | None = None) -> str:
    """Return the text of `calibration.yaml`; without `config` it lacks the settings, which a robot has."""
    settings = {} if config is None else {'settings': to_dict(config)}
    content = _to_dict(calibration) | settings
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110))


def load_calibration(path: Path) -> Calibration:
    """Read a `calibration.yaml`.

    Raises:
        ConfigError: the file cannot be read, or is not a calibration.
    """
    tree = read_yaml(path)
    try:
        model = model_from_dict(tree['model'], f'{path}, model')
        names = ('bias', *model.coefficient_names)
        values = np.array([float(tree['coefficients'][name]['value']) for name in names])
        covariance = np.array(tree['covariance'], float)
        if covariance.shape != (len(names),) * 2 or not np.isfinite([*values, *covariance.flat]).all():
            raise ValueError('a value or the covariance is incomplete')
        if not _is_covariance(covariance):
            raise ValueError('the covariance is not positive semidefinite')
        scale_factor = 1.0 + values[SCALE]
        if not is_plausible(scale_factor):
            raise ValueError(f'no gyro has a scale factor of {scale_factor:g}')
        if not math.isclose(float(tree['scale_factor']), scale_factor, abs_tol=1e-9):
            raise ValueError(f'scale_factor {tree["scale_factor"]} contradicts its coefficient')
        units = tuple(str(tree['coefficients'][name]['unit']) for name in names)
        if units != (BIAS_UNIT, *(item.unit for item in model.coefficients)):
            raise ValueError(f'the units {", ".join(units)} are not those of the model')
        if not isinstance(tree['converged'], bool):
            raise ValueError(f'converged is {tree["converged"]!r}, not true or false')
        provenance: Mapping[str, Any] = tree['provenance']
        time_s, temperature_c = tree['convergence_time_s'], provenance.get('temperature_c')
        return Calibration(
            model=model,
            names=names,
            units=units,
            values=values,
            covariance=covariance,
            nominal_scale_factor_volt=float(tree['nominal_scale_factor_volt']),
            converged=bool(tree['converged']),
            convergence_time_s=None if time_s is None else float(time_s),
            duration_s=float(provenance['duration_s']),
            source=str(provenance['source']),
            end_ns=int(provenance['end_ns']),
            temperature_c=math.nan if temperature_c is None else _temperature(float(temperature_c)),
        )
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ConfigError(
            f'is not a calibration ({_reason(error)})',
            where=str(path),
            todo='give a calibration.yaml that `gyrocal replay -o` wrote',
        ) from error


def _temperature(value_c: float) -> float:
    if abs(value_c) > MAX_TEMPERATURE_C:
        raise ValueError(f'the temperature is {value_c:g} deg C')
    return value_c


def _reason(error: Exception) -> str:
    """Return what is wrong with a file in words: the message of a KeyError is the name alone."""
    return f'there is no {error}' if isinstance(error, KeyError) else str(error)


def _is_covariance(matrix: Array) -> bool:
    """Return True if a matrix is symmetric and, up to rounding, positive semidefinite."""
    std = np.sqrt(np.abs(np.diagonal(matrix)))
    scale = np.where(std > 0.0, std, 1.0)
    correlation = matrix / np.outer(scale, scale)
    return bool(np.allclose(correlation, correlation.T) and np.linalg.eigvalsh(correlation).min() > -1e-9)


def _to_dict(calibration: Calibration) -> dict[str, Any]:
    temperature_c = calibration.temperature_c
    return {
        'scale_factor': calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'scale_factor_volt': calibration.scale_factor_volt,
        'nominal_scale_factor_volt': calibration.nominal_scale_factor_volt,
        'bias_deg_s': math.degrees(float(calibration.values[0])),
        'converged': calibration.converged,
        'convergence_time_s': calibration.convergence_time_s,
        'coefficients': coefficient_table(calibration),
        'covariance': calibration.covariance.tolist(),
        'model': model_to_dict(calibration.model),
        'provenance': {
            'source': calibration.source,
            'duration_s': calibration.duration_s,
            'end_ns': calibration.end_ns,
            'temperature_c': None if math.isnan(temperature_c) else temperature_c,
            'version': __version__,
        },
    }


def announcement(calibration: Calibration) -> dict[str, bool | float | str | list[str] | list[float]]:
    """Return the parameters of `/gyro_calibration`, by name; added effects are among the coefficients."""
    model, stds = calibration.model, calibration.stds
    return {
        'gyro.scale_factor': calibration.scale_factor,
        'gyro.scale_factor_std': calibration.scale_factor_std,
        'gyro.scale_factor_volt': calibration.scale_factor_volt,
        'gyro.bias': float(calibration.values[0]),
        'gyro.bias_std': float(stds[0]),
        'gyro.converged': calibration.converged,
        'gyro.model': f'{model.name} {model.version}',
        'gyro.coefficient_names': list(model.coefficient_names),
        'gyro.coefficients': calibration.values[1:].tolist(),
        'gyro.coefficient_stds': stds[1:].tolist(),
    }


def coefficient_table(calibration: Calibration) -> dict[str, dict[str, Any]]:
    """Return value, standard deviation and unit by name, as in files and in JSON output."""
    columns = (calibration.names, calibration.values, calibration.stds, calibration.units)
    return {
        name: {'value': float(value), 'std': float(std), 'unit': unit}
        for name, value, std, unit in zip(*columns, strict=True)
    }
