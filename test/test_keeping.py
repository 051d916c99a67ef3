"""The calibration file of a running robot: never spoiled, never lost, always told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.start import initial_state
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.pipeline.calibration import Calibration, calibration_of, load_calibration, save_calibration
from gyrocal_ros.robot.calibration_store import CalibrationStore


def known(converged: bool = True) -> Calibration:
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
    )


def test_what_is_saved_is_found_again(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'calibration.yaml'
    assert CalibrationStore(path).save(known(), Config())
    found = CalibrationStore(path).load(Config())
    assert found is not None
    assert found.values.tolist() == known().values.tolist()
    assert [item.name for item in path.parent.iterdir()] == [path.name], 'and nothing half-written beside it'


@pytest.mark.parametrize('text', ['', 'scale_factor: [', 'scale_factor: 1.0', '\x00\x01'])
def test_a_file_that_cannot_be_used_is_set_aside_and_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'calibration.yaml'
    path.write_text(text)
    keeper = CalibrationStore(path)
    assert keeper.load(Config()) is None
    assert 'begun with the priors' in keeper.complaint
    assert not path.exists()
    assert (tmp_path / 'calibration.yaml.bad').read_text() == text
    keeper.save(known(), Config())
    assert load_calibration(path).converged


def test_a_calibration_with_another_nominal_scale_factor_is_set_aside(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    save_calibration(known(), Config(), path)
    other = replace(Config(), gyro=replace(Config().gyro, nominal_scale_factor_volt=100.0))
    keeper = CalibrationStore(path)
    assert keeper.load(other) is None
    assert 'nominal scale factor of 146.4 deg/s/V, now it is 100' in keeper.complaint


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='is a folder'):
        CalibrationStore(tmp_path).load(Config())


def test_what_cannot_be_written_is_told_until_it_can(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    keeper = CalibrationStore(tmp_path / 'file' / 'calibration.yaml')
    assert not keeper.save(known(), Config())
    assert 'could not be saved' in keeper.complaint
    (tmp_path / 'file').unlink()
    assert keeper.save(known(), Config())
    assert not keeper.complaint


def test_a_half_done_calibration_takes_no_place_of_a_finished_one(tmp_path: Path) -> None:
    keeper = CalibrationStore(tmp_path / 'calibration.yaml')
    assert keeper.is_better(known(converged=False))
    keeper.save(known(), Config())
    assert not keeper.is_better(known(converged=False))
    assert keeper.is_better(known())


def test_what_is_forgotten_is_kept_under_another_name(tmp_path: Path) -> None:
    path = tmp_path / 'calibration.yaml'
    keeper = CalibrationStore(path)
    assert not keeper.forget()
    keeper.save(known(), Config())
    assert 'calibration.yaml.old' in keeper.forget()
    assert not path.exists()
    assert keeper.is_better(known(converged=False))
    assert CalibrationStore(path).load(Config()) is None
