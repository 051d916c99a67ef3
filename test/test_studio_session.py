"""Sessions of the studio without a browser: actions, saved results, refusals."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import pytest
from studio_parts import HIDDEN, SIZE, InProcessWorker, open_session

from gyrocal_ros.cli.main import main
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.studio.export import export
from gyrocal_ros.studio.recordings import RecordingContents
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.tasks import Examine, Failed, RunPreview, TaskProgress

FIRST, SECOND = '0_default', f'1_{HIDDEN}'


@pytest.fixture
def opened(uneven_bag: Path, tmp_path: Path) -> Iterator[tuple[Session, InProcessWorker]]:
    session, worker = open_session(uneven_bag, tmp_path / 'session')
    yield session, worker
    session.close()


@pytest.fixture
def session(opened: tuple[Session, InProcessWorker]) -> Session:
    return opened[0]


class TestOpening:
    @pytest.mark.slow
    def test_the_recording_is_checked_and_the_first_model_runs(self, session: Session) -> None:
        state = session.state
        assert state.contents is not None and state.contents.check is not None
        assert state.contents.check.usable
        assert state.tree.present_label == FIRST and state.running is None
        assert state.improvement is not None and len(state.improvement.revisions) == 1

    @pytest.mark.slow
    def test_a_preview_of_the_heading_is_sent_while_the_filter_runs(
        self, opened: tuple[Session, InProcessWorker]
    ) -> None:
        sent = opened[1].sent
        kinds = [type(message) for message in sent]
        assert kinds.index(RecordingContents) < kinds.index(RunPreview)
        assert max(message.fraction for message in sent if isinstance(message, TaskProgress)) > 0.9

    @pytest.mark.slow
    def test_the_best_explanation_is_found(self, session: Session) -> None:
        examination = session.state.examination
        assert examination is not None and examination.best is not None
        assert examination.best.effect.name == HIDDEN

    def test_a_bag_that_cannot_be_used_is_reported(self, tmp_path: Path) -> None:
        session, _ = open_session(tmp_path / 'nothing', tmp_path / 'session')
        assert session.state.is_error and 'no such bag' in session.state.message
        session.close()


class TestModels:
    @pytest.mark.slow
    def test_the_figures_of_merit_are_those_of_the_command(
        self,
        session: Session,
        opened: tuple[Session, InProcessWorker],
        uneven_bag: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        main(['improve', str(uneven_bag), '--effect', HIDDEN, '--json'])
        expected = json.loads(capsys.readouterr().out)['revisions']
        revisions = session.improvement().revisions
        assert [one.label for one in revisions] == [one['revision'] for one in expected] == [FIRST, SECOND]
        for ours, theirs in zip(revisions, expected, strict=True):
            assert ours.held_out.rms_deg == pytest.approx(theirs['held_out_drift_deg']['rms'], rel=1e-9)
            assert ours.fitted.rms_deg == pytest.approx(theirs['fitted_drift_deg']['rms'], rel=1e-9)
        assert revisions[1].held_out.rms_deg < 0.1 * revisions[0].held_out.rms_deg

    @pytest.mark.slow
    def test_undo_and_adding_again_need_no_run(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        worker = opened[1]
        session.add(HIDDEN)
        worker.work()
        count = len(worker.executed)
        session.undo()
        assert session.state.tree.present_label == FIRST
        assert [one.is_kept for one in session.improvement().revisions] == [True, False]
        session.add(HIDDEN)
        assert session.state.tree.present_label == SECOND and len(worker.executed) == count
        assert [one.label for one in session.improvement().kept] == [FIRST, SECOND]

    @pytest.mark.slow
    def test_an_effect_with_a_forecast_is_added_without_a_run(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        worker = opened[1]
        session.forecast(HIDDEN)
        worker.work()
        assert session.state.forecast(HIDDEN) is not None and session.state.tree.present_label == FIRST
        count = len(worker.executed)
        session.add(HIDDEN)
        assert session.state.tree.present_label == SECOND and len(worker.executed) == count

    def test_adding_an_effect_continues_its_running_forecast(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.forecast(HIDDEN)
        session.add(HIDDEN)
        assert session.state.running is not None and session.state.running.kind == 'add'
        opened[1].work()
        assert session.state.tree.present_label == SECOND
        assert [type(task) for task in opened[1].executed].count(Examine) == 2

    def test_adding_an_effect_cancels_the_forecast_of_another(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.forecast('scale_cubic')
        session.add(HIDDEN)
        opened[1].work()
        assert session.state.tree.present_label == SECOND and session.state.forecasts == {}

    def test_any_revision_can_become_the_present_one(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        session.go_to(FIRST)
        assert session.state.tree.present_label == FIRST
        with pytest.raises(GyrocalError, match='no such revision'):
            session.go_to('../somewhere')


class TestRefusals:
    def test_actions_are_refused_while_a_task_is_running(self, uneven_bag: Path, tmp_path: Path) -> None:
        session, _ = open_session(uneven_bag, tmp_path / 'session', work=False)
        with pytest.raises(GyrocalError, match='another task is running'):
            session.add(HIDDEN)
        for refused in (session.undo, session.resume):
            with pytest.raises(GyrocalError, match='another task is running'):
                refused()
        for early in (session.write, session.reveal):
            with pytest.raises(GyrocalError, match='has not run yet'):
                early()
        session.close()

    def test_unknown_effects_and_effects_of_the_model_are_refused(self, session: Session) -> None:
        with pytest.raises(GyrocalError, match='in the model already'):
            session.add('scale_factor')
        with pytest.raises(GyrocalError, match='os.system'):
            session.add('os.system')
        assert session.state.tree.present_label == FIRST

    def test_undo_without_an_addition_is_refused(self, session: Session) -> None:
        with pytest.raises(GyrocalError, match='no effect has been added'):
            session.undo()

    def test_the_model_stays_after_a_failed_run(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.add(HIDDEN)
        assert session.state.running is not None
        session.receive(session.state.running.number, Failed('the estimate has lost the measurements'))
        assert (
            session.state.is_error and session.state.tree.present_label == FIRST and not session.state.is_busy
        )

    def test_the_model_stays_after_a_cancelled_run(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.add(HIDDEN)
        session.cancel()
        opened[1].work()
        assert session.state.message.startswith('Cancelled') and session.state.tree.present_label == FIRST

    def test_a_cancelled_opening_can_be_resumed(self, uneven_bag: Path, tmp_path: Path) -> None:
        session, worker = open_session(uneven_bag, tmp_path / 'session', work=False)
        session.cancel()
        worker.work()
        assert session.state.tree.present is None
        session.resume()
        worker.work()
        assert session.state.tree.present_label == FIRST
        session.close()


class TestFolder:
    def test_a_killed_server_loses_nothing(
        self, session: Session, opened: tuple[Session, InProcessWorker], uneven_bag: Path
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        before = session.improvement()
        session.close()  # the lock goes with the process; nothing else happens on closing
        again, worker = open_session(uneven_bag, session.folder)
        after = again.improvement()
        assert again.state.tree.present_label == SECOND
        assert [one.held_out.rms_deg for one in after.revisions] == [
            one.held_out.rms_deg for one in before.revisions
        ]
        assert [one.why for one in after.revisions] == [one.why for one in before.revisions]
        replayed = [task.model for task in worker.executed if isinstance(task, Examine)]
        assert [model.effects[-1].name for model in replayed] == [HIDDEN, 'scale_factor']
        again.close()

    def test_an_incomplete_revision_is_ignored(
        self, session: Session, opened: tuple[Session, InProcessWorker], uneven_bag: Path
    ) -> None:
        (session.folder / SECOND).mkdir()
        (session.folder / SECOND / 'model.yaml').write_text('half of')
        session.close()
        again, worker = open_session(uneven_bag, session.folder)
        assert [one.label for one in again.improvement().revisions] == [FIRST]
        again.add(HIDDEN)
        worker.work()
        assert load_model(again.folder / SECOND / 'model.yaml').effects[-1].name == HIDDEN
        again.close()

    def test_two_studios_do_not_share_a_folder(self, session: Session, uneven_bag: Path) -> None:
        with pytest.raises(GyrocalError, match='another studio uses it'):
            open_session(uneven_bag, session.folder)

    @pytest.mark.parametrize(
        ('saved', 'message'),
        [
            (
                '{"recording": {"duration_s": 1.0}, "present": "0_default", "revisions": []}',
                'another recording',
            ),
            ('{"recording"', 'is damaged'),
            ('[]', 'is damaged'),
        ],
    )
    def test_the_folder_of_another_recording_is_not_changed(
        self, uneven_bag: Path, tmp_path: Path, saved: str, message: str
    ) -> None:
        file = tmp_path / 'session' / 'studio.json'
        file.parent.mkdir()
        file.write_text(saved)
        session, _ = open_session(uneven_bag, file.parent)
        assert session.state.is_error and message in session.state.message
        assert file.read_text() == saved
        session.close()

    def test_labels_with_a_path_are_refused(self, session: Session, uneven_bag: Path) -> None:
        session.close()
        file = session.folder / 'studio.json'
        state = json.loads(file.read_text())
        state['present'] = state['revisions'][0]['label'] = '../elsewhere'
        file.write_text(json.dumps(state))
        again, _ = open_session(uneven_bag, session.folder)
        assert again.state.is_error and 'do not exist' in again.state.message
        again.close()

    def test_model_and_calibration_of_the_present_revision_are_written(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        folder = session.write()
        assert load_model(folder / 'model.yaml').effects[-1].name == HIDDEN
        found = load_calibration(folder / 'calibration.yaml')
        assert dict(zip(found.names, found.values, strict=True))[HIDDEN] == pytest.approx(SIZE, rel=0.02)
        session.undo()
        session.write()
        assert HIDDEN not in (folder / 'model.yaml').read_text()


class TestLesson:
    def test_the_hidden_effects_are_compared_with_the_model(
        self, session: Session, opened: tuple[Session, InProcessWorker]
    ) -> None:
        session.guess('scale_cubic')
        session.reveal()
        revealed = session.state.revealed
        assert revealed is not None and revealed.hidden == (HIDDEN,) and revealed.guessed_right is False
        assert revealed.missed == (HIDDEN,) and revealed.coefficients[1].estimate is None
        session.add(HIDDEN)
        opened[1].work()
        assert session.state.revealed is None, 'the answer was compared with another model'
        session.guess(HIDDEN)
        session.reveal()
        revealed = session.state.revealed
        assert (
            revealed is not None
            and revealed.guessed_right is True
            and not revealed.missed
            and not revealed.superfluous
        )
        item = revealed.coefficients[1]
        assert item.truth == SIZE and item.estimate == pytest.approx(SIZE, rel=0.02)
        assert item.sigma is not None and math.isfinite(item.sigma)


class TestReport:
    @pytest.mark.slow
    def test_it_contains_pages_models_and_history(
        self, session: Session, opened: tuple[Session, InProcessWorker], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr('gyrocal_ros.report.png.find_spec', lambda _: None)
        monkeypatch.setattr('gyrocal_ros.report.pdf.shutil.which', lambda _: None)
        session.add(HIDDEN)
        opened[1].work()
        message = export(session.state, session.folder)
        report = session.folder / 'report'
        assert 'kaleido is missing' in message and 'there is no Chromium' in message
        assert HIDDEN in (report / 'report.html').read_text()
        assert 'Diagnosis' in (report / 'present' / 'report.html').read_text()
        assert json.loads((report / 'history.json').read_text())['effects'] == ['scale_factor', HIDDEN]
        assert (report / SECOND / 'merit.json').is_file()
        with ZipFile(session.folder / 'report.zip') as packed:
            files = {str(path.relative_to(session.folder)) for path in report.rglob('*') if path.is_file()}
            assert {name for name in packed.namelist() if not name.endswith('/')} == files
            assert packed.testzip() is None
