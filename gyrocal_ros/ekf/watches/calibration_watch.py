"""What speaks against the calibration: a scale factor that changes or depends on the rate, a wrong reference.

Each is tested at every step by the innovations. What is suspected adds to the standard deviations, and a
scale factor that has changed is followed where that is wanted, as is the time between images and gyro.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import Array, quickly_filled
from gyrocal_ros.ekf.equations.heading import HeadingReference
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.features.track_noise import TrackNoise
from gyrocal_ros.ekf.noise.noise_bank import NoiseBank, walks_more
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW, YAW_BIAS, State, with_further_errors
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.ekf.watches.camera_faults import CAMERA_ERRORS
from gyrocal_ros.ekf.watches.camera_watch import CameraWatch
from gyrocal_ros.ekf.watches.drift_suspicion import DRIFT_STD, USUAL_DRIFT_STD, HeadingErrors
from gyrocal_ros.ekf.watches.law_watch import LAWS, LawWatch
from gyrocal_ros.ekf.watches.scale_watch import ScaleChange, ScaleWatch
from gyrocal_ros.model.sensor import Effect, SensorModel

MOST_CHANGE = 0.5
"""Largest change of the scale factor that is followed: one that is larger is no change of a gyro."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Suspicions:
    """What the tests of one step have found."""

    std: Array
    """(1 + k,) standard deviations of yaw bias and coefficients by errors that are suspected."""
    change: ScaleChange | None
    """Significant change of the scale factor."""
    followed: bool
    """True if the state follows it."""
    event: str
    """What is new to the user."""
    bias_walk: float
    """Random walk of the bias that is expected, relative to the settings."""


def watched_effects(*, tests_camera: bool, tests_laws: bool) -> tuple[Effect, ...]:
    """Return the effects that are tested, in the order of their columns in the sensitivity."""
    errors = [error.effect for error in CAMERA_ERRORS if tests_camera]
    laws = [law for law, _ in LAWS if tests_laws]
    return (*errors, *laws)


