"""The loop of the studio without a browser: what can be done, what is kept, what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from studio_parts import HIDDEN, SIZE, Desk, open_session

from gyrocal_ros.cli.main import main
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.studio.export import export
from gyrocal_ros.studio.recordings import Contents
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.worker import Advance, Examine, Failed, RunPreview

FIRST, SECOND = '0_default', f'1_{HIDDEN}'


@pytest.fixture
def opened(uneven_bag: Path, tmp_path: Path) -> Iterator[tuple[Session, Desk]]:
    session, desk = open_session(uneven_bag, tmp_path / 'session')
    yield session, desk
    session.close()


@pytest.fixture
def session(opened: tuple[Session, Desk]) -> Session:
    return opened[0]


class TestOpening:
    @pytest.mark.slow
    def test_the_recording_is_looked_into_and_the_first_model_runs(self, session: Session) -> None:
        view = session.view
        assert view.contents is not None and view.contents.check is not None
        assert view.contents.check.usable
        assert view.trials.present == FIRST and view.doing is None
        assert view.improvement is not None and len(view.improvement.revisions) == 1

    @pytest.mark.slow
    def test_the_heading_shows_itself_while_the_filter_runs(self, opened: tuple[Session, Desk]) -> None:
        kinds = [type(news) for news in opened[1].told]
        assert kinds.index(Contents) < kinds.index(RunPreview)
        parts = [news.part for news in opened[1].told if isinstance(news, Advance)]
        assert max(parts) > 0.9

    @pytest.mark.slow
    def test_what_explains_most_is_known(self, session: Session) -> None:
        now = session.view.trials.now
        assert now is not None and now.examined is not None and now.examined.best is not None
        assert now.examined.best.effect.name == HIDDEN

    def test_a_bag_that_cannot_be_used_is_told(self, tmp_path: Path) -> None:
        session, _ = open_session(tmp_path / 'nothing', tmp_path / 'session')
        assert session.view.is_trouble and 'no such bag' in session.view.message
        session.close()


class TestTheLoop:
    @pytest.mark.slow
    def test_the_error_falls_by_what_the_command_line_gives(
        self,
        session: Session,
        opened: tuple[Session, Desk],
        uneven_bag: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        main(['improve', str(uneven_bag), '--effect', HIDDEN, '--json'])
        by_command = json.loads(capsys.readouterr().out)['revisions']
        revisions = session.improvement().revisions
        assert [one.label for one in revisions] == [one['revision'] for one in by_command] == [FIRST, SECOND]
        for ours, theirs in zip(revisions, by_command, strict=True):
            assert ours.held_out.rms_deg == pytest.approx(theirs['held_out_drift_deg']['rms'], rel=1e-9)
            assert ours.fitted.rms_deg == pytest.approx(theirs['fitted_drift_deg']['rms'], rel=1e-9)
        assert revisions[1].held_out.rms_deg < 0.1 * revisions[0].held_out.rms_deg

    @pytest.mark.slow
    def test_undo_and_adding_again_take_no_run(self, session: Session, opened: tuple[Session, Desk]) -> None:
        desk = opened[1]
        session.add(HIDDEN)
        desk.work()
        count = len(desk.ran)
        session.undo()
        assert session.view.trials.present == FIRST
        assert [one.is_kept for one in session.improvement().revisions] == [True, False]
        session.add(HIDDEN)
        assert session.view.trials.present == SECOND and len(desk.ran) == count
        assert [one.label for one in session.improvement().kept] == [FIRST, SECOND]

    @pytest.mark.slow
    def test_what_was_tried_in_advance_is_added_at_once(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        desk = opened[1]
        session.forecast(HIDDEN)
        desk.work()
        assert session.view.forecast(HIDDEN) is not None and session.view.trials.present == FIRST
        count = len(desk.ran)
        session.add(HIDDEN)
        assert session.view.trials.present == SECOND and len(desk.ran) == count

    def test_adding_what_is_being_tried_goes_on_with_that_run(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.forecast(HIDDEN)
        session.add(HIDDEN)
        assert session.view.doing is not None and session.view.doing.what == 'add'
        opened[1].work()
        assert session.view.trials.present == SECOND
        assert [type(task) for task in opened[1].ran].count(Examine) == 2

    def test_adding_makes_what_is_tried_in_advance_give_way(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.forecast('scale_cubic')
        session.add(HIDDEN)
        opened[1].work()
        assert session.view.trials.present == SECOND and session.view.forecasts == {}

    def test_any_revision_can_be_made_the_present_one(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        session.go_to(FIRST)
        assert session.view.trials.present == FIRST
        with pytest.raises(GyrocalError, match='no such revision'):
            session.go_to('../somewhere')


class TestRefusals:
    def test_nothing_is_added_while_something_is_under_way(self, uneven_bag: Path, tmp_path: Path) -> None:
        session, _ = open_session(uneven_bag, tmp_path / 'session', work=False)
        with pytest.raises(GyrocalError, match='under way'):
            session.add(HIDDEN)
        for refused in (session.undo, session.resume):
            with pytest.raises(GyrocalError, match='under way'):
                refused()
        for early in (session.write, session.reveal):
            with pytest.raises(GyrocalError, match='has not run yet'):
                early()
        session.close()

    def test_an_effect_that_is_not_there_or_there_already_is_refused(self, session: Session) -> None:
        with pytest.raises(GyrocalError, match='in the model already'):
            session.add('scale_factor')
        with pytest.raises(GyrocalError, match='os.system'):
            session.add('os.system')
        assert session.view.trials.present == FIRST

    def test_there_is_nothing_to_undo_at_first(self, session: Session) -> None:
        with pytest.raises(GyrocalError, match='nothing was added'):
            session.undo()

    def test_a_run_that_fails_leaves_the_model_as_it_was(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.add(HIDDEN)
        assert session.view.doing is not None
        session.hear(session.view.doing.number, Failed('the estimate has lost the measurements'))
        assert session.view.is_trouble and session.view.trials.present == FIRST and not session.view.is_busy

    def test_a_cancelled_run_leaves_the_model_as_it_was(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.add(HIDDEN)
        session.cancel()
        opened[1].work()
        assert session.view.message.startswith('Cancelled') and session.view.trials.present == FIRST

    def test_a_cancelled_opening_can_be_taken_up_again(self, uneven_bag: Path, tmp_path: Path) -> None:
        session, desk = open_session(uneven_bag, tmp_path / 'session', work=False)
        session.cancel()
        desk.work()
        assert session.view.trials.now is None
        session.resume()
        desk.work()
        assert session.view.trials.present == FIRST
        session.close()


class TestTheFolder:
    def test_a_killed_server_loses_nothing(
        self, session: Session, opened: tuple[Session, Desk], uneven_bag: Path
    ) -> None:
        session.add(HIDDEN)
        opened[1].work()
        before = session.improvement()
        session.close()  # the lock goes with the process; nothing else happens on closing
        again, desk = open_session(uneven_bag, session.folder)
        after = again.improvement()
        assert again.view.trials.present == SECOND
        assert [one.held_out.rms_deg for one in after.revisions] == [
            one.held_out.rms_deg for one in before.revisions
        ]
        assert [one.why for one in after.revisions] == [one.why for one in before.revisions]
        replayed = [task.model for task in desk.ran if isinstance(task, Examine)]
        assert [model.effects[-1].name for model in replayed] == [HIDDEN, 'scale_factor']
        again.close()

    def test_a_revision_that_was_not_named_yet_does_not_count(
        self, session: Session, opened: tuple[Session, Desk], uneven_bag: Path
    ) -> None:
        (session.folder / SECOND).mkdir()
        (session.folder / SECOND / 'model.yaml').write_text('half of')
        session.close()
        again, desk = open_session(uneven_bag, session.folder)
        assert [one.label for one in again.improvement().revisions] == [FIRST]
        again.add(HIDDEN)
        desk.work()
        assert load_model(again.folder / SECOND / 'model.yaml').effects[-1].name == HIDDEN
        again.close()

    def test_two_studios_do_not_share_a_folder(self, session: Session, uneven_bag: Path) -> None:
        with pytest.raises(GyrocalError, match='another studio works in it'):
            open_session(uneven_bag, session.folder)

    @pytest.mark.parametrize(
        ('state', 'complaint'),
        [
            (
                '{"recording": {"duration_s": 1.0}, "present": "0_default", "revisions": []}',
                'another recording',
            ),
            ('{"recording"', 'is damaged'),
            ('[]', 'is damaged'),
        ],
    )
    def test_the_folder_of_another_recording_is_left_alone(
        self, uneven_bag: Path, tmp_path: Path, state: str, complaint: str
    ) -> None:
        file = tmp_path / 'session' / 'studio.json'
        file.parent.mkdir()
        file.write_text(state)
        session, _ = open_session(uneven_bag, file.parent)
        assert session.view.is_trouble and complaint in session.view.message
        assert file.read_text() == state
        session.close()

    def test_a_label_names_a_folder_of_the_session_and_nothing_else(
        self, session: Session, uneven_bag: Path
    ) -> None:
        session.close()
        file = session.folder / 'studio.json'
        state = json.loads(file.read_text())
        state['present'] = state['revisions'][0]['label'] = '../elsewhere'
        file.write_text(json.dumps(state))
        again, _ = open_session(uneven_bag, session.folder)
        assert again.view.is_trouble and 'not there' in again.view.message
        again.close()

    def test_the_present_model_is_written_for_the_robot(
        self, session: Session, opened: tuple[Session, Desk]
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


class TestTheLesson:
    def test_the_truth_is_held_against_what_was_found(
        self, session: Session, opened: tuple[Session, Desk]
    ) -> None:
        session.guess('scale_cubic')
        session.reveal()
        told = session.view.revealed
        assert told is not None and told.hidden == (HIDDEN,) and told.guessed_right is False
        assert told.missed == (HIDDEN,) and told.lines[1].found is None
        session.add(HIDDEN)
        opened[1].work()
        assert session.view.revealed is None, 'it was about another model'
        session.guess(HIDDEN)
        session.reveal()
        told = session.view.revealed
        assert told is not None and told.guessed_right is True and not told.missed and not told.needless
        line = told.lines[1]
        assert line.truth == SIZE and line.found == pytest.approx(SIZE, rel=0.02)
        assert line.sigma is not None and math.isfinite(line.sigma)


class TestTheReport:
    @pytest.mark.slow
    def test_it_holds_pages_models_and_history(
        self, session: Session, opened: tuple[Session, Desk], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr('gyrocal_ros.report.png.find_spec', lambda _: None)
        session.add(HIDDEN)
        opened[1].work()
        said = export(session.view, session.folder)
        report = session.folder / 'report'
        assert 'kaleido is missing' in said
        assert HIDDEN in (report / 'report.html').read_text()
        assert 'Diagnosis' in (report / 'present' / 'report.html').read_text()
        assert json.loads((report / 'history.json').read_text())['effects'] == ['scale_factor', HIDDEN]
        assert (report / SECOND / 'merit.json').is_file()
