"""The board on the robot: a thread reads the serial line, and opens the port again whenever it was lost."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace

from gyrocal_ros.board.clock import RestartCause
from gyrocal_ros.board.commands import CommandQueue, PendingCommand
from gyrocal_ros.board.link import Link, LinkError
from gyrocal_ros.board.messages import Acknowledgement, CommandResult, Imu, SetRates, Supply, Wheels
from gyrocal_ros.board.reader import BoardReader, Reading
from gyrocal_ros.config.board_limits import BoardLimits
from gyrocal_ros.config.robot_sections import BoardConfig, DriverConfig
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.robot.health import Level, Problem, Status, Window, as_warnings, status

RETRY_S = 0.5
"""Time from the loss of the port, or from the last attempt, to the next attempt to open it."""
ZERO_MS = 2000
"""Time over which the board averages its gyros to measure their zero."""
ZERO_TIMEOUT_S = 6.0
"""Timeout of the answer to it, repetitions included."""

RECENT_S = 5.0
"""Length of the window of recent counts of the board."""
SILENT_S = 1.0
"""Time without data after which the board counts as silent."""
MAX_STRAY = 3
"""Maximum number of corrupted frames before the first valid one on a healthy line."""
MAX_CORRUPTED = 0.5
"""Largest share of corrupted frames that is a warning; more are an error."""
MIN_RATE = 0.9
"""Smallest received share of a requested rate that is normal."""
MAX_TRIES = 4
"""Number of transmissions after which a command counts as unanswered."""


class BoardError(GyrocalError):
    """The board has not executed a command."""


@dataclass(frozen=True, slots=True)
class PortState:
    """State of the serial port."""

    is_open: bool
    since_s: float
    """Time of the last change, by a monotonic clock."""
    why: str = ''
    """Reason for a closed port, and the remedy."""


class BoardDriver:
    """Reads a board until it is closed.

    Args:
        board: scale of the raw values of each converter.
        driver: the serial line, and the rates to request.
        now_ns: clock of the stamps.
        publish: called with each reading, in the thread of the driver.
        limits: largest readings; None for the default ones.
    """

    def __init__(
        self,
        board: BoardConfig,
        driver: DriverConfig,
        now_ns: Callable[[], int],
        publish: Callable[[Reading], None],
        limits: BoardLimits | None = None,
    ) -> None:
        self._driver, self._now_ns, self._publish = driver, now_ns, publish
        self._changed = threading.Condition()
        """Guards all attributes below; notified when the board has answered a command."""
        self._reader = BoardReader(board, driver.baud_rate, limits)
        self._commands = CommandQueue(rates_of(driver))
        self._connections = 0
        self._port = PortState(is_open=False, since_s=time.monotonic(), why='not tried yet')
        self._data_s = 0.0
        self._health = BoardHealth(self._counts(), time.monotonic())
        self._unpublished, self._why_unpublished = 0, ''
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name='board', daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and close the port."""
        self._closing.set()
        self._thread.join()

    def set_rates(self, driver: DriverConfig) -> None:
        """Request other rates from the board."""
        with self._changed:
            if rates_of(driver) != self._commands.rates.command:
                self._commands.request_rates(rates_of(driver))

    def zero(self) -> None:
        """Let the board measure the zero of its gyros; wait for its answer.

        Raises:
            BoardError: the board has not done so.
        """
        with self._changed:
            if not self._port.is_open:
                raise BoardError(f'not connected: {self._port.why}')
            order = self._commands.request_zero(ZERO_MS)
            self._changed.wait_for(lambda: order.result is not None, ZERO_TIMEOUT_S)
            self._commands.cancel_zero()
        if order.result is None:
            raise BoardError('the board does not answer', todo='see /diagnostics')
        if order.result == CommandResult.REFUSED:
            raise BoardError('the board refuses', todo='keep the robot at rest')
        if order.result != CommandResult.DONE:
            raise BoardError('the firmware of the board has no command for the zero', todo='update it')

    def status(self) -> Status:
        """Return the health of board and serial line; to be called about once a second."""
        if self._thread.ident and not self._thread.is_alive():
            text = 'the thread of the driver has ended with an error: see the log'
            return status('', [Problem(Level.ERROR, text)], {})
        with self._changed:
            health = self._health.status(
                self._counts(), self._port, self._data_s, self._commands.rates, time.monotonic()
            )
            drift_ppm = round(1e6 * self._reader.clock.drift, 1)
        numbers = {'port': self._driver.port, **health.numbers, 'clock_drift_ppm': drift_ppm}
        if self._unpublished:
            numbers['unpublished'] = self._unpublished
            text = f'{self._unpublished} readings could not be published: {self._why_unpublished}'
            return status(health.message, [*health.problems, Problem(Level.ERROR, text)], numbers)
        return replace(health, numbers=numbers)

    def add_unpublished(self, _: str, why: str) -> None:
        """Count a reading that could not be published."""
        self._unpublished, self._why_unpublished = self._unpublished + 1, why

    def _counts(self) -> Counter[str]:
        """Return all counts since the start, by the names that /diagnostics gives them."""
        received, clock = self._reader.received, self._reader.clock
        return Counter(
            bytes=self._reader.bytes,
            imu=received[Imu],
            wheels=received[Wheels],
            supply=received[Supply],
            board_restarts=clock.restarts[RestartCause.BOARD],
            clock_sets=clock.restarts[RestartCause.ARRIVALS],
            odd_times=clock.outliers,
            implausible=self._reader.implausible,
            connections=self._connections,
            **asdict(self._reader.decoder.counts),
        )

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                with Link(self._driver.port, self._driver.baud_rate) as link:
                    self._on_open()
                    while not self._closing.is_set():
                        self._transfer(link)
            except LinkError as error:
                self._on_lost(str(error))
                self._closing.wait(RETRY_S)

    def _on_open(self) -> None:
        now_s = time.monotonic()
        with self._changed:
            self._connections += 1
            self._port = PortState(is_open=True, since_s=now_s)
            self._reader.skip_partial_frame()
            self._commands.resend_rates()

    def _on_lost(self, why: str) -> None:
        now_s = time.monotonic()
        with self._changed:
            since_s = now_s if self._port.is_open else self._port.since_s
            self._port = PortState(is_open=False, since_s=since_s, why=why)

    def _transfer(self, link: Link) -> None:
        """Read once, and send the commands that are due."""
        data = link.read()
        arrival_ns, now_s = self._now_ns(), time.monotonic()
        with self._changed:
            readings = self._decode(data, arrival_ns, now_s) if data else []
            commands = self._commands.due_frames(now_s)
        if commands:
            link.write(commands)
        for reading in readings:
            self._publish(reading)

    def _decode(self, data: bytes, arrival_ns: int, now_s: float) -> list[Reading]:
        restarts = self._restarts()
        readings = self._reader.feed(data, arrival_ns)
        if self._restarts() != restarts:
            self._commands.resend_rates()
        for reading in readings:
            if isinstance(reading, Acknowledgement):
                self._commands.acknowledge(reading)
                self._changed.notify_all()
        self._data_s = now_s
        return readings

    def _restarts(self) -> int:
        """Return the number of apparent restarts of the board, each of which resets its rates."""
        return self._reader.clock.restarts[RestartCause.BOARD] + self._reader.decoder.counts.sequence_restarts


