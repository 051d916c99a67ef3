"""How the calibrator is, in sentences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gyrocal_ros.config.sections import ConvergenceConfig
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.robot.health import Complaint, Level, Status, status
from gyrocal_ros.robot.health_log import RECENT_S, HealthLog

SILENT_S = {Role.IMU: 0.5, Role.WHEELS: 1.0, Role.FEATURES: 2.0}
"""What says nothing for so long is missed."""
HEARD, OF_NO_USE, LEFT_OUT, WITHOUT_IMU = 'heard', 'of_no_use', 'left_out', 'without_imu'
"""What is counted by topic: each count is named so, then by its topic."""
LAST_GOOD = 'the scale factor is no longer learned, the last good calibration is served'


@dataclass(frozen=True, slots=True)
class Facts:
    """What the calibrator knows of itself at a moment."""

    calibration: Calibration
    convergence: ConvergenceConfig
    is_estimating: bool
    knows_camera: bool
    """Its calibration, and where it sits."""
    is_trusted: bool
    on_probation: bool
    """Begun anew, and not yet believed."""
    recent_nis: float
    overall_nis: float
    restarts: int
    map_size: int
    pixel_noise_px: float
    lag_s: float
    """How far the filter is behind the newest IMU sample."""
    window_s: float
    left_out: Counter[str]
    """Messages by topic that were late, repeated or oddly stamped."""
    useless: Counter[str]
    """Messages by topic that were of no use for want of an IMU."""
    signals: frozenset[str]
    """Names of the numbers that have come, for effects that follow them."""
    standing: Sequence[str]
    """What is wrong until somebody mends it: mounting, files."""


class CalibratorHealth:
    """Keeps count of what comes and what happens; tells what is wrong now, or was a moment ago.

    Args:
        model: whose effects may follow what does not come.
        start_s: now, by a clock that is never set, as everywhere here.
    """

    def __init__(self, model: SensorModel, start_s: float) -> None:
        self._model = model
        self._journal = HealthLog(SILENT_S, start_s)
        self._counts: Counter[str] = Counter()
        self._why_spoiled: dict[str, str] = {}
        self._seen_s = start_s

    def hear(self, topic: str, now_s: float) -> None:
        """Note that a message has come."""
        self._counts[f'{HEARD} {topic}'] += 1
        self._journal.hear(topic, now_s)

    def see(self, now_s: float) -> None:
        """Note that the camera has seen something."""
        self._seen_s = now_s

    def spoil(self, topic: str, why: str) -> None:
        """Note a message that cannot be used, and why."""
        self._counts[f'{OF_NO_USE} {topic}'] += 1
        self._why_spoiled[topic] = why

    def happened(self, text: str, now_s: float) -> None:
        """Note what a person should know for a while."""
        self._journal.happened(text, now_s)

    def tell(self, facts: Facts, now_s: float) -> Status:
        """Judge the present moment; to be asked once a second or so."""
        of_intake = {LEFT_OUT: facts.left_out, WITHOUT_IMU: facts.useless}
        counts = self._counts + Counter(
            {f'{what} {topic}': n for what, topics in of_intake.items() for topic, n in topics.items()}
        )
        recent, passed_s = self._journal.recent(counts, now_s)
        warnings = [
            *self._camera(facts, now_s),
            *self._unusable(recent, facts.window_s),
            *_filter(facts),
            *self._missing_signals(facts),
            *facts.standing,
            *self._journal.events(now_s),
        ]
        complaints = [*self._silences(now_s), *(Complaint(Level.WARN, text) for text in warnings)]
        return status(_fine(facts), complaints, _numbers(facts, counts, recent, passed_s))

    def _silences(self, now_s: float) -> Iterator[Complaint]:
        for role, todo in (
            (Role.IMU, 'see whether the driver runs and the board is connected'),
            (Role.WHEELS, 'see whether the driver runs; nobody knows how far the robot goes'),
        ):
            silence = self._journal.silence(role, now_s)
            if silence:
                yield Complaint(Level.ERROR, f'{role}: {silence}; {todo}')

    def _camera(self, facts: Facts, now_s: float) -> Iterator[str]:
        blind_s = now_s - self._seen_s
        if silence := self._journal.silence(Role.FEATURES, now_s):
            yield f'{Role.FEATURES}: {silence}; see whether camera and tracker run; {LAST_GOOD}'
        elif blind_s >= SILENT_S[Role.FEATURES]:
            yield f'the camera has seen no feature for {blind_s:.0f} s, it may be covered; {LAST_GOOD}'
        if not facts.knows_camera and self._journal.running_s(now_s) > SILENT_S[Role.FEATURES]:
            yield f'{Role.CAMERA_INFO}: nothing has come yet; nothing is estimated without it'

    def _unusable(self, recent: Counter[str], window_s: float) -> Iterator[str]:
        """Messages of late that were left out."""
        for name, count in sorted(recent.items()):
            what, _, topic = name.partition(' ')
            of_late = f'{topic}: {count} messages in {RECENT_S:.0f} s'
            if what == LEFT_OUT:
                yield (
                    f'{of_late} came more than {window_s:g} s late or are stamped far from the others; '
                    'compare the clocks, or raise live.reorder_window_s'
                )
            elif what == OF_NO_USE:
                yield f'{of_late} are of no use: {self._why_spoiled[topic]}'

    def _missing_signals(self, facts: Facts) -> Iterator[str]:
        for signal, names in followers_by_signal(self._model).items():
            if signal not in facts.signals:
                yield f'{signal} has not come yet: nothing can be learned of {", ".join(names)}'


def _filter(facts: Facts) -> Iterator[str]:
    """What is to be said of the estimate."""
    if not facts.is_estimating:
        return
    limits, scale_std = facts.convergence, facts.calibration.scale_factor_std
    if facts.on_probation:
        yield 'the filter was begun anew and has to prove itself; the last good calibration is served'
    elif not facts.is_trusted:
        yield (
            'what the camera sees contradicts the filter: NIS '
            f'{max(facts.recent_nis, facts.overall_nis):.1f} per degree of freedom, up to '
            f'{limits.nis_high:g} is healthy; the last good calibration is served; '
            'check the calibration, the mounting and the stamps of the camera'
        )
    elif facts.recent_nis < limits.nis_low:
        yield (
            f'the images are better than the filter takes them for (NIS {facts.recent_nis:.1f}, from '
            f'{limits.nis_low:g} on is healthy): it learns that, or lower camera.pixel_noise_px'
        )
    if scale_std > limits.scale_std:
        yield (
            f'not converged yet: the scale factor is known to {100.0 * scale_std:.2g} %, '
            f'{100.0 * limits.scale_std:.2g} % is wanted; turn both ways where the camera sees the ceiling'
        )


def _fine(facts: Facts) -> str:
    calibration = facts.calibration
    scale = f'scale factor {calibration.scale_factor:.5f} ± {calibration.scale_factor_std:.1g}'
    bias_deg_s = math.degrees(float(calibration.values[0]))
    served = 'calibrated' if facts.is_estimating else 'not estimating; served'
    return f'{served}: {scale}, bias {bias_deg_s:.4f} deg/s'


def _numbers(facts: Facts, counts: Counter[str], recent: Counter[str], passed_s: float) -> dict[str, object]:
    rates = {
        f'{name}_hz': round(recent[f'{HEARD} {role}'] / passed_s, 1)
        for name, role in (('imu', Role.IMU), ('wheels', Role.WHEELS), ('features', Role.FEATURES))
    }
    calibration = facts.calibration
    return {
        'scale_factor': round(calibration.scale_factor, 6),
        'scale_factor_std': float(f'{calibration.scale_factor_std:.2g}'),
        'bias_deg_s': round(math.degrees(float(calibration.values[0])), 5),
        'bias_std_deg_s': float(f'{math.degrees(float(calibration.stds[0])):.2g}'),
        'converged': calibration.converged,
        'estimating': facts.is_estimating,
        'recent_nis': round(facts.recent_nis, 3),
        'overall_nis': round(facts.overall_nis, 3),
        'pixel_noise_px': round(facts.pixel_noise_px, 3),
        'map_size': facts.map_size,
        'filter_lag_s': round(facts.lag_s, 3),
        'filter_restarts': facts.restarts,
        **rates,
        **{name: count for name, count in sorted(counts.items()) if not name.startswith(HEARD)},
    }
