"""Images of something else than the ceiling, for ten seconds: what is known of the gyro stays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from recordings import ModifiedSource, recording

from gyrocal_ros.bench.faults.semantic import FAULTS, Moment, faulty
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Measurement, seconds
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.ekf.watches.calibration_watch import MOST_CHANGE
from gyrocal_ros.ekf.watches.scale_watch import ScaleChange, ScaleWatch
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.world import SimSource

SIZE_S = 10.0
WITHOUT_STD = 5e-4
"""Standard deviation of the scale factor that half of the recording would give, and a little more."""


def with_fault(source: SimSource, name: str) -> ModifiedSource:
    """Return a recording whose camera is wrong for ten seconds from its middle."""

    def change(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        memory: dict[str, Any] = {}
        random = np.random.default_rng(0)
        for item in measurements:
            time_s = seconds(item.t_ns - source.span.start_ns)
            changed = faulty(item, FAULTS[name], Moment(time_s, SIZE_S, random, memory), source.rig)
            if changed is not None:
                yield changed

    return ModifiedSource(source, change)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 4])
@pytest.mark.parametrize(
    'name',
    ['old picture with new noise', 'dust in the dark', 'features wander', 'ids exchanged for a while'],
)
def test_images_of_something_else_do_not_spoil_a_calibration(name: str, seed: int) -> None:
    source = recording(seed=seed)
    run = calibrate(with_fault(source, name), Config(), default_model(), follows_changes=True)
    error = conclude(run).scale_factor - source.truth.scale_factor
    std = run.history.std[-1, COEFFICIENTS_START]
    assert abs(error) < 3.0 * std
    assert std < WITHOUT_STD


@pytest.mark.parametrize('change', [0.9 * MOST_CHANGE, 1.1 * MOST_CHANGE])
def test_a_change_larger_than_any_of_a_gyro_is_not_followed(
    change: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shown(watch: ScaleWatch, *arguments: Any) -> ScaleChange:
        return ScaleChange(0, -change, 0.01, 20.0, was_calibrated=True)

    monkeypatch.setattr(ScaleWatch, 'add', shown)
    monkeypatch.setattr(ScaleWatch, 'is_settled', True)
    monkeypatch.setattr(ScaleWatch, 'follow', lambda watch, state, change: state)
    run = calibrate(recording('cleaning', 3, 30.0), Config(), default_model(), follows_changes=True)
    assert run.history.scale_followed.any() == (change < MOST_CHANGE)
