"""EKF SLAM with self-calibration: the algorithm on one page.

Lee, Choi, Park, Myung 2012, section 2.3. `stream` cuts IMU and wheel samples into blocks that end where the
camera, or another heading reference, measures; `EkfSlam.step` takes one block and that measurement.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import (
    Array,
    FeatureObservations,
    HeadingSample,
    IntArray,
    MotionBlock,
    Rig,
    SearchRegions,
    changed,
    seconds,
)
from gyrocal_ros.ekf.equations.effects_by_place import PoseMotion, pose_motion, sort_effects, true_camera
from gyrocal_ros.ekf.equations.heading import HeadingReference, ModelLag
from gyrocal_ros.ekf.equations.levelling import Levelling, unlevelled
from gyrocal_ros.ekf.equations.predict import FilterModel, Transition, predict, predict_sensitivity, with_pose
from gyrocal_ros.ekf.equations.steady_rate import SteadyRate, with_acceleration
from gyrocal_ros.ekf.equations.update import MeasurementUpdate, UpdateStats, zero_rate_update
from gyrocal_ros.ekf.features.admission import Admission
from gyrocal_ros.ekf.features.certain_way import is_certain, without_way
from gyrocal_ros.ekf.features.considered import stretch_by_values
from gyrocal_ros.ekf.features.frozen_camera import FrozenCamera
from gyrocal_ros.ekf.features.gating import MotionGate
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.features.knock_watch import KnockWatch
from gyrocal_ros.ekf.features.known_depth import TellingWay
from gyrocal_ros.ekf.features.landmarks import forget, forget_all
from gyrocal_ros.ekf.features.moving_features import MovingFeatures
from gyrocal_ros.ekf.features.resting_view import RestingView
from gyrocal_ros.ekf.features.track_noise import TrackNoise
from gyrocal_ros.ekf.features.way_agreement import WayAgreement
from gyrocal_ros.ekf.history.step_record import StepRecord, step_record
from gyrocal_ros.ekf.image_update import add_landmarks, search_regions, update_from_image
from gyrocal_ros.ekf.map_watch import CONTRADICTED, MAP_DROPPED, MapWatch, SlipWatch
from gyrocal_ros.ekf.noise.rest import RestDetector, RestNoise
from gyrocal_ros.ekf.noise.wheel_noise import WheelNoise
from gyrocal_ros.ekf.state.layout import YAW, YAW_BIAS, State
from gyrocal_ros.ekf.state.pauses import drifted, inflate_after_gap, restarted_at
from gyrocal_ros.ekf.state.start import Start, aged, initial_state, warmed
from gyrocal_ros.ekf.watches.calibration_watch import CalibrationWatch, watched_effects
from gyrocal_ros.ekf.watches.scale_watch import COLUMNS
from gyrocal_ros.errors import ConfigError, IndefiniteCovarianceError
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import PosedCamera, posed_camera
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.statistics import chi_square_quantile

Seen = FeatureObservations | HeadingSample
NONE: IntArray = np.empty(0, np.int64)


class EkfSlam:
    """The estimator.

    Args:
        model: the sensor model whose coefficients are estimated.
        config: settings.
        rig: camera and its mounting, as assumed.
        start: result of an earlier run.
        candidates: effects that the model lacks; the sensitivities to them are computed, for the tests.
        follows_changes: True to let a changed scale factor go as soon as the measurements show the change,
            False to keep one scale factor for the whole recording and only record the change.
    """

    def __init__(
        self,
        model: SensorModel,
        config: Config,
        rig: Rig,
        start: Start | None = None,
        candidates: tuple[Effect, ...] = (),
        follows_changes: bool = False,
    ) -> None:
        self.model, self.config, self.rig = model, config, rig
        self.parametrisation = PARAMETRISATIONS[config.features.parametrisation]
        tests_laws = self.parametrisation.rows == 2
        tests_camera = tests_laws and rig.camera is not None
        watched = watched_effects(tests_camera=tests_camera, tests_laws=tests_laws)
        self._effects = sort_effects(model.effects)
        self._candidates = sort_effects((*candidates, *watched), more=COLUMNS)
        self._own_candidates = sum(len(effect.coefficients) for effect in candidates)
        if self.parametrisation.rows != 2 and (self._effects.act_on_images or self._candidates.act_on_images):
            raise ConfigError(
                'effects on the camera need features measured in pixels',
                where='features.parametrisation',
                todo='use inverse_depth',
            )
        self.state: State = initial_state(model, config, start, self._candidates.count)
        self._to_age = self._to_warm = start
        self._pause = ''  # event of a time without measurements, for the next step
        self.memories = self._effects.no_memories()
        """Memories of the gyro effects at the present state."""
        self._candidate_memories = self._candidates.no_memories()
        self._motion = PoseMotion(np.zeros(6), np.zeros(6))
        self._way_noise_m: Array | None = None
        self._stretch_by_values: Array | None = None
        self._telling_way, self.wheel_noise = TellingWay(), WheelNoise(config.wheels)
        self._rest, self._motion_gate = RestDetector(), MotionGate()
        self._map_watch, self._slip_watch, self._knock_watch = MapWatch(), SlipWatch(), KnockWatch()
        self._moving, self._admission, self._resting_view = MovingFeatures(), Admission(), RestingView()
        self._steady, self._frozen, self._way = SteadyRate(), FrozenCamera(), WayAgreement()
        self._heading = HeadingReference(config.reference, config.gyro, ModelLag.of(model, self.state))
        at_first = config.gyro if config.reference.estimate_noise else config.rest
        self._rest_noise = RestNoise(math.radians(at_first.rate_noise_deg_s))
        self._levelling: Levelling | None = None
        if rig.camera is None:
            self._levelling, self.state = Levelling(), unlevelled(self.state)
        self.watch = CalibrationWatch(
            self.state,
            model,
            config,
            self._heading if rig.camera is None else None,
            math.inf if rig.camera is None else rig.camera.fx_px,
            first=self._own_candidates,
            tests_camera=tests_camera,
            tests_laws=tests_laws,
            is_stored=start is not None,
            follows_changes=follows_changes,
        )
        self.state = self.watch.begin(self.state)
        self.expect_pixel_noise(config.camera.pixel_noise_px)

    def step(self, block: MotionBlock, seen: Seen | None = None) -> StepRecord:
        """Predict over one block of samples and correct the estimate by the measurement at its end.

        Raises:
            FilterDivergedError: the measurements contradict the estimate beyond repair.
        """
        before = self._warmed(block)
        is_at_rest = self._rest.is_at_rest(block, self.config.rest.settle_s)
        if self._levelling is None:
            self._frozen.move(block)
            self._way.move(block, float(before.mean[YAW_BIAS]))
        else:
            self._heading.move(block, self._rest_noise.density_rad_s if is_at_rest else None)

        # Prediction: eq. (10) for the robot, eq. (11) for the features; sensitivities of the candidates.
        block = with_pose(block, before)
        gyro = self._gyro_noise(block)
        steady = self._steady.without_noise(block, gyro, is_at_rest=is_at_rest)
        block = with_acceleration(block, steady) if is_at_rest else block
        gyro, sway = self._noise_at_rest(block, gyro, is_at_rest=is_at_rest)
        transition = self._predict(before, block, steady, gyro)
        predicted = self.state = self.watch.wander(self.state, block.duration_s)

        # Zero-rate update: a robot that stands still does not turn.
        resting = UpdateStats()
        if is_at_rest:
            gate = chi_square_quantile(1.0 - self.config.features.outlier_probability, 3)
            self.state, resting = zero_rate_update(before, self.state, transition.matrix, sway, gate)

        # A heading reference wanders also at rest, and its frame is that of the heading.
        self.state = self._heading.wander(self.state, block.duration_s)

        # Levelling: without a camera gravity bounds roll and pitch.
        if self._levelling is not None:
            self.state = self._levelling.update(self.state, block)

        # Measurement update: eqs. (12) to (14), or a heading; new features join the map: eqs. (15) to (22).
        update, event = self._measure(seen, is_at_rest=resting.dof > 0)

        # Tests: scale factor or camera may be wrong. At rest images err alike, for the position is kept.
        stats = resting, update.stats.of_first(0) if resting.dof else update.stats
        self.state, suspicions = self.watch.test(
            before, predicted, self.state, block.duration_s, stats, self.track_noise
        )

        pause, self._pause = self._pause, ''
        return step_record(
            before,
            predicted,
            self.state,
            block,
            transition,
            changed(update, stats=update.stats.of_first(self._own_candidates)),
            resting.of_first(self._own_candidates),
            self.track_noise,
            '; '.join(filter(None, (pause, event, suspicions.event))),
            suspicions,
        )

    @property
    def finding(self) -> str:
        """What is wrong with the gyro, the camera or the heading reference; empty where nothing is."""
        return self._way.finding or self.watch.finding

    def _gyro_noise(self, block: MotionBlock) -> GyroConfig:
        """Return the noise of the gyro in motion."""
        gyro = self.config.gyro
        if self._levelling is None:  # the noise of a heading reference is learned with that of the gyro
            gyro = self._steady.with_noise(block, gyro, self._effects)
        return self.watch.walk(gyro)

    def _noise_at_rest(
        self, block: MotionBlock, gyro: GyroConfig, *, is_at_rest: bool
    ) -> tuple[GyroConfig, Array | float]:
        """Return the noise of the gyro, which may be another at rest, and the std (rad) of the sway there."""
        sway_rad = math.radians(self.config.rest.rotation_noise_deg)
        sway: Array | float = sway_rad
        if self._levelling is None:
            return gyro, sway
        if is_at_rest:  # images see the sway between them; beside headings it is noise of the gyro
            gyro, sway = self._rest_noise.split(gyro, sway_rad, block.duration_s)
        if self.config.reference.estimate_noise:
            self._rest_noise.add(block, is_at_rest=is_at_rest)
        return gyro, sway

    def _predict(
        self, before: State, block: MotionBlock, steady: MotionBlock, gyro: GyroConfig
    ) -> Transition:
        """Predict state and sensitivity, and note the motion that the next image needs."""
        is_way_noise = not is_certain(block, self.config.wheels)
        steady = without_way(steady) if is_way_noise else steady
        if self._levelling is None:
            rates = self._steady.tilt_noise_rad_s, self._steady.change_rad_s
        else:
            rates = self._levelling.rate_noise_rad_s(block).tolist(), 0.0
        model = FilterModel(self.model, self._effects, gyro, self.wheel_noise.config, *rates)
        self.state, transition = predict(before, block, model, self.memories, steady)
        self.memories = transition.contribution.correction.memories
        self.state, self._candidate_memories = predict_sensitivity(
            self.state, transition, steady, self._candidates, self._candidate_memories
        )
        self._motion = pose_motion(transition.motion, block)
        self.wheel_noise.move(block)
        forward, drift_by_values = transition.motion.forward, transition.contribution.drift_by_values
        self._stretch_by_values = None
        if is_way_noise:
            way_m = forward @ block.distance_m
            self._way_noise_m = way_m if self._way_noise_m is None else self._way_noise_m + way_m
        elif drift_by_values is not None:
            self._stretch_by_values = stretch_by_values(forward @ block.distance_m, drift_by_values)
        return transition

    def _measure(self, seen: Seen | None, *, is_at_rest: bool) -> tuple[MeasurementUpdate, str]:
        """Update by a heading or an image; return what was updated, and an event."""
        if seen is None:
            return MeasurementUpdate(), ''
        if isinstance(seen, HeadingSample):
            self.state, update = self._heading.update(
                self.state, seen, self._effects, self._candidates, self._motion.rate
            )
            return update, update.event
        if self._frozen.repeats(seen):
            return MeasurementUpdate(), self._frozen.event()
        assert self.rig.camera is not None
        turned, rate = self._way.event(seen, self.rig.camera, self.rig.camera_mount), self._motion.rate[YAW]
        try:
            update, knock = self._knock_watch.see(self._update_from_image(seen, is_at_rest=is_at_rest), rate)
        except IndefiniteCovarianceError:
            if not (self.parametrisation.is_robust and self._map_watch.may_be_bent()):
                raise
            update, knock = CONTRADICTED, ''  # images of something else have bent the map
        event = self._slip_watch.event(update, self.state.t_ns)
        if self._map_watch.is_lost(update, self.track_noise.pixel) or update is CONTRADICTED:
            self.state, event, self._telling_way = forget_all(self.state), MAP_DROPPED, TellingWay()
        return update, '; '.join(filter(None, (turned, event, knock)))

    def _update_from_image(self, observations: FeatureObservations, *, is_at_rest: bool) -> MeasurementUpdate:
        features = self.config.features
        if self.parametrisation.needs_motion_gate and not self._motion_gate.passes(self.state, features):
            return MeasurementUpdate()
        self.track_noise.see(observations.covariances_px2)
        gone_ids = self._remove_shifted(observations, is_at_rest=is_at_rest)
        # A tracker that tells how well patches match finds them again: at rest it has nothing new to tell.
        is_known = observations.covariances_px2 is not None and self._resting_view.is_still
        model = self._image_model(is_known=is_known, stays=is_at_rest)
        self.state, update = update_from_image(self.state, model, observations)
        self._way_noise_m = None
        if update.used:
            self.wheel_noise.learn(update.by_position, float(self.state.mean[YAW]))
        self._telling_way.see(self.state, model.view)
        if not is_at_rest and self._agrees(update) and len(ids := self._moving.find(self.state, update)):
            self.state, gone_ids = forget(self.state, ids), np.concatenate([gone_ids, ids])
        self._moving.add(update.dropped_ids if update.event else NONE)  # they turn with the camera
        self._moving.update(observations.ids, update.dropped_ids)
        new = self._admission.choose(self.state, observations.ids, self._moving, features.map_size)
        if new:
            placed = self._admission.placed(self.state)
            self.state = add_landmarks(placed, self._image_model(), observations, new)
        if self.config.camera.estimate_pixel_noise:
            self.track_noise.learn(update, agrees=self._agrees(update))
        dropped_ids = np.concatenate([gone_ids, update.dropped_ids]) if len(gone_ids) else update.dropped_ids
        return changed(update, added=len(new), on_lens=observations.on_lens, dropped_ids=dropped_ids)

    def _agrees(self, update: MeasurementUpdate) -> bool:
        """Return True if an image agrees with the map: a depth that changes is then no fault of the map."""
        largest = self.config.convergence.nis_high * update.stats.dof
        return self.parametrisation.is_anchored and 0.0 < update.stats.nis < largest

    def _remove_shifted(self, observations: FeatureObservations, *, is_at_rest: bool) -> IntArray:
        """Remove features from the map that shift while the robot stands still; return their ids."""
        if not is_at_rest:
            self._resting_view.leave()
            return NONE
        ids, pixels = observations.ids, observations.pixels
        shifted, moving = self._resting_view.see(ids, pixels, self.view(), self.track_noise.pixel.std)
        self._moving.add(moving)
        removed = np.intersect1d(self.state.landmarks.ids, [*shifted, *moving])
        self.state = forget(self.state, removed)
        return removed

    def _warmed(self, block: MotionBlock) -> State:
        """Return the state; at the first temperature after an earlier calibration, with its change since."""
        temperature_c = float(block.temperature_c[0])
        if self._to_warm is None or not math.isfinite(temperature_c):
            return self.state
        start, self._to_warm = self._to_warm, None
        return warmed(self.state, self.model, start, temperature_c, self.config.gyro)

    def _image_model(self, *, is_known: bool = False, stays: bool = False) -> ImageModel:
        return ImageModel(
            view=self.view(),
            rig=self.rig,
            form=self.parametrisation,
            config=self.config,
            noise_px=self.track_noise.pixel.std,
            match_px=self.track_noise.match_px,
            effects=self._effects,
            candidates=self._candidates,
            scored=self._own_candidates,
            motion=self._motion,
            way_noise_m=self._way_noise_m,
            stretch_by_values=self._stretch_by_values,
            interval_s=seconds(self.state.t_ns - max(self.state.landmarks.last_seen_ns.tolist(), default=0)),
            has_moved=self._telling_way.tells or not self.parametrisation.is_anchored,
            slow_variance_px=self.track_noise.slow_variance_px,
            stamp_std_s=self.track_noise.stamp_std_s,
            errors_repeat=self.track_noise.errors_repeat,
            is_known=is_known,
            stays=stays and self.parametrisation.is_anchored,
            slip=self._slip_watch.slip(self.state.t_ns, drives=self.wheel_noise.drives),
        )

    # --- queries and settings for other rooms -----------------------------------------------------

    def view(self) -> PosedCamera:
        """Return the camera at the present estimate, corrected by the effects on it."""
        assert self.rig.camera is not None
        state = self.state
        camera, mount = true_camera(self._effects, self.rig.camera, self.rig.camera_mount, state.coefficients)
        return posed_camera(camera, mount, state.position_m, state.euler_rad)

    def regions(self) -> SearchRegions:
        """Return where the mapped features are expected in an image taken now."""
        return search_regions(self.state, self._image_model())

    def time_offset_s(self) -> float:
        """Return the estimated stamp error of images or headings: stamp minus true time."""
        offset_s = self._heading.time_offset_s + self.watch.time_offset_s
        for _, place in self._effects.time:
            offset_s += float(self.state.coefficients[place][0])
        return offset_s

    def reference_numbers(self) -> dict[str, float]:
        """Return noise and time offset of the heading reference, by the names of /diagnostics; {} before."""
        return self._heading.numbers() if self.rig.camera is None else {}

    def expect_pixel_noise(self, std_px: float) -> None:
        """Restart the estimation of the pixel noise at this standard deviation."""
        is_known = not self.config.camera.estimate_pixel_noise
        self.track_noise = TrackNoise(std_px, is_robust=self.parametrisation.is_robust, is_known=is_known)

    def start_at(self, t_ns: int) -> None:
        """Set the time of the first sample, or of the first one of a new time base."""
        self.state = changed(self.state, t_ns=t_ns)
        if self._to_age is not None:
            self.state = aged(self.state, self.model, self._to_age, self.config.gyro)
            self._to_age = None

    def restart_at(self, state: State) -> None:
        """Move the initial estimate to about the pose of another state."""
        self.state = restarted_at(self.state, state)

    def skip_to(self, t_ns: int) -> None:
        """Skip a time without gyro and without images: keep the calibration and drop the map."""
        pause_s = seconds(t_ns - self.state.t_ns)
        self.start_new_time_base(t_ns)
        self.state = drifted(self.state, self.model, pause_s, self.config.gyro)
        self._pause = f'neither gyro nor images for {pause_s:.0f} s; a new map was started'

    def start_new_time_base(self, t_ns: int) -> None:
        """Keep the calibration and drop the map: the motion during the step of the clock is unknown."""
        self._rest, self._steady = RestDetector(), SteadyRate()
        self._telling_way, self._way_noise_m = TellingWay(), None
        self.wheel_noise.forget()
        self._heading.forget_alignment()
        self.state = inflate_after_gap(forget_all(self.state), t_ns)
