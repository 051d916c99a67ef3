"""Recordings of images by another simulator: the calibration converges, and its model fits."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from recordings import ModifiedSource, each

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ImuSample
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.in_memory import preload

BAGS = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'foreign-images'


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BAGS.exists(), reason='no foreign-images beside the project'),
]


def with_asymmetry(size: float, scale_factor: float) -> Callable[[ImuSample], ImuSample]:
    """Return what makes a gyro read `rate = scale factor * reading + size * |reading|`."""

    def read(sample: ImuSample) -> ImuSample:
        x, y, z = sample.rate_rad_s
        return replace(sample, rate_rad_s=(x, y, z / (1.0 + (size if z > 0.0 else -size) / scale_factor)))

    return read


@pytest.mark.thorough
def test_an_asymmetry_is_found_though_there_are_few_turns() -> None:
    """A minute has four or five turns, so the scatter of the stretches says little; a run decides."""
    size, scale_factor = 0.003, json.loads((BAGS / 'clean.truth.json').read_text())['scale_factor']
    gyro = each(ImuSample, with_asymmetry(size, scale_factor))
    source, config = preload(
        ModifiedSource(open_bag(BAGS / 'clean', Config()), gyro), Config(), default_model()
    )

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        return calibrate(source, config, model, candidates=candidates)

    found = search(default_model(), summarise_recording(source), run)
    assert [item.effect.name for item in found.kept] == ['scale_asymmetry']
    (value,), (std,) = found.last.estimate_of('scale_asymmetry')
    assert abs(value - size) < 3.0 * std
    assert found.last.run.state.coefficients[0] == pytest.approx(scale_factor - 1.0, abs=1e-4)


@pytest.mark.thorough
def test_a_recording_without_a_missing_effect_converges() -> None:
    run = calibrate(open_bag(BAGS / 'soft', Config()), Config(), default_model(), follows_changes=True)
    calibration = conclude(run)
    assert calibration.converged
    assert calibration.scale_factor_std < 1e-4
    assert 0.7 < run.history.nis.sum() / run.history.dof.sum() < 1.5