def rates_of(driver: DriverConfig) -> SetRates:
    """Return the rates that the settings request."""
    return SetRates(driver.imu_hz, driver.wheels_hz, driver.supply_hz)


class BoardHealth:
    """Judges the board and the serial line by growing counts.

    Args:
        counts: counts since the start: messages `imu`, `wheels` and `supply`, `board_restarts`,
            `clock_sets`, `odd_times`, `implausible`, and the frames as in `board.protocol.Counts`.
        now_s: the present time, by a monotonic clock.
    """

    def __init__(self, counts: Counter[str], now_s: float) -> None:
        self._window = Window(RECENT_S, now_s, counts)
        self._requested: SetRates | None = None
        self._requested_s = now_s

    def status(
        self,
        counts: Counter[str],
        port: PortState,
        data_s: float,
        order: PendingCommand[SetRates],
        now_s: float,
    ) -> Status:
        """Return the present health; to be called about once a second.

        Args:
            counts: counts since the start.
            port: state of the port.
            data_s: time of the last data.
            order: the requested rates, and the answer of the board.
            now_s: the present time.
        """
        recent, passed_s = self._window.add(counts, now_s)
        if order.command != self._requested:
            self._requested, self._requested_s = order.command, now_s
        steady_s = now_s - max(port.since_s, self._requested_s)
        is_steady = steady_s > passed_s and not recent['board_restarts']
        rates = [
            ('IMU', recent['imu'] / passed_s, order.command.imu),
            ('wheels', recent['wheels'] / passed_s, order.command.wheels),
            ('supply', recent['supply'] / passed_s, order.command.supply),
        ]
        problems = [*_line_problems(recent, port, data_s, now_s)] or [
            *_frame_problems(recent),
            *as_warnings(_content_texts(recent)),
            *as_warnings(_rate_texts(recent, rates, order, is_steady=is_steady)),
        ]
        summary = ', '.join(f'{name} {hz:.0f} Hz' for name, hz, _ in rates)
        numbers = {f'{name.lower()}_hz': round(hz, 1) for name, hz, _ in rates}
        return status(summary, problems, {**numbers, **counts})


