"""Measurements as they arrive become measurements in the order of their stamps."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence

from gyrocal_ros.data import NS_PER_S, ClockStep, ImuSample, Measurement, nanoseconds, seconds
from gyrocal_ros.ekf.motion import GAP_NS
from gyrocal_ros.msgs.reorder import Reorderer
from gyrocal_ros.msgs.topics import Role

STEP_S = 0.5
"""A lasting jump of the stamps against a steady clock, above which the clock has stepped."""
MAX_SILENCE_NS = NS_PER_S
"""How long the others are kept for an IMU that says nothing. After more the robot may have turned anywhere,
and a tracker that foresaw no turns may have lost its features: pose and map are begun anew."""
MAX_WAITING = 10_000
"""So many measurements wait at most, some 30 seconds of them; the oldest go first."""


class InputQueue:
    """Sorts what arrives, and keeps its memory bounded whatever stays away.

    Args:
        window_s: how late a message may come.
        clock_step_s: how large a jump of the stamps makes a step of the clock.
        punctual: numbers of the topics of which each comes in its order; what all of them have passed
            waits no longer.
    """

    def __init__(self, window_s: float, clock_step_s: float, punctual: Collection[int]) -> None:
        self.waiting: deque[Measurement] = deque(maxlen=MAX_WAITING)
        """In order, to be taken from the left."""
        self.useless: Counter[int] = Counter()
        """How many of each stream nothing could be done with, for want of an IMU."""
        self.events: list[str] = []
        """What happened that a person should know; the reader clears it."""
        self._order = Reorderer[tuple[int, Sequence[Measurement]]](
            nanoseconds(window_s), nanoseconds(clock_step_s), punctual
        )
        self._imu_ns: int | None = None
        self._imu_has_come = False

    @property
    def left_out(self) -> Counter[int]:
        """How many messages of each stream were late, repeated or oddly stamped."""
        counts: Counter[int] = Counter()
        for (_, stream), count in self._order.drops.items():
            counts[stream] += count
        return counts

    def push(self, stream: int, samples: Sequence[Measurement], arrival_ns: int) -> None:
        """Take in what was measured at one moment.

        Args:
            stream: number of its topic; of measurements of one moment, those of the lower come first.
            samples: one or several.
            arrival_ns: when they came, by a clock that never steps; always 0 where nobody knows.
        """
        for item in self._order.push(samples[0].t_ns, stream, (stream, samples), arrival_ns):
            self._hand_on(item)

    def finish(self) -> None:
        """Hand on what is held back for those that are late."""
        for item in self._order.finish():
            self._hand_on(item)

    def _hand_on(self, item: tuple[int, Sequence[Measurement]] | ClockStep) -> None:
        if isinstance(item, ClockStep):
            self.events.append(
                f'the clock jumped by {seconds(item.step_ns):+.1f} s; the calibration is kept, pose and map '
                'are begun anew'
            )
            self._imu_ns = item.t_ns
            self.waiting.append(item)
            return
        stream, samples = item
        self.waiting.extend(self._kept(stream, samples))

    def _kept(self, stream: int, samples: Sequence[Measurement]) -> Iterator[Measurement]:
        """What of it is of use: nothing where the IMU has been silent for long."""
        t_ns = samples[0].t_ns
        if self._imu_ns is None:
            self._imu_ns = t_ns
        silent_ns = t_ns - self._imu_ns
        if isinstance(samples[0], ImuSample):
            self._imu_ns = t_ns
            if silent_ns > GAP_NS and self._imu_has_come:
                self.events.append(f'{Role.IMU}: there was a gap of {seconds(silent_ns):.1f} s')
            if silent_ns > MAX_SILENCE_NS:
                yield ClockStep(t_ns, 0)
            self._imu_has_come = True
        elif silent_ns > MAX_SILENCE_NS:
            self.useless[stream] += 1
            return
        yield from samples
