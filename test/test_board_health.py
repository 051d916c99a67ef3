"""What is told of the board: each fault in its sentence while it lasts, and no longer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from gyrocal_ros.board.commands import PendingCommand
from gyrocal_ros.board.messages import CommandResult, SetRates
from gyrocal_ros.board.protocol import Counts
from gyrocal_ros.robot.board_health import RECENT_S, BoardHealth, PortState, Tally
from gyrocal_ros.robot.health import Level, Status

RATES = SetRates(200, 50, 10)
NOTHING = Tally(0.0, 0, 0, 0, 0, 0, 0, 0, 0, Counts())
OPEN = PortState(is_open=True, since_s=0.0)


@dataclass
class Board:
    """A board that is asked about once a second."""

    now: Tally = NOTHING
    line: PortState = OPEN
    heard_s: float = 0.0
    order: PendingCommand[SetRates] = field(default_factory=lambda: PendingCommand(RATES, CommandResult.DONE))
    health: BoardHealth = field(default_factory=lambda: BoardHealth(NOTHING))

    def second(self, imu: int = 200, wheels: int = 50, supply: int = 10, **more: int) -> Status:
        """A second in which so much came, and `more` was counted."""
        now, frames = self.now, self.now.frames
        bad = {name: count for name, count in more.items() if hasattr(frames, name)}
        come = imu + wheels + supply
        counted = {name: getattr(frames, name) + count for name, count in bad.items()}
        self.now = replace(
            now,
            time_s=now.time_s + 1.0,
            imu=now.imu + imu,
            wheels=now.wheels + wheels,
            supply=now.supply + supply,
            frames=replace(frames, packets=frames.packets + come, **counted),
            **{name: getattr(now, name) + count for name, count in more.items() if name not in bad},
        )
        if come or bad:
            self.heard_s = self.now.time_s
        return self.health.tell(self.now, self.line, self.heard_s, self.order)

    def seconds(self, count: int, **more: Any) -> Status:
        for _ in range(count - 1):
            self.second(**more)
        return self.second(**more)


def test_a_board_that_does_all_it_should_is_fine() -> None:
    board = Board()
    assert all(board.second().level == Level.OK for _ in range(10))
    health = board.second()
    assert health.message == 'IMU 200 Hz, wheels 50 Hz, supply 10 Hz'
    assert health.numbers['imu_hz'] == 200.0
    assert health.numbers['packets'] == 11 * 260


@pytest.mark.parametrize(
    ('counted', 'level', 'words'),
    [
        ({'bad_checksums': 4, 'malformed': 3}, Level.WARN, 'frames came spoiled (7 of late)'),
        ({'malformed': 3000}, Level.ERROR, 'frames came spoiled (3000 of late)'),
        ({'lost': 12}, Level.WARN, '12 frames were lost of late'),
        ({'bad_checksums': 4, 'lost': 12}, Level.WARN, '8 frames were lost of late'),
        ({'unknown': 5}, Level.WARN, '5 messages of unknown types'),
        ({'board_restarts': 1, 'odd_times': 1}, Level.WARN, 'the board was started anew'),
        ({'odd_times': 2}, Level.WARN, '2 messages came with odd board times'),
        ({'clock_sets': 1}, Level.WARN, "this computer's clock was set"),
    ],
)
def test_what_happened_is_told_for_a_while(counted: dict[str, int], level: Level, words: str) -> None:
    board = Board()
    board.seconds(10)
    first = board.second(**counted)
    assert first.level == level and words in first.message
    later = [board.second() for _ in range(round(RECENT_S) + 2)]
    assert words in later[round(RECENT_S) - 2].message
    assert later[-1].level == Level.OK
    for name, count in counted.items():
        assert later[-1].numbers[name] == count


def test_a_port_that_is_not_open_is_the_only_complaint() -> None:
    board = Board()
    board.seconds(10, bad_checksums=5)
    board.line = PortState(is_open=False, since_s=board.now.time_s, why='/dev/x: is gone')
    health = board.seconds(3, imu=0, wheels=0, supply=0)
    assert (health.level, health.message) == (Level.ERROR, 'not connected for 3 s: /dev/x: is gone')


def test_a_board_that_is_silent_is_told_at_once() -> None:
    board = Board()
    board.seconds(10)
    health = board.seconds(2, imu=0, wheels=0, supply=0)
    assert health.level == Level.ERROR
    assert health.message.startswith('nothing has come from the board for 2 s')


def test_noise_alone_is_not_from_the_board() -> None:
    health = Board().seconds(10, imu=0, wheels=0, supply=0, malformed=20)
    assert health.level == Level.ERROR
    assert 'what comes is not from the board: see to driver.port and to driver.baud_rate' in health.message


def test_a_rate_that_is_too_low_is_told_when_it_lasts() -> None:
    board = Board()
    assert board.seconds(3, imu=100).level == Level.OK
    health = board.seconds(7, imu=100)
    assert (health.level, health.message) == (Level.WARN, 'IMU 100 Hz, not the 200 asked for')


def test_rates_are_judged_by_what_is_asked_for_now() -> None:
    board = Board()
    board.seconds(10, imu=100, wheels=25)
    board.order = PendingCommand(SetRates(100, 25, 10), CommandResult.DONE)
    assert all(board.second(imu=100, wheels=25).level == Level.OK for _ in range(10))


def test_rates_that_the_board_refuses_are_told() -> None:
    board = Board(order=PendingCommand(SetRates(400, 50, 10), CommandResult.OUT_OF_RANGE))
    health = board.seconds(10)
    assert health.level == Level.WARN
    assert health.message.startswith(
        'the board cannot send 400 IMU, 50 wheel and 10 supply messages a second'
    )


def test_a_board_that_does_not_answer_is_told() -> None:
    board = Board(order=PendingCommand(RATES, attempts=2))
    assert board.seconds(10).level == Level.OK
    board.order.attempts = 4
    assert board.second().message == 'the board does not answer commands'
