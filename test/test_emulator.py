"""The emulated board, read by the driver's own reader, with and without faults."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from emulated import BoardProgram

from gyrocal_ros.board.clock import RestartCause
from gyrocal_ros.board.convert import SupplySample
from gyrocal_ros.board.link import Link
from gyrocal_ros.board.messages import Acknowledgement, CommandResult, Message, SetRates, Zero
from gyrocal_ros.board.protocol import checksum, cobs_encode, encode
from gyrocal_ros.board.reader import BoardReader, Reading, WheelMotion
from gyrocal_ros.cli import board_emulator
from gyrocal_ros.cli.main import make_parser
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    ClockStep,
    CovariateSample,
    ImuSample,
    Measurement,
    TemperatureSample,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.emulator.board import EmulatedBoard, Oscillator, detect_sensors
from gyrocal_ros.emulator.line import (
    FAULT_DESCRIPTIONS,
    DataEvent,
    EmulatedLine,
    Fault,
    FaultKind,
    parse_fault,
)
from gyrocal_ros.emulator.schedule import Emulator, PortEvent
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

BAUD = 115200
BAG = Path(__file__).resolve().parent.parent / 'bags/demo'
PAGE = (Path(__file__).resolve().parent.parent / 'docs/board_protocol.md').read_text(encoding='utf-8')
WALL_NS = 1_800_000_000 * NS_PER_S
"""Time of day of the start of the recording."""
MS = 1_000_000


def robot(duration_s: float, scenario: str = 'cleaning') -> list[Measurement]:
    chosen = replace(find_scenario(scenario), duration_s=duration_s, imu_hz=200)
    return list(SimSource(chosen, 3).board_measurements())


OSCILLATOR = Oscillator(123_456_789, 30.0)

SHORT, LONG = robot(8.0), robot(40.0)
STANDING = robot(8.0, 'standing')


def emulator(
    measurements: Iterable[Measurement],
    *faults: str,
    jitter_s: float = 0.0,
    oscillator: Oscillator = OSCILLATOR,
    seed: int = 1,
) -> Emulator:
    sensors, played = detect_sensors(measurements)
    line = EmulatedLine(BAUD, jitter_s, [parse_fault(text) for text in faults], np.random.default_rng(seed))
    return Emulator(played, START_NS, EmulatedBoard(BoardConfig(), sensors, oscillator), line)


@dataclass
class Host:
    """Reads an emulated board in simulated time."""

    board: Emulator
    reader: BoardReader = field(default_factory=lambda: BoardReader(BoardConfig(), BAUD))
    readings: list[Reading] = field(default_factory=list)
    port_events: list[PortEvent] = field(default_factory=list)

    def read(self, until_s: float = np.inf) -> Host:
        """Process all events up to a time since the start."""
        while (t_ns := self.board.next_ns()) is not None and t_ns < until_s * NS_PER_S:
            event = self.board.pop()
            if isinstance(event, PortEvent):
                self.port_events.append(event)
            else:
                self.readings += self.reader.feed(event.data, WALL_NS + event.t_ns)
        return self

    def send(self, message: Message, at_s: float, sequence: int = 1) -> None:
        self.board.receive(encode(message, sequence), nanoseconds(at_s))

    def imu(self) -> list[ImuSample]:
        return [reading for reading in self.readings if isinstance(reading, ImuSample)]

    def wheels(self) -> list[WheelSample]:
        return [reading.sample for reading in self.readings if isinstance(reading, WheelMotion)]

    def answers(self) -> list[Acknowledgement]:
        return [reading for reading in self.readings if isinstance(reading, Acknowledgement)]

    def errors_ms(self, measurements: list[Measurement]) -> Array:
        """Return stamps minus true times of the IMU, for a run without losses."""
        true_ns = [item.t_ns - START_NS for item in measurements if isinstance(item, ImuSample)]
        return (np.array([sample.t_ns - WALL_NS for sample in self.imu()]) - np.array(true_ns)) / MS


@cache
def without_faults() -> Host:
    """Return the host after all of the recording."""
    return Host(emulator(LONG)).read()


# --- recovered measurements -------------------------------------------------------------------------


@pytest.mark.slow
def test_all_samples_are_recovered() -> None:
    host, config = without_faults(), BoardConfig()
    sent = [item for item in LONG if isinstance(item, ImuSample)]
    rate_step = np.radians(config.gyro_volt * config.gyro_scale_factor_volt[0])
    for column, step in (('rate_rad_s', rate_step), ('specific_force_m_s2', config.accelerometer_scale[0])):
        received, expected = (
            np.array([getattr(item, column) for item in items]) for items in (host.imu(), sent)
        )
        assert received.shape == expected.shape
        assert np.abs(received - expected).max() <= 0.501 * step
    assert np.abs(host.errors_ms(LONG)).max() < 0.1
    counts = host.reader.decoder.counts
    assert (counts.lost, counts.malformed, counts.bad_checksums, counts.repeated) == (0, 0, 0, 0)


@pytest.mark.slow
def test_the_distance_of_the_wheels_is_preserved() -> None:
    host, config = without_faults(), BoardConfig()
    sent = [item for item in LONG if isinstance(item, WheelSample)][1:]  # a sample needs two readings
    received = host.wheels()
    assert len(received) == len(sent)
    for column, error in (
        ('speed_m_s', config.tick_m),
        ('yaw_rate_rad_s', 2.0 * config.tick_m / config.track_m),
    ):
        distances = [
            np.cumsum([getattr(item, column) for item in items]) / 50.0 for items in (received, sent)
        ]
        assert np.abs(distances[0] - distances[1]).max() < 1.5 * error


@pytest.mark.slow
def test_slow_signals_are_recovered() -> None:
    host = without_faults()
    warm = [reading for reading in host.readings if isinstance(reading, TemperatureSample)]
    true_c = [item.temperature_c for item in LONG if isinstance(item, TemperatureSample)]
    assert len(warm) == pytest.approx(40, abs=1)
    assert {round(item.temperature_c, 2) for item in warm} <= {round(value, 2) for value in true_c}
    supply = [reading for reading in host.readings if isinstance(reading, SupplySample)]
    volts = [item.value for item in LONG if isinstance(item, CovariateSample) and 'voltage' in item.name]
    assert len(supply) == pytest.approx(400, abs=1)
    assert {round(item.voltage_v, 3) for item in supply} <= {round(value, 3) for value in volts}


@pytest.mark.slow
@pytest.mark.parametrize('drift_ppm', [-100.0, 30.0])
@pytest.mark.parametrize('start_us', [0, 4_294_967_295 - 20_000_000])
def test_stamps_are_within_a_millisecond_with_jitter(drift_ppm: float, start_us: int) -> None:
    """Check also a wrap of the board's counter."""
    host = Host(emulator(LONG, jitter_s=0.02, oscillator=Oscillator(start_us, drift_ppm))).read()
    errors = host.errors_ms(LONG)
    assert np.abs(errors[200 * 10 :]).max() < 1.0
    assert not host.reader.clock.restarts and not host.reader.clock.outliers


