"""Validation: models with the coefficients of one recording on another recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from studio_parts import HIDDEN, SIZE, open_session

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.drift import reference_heading
from gyrocal_ros.diagnose.analysis.validation import coefficient_pairs, validate
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.studio import panels
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.session import Session


@pytest.fixture(scope='module')
def session(uneven_bag: Path, strange_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Session:
    session, worker = open_session(uneven_bag, tmp_path_factory.mktemp('validation') / 'session')
    session.add(HIDDEN)
    worker.work()
    session.validate_on(Bag(strange_bag, Config()))
    worker.work()
    session.close()
    return session


def test_with_its_own_coefficients_a_recording_drifts_as_fitted(session: Session) -> None:
    run = session.improvement().final.examined.run
    same = validate(conclude(run), run, reference_heading(run))
    assert same.drift.rms_deg == pytest.approx(same.fitted.rms_deg, rel=1e-9)
    assert all(pair.training == pair.test for pair in coefficient_pairs(same))
    worse = replace(same.training, values=same.training.values + 0.01)
    assert validate(worse, run, reference_heading(run)).drift.rms_deg > 5.0 * same.drift.rms_deg


def test_another_robot_shows_that_it_has_other_coefficients(session: Session) -> None:
    (models,) = session.state.validated.values()
    assert list(models) == ['0_default', f'1_{HIDDEN}'] and not session.state.is_error
    found = models[f'1_{HIDDEN}']
    pair = next(one for one in coefficient_pairs(found) if one.name == HIDDEN)
    assert pair.training == pytest.approx(SIZE, rel=0.02) and abs(pair.sigma) > 5.0
    assert found.drift.rms_deg > found.fitted.rms_deg
    assert not pair.is_zero and replace(pair, training=0.0, test=0.0).is_zero


def test_the_tables_name_training_and_test(session: Session) -> None:
    parts = panels.validations(session.state)
    text = str([part.to_plotly_json() for part in parts])
    assert 'training: uneven; test: strange' in text and 'fitted on strange' in text and 'deg/s' in text


def test_the_training_recording_is_no_test(session: Session, uneven_bag: Path) -> None:
    with pytest.raises(GyrocalError, match='used to fit'):
        session.validate_on(Bag(uneven_bag, Config()))
