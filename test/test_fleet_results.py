"""Plan, result files and tables of a fleet, without a cluster."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.fleet.plan import PlannedBag, plan_bags
from gyrocal_ros.fleet.pooling import candidate_of, effect_of
from gyrocal_ros.fleet.result import BagResult, BagScores, decode, encode, failed
from gyrocal_ros.fleet.store import COLUMNS, FleetStore
from gyrocal_ros.fleet.table import read_fleet, read_information, read_scores

ABOUT = {'model': {'name': 'm'}}


def bag_folder(path: Path) -> Path:
    path.mkdir(parents=True)
    (path / 'metadata.yaml').write_text('')
    (path / 'a.mcap').write_text('')
    return path


def scores(names: tuple[str, ...], seed: int = 0) -> BagScores:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((len(names), len(names)))
    return BagScores(
        names, ('1',) * len(names), root @ root.T, rng.standard_normal(len(names)), np.ones(len(names))
    )


def good(seed: int, names: tuple[str, ...] = ('x.a', 'y.b', 'y.c')) -> BagResult:
    row = {'status': 'calibrated', 'reason': '', 'scale_factor': 1.0 + seed, 'scale_factor_std': 0.1}
    return BagResult(row, scores(names, seed))


def test_folders_files_and_patterns_are_searched_for_bags(tmp_path: Path) -> None:
    first = bag_folder(tmp_path / 'robot_a' / 'monday')
    second = bag_folder(tmp_path / 'robot_b' / 'monday')
    single = tmp_path / 'robot_b' / 'tuesday.bag'
    single.write_text('')
    expected = [('robot_a', str(first)), ('robot_b', str(second)), ('robot_b', str(single))]
    assert [(item.robot, item.bag) for item in plan_bags([str(tmp_path)])] == expected
    assert [(item.robot, item.bag) for item in plan_bags([str(tmp_path / '*'), str(single)])] == expected
    with pytest.raises(GyrocalError, match='contains no bag'):
        plan_bags([str(tmp_path / 'nothing')])


def test_a_table_names_robots_and_has_further_columns(tmp_path: Path) -> None:
    table = tmp_path / 'bags.csv'
    table.write_text('bag,robot,age_h,site\nb/one,007,12.5,hall\nmemory://two,8,,\n')
    first, second = plan_bags([str(table)])
    assert (first.bag, first.robot) == (str(tmp_path / 'b/one'), '007')
    assert first.columns == {'age_h': 12.5, 'site': 'hall'}
    assert second.bag == 'memory://two' and second.columns['age_h'] is None


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('bag,age\nx,1\n', 'has no column robot'),
        ('bag,robot\nx,1\nx,2\n', 'is listed for two robots'),
        ('', 'cannot be read'),
    ],
)
def test_a_wrong_table_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / 'bags.csv').write_text(text)
    with pytest.raises(GyrocalError, match=message):
        plan_bags([str(tmp_path / 'bags.csv')])


def test_a_result_file_keeps_every_bit_and_belongs_to_its_key() -> None:
    result = good(3)
    content = encode(result, 'key')
    assert encode(result, 'key') == content
    read = decode(content, 'key')
    assert read is not None and read.scores is not None and result.scores is not None
    assert read.row == result.row and read.scores.names == result.scores.names
    assert np.array_equal(read.scores.information, result.scores.information)
    assert np.array_equal(read.scores.score, result.scores.score)
    assert decode(content, 'another key') is None
    assert decode(content[:-20], 'key') is None


def test_tables_hold_every_bag_once_whatever_columns_it_has(tmp_path: Path) -> None:
    store = FleetStore(tmp_path / 'fleet')
    planned = [
        PlannedBag('/a', 'r1', {'age_h': 10, 'status': 'ignored'}),
        PlannedBag('/b', 'r2', {}),
        PlannedBag('/c', 'r2', {}),
    ]
    other = good(2, ('y.c', 'z.d'))
    store.write_tables(planned, [good(1), failed('damaged'), other], ABOUT)
    table = read_fleet([store.folder])
    assert list(table.columns)[: len(COLUMNS)] == list(COLUMNS)
    assert table.columns['status'] == ['calibrated', 'failed', 'calibrated']
    assert table.columns['reason'][1] == 'damaged'
    assert table.coefficients == ['scale_factor', 'bias']
    assert table.numbers('age_h')[0] == 10.0 and np.isnan(table.numbers('age_h')[1:]).all()
    read = read_scores([store.folder])
    assert read.bags == ('/a', '/c') and read.names == ('x.a', 'y.b', 'y.c', 'z.d')
    first = good(1).scores
    assert first is not None and other.scores is not None
    information = read_information([store.folder], read, np.array([0, 2, 3]))
    expected = np.zeros((2, 3, 3))
    expected[0, :2, :2] = first.information[np.ix_([0, 2], [0, 2])]
    expected[1, 1:, 1:] = other.scores.information
    assert np.allclose(information, expected, rtol=1e-15)


def test_the_last_run_of_a_bag_counts_and_models_must_agree(tmp_path: Path) -> None:
    planned = [PlannedBag('/a', 'r1', {})]
    for name, seed, about in (('one', 1, ABOUT), ('two', 2, ABOUT), ('other', 3, {'model': {'name': 'n'}})):
        FleetStore(tmp_path / name).write_tables(planned, [good(seed)], about)
    table = read_fleet([tmp_path / 'one', tmp_path / 'two'])
    assert table.columns['scale_factor'] == [3.0]
    assert read_scores([tmp_path / 'one', tmp_path / 'two']).bags == ('/a',)
    with pytest.raises(GyrocalError, match='different sensor models'):
        read_fleet([tmp_path / 'one', tmp_path / 'other'])
    with pytest.raises(GyrocalError, match='is no finished fleet'):
        read_fleet([tmp_path])


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'thesis.txt').write_text('')
    with pytest.raises(GyrocalError, match='is not the folder of a fleet'):
        FleetStore(tmp_path)


@pytest.mark.parametrize(
    ('name', 'candidate', 'effect'),
    [
        ('gyro_lag.tau', 'gyro_lag', 'gyro_lag'),
        ('bias_warmup.amplitude@20.5', 'bias_warmup@20.5', 'bias_warmup'),
        ('turn_hysteresis[2].k@4', 'turn_hysteresis[2]@4', 'turn_hysteresis'),
        ('covariate_bias:fan.speed.k', 'covariate_bias:fan.speed', 'covariate_bias:fan.speed'),
    ],
)
def test_columns_are_named_by_effect_scan_and_coefficient(name: str, candidate: str, effect: str) -> None:
    assert candidate_of(name) == candidate
    assert effect_of(candidate) == effect
