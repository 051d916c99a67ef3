"""The door of the studio: who gets in, what is loaded, and what a browser may name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from studio_parts import open_session

from gyrocal_ros.bag.storage import bags_in
from gyrocal_ros.cli.main import main
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.robot.feed import Feed
from gyrocal_ros.studio.callbacks import BUTTONS, marks
from gyrocal_ros.studio.server import is_loopback, listen, make_app, make_live_app

NAMES = frozenset({'127.0.0.1', 'localhost', '[::1]'})


class Desk:
    """One session, as the page sees it."""

    titles = ('uneven',)

    def __init__(self, session: Any) -> None:
        self.session = session

    @property
    def view(self) -> Any:
        return self.session.view

    def draw_riddle(self) -> None:
        raise AssertionError('nobody asked for it')


@pytest.fixture(scope='module')
def desk(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    session, _ = open_session(uneven_bag, tmp_path_factory.mktemp('out') / 'session')
    yield Desk(session)
    session.close()


@pytest.fixture
def visitor(desk: Any) -> Any:
    return make_app(desk, names=NAMES).server.test_client()


class TestTheDoor:
    @pytest.mark.slow
    @pytest.mark.parametrize('host', ['127.0.0.1:8350', 'localhost', '[::1]:8350'])
    def test_this_machine_gets_in(self, visitor: Any, host: str) -> None:
        assert visitor.get('/', headers={'Host': host}).status_code == 200

    @pytest.mark.slow
    @pytest.mark.parametrize('host', ['evil.example', 'evil.example:8350', '127.0.0.1.evil.example', ''])
    def test_a_name_that_was_made_to_point_here_does_not(self, visitor: Any, host: str) -> None:
        for path in ('/', '/_dash-layout', '/assets/studio.css'):
            assert visitor.get(path, headers={'Host': host}).status_code == 403

    @pytest.mark.parametrize('origin', ['http://evil.example', 'http://localhost:9999', 'null'])
    def test_the_page_of_another_site_cannot_press_buttons_here(self, visitor: Any, origin: str) -> None:
        headers = {'Host': 'localhost', 'Origin': origin, 'Content-Type': 'text/plain'}
        assert visitor.post('/_dash-update-component', data='{}', headers=headers).status_code == 403
        own = {'Host': 'localhost', 'Origin': 'http://localhost'}
        assert visitor.get('/', headers=own).status_code == 200

    def test_the_network_has_to_know_the_token(self, desk: Any) -> None:
        visitor = make_app(desk, token='secret').server.test_client()
        for path in (
            '/',
            '/_dash-layout',
            '/_dash-dependencies',
            '/assets/studio.js',
            '/?token=guess',
            '/?token=%C3%A9',
        ):
            answer = visitor.get(path)
            assert answer.status_code == 401 and b'uneven' not in answer.data
        assert visitor.post('/_dash-update-component', json={}).status_code == 401
        answer = visitor.get('/?token=secret')
        assert answer.status_code == 302 and answer.headers['Location'] == '/'
        cookie = answer.headers['Set-Cookie']
        assert 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
        assert visitor.get('/_dash-layout').status_code == 200

    def test_loopback_is_told_from_the_network(self) -> None:
        assert all(map(is_loopback, ('127.0.0.1', '127.0.1.1', '::1', 'localhost')))
        assert not any(map(is_loopback, ('0.0.0.0', '192.168.1.2', '::', 'robot')))

    def test_a_port_that_is_taken_is_told(self, desk: Any) -> None:
        app = make_app(desk)
        first = listen(app, '127.0.0.1', 0)
        with pytest.raises(GyrocalError, match='cannot be listened on'):
            listen(app, '127.0.0.1', first.server_port)
        first.server_close()


class TestThePage:
    def test_everything_comes_from_here(self, visitor: Any) -> None:
        page = visitor.get('/', headers={'Host': 'localhost'})
        sources = re.findall(r'(?:src|href)="([^"]+)"', page.text)
        assert len(sources) > 5 and all(source.startswith('/') for source in sources), sources
        policy = page.headers['Content-Security-Policy']
        assert "default-src 'self'" in policy and 'http' not in policy and 'unsafe-eval' not in policy

    def test_the_layout_holds_the_parts_in_their_order(self, visitor: Any) -> None:
        words = visitor.get('/_dash-layout', headers={'Host': 'localhost'}).text
        places = [
            words.index(f'"{name}-title"') for name in ('bag', 'model', 'residual', 'missing', 'history')
        ]
        assert places == sorted(places)

    def test_what_has_not_changed_is_not_drawn_again(self, desk: Any) -> None:
        before = marks(desk.view)
        desk.session.say('hello')
        assert marks(desk.view) == before
        desk.session.guess('gyro_lag')
        desk.session.reveal()
        changed = marks(desk.view)
        assert {name for name in before if before[name] != changed[name]} == {'lesson'}

    def test_buttons_that_a_busy_browser_sends_as_one_are_all_heeded(self, desk: Any, visitor: Any) -> None:
        inputs: list[dict[str, Any]] = [
            {'id': name, 'property': 'n_clicks', 'value': None} for name in BUTTONS
        ]
        for one in inputs:
            if one['id'] in ('undo', 'write'):
                one['value'] = 1
        asked = {
            'output': 'acted.data',
            'outputs': {'id': 'acted', 'property': 'data'},
            'inputs': [*inputs, {'id': 'recording', 'property': 'value', 'value': 0}],
            'state': [
                {'id': 'chosen', 'property': 'data', 'value': None},
                {'id': 'right', 'property': 'value', 'value': None},
            ],
            'changedPropIds': ['undo.n_clicks', 'write.n_clicks'],
        }
        answer = visitor.post('/_dash-update-component', json=asked, headers={'Host': 'localhost'})
        assert answer.status_code == 200
        assert (desk.session.folder / 'model.yaml').is_file(), 'the second is not lost for the first'


class TestTheLivePage:
    def test_it_is_guarded_as_the_other_and_shows_what_is_heard(self) -> None:
        feed = Feed(0.0)
        feed.calibration({'gyro.scale_factor': 0.93, 'gyro.scale_factor_std': 0.001}, 1.0)
        feed.health('calibrator', 1, 'not converged yet', {'recent_nis': '1.1'}, 1.0)
        visitor = make_live_app(feed.overview, names=NAMES).server.test_client()
        assert visitor.get('/', headers={'Host': 'evil.example'}).status_code == 403
        outputs = (
            'shown.data',
            'message.children',
            'live-figure.figure',
            'tracks.children',
            'nodes.children',
        )
        asked = {
            'output': f'..{"...".join(outputs)}..',
            'outputs': [dict(zip(('id', 'property'), one.split('.'), strict=True)) for one in outputs],
            'inputs': [{'id': 'poll', 'property': 'n_intervals', 'value': 1}],
            'state': [{'id': 'shown', 'property': 'data', 'value': None}],
            'changedPropIds': ['poll.n_intervals'],
        }
        answer = visitor.post('/_dash-update-component', json=asked, headers={'Host': 'localhost'})
        assert answer.status_code == 200
        assert 'Scale factor 0.9300' in answer.text and 'not converged yet' in answer.text

    def test_without_ros_it_says_what_to_do(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr('gyrocal_ros.cli.studio.find_spec', lambda _: None)
        assert main(['studio', '--live', '--no-browser']) == 2
        assert 'source the setup.bash' in capsys.readouterr().err


class TestTheCommand:
    def test_only_bags_right_inside_the_folder_are_offered(self, uneven_bag: Path, tmp_path: Path) -> None:
        inside = tmp_path / 'given'
        inside.mkdir()
        (inside / 'elsewhere').symlink_to(uneven_bag)
        (inside / 'notes.txt').write_text('no bag')
        (inside / 'one.mcap').touch()
        assert [path.name for path in bags_in(inside)] == ['one.mcap']
        assert [path.name for path in bags_in(uneven_bag.parent)] == ['uneven']

    def test_a_folder_without_bags_is_refused(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(['studio', str(tmp_path), '--no-browser']) == 2
        assert 'holds no bag' in capsys.readouterr().err
