"""The calibrator on a running robot: messages go in as they arrive, calibrated samples come out at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrocal_ros.config.robot_sections import LiveConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    CalibratedSample,
    CameraIntrinsics,
    CovariateSample,
    FeatureObservations,
    HeadingSample,
    ImuSample,
    Measurement,
    OdometryEstimate,
    SearchRegions,
    TemperatureSample,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.map import CeilingMap, ceiling_map
from gyrocal_ros.ekf.state.map_frame import point_covariances
from gyrocal_ros.model.recording import SPEED_SIGNAL
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.bursts import Bursts
from gyrocal_ros.msgs.mounts import into_body_axes
from gyrocal_ros.msgs.plausible import IMPLAUSIBLE, plausible
from gyrocal_ros.msgs.topics import Role, bounds
from gyrocal_ros.msgs.transforms import Transform
from gyrocal_ros.pipeline.by_heading import for_reference
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.robot.calibration_store import CalibrationStore
from gyrocal_ros.robot.dead_reckoning import DeadReckoning
from gyrocal_ros.robot.estimator import Estimator
from gyrocal_ros.robot.health import (
    CALIBRATOR_INPUTS,
    DROPPED,
    HEADING_INPUTS,
    RECEIVED,
    SEEN,
    WITHOUT_IMU,
    HealthLog,
    Status,
    as_warnings,
    input_problems,
    status,
)
from gyrocal_ros.robot.input_queue import STEP_S, InputQueue
from gyrocal_ros.robot.mounting import ANOTHER_IMU, Mounting

ORDERED_ROLES = (Role.IMU, Role.WHEELS, Role.FEATURES)
"""Topics whose messages arrive in the order of their stamps. When all of them have passed a moment the filter
steps to it at once, so that the tracker gets its search regions before the next image."""


class LiveCalibrator:
    """Estimates and applies the calibration while measurements arrive, and keeps it in a file.

    After each call that takes in a message, call `work` until it has nothing left.

    Args:
        model: the sensor model.
        config: settings of the estimator.
        live: settings of the calibrator itself.
        name: source of the calibration, for its file.
        steady: True if the times of arrival can be compared with the stamps, whose clock runs at the rate
            of the monotonic clock; False in simulated time.
        now_s: the present time by a monotonic clock, as are all times `now_s` here.

    Raises:
        ConfigError: the file of the calibration is a folder.
    """

    def __init__(
        self,
        model: SensorModel,
        config: Config,
        live: LiveConfig,
        *,
        name: str,
        steady: bool,
        now_s: float,
    ) -> None:
        self._by_heading = bool(live.heading_reference)
        seen = ('headings', Role.HEADING) if self._by_heading else ('features', Role.FEATURES)
        self._rates = (('imu', Role.IMU), ('wheels', Role.WHEELS), seen)
        config = for_reference(config) if self._by_heading else config
        self._model, self._live = model, live
        self._steady, self._clock_step_s = steady, config.recording.clock_step_s
        self._store = CalibrationStore(Path(live.calibration).expanduser() if live.calibration else None)
        self._estimator = Estimator(model, config, self._store.load(config), name)
        self._applied = self._estimator.trusted
        self._reckoning = DeadReckoning(model, config, self._applied, 1.25 * live.reorder_window_s)
        self._mounting = Mounting(config.camera, has_camera=not self._by_heading)
        self._bursts = Bursts()
        self._rig, self._R_bi = self._mounting.rig, self._mounting.R_bi
        self._streams = [str(role) for role in Role]
        self._signals = {SPEED_SIGNAL}
        self._to_body = into_body_axes(np.eye(3))
        self._queue = self._new_queue()
        self._log = HealthLog(now_s)
        self._now_s = self._saved_s = now_s
        self.newest_ns = 0
        """Stamp of the last IMU sample, the present time of the sensors' clock; 0 before the first."""
        self.switch(live.estimate)

    # --- input ------------------------------------------------------------------------------------

    def imu(self, sample: ImuSample, frame: str, now_s: float) -> CalibratedSample | None:
        """Take in a sample in the IMU's own axes; return it calibrated, None while its mount is unknown."""
        if not self._is_plausible(Role.IMU, *sample.rate_rad_s, *sample.specific_force_m_s2):
            return None
        if not self._mounting.add_imu(sample, frame):
            self._log.add_unusable(Role.IMU, ANOTHER_IMU)
            return None
        for spread in self._bursts.add(sample):
            self._take(Role.IMU, (spread,), now_s)
        self._update_mounting()
        self.newest_ns = sample.t_ns
        return None if self._R_bi is None else self._reckoning.imu(self._to_body(sample))

    def wheels(self, sample: WheelSample, now_s: float) -> OdometryEstimate | None:
        """Take in a reading of the encoders; return the pose at its stamp, None without IMU samples."""
        if not self._is_plausible(Role.WHEELS, sample.speed_m_s, sample.yaw_rate_rad_s):
            return None
        self._take(Role.WHEELS, (sample,), now_s)
        return self._reckoning.wheels(sample)

    def features(self, seen: FeatureObservations, frame: str, now_s: float) -> None:
        """Take in the features of one image."""
        self._take(Role.FEATURES, (seen,), now_s)
        if len(seen.ids):
            self._log.add_arrival(SEEN, now_s)
        self._mounting.set_camera_frame(frame)
        self._update_mounting()

    def heading(self, sample: HeadingSample, now_s: float) -> None:
        """Take in a heading of the reference; NaN where it has none."""
        if self._is_plausible(Role.HEADING, sample.yaw_rad):
            self._take(Role.HEADING, (sample,), now_s)

    def temperature(self, sample: TemperatureSample, now_s: float) -> None:
        """Take in a temperature."""
        if not self._is_plausible(Role.TEMPERATURE, sample.temperature_c):
            return
        self._take(Role.TEMPERATURE, (sample,), now_s)
        self._signals.add('temperature')
        self._reckoning.add(sample)

    def signal(self, sample: CovariateSample, now_s: float) -> None:
        """Take in a value of a signal that effects depend on; NaN where it is not measured."""
        if not math.isfinite(sample.value):
            return
        if sample.name not in self._streams:
            self._streams.append(sample.name)
        self._take(sample.name, (sample,), now_s)
        self._signals.add(sample.name)
        self._reckoning.add(sample)

    def camera(self, camera: CameraIntrinsics, frame: str, now_s: float) -> None:
        """Take in the intrinsics of `camera_info`."""
        self._log.add_arrival(Role.CAMERA_INFO, now_s)
        self._mounting.set_camera(camera, frame)
        self._update_mounting()

    def transforms(self, transforms: Iterable[Transform]) -> None:
        """Take in static transforms."""
        self._mounting.add_transforms(transforms)
        self._update_mounting()

    def unusable(self, topic: str, why: str) -> None:
        """Count a message that could not be converted."""
        self._log.add_unusable(topic, why)

    # --- output -----------------------------------------------------------------------------------

    def work(self) -> SearchRegions | None:
        """Let the filter take at most one step; return where it then expects the features.

        The tracker itself carries these regions to its next image, so that it does the same on the robot
        as in a recording (see `vision.gyro_aided_tracker`).
        """
        slam = self._estimator.slam
        if slam is None or self._R_bi is None:
            return None
        waiting, has_stepped = self._queue.waiting, False
        while waiting and not has_stepped:
            measurement = waiting.popleft()
            if isinstance(measurement, ImuSample):
                measurement = self._to_body(measurement)
            has_stepped = self._estimator.step(measurement, self._reckoning.predicted)
        self._log_events()
        return self._apply() if has_stepped else None

    @property
    def calibration(self) -> Calibration:
        """The present calibration."""
        return self._estimator.calibration

    @property
    def filter(self) -> EkfSlam | None:
        """The filter with its map; None while it is stopped."""
        return self._estimator.slam

    def ceiling_map(self) -> CeilingMap | None:
        """Return the mapped features as points; None while the filter is stopped."""
        slam = self._estimator.slam
        if slam is None:
            return None
        ceiling = ceiling_map(slam.state, slam.config.features.parametrisation)
        by_frame = point_covariances(ceiling.points_m, slam.config.wheels)
        return replace(ceiling, covariances_m2=ceiling.covariances_m2 + by_frame)

    @property
    def has_work(self) -> bool:
        """True if `work` would process a measurement."""
        return self._estimator.slam is not None and self._R_bi is not None and bool(self._queue.waiting)

    def status(self, now_s: float, *others: str) -> Status:
        """Return the present health, with problems that others have found; call it about once a second."""
        estimator, log = self._estimator, self._log
        by_stream = {DROPPED: self._queue.dropped, WITHOUT_IMU: self._queue.without_imu}
        counts = log.counts + Counter(
            {
                f'{kind} {self._streams[stream]}': count
                for kind, streams in by_stream.items()
                for stream, count in streams.items()
            }
        )
        recent, passed_s = log.recent(counts, now_s)
        inputs = HEADING_INPUTS if self._by_heading else CALIBRATOR_INPUTS
        window_s, knows_camera = self._live.reorder_window_s, self._rig is not None
        problems = [
            *input_problems(log, recent, inputs, knows_camera=knows_camera, window_s=window_s, now_s=now_s),
            *as_warnings(estimator.problems()),
            *as_warnings(self._missing_signals()),
            *as_warnings(str(issue) for issue in self._mounting.issues),
            *as_warnings(filter(None, (self._store.problem, *others))),
            *as_warnings(log.events(now_s)),
        ]
        numbers = {
            **estimator.numbers(self.newest_ns),
            **{f'{name}_hz': round(recent[f'{RECEIVED} {role}'] / passed_s, 1) for name, role in self._rates},
            **{name: count for name, count in sorted(counts.items()) if not name.startswith(RECEIVED)},
        }
        return status(estimator.summary, problems, numbers)

    # --- commands ---------------------------------------------------------------------------------

    def configure(self, config: Config, live: LiveConfig) -> None:
        """Replace the settings; those that are only read at the start have no effect."""
        config = for_reference(config) if self._by_heading else config
        self._estimator.config = self._reckoning.config = config
        self._live = live

    def switch(self, on: bool) -> None:
        """Start or stop the estimation."""
        if not on:
            self._queue = self._new_queue()
        self._estimator.switch(on, self._reckoning.predicted)

    def reset(self) -> str:
        """Discard the calibration; return a clause about its file."""
        self._estimator.reset(self._reckoning.predicted)
        self._applied = self._estimator.trusted
        self._reckoning.recalibrate(self._applied)
        return self._store.discard()

    def save(self) -> str:
        """Write the calibration to its file now; return why that failed, empty where it did not."""
        if self._store.path is None:
            return self._store.problem or 'there is no file: name one in live.calibration'
        return '' if self._store.save(self.calibration, self._estimator.config) else self._store.problem

    def save_if_due(self, now_s: float) -> None:
        """Write the calibration at intervals, if it was estimated and may replace the stored one."""
        if now_s - self._saved_s >= self._live.save_interval_s:
            self._saved_s = now_s
            self._save_if_estimated()

    def close(self) -> None:
        """Process all that still waits, and save."""
        if self._estimator.is_on:
            self._queue.finish()
            while self.has_work:
                self.work()
            self._estimator.finish()
        self._save_if_estimated()

    # --- internals --------------------------------------------------------------------------------

    def _is_plausible(self, role: Role, *values: float) -> bool:
        """Return True if all values are finite and within bounds; count the message otherwise."""
        is_plausible = plausible(values, bounds(role))
        if not is_plausible:
            self._log.add_unusable(role, IMPLAUSIBLE)
        return is_plausible

    def _take(self, topic: str, samples: Sequence[Measurement], now_s: float) -> None:
        self._now_s = now_s
        self._log.add_arrival(topic, now_s)
        if self._estimator.is_on:
            arrival_ns = nanoseconds(now_s) if self._steady else 0
            self._queue.push(self._streams.index(topic), samples, arrival_ns)

    def _new_queue(self) -> InputQueue:
        clock_step_s = STEP_S if self._steady else self._clock_step_s
        window_s = self._live.reorder_window_s
        roles = (Role.IMU, Role.WHEELS) if self._by_heading else ORDERED_ROLES
        ordered = [self._streams.index(role) for role in roles]
        return InputQueue(window_s, max(clock_step_s, 1.5 * window_s), ordered)

    def _update_mounting(self) -> None:
        """Restart with the mounting of the sensors if that has changed."""
        rig, R_bi = self._mounting.rig, self._mounting.R_bi
        if rig is self._rig and R_bi is self._R_bi:
            return
        if R_bi is not None and R_bi is not self._R_bi:
            self._to_body = into_body_axes(R_bi)
        has_imu_moved = self._R_bi is not None and R_bi is not self._R_bi
        if rig is not None and (rig is not self._rig or has_imu_moved):
            self._estimator.set_rig(rig, self._reckoning.predicted)
        self._rig, self._R_bi = rig, R_bi

    def _apply(self) -> SearchRegions | None:
        """Pass the state of the filter to the dead reckoning, if it is trusted."""
        estimator, reckoning = self._estimator, self._reckoning
        slam = estimator.slam
        assert slam is not None
        if estimator.is_trusted:
            reckoning.anchor(slam.state, slam.memories)
        if estimator.trusted is not self._applied:
            if not estimator.is_trusted:
                reckoning.recalibrate(estimator.trusted)
            self._applied = estimator.trusted
        return None if self._by_heading else slam.regions()

    def _missing_signals(self) -> Iterator[str]:
        for signal, names in followers_by_signal(self._model).items():
            if signal not in self._signals:
                yield f'{signal} has not been received yet: {", ".join(names)} cannot be estimated'

    def _log_events(self) -> None:
        for events in (self._queue.events, self._estimator.events):
            for text in events:
                self._log.add_event(text, self._now_s)
            events.clear()

    def _save_if_estimated(self) -> None:
        calibration = self.calibration
        if self._estimator.has_learned and self._store.may_replace(calibration):
            self._store.save(calibration, self._estimator.config)