@pytest.mark.slow
def test_jitter_has_the_requested_range() -> None:
    board, late_ms = emulator(LONG, jitter_s=0.02), []
    true_ms = iter((item.t_ns - START_NS) / MS for item in LONG if isinstance(item, ImuSample))
    reader = BoardReader(BoardConfig(), BAUD)
    while (t_ns := board.next_ns()) is not None:
        event = board.pop()
        assert isinstance(event, DataEvent)
        late_ms += [
            t_ns / MS - next(true_ms) for r in reader.feed(event.data, t_ns) if isinstance(r, ImuSample)
        ]
    on_the_wire_ms = 2.7
    assert on_the_wire_ms - 0.1 < min(late_ms) < on_the_wire_ms + 0.1
    assert 20.0 < max(late_ms) < 20.0 + 2.0 * on_the_wire_ms


@pytest.mark.slow
def test_the_same_seed_yields_the_same_events() -> None:
    def sent(seed: int) -> list[DataEvent | PortEvent]:
        board = emulator(SHORT, 'noise@1+3=0.02', 'cut@2+3=0.1', 'unplug@5+1', jitter_s=0.02, seed=seed)
        events = []
        while board.next_ns() is not None:
            events.append(board.pop())
        return events

    first = sent(1)
    assert first == sent(1) != sent(2)
    assert [event.t_ns for event in first] == sorted(event.t_ns for event in first)


def test_a_step_of_the_recorded_clock_is_not_played() -> None:
    step_ns = 3600 * NS_PER_S
    half = len(SHORT) // 2
    stepped = [
        *SHORT[:half],
        ClockStep(SHORT[half].t_ns + step_ns, step_ns),
        *(replace(item, t_ns=item.t_ns + step_ns) for item in SHORT[half:]),  # type: ignore[type-var]
    ]
    assert np.abs(Host(emulator(stepped)).read().errors_ms(SHORT)).max() < 0.1


