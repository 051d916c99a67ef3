"""Results appear completely or not at all, and no file of the user is lost."""

from __future__ import annotations

import errno
import os
import subprocess
from pathlib import Path

import pytest

from gyrocal_ros import files
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import new_folder, shipped, write_text_atomic


def test_text_is_written_with_its_parent_folders(tmp_path: Path) -> None:
    write_text_atomic(tmp_path / 'a' / 'b.yaml', 'ä: 1\n')
    assert (tmp_path / 'a' / 'b.yaml').read_text(encoding='utf-8') == 'ä: 1\n'
    assert [item.name for item in (tmp_path / 'a').iterdir()] == ['b.yaml']


def test_text_replaces_a_file_only_with_overwrite(tmp_path: Path) -> None:
    file = tmp_path / 'b.yaml'
    file.write_text('old')
    with pytest.raises(GyrocalError, match='exists already'):
        write_text_atomic(file, 'new')
    assert file.read_text() == 'old'
    write_text_atomic(file, 'new', overwrite=True)
    assert file.read_text() == 'new'


def test_a_failed_write_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    (tmp_path / 'file').write_text('')
    with pytest.raises(GyrocalError, match='cannot be written'):
        write_text_atomic(tmp_path / 'file' / 'b.yaml', 'new')
    monkeypatch.setattr('gyrocal_ros.files.os.fsync', no_space)
    with pytest.raises(GyrocalError, match='No space left'):
        write_text_atomic(tmp_path / 'b.yaml', 'new')
    assert [item.name for item in tmp_path.iterdir()] == ['file']


def test_a_folder_appears_when_complete(tmp_path: Path) -> None:
    target = tmp_path / 'runs' / 'one'
    with new_folder(target) as folder:
        (folder / 'figures').mkdir()
        (folder / 'figures' / 'a.html').write_text('a')
        assert not target.exists()
    assert (target / 'figures' / 'a.html').read_text() == 'a'
    assert [item.name for item in target.parent.iterdir()] == ['one']


@pytest.mark.parametrize('failure', [RuntimeError, KeyboardInterrupt])
def test_a_folder_is_removed_on_failure(tmp_path: Path, failure: type[BaseException]) -> None:
    with pytest.raises(failure), new_folder(tmp_path / 'out') as folder:
        (folder / 'half').write_text('half')
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_files_is_refused_before_the_work_starts(tmp_path: Path) -> None:
    (tmp_path / 'mine.txt').write_text('mine')
    with pytest.raises(GyrocalError, match='not empty'), new_folder(tmp_path):
        pytest.fail('the block must not be entered')
    with pytest.raises(GyrocalError, match='is a file'), new_folder(tmp_path / 'mine.txt', overwrite=True):
        pytest.fail('the block must not be entered')


def test_overwriting_replaces_only_files_of_the_same_name(tmp_path: Path) -> None:
    target = tmp_path / 'out'
    target.mkdir()
    (target / 'mine.txt').write_text('mine')
    (target / 'a.html').write_text('old')
    with new_folder(target, overwrite=True) as folder:
        (folder / 'a.html').write_text('new')
        (folder / 'sub').mkdir()
        (folder / 'sub' / 'b.html').write_text('b')
    assert {item.relative_to(target).as_posix(): item.read_text() for item in target.rglob('*.*')} == {
        'mine.txt': 'mine',
        'a.html': 'new',
        'sub/b.html': 'b',
    }
    assert [item.name for item in tmp_path.iterdir()] == ['out']


@pytest.mark.parametrize('exchange', [True, False], ids=['one step', 'two renames'])
def test_a_failed_overwrite_leaves_the_old_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: bool
) -> None:
    target = tmp_path / 'out'
    (target / 'sub').mkdir(parents=True)
    (target / 'a').write_text('old')
    (target / 'sub' / 'b').write_text('old')
    if not exchange:
        monkeypatch.setattr(files, 'RENAME_EXCHANGE', 0)  # fails: the name exists
    with pytest.raises(RuntimeError), new_folder(target, overwrite=True) as folder:
        (folder / 'a').write_text('new')
        raise RuntimeError
    assert (target / 'a').read_text() == 'old'
    with new_folder(target, overwrite=True) as folder:
        (folder / 'a').write_text('new')
    assert (target / 'a').read_text() == 'new'
    assert (target / 'sub' / 'b').read_text() == 'old'
    assert [item.name for item in tmp_path.iterdir()] == ['out']


