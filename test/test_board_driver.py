"""The driver without ROS, at the port of an emulated board: reconnection, commands, what it tells."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from emulated import WITHIN_S, BoardProgram

from gyrocal_ros.config.sections import BoardConfig, DriverConfig
from gyrocal_ros.data import ImuSample
from gyrocal_ros.robot import board_driver, board_health
from gyrocal_ros.robot.board_driver import BoardDriver, BoardError
from gyrocal_ros.robot.health import Level


@dataclass
class Host:
    """A driver, and all that it has handed on."""

    port: Path
    readings: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.settings = replace(DriverConfig(), port=str(self.port))
        self.driver = BoardDriver(BoardConfig(), self.settings, time.time_ns, self.readings.append)
        self.driver.start()

    def wait(self, until: Callable[[], Any], what: str) -> None:
        end_s = time.monotonic() + WITHIN_S
        while not until():
            assert time.monotonic() < end_s, f'waited in vain for {what}; {self.driver.tell()}'
            time.sleep(0.02)

    def wait_to_be_told(self, words: str, level: Level) -> None:
        def is_told() -> bool:
            health = self.driver.tell()
            return words in health.message and health.level == level

        self.wait(is_told, words)

    def wait_for_imu(self, count: int = 20) -> None:
        more = len(self.imu()) + count
        self.wait(lambda: len(self.imu()) >= more, 'IMU samples')

    def imu(self) -> list[ImuSample]:
        return [reading for reading in self.readings if isinstance(reading, ImuSample)]


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    monkeypatch.setattr(board_health, 'RECENT_S', 1.0)
    monkeypatch.setattr(board_driver, 'ZERO_MS', 100)
    made = Host(tmp_path / 'board')
    yield made
    made.driver.close()


def test_a_port_that_is_lost_is_found_again_and_stamps_rise(host: Host) -> None:
    host.wait_to_be_told(f'{host.port}: is not there; plug the board in', Level.ERROR)
    with BoardProgram(host.port, '--scenario', 'standing') as board:
        host.wait_for_imu()
        host.wait_to_be_told('IMU', Level.OK)
        board.inject_fault('unplug+1')
        host.wait_to_be_told('not connected for', Level.ERROR)
        host.wait_for_imu()
        host.wait_to_be_told('frames were lost of late', Level.WARN)
        host.wait_to_be_told('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
    host.wait_to_be_told('is gone', Level.ERROR)
    with BoardProgram(host.port, '--scenario', 'standing', '--seed', '2'):
        host.wait_for_imu()
        host.wait_to_be_told('the board was started anew', Level.WARN)
    times = [sample.t_ns for sample in host.imu()]
    assert all(a < b for a, b in pairwise(times))
    assert host.driver.tell().numbers['connections'] == 3


def test_a_board_is_told_the_rates_and_keeps_them_when_it_loses_its_power(host: Host) -> None:
    with BoardProgram(host.port, '--scenario', 'standing') as board:
        host.wait_to_be_told('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
        host.driver.set_rates(replace(host.settings, imu_hz=50, wheels_hz=10))
        host.wait_to_be_told('IMU 50 Hz, wheels 10 Hz, supply 10 Hz', Level.OK)
        board.inject_fault('restart+0.5')
        host.wait_to_be_told('the board was started anew', Level.WARN)
        host.wait_to_be_told('IMU 50 Hz, wheels 10 Hz, supply 10 Hz', Level.OK)
        host.driver.set_rates(replace(host.settings, imu_hz=150))
        host.wait_to_be_told('the board cannot send 150 IMU', Level.WARN)


def test_the_zero_is_measured_while_the_robot_stands(host: Host) -> None:
    with pytest.raises(BoardError, match='not connected'):
        host.driver.zero()
    with BoardProgram(host.port, '--scenario', 'standing'):
        host.wait_for_imu()
        host.driver.zero()
    with BoardProgram(host.port, '--scenario', 'spins', '--start-at', str(time.time() - 10.0)):
        host.wait_for_imu()
        with pytest.raises(BoardError, match='refuses; let the robot stand'):
            host.driver.zero()


def test_the_driver_takes_no_port_twice_and_lets_go_of_it(host: Host) -> None:
    with BoardProgram(host.port, '--scenario', 'standing'):
        host.wait_for_imu()
        other = Host(host.port)
        other.wait_to_be_told('is in use', Level.ERROR)
        host.driver.close()
        other.wait_for_imu()
        other.driver.close()


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_an_error_in_a_reader_of_readings_is_told(tmp_path: Path) -> None:
    def fail(reading: object) -> None:
        raise RuntimeError('as the test wants it')

    with BoardProgram(tmp_path / 'board', '--scenario', 'standing'):
        settings = replace(DriverConfig(), port=str(tmp_path / 'board'))
        driver = BoardDriver(BoardConfig(), settings, time.time_ns, fail)
        driver.start()
        end_s = time.monotonic() + WITHIN_S
        while 'reading has ended' not in driver.tell().message:
            assert time.monotonic() < end_s
        driver.close()
