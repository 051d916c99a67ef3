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
from gyrocal_ros.ekf.state import COEFFICIENTS_START
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