def abandoned(path: Path, ending: str = '.part', process: int | None = None) -> Path:
    """Return the name of a temporary folder of a process, one that has ended if none is given."""
    if process is None:
        ended = subprocess.Popen(['true'])
        ended.wait()
        process = ended.pid
    return path.with_name(f'.{path.name}.{process}.0123abcd{ending}')


def test_temporary_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    target = tmp_path / 'out'
    dead, alive = abandoned(target), abandoned(target, process=os.getpid())
    other = abandoned(tmp_path / 'another')
    for folder in (dead, alive, other):
        folder.mkdir()
        (folder / 'half').write_text('half')
    with new_folder(target) as folder:
        (folder / 'a').write_text('a')
    assert {item.name for item in tmp_path.iterdir()} == {'out', alive.name, other.name}


def test_a_folder_that_a_killed_process_had_renamed_is_put_back(tmp_path: Path) -> None:
    target = tmp_path / 'out'
    renamed = abandoned(target, '.part.old')
    renamed.mkdir()
    (renamed / 'mine').write_text('mine')
    with pytest.raises(GyrocalError, match='not empty'), new_folder(target):
        pytest.fail('the block must not be entered')
    assert (target / 'mine').read_text() == 'mine'


def test_names_that_are_too_long_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GyrocalError, match='cannot be written'):
        write_text_atomic(tmp_path / ('a' * 300), 'text')
    with pytest.raises(GyrocalError, match='cannot be written'), new_folder(tmp_path / ('a' * 300)):
        pytest.fail('the block must not be entered')
    write_text_atomic(tmp_path / ('a' * 250), 'text')
    assert [len(item.name) for item in tmp_path.iterdir()] == [250]


def test_an_empty_folder_may_be_filled(tmp_path: Path) -> None:
    (tmp_path / 'out').mkdir()
    with new_folder(tmp_path / 'out') as folder:
        (folder / 'a').write_text('a')
    assert (tmp_path / 'out' / 'a').read_text() == 'a'


@pytest.mark.parametrize(
    ('package', 'share'),
    [
        ('checkout/gyrocal_ros', 'checkout'),
        ('venv/lib/python3.12/site-packages/gyrocal_ros', 'venv/share/gyrocal_ros'),
        (
            'install/gyrocal_ros/lib/python3.12/site-packages/gyrocal_ros',
            'install/gyrocal_ros/share/gyrocal_ros',
        ),
    ],
    ids=['checkout', 'pip', 'colcon'],
)
def test_installed_files_are_found_for_each_kind_of_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, share: str
) -> None:
    (tmp_path / package).mkdir(parents=True)
    (tmp_path / share / 'bags').mkdir(parents=True)
    (tmp_path / share / 'package.xml').write_text('')
    monkeypatch.setattr(files, '__file__', str(tmp_path / package / 'files.py'))
    assert shipped('bags') == (tmp_path / share / 'bags').resolve()
    with pytest.raises(GyrocalError, match='not installed'):
        shipped('no_such_thing')


@pytest.mark.parametrize('name', ['loop', 'loop/x', 'a\0b'])
def test_a_place_that_cannot_exist_is_reported(name: str, tmp_path: Path) -> None:
    (tmp_path / 'loop').symlink_to('loop')
    with pytest.raises(GyrocalError, match='cannot be written'):
        write_text_atomic(tmp_path / name, 'a')
    with pytest.raises(GyrocalError, match='cannot be written'), new_folder(tmp_path / name):
        pass


def test_a_name_that_is_not_utf_8_is_written_with_question_marks(tmp_path: Path) -> None:
    name = os.fsdecode(b'bag\xff')
    write_text_atomic(tmp_path / name, f'of {name}')
    assert (tmp_path / name).read_bytes() == b'of bag?'