# --- commands ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_supported_rates_are_sent() -> None:
    host = Host(emulator(LONG)).read(10.0)
    host.send(SetRates(100, 25, 2), 10.0, sequence=7)
    host.readings.clear()
    host.read(20.0)
    assert host.answers() == [Acknowledgement(7, SetRates.TYPE, CommandResult.DONE)]
    supply = [reading for reading in host.readings if isinstance(reading, SupplySample)]
    counts = len(host.imu()), len(host.wheels()), len(supply)
    assert counts == pytest.approx((1000, 250, 20), abs=2)
    assert {round((b.t_ns - a.t_ns) / MS) for a, b in pairwise(host.imu()[1:])} == {10}
    host.send(SetRates(200, 0, 0), 20.0, sequence=8)
    host.readings.clear()
    host.read(30.0)
    assert len(host.imu()) == pytest.approx(2000, abs=2)
    assert len(host.wheels()) <= 1


@pytest.mark.parametrize('rates', [SetRates(400, 50, 10), SetRates(200, 51, 10), SetRates(200, 50, 1000)])
def test_unsupported_rates_change_nothing(rates: SetRates) -> None:
    host = Host(emulator(SHORT)).read(2.0)
    host.send(rates, 2.0)
    host.readings.clear()
    host.read(4.0)
    assert host.answers() == [Acknowledgement(1, SetRates.TYPE, CommandResult.OUT_OF_RANGE)]
    assert len(host.imu()) == pytest.approx(400, abs=2)


def test_the_zero_is_subtracted_and_survives_a_restart() -> None:
    host = Host(emulator(STANDING, 'restart@5+0.5')).read(2.0)
    before = np.mean([sample.rate_rad_s for sample in host.imu()], axis=0)
    host.send(Zero(1000), 2.0, sequence=9)
    host.read(2.9)
    assert not host.answers()
    host.read(4.0)
    assert host.answers() == [Acknowledgement(9, Zero.TYPE, CommandResult.DONE)]
    for until_s in (5.0, 8.0):
        host.readings.clear()
        host.read(until_s)
        after = np.mean([sample.rate_rad_s for sample in host.imu()], axis=0)
        assert np.abs(after).max() < 1e-3 < np.abs(before).max()


def test_a_zero_is_refused_if_a_wheel_turns() -> None:
    host = Host(emulator(SHORT)).read(4.0)
    host.send(Zero(1000), 4.0)
    assert host.read().answers() == [Acknowledgement(1, Zero.TYPE, CommandResult.REFUSED)]


def test_an_unknown_command_is_answered_and_noise_is_not() -> None:
    host = Host(emulator(SHORT)).read(1.0)
    body = bytes((0x99, 5, 0, 0, 0, 0, 0, 42))
    host.board.receive(
        b'noise\0' + cobs_encode(body + checksum(body).to_bytes(2, 'little')) + b'\0', NS_PER_S
    )
    assert host.read(2.0).answers() == [Acknowledgement(5, 0x99, CommandResult.UNKNOWN)]


def test_a_recording_without_a_battery_sends_no_supply() -> None:
    host = Host(emulator(item for item in SHORT if not isinstance(item, CovariateSample))).read(2.0)
    host.send(SetRates(200, 50, 10), 2.0)
    host.read()
    assert not any(isinstance(reading, SupplySample) for reading in host.readings)
    assert [answer.result for answer in host.answers()] == [CommandResult.OUT_OF_RANGE]


# --- faults -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_noise_corrupts_frames_during_its_interval_only() -> None:
    host = Host(emulator(LONG, 'noise@10+10=0.05')).read(10.0)
    assert host.reader.decoder.counts.lost == 0
    corrupted = host.read(20.1).reader.decoder.counts
    assert corrupted.bad_checksums + corrupted.malformed > 1000
    lost = corrupted.lost
    assert 0.6 < lost / 2600 < 0.95  # 5 % of the bytes affect most of the frames
    assert np.abs(host.read().reader.decoder.counts.lost - lost) <= 1
    times = [sample.t_ns for sample in host.imu()]
    assert all(a < b for a, b in pairwise(times))


@pytest.mark.parametrize(('fault', 'bad'), [('cut@2+4=0.1', True), ('drop@2+4=0.1', False)])
def test_frames_are_truncated_and_dropped(fault: str, bad: bool) -> None:
    counts = Host(emulator(SHORT, fault)).read().reader.decoder.counts
    assert 50 < counts.lost < 300
    assert (counts.malformed + counts.bad_checksums > 0) == bad


