"""The driver without ROS, at the port of an emulated board: reconnection, commands, health."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from emulated import WITHIN_S, BoardProgram

from gyrocal_ros.config.robot_sections import BoardConfig, DriverConfig
from gyrocal_ros.data import ImuSample
from gyrocal_ros.robot import board_driver
from gyrocal_ros.robot.board_driver import BoardDriver, BoardError
from gyrocal_ros.robot.health import Level


@dataclass
class Host:
    """A driver, and the readings that it has published."""

    port: Path
    readings: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.settings = replace(DriverConfig(), port=str(self.port))
        self.driver = BoardDriver(BoardConfig(), self.settings, time.time_ns, self.readings.append)
        self.driver.start()

    def wait(self, condition: Callable[[], Any], what: str) -> None:
        end_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < end_s, f'timeout while waiting for {what}; {self.driver.status()}'
            time.sleep(0.02)

    def wait_for_health(self, words: str, level: Level) -> None:
        def is_reported() -> bool:
            health = self.driver.status()
            return words in health.message and health.level == level

        self.wait(is_reported, words)

    def wait_for_imu(self, count: int = 20) -> None:
        more = len(self.imu()) + count
        self.wait(lambda: len(self.imu()) >= more, 'IMU samples')

    def imu(self) -> list[ImuSample]:
        return [reading for reading in self.readings if isinstance(reading, ImuSample)]


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    monkeypatch.setattr(board_driver, 'RECENT_S', 1.0)
    monkeypatch.setattr(board_driver, 'ZERO_MS', 100)
    made = Host(tmp_path / 'board')
    yield made
    made.driver.close()


@pytest.mark.slow
def test_a_lost_port_is_opened_again_and_stamps_increase(host: Host) -> None:
    host.wait_for_health(f'{host.port}: is not there; plug the board in', Level.ERROR)
    with BoardProgram(host.port, '--scenario', 'standing') as board:
        host.wait_for_imu()
        host.wait_for_health('IMU', Level.OK)
        board.inject_fault('unplug+1')
        host.wait_for_health('not connected for', Level.ERROR)
        host.wait_for_imu()
        host.wait_for_health('frames were lost recently', Level.WARN)
        host.wait_for_health('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
    # It is gone, and a moment later not there: the first may pass between two looks at the health.
    host.wait_for_health('not connected for', Level.ERROR)
    with BoardProgram(host.port, '--scenario', 'standing', '--seed', '2'):
        host.wait_for_imu()
        host.wait_for_health('the board has restarted', Level.WARN)
    times = [sample.t_ns for sample in host.imu()]
    assert all(a < b for a, b in pairwise(times))
    assert host.driver.status().numbers['connections'] == 3


@pytest.mark.slow
def test_rates_are_requested_again_after_a_restart_of_the_board(host: Host) -> None:
    with BoardProgram(host.port, '--scenario', 'standing') as board:
        host.wait_for_health('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
        host.driver.set_rates(replace(host.settings, imu_hz=50, wheels_hz=10))
        host.wait_for_health('IMU 50 Hz, wheels 10 Hz, supply 10 Hz', Level.OK)
        board.inject_fault('restart+0.5')
        host.wait_for_health('the board has restarted', Level.WARN)
        host.wait_for_health('IMU 50 Hz, wheels 10 Hz, supply 10 Hz', Level.OK)
        host.driver.set_rates(replace(host.settings, imu_hz=150))
        host.wait_for_health('the board cannot send 150 IMU', Level.WARN)


@pytest.mark.slow
def test_the_zero_is_measured_only_at_rest(host: Host) -> None:
    with pytest.raises(BoardError, match='not connected'):
        host.driver.zero()
    with BoardProgram(host.port, '--scenario', 'standing'):
        host.wait_for_imu()
        host.driver.zero()
    with BoardProgram(host.port, '--scenario', 'spins', '--start-at', str(time.time() - 10.0)):
        host.wait_for_imu()
        with pytest.raises(BoardError, match='refuses; keep the robot at rest'):
            host.driver.zero()


@pytest.mark.slow
def test_the_driver_locks_its_port_until_it_is_closed(host: Host) -> None:
    with BoardProgram(host.port, '--scenario', 'standing'):
        host.wait_for_imu()
        other = Host(host.port)
        other.wait_for_health('is in use', Level.ERROR)
        host.driver.close()
        other.wait_for_imu()
        other.driver.close()


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_an_error_in_the_callback_is_reported(tmp_path: Path) -> None:
    def fail(reading: object) -> None:
        raise RuntimeError('raised by the test')

    with BoardProgram(tmp_path / 'board', '--scenario', 'standing'):
        settings = replace(DriverConfig(), port=str(tmp_path / 'board'))
        driver = BoardDriver(BoardConfig(), settings, time.time_ns, fail)
        driver.start()
        end_s = time.monotonic() + WITHIN_S
        while 'the thread of the driver has ended' not in driver.status().message:
            assert time.monotonic() < end_s
        driver.close()
