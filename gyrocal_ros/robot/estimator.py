"""The filter on a running robot: started, stopped, restarted when it diverges, and checked at each step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Measurement, Rig, seconds
from gyrocal_ros.ekf.history.convergence import Convergence
from gyrocal_ros.ekf.history.scatter import Scatter, traces, with_suspected
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.history.turn_agreement import TurnAgreement
from gyrocal_ros.ekf.map_watch import LOSES_MAPS, MAP_DROPPED, LostMaps
from gyrocal_ros.ekf.noise.noise_bank import MUCH_WALK, walks_more
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW_BIAS, State
from gyrocal_ros.ekf.state.start import Start, initial_state
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import Calibration, calibration_of


class _Words(NamedTuple):
    """Words for what corrects the heading."""

    seen: str
    to_check: str
    where: str


BY_CAMERA = _Words(
    'images',
    'the calibration, the mounting and the stamps of the camera',
    'where the camera sees the ceiling',
)
BY_REFERENCE = _Words(
    'headings', 'the stamps and the jumps of the heading reference', 'while the heading reference works'
)
CHECKPOINT_S = 5.0
"""Time for which the filter has to stay consistent after a state before that becomes the checkpoint."""
CONTRADICTED_S = 30.0
"""Time after which a filter that the measurements contradict is restarted: it does not recover by itself."""
RESTART_INFLATION = 4.0
"""Factor on the covariance of the last good calibration when a diverged filter is restarted."""


class Estimator:
    """The filter, and the last of its states that was consistent with the measurements.

    The calls that may start the filter take the pose at which it starts, as `at`: the state by dead
    reckoning. The first start of all is at the origin of the map.

    Args:
        model: the sensor model.
        config: settings; may be replaced at any time.
        prior: an earlier calibration to start from.
        name: source of the calibration, for its file.
    """

    def __init__(self, model: SensorModel, config: Config, prior: Calibration | None, name: str) -> None:
        self.model, self.name = model, name
        self._stream: SlamStream | None = None
        self.restarts = 0
        """Number of restarts because the filter had diverged."""
        self.dropped = 0
        """Number of features removed from the map because they are not fixed in space."""
        self.events: list[str] = []
        """Events for the user; the reader clears the list."""
        self._config, self._prior = config, prior
        self._rig: Rig | None = None
        self._running_s, self._temperature_c = 0.0, math.nan
        self.is_on = False
        """True if the filter runs, or will run once the camera is known."""
        self.on_probation = False
        """True after a restart, until the filter has been consistent for long enough to be trusted."""
        self._is_changing, self._fault, self._turns = False, '', TurnAgreement()
        self.has_learned = False
        """True once an image has updated the filter since the start or the last reset."""
        self._trusted = initial_state(model, config, self._start)
        self._reset_watch()

    @property
    def slam(self) -> EkfSlam | None:
        """The filter; None while it does not run."""
        return None if self._stream is None else self._stream.slam

    @property
    def config(self) -> Config:
        """The settings."""
        return self._config

    @config.setter
    def config(self, config: Config) -> None:
        self._config = config
        if self.slam is not None:
            self.slam.config = config

    @property
    def is_trusted(self) -> bool:
        """True if the present state may be used: no measurement contradicts it."""
        if self._is_changing or self._fault or (self.on_probation and not self.watch.is_settled):
            return False
        return not self.watch.is_contradicted(self._config.convergence)

    @property
    def trusted(self) -> State:
        """The last state that was trusted."""
        return self._trusted

    @property
    def _model_fits(self) -> bool | str:
        """Whether the model fits, if that can be told: a law may be behind a bias that walks too much."""
        if self._scatter.contradicts:
            return False
        return True if self._scatter.is_judged and self._largest_walk < MUCH_WALK else 'unknown'

    @property
    def calibration(self) -> Calibration:
        """The calibration of the last state that was trusted."""
        watch, prior = self.watch, self._prior
        inflation = self._trusted_inflation
        std = float(np.sqrt(self._trusted.covariance[COEFFICIENTS_START, COEFFICIENTS_START]))
        std *= float(inflation[SCALE])
        was_converged = prior is not None and prior.converged and not watch.is_settled
        is_consistent = was_converged or watch.is_consistent(self._config.convergence)
        is_narrow = std <= self._config.convergence.scale_std
        return calibration_of(
            self._trusted,
            self.model,
            self._config,
            converged=is_narrow and is_consistent and not self._scatter.contradicts and not self.on_probation,
            convergence_time_s=watch.since_s,
            duration_s=self._time_s,
            source=self.name,
            end_ns=self._trusted.t_ns,
            temperature_c=self._temperature_c,
            inflation=inflation,
        )

    def set_rig(self, rig: Rig, at: State) -> None:
        """Set camera and mounting; another camera than before discards the estimate."""
        if self._rig is not None:
            self.events.append('the camera or its mounting has changed; the estimate is restarted')
            self._trusted = initial_state(self.model, self._config, self._start)
            self.has_learned = False
        is_first, self._rig = self._rig is None, rig
        if self.is_on:
            self._start_filter(None if is_first else at)

    def switch(self, on: bool, at: State) -> None:
        """Start the filter from the present calibration, or stop it and keep the calibration."""
        if on == self.is_on:
            return
        self.is_on = on
        if not on:
            self._stop_filter()
        elif self._rig is not None:
            self._prior = self.calibration
            self._start_filter(at)

    def reset(self, at: State) -> None:
        """Discard the estimate, and restart with the priors of the model."""
        self._prior, self.has_learned, self.on_probation = None, False, False
        self._trusted = initial_state(self.model, self._config, None)
        if self.slam is not None:
            self._start_filter(at)
        else:
            self._reset_watch()

    def step(self, measurement: Measurement, at: State) -> bool:
        """Process one measurement; return True if the filter took a step.

        Args:
            measurement: the next in the order of stamps.
            at: state by dead reckoning, in case that the filter has diverged and is restarted.
        """
        assert self._stream is not None
        try:
            return self._check(self._stream.step(measurement))
        except (FilterDivergedError, np.linalg.LinAlgError) as error:
            self._restart(error.what if isinstance(error, FilterDivergedError) else str(error), at)
            return False

    def finish(self) -> None:
        """Process what the filter still holds back, at the end."""
        if self._stream is None:
            return
        try:
            self._check(self._stream.finish())
        except (FilterDivergedError, np.linalg.LinAlgError):
            self._stop_filter()

    # --- health -----------------------------------------------------------------------------------

    @property
    def summary(self) -> str:
        """The calibration in one clause."""
        calibration = self.calibration
        scale = f'scale factor {calibration.scale_factor:.5f} ± {calibration.scale_factor_std:.1g}'
        bias_deg_s = math.degrees(float(calibration.values[0]))
        state = 'calibrated' if self.is_on else 'not estimating; in use'
        return f'{state}: {scale}, bias {bias_deg_s:.4f} deg/s'

    def problems(self) -> Iterator[str]:
        """Yield what is wrong with the estimate."""
        if not self.is_on:
            return
        limits, nis = self._config.convergence, self.watch.recent_nis
        scale_std = self.calibration.scale_factor_std
        words = BY_CAMERA if self._rig is None or self._rig.camera is not None else BY_REFERENCE
        if self._fault:
            yield self._fault
        elif self.on_probation:
            yield 'the filter was restarted and is not trusted yet; the last good calibration is used'
        elif self._is_changing:
            yield 'the scale factor does not fit any more; a new one is being estimated'
        elif not self.is_trusted:
            yield (
                f'the {words.seen} contradict the filter: NIS {max(nis, self.watch.overall_nis):.1f} per '
                f'degree of freedom, up to {limits.nis_high:g} is consistent; the last good calibration is '
                f'used; check {words.to_check}'
            )
        elif self.watch.is_too_calm(limits):
            yield (
                f'the images are less noisy than the filter assumes (NIS {nis:.1f}, from {limits.nis_low:g} '
                'on is consistent): it adapts to that, or lower camera.pixel_noise_px'
            )
        if self.slam is not None and self.slam.finding:
            yield self.slam.finding
        if self._largest_walk >= MUCH_WALK:
            yield f'{walks_more(self._largest_walk)}; record a bag and diagnose it'
        if self._scatter.contradicts:
            yield (
                'the model does not fit: the estimates change by far more than the filter expects; record a '
                'bag and diagnose it'
            )
        if scale_std > limits.scale_std:
            yield (
                'not converged yet: the standard deviation of the scale factor is '
                f'{100.0 * scale_std:.2g} %, {100.0 * limits.scale_std:.2g} % is required; turn both ways '
                f'{words.where}'
            )

    def numbers(self, newest_ns: int) -> dict[str, object]:
        """Return the figures of the estimate, by the names that /diagnostics gives them.

        Args:
            newest_ns: stamp of the newest IMU sample, for the lag of the filter.
        """
        calibration, slam = self.calibration, self.slam
        return {
            'scale_factor': round(calibration.scale_factor, 6),
            'scale_factor_std': float(f'{calibration.scale_factor_std:.2g}'),
            'bias_deg_s': round(math.degrees(float(calibration.values[0])), 5),
            'bias_std_deg_s': float(f'{math.degrees(float(calibration.stds[0])):.2g}'),
            'converged': calibration.converged,
            'estimating': self.is_on,
            'recent_nis': round(self.watch.recent_nis, 3),
            'overall_nis': round(self.watch.overall_nis, 3),
            'model_fits': self._model_fits,
            'pixel_noise_px': round(math.nan if slam is None else slam.track_noise.pixel.std, 3),
            'stamp_noise_s': round(math.nan if slam is None else slam.track_noise.learned_stamp_std_s, 4),
            'wheel_noise_m': round(math.nan if slam is None else slam.wheel_noise.config.distance_noise_m, 4),
            'map_size': 0 if slam is None else len(slam.state.landmarks.ids),
            'features_dropped': self.dropped,
            **(slam.reference_numbers() if slam is not None else {}),
            'filter_lag_s': round(self._lag_s(newest_ns), 3),
            'filter_restarts': self.restarts,
        }

    # --- filter -----------------------------------------------------------------------------------

    @property
    def _start(self) -> Start | None:
        return None if self._prior is None else self._prior.start()

    def _start_filter(self, at: State | None) -> None:
        """Start a filter from the prior, at a pose; None: at the origin of the map."""
        assert self._rig is not None
        self._stop_filter()
        slam = EkfSlam(self.model, self._config, self._rig, self._start, follows_changes=True)
        if at is not None:
            slam.restart_at(at)
        self._stream = SlamStream(slam, self._running_s)
        self._reset_watch()

    def _stop_filter(self) -> None:
        if self._stream is not None:
            self._running_s = self._stream.running_s
        self._stream = None

    def _lag_s(self, newest_ns: int) -> float:
        """Return how far the filter is behind the newest IMU sample."""
        if self._stream is None or not self._stream.has_started:
            return 0.0
        return seconds(newest_ns - self._stream.slam.state.t_ns)

    def _reset_watch(self) -> None:
        self.watch, self._scatter, self._largest_walk = Convergence(), Scatter(traces(self.model)), 1.0
        self._inflation = self._trusted_inflation = self._scatter.inflation
        self._time_s = self._checkpoint_s = self._consistent_s = 0.0
        self._has_stepped = False
        self._checkpoint = self._candidate = self._trusted
        self._lost_maps = LostMaps()

    def _restart(self, why: str, at: State) -> None:
        """Restart a diverged filter from the last checkpoint, with an inflated covariance."""
        self.restarts += 1
        self.events.append(
            f'the filter diverged and was restarted with the last good calibration ({why}); check the camera '
            'and its mounting'
        )
        self._trusted = self._checkpoint
        good = self.calibration
        self._prior = replace(good, covariance=RESTART_INFLATION * good.covariance)
        self._start_filter(at)
        self.on_probation = True

    def _check(self, records: list[StepRecord]) -> bool:
        for record in records:
            self._check_step(record)
        if records and self.slam is not None:
            if self.is_trusted:
                self._trust(self.slam.state)
            elif self._fault or not self.watch.is_contradicted(self._config.convergence):
                self._consistent_s = self._time_s  # a fault of the mounting would survive a new start
            elif self._time_s - self._consistent_s > CONTRADICTED_S:
                raise FilterDivergedError(f'the measurements contradicted it for {CONTRADICTED_S:.0f} s')
        return bool(records)

    def _check_step(self, record: StepRecord) -> None:
        if not (np.isfinite(record.mean).all() and (record.std[YAW_BIAS:] > 0.0).all()):
            raise FilterDivergedError('the estimate is no longer finite')
        stats = record.update.stats
        self.dropped += len(record.update.dropped_ids)
        if self._has_stepped:  # time counts from the first step, as in a replay
            self._time_s += record.block.duration_s
        self._has_stepped = True
        if math.isfinite(temperature_c := float(record.block.temperature_c[-1])):
            self._temperature_c = temperature_c
        self._is_changing = record.scale_change != 0.0
        self._compare_turns(record)
        if record.scale_followed:
            self._begin_anew()
        elif record.bias_walk > self._largest_walk:
            self._largest_walk, self._scatter = record.bias_walk, Scatter(traces(self.model))
        else:
            self._scatter.add(self._time_s, record.change, record.change_variance, record.std[YAW_BIAS:] ** 2)
        self._inflation = with_suspected(self._scatter.inflation, record.suspected_std, record.std[YAW_BIAS:])
        scale_std = float(record.std[COEFFICIENTS_START] * self._inflation[SCALE])
        self.watch.add(self._time_s, scale_std, stats.nis, stats.dof, self._config.convergence)
        if stats.dof > 0:
            self.has_learned = True
        if record.event:
            self.events.append(record.event)
        if MAP_DROPPED in record.event:
            self._lost_maps.add(self._time_s)
            if self._lost_maps.are_many:
                raise FilterDivergedError(LOSES_MAPS)

    def _compare_turns(self, record: StepRecord) -> None:
        block, scale = record.block, COEFFICIENTS_START
        gyro_rad = float(block.rate_rad_s[:, 2] @ block.dt_s)
        self._turns.add(gyro_rad, float(block.wheel_turn_rad.sum()), block.duration_s)
        self._fault = self._turns.fault(1.0 + float(record.mean[scale]), float(record.std[scale]))

    def _begin_anew(self) -> None:
        """Judge the filter by what comes after a change of the scale factor, and do not go back behind it."""
        assert self.slam is not None
        self.watch, self._scatter = Convergence(after_change=True), Scatter(traces(self.model))
        self._checkpoint = self._candidate = self.slam.state
        self._checkpoint_s = self._consistent_s = self._time_s
        if self._prior is not None:
            self._prior = replace(self._prior, converged=False)

    def _trust(self, state: State) -> None:
        self._trusted, self._consistent_s, self.on_probation = state, self._time_s, False
        self._trusted_inflation = np.maximum(self._inflation, self.watch.inflation)
        if self._time_s - self._checkpoint_s >= CHECKPOINT_S:
            self._checkpoint, self._candidate = self._candidate, state
            self._checkpoint_s = self._time_s
