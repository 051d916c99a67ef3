"""Figures of the studio: small for recordings of any length, without loss of spikes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_parts import HIDDEN, InProcessWorker, open_session

from gyrocal_ros.ekf.history.run import History
from gyrocal_ros.studio import pictures
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.state import StudioState

HOUR = 36
"""Number of repetitions of the recording."""
MAX_BYTES = 200_000
SPIKE_DEG = 33.0


@pytest.fixture(scope='module')
def opened(
    uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Session, InProcessWorker]]:
    session, worker = open_session(uneven_bag, tmp_path_factory.mktemp('out') / 'session')
    session.add(HIDDEN)
    worker.work()
    yield session, worker
    session.close()


@pytest.fixture
def state(opened: tuple[Session, InProcessWorker]) -> StudioState:
    return opened[0].state


def lengthened(history: History) -> History:
    """Repeat a history to an hour, with one large innovation."""
    long = {item.name: np.concatenate([getattr(history, item.name)] * HOUR) for item in fields(history)}
    steps = len(history.time_s)
    long['time_s'] += np.repeat(np.arange(HOUR), steps) * (history.time_s[-1] + history.dt_s[-1])
    measured = np.flatnonzero(np.isfinite(long['heading_innovation_rad']))
    long['heading_innovation_rad'][measured[len(measured) // 2]] = np.radians(SPIKE_DEG)
    return History(**long)


def an_hour(state: StudioState) -> StudioState:
    """Return the state after a recording of an hour."""
    models = []
    for tried in state.tree.models:
        assert tried.examination is not None
        examined = tried.examination.examined
        run = replace(examined.run, history=lengthened(examined.run.history), truth=None)
        examination = replace(tried.examination, examined=replace(examined, run=run))
        models.append(replace(tried, examination=examination))
    return replace(state, tree=ModelTree(tuple(models), state.tree.present_label))


def size_bytes(figure: Any) -> int:
    return len(figure.to_json())


@pytest.mark.slow
def test_figures_of_an_hour_are_small(state: StudioState) -> None:
    long = an_hour(state)
    first = replace(long, tree=replace(long.tree, present_label=long.tree.models[0].label))
    for one in (long, first):
        assert one.examination is not None
        assert one.examination.examined.run.history.time_s[-1] > 3500.0
        for kind in pictures.KINDS:
            assert size_bytes(pictures.against_measurement(one, kind)) < MAX_BYTES, kind


@pytest.mark.slow
def test_a_spike_in_an_hour_is_drawn(state: StudioState) -> None:
    long = an_hour(state)
    first = replace(long, tree=replace(long.tree, present_label=long.tree.models[0].label))
    figure = pictures.against_measurement(first, 'innovations')
    assert figure is not None
    drawn = next(trace for trace in figure.data if trace.name == 'innovation as a heading')
    assert np.nanmax(drawn.y) == pytest.approx(SPIKE_DEG) and len(drawn.x) <= 1500


def test_the_curve_of_the_added_effect_fits_the_error_before(state: StudioState) -> None:
    figure = pictures.error_by_signal(state, 'rate (deg/s)', False)
    assert figure is not None
    first, present, added = (
        next(trace for trace in figure.data if trace.name == name)
        for name in (pictures.FIRST, pictures.PRESENT, 'by the effects added')
    )
    assert np.allclose(added.y, first.y, atol=first.error_y.array.max())
    assert np.abs(present.y).max() < 0.1 * np.abs(first.y).max()


def test_spans_with_the_camera_off_are_shaded(state: StudioState) -> None:
    present = state.tree.present
    assert present is not None and present.examination is not None
    examined = present.examination.examined
    run = examined.run
    blind = (run.history.time_s > 30.0) & (run.history.time_s < 45.0)
    seen = np.where(blind, np.nan, run.history.heading_innovation_rad)
    in_view = np.where(blind, 0.0, run.history.in_view)
    run = replace(run, history=replace(run.history, heading_innovation_rad=seen, in_view=in_view))
    examination = replace(present.examination, examined=replace(examined, run=run))
    tree = state.tree.with_examination(present.label, examination)
    figure = pictures.against_measurement(replace(state, tree=tree), 'heading')
    assert figure is not None
    spans = {(shape.x0, shape.x1) for shape in figure.layout.shapes if shape.type == 'rect'}
    assert [(pytest.approx(30.0, abs=0.3), pytest.approx(45.0, abs=0.3))] == sorted(spans)
    assert [note.text for note in figure.layout.annotations].count('camera off') == 1


@pytest.mark.slow
def test_every_panel_names_its_unit(state: StudioState) -> None:
    for name, figure in pictures.all_figures(state).items():
        axes = [axis.title.text or '' for axis in figure.select_yaxes()]
        assert figure.layout.title.text, name
        if name in ('heading', 'drift', 'revisions', 'left_over_1'):
            assert any('deg' in text or '%' in text for text in axes), name
