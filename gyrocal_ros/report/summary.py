"""The figures of merit of a run under the names that scripts rely on."""

from __future__ import annotations

from typing import Any

from gyrocal_ros.calibration import Calibration, coefficient_table
from gyrocal_ros.diagnose.drift import blind_drift, heading_rms_deg
from gyrocal_ros.ekf.run import Run


def summarise(run: Run, calibration: Calibration) -> dict[str, Any]:
    """What `replay --json` prints, but for the time it took."""
    summary: dict[str, Any] = {
        'source': run.source,
        'scale_factor': calibration.scale_factor,
        'scale_factor_std': calibration.scale_factor_std,
        'scale_factor_volt': calibration.scale_factor_volt,
        'bias': float(calibration.values[0]),
        'bias_std': float(calibration.stds[0]),
        'converged': calibration.converged,
        'convergence_time_s': calibration.convergence_time_s,
        'coefficients': coefficient_table(calibration),
        'duration_s': calibration.duration_s,
        'nis_per_dof': float(run.history.nis.sum() / run.history.dof.sum()),
        'events': [event.text for event in run.events],
    }
    heading_rms = heading_rms_deg(run)
    if heading_rms is not None:
        drift = blind_drift(run)
        summary['heading_rms_deg'] = heading_rms
        summary['blind_drift_deg'] = {'rms': drift.rms_deg, 'max': drift.max_deg}
    return summary