@pytest.mark.slow
def test_a_pause_delays_frames_and_loses_none() -> None:
    host = Host(emulator(LONG, 'pause@15+3', jitter_s=0.02)).read()
    assert host.reader.decoder.counts.lost == 0
    assert np.abs(host.errors_ms(LONG)[2000:]).max() < 1.0


@pytest.mark.slow
def test_frames_to_an_unplugged_port_are_lost() -> None:
    host = Host(emulator(LONG, 'unplug@15+5', jitter_s=0.02)).read()
    assert host.port_events == [
        PortEvent(15 * NS_PER_S, is_connected=False),
        PortEvent(20 * NS_PER_S, is_connected=True),
    ]
    assert host.reader.decoder.counts.lost == pytest.approx(5 * 260, abs=10)
    times = np.array([sample.t_ns for sample in host.imu()])
    assert (np.diff(times) > 0).all()
    assert ((times - WALL_NS) // NS_PER_S != 17).all()


def test_a_board_restarts_after_a_loss_of_power() -> None:
    host = Host(emulator(LONG, 'restart@15+2')).read(10.0)
    host.send(SetRates(100, 25, 10), 10.0)
    host.read(15.0)
    host.readings.clear()
    host.read(25.0)
    assert host.reader.clock.restarts == {RestartCause.BOARD: 1}
    assert len(host.imu()) == pytest.approx(8 * 200, abs=3)
    times = np.array([sample.t_ns for sample in host.imu()])
    since_ms = (times[-1000:] - WALL_NS) / MS
    assert np.abs((since_ms + 2.5) % 5.0 - 2.5).max() < 0.01


def test_a_board_without_power_receives_nothing() -> None:
    host = Host(emulator(SHORT, 'restart@2+2')).read(3.0)
    host.send(SetRates(100, 25, 10), 3.0)
    host.read()
    assert not host.answers()


def test_a_fault_may_be_added_while_running() -> None:
    host = Host(emulator(SHORT)).read(3.0)
    host.board.add_fault(parse_fault('unplug+1', now_ns=3 * NS_PER_S))
    host.read()
    assert [event.t_ns / NS_PER_S for event in host.port_events] == [3.0, 4.0]
    assert host.reader.decoder.counts.lost == pytest.approx(260, abs=3)


def test_a_wrong_gain_scales_the_rates_for_its_time() -> None:
    right, wrong = without_faults().imu(), Host(emulator(LONG, 'gain@10+20=0.1')).read().imu()
    first, last = 10 * 200 + 2, 30 * 200 - 2  # without the samples at the edges
    before, after = (np.array([sample.rate_rad_s for sample in samples]) for samples in (right, wrong))
    np.testing.assert_allclose(after[first:last], 0.9 * before[first:last], atol=1e-3)
    np.testing.assert_array_equal(after[: first - 4], before[: first - 4])
    np.testing.assert_array_equal(after[last + 4 :], before[last + 4 :])
    assert np.abs(before[first:last, 2]).max() > 0.1


def test_faults_are_parsed() -> None:
    assert parse_fault('noise@120+30=0.05') == Fault(FaultKind.NOISE, 120 * NS_PER_S, 150 * NS_PER_S, 0.05)
    assert parse_fault('pause+1.5\n', now_ns=7) == Fault(FaultKind.PAUSE, 7, 7 + 1_500_000_000)


@pytest.mark.parametrize(
    ('text', 'todo'),
    [
        ('noise', 'write KIND@FROM'),
        ('noise+3=0.1', 'write KIND@FROM'),
        ('nose@1+3=0.1', "did you mean 'noise'"),
        ('noise@1+3', 'write noise@FROM.FOR=SHARE'),
        ('noise@1+3=2', 'a share from 0 to 1'),
        ('unplug@1+3=0.5', 'write unplug@FROM.FOR$'),
        ('unplug@1.2.3+3', '1.2.3 is not a number'),
    ],
)
def test_malformed_faults_are_refused(text: str, todo: str) -> None:
    with pytest.raises(GyrocalError, match=todo):
        parse_fault(text)


# --- the program ------------------------------------------------------------------------------------


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'gyrocal_ros.cli.board_emulator', *arguments]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--scenario', 'cleanin'], "did you mean 'cleaning'"),
        (['--jitter', '2'], 'give 0 to 1 s'),
        (['--fault', 'noise@1+1'], 'write noise@FROM+FOR=SHARE'),
        (['--bag', 'nowhere'], 'nowhere'),
        (['--link', __file__], 'is not a symbolic link'),
    ],
)
def test_invalid_arguments_are_refused_in_one_line(arguments: list[str], words: str) -> None:
    result = run(*arguments)
    assert result.returncode == 2 and not result.stdout
    assert result.stderr.startswith('board_emulator: error: ') and result.stderr.count('\n') == 1
    assert words in result.stderr


