"""Tests of a camera that is switched on when the robot has long been on its way."""

from __future__ import annotations

import numpy as np
import pytest
from filter_states import some_state
from recordings import ModifiedSource, recording, without

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations
from gyrocal_ros.diagnose.analysis.drift import heading_error
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.state.layout import POSITION, YAW
from gyrocal_ros.ekf.state.pauses import at_own_origin
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

BEGINS_S = 30.0


@pytest.mark.slow
@pytest.mark.parametrize(('scenario', 'seed'), [('lanes', 1), ('cleaning', 1), ('cleaning', 2)])
def test_the_calibration_is_as_good_as_if_the_recording_began_then(scenario: str, seed: int) -> None:
    source = recording(scenario, seed, 75.0)
    run = calibrate(
        ModifiedSource(source, without(FeatureObservations, to_s=BEGINS_S)),
        Config(),
        default_model(),
        candidates=(find_effect('scale_asymmetry'),),
    )
    calibration = conclude(run)
    z = (calibration.scale_factor - source.truth.scale_factor) / calibration.scale_factor_std
    assert abs(z) < 3.0 and calibration.scale_factor_std < 4e-4
    assert calibration.converged and BEGINS_S < (calibration.convergence_time_s or 0.0) < 65.0
    assert not run.events
    history = run.history
    first = int(np.argmax(history.in_view > 0))
    assert history.std[first - 1, YAW] == 0.0 and history.std[first - 2, YAW] > 0.1, 'the gyro was not known'
    error = heading_error(run)
    assert error is not None and error.time_s[0] >= history.time_s[first]
    assert np.degrees(np.abs(error.error_rad).max()) < 0.3


def test_only_position_and_heading_are_free() -> None:
    filled = some_state()
    state = at_own_origin(filled)
    free = [*range(POSITION.start, POSITION.stop), YAW]
    others = np.setdiff1d(np.arange(len(filled.mean)), free)
    assert not state.covariance[free].any() and not state.covariance[:, free].any()
    assert not state.sensitivity[free].any() and filled.sensitivity[free].any()
    np.testing.assert_array_equal(state.mean, filled.mean)
    np.testing.assert_array_equal(
        state.covariance[np.ix_(others, others)], filled.covariance[np.ix_(others, others)]
    )
    np.testing.assert_array_equal(state.sensitivity[others], filled.sensitivity[others])
