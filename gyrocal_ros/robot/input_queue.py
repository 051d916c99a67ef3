"""Sorts measurements by stamp as they arrive, with a bounded memory."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence

from gyrocal_ros.data import NS_PER_S, ClockStep, ImuSample, Measurement, nanoseconds, seconds
from gyrocal_ros.ekf.motion import GAP_NS
from gyrocal_ros.msgs.reorder import Reorderer
from gyrocal_ros.msgs.topics import Role

STEP_S = 0.5
"""Smallest lasting jump of the stamps against a steady clock that counts as a step of their clock."""
MAX_SILENCE_NS = NS_PER_S
"""Longest silence of the IMU during which other measurements are kept. In a longer one the robot may have
turned by any angle, and a tracker without predicted turns may have lost its features: pose and map are
restarted."""
MAX_WAITING = 10_000
"""Queue limit, about 30 s of measurements; the oldest are dropped first."""


class InputQueue:
    """Sorts measurements by stamp; bounded whichever sensor is silent.

    Args:
        window_s: largest delay of a message.
        clock_step_s: smallest jump of the stamps that counts as a step of the clock.
        ordered: numbers of the streams that arrive in the order of their stamps. A measurement is
            released once all of these have passed its stamp.
    """

    def __init__(self, window_s: float, clock_step_s: float, ordered: Collection[int]) -> None:
        self.waiting: deque[Measurement] = deque(maxlen=MAX_WAITING)
        """Sorted measurements, the oldest on the left."""
        self.without_imu: Counter[int] = Counter()
        """Number of messages of each stream dropped because the IMU was silent."""
        self.events: list[str] = []
        """Events for the user; the reader clears the list."""
        self._reorderer = Reorderer[tuple[int, Sequence[Measurement]]](
            nanoseconds(window_s), nanoseconds(clock_step_s), ordered
        )
        self._imu_ns: int | None = None
        """Stamp of the last IMU sample; before the first, of the first measurement or clock step."""
        self._has_imu = False

    @property
    def dropped(self) -> Counter[int]:
        """Number of messages of each stream that were late, repeated or inconsistently stamped."""
        counts: Counter[int] = Counter()
        for (_, stream), count in self._reorderer.drops.items():
            counts[stream] += count
        return counts

    def push(self, stream: int, samples: Sequence[Measurement], arrival_ns: int) -> None:
        """Add the measurements of one message.

        Args:
            stream: number of the topic; at equal stamps, the lower number comes first.
            samples: one or several, of one moment.
            arrival_ns: time of arrival by a clock that never steps; always 0 where there is none.
        """
        for item in self._reorderer.push(samples[0].t_ns, stream, (stream, samples), arrival_ns):
            self._release(item)

    def finish(self) -> None:
        """Release what is held back for late messages."""
        for item in self._reorderer.finish():
            self._release(item)

    def _release(self, item: tuple[int, Sequence[Measurement]] | ClockStep) -> None:
        if isinstance(item, ClockStep):
            self.events.append(
                f'the clock jumped by {seconds(item.step_ns):+.1f} s; the calibration is kept, pose and map '
                'are restarted'
            )
            self._imu_ns = item.t_ns
            self.waiting.append(item)
            return
        stream, samples = item
        self.waiting.extend(self._usable(stream, samples))

    def _usable(self, stream: int, samples: Sequence[Measurement]) -> Iterator[Measurement]:
        """Yield the measurements that the filter can use: none while the IMU is silent for long."""
        t_ns = samples[0].t_ns
        if self._imu_ns is None:
            self._imu_ns = t_ns
        silent_ns = t_ns - self._imu_ns
        if isinstance(samples[0], ImuSample):
            self._imu_ns = t_ns
            if silent_ns > GAP_NS and self._has_imu:
                self.events.append(f'{Role.IMU}: gap of {seconds(silent_ns):.1f} s')
            if silent_ns > MAX_SILENCE_NS:
                yield ClockStep(t_ns, 0)
            self._has_imu = True
        elif silent_ns > MAX_SILENCE_NS:
            self.without_imu[stream] += 1
            return
        yield from samples
