"""Learning of an unknown law in the studio: the evidence first, then the addition, then the way back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studio_parts import HIDDEN, InProcessWorker, open_session

from gyrocal_ros.diagnose.diagnosis import diagnose_before_adding
from gyrocal_ros.diagnose.status import diagnosis_status
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio import panels, pictures
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.tasks import LearnedResult, Stopped

LAW, AXIS = 'bias_curve:heading', ('heading in the map (deg)', False)
AMPLITUDE_DEG_S, PHASE_RAD = 0.5, 0.7


@pytest.fixture(scope='module')
def learned(
    strange_bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Session, InProcessWorker]]:
    """A session that has learned a law and not added it."""
    session, worker = open_session(strange_bag, tmp_path_factory.mktemp('out') / 'session')
    assert session.state.can_learn
    session.learn()
    worker.work()
    yield session, worker
    session.close()


@pytest.mark.slow
def test_the_law_is_proposed_with_its_closed_form(learned: tuple[Session, InProcessWorker]) -> None:
    state = learned[0].state
    assert state.proposal is not None and state.proposal.name == LAW and not state.can_learn
    assert [one.label for one in state.tree.models] == ['0_default'], 'nothing was added'
    form = state.proposal.law.forms[0]
    assert form.form.name == 'sine of the heading' and form.fits
    truth = np.radians(AMPLITUDE_DEG_S) * np.array([np.cos(PHASE_RAD), np.sin(PHASE_RAD)])
    assert np.allclose(form.values, truth, atol=5e-5)
    assert panels.choices(state)[0].effect.name == LAW
    card = str(panels.candidate_card(state, LAW))
    assert 'sine of the heading' in card and 'from 4.' in card
    status = panels.status(state)
    assert status is not None and LAW in status.sentence and status.next_step.startswith(f'Add {LAW}')


@pytest.mark.slow
def test_its_curve_goes_through_the_error_left_over(learned: tuple[Session, InProcessWorker]) -> None:
    state = learned[0].state
    assert pictures.axis_of(state, LAW) == AXIS
    figure = pictures.error_by_signal(state, *AXIS, LAW)
    assert figure is not None
    drawn = {trace.name: trace for trace in figure.data}
    curve, points = drawn[f'by {LAW}, if added'], drawn[pictures.FIRST]
    assert '3 sigma' in drawn and 'sine of the heading (closed form that fits)' in drawn
    at_knots = np.interp(points.x, curve.x, curve.y)
    # Between knots 60 deg apart the error is taken as straight lines, which a sine is not.
    assert np.all(np.abs(at_knots - points.y) < points.error_y.array + 0.1 * AMPLITUDE_DEG_S)
    assert np.ptp(np.array(curve.y)) == pytest.approx(2.0 * AMPLITUDE_DEG_S, rel=0.05)
    elsewhere = pictures.error_by_signal(state, 'rate (deg/s)', False, LAW)
    assert elsewhere is not None and f'by {LAW}, if added' in {trace.name for trace in elsewhere.data}


@pytest.mark.slow
def test_adding_it_needs_no_run_reduces_the_error_and_can_be_undone(
    learned: tuple[Session, InProcessWorker],
) -> None:
    session, worker = learned
    count = len(worker.executed)
    session.add(LAW)
    before, after = session.improvement().revisions
    assert after.held_out.rms_deg < 0.1 * before.held_out.rms_deg and len(worker.executed) == count
    effect = load_model(session.folder / '1_bias_curve_heading' / 'model.yaml').effects[-1]
    assert effect.name == LAW
    status = panels.status(session.state)
    assert status is not None and status.level == 'green'
    session.undo()
    state = session.state
    assert state.tree.present_label == '0_default' and state.proposal is not None
    assert panels.choices(state)[0].effect.name == LAW, 'what was learned is not forgotten'


def test_a_model_that_fits_has_nothing_to_learn(uneven_bag: Path, tmp_path: Path) -> None:
    session, worker = open_session(uneven_bag, tmp_path / 'session')
    with pytest.raises(GyrocalError, match='press "Learn this"'):
        session.add('bias_curve:rate')
    session.add(HIDDEN)
    worker.work()
    with pytest.raises(GyrocalError, match='does not contradict'):
        session.learn()
    session.close()


def test_learning_without_a_result_and_a_cancelled_one(uneven_bag: Path, tmp_path: Path) -> None:
    session, _ = open_session(uneven_bag, tmp_path / 'session')
    assert session.state.can_learn
    for message, can_learn in ((Stopped(), True), (LearnedResult(None), False)):
        session.learn()
        running = session.state.running
        assert running is not None and session.state.is_busy
        session.receive(running.number, message)
        assert session.state.running is None and session.state.proposal is None
        assert session.state.can_learn == can_learn
    examination = session.state.examination
    assert examination is not None
    present = session.state.tree.present
    assert present is not None
    recorded = session.state.recorded
    assert recorded is not None
    status = panels.status(session.state)
    assert status is not None and status.next_step == f'Add {HIDDEN}, and compare the drift.'
    assert status.level == 'yellow' and status.sentence.startswith(f'Missing: {HIDDEN}')
    nothing_known = diagnose_before_adding(examination.examined, None, (), recorded)
    unexplained = replace(examination, best=None, limits=(), diagnosis=nothing_known)
    tree = session.state.tree.with_examination(present.label, unexplained)
    status = panels.status(replace(session.state, tree=tree))
    assert status is not None and status.level == 'red' and 'Nothing was learned' in status.next_step
    assert status.sentence == diagnosis_status(nothing_known).sentence
    limited = diagnose_before_adding(examination.examined, None, ['rate_saturation'], recorded)
    limit = diagnosis_status(limited)
    assert (limit.level, limit.sentence) == ('yellow', 'The readings suggest a limit: rate_saturation.')
    session.close()
