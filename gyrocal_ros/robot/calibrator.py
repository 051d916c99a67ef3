"""The calibrator on a running robot: messages go in as they arrive, what is known comes out at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gyrocal_ros.config.sections import Config, LiveConfig
from gyrocal_ros.data import (
    CalibratedSample,
    CameraIntrinsics,
    CovariateSample,
    FeatureObservations,
    ImuSample,
    Measurement,
    OdometryEstimate,
    SearchRegions,
    TemperatureSample,
    WheelSample,
    nanoseconds,
    seconds,
)
from gyrocal_ros.ekf.motion import SPEED_SIGNAL
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.mounts import into_body_axes
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.robot.calibration_store import CalibrationStore
from gyrocal_ros.robot.calibrator_health import CalibratorHealth, Facts
from gyrocal_ros.robot.dead_reckoning import DeadReckoning
from gyrocal_ros.robot.estimator import Estimator
from gyrocal_ros.robot.health import Status
from gyrocal_ros.robot.input_queue import STEP_S, InputQueue
from gyrocal_ros.robot.mounting import Mounting

LARGEST = 1e5
"""No sensor of a robot reads so much, in SI units."""
PUNCTUAL = (Role.IMU, Role.WHEELS, Role.FEATURES)
"""What the filter goes on by. Each comes in its order, and when all of them have passed a moment it goes
on at once, so that the tracker has its word before the next image."""


class LiveCalibrator:
    """Takes what a robot measures, estimates, and keeps the calibration.

    After each call that takes something in, call `work` until it has nothing left.

    Args:
        model: the sensor model.
        config: settings of the estimator.
        live: settings of the calibrator itself.
        name: where the calibration comes from, for its file.
        steady: the times of arrival count: the clock of the stamps runs as the steady one does. Not so
            where time is simulated.
        now_s: the time by a clock that is never set, as everywhere here.

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
        self._live, self._steady, self._clock_step_s = live, steady, config.recording.clock_step_s
        self._keeper = CalibrationStore(Path(live.calibration).expanduser() if live.calibration else None)
        known = self._keeper.load(config)
        self._estimator = Estimator(model, config, known, name, lambda: self._reckoner.ahead)
        self._served = self._estimator.served
        self._reckoner = DeadReckoning(model, config, self._served, 1.25 * live.reorder_window_s)
        self._mounting = Mounting(config.camera)
        self._rig, self._R_bi = self._mounting.rig, self._mounting.R_bi
        self._streams = [str(role) for role in Role]
        self._signals = {SPEED_SIGNAL}
        self._turn = into_body_axes(np.eye(3))
        self._intake = self._new_intake()
        self._health = CalibratorHealth(model, now_s)
        self._now_s = self._saved_s = now_s
        self.newest_ns = 0
        """Stamp of the last IMU sample: what the clock of the sensors shows now, 0 before the first."""
        self.switch(live.estimate)

    # --- what comes in ---------------------------------------------------------------------------

    def imu(self, sample: ImuSample, frame: str, now_s: float) -> CalibratedSample | None:
        """Take a sample in the IMU's own axes; return the true one, None until the IMU's mount is known."""
        if not self._is_sound(Role.IMU, *sample.rate_rad_s, *sample.specific_force_m_s2):
            return None
        self._take(Role.IMU, (sample,), now_s)
        self._mounting.hear_imu(sample, frame)
        self._look_at_mounting()
        self.newest_ns = sample.t_ns
        return None if self._R_bi is None else self._reckoner.imu(self._turn(sample))

    def wheels(self, sample: WheelSample, now_s: float) -> OdometryEstimate | None:
        """Take a reading of the encoders; return where the robot was then, None while nobody knows."""
        if not self._is_sound(Role.WHEELS, sample.speed_m_s, sample.yaw_rate_rad_s):
            return None
        self._take(Role.WHEELS, (sample,), now_s)
        return self._reckoner.wheels(sample)

    def features(self, seen: FeatureObservations, frame: str, now_s: float) -> None:
        """Take what the tracker saw in one image."""
        self._take(Role.FEATURES, (seen,), now_s)
        if len(seen.ids):
            self._health.see(now_s)
        self._mounting.hear_features(frame)
        self._look_at_mounting()

    def temperature(self, sample: TemperatureSample, now_s: float) -> None:
        """Take a temperature."""
        if not self._is_sound(Role.TEMPERATURE, sample.temperature_c):
            return
        self._take(Role.TEMPERATURE, (sample,), now_s)
        self._signals.add('temperature')
        self._reckoner.add(sample)

    def signal(self, sample: CovariateSample, now_s: float) -> None:
        """Take a number that effects follow; NaN where it is not measured."""
        if not math.isfinite(sample.value):
            return
        if sample.name not in self._streams:
            self._streams.append(sample.name)
        self._take(sample.name, (sample,), now_s)
        self._signals.add(sample.name)
        self._reckoner.add(sample)

    def camera(self, camera: CameraIntrinsics, frame: str, now_s: float) -> None:
        """Take what `camera_info` says."""
        self._health.hear(Role.CAMERA_INFO, now_s)
        self._mounting.hear_camera(camera, frame)
        self._look_at_mounting()

    def links(self, links: Iterable[Transform]) -> None:
        """Take static transforms."""
        self._mounting.hear_links(links)
        self._look_at_mounting()

    def spoiled(self, topic: str, why: str) -> None:
        """Note a message that means nothing."""
        self._health.spoil(topic, why)

    # --- what comes out --------------------------------------------------------------------------

    def work(self) -> SearchRegions | None:
        """Let the filter go one step on, if it can; return where it expects its features then.

        The tracker carries these regions to its next image by itself, so that it does on the robot what
        it does in a recording (see `vision.gyro_aided_tracker`).
        """
        slam = self._estimator.slam
        if slam is None or self._R_bi is None:
            return None
        waiting, went_on = self._intake.waiting, False
        while waiting and not went_on:
            measurement = waiting.popleft()
            if isinstance(measurement, ImuSample):
                measurement = self._turn(measurement)
            went_on = self._estimator.step(measurement)
        self._tell_events()
        return self._serve() if went_on else None

    @property
    def calibration(self) -> Calibration:
        """What is known of the gyro."""
        return self._estimator.calibration

    @property
    def filter(self) -> EkfSlam | None:
        """The filter with its map, while there is one."""
        return self._estimator.slam

    @property
    def has_work(self) -> bool:
        """Whether `work` would have something to do."""
        return self._estimator.slam is not None and self._R_bi is not None and bool(self._intake.waiting)

    def status(self, now_s: float, *others: str) -> Status:
        """How it is, with what others find wrong; to be asked once a second or so."""
        estimator, watch = self._estimator, self._estimator.watch
        slam = estimator.slam
        left_out, useless = self._intake.left_out, self._intake.useless
        facts = Facts(
            calibration=self.calibration,
            convergence=estimator.config.convergence,
            is_estimating=self._estimator.is_on,
            knows_camera=self._rig is not None,
            is_trusted=estimator.is_trusted,
            on_probation=estimator.on_probation,
            recent_nis=watch.recent_nis,
            overall_nis=watch.overall_nis,
            restarts=estimator.restarts,
            map_size=0 if slam is None else len(slam.state.landmarks.ids),
            pixel_noise_px=math.nan if slam is None else slam.pixel_noise.std,
            lag_s=seconds(self.newest_ns - slam.state.t_ns) if slam and slam.has_started else 0.0,
            window_s=self._live.reorder_window_s,
            left_out=Counter({self._streams[stream]: count for stream, count in left_out.items()}),
            useless=Counter({self._streams[stream]: count for stream, count in useless.items()}),
            signals=frozenset(self._signals),
            standing=(
                *(str(finding) for finding in self._mounting.findings),
                *filter(None, (self._keeper.complaint, *others)),
            ),
        )
        return self._health.tell(facts, now_s)

    # --- orders ----------------------------------------------------------------------------------

    def configure(self, config: Config, live: LiveConfig) -> None:
        """Go on with other settings; of those that need a new start, nothing is heard."""
        self._estimator.config = self._reckoner.config = config
        self._live = live

    def switch(self, on: bool) -> None:
        """Estimate, or do so no more."""
        if not on:
            self._intake = self._new_intake()
        self._estimator.switch(on)

    def reset(self) -> str:
        """Forget the calibration; return what became of its file."""
        self._estimator.reset()
        self._reckoner.recalibrate(self._estimator.served)
        self._served = self._estimator.served
        return self._keeper.forget()

    def save(self) -> str:
        """Write the calibration to its file now; return what went wrong, empty for nothing."""
        if self._keeper.path is None:
            return self._keeper.complaint or 'there is no file: name one in live.calibration'
        return '' if self._keeper.save(self.calibration, self._estimator.config) else self._keeper.complaint

    def save_if_due(self, now_s: float) -> None:
        """Write the calibration at intervals, where it was learned and is worth it."""
        if now_s - self._saved_s >= self._live.save_interval_s:
            self._saved_s = now_s
            self._save_what_was_learned()

    def close(self) -> None:
        """Use all that still waits, and save."""
        if self._estimator.is_on:
            self._intake.finish()
            while self.has_work:
                self.work()
            self._estimator.finish()
        self._save_what_was_learned()

    # --- how -------------------------------------------------------------------------------------

    def _is_sound(self, topic: str, *numbers: float) -> bool:
        """Whether numbers can be true; NaN and what is beyond all bounds is noted."""
        is_sound = all(abs(number) < LARGEST for number in numbers)
        if not is_sound:
            self._health.spoil(topic, 'the numbers cannot be (NaN, or far too large); look after its driver')
        return is_sound

    def _take(self, topic: str, samples: Sequence[Measurement], now_s: float) -> None:
        self._now_s = now_s
        self._health.hear(topic, now_s)
        if self._estimator.is_on:
            arrival_ns = nanoseconds(now_s) if self._steady else 0
            self._intake.push(self._streams.index(topic), samples, arrival_ns)

    def _new_intake(self) -> InputQueue:
        clock_step_s = STEP_S if self._steady else self._clock_step_s
        window_s = self._live.reorder_window_s
        punctual = [self._streams.index(role) for role in PUNCTUAL]
        return InputQueue(window_s, max(clock_step_s, 1.5 * window_s), punctual)

    def _look_at_mounting(self) -> None:
        """Begin with what is known now of the mounting of the sensors, if that is new."""
        rig, R_bi = self._mounting.rig, self._mounting.R_bi
        if rig is self._rig and R_bi is self._R_bi:
            return
        if R_bi is not None and R_bi is not self._R_bi:
            self._turn = into_body_axes(R_bi)
        is_imu_new = self._R_bi is not None and R_bi is not self._R_bi
        if rig is not None and (rig is not self._rig or is_imu_new):
            self._estimator.set_rig(rig)
        self._rig, self._R_bi = rig, R_bi

    def _serve(self) -> SearchRegions | None:
        """Hand the filter's state on to the dead reckoning, if it is trusted."""
        estimator, reckoner = self._estimator, self._reckoner
        slam = estimator.slam
        assert slam is not None
        if estimator.is_trusted:
            reckoner.anchor(slam.state, slam.memories)
        if estimator.served is not self._served:
            if not estimator.is_trusted:
                reckoner.recalibrate(estimator.served)
            self._served = estimator.served
        return slam.regions()

    def _tell_events(self) -> None:
        for events in (self._intake.events, self._estimator.events):
            for text in events:
                self._health.happened(text, self._now_s)
            events.clear()

    def _save_what_was_learned(self) -> None:
        calibration = self.calibration
        if self._estimator.has_learned and self._keeper.is_better(calibration):
            self._keeper.save(calibration, self._estimator.config)