class CalibrationWatch:
    """Tests the scale factor, and the camera or the heading reference.

    Args:
        state: initial state of the filter.
        model: the sensor model.
        config: settings.
        heading: the heading reference; None for a robot with a camera.
        focal_px: focal length of the camera; infinite without one.
        first: index of the first column of these tests in the sensitivity.
        tests_camera: True for a robot with a camera whose features are measured in pixels.
        tests_laws: True to test whether the scale factor depends on the rate.
        is_stored: True if the first scale factor is that of an earlier calibration.
        follows_changes: True to let the state follow a changed scale factor, and a bias that walks by more
            than set.
    """

    def __init__(
        self,
        state: State,
        model: SensorModel,
        config: Config,
        heading: HeadingReference | None,
        focal_px: float,
        *,
        first: int,
        tests_camera: bool,
        tests_laws: bool,
        is_stored: bool,
        follows_changes: bool,
    ) -> None:
        names = {effect.name for effect in model.effects}
        self._camera = CameraWatch(first, names) if tests_camera else None
        after = first + CameraWatch.count if tests_camera else first
        self._laws = LawWatch(after, names, self._camera) if tests_laws else None
        self._watches = [watch for watch in (self._camera, self._laws) if watch is not None]
        self._heading, self._focal_px = heading, focal_px
        unknown = initial_state(model, config, None)
        self._unknown_std = np.sqrt(unknown.covariance.diagonal()[YAW_BIAS:])
        """(1 + k,) standard deviations of yaw bias and coefficients where nothing is known."""
        self._scale = ScaleWatch(
            state,
            sum(watch.count for watch in self._watches),
            DRIFT_STD if heading is None else USUAL_DRIFT_STD,
            config.convergence.scale_std,
            is_stored=is_stored,
        )
        # Beside a heading the filter learns the noise.
        self._noise = NoiseBank(state, follows=follows_changes) if heading is None else None
        self._bias_walk = yaw_noise_of(model, config.gyro, np.zeros(1)).bias_walk_rad_s
        self._told_walk = self._largest_walk = 1.0
        self._follows_changes, self._is_stored = follows_changes, is_stored
        self._has_told, self.finding = False, ''
        """What is wrong with the gyro, the camera or the heading reference; empty where nothing is."""

    @property
    def time_offset_s(self) -> float:
        """Stamp minus true time of the images, as far as the filter follows it."""
        return 0.0 if self._camera is None else self._camera.time_offset_s

    @property
    def unfollowed_walk(self) -> float:
        """Random walk of the bias, relative to the settings, that is certain and not followed."""
        return 1.0 if self._noise is None or self._follows_changes else self._noise.least_walk

    def begin(self, state: State) -> State:
        """Return the state from which changes of the scale factor are tested."""
        return self._scale.begin(state)

    def walk(self, gyro: GyroConfig) -> GyroConfig:
        """Return settings with the random walk of the scale factor that repeated changes show."""
        return self._scale.walk(gyro)

    def wander(self, state: State, duration_s: float) -> State:
        """Add the random walk of the bias over a time beyond that of the settings, as far as it is found."""
        if self._noise is None or self._noise.walk == 1.0:
            return state
        further = self._bias_walk * math.sqrt((self._noise.walk**2 - 1.0) * duration_s)
        return with_further_errors(state, np.array([YAW_BIAS]), further)

    def test(
        self,
        before: State,
        predicted: State,
        state: State,
        duration_s: float,
        updates: tuple[UpdateStats, ...],
        tracks: TrackNoise,
    ) -> tuple[State, Suspicions]:
        """Return the state after the tests of one step, and what they have found.

        Args:
            before: state before the step.
            predicted: the predicted one.
            state: the one after the updates.
            duration_s: length of the step.
            updates: its updates, the last one by the image or the heading.
            tracks: what is known of the errors of the features.
        """
        camera = self._camera
        for watch in self._watches:
            watch.add(duration_s, updates)
        sums = [watch.sums for watch in self._watches]
        turned_rad = float(predicted.mean[YAW] - before.mean[YAW])
        errors = HeadingErrors(
            tracks.common_px / self._focal_px, tracks.turn_px / self._focal_px, tracks.are_tracked
        )
        shift = camera.shift(state) if camera is not None and camera.is_certain else None
        by_camera = 0.0 if shift is None else float(shift[SCALE])
        change = self._scale.add(duration_s, updates, sums, turned_rad, errors, by_camera)
        is_possible = change is not None and abs(change.value) <= MOST_CHANGE
        follows, events = self._follows_changes and self._scale.is_settled and is_possible, []
        if change is not None and follows:
            state = self._scale.follow(state, change)
            if self._is_stored and change.was_calibrated:
                state = self._without_stored(state)
            for watch in self._watches:
                watch.restart()
            if self._noise is not None:
                self._noise.begin(state)
            events += [str(change)] if change.was_calibrated else []
        elif change is None and camera is not None and self._follows_changes:
            state = self._with_time_offset(state, camera, duration_s if updates[-1].dof else 0.0)
        if self._noise is not None:
            self._noise.add(predicted, state, duration_s, 0.0 if self._laws is None else self._laws.explained)
            state = self._with_larger_walk(state, self._noise)
            events += self._walk_events(self._noise.least_walk)
        std = self._suspected_std(state, duration_s)
        if self.finding and not self._has_told:
            events.append(self.finding)
            self._has_told = True
        state = self._scale.renew(state, duration_s)
        walk = 1.0 if self._noise is None else self._noise.walk
        return state, Suspicions(std, change, follows, '; '.join(events), walk)

    def _with_larger_walk(self, state: State, noise: NoiseBank) -> State:
        """Return the state with the errors so far of a walk that it did not expect, once that is known."""
        if noise.walk <= self._largest_walk:
            return state
        self._largest_walk = noise.walk
        state = with_further_errors(state, np.arange(YAW_BIAS, state.robot_size), noise.unexpected_std(state))
        noise.begin(state)
        for watch in self._watches:
            watch.restart()
        return self._scale.begin(state)

    def _without_stored(self, state: State) -> State:
        """Return the state where nothing is known of the coefficients, if there are several.

        The others are of the same earlier calibration as the scale factor that is dropped, perhaps of another
        gyro. What was learned of the scale factor beside them is as wrong as they are.
        """
        self._is_stored = False
        places = np.arange(COEFFICIENTS_START, state.robot_size)
        return with_further_errors(state, places, self._unknown_std[SCALE:]) if len(places) > 1 else state

    def _with_time_offset(self, state: State, camera: CameraWatch, measured_s: float) -> State:
        """Return the state where the time between images and gyro is followed; tests go on from there."""
        told = camera.allowed_for
        state, has_changed = camera.with_time_offset(state, measured_s)
        if not has_changed:
            return state
        self._has_told = self._has_told and camera.allowed_for == told
        if self._laws is not None:
            self._laws.restart()
        if self._noise is not None:
            self._noise.begin(state)
        return self._scale.begin(state)

    def _walk_events(self, least: float) -> Iterator[str]:
        """Yield an event if the bias walks by a larger factor, relative to the settings, than was told."""
        if least > self._told_walk:
            self._told_walk = least
            yield f'{walks_more(least, "at least ")}; `gyrocal diagnose` looks for the cause'

    def _suspected_std(self, state: State, duration_s: float) -> Array:
        """Return the standard deviations by suspected errors, and note what is wrong most of all."""
        std, reference_explains = np.zeros(1 + state.coefficient_count), 0.0
        std[SCALE : SCALE + 1] = self._scale.suspected_std(state)
        if self._camera is not None:
            shift = self._camera.shift(state)
            self.finding = self._camera.finding(duration_s, state, shift)
            std = std if shift is None else np.hypot(std, shift)
            reference_explains = self._camera.explained
        elif self._heading is not None:
            self.finding = self._heading.finding
            std = np.hypot(std, self._heading.suspected_std(self._unknown_std))
        if self._laws is not None:
            law = self._laws.finding(duration_s)
            noise_explains = 0.0 if self._noise is None else self._noise.explained
            if law and self._laws.explained > max(reference_explains, noise_explains):
                self.finding = law
            std = np.hypot(std, self._laws.suspected_std(state))
        return std if self._noise is None else np.hypot(std, self._noise.unexpected_std(state))
