"""The receive path from bytes to readings, and the repetition of commands until they are acknowledged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count, pairwise

import numpy as np
import pytest

from gyrocal_ros.board.clock import RestartCause
from gyrocal_ros.board.commands import ANSWER_TIMEOUT_S, CommandQueue
from gyrocal_ros.board.convert import SupplySample
from gyrocal_ros.board.messages import (
    Acknowledgement,
    CommandResult,
    Imu,
    Message,
    SetRates,
    Supply,
    Wheels,
    Zero,
)
from gyrocal_ros.board.protocol import Decoder, Packet, encode, wire_time_s
from gyrocal_ros.board.reader import BoardReader, Reading, WheelMotion, WheelPose
from gyrocal_ros.config.board_limits import BoardLimits
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import NS_PER_S, ImuSample, TemperatureSample, nanoseconds

START_NS = 1_700_000_000 * NS_PER_S
BAUD = 115200
LEVEL = Imu((0, 0, 1000), (0, 0, 8192), 2550)
RATES = SetRates(200, 50, 10)


class Sender:
    """A board whose frames arrive after their transmission time."""

    def __init__(self, board_us: int = 0, baud_rate: int = BAUD) -> None:
        self._board_us, self._baud_rate = board_us, baud_rate
        self._sequence = count()

    def send(self, message: Message, at_s: float) -> tuple[bytes, int]:
        """Return the frame and arrival time of a message measured at `at_s`."""
        frame = encode(message, next(self._sequence), self._board_us + round(1e6 * at_s))
        arrival_s = at_s + wire_time_s(type(message), self._baud_rate)
        return frame, START_NS + nanoseconds(arrival_s)


def readings(reader: BoardReader, *arrivals: tuple[bytes, int]) -> list[Reading]:
    return [reading for data, arrival_ns in arrivals for reading in reader.feed(data, arrival_ns)]


def stamps(found: list[Reading]) -> list[int]:
    return [reading.t_ns for reading in found if isinstance(reading, ImuSample)]


# --- readings -------------------------------------------------------------------------------------


def test_every_message_is_converted_to_its_reading() -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    imu, temperature, wheels, supply, answer = readings(
        reader,
        sender.send(LEVEL, 0.0),
        sender.send(Wheels(0, 0), 0.003),
        sender.send(Wheels(100, 100), 0.023),
        sender.send(Supply(16_400, -1250), 0.024),
        sender.send(Acknowledgement(7, SetRates.TYPE, CommandResult.DONE), 0.025),
    )
    assert isinstance(imu, ImuSample)
    assert imu.rate_rad_s == pytest.approx((0.0, 0.0, math.radians(1.464)))
    assert temperature == TemperatureSample(imu.t_ns, 25.5)
    assert isinstance(wheels, WheelMotion)
    assert wheels.sample.speed_m_s == pytest.approx(1.5)
    assert isinstance(supply, SupplySample) and supply.voltage_v == 16.4
    assert answer == Acknowledgement(7, SetRates.TYPE, CommandResult.DONE)
    assert reader.received == {Imu: 1, Wheels: 2, Supply: 1, Acknowledgement: 1}


@pytest.mark.parametrize('baud_rate', [9600, 115200, 4_000_000])
def test_the_transmission_time_of_each_message_is_subtracted(baud_rate: int) -> None:
    sender, reader = Sender(baud_rate=baud_rate), BoardReader(BoardConfig(), baud_rate)
    for i in range(100):
        message: Message = (LEVEL, Wheels(i, i), Supply(i, i))[i % 3]
        for reading in readings(reader, sender.send(message, 0.1 * i)):
            assert not isinstance(reading, Acknowledgement)
            t_ns = reading.sample.t_ns if isinstance(reading, WheelMotion) else reading.t_ns
            assert abs(t_ns - START_NS - nanoseconds(0.1 * i)) < 10_000


def test_the_temperature_is_output_once_per_second() -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    found = readings(reader, *(sender.send(LEVEL, 0.005 * i) for i in range(2000)))
    warm = [reading.t_ns for reading in found if isinstance(reading, TemperatureSample)]
    assert len(warm) == 10
    assert {round((b - a) / 1e6) for a, b in pairwise(warm)} == {1000}


def drive(reader: BoardReader, ticks: list[tuple[int, int]]) -> WheelPose:
    sender, pose = Sender(), WheelPose()
    for i, (left, right) in enumerate(ticks):
        for reading in readings(reader, sender.send(Wheels(left, right), 0.02 * i)):
            assert isinstance(reading, WheelMotion)
            pose = reading.pose
    return pose


def test_the_pose_follows_the_wheels() -> None:
    config = BoardConfig()
    quarter = round(math.pi / 4.0 * config.track_m / config.tick_m)
    metre = round(1.0 / config.tick_m)
    forward = [(metre * i // 100, metre * i // 100) for i in range(101)]
    turn = [(metre - quarter * i // 50, metre + quarter * i // 50) for i in range(51)]
    back = [(metre - quarter - metre * i // 100, metre + quarter - metre * i // 100) for i in range(101)]
    pose = drive(BoardReader(config, BAUD), forward + turn + back)
    assert (pose.x_m, pose.y_m) == pytest.approx((1.0, -1.0), abs=0.005)
    assert pose.yaw_rad == pytest.approx(math.pi / 2.0, abs=0.005)


def test_the_pose_continues_over_a_gap_of_unknown_speed() -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    times = (0.0, 0.02, 5.0, 5.02)
    found = readings(reader, *(sender.send(Wheels(100 * i, 100 * i), t) for i, t in enumerate(times)))
    motions = [reading for reading in found if isinstance(reading, WheelMotion)]
    assert [motion.pose.x_m for motion in motions] == pytest.approx([0.03, 0.09])
    assert motions[-1].sample.speed_m_s == pytest.approx(1.5)


# --- lost lines -----------------------------------------------------------------------------------


def test_stamps_increase_over_a_lost_line() -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    before = readings(reader, *(sender.send(LEVEL, 0.005 * i) for i in range(100)))
    reader.feed(sender.send(LEVEL, 0.5)[0][:9], START_NS)
    reader.skip_partial_frame()
    after = readings(reader, *(sender.send(LEVEL, 5.0 + 0.005 * i) for i in range(100)))
    times = stamps(before + after)
    assert all(a < b for a, b in pairwise(times))
    assert times[-1] - times[0] == pytest.approx(5.495e9, abs=1e6)
    assert reader.decoder.counts.malformed == 0


def test_starting_in_the_middle_of_a_frame_counts_no_error() -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    (first, arrival_ns), (second, later_ns) = sender.send(LEVEL, 0.0), sender.send(LEVEL, 0.005)
    reader.skip_partial_frame()
    assert readings(reader, (first[10:15], arrival_ns), (first[15:], arrival_ns), (second, later_ns))
    counts = reader.decoder.counts
    assert (counts.packets, counts.malformed, counts.bad_checksums) == (1, 0, 0)


@pytest.mark.parametrize('away_s', [0.0, 2.0, 30.0])
def test_stamps_increase_over_a_restart_of_the_board(away_s: float) -> None:
    first, second, reader = Sender(3_000_000_000), Sender(), BoardReader(BoardConfig(), BAUD)
    before = readings(reader, *(first.send(LEVEL, 0.005 * i) for i in range(400)))
    again_s = 2.0 + away_s
    after = readings(
        reader,
        *(
            (data, ns + nanoseconds(again_s))
            for data, ns in (second.send(LEVEL, 0.005 * i) for i in range(400))
        ),
    )
    times = stamps(before + after)
    assert all(a < b for a, b in pairwise(times))
    assert times[-1] - times[0] == pytest.approx(1e9 * (again_s + 1.995), abs=1e6)
    assert reader.clock.restarts == {RestartCause.BOARD: 1}


def test_noise_never_raises_and_intact_frames_are_decoded() -> None:
    rng, sender, reader = np.random.default_rng(1), Sender(), BoardReader(BoardConfig(), BAUD)
    found = []
    for i in range(300):
        frame, arrival_ns = sender.send(LEVEL, 0.005 * i)
        found += reader.feed(rng.bytes(int(rng.integers(2000))) + b'\0' + frame, arrival_ns)
    times = stamps(found)
    assert len(times) == 300 and all(a < b for a, b in pairwise(times))
    assert reader.decoder.counts.malformed > 300


# --- commands -------------------------------------------------------------------------------------


def packets(data: bytes) -> list[Packet]:
    return Decoder().feed(data)


def transmissions(commands: CommandQueue, until_s: float) -> Iterator[tuple[float, Packet]]:
    """Yield the time and packet of each transmission, polling a hundred times per second."""
    for i in range(round(100.0 * until_s)):
        for packet in packets(commands.due_frames(0.01 * i)):
            yield 0.01 * i, packet


def test_rates_are_sent_until_they_are_acknowledged() -> None:
    commands = CommandQueue(RATES)
    sent = list(transmissions(commands, 3.0 * ANSWER_TIMEOUT_S))
    assert [at_s for at_s, _ in sent] == pytest.approx(
        [0.0, ANSWER_TIMEOUT_S, 2.0 * ANSWER_TIMEOUT_S], abs=0.011
    )
    assert {packet.message for _, packet in sent} == {RATES}
    assert len({packet.sequence for _, packet in sent}) == 3
    commands.acknowledge(Acknowledgement(sent[0][1].sequence, SetRates.TYPE, CommandResult.DONE))
    assert commands.rates.result == CommandResult.DONE
    assert commands.due_frames(1e6) == b''


def test_an_answer_to_another_command_is_ignored() -> None:
    commands = CommandQueue(RATES)
    [packet] = packets(commands.due_frames(0.0))
    commands.acknowledge(Acknowledgement(packet.sequence + 1, SetRates.TYPE, CommandResult.DONE))
    commands.acknowledge(Acknowledgement(packet.sequence, Zero.TYPE, CommandResult.DONE))
    assert commands.rates.result is None


def test_rates_are_sent_again_after_a_possible_restart() -> None:
    commands = CommandQueue(RATES)
    [first] = packets(commands.due_frames(0.0))
    commands.acknowledge(Acknowledgement(first.sequence, SetRates.TYPE, CommandResult.DONE))
    commands.resend_rates()
    [second] = packets(commands.due_frames(0.0))
    assert second.message == RATES and second.sequence != first.sequence


def test_a_zero_command_is_repeated_only_after_its_averaging_time() -> None:
    commands = CommandQueue(RATES)
    pending = commands.request_zero(1000)
    sent = [at_s for at_s, packet in transmissions(commands, 4.0) if packet.message == Zero(1000)]
    assert sent == pytest.approx([0.0, 1.0 + ANSWER_TIMEOUT_S, 2.0 + 2.0 * ANSWER_TIMEOUT_S], abs=0.02)
    assert pending.result is None
    commands.cancel_zero()
    assert all(packet.message == RATES for packet in packets(commands.due_frames(1e6)))


@pytest.mark.slow
def test_the_sequence_numbers_of_commands_wrap() -> None:
    commands = CommandQueue(RATES)
    numbers = [packets(commands.due_frames(float(at_s)))[0].sequence for at_s in range(65_540)]
    assert numbers[65_535] == 0 and max(numbers) == 65_535


# --- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    'absurd',
    [
        Imu((0, 0, 2**31 - 1), LEVEL.accelerometer, 2550),
        Imu((-(2**31), 0, 0), LEVEL.accelerometer, 2550),
        Imu((0, 0, 1_400_000), LEVEL.accelerometer, 2550),
    ],
)
def test_readings_beyond_the_limits_are_dropped_and_counted(absurd: Imu) -> None:
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD)
    found = readings(reader, *(sender.send(absurd if i == 5 else LEVEL, 0.005 * i) for i in range(10)))
    assert len(stamps(found)) == 9
    assert reader.implausible == 1


def test_a_specific_force_beyond_its_limit_is_dropped() -> None:
    limits = BoardLimits(force_m_s2=20.0)
    sender, reader = Sender(), BoardReader(BoardConfig(), BAUD, limits)
    absurd = Imu((0, 0, 0), (0, 0, 2**15 - 1), 2550)
    assert readings(reader, sender.send(absurd, 0.0)) == []
    assert reader.implausible == 1


def test_one_absurd_count_of_a_wheel_moves_nothing() -> None:
    reader = BoardReader(BoardConfig(), BAUD)
    ticks = [(10 * i, 10 * i) for i in range(20)]
    ticks[7] = (2**31 - 1, 70)
    pose = drive(reader, ticks)
    assert pose.x_m == pytest.approx(190 * BoardConfig().tick_m)
    assert (pose.y_m, pose.yaw_rad, reader.implausible) == (0.0, 0.0, 1)


def test_counters_that_have_jumped_for_good_are_used_after_a_second() -> None:
    reader = BoardReader(BoardConfig(), BAUD)
    ticks = [(10 * i + (10**8 if i > 50 else 0), 10 * i) for i in range(200)]
    pose = drive(reader, ticks)
    assert reader.implausible == pytest.approx(50, abs=2), 'those of a second'
    assert 0.9 * 1500 < pose.x_m / BoardConfig().tick_m < 1500
    assert abs(pose.yaw_rad) < 0.01
