"""A robot for the live calibrator without ROS: what it measures goes in, what comes out is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from recordings import at, recording

from gyrocal_ros.config.sections import Config, LiveConfig
from gyrocal_ros.data import (
    NS_PER_S,
    CalibratedSample,
    CovariateSample,
    FeatureObservations,
    ImuSample,
    Measurement,
    OdometryEstimate,
    Rig,
    SearchRegions,
    TemperatureSample,
    TruthSample,
    WheelSample,
    seconds,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.topics import BODY_FRAME, CAMERA_FRAME, IMU_FRAME
from gyrocal_ros.msgs.transforms import IDENTITY, Transform
from gyrocal_ros.robot.calibrator import LiveCalibrator
from gyrocal_ros.robot.health import Status
from gyrocal_ros.sim.world import SimSource

DURATION_S = 40.0
BEGAN_S = 5000.0
"""The steady clock when the node starts."""


@dataclass
class Robot:
    """The calibrator, and all that it put out."""

    live: LiveCalibrator
    now_s: float = BEGAN_S
    calibrated: list[CalibratedSample] = field(default_factory=list)
    located: list[OdometryEstimate] = field(default_factory=list)
    regions: list[SearchRegions] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    _origin_ns: int | None = None
    _told_s: float = BEGAN_S

    def mount(self, rig: Rig, imu: bool = True) -> None:
        """Let the transforms and `camera_info` come."""
        links = [Transform(BODY_FRAME, CAMERA_FRAME, rig.camera_mount)]
        if imu:
            links.append(Transform(BODY_FRAME, IMU_FRAME, IDENTITY))
        self.live.links(links)
        assert rig.camera is not None
        self.live.camera(rig.camera, CAMERA_FRAME, self.now_s)

    def run(
        self,
        measurements: Iterable[Measurement],
        step_s: float = 0.0,
        delay_s: Callable[[Measurement], float] = lambda item: 0.0,
    ) -> None:
        """Let measurements arrive.

        Args:
            measurements: in the order of their stamps.
            step_s: by how much all stamps are off.
            delay_s: how long after its stamp each one comes.
        """
        if self._origin_ns is None:
            measurements = list(measurements)
            self._origin_ns = measurements[0].t_ns
        origin_ns = self._origin_ns
        arriving = (
            (BEGAN_S + seconds(item.t_ns - origin_ns) + delay_s(item), place, item)
            for place, item in enumerate(measurements)
        )
        for self.now_s, _, item in sorted(arriving):
            self.take(replace(item, t_ns=item.t_ns + round(step_s * NS_PER_S)))

    def take(self, item: Measurement) -> None:
        """Let one measurement arrive now."""
        match item:
            case ImuSample():
                sample = self.live.imu(item, IMU_FRAME, self.now_s)
                if sample is not None:
                    self.calibrated.append(sample)
            case WheelSample():
                place = self.live.wheels(item, self.now_s)
                if place is not None:
                    self.located.append(place)
            case FeatureObservations():
                self.live.features(item, CAMERA_FRAME, self.now_s)
            case TemperatureSample():
                self.live.temperature(item, self.now_s)
            case CovariateSample():
                self.live.signal(item, self.now_s)
        self.work()
        if self.now_s - self._told_s >= 1.0:
            self._told_s = self.now_s
            self.statuses.append((self.now_s - BEGAN_S, self.live.status(self.now_s)))
            self.live.save_if_due(self.now_s)

    def work(self) -> None:
        """Let the filter go on, as far as it can."""
        while self.live.has_work:
            regions = self.live.work()
            if regions is not None:
                self.regions.append(regions)

    def said(self, words: str) -> list[float]:
        """When the health told something that contains these words, seconds since the start."""
        return [when_s for when_s, status in self.statuses if words in status.message]


def robot(
    *,
    calibration: Path | None = None,
    config: Config | None = None,
    model: SensorModel | None = None,
    steady: bool = True,
    **live: Any,
) -> Robot:
    """A robot that was just switched on."""
    settings = replace(LiveConfig(), calibration=str(calibration or ''), **live)
    chosen = model or default_model()
    return Robot(
        LiveCalibrator(chosen, config or Config(), settings, name='test', steady=steady, now_s=BEGAN_S)
    )


def source() -> SimSource:
    """The drive of all these tests."""
    return recording(duration_s=DURATION_S, seed=3)


@cache
def measured(from_s: float = 0.0, to_s: float = DURATION_S) -> tuple[Measurement, ...]:
    """What the sensors measure between two moments."""
    everything = (item for item in source().measurements() if not isinstance(item, TruthSample))
    return tuple(item for item in everything if at(from_s) <= item.t_ns < at(to_s))


def switched_on(path: Path | None = None, **settings: Any) -> Robot:
    """A robot of which it is known how its sensors sit."""
    new = robot(calibration=path, **settings)
    new.mount(source().rig)
    return new
