"""The board on the robot: a thread reads the line, and opens it again whenever it was lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from gyrocal_ros.board.clock import RestartCause
from gyrocal_ros.board.commands import CommandQueue
from gyrocal_ros.board.link import Link, LinkError
from gyrocal_ros.board.messages import Acknowledgement, CommandResult, SetRates
from gyrocal_ros.board.reader import BoardReader, Reading
from gyrocal_ros.config.sections import BoardConfig, DriverConfig
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.robot.board_health import BoardHealth, PortState, tally
from gyrocal_ros.robot.health import Complaint, Level, Status, status

RETRY_S = 0.5
"""How long after its loss, or after the last attempt, the port is tried again."""
ZERO_MS = 2000
"""How long the gyros are averaged for their zero."""
ZERO_LIMIT_S = 6.0
"""How long to wait for it, repetitions included."""


class BoardError(GyrocalError):
    """The board has not done what it was told to."""


class BoardDriver:
    """Reads a board until it is closed.

    Args:
        board: what one count of each converter means.
        driver: the line, and the rates to ask for.
        now_ns: the clock that the stamps are to follow.
        hand_on: gets every reading, in a thread of its own.
    """

    def __init__(
        self,
        board: BoardConfig,
        driver: DriverConfig,
        now_ns: Callable[[], int],
        hand_on: Callable[[Reading], None],
    ) -> None:
        self._driver, self._now_ns, self._hand_on = driver, now_ns, hand_on
        self._changed = threading.Condition()
        """Guards all that follows; notified when the board has answered."""
        self._reader = BoardReader(board, driver.baud_rate)
        self._commands = CommandQueue(rates_of(driver))
        self._connections = 0
        self._line = PortState(is_open=False, since_s=time.monotonic(), why='not tried yet')
        self._heard_s = 0.0
        self._health = BoardHealth(tally(self._reader, 0, time.monotonic()))
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name='board', daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self) -> None:
        """End it, and let go of the port."""
        self._ending.set()
        self._thread.join()

    def set_rates(self, driver: DriverConfig) -> None:
        """Ask the board for other rates."""
        with self._changed:
            if rates_of(driver) != self._commands.rates.command:
                self._commands.request_rates(rates_of(driver))

    def zero(self) -> None:
        """Let the board measure the zero of its gyros; wait for its answer.

        Raises:
            BoardError: it has not done so.
        """
        with self._changed:
            if not self._line.is_open:
                raise BoardError(f'not connected: {self._line.why}')
            order = self._commands.request_zero(ZERO_MS)
            self._changed.wait_for(lambda: order.result is not None, ZERO_LIMIT_S)
            self._commands.cancel_zero()
        if order.result is None:
            raise BoardError('the board does not answer', todo='see /diagnostics')
        if order.result == CommandResult.REFUSED:
            raise BoardError('the board refuses', todo='let the robot stand still')
        if order.result != CommandResult.DONE:
            raise BoardError("the board's program knows no zero", todo='update it')

    def tell(self) -> Status:
        """How the board and the line are; to be asked once a second."""
        if self._thread.ident and not self._thread.is_alive():
            return status('', [Complaint(Level.ERROR, 'reading has ended by an error: see the log')], {})
        with self._changed:
            now = tally(self._reader, self._connections, time.monotonic())
            told = self._health.tell(now, self._line, self._heard_s, self._commands.rates)
            drift_ppm = round(1e6 * self._reader.clock.drift, 1)
        return replace(
            told, numbers={'port': self._driver.port, **told.numbers, 'clock_drift_ppm': drift_ppm}
        )

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                with Link(self._driver.port, self._driver.baud_rate) as link:
                    self._opened()
                    while not self._ending.is_set():
                        self._serve(link)
            except LinkError as error:
                self._lost(str(error))
                self._ending.wait(RETRY_S)

    def _opened(self) -> None:
        now_s = time.monotonic()
        with self._changed:
            self._connections += 1
            self._line = PortState(is_open=True, since_s=now_s)
            self._reader.skip_partial_frame()
            self._commands.resend_rates()

    def _lost(self, why: str) -> None:
        now_s = time.monotonic()
        with self._changed:
            since_s = now_s if self._line.is_open else self._line.since_s
            self._line = PortState(is_open=False, since_s=since_s, why=why)

    def _serve(self, link: Link) -> None:
        """Read once, and send what there is to send."""
        data = link.read()
        arrival_ns, now_s = self._now_ns(), time.monotonic()
        with self._changed:
            readings = self._take(data, arrival_ns, now_s) if data else []
            commands = self._commands.due_frames(now_s)
        if commands:
            link.write(commands)
        for reading in readings:
            self._hand_on(reading)

    def _take(self, data: bytes, arrival_ns: int, now_s: float) -> list[Reading]:
        starts = self._starts()
        readings = self._reader.feed(data, arrival_ns)
        if self._starts() != starts:
            self._commands.resend_rates()
        for reading in readings:
            if isinstance(reading, Acknowledgement):
                self._commands.acknowledge(reading)
                self._changed.notify_all()
        self._heard_s = now_s
        return readings

    def _starts(self) -> int:
        """How often the board seems to have been started anew, with its usual rates."""
        return self._reader.clock.restarts[RestartCause.BOARD] + self._reader.decoder.counts.sequence_restarts


def rates_of(driver: DriverConfig) -> SetRates:
    """The rates that the settings ask for."""
    return SetRates(driver.imu_hz, driver.wheels_hz, driver.supply_hz)