@pytest.mark.slow
def test_the_program_ends_and_removes_its_port(tmp_path: Path) -> None:
    link = tmp_path / 'board'
    result = run(
        '--link', str(link), '--duration', '1', '--fault', 'unplug@0.2+0.2', '--ros-args', '-r', 'a:=b'
    )
    assert (result.returncode, result.stdout) == (0, f'{link}\n')
    assert 'unplugged' in result.stderr and 'plugged in at /dev/' in result.stderr
    assert not link.is_symlink()


@pytest.mark.slow
def test_the_interrupted_program_removes_its_port(tmp_path: Path) -> None:
    link = tmp_path / 'board'
    board = BoardProgram(link)
    assert link.is_symlink()
    assert board.stop() == 0
    assert not link.is_symlink()


@pytest.mark.slow
def test_a_recorded_bag_is_played(tmp_path: Path) -> None:
    with BoardProgram(tmp_path / 'board', '--bag', str(BAG)), Link(str(tmp_path / 'board'), BAUD) as link:
        reader, found = BoardReader(BoardConfig(), BAUD), list[Reading]()
        while len(found) < 200:
            found += reader.feed(link.read(), time.time_ns())
    kinds = {type(reading) for reading in found}
    assert {ImuSample, WheelMotion, TemperatureSample, SupplySample} <= kinds


@pytest.mark.slow
def test_the_program_does_not_import_ros() -> None:
    code = 'import gyrocal_ros.cli.board_emulator, sys; print([m for m in sys.modules if "rclpy" in m])'
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert result.stdout == '[]\n'


@pytest.mark.slow
def test_a_late_start_skips_missed_events(tmp_path: Path) -> None:
    """A play that started in the past continues at the present time."""
    start_s = time.time() - 10.0
    with (
        BoardProgram(tmp_path / 'board', '--start-at', str(start_s)),
        Link(str(tmp_path / 'board'), BAUD) as link,
    ):
        reader, found = BoardReader(BoardConfig(), BAUD), list[Reading]()
        while not (samples := [reading for reading in found if isinstance(reading, ImuSample)]):
            found += reader.feed(link.read(), time.time_ns())
    since_s = samples[0].t_ns / NS_PER_S - start_s
    assert since_s > 10.0


# --- the protocol page ------------------------------------------------------------------------------


def test_the_page_has_every_fault() -> None:
    rows = dict(re.findall(r'^\| `(\w+)` \| `(.*?)` \|', PAGE, flags=re.MULTILINE))
    assert rows.keys() == set(FaultKind)
    for kind, example in rows.items():
        assert parse_fault(example).kind == kind
        assert f'| `{example}` | {FAULT_DESCRIPTIONS[FaultKind(kind)]} |' in PAGE


def test_the_commands_of_the_page_can_be_parsed() -> None:
    [commands] = re.findall(r'^```sh\n(.*?)^```', PAGE, flags=re.MULTILINE | re.DOTALL)
    lines = [shlex.split(line, comments=True) for line in commands.splitlines()]
    for program, *arguments in lines:
        if program == board_emulator.PROGRAM:
            make_parser(program, board_emulator).parse_args(arguments)
    assert board_emulator.PROGRAM in {line[0] for line in lines}


@pytest.mark.slow
def test_the_reader_of_the_page_reads_the_emulator(tmp_path: Path) -> None:
    [code] = re.findall(r'^```python\n(.*?)^```', PAGE, flags=re.MULTILINE | re.DOTALL)
    port = tmp_path / 'board'
    with BoardProgram(port, '--scenario', 'standing') as board:
        reading = subprocess.Popen([sys.executable, '-c', code, str(port)], stdout=subprocess.PIPE, text=True)
        assert reading.stdout is not None
        while 'Acknowledgement(' not in reading.stdout.readline():
            pass
        board.inject_fault('pause+10')
        output, _ = reading.communicate(timeout=60)
    assert 'lost=0' in output.splitlines()[-1]
