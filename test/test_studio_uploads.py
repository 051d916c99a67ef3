"""Recordings that the page of the studio receives."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from studio_parts import IdleWorker

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.studio import uploads
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.server import MAX_REQUEST_BYTES, make_app
from gyrocal_ros.studio.workspace import Workspace

LOCAL = {'Host': 'localhost', 'Origin': 'http://localhost'}
PIECE = 2**19


@pytest.fixture
def workspace(tmp_path: Path) -> Iterator[Workspace]:
    bags = [Bag(tmp_path / 'first', Config())]
    workspace = Workspace(bags, default_model(), Config(), tmp_path / 'out', IdleWorker())
    yield workspace
    workspace.close()


@pytest.fixture
def client(workspace: Workspace) -> Any:
    return make_app(workspace, names=frozenset({'localhost'})).server.test_client()


def send(client: Any, bag: str, files: dict[str, bytes]) -> list[Any]:
    """Send the files of a bag in pieces, as the page does; return the answers that are errors."""
    whole, errors = sum(map(len, files.values())), []
    for name, content in files.items():
        for at in range(0, max(len(content), 1), PIECE):
            address = f'/upload/{bag}/{name}?at={at}&whole={whole}'
            answer = client.put(address, data=content[at : at + PIECE], headers=LOCAL)
            errors += [] if answer.status_code == 204 else [answer]
    answer = client.post(f'/upload/{bag}', headers=LOCAL)
    return errors + ([] if answer.status_code == 204 else [answer])


def contents(bag: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in bag.iterdir() if path.is_file()}


def left_in(workspace: Workspace) -> list[str]:
    folder = workspace.out / uploads.FOLDER
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def test_a_folder_of_rosbag2_is_received_byte_by_byte_and_opened(
    client: Any, workspace: Workspace, uneven_bag: Path
) -> None:
    sent = contents(uneven_bag)
    assert max(map(len, sent.values())) > PIECE, 'several pieces are needed for this test'
    assert not send(client, 'monday', sent)
    assert workspace.titles == ['first', 'monday'] and workspace.state.title == 'monday'
    assert contents(workspace.out / uploads.FOLDER / 'monday') == sent


def test_a_single_file_is_a_bag(client: Any, workspace: Workspace, uneven_bag: Path) -> None:
    (file,) = uneven_bag.glob('*.mcap')
    assert not send(client, file.stem, {file.name: file.read_bytes()})
    assert workspace.state.title == file.name and left_in(workspace) == [file.name]


def test_a_damaged_bag_is_refused_with_its_reason_and_leaves_nothing(
    client: Any, workspace: Workspace, uneven_bag: Path
) -> None:
    (file,) = uneven_bag.glob('*.mcap')
    (error,) = send(client, 'half', {'half.mcap': file.read_bytes()[: file.stat().st_size // 2]})
    assert error.status_code == 400
    assert error.text.startswith('half.mcap') or 'half/half.mcap' in error.text
    assert 'damaged' in error.text and str(workspace.out) not in error.text
    assert workspace.titles == ['first'] and left_in(workspace) == []


def test_the_name_of_another_bag_is_refused(client: Any, workspace: Workspace, uneven_bag: Path) -> None:
    assert not send(client, 'monday', contents(uneven_bag))
    (error,) = send(client, 'monday', contents(uneven_bag))
    assert 'name of another bag' in error.text and left_in(workspace) == ['monday']
    (error,) = send(client, 'first', contents(uneven_bag))
    assert 'name of another bag' in error.text


@pytest.mark.parametrize(
    'address',
    ['a/notes.txt', 'a/.mcap', '.hidden/a.mcap', '..%2F..%2Fa/b.mcap', 'a/..%2Fb.mcap', 'a%5Cb/c.mcap']
    + ['a%00b/c.mcap', f'{"a" * 200}/b.mcap'],
)
def test_names_that_are_no_plain_files_of_a_bag_are_refused(
    client: Any, workspace: Workspace, tmp_path: Path, address: str
) -> None:
    before = sorted(tmp_path.rglob('*'))
    answer = client.put(f'/upload/{address}?at=0&whole=1', data=b'x', headers=LOCAL)
    assert answer.status_code in (400, 404, 405)
    assert sorted(tmp_path.rglob('*')) == before


def test_too_large_recordings_are_refused_before_they_are_sent(client: Any, workspace: Workspace) -> None:
    answer = client.put(f'/upload/a/a.mcap?at=0&whole={uploads.MAX_BYTES + 1}', data=b'x', headers=LOCAL)
    assert answer.status_code == 400 and 'too large' in answer.text
    answer = client.put('/upload/a/a.mcap?at=0&whole=1', data=b'x' * (MAX_REQUEST_BYTES + 1), headers=LOCAL)
    assert answer.status_code == 413
    assert left_in(workspace) == []


def test_a_sum_of_pieces_beyond_the_limit_is_refused(
    client: Any, workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, 'MAX_BYTES', 10)
    assert client.put('/upload/a/a.mcap?at=0&whole=1', data=b'x' * 8, headers=LOCAL).status_code == 204
    assert client.put('/upload/a/b.mcap?at=0&whole=1', data=b'x' * 8, headers=LOCAL).status_code == 400
    assert left_in(workspace) == []


def test_a_full_disk_is_told_before_it_is_full(
    client: Any, workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, 'SPARE_BYTES', 2**60)
    answer = client.put('/upload/a/a.mcap?at=0&whole=1', data=b'x', headers=LOCAL)
    assert answer.status_code == 400 and 'no place on the disk' in answer.text


def test_a_missing_piece_is_noticed(client: Any) -> None:
    assert client.put('/upload/a/a.mcap?at=0&whole=9', data=b'abc', headers=LOCAL).status_code == 204
    answer = client.put('/upload/a/a.mcap?at=6&whole=9', data=b'ghi', headers=LOCAL)
    assert answer.status_code == 400 and 'missing' in answer.text


def test_what_an_interrupted_studio_left_is_removed(client: Any, workspace: Workspace) -> None:
    assert client.put('/upload/a/a.mcap?at=0&whole=9', data=b'abc', headers=LOCAL).status_code == 204
    assert left_in(workspace) == [f'{uploads.PART}a']
    make_app(workspace, names=frozenset({'localhost'}))
    assert left_in(workspace) == []


def test_browsers_on_other_machines_and_other_sites_cannot_send(workspace: Workspace) -> None:
    over_network = make_app(workspace, token='secret').server.test_client()
    answer = over_network.put('/upload/a/a.mcap?at=0&whole=1&token=secret', data=b'x')
    over_network.set_cookie('gyrocal_studio', 'secret')
    answer = over_network.put('/upload/a/a.mcap?at=0&whole=1', data=b'x')
    assert answer.status_code in (404, 405)
    local = make_app(workspace, names=frozenset({'localhost'})).server.test_client()
    headers = {'Host': 'localhost', 'Origin': 'http://evil.example'}
    assert local.put('/upload/a/a.mcap?at=0&whole=1', data=b'x', headers=headers).status_code == 403
    assert left_in(workspace) == []
