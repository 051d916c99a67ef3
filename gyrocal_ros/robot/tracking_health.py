"""How the tracker is, in sentences."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence

import numpy as np

from gyrocal_ros.data import FeatureObservations, Frame, seconds
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.robot.health import Complaint, Level, Status, status
from gyrocal_ros.robot.health_log import RECENT_S, HealthLog

SILENT_S = {Role.CAMERA_INFO: 2.0, Role.IMAGE: 2.0, Role.IMU: 0.5}
"""What says nothing for so long is missed."""
BLIND_S = 1.0
"""Nothing seen for so long is more than a lamp that dazzles."""
KEPT = 1000
"""Latest images whose latency counts."""
SOME = 20
"""Latest images that tell the rate and how late they come."""
DARK_GREY, FLAT_GREY = 30.0, 6.0
"""Mean grey of an image of which nothing can be seen, and the standard deviation of a featureless one."""
LATE_S, AHEAD_S = 0.2, 0.02
FEW = 0.02
"""A share of lost images that does no harm."""


class TrackingHealth:
    """Keeps count of what comes and what is seen; tells what is wrong now, or was a moment ago.

    Args:
        start_s: now, by a clock that is never set, as everywhere here.
    """

    def __init__(self, start_s: float) -> None:
        self._counts: Counter[str] = Counter()
        self._journal = HealthLog(SILENT_S, start_s)
        self._seen_s = start_s
        self._why_spoiled = ''
        self._stamps_ns: deque[int] = deque(maxlen=SOME)
        self._lags_s: deque[float] = deque(maxlen=SOME)
        self._latencies_s: deque[float] = deque(maxlen=KEPT)
        self._imu_ns: int | None = None
        self._features = 0
        self._is_guided = False
        self._grey = (0.0, 0.0)

    # --- what is noted ---------------------------------------------------------------------------

    def hear(self, role: Role, now_s: float) -> None:
        """Note that a message has come."""
        self._journal.hear(role, now_s)

    def hear_imu(self, t_ns: int, now_s: float) -> None:
        """Note a sample of the IMU."""
        self.hear(Role.IMU, now_s)
        self._imu_ns = t_ns

    def hear_image(self, t_ns: int, now_s: float) -> None:
        """Note an image; those that were lost on the way here show in the stamps."""
        self.hear(Role.IMAGE, now_s)
        self._counts['images'] += 1
        if len(self._stamps_ns) > 5:
            usual_ns = float(np.median(np.diff(self._stamps_ns)))
            gone = (t_ns - self._stamps_ns[-1]) / max(usual_ns, 1.0)
            if 1.5 < gone < 10.0:
                self._counts['lost'] += round(gone) - 1
        self._stamps_ns.append(t_ns)
        if self._imu_ns is not None:
            self._lags_s.append(seconds(self._imu_ns - t_ns))

    def late(self) -> None:
        """Note an image that is not newer than the one before."""
        self._counts['late'] += 1

    def drop(self) -> None:
        """Note an image that had to make way for newer ones."""
        self._counts['dropped'] += 1

    def spoil(self, why: str) -> None:
        """Note an image that cannot be used, and why."""
        self._counts['of_no_use'] += 1
        self._why_spoiled = why

    def see(self, frame: Frame, seen: FeatureObservations, is_guided: bool, now_s: float) -> None:
        """Note what was seen in an image."""
        self._counts['followed'] += 1
        self._features, self._is_guided = len(seen.ids), is_guided
        if self._features:
            self._seen_s = now_s
        else:
            coarse = frame.image[::8, ::8]
            self._grey = float(coarse.mean()), float(coarse.std())

    def hand_on(self, latency_s: float) -> None:
        """Note how long after its image a list of features went out."""
        self._latencies_s.append(latency_s)

    def happened(self, text: str, now_s: float) -> None:
        """Note what a person should know for a while."""
        self._journal.happened(text, now_s)

    # --- what is told ----------------------------------------------------------------------------

    def tell(self, knows_camera: bool, standing: Sequence[str], now_s: float) -> Status:
        """Judge the present moment; to be asked once a second or so.

        Args:
            knows_camera: whether its calibration has come.
            standing: what is wrong until somebody mends it.
            now_s: now.
        """
        recent, passed_s = self._journal.recent(self._counts, now_s)
        rate_hz = recent['images'] / passed_s
        warnings = [
            *self._losses(recent),
            *self._sight(now_s),
            *self._stamps(),
            *standing,
            *self._journal.events(now_s),
        ]
        complaints = [
            *self._silences(knows_camera, now_s),
            *self._spoiled(recent),
            *(Complaint(Level.WARN, text) for text in warnings),
        ]
        guide = 'guided by the calibrator' if self._is_guided else 'without the calibrator'
        fine = f'following {self._features} features in {rate_hz:.1f} images a second, {guide}'
        return status(fine, complaints, self._numbers(rate_hz))

    def _silences(self, knows_camera: bool, now_s: float) -> Iterator[Complaint]:
        if silence := self._journal.silence(Role.IMAGE, now_s):
            yield Complaint(
                Level.ERROR,
                f'{Role.IMAGE}: {silence}; see whether the camera is plugged in and its driver runs',
            )
        if not knows_camera and self._journal.running_s(now_s) > SILENT_S[Role.CAMERA_INFO]:
            yield Complaint(
                Level.ERROR,
                f'{Role.CAMERA_INFO}: nothing has come yet; nothing is followed without it; calibrate the '
                'camera and let its driver publish it',
            )
        if silence := self._journal.silence(Role.IMU, now_s):
            yield Complaint(
                Level.WARN,
                f'{Role.IMU}: {silence}; turns are not foreseen and fast ones lose the features; see whether '
                'the driver runs',
            )

    def _spoiled(self, recent: Counter[str]) -> Iterator[Complaint]:
        if count := recent['of_no_use']:
            level = Level.ERROR if count > 0.5 * recent['images'] else Level.WARN
            yield Complaint(
                level, f'{Role.IMAGE}: {count} images in {RECENT_S:.0f} s are of no use: {self._why_spoiled}'
            )

    def _losses(self, recent: Counter[str]) -> Iterator[str]:
        missed = recent['dropped'] + recent['lost']
        if missed > FEW * recent['images']:
            yield (
                f'{missed} images in {RECENT_S:.0f} s were left out: the computer cannot keep up, or they '
                'are lost on the way; lower the rate of the camera or tracker.features'
            )
        if recent['late']:
            yield (
                f'{recent["late"]} images in {RECENT_S:.0f} s are not newer than the one before; see whether '
                'two cameras publish on one topic'
            )

    def _sight(self, now_s: float) -> Iterator[str]:
        blind_s = now_s - self._seen_s
        if not self._counts['followed'] or self._features or blind_s < BLIND_S:
            return
        mean, scatter = self._grey
        if mean < DARK_GREY:
            why = (
                f'the images are dark (grey level {mean:.0f} of 255); uncover the camera or put on the light'
            )
        elif scatter < FLAT_GREY:
            why = f'the images show one grey ({mean:.0f} of 255); uncover the camera or see to its exposure'
        else:
            why = 'nothing in the images stands out; see to the focus and the exposure of the camera'
        yield f'no feature was seen for {blind_s:.0f} s: {why}'

    def _stamps(self) -> Iterator[str]:
        lag_s = self._lag_s()
        if lag_s > LATE_S:
            yield (
                f'images come {lag_s:.2f} s after the IMU of the same moment; see what holds them up, or '
                'compare the clocks'
            )
        elif lag_s < -AHEAD_S:
            yield f'images are stamped {-lag_s:.2f} s ahead of the IMU; compare the clocks'

    def _lag_s(self) -> float:
        return float(np.median(self._lags_s)) if len(self._lags_s) == SOME else 0.0

    def _numbers(self, rate_hz: float) -> dict[str, object]:
        latencies_ms = 1e3 * np.array(self._latencies_s or [0.0])
        p50, p99 = np.percentile(latencies_ms, [50.0, 99.0])
        names = ('images', 'followed', 'dropped', 'lost', 'late', 'of_no_use')
        return {
            'image_hz': round(rate_hz, 1),
            'features': self._features,
            'guided_by_calibrator': self._is_guided,
            'latency_ms_p50': round(float(p50), 1),
            'latency_ms_p99': round(float(p99), 1),
            'image_behind_imu_ms': round(1e3 * self._lag_s(), 1),
            **{name: self._counts[name] for name in names},
        }
