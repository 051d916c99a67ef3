"""Collects what the nodes of a running robot publish, as plain values for a display."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.robot.health import Level

MAX_POINTS = 3600
"""Maximum number of values kept, an hour at one a second; the oldest are dropped first."""
SILENT_S = 5.0
"""Time without a status after which a node counts as gone."""


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """Last status of one node."""

    name: str
    level: Level
    message: str
    numbers: Mapping[str, str]
    silent_s: float

    @property
    def is_gone(self) -> bool:
        """True if the node has been silent for longer than `SILENT_S`, so that it may have ended."""
        return self.silent_s > SILENT_S


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """Everything received so far."""

    version: int
    """Number of updates; grows with every message."""
    time_s: Array
    """(n,) times of the calibrations, since the feed began."""
    scale_factor: Array
    scale_factor_std: Array
    nis_time_s: Array
    """(m,)"""
    nis: Array
    """(m,) per degree of freedom, over the last seconds."""
    calibration: Mapping[str, object]
    """The last calibration, by parameter name."""
    nodes: tuple[NodeHealth, ...]
    tracks: bytes | None
    """The last image with the tracks drawn, as JPEG."""


@dataclass(slots=True)
class _Report:
    level: Level
    message: str
    numbers: Mapping[str, str]
    at_s: float


@dataclass(slots=True)
class Feed:
    """Collects the messages; thread-safe.

    All times are by a monotonic clock.
    """

    start_s: float
    _scale: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=MAX_POINTS))
    _nis: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MAX_POINTS))
    _calibration: Mapping[str, object] = field(default_factory=dict)
    _reports: dict[str, _Report] = field(default_factory=dict)
    _tracks: bytes | None = None
    _version: int = 0
    _lock: Lock = field(default_factory=Lock)

    def calibration(self, values: Mapping[str, object], now_s: float) -> None:
        """Add a calibration, by parameter name as on `/gyro_calibration`."""
        scale, std = values.get('gyro.scale_factor'), values.get('gyro.scale_factor_std')
        with self._lock:
            self._calibration = {**self._calibration, **values}
            if isinstance(scale, float) and isinstance(std, float):
                self._scale.append((now_s - self.start_s, scale, std))
            self._version += 1

    def health(self, name: str, level: int, message: str, numbers: Mapping[str, str], now_s: float) -> None:
        """Add the status of a node."""
        known = Level(level) if level in tuple(Level) else Level.ERROR
        with self._lock:
            self._reports[name] = _Report(known, message, dict(numbers), now_s)
            nis = _number(numbers.get('recent_nis'))
            if math.isfinite(nis):
                self._nis.append((now_s - self.start_s, nis))
            self._version += 1

    def tracks(self, jpeg: bytes) -> None:
        """Replace the image."""
        with self._lock:
            self._tracks, self._version = jpeg, self._version + 1

    def overview(self, now_s: float) -> Overview:
        """Return everything received so far."""
        with self._lock:
            scale, nis = np.array(self._scale).reshape(-1, 3), np.array(self._nis).reshape(-1, 2)
            nodes = tuple(
                NodeHealth(name, report.level, report.message, report.numbers, now_s - report.at_s)
                for name, report in sorted(self._reports.items())
            )
            return Overview(
                version=self._version,
                time_s=scale[:, 0],
                scale_factor=scale[:, 1],
                scale_factor_std=scale[:, 2],
                nis_time_s=nis[:, 0],
                nis=nis[:, 1],
                calibration=self._calibration,
                nodes=nodes,
                tracks=self._tracks,
            )


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None else math.nan
    except ValueError:
        return math.nan
