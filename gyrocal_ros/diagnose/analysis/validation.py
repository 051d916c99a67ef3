"""Validation: a model with the coefficients that one recording gave, on another recording."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from gyrocal_ros.diagnose.analysis.drift import BlindDrift, blind_drift, held_out_from_s
from gyrocal_ros.diagnose.analysis.paths import Heading
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.pipeline.calibration import Calibration, conclude


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """One model, fitted on a training recording, on a test recording."""

    training: Calibration
    """Bias and coefficients by the training recording."""
    test: Calibration
    """Bias and coefficients by the test recording."""
    drift: BlindDrift
    """Blind drift on the test recording with the coefficients of the training recording."""
    fitted: BlindDrift
    """Blind drift of the same spans with the coefficients that were fitted on them."""


@dataclass(frozen=True, slots=True)
class CoefficientPair:
    """A coefficient by two recordings."""

    name: str
    unit: str
    training: float
    training_std: float
    test: float
    test_std: float

    @property
    def sigma(self) -> float:
        """Difference in standard deviations of the difference; NaN where both are exact."""
        std = math.hypot(self.training_std, self.test_std)
        return (self.test - self.training) / std if std > 0.0 else math.nan

    @property
    def is_zero(self) -> bool:
        """True if both recordings leave it within one standard deviation of zero."""
        return abs(self.training) <= self.training_std and abs(self.test) <= self.test_std


def validate(training: Calibration, run: Run, reference: tuple[Heading, str]) -> Validation:
    """Compare the coefficients of a training recording with a run over a test recording.

    The spans begin with the bias that was known by then: it differs from one start of a gyro to the next. The
    coefficients are those of the training recording, so no span was used for them.

    Args:
        training: calibration by the training recording.
        run: run of the same model over the test recording.
        reference: heading over the test recording to compare with, and its name.
    """
    from_s = held_out_from_s(run)
    drift = blind_drift(run, reference, from_s, coefficients=training.values[1:])
    fitted = blind_drift(run, reference, from_s, coefficients=run.history.coefficients[-1])
    return Validation(training, conclude(run), drift, fitted)


def coefficient_pairs(validation: Validation) -> Iterator[CoefficientPair]:
    """Yield the bias and each coefficient by both recordings."""
    one, other = validation.training, validation.test
    columns = (one.names, one.units, one.values, one.stds, other.values, other.stds)
    for name, unit, *numbers in zip(*columns, strict=True):
        yield CoefficientPair(name, unit, *map(float, numbers))
