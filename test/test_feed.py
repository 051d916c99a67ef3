"""The feed of the outputs of a running robot."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.report.calibration_figures import live
from gyrocal_ros.robot.feed import MAX_POINTS, Feed
from gyrocal_ros.robot.health import Level


def values(scale: float, std: float = 0.001) -> dict[str, object]:
    return {'gyro.scale_factor': scale, 'gyro.scale_factor_std': std, 'gyro.converged': True}


def test_calibrations_are_kept_in_order() -> None:
    feed = Feed(start_s=100.0)
    for second, scale in enumerate((1.0, 0.95, 0.93)):
        feed.calibration(values(scale), 101.0 + second)
    overview = feed.overview(110.0)
    assert overview.time_s.tolist() == [1.0, 2.0, 3.0] and overview.scale_factor.tolist() == [1.0, 0.95, 0.93]
    assert overview.calibration['gyro.converged'] is True


def test_a_silent_node_counts_as_gone() -> None:
    feed = Feed(0.0)
    feed.health('calibrator', 1, 'not converged yet', {'recent_nis': '1.02'}, 1.0)
    feed.health('tracker', 7, 'odd', {'recent_nis': 'none'}, 9.0)
    calibrator, tracker = feed.overview(10.0).nodes
    assert calibrator.is_gone and calibrator.level is Level.WARN
    assert not tracker.is_gone and tracker.level is Level.ERROR, 'an unknown level counts as an error'
    assert feed.overview(10.0).nis.tolist() == [1.02]


def test_memory_is_bounded() -> None:
    feed = Feed(0.0)
    for second in range(MAX_POINTS + 10):
        feed.calibration(values(1.0), float(second))
        feed.health('calibrator', 0, 'well', {'recent_nis': '1'}, float(second))
    overview = feed.overview(float(MAX_POINTS))
    assert len(overview.time_s) == len(overview.nis) == MAX_POINTS and overview.time_s[0] == 10.0


def test_every_update_increments_the_version() -> None:
    feed = Feed(0.0)
    assert feed.overview(0.0).version == 0
    feed.tracks(b'jpeg')
    overview = feed.overview(0.0)
    assert overview.version == 1 and overview.tracks == b'jpeg' and not len(overview.time_s)


def test_the_figure_has_a_closed_band_and_can_be_empty() -> None:
    time_s, scale = np.arange(40.0), np.linspace(1.0, 0.93, 40)
    figure = live(time_s, scale, np.full(40, 0.01), time_s, np.ones(40))
    band = next(trace for trace in figure.data if trace.name == '3 sigma')
    assert np.isnan(band.x).sum() == 1, 'one gap, at its end'
    none = np.empty(0)
    assert not len(live(none, none, none, none, none).data[0].x)
