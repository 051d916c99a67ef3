"""Initial calibration of the next robot, from the fleet that it comes from."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.effects.model_file import model_from_dict
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.fleet.findings import TEMPERATURE, Findings
from gyrocal_ros.fleet.hierarchy import FleetEstimate
from gyrocal_ros.pipeline.calibration import Calibration

MIN_ROBOTS = 5
"""Minimum number of robots for a prior."""


def prior_of(found: Findings, config: Config) -> Calibration:
    """Return the prior as a calibration, in the form that `replay --start-from` reads.

    A new part is a draw from the fleet: its mean is that of the fleet at zero running hours, its variance
    the predictive one, tau^2 + omega^2 + var(mean) + slope^2 var(temperature). The number of robots is small,
    so the variances are multiplied by (m - 1) / (m - 3), the variance of Student's t with m - 1 degrees of
    freedom (Gelman et al. 2013, section 3.2). It is multiplied with the prior of the model, which is all
    there is for a coefficient that no bag tells.

    Raises:
        GyrocalError: bias or scale factor are known of too few robots.
    """
    model = model_from_dict(found.table.model, 'model of the fleet')
    names = ('bias', *model.coefficient_names)
    values, variances = [], []
    temperatures = found.table.numbers('temperature_c')
    for name in names:
        mean, std = found.table.priors.get(name, (0.0, math.inf))
        fitted = found.coefficients.get(name)
        offset = 1.0 if name == SCALE_FACTOR else 0.0  # the model estimates what is beyond 1
        if fitted is not None and fitted.robots >= MIN_ROBOTS:
            information = np.array([1.0 / _predictive_variance(fitted, temperatures), std**-2.0])
            values.append(float(np.average([fitted.mean.value, mean], weights=information)) - offset)
            variances.append(1.0 / float(information.sum()))
        elif name in ('bias', SCALE_FACTOR):
            what = f'{name} is known of too few robots'
            todo = f'a prior needs {MIN_ROBOTS} robots, record more'
            raise GyrocalError(what, where=', '.join(map(str, found.table.folders)), todo=todo)
        else:
            values.append(mean)
            variances.append(std**2)
    robots = max(estimate.robots for estimate in found.coefficients.values())
    return Calibration(
        model=model,
        names=names,
        units=('rad/s', *(item.unit for item in model.coefficients)),
        values=np.array(values),
        covariance=np.diag(variances),
        nominal_scale_factor_volt=config.gyro.nominal_scale_factor_volt,
        converged=False,
        convergence_time_s=None,
        duration_s=float(np.nansum(found.table.numbers('duration_s'))),
        source=f'prior from a fleet of {robots} robots',
        end_ns=0,
    )


def _predictive_variance(fitted: FleetEstimate, temperatures: np.ndarray) -> float:
    robots = fitted.robots
    spread = fitted.spread.value**2 + fitted.bag_spread**2 + fitted.mean.std**2
    slope = fitted.slopes.get(TEMPERATURE)
    if slope is not None:
        spread += (slope.value * float(np.nanstd(temperatures))) ** 2
    variance = spread * (robots - 1) / (robots - 3)
    assert math.isfinite(variance)
    return variance
