"""A robot for tests of the live calibrator without ROS: feeds measurements in and records the outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from recordings import at, recording

from gyrocal_ros.config.robot_sections import LiveConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    CalibratedSample,
    CovariateSample,
    FeatureObservations,
    HeadingSample,
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
"""Length of the recording."""
START_S = 5000.0
"""Reading of the steady clock when the node starts."""


@dataclass
class Robot:
    """The calibrator, with all its outputs."""

    live: LiveCalibrator
    now_s: float = START_S
    calibrated: list[CalibratedSample] = field(default_factory=list)
    odometry: list[OdometryEstimate] = field(default_factory=list)
    regions: list[SearchRegions] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    _origin_ns: int | None = None
    _asked_s: float = START_S

    def mount(self, rig: Rig, imu: bool = True) -> None:
        """Deliver the transforms and `camera_info`."""
        transforms = [Transform(BODY_FRAME, CAMERA_FRAME, rig.camera_mount)]
        if imu:
            transforms.append(Transform(BODY_FRAME, IMU_FRAME, IDENTITY))
        self.live.transforms(transforms)
        assert rig.camera is not None
        self.live.camera(rig.camera, CAMERA_FRAME, self.now_s)

    def run(
        self,
        measurements: Iterable[Measurement],
        step_s: float = 0.0,
        delay_s: Callable[[Measurement], float] = lambda item: 0.0,
    ) -> None:
        """Deliver measurements.

        Args:
            measurements: measurements in the order of their stamps.
            step_s: offset added to all stamps.
            delay_s: returns the time from the stamp of a measurement to its arrival.
        """
        if self._origin_ns is None:
            measurements = list(measurements)
            self._origin_ns = measurements[0].t_ns
        origin_ns = self._origin_ns
        arriving = (
            (START_S + seconds(item.t_ns - origin_ns) + delay_s(item), number, item)
            for number, item in enumerate(measurements)
        )
        for self.now_s, _, item in sorted(arriving):
            self.take(replace(item, t_ns=item.t_ns + round(step_s * NS_PER_S)))

    def take(self, item: Measurement) -> None:
        """Deliver one measurement now."""
        match item:
            case ImuSample():
                sample = self.live.imu(item, IMU_FRAME, self.now_s)
                if sample is not None:
                    self.calibrated.append(sample)
            case WheelSample():
                estimate = self.live.wheels(item, self.now_s)
                if estimate is not None:
                    self.odometry.append(estimate)
            case FeatureObservations():
                self.live.features(item, CAMERA_FRAME, self.now_s)
            case HeadingSample():
                self.live.heading(item, self.now_s)
            case TemperatureSample():
                self.live.temperature(item, self.now_s)
            case CovariateSample():
                self.live.signal(item, self.now_s)
        self.work()
        if self.now_s - self._asked_s >= 1.0:
            self._asked_s = self.now_s
            self.statuses.append((self.now_s - START_S, self.live.status(self.now_s)))
            self.live.save_if_due(self.now_s)

    def work(self) -> None:
        """Let the filter process everything that waits."""
        while self.live.has_work:
            regions = self.live.work()
            if regions is not None:
                self.regions.append(regions)

    def reported(self, words: str) -> list[float]:
        """Times, in seconds since the start, at which the health message contained these words."""
        return [at_s for at_s, status in self.statuses if words in status.message]


def robot(
    *,
    calibration: Path | None = None,
    config: Config | None = None,
    model: SensorModel | None = None,
    steady: bool = True,
    **live: Any,
) -> Robot:
    """Make a robot that was just switched on."""
    settings = replace(LiveConfig(), calibration=str(calibration or ''), **live)
    chosen = model or default_model()
    return Robot(
        LiveCalibrator(chosen, config or Config(), settings, name='test', steady=steady, now_s=START_S)
    )


def source(camera_hz: int = 5) -> SimSource:
    """The drive that all these tests use."""
    return recording(duration_s=DURATION_S, seed=3, camera_hz=camera_hz)


@cache
def measured(from_s: float = 0.0, to_s: float = DURATION_S, camera_hz: int = 5) -> tuple[Measurement, ...]:
    """The measurements between two times."""
    all_items = (item for item in source(camera_hz).measurements() if not isinstance(item, TruthSample))
    return tuple(item for item in all_items if at(from_s) <= item.t_ns < at(to_s))


def switched_on(path: Path | None = None, **settings: Any) -> Robot:
    """Make a robot whose mounting is known."""
    new = robot(calibration=path, **settings)
    new.mount(source().rig)
    return new
