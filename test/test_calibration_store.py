"""The calibration file of a running robot: never corrupted, never lost, problems reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.pipeline.calibration import Calibration, calibration_of, load_calibration, save_calibration
from gyrocal_ros.robot.calibration_store import CalibrationStore


def calibration(converged: bool = True) -> Calibration:
    model, config = default_model(), Config()
    return calibration_of(
        initial_state(model, config, None),
        model,
        config,
        converged=converged,
        convergence_time_s=None,
        duration_s=1.0,
        source='test',
        end_ns=0,
        temperature_c=31.5,
        inflation=np.ones(2),
    )


def test_a_saved_calibration_is_loaded_again(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'calibration.yaml'
    assert CalibrationStore(path).save(calibration(), Config())
    found = CalibrationStore(path).load(Config())
    assert found is not None
    assert found.values.tolist() == calibration().values.tolist()
    assert found.temperature_c == 31.5
    assert [item.name for item in path.parent.iterdir()] == [path.name], 'no temporary file is left'


@pytest.mark.parametrize('text', ['', 'scale_factor: [', 'scale_factor: 1.0', '\x00\x01'])
def test_an_unusable_file_is_renamed_and_reported(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'calibration.yaml'
    path.write_text(text)
    store = CalibrationStore(path)
    assert store.load(Config()) is None
    assert 'started with the priors' in store.problem
    assert not path.exists()
    assert (tmp_path / 'calibration.yaml.bad').read_text() == text
    store.save(calibration(), Config())
    assert load_calibration(path).converged


@pytest.mark.parametrize('scale_factor', [6.0, -0.9, 0.0, 0.49, 1.51])
def test_an_impossible_scale_factor_is_refused(tmp_path: Path, scale_factor: float) -> None:
    path = tmp_path / 'calibration.yaml'
    wrong = replace(calibration(), values=np.array([0.0, scale_factor - 1.0]))
    save_calibration(wrong, Config(), path)
    with pytest.raises(ConfigError, match=f'no gyro has a scale factor of {scale_factor:g}'):
        load_calibration(path)
    store = CalibrationStore(path)
    assert store.load(Config()) is None
    assert 'no gyro has a scale factor' in store.problem


def test_a_scale_factor_that_was_edited_beside_its_coefficient_is_refused(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    save_calibration(calibration(), Config(), path)
    path.write_text(path.read_text().replace('scale_factor: 1.0\n', 'scale_factor: 1.1\n', 1))
    with pytest.raises(ConfigError, match='scale_factor 1.1 contradicts its coefficient'):
        load_calibration(path)


def test_a_calibration_with_another_nominal_scale_factor_is_renamed(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    save_calibration(calibration(), Config(), path)
    other = replace(Config(), gyro=replace(Config().gyro, nominal_scale_factor_volt=100.0))
    store = CalibrationStore(path)
    assert store.load(other) is None
    assert 'nominal scale factor of 146.4 deg/s/V, now it is 100' in store.problem


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='is a folder'):
        CalibrationStore(tmp_path).load(Config())


def test_a_failed_save_is_reported_until_one_succeeds(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    store = CalibrationStore(tmp_path / 'file' / 'calibration.yaml')
    assert not store.save(calibration(), Config())
    assert 'could not be saved' in store.problem
    (tmp_path / 'file').unlink()
    assert store.save(calibration(), Config())
    assert not store.problem


def test_a_converged_calibration_is_not_replaced_by_one_that_is_not(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path / 'calibration.yaml')
    assert store.may_replace(calibration(converged=False))
    store.save(calibration(), Config())
    assert not store.may_replace(calibration(converged=False))
    assert store.may_replace(calibration())


def test_a_file_that_another_calibrator_writes_is_reported(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    first, second = CalibrationStore(path), CalibrationStore(path)
    for store in (first, first, second):
        assert store.save(calibration(), Config()) and not store.problem
    assert first.save(calibration(), Config())
    assert 'is also written by another program' in first.problem
    assert first.save(calibration(), Config()) and not first.problem


def test_a_file_that_was_deleted_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    store = CalibrationStore(path)
    store.save(calibration(), Config())
    path.unlink()
    assert store.save(calibration(), Config()) and not store.problem


def test_a_discarded_file_is_renamed(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    store = CalibrationStore(path)
    assert not store.discard()
    store.save(calibration(), Config())
    assert 'calibration.yaml.old' in store.discard()
    assert not path.exists()
    assert store.may_replace(calibration(converged=False))
    assert CalibrationStore(path).load(Config()) is None


def test_no_renamed_file_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    for number in range(13):
        path.write_text(f'number: {number}')
        assert CalibrationStore(path).load(Config()) is None
    texts = {file.name: file.read_text() for file in tmp_path.iterdir()}
    assert len(texts) == 10, 'the oldest beyond ten are removed'
    assert texts['calibration.yaml.bad.13'] == 'number: 12'
    assert texts['calibration.yaml.bad.4'] == 'number: 3'
    assert CalibrationStore(path).discard() == ''


def test_a_discarded_file_does_not_replace_an_earlier_one(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path / 'calibration.yaml')
    for _ in range(2):
        store.save(calibration(), Config())
        store.discard()
    assert {file.name for file in tmp_path.iterdir()} == {'calibration.yaml.old', 'calibration.yaml.old.2'}
