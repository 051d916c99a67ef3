"""Where failures of the model lie on the axes of the figures."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from studio_parts import HIDDEN, open_session

from gyrocal_ros.diagnose.analysis.regimes import Failure, regimes
from gyrocal_ros.diagnose.analysis.shapes import RATE, TIME
from gyrocal_ros.diagnose.series.failure_ranges import MAX_STRETCHES, failure_ranges
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.studio import pictures
from gyrocal_ros.studio.state import StudioState


@pytest.fixture(scope='module')
def state(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> StudioState:
    session, worker = open_session(uneven_bag, tmp_path_factory.mktemp('ranges') / 'session')
    session.add(HIDDEN)
    worker.work()
    session.reveal()
    session.close()
    return session.state


@pytest.fixture
def run(state: StudioState) -> Run:
    assert state.examination is not None
    return state.examination.examined.run


def test_a_stretch_of_time_is_one_range(run: Run) -> None:
    (found,) = failure_ranges(run, [Failure('', 5.0, from_s=20.0, to_s=30.0)])
    assert np.array(found[TIME]) == pytest.approx(np.array([[20.0, 30.0]]), abs=0.2)


def test_turns_to_one_side_are_many_stretches_and_one_range_of_the_rate(run: Run) -> None:
    (found,) = failure_ranges(run, [Failure('', 5.0, regime='turning left')])
    (rate,) = found[RATE]
    assert rate[0] > 0.0 and 1 < len(found[TIME]) <= MAX_STRETCHES
    turning = run.history.turn_rad > 0.0
    for low, high in found[TIME]:
        inside = (run.history.time_s >= low) & (run.history.time_s <= high)
        assert np.mean(turning[inside]) > 0.8


def test_a_range_of_a_signal_ends_where_the_next_begins(run: Run) -> None:
    names = [regime.name for regime in regimes(run) if regime.name.startswith(TIME)]
    found = failure_ranges(run, [Failure('', 5.0, regime=name) for name in dict.fromkeys(names)])
    stretches = [one[TIME] for one in found]
    assert len(stretches) > 2 and all(len(one) == 1 for one in stretches)
    assert all(earlier[0][1] < later[0][0] for earlier, later in pairwise(stretches))


def test_coefficients_are_drawn_over_time_with_the_truth_when_it_is_known(state: StudioState) -> None:
    figure = pictures.against_measurement(state, 'coefficients')
    hidden = pictures.against_measurement(replace(state, revealed=None), 'coefficients')
    assert figure is not None and hidden is not None
    titles = [axis.title.text for axis in figure.select_yaxes()]
    assert titles[0] == 'bias<br>(deg/s)' and any(HIDDEN in title for title in titles)
    lines = [shape.y0 for shape in figure.layout.shapes]
    assert len(lines) == 2 and not hidden.layout.shapes
    assert state.revealed is not None
    for item in state.revealed.coefficients:
        assert item.in_model is not None and item.in_model[1] in lines
        drawn = next(one for one in figure.data if one.name == item.in_model[0])
        assert drawn.y[-1] == pytest.approx(item.in_model[1], abs=float(drawn.customdata[-1]) + 1e-4)