def _corrupted(recent: Counter[str]) -> int:
    return recent['malformed'] + recent['bad_checksums']


def _line_problems(recent: Counter[str], port: PortState, data_s: float, now_s: float) -> Iterator[Problem]:
    """Yield the problem that leaves no data at all."""
    silent_s = now_s - max(port.since_s, data_s)
    if not port.is_open:
        yield Problem(Level.ERROR, f'not connected for {now_s - port.since_s:.0f} s: {port.why}')
    elif silent_s > SILENT_S:
        text = f'no data from the board for {silent_s:.0f} s: check its power supply and its firmware'
        yield Problem(Level.ERROR, text)
    elif _corrupted(recent) > MAX_STRAY and not recent['packets']:
        text = 'the received data are not from the board: check driver.port and driver.baud_rate'
        yield Problem(Level.ERROR, text)


def _frame_problems(recent: Counter[str]) -> Iterator[Problem]:
    corrupted = _corrupted(recent)
    if corrupted:
        share = corrupted / (corrupted + recent['packets'])
        yield Problem(
            Level.ERROR if share > MAX_CORRUPTED else Level.WARN,
            f'{share:.0%} of the frames are corrupted ({corrupted} recently): check cable and ground',
        )
    lost = recent['lost'] - corrupted  # the sequence numbers miss a corrupted frame, too
    if lost > 0:
        yield Problem(Level.WARN, f'{lost} frames were lost recently')
    if recent['unknown']:
        text = f'{recent["unknown"]} messages of unknown types recently: the firmware of the board is newer'
        yield Problem(Level.WARN, text)


def _content_texts(recent: Counter[str]) -> Iterator[str]:
    if recent['board_restarts']:
        yield 'the board has restarted: check its power supply'
    elif recent['odd_times']:
        yield f'{recent["odd_times"]} messages with inconsistent board times were dropped'
    if recent['implausible']:
        yield f'{recent["implausible"]} packets beyond board_limits were dropped'
    if recent['clock_sets']:
        yield "this computer's clock was set: the stamps follow it"


def _rate_texts(
    recent: Counter[str],
    rates: list[tuple[str, float, int]],
    order: PendingCommand[SetRates],
    *,
    is_steady: bool,
) -> Iterator[str]:
    """Yield what is wrong with the rates: name, received and requested rate of each message."""
    requested = order.command
    if order.result is None and order.attempts >= MAX_TRIES:
        yield 'the board does not answer commands'
    elif order.result not in (None, CommandResult.DONE):
        yield (
            f'the board cannot send {requested.imu} IMU, {requested.wheels} wheel and {requested.supply} '
            'supply messages a second: set driver.imu_hz, driver.wheels_hz and driver.supply_hz'
        )
    elif is_steady and not _corrupted(recent) and not recent['lost']:
        for name, hz, requested_hz in rates:
            if hz < MIN_RATE * requested_hz:
                yield f'{name} {hz:.0f} Hz, not the requested {requested_hz}'
