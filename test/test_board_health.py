"""Health of the board: each fault is reported while it lasts, and for the length of the window after it."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

import pytest

from gyrocal_ros.board.commands import PendingCommand
from gyrocal_ros.board.messages import CommandResult, SetRates
from gyrocal_ros.board.protocol import Counts
from gyrocal_ros.robot.board_driver import RECENT_S, BoardHealth, PortState
from gyrocal_ros.robot.health import Level, Status

RATES = SetRates(200, 50, 10)
OPEN = PortState(is_open=True, since_s=0.0)
COUNTERS = (
    'bytes',
    'imu',
    'wheels',
    'supply',
    'board_restarts',
    'clock_sets',
    'odd_times',
    'implausible',
    'connections',
)
FRAMES = asdict(Counts())


def zeros() -> Counter[str]:
    return Counter({**dict.fromkeys(COUNTERS, 0), **FRAMES})


@dataclass
class Board:
    """A board whose health is asked for once a second."""

    counts: Counter[str] = field(default_factory=zeros)
    now_s: float = 0.0
    port: PortState = OPEN
    data_s: float = 0.0
    order: PendingCommand[SetRates] = field(default_factory=lambda: PendingCommand(RATES, CommandResult.DONE))
    health: BoardHealth = field(default_factory=lambda: BoardHealth(zeros(), 0.0))

    def second(self, imu: int = 200, wheels: int = 50, supply: int = 10, **more: int) -> Status:
        """Let a second pass with these numbers of messages, and further counts."""
        assert set(more) <= set(self.counts), 'all counters are known'
        received = imu + wheels + supply
        self.counts.update(imu=imu, wheels=wheels, supply=supply, packets=received)
        self.counts.update(more)
        self.now_s += 1.0
        if received or set(more) & set(FRAMES):
            self.data_s = self.now_s
        return self.health.status(self.counts, self.port, self.data_s, self.order, self.now_s)

    def seconds(self, count: int, **more: Any) -> Status:
        for _ in range(count - 1):
            self.second(**more)
        return self.second(**more)


def test_a_working_board_has_no_problems() -> None:
    board = Board()
    assert all(board.second().level == Level.OK for _ in range(10))
    health = board.second()
    assert health.message == 'IMU 200 Hz, wheels 50 Hz, supply 10 Hz'
    assert health.numbers['imu_hz'] == 200.0
    assert health.numbers['packets'] == 11 * 260


@pytest.mark.parametrize(
    ('counted', 'level', 'words'),
    [
        ({'bad_checksums': 4, 'malformed': 3}, Level.WARN, 'frames are corrupted (7 recently)'),
        ({'malformed': 3000}, Level.ERROR, 'frames are corrupted (3000 recently)'),
        ({'lost': 12}, Level.WARN, '12 frames were lost recently'),
        ({'bad_checksums': 4, 'lost': 12}, Level.WARN, '8 frames were lost recently'),
        ({'unknown': 5}, Level.WARN, '5 messages of unknown types'),
        ({'board_restarts': 1, 'odd_times': 1}, Level.WARN, 'the board has restarted'),
        ({'odd_times': 2}, Level.WARN, '2 messages with inconsistent board times were dropped'),
        ({'implausible': 2}, Level.WARN, '2 packets beyond board_limits were dropped'),
        ({'clock_sets': 1}, Level.WARN, "this computer's clock was set"),
    ],
)
def test_a_fault_is_reported_for_the_length_of_the_window(
    counted: dict[str, int], level: Level, words: str
) -> None:
    board = Board()
    board.seconds(10)
    first = board.second(**counted)
    assert first.level == level and words in first.message
    later = [board.second() for _ in range(round(RECENT_S) + 2)]
    assert words in later[round(RECENT_S) - 2].message
    assert later[-1].level == Level.OK
    for name, count in counted.items():
        assert later[-1].numbers[name] == count


def test_a_closed_port_is_the_only_problem() -> None:
    board = Board()
    board.seconds(10, bad_checksums=5)
    board.port = PortState(is_open=False, since_s=board.now_s, why='/dev/x: is gone')
    health = board.seconds(3, imu=0, wheels=0, supply=0)
    assert (health.level, health.message) == (Level.ERROR, 'not connected for 3 s: /dev/x: is gone')


def test_a_silent_board_is_reported_at_once() -> None:
    board = Board()
    board.seconds(10)
    health = board.seconds(2, imu=0, wheels=0, supply=0)
    assert health.level == Level.ERROR
    assert health.message.startswith('no data from the board for 2 s')


def test_noise_alone_is_not_from_the_board() -> None:
    health = Board().seconds(10, imu=0, wheels=0, supply=0, malformed=20)
    assert health.level == Level.ERROR
    assert 'the received data are not from the board: check driver.port and driver.baud_rate' in (
        health.message
    )


def test_a_low_rate_is_reported_when_it_lasts() -> None:
    board = Board()
    assert board.seconds(3, imu=100).level == Level.OK
    health = board.seconds(7, imu=100)
    assert (health.level, health.message) == (Level.WARN, 'IMU 100 Hz, not the requested 200')


def test_rates_are_compared_with_those_requested_last() -> None:
    board = Board()
    board.seconds(10, imu=100, wheels=25)
    board.order = PendingCommand(SetRates(100, 25, 10), CommandResult.DONE)
    assert all(board.second(imu=100, wheels=25).level == Level.OK for _ in range(10))


def test_rates_that_the_board_refuses_are_reported() -> None:
    board = Board(order=PendingCommand(SetRates(400, 50, 10), CommandResult.OUT_OF_RANGE))
    health = board.seconds(10)
    assert health.level == Level.WARN
    assert health.message.startswith(
        'the board cannot send 400 IMU, 50 wheel and 10 supply messages a second'
    )


def test_unanswered_commands_are_reported() -> None:
    board = Board(order=PendingCommand(RATES, attempts=2))
    assert board.seconds(10).level == Level.OK
    board.order.attempts = 4
    assert board.second().message == 'the board does not answer commands'
