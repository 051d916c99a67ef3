"""The server of the studio: access, sources of the page, and recordings that a browser may choose."""

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


class OneSession:
    """A workspace with one session."""

    titles = ('uneven',)

    def __init__(self, session: Any) -> None:
        self.session = session
        self.out = session.folder.parent

    @property
    def state(self) -> Any:
        return self.session.state

    def draw_task(self) -> None:
        raise AssertionError('was not requested')


@pytest.fixture(scope='module')
def workspace(uneven_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    session, _ = open_session(uneven_bag, tmp_path_factory.mktemp('out') / 'session')
    yield OneSession(session)
    session.close()


@pytest.fixture
def client(workspace: Any) -> Any:
    return make_app(workspace, names=NAMES).server.test_client()


class TestAccess:
    @pytest.mark.slow
    @pytest.mark.parametrize('host', ['127.0.0.1:8350', 'localhost', '[::1]:8350'])
    def test_requests_from_this_machine_are_accepted(self, client: Any, host: str) -> None:
        assert client.get('/', headers={'Host': host}).status_code == 200

    @pytest.mark.slow
    @pytest.mark.parametrize('host', ['evil.example', 'evil.example:8350', '127.0.0.1.evil.example', ''])
    def test_other_host_names_that_resolve_to_this_machine_are_refused(self, client: Any, host: str) -> None:
        for path in ('/', '/_dash-layout', '/assets/studio.css'):
            assert client.get(path, headers={'Host': host}).status_code == 403

    @pytest.mark.parametrize('origin', ['http://evil.example', 'http://localhost:9999', 'null'])
    def test_requests_from_pages_of_other_sites_are_refused(self, client: Any, origin: str) -> None:
        headers = {'Host': 'localhost', 'Origin': origin, 'Content-Type': 'text/plain'}
        assert client.post('/_dash-update-component', data='{}', headers=headers).status_code == 403
        same_site = {'Host': 'localhost', 'Origin': 'http://localhost'}
        assert client.get('/', headers=same_site).status_code == 200

    def test_access_over_the_network_needs_the_token(self, workspace: Any) -> None:
        client = make_app(workspace, token='secret').server.test_client()
        for path in (
            '/',
            '/_dash-layout',
            '/_dash-dependencies',
            '/assets/studio.js',
            '/?token=guess',
            '/?token=%C3%A9',
        ):
            answer = client.get(path)
            assert answer.status_code == 401 and b'uneven' not in answer.data
        assert client.post('/_dash-update-component', json={}).status_code == 401
        answer = client.get('/?token=secret')
        assert answer.status_code == 302 and answer.headers['Location'] == '/'
        cookie = answer.headers['Set-Cookie']
        assert 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
        assert client.get('/_dash-layout').status_code == 200

    def test_loopback_addresses_are_recognised(self) -> None:
        assert all(map(is_loopback, ('127.0.0.1', '127.0.1.1', '::1', 'localhost')))
        assert not any(map(is_loopback, ('0.0.0.0', '192.168.1.2', '::', 'robot')))

    def test_a_port_in_use_is_reported(self, workspace: Any) -> None:
        app = make_app(workspace)
        first = listen(app, '127.0.0.1', 0)
        with pytest.raises(GyrocalError, match='cannot be used'):
            listen(app, '127.0.0.1', first.server_port)
        first.server_close()


class TestPage:
    def test_the_page_loads_from_this_server_only(self, client: Any) -> None:
        page = client.get('/', headers={'Host': 'localhost'})
        sources = re.findall(r'(?:src|href)="([^"]+)"', page.text)
        assert len(sources) > 5 and all(source.startswith('/') for source in sources), sources
        policy = page.headers['Content-Security-Policy']
        assert "default-src 'self'" in policy and 'http' not in policy and 'unsafe-eval' not in policy

    def test_the_layout_has_the_parts_in_order(self, client: Any) -> None:
        text = client.get('/_dash-layout', headers={'Host': 'localhost'}).text
        places = [
            text.index(f'"{name}-title"') for name in ('bag', 'model', 'residual', 'missing', 'history')
        ]
        assert places == sorted(places)

    def test_marks_change_only_for_parts_that_change(self, workspace: Any) -> None:
        before = marks(workspace.state)
        workspace.session.show_message('hello')
        assert marks(workspace.state) == before
        workspace.session.guess('gyro_lag')
        workspace.session.reveal()
        changed = marks(workspace.state)
        assert {name for name in before if before[name] != changed[name]} == {
            'model',
            'lesson',
        }  # the truth is drawn

    def test_several_clicks_in_one_request_are_all_processed(self, workspace: Any, client: Any) -> None:
        inputs: list[dict[str, Any]] = [
            {'id': name, 'property': 'n_clicks', 'value': None} for name in BUTTONS
        ]
        for one in inputs:
            if one['id'] in ('undo', 'write'):
                one['value'] = 1
        request = {
            'output': 'acted.data',
            'outputs': {'id': 'acted', 'property': 'data'},
            'inputs': [*inputs, {'id': 'recording', 'property': 'value', 'value': 0}],
            'state': [
                {'id': 'chosen', 'property': 'data', 'value': None},
                {'id': 'right', 'property': 'value', 'value': None},
                {'id': 'other', 'property': 'value', 'value': None},
            ],
            'changedPropIds': ['undo.n_clicks', 'write.n_clicks'],
        }
        answer = client.post('/_dash-update-component', json=request, headers={'Host': 'localhost'})
        assert answer.status_code == 200
        assert (workspace.session.folder / 'model.yaml').is_file(), 'the second click is processed as well'


class TestLivePage:
    def test_it_has_the_same_access_control_and_shows_received_values(self) -> None:
        feed = Feed(0.0)
        feed.calibration({'gyro.scale_factor': 0.93, 'gyro.scale_factor_std': 0.001}, 1.0)
        feed.health('calibrator', 1, 'not converged yet', {'recent_nis': '1.1'}, 1.0)
        client = make_live_app(feed.overview, names=NAMES).server.test_client()
        assert client.get('/', headers={'Host': 'evil.example'}).status_code == 403
        outputs = (
            'shown.data',
            'message.children',
            'live-figure.figure',
            'tracks.children',
            'nodes.children',
        )
        request = {
            'output': f'..{"...".join(outputs)}..',
            'outputs': [dict(zip(('id', 'property'), one.split('.'), strict=True)) for one in outputs],
            'inputs': [{'id': 'poll', 'property': 'n_intervals', 'value': 1}],
            'state': [{'id': 'shown', 'property': 'data', 'value': None}],
            'changedPropIds': ['poll.n_intervals'],
        }
        answer = client.post('/_dash-update-component', json=request, headers={'Host': 'localhost'})
        assert answer.status_code == 200
        assert 'Scale factor 0.9300' in answer.text and 'not converged yet' in answer.text

    def test_without_ros_the_error_names_the_remedy(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr('gyrocal_ros.cli.studio.find_spec', lambda _: None)
        assert main(['studio', '--live', '--no-browser']) == 2
        assert 'source the setup.bash' in capsys.readouterr().err


class TestCommand:
    def test_only_bags_directly_in_the_folder_are_offered(self, uneven_bag: Path, tmp_path: Path) -> None:
        folder = tmp_path / 'given'
        folder.mkdir()
        (folder / 'elsewhere').symlink_to(uneven_bag)
        (folder / 'notes.txt').write_text('no bag')
        (folder / 'one.mcap').touch()
        assert [path.name for path in bags_in(folder)] == ['one.mcap']
        assert [path.name for path in bags_in(uneven_bag.parent)] == ['uneven']

    def test_a_folder_without_bags_is_refused(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(['studio', str(tmp_path), '--no-browser']) == 2
        assert 'contains no bag' in capsys.readouterr().err


class TestDownloads:
    HOST = {'Host': 'localhost'}

    def test_an_exported_file_is_sent_under_the_name_of_the_recording(
        self, client: Any, workspace: Any
    ) -> None:
        file = workspace.session.folder / 'report.zip'
        assert client.get('/download/report.zip', headers=self.HOST).status_code == 404
        file.write_bytes(b'packed')
        try:
            answer = client.get('/download/report.zip', headers=self.HOST)
            assert answer.status_code == 200 and answer.data == b'packed'
            assert 'attachment; filename=uneven_report.zip' in answer.headers['Content-Disposition']
        finally:
            file.unlink()

    @pytest.mark.parametrize(
        'name', ['studio.json', '.lock', '../studio.json', '..%2Fstudio.json', '/etc/passwd', 'report/..']
    )
    def test_no_other_file_can_be_named(self, client: Any, name: str) -> None:
        answer = client.get(f'/download/{name}', headers=self.HOST)
        assert answer.status_code == 404 or b'<!DOCTYPE html>' in answer.data  # the page, not a file
        assert 'Content-Disposition' not in answer.headers and b'builds_on' not in answer.data

    def test_a_token_is_needed_as_for_the_page(self, workspace: Any) -> None:
        guarded = make_app(workspace, token='secret', names=NAMES).server.test_client()
        assert guarded.get('/download/report.zip', headers=self.HOST).status_code == 401
