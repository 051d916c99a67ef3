"""Health of what runs on the robot: silences, counts and events become problems, each with its remedy.

Shared by all nodes: `Status`, `Window`, `HealthLog`. Here too are the problems of what calibrator and tracker
receive; those of the board are in `board_driver`, those of the estimate in `estimator`. A node asks for its
status once a second and publishes it on `/diagnostics`. Times are by a monotonic clock.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from gyrocal_ros.data import FeatureObservations, Frame, seconds
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.vision.dirty_lens import LIFETIME_S, MANY_MARKS, MANY_MARKS_TEXT

RECENT_S = 10.0
"""Length of the window of recent counts and events."""
MAX_EVENTS = 20
"""Maximum number of events kept."""
RECEIVED, UNUSABLE, DROPPED, WITHOUT_IMU = 'received', 'of_no_use', 'left_out', 'without_imu'
"""Names of counters, each followed by a topic. All but the first are keys of /diagnostics."""
SEEN = 'features seen'
"""Pseudo-topic of a `HealthLog` for images in which features were seen."""
CAMERA_INFO_LIMIT_S = 2.0
"""Time after the start from which an unknown camera is reported."""


class Level(IntEnum):
    """Severity, numbered as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong now."""

    level: Level
    text: str
    """Problem in one clause, with its remedy where there is one."""


@dataclass(frozen=True, slots=True)
class Status:
    """Health of one node."""

    level: Level
    message: str
    numbers: Mapping[str, object] = field(default_factory=dict)
    """Counts since the start, rates and estimates, by a name that carries the unit."""
    problems: tuple[Problem, ...] = ()
    """Problems of which the message consists, the worst first."""


def status(summary: str, problems: Iterable[Problem], numbers: Mapping[str, object]) -> Status:
    """Join problems, the worst first; without any, `summary` is the message."""
    worst_first = sorted(problems, key=lambda problem: -problem.level)
    level = worst_first[0].level if worst_first else Level.OK
    message = '; '.join(problem.text for problem in worst_first) or summary
    return Status(level, message, numbers, tuple(worst_first))


def as_warnings(texts: Iterable[str]) -> list[Problem]:
    """Return a problem of level WARN for each text."""
    return [Problem(Level.WARN, text) for text in texts]


class Window:
    """Growth of counts over the last seconds.

    Args:
        length_s: length of the window.
        start_s: the present time.
        counts: the present counts.
    """

    def __init__(self, length_s: float, start_s: float, counts: Counter[str]) -> None:
        self._length_s = length_s
        self._history = deque([(start_s, counts.copy())])

    def add(self, counts: Counter[str], now_s: float) -> tuple[Counter[str], float]:
        """Store the present counts; return their growth over the window and the time (s) that it covers.

        To be called about once a second, since each call lengthens the history.
        """
        while len(self._history) > 1 and self._history[1][0] <= now_s - self._length_s:
            self._history.popleft()
        before_s, before = self._history[0]
        self._history.append((now_s, counts.copy()))
        return counts - before, max(now_s - before_s, 1e-3)


@dataclass(frozen=True, slots=True)
class Expected:
    """A topic whose silence is a problem."""

    topic: Role
    limit_s: float
    """Shortest silence that is reported."""
    level: Level
    remedy: str


class HealthLog:
    """Arrivals, counters and recent events of one node.

    Args:
        start_s: the present time.
    """

    def __init__(self, start_s: float) -> None:
        self.counts: Counter[str] = Counter()
        self._start_s = start_s
        self._last_s: dict[str, float] = {}
        self._why_unusable: dict[str, str] = {}
        self._events: deque[tuple[float, str]] = deque(maxlen=MAX_EVENTS)
        self._window = Window(RECENT_S, start_s, self.counts)

    def add_arrival(self, topic: str, now_s: float) -> None:
        """Count a message of a topic, which ends its silence."""
        self.counts[f'{RECEIVED} {topic}'] += 1
        self._last_s[topic] = now_s

    def add_unusable(self, topic: str, why: str) -> None:
        """Count a message that cannot be used."""
        self.counts[f'{UNUSABLE} {topic}'] += 1
        self._why_unusable[topic] = why

    def add_event(self, text: str, now_s: float) -> None:
        """Store an event, to be reported for `RECENT_S`."""
        self._events.append((now_s, text))

    def recent(self, counts: Counter[str], now_s: float) -> tuple[Counter[str], float]:
        """Return the growth of the counts, own and further ones, over `RECENT_S`, and its time (s)."""
        return self._window.add(counts, now_s)

    def running_s(self, now_s: float) -> float:
        """Return the time since the start."""
        return now_s - self._start_s

    def silent_s(self, topic: str, now_s: float) -> float:
        """Return the time since the last arrival on a topic, or since the start."""
        return now_s - self._last_s.get(topic, self._start_s)

    def silences(self, expected: Sequence[Expected], now_s: float) -> Iterator[Problem]:
        """Yield a problem for each topic that has been silent for too long."""
        for item in expected:
            silent_s = self.silent_s(item.topic, now_s)
            if silent_s >= item.limit_s:
                what = f'no message for {silent_s:.0f} s' if item.topic in self._last_s else 'no message yet'
                yield Problem(item.level, f'{item.topic}: {what}; {item.remedy}')

    def unusable_text(self, topic: str, count: int, what: str = 'messages') -> str:
        """Return the text for a number of recent messages of a topic that cannot be used."""
        return f'{topic}: {count} {what} in {RECENT_S:.0f} s cannot be used: {self._why_unusable[topic]}'

    def events(self, now_s: float) -> list[str]:
        """Return the recent events, each text once."""
        return list(dict.fromkeys(text for at_s, text in self._events if now_s - at_s <= RECENT_S))


# --- calibrator -----------------------------------------------------------------------------------

LAST_GOOD = 'the scale factor is no longer estimated, the last good calibration is used'
BLIND_S = 2.0
"""Shortest time without features that the calibrator reports."""
CALIBRATOR_INPUTS = (
    Expected(Role.IMU, 0.5, Level.ERROR, 'check that the driver runs and the board is connected'),
    Expected(Role.WHEELS, 1.0, Level.ERROR, 'check that the driver runs; the distance driven is unknown'),
    Expected(Role.FEATURES, BLIND_S, Level.WARN, f'check that camera and tracker run; {LAST_GOOD}'),
)
HEADING_INPUTS = (
    CALIBRATOR_INPUTS[0],
    Expected(Role.HEADING, 2.0 * BLIND_S, Level.WARN, f'check that its node runs; {LAST_GOOD}'),
)
"""Inputs of a calibrator with a heading reference in place of the camera; it need not have wheels."""


def input_problems(
    log: HealthLog,
    recent: Counter[str],
    inputs: Sequence[Expected],
    *,
    knows_camera: bool,
    window_s: float,
    now_s: float,
) -> Iterator[Problem]:
    """Yield what is wrong with the messages that come to the calibrator.

    Args:
        log: arrivals of the topics, and of images with features as `SEEN`.
        recent: recent counts, with those of the input queue.
        inputs: the expected topics.
        knows_camera: calibration and mounting of the camera are known, or there is none.
        window_s: largest delay of a message that the input queue accepts.
        now_s: the present time.
    """
    yield from log.silences(inputs, now_s)
    texts = []
    blind_s = log.silent_s(SEEN, now_s)
    if log.silent_s(Role.FEATURES, now_s) < BLIND_S <= blind_s:
        texts.append(f'no features in the images for {blind_s:.0f} s, the camera may be covered; {LAST_GOOD}')
    if not knows_camera and log.running_s(now_s) > CAMERA_INFO_LIMIT_S:
        texts.append(f'{Role.CAMERA_INFO}: no message yet; nothing is estimated without it')
    for name, count in sorted(recent.items()):
        kind, _, topic = name.partition(' ')
        if kind == DROPPED:
            texts.append(
                f'{topic}: {count} messages in {RECENT_S:.0f} s came more than {window_s:g} s late or have '
                'stamps far from the others; compare the clocks, or raise live.reorder_window_s'
            )
        elif kind == UNUSABLE:
            texts.append(log.unusable_text(topic, count))
    yield from as_warnings(texts)


# --- tracker --------------------------------------------------------------------------------------

TRACKER_INPUTS = (
    Expected(Role.IMAGE, 2.0, Level.ERROR, 'check that the camera is plugged in and its driver runs'),
    Expected(
        Role.IMU,
        0.5,
        Level.WARN,
        'turns are not predicted and fast ones lose the features; check that the driver runs',
    ),
)
DAZZLED_S = 1.0
"""Shortest time without features that the tracker reports; in less, a lamp may have dazzled the camera."""
TIMED_IMAGES, MIN_TIMED = 20, 6
"""Number of last images that give the image interval and the delay; fewest for the interval."""
LATENCIES = 1000
"""Number of last images that give the latency."""
DARK_GREY, FLAT_GREY = 30.0, 6.0
"""Largest mean of a dark image, and largest standard deviation of a featureless one, in grey levels."""
MAX_DELAY_S, MAX_AHEAD_S = 0.2, 0.02
"""Largest normal delay of the images against the IMU, and largest normal lead of their stamps."""
MAX_LOST = 0.02
"""Largest share of lost images that does no harm."""


class TrackingHealth:
    """Health of the tracker: what it receives, what it sees, and how late it publishes.

    Args:
        start_s: the present time.
    """

    def __init__(self, start_s: float) -> None:
        self.log = HealthLog(start_s)
        self._stamps_ns: deque[int] = deque(maxlen=TIMED_IMAGES)
        self._delays_s: deque[float] = deque(maxlen=TIMED_IMAGES)
        self._latencies_s: deque[float] = deque(maxlen=LATENCIES)
        self._imu_ns: int | None = None
        self._marks_s: deque[float] = deque(maxlen=MANY_MARKS)
        self._features = 0
        self._is_guided = False
        self._why_blind = ''

    def add_imu(self, t_ns: int, now_s: float) -> None:
        """Count an IMU sample."""
        self.log.add_arrival(Role.IMU, now_s)
        self._imu_ns = t_ns

    def add_image(self, t_ns: int, now_s: float) -> None:
        """Count an image, and those before it that were lost in transport, by the gap of the stamps."""
        self.log.add_arrival(Role.IMAGE, now_s)
        if len(self._stamps_ns) >= MIN_TIMED:
            interval_ns = float(np.median(np.diff(self._stamps_ns)))
            intervals = (t_ns - self._stamps_ns[-1]) / max(interval_ns, 1.0)
            if 1.5 < intervals < 10.0:
                self.log.counts['lost'] += round(intervals) - 1
        self._stamps_ns.append(t_ns)
        if self._imu_ns is not None:
            self._delays_s.append(seconds(self._imu_ns - t_ns))

    def add_tracked(self, frame: Frame, seen: FeatureObservations, is_guided: bool, now_s: float) -> None:
        """Store what was seen in an image."""
        self.log.counts['followed'] += 1
        self._features, self._is_guided = len(seen.ids), is_guided
        self.log.counts['on_lens'] += seen.on_lens
        self._marks_s.extend([now_s] * seen.on_lens)
        if self._features:
            self.log.add_arrival(SEEN, now_s)
        else:
            coarse = frame.image[::8, ::8]
            self._why_blind = _why_blind(float(coarse.mean()), float(coarse.std()))

    def add_latency(self, latency_s: float) -> None:
        """Store the time from the arrival of an image to the publication of its features."""
        self._latencies_s.append(latency_s)

    def status(self, knows_camera: bool, issues: Iterable[str], now_s: float) -> Status:
        """Return the present health; to be called about once a second.

        Args:
            knows_camera: the camera is calibrated.
            issues: problems of the mounting.
            now_s: the present time.
        """
        recent, passed_s = self.log.recent(self.log.counts, now_s)
        images = recent[f'{RECEIVED} {Role.IMAGE}']
        problems = [
            *self.log.silences(TRACKER_INPUTS, now_s),
            *self._camera_problems(recent, images, knows_camera, now_s),
            *as_warnings((*self._image_texts(recent, images, now_s), *issues, *self.log.events(now_s))),
        ]
        guide = 'guided by the calibrator' if self._is_guided else 'without the calibrator'
        summary = f'tracking {self._features} features in {images / passed_s:.1f} images a second, {guide}'
        return status(summary, problems, self._numbers(images / passed_s))

    def _camera_problems(
        self, recent: Counter[str], images: int, knows_camera: bool, now_s: float
    ) -> Iterator[Problem]:
        if not knows_camera and self.log.running_s(now_s) > CAMERA_INFO_LIMIT_S:
            yield Problem(
                Level.ERROR,
                f'{Role.CAMERA_INFO}: no message yet; nothing is tracked without it; calibrate the camera '
                'and let its driver publish it',
            )
        for kind, count in sorted(recent.items()):
            word, _, topic = kind.partition(' ')
            if word == UNUSABLE and topic != Role.IMAGE and count:
                yield Problem(Level.WARN, self.log.unusable_text(topic, count))
        if unusable := recent[f'{UNUSABLE} {Role.IMAGE}']:
            level = Level.ERROR if unusable > 0.5 * images else Level.WARN
            yield Problem(level, self.log.unusable_text(Role.IMAGE, unusable, 'images'))

    def _image_texts(self, recent: Counter[str], images: int, now_s: float) -> Iterator[str]:
        lost = recent['dropped'] + recent['lost']
        if lost > MAX_LOST * images:
            yield (
                f'{lost} images in {RECENT_S:.0f} s were dropped: the computer is too slow, or they are lost '
                'in transport; lower the rate of the camera or tracker.features'
            )
        if recent['late']:
            yield (
                f'{recent["late"]} images in {RECENT_S:.0f} s are not newer than the one before; check '
                'whether two cameras publish on one topic'
            )
        if len(self._marks_s) == MANY_MARKS and now_s - self._marks_s[0] < LIFETIME_S:
            yield MANY_MARKS_TEXT
        blind_s = self.log.silent_s(SEEN, now_s)
        if self.log.counts['followed'] and not self._features and blind_s >= DAZZLED_S:
            yield f'no feature was seen for {blind_s:.0f} s: {self._why_blind}'
        delay_s = self._delay_s()
        if delay_s > MAX_DELAY_S:
            yield (
                f'images come {delay_s:.2f} s after the IMU samples of the same time; find what delays them, '
                'or compare the clocks'
            )
        elif delay_s < -MAX_AHEAD_S:
            yield f'images are stamped {-delay_s:.2f} s ahead of the IMU; compare the clocks'

    def _delay_s(self) -> float:
        return float(np.median(self._delays_s)) if len(self._delays_s) == TIMED_IMAGES else 0.0

    def _numbers(self, rate_hz: float) -> dict[str, object]:
        latencies_ms = 1e3 * np.array(self._latencies_s or [0.0])
        p50, p99 = np.percentile(latencies_ms, [50.0, 99.0])
        counts = self.log.counts
        return {
            'image_hz': round(rate_hz, 1),
            'features': self._features,
            'guided_by_calibrator': self._is_guided,
            'latency_ms_p50': round(float(p50), 1),
            'latency_ms_p99': round(float(p99), 1),
            'image_behind_imu_ms': round(1e3 * self._delay_s(), 1),
            'images': counts[f'{RECEIVED} {Role.IMAGE}'],
            **{name: counts[name] for name in ('followed', 'dropped', 'lost', 'late', 'on_lens')},
            UNUSABLE: counts[f'{UNUSABLE} {Role.IMAGE}'],
        }


def _why_blind(mean: float, std: float) -> str:
    """Return the likely reason for an image without features, by mean and scatter of its grey levels."""
    if mean < DARK_GREY:
        return (
            f'the images are dark (grey level {mean:.0f} of 255); uncover the camera or switch on the light'
        )
    if std < FLAT_GREY:
        return f'the images are one grey ({mean:.0f} of 255); uncover the camera or check its exposure'
    return 'the images have no distinct features; check the focus and the exposure of the camera'
