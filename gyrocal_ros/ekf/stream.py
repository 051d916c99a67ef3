"""Converts a stream of measurements to the blocks and images that the filter takes.

IMU and wheel samples are buffered. Whenever the camera (or another heading reference) measures, the block up
to that moment is cut; without it, a block ends after `MAX_BLOCK_NS`.
"""

from __future__ import annotations

from collections import deque

from gyrocal_ros.data import (
    ClockStep,
    CovariateSample,
    FeatureObservations,
    HeadingSample,
    ImuSample,
    Measurement,
    MotionBlock,
    TemperatureSample,
    TruthSample,
    WheelSample,
    changed,
    nanoseconds,
)
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.slam import EkfSlam, Seen

MAX_BLOCK_NS = 250_000_000
"""Maximum length of a block that is predicted at once, where the camera is slow or covered."""
BLIND_NS = 2_000_000_000
"""Time without gyro and without images that is not predicted over: the robot may be anywhere after it."""


class Synchroniser:
    """Buffers measurements and cuts them into blocks, each with the image or heading at its end.

    Args:
        running_s: time for which the gyro has been running at the first sample.
    """

    def __init__(self, running_s: float = 0.0) -> None:
        self.buffer = MotionBuffer(running_s)
        self._waiting: deque[Seen] = deque()
        self._needed_ns = 0
        """Time up to which samples are needed before the first one that waits is of use."""
        self._next: tuple[int, Seen] | None = None

    def add(self, measurement: Measurement, filter_ns: int) -> bool:
        """Take one measurement; return True if a block may have become available.

        Args:
            measurement: any sample.
            filter_ns: time of the filter.
        """
        match measurement:
            case ImuSample() | WheelSample() | TemperatureSample() | CovariateSample():
                self.buffer.add(measurement)
                # Most samples: nothing to do until the next image, or until samples have reached it.
                is_reached = bool(self._waiting) and self.buffer.may_cover(self._needed_ns)
                return is_reached or measurement.t_ns - filter_ns > MAX_BLOCK_NS
            case TruthSample():
                return False
            case FeatureObservations() | HeadingSample():
                self._needed_ns = self._needed_ns if self._waiting else 0
                self._waiting.append(measurement)
                return True
            case _:
                raise TypeError(f'{type(measurement).__name__} is not for the filter')

    def covered_ns(self) -> int | None:
        """Return the time up to which blocks can be cut; None before the first IMU sample."""
        return self.buffer.covered_until_ns()

    def last_seen_ns(self, offset_s: float) -> int | None:
        """Return the true time of the last image in the queue; None without one."""
        return _true_time_ns(self._waiting[-1], offset_s) if self._waiting else None

    def blind_until_ns(self, start_ns: int, offset_s: float) -> int | None:
        """Return the end of a time without gyro and images that begins at a time; None where it is short.

        Args:
            start_ns: time of the filter.
            offset_s: stamp minus true time of the images.
        """
        end_ns = self.buffer.pause_end_ns(start_ns)
        if end_ns is None:
            return None
        if self._waiting:
            end_ns = min(end_ns, _true_time_ns(self._waiting[0], offset_s))
        return end_ns if end_ns - start_ns > BLIND_NS else None

    def next_block(
        self, start_ns: int, until_ns: int, offset_s: float
    ) -> tuple[MotionBlock, Seen | None] | None:
        """Cut the next block; return None where more measurements are needed.

        Args:
            start_ns: time of the filter.
            until_ns: time up to which blocks can be cut.
            offset_s: stamp minus true time of the images.
        """
        while True:
            if self._next is None and self._waiting:
                moment_ns = _true_time_ns(self._waiting[0], offset_s)
                self._needed_ns = moment_ns
                if moment_ns <= until_ns:
                    self._next, self._needed_ns = (moment_ns, self._waiting.popleft()), 0
            # An image that is stamped late may still come from before the latest sample.
            end_ns = until_ns - max(nanoseconds(offset_s), 0) if self._next is None else self._next[0]
            if end_ns - start_ns > MAX_BLOCK_NS:
                return self.buffer.cut(start_ns, start_ns + MAX_BLOCK_NS), None
            if self._next is None:
                return None
            _, seen = self._next
            self._next = None
            if end_ns > start_ns:
                return self.buffer.cut(start_ns, end_ns), seen

    def restart(self, running_s: float) -> None:
        """Drop all queued measurements and buffer samples of a new time base."""
        self.buffer = MotionBuffer(running_s)
        self._waiting.clear()
        self._next = None


class SlamStream:
    """The filter as a consumer of measurements, one at a time, in the order of their stamps.

    Args:
        slam: the filter.
        running_s: time for which the gyro has been running at the first sample.
    """

    def __init__(self, slam: EkfSlam, running_s: float = 0.0) -> None:
        self.slam = slam
        self.has_started = False
        self._sync = Synchroniser(running_s)

    @property
    def running_s(self) -> float:
        """Time for which the gyro has been running, at the state of the filter."""
        return self._sync.buffer.running_s(self.slam.state.t_ns)

    def step(self, measurement: Measurement) -> list[StepRecord]:
        """Take one measurement; return the steps that have become possible (often none).

        Raises:
            FilterDivergedError: the measurements contradict the estimate beyond repair.
        """
        if isinstance(measurement, ClockStep):
            return self._start_new_time_base(measurement)
        if not self._sync.add(measurement, self.slam.state.t_ns):
            return []
        return self._run(self._sync.covered_ns())

    def finish(self) -> list[StepRecord]:
        """Use the images in the queue at the end of the stream, but none long after the gyro."""
        covered_ns, last_ns = self._sync.covered_ns(), self._sync.last_seen_ns(self.slam.time_offset_s())
        if covered_ns is None or last_ns is None:
            return []
        return self._run(min(last_ns, covered_ns + MAX_BLOCK_NS))

    def _run(self, until_ns: int | None) -> list[StepRecord]:
        records: list[StepRecord] = []
        start_ns = self._sync.buffer.start_ns
        if until_ns is None or start_ns is None:
            return records
        if not self.has_started:
            self.slam.start_at(start_ns)
            self.has_started = True
        while True:
            now_ns, offset_s = self.slam.state.t_ns, self.slam.time_offset_s()
            if blind_until_ns := self._sync.blind_until_ns(now_ns, offset_s):
                self.slam.skip_to(blind_until_ns)
            elif item := self._sync.next_block(now_ns, until_ns, offset_s):
                records.append(_with_event(self.slam.step(*item), self._sync.buffer.faulty_gyro.news()))
            else:
                return records

    def _start_new_time_base(self, step: ClockStep) -> list[StepRecord]:
        records = self.finish()
        self._sync.restart(self.running_s)
        self.slam.start_new_time_base(step.t_ns)
        self.has_started = False
        return records


def _with_event(record: StepRecord, event: str) -> StepRecord:
    """Return a record with one event more, where there is one."""
    return changed(record, event='; '.join(filter(None, (record.event, event)))) if event else record


def _true_time_ns(seen: Seen, offset_s: float) -> int:
    """Return the stamp, corrected by the time offset."""
    return seen.t_ns - nanoseconds(offset_s)
