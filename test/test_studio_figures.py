"""Figures of the studio: small for recordings of any length, without loss of spikes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_parts import HIDDEN, Desk, open_session

from gyrocal_ros.ekf.run import History
from gyrocal_ros.studio import pictures
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.state import StudioState

HOUR = 36
"""Number of repetitions of the recording."""
MAX_BYTES = 200_000
SPIKE_DEG = 33.0


@pytest.fixture(scope='module')
def opened(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Session, Desk]]:
    session, desk = open_session(uneven_bag, tmp_path_factory.mktemp('out') / 'session')
    session.add(HIDDEN)
    desk.work()
    yield session, desk
    session.close()


@pytest.fixture
def view(opened: tuple[Session, Desk]) -> StudioState:
    return opened[0].view


def lengthened(history: History) -> History:
    """Repeat a history to an hour, with one innovation that is far off."""
    long = {item.name: np.concatenate([getattr(history, item.name)] * HOUR) for item in fields(history)}
    steps = len(history.time_s)
    long['time_s'] += np.repeat(np.arange(HOUR), steps) * (history.time_s[-1] + history.dt_s[-1])
    measured = np.flatnonzero(np.isfinite(long['heading_innovation_rad']))
    long['heading_innovation_rad'][measured[len(measured) // 2]] = np.radians(SPIKE_DEG)
    return History(**long)


def an_hour(view: StudioState) -> StudioState:
    """Return the state after a recording of an hour."""
    every = []
    for trial in view.trials.every:
        assert trial.examined is not None
        stage = trial.examined.stage
        run = replace(stage.run, history=lengthened(stage.run.history), truth=None)
        every.append(replace(trial, examined=replace(trial.examined, stage=replace(stage, run=run))))
    return replace(view, trials=ModelTree(tuple(every), view.trials.present))


def size_bytes(figure: Any) -> int:
    return len(figure.to_json())


@pytest.mark.slow
def test_figures_of_an_hour_are_small(view: StudioState) -> None:
    long = an_hour(view)
    first = replace(long, trials=replace(long.trials, present=long.trials.every[0].label))
    for state in (long, first):
        assert state.trials.now is not None and state.trials.now.examined is not None
        assert state.trials.now.examined.stage.run.history.time_s[-1] > 3500.0
        for kind in pictures.KINDS:
            assert size_bytes(pictures.against_measurement(state, kind)) < MAX_BYTES, kind


@pytest.mark.slow
def test_a_spike_in_an_hour_is_drawn(view: StudioState) -> None:
    long = an_hour(view)
    first = replace(long, trials=replace(long.trials, present=long.trials.every[0].label))
    figure = pictures.against_measurement(first, 'innovations')
    assert figure is not None
    drawn = next(trace for trace in figure.data if trace.name == 'innovation as a heading')
    assert np.nanmax(drawn.y) == pytest.approx(SPIKE_DEG) and len(drawn.x) <= 1500


def test_the_curve_of_the_added_effect_fits_the_error_before(view: StudioState) -> None:
    figure = pictures.left_over(view, 'rate (deg/s)', False)
    assert figure is not None
    first, now, added = (
        next(trace for trace in figure.data if trace.name == name)
        for name in (pictures.AS_IT_WAS, pictures.NOW, 'by the effects added')
    )
    assert np.allclose(added.y, first.y, atol=first.error_y.array.max())
    assert np.abs(now.y).max() < 0.1 * np.abs(first.y).max()


def test_spans_with_the_camera_off_are_shaded(view: StudioState) -> None:
    now = view.trials.now
    assert now is not None and now.examined is not None
    run = now.examined.stage.run
    blind = (run.history.time_s > 30.0) & (run.history.time_s < 45.0)
    seen = np.where(blind, np.nan, run.history.heading_innovation_rad)
    run = replace(run, history=replace(run.history, heading_innovation_rad=seen))
    examined = replace(now.examined, stage=replace(now.examined.stage, run=run))
    figure = pictures.against_measurement(
        replace(view, trials=view.trials.ran(now.label, examined)), 'heading'
    )
    assert figure is not None
    spans = {(shape.x0, shape.x1) for shape in figure.layout.shapes if shape.type == 'rect'}
    assert [(pytest.approx(30.0, abs=0.3), pytest.approx(45.0, abs=0.3))] == sorted(spans)
    assert [note.text for note in figure.layout.annotations].count('camera off') == 1


@pytest.mark.slow
def test_every_panel_names_its_unit(view: StudioState) -> None:
    for name, figure in pictures.all_of(view).items():
        axes = [axis.title.text or '' for axis in figure.select_yaxes()]
        assert figure.layout.title.text, name
        if name in ('heading', 'drift', 'revisions', 'left_over_1'):
            assert any('deg' in text or '%' in text for text in axes), name
