"""Recordings of images by another simulator: the calibration converges, and its model fits."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

BAGS = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'foreign-images'


@pytest.mark.slow
@pytest.mark.skipif(not BAGS.exists(), reason='no foreign-images beside the project')
def test_a_recording_without_a_missing_effect_converges() -> None:
    run = calibrate(open_bag(BAGS / 'soft', Config()), Config(), default_model(), follows_changes=True)
    calibration = conclude(run)
    assert calibration.converged
    assert calibration.scale_factor_std < 1e-4
    assert 0.7 < run.history.nis.sum() / run.history.dof.sum() < 1.5
