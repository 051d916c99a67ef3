"""The filter on a running robot: begun, stopped, begun anew when it is lost; never trusted blindly."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Measurement, Rig
from gyrocal_ros.ekf.convergence import Convergence
from gyrocal_ros.ekf.slam import EkfSlam, StepRecord
from gyrocal_ros.ekf.start import Start, initial_state, restarted_at
from gyrocal_ros.ekf.state import COEFFICIENTS_START, YAW_BIAS, State
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import Calibration, calibration_of

CHECKPOINT_S = 5.0
"""A state is good to go back to when the filter has run well for so long since."""
MAPS_LOST, MAPS_LOST_S = 3, 60.0
"""So many new maps within so long: the filter is lost, whatever its numbers say."""
DISTRUST_S = 30.0
"""A filter that was contradicted for so long does not find back by itself."""
WIDENING = 4.0
"""How much larger the variances are when the filter is begun anew."""


class Estimator:
    """The filter, and what of it is served.

    Args:
        model: the sensor model.
        config: settings; may be exchanged for others at any time.
        known: an earlier calibration to start from.
        name: where the calibration comes from, for the file.
        where: the robot's state by dead reckoning, to begin anew there.
    """

    def __init__(
        self,
        model: SensorModel,
        config: Config,
        known: Calibration | None,
        name: str,
        where: Callable[[], State],
    ) -> None:
        self.model, self.name = model, name
        self.watch = Convergence()
        self.slam: EkfSlam | None = None
        self.restarts = 0
        """How often the filter had to be begun anew because it was lost."""
        self.events: list[str] = []
        """What happened that a person should know; the reader clears it."""
        self._config, self._known, self._where = config, known, where
        self._rig: Rig | None = None
        self._running_s = 0.0
        self.is_on = False
        """Whether it estimates, as soon as it can."""
        self.on_probation = False
        """Just begun anew: it has to prove itself before it is trusted."""
        self.has_learned = False
        """Whether the camera has taught anything since the start, or since all was forgotten."""
        self._served = initial_state(model, config, self._start)
        self._begin_watch()

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
        """Whether the present state may be served: nothing measured contradicts it."""
        if self.on_probation and not self.watch.is_settled:
            return False
        return not self.watch.is_contradicted(self._config.convergence)

    @property
    def served(self) -> State:
        """The last state that was trusted."""
        return self._served

    @property
    def calibration(self) -> Calibration:
        """What is known of the gyro, by the last state that was trusted."""
        watch, known = self.watch, self._known
        std = float(np.sqrt(self._served.covariance[COEFFICIENTS_START, COEFFICIENTS_START]))
        was_converged = known is not None and known.converged and not watch.is_settled
        is_healthy = was_converged or watch.is_consistent(self._config.convergence)
        is_narrow = std <= self._config.convergence.scale_std
        return calibration_of(
            self._served,
            self.model,
            self._config,
            converged=is_narrow and is_healthy and not self.on_probation,
            convergence_time_s=watch.since_s,
            duration_s=self._time_s,
            source=self.name,
            end_ns=self._served.t_ns,
        )

    def set_rig(self, rig: Rig) -> None:
        """Take in where the camera sits; what was learned with it elsewhere is not kept."""
        if self._rig is not None:
            self.events.append('the camera or its mounting has changed; the estimate is begun anew')
            self._served = initial_state(self.model, self._config, self._start)
            self.has_learned = False
        is_first, self._rig = self._rig is None, rig
        if self.is_on:
            self._begin(at_origin=is_first)

    def switch(self, on: bool) -> None:
        """Estimate, from what was learned before, or do so no more: that is kept and served."""
        if on == self.is_on:
            return
        self.is_on = on
        if not on:
            self._end()
        elif self._rig is not None:
            self._known = self.calibration
            self._begin()

    def reset(self) -> None:
        """Forget what was learned; begin with the priors."""
        self._known, self.has_learned, self.on_probation = None, False, False
        self._served = initial_state(self.model, self._config, None)
        if self.slam is not None:
            self._begin()
        else:
            self._begin_watch()

    def step(self, measurement: Measurement) -> bool:
        """Take one measurement; return whether the filter went on by it."""
        assert self.slam is not None
        try:
            return self._note(self.slam.step(measurement))
        except (FilterDivergedError, np.linalg.LinAlgError) as error:
            self._begin_anew(error.what if isinstance(error, FilterDivergedError) else str(error))
            return False

    def finish(self) -> None:
        """Use what still waits, at the end."""
        if self.slam is None:
            return
        try:
            self._note(self.slam.finish())
        except (FilterDivergedError, np.linalg.LinAlgError):
            self._end()

    @property
    def _start(self) -> Start | None:
        return None if self._known is None else self._known.start()

    def _begin(self, at_origin: bool = False) -> None:
        """Begin the filter from what is known, at the origin of the map or where the robot is."""
        assert self._rig is not None
        self._end()
        self.slam = EkfSlam(self.model, self._config, self._rig, start=self._start, running_s=self._running_s)
        if not at_origin:
            self.slam.state = restarted_at(self.slam.state, self._where())
        self._begin_watch()

    def _end(self) -> None:
        if self.slam is not None:
            self._running_s = self.slam.running_s
        self.slam = None

    def _begin_watch(self) -> None:
        self.watch = Convergence()
        self._time_s = self._checkpoint_s = self._trusted_s = 0.0
        self._has_stepped = False
        self._checkpoint = self._candidate = self._served
        self._lost_maps_s: deque[float] = deque(maxlen=MAPS_LOST)

    def _begin_anew(self, why: str) -> None:
        """Give the filter up and begin with the last good calibration, in which there is less trust now."""
        self.restarts += 1
        self.events.append(
            f'the filter was lost and begun anew with the last good calibration ({why}); check the camera '
            'and its mounting'
        )
        self._served = self._checkpoint
        good = self.calibration
        self._known = replace(good, covariance=WIDENING * good.covariance)
        self._begin()
        self.on_probation = True

    def _note(self, records: list[StepRecord]) -> bool:
        for record in records:
            self._judge(record)
        if records and self.slam is not None:
            if self.is_trusted:
                self._serve(self.slam.state)
            elif self._time_s - self._trusted_s > DISTRUST_S:
                raise FilterDivergedError(f'it was contradicted for {DISTRUST_S:.0f} s')
        return bool(records)

    def _judge(self, record: StepRecord) -> None:
        if not (np.isfinite(record.mean).all() and (record.std[YAW_BIAS:] > 0.0).all()):
            raise FilterDivergedError('the estimate is no longer finite')
        lesson = record.image.lesson
        if self._has_stepped:  # time counts from the first step, as in a replay
            self._time_s += record.block.duration_s
        self._has_stepped = True
        scale_std = float(record.std[COEFFICIENTS_START])
        self.watch.add(self._time_s, scale_std, lesson.nis, lesson.dof, self._config.convergence)
        if lesson.dof > 0:
            self.has_learned = True
        if record.event:
            self.events.append(record.event)
            self._lost_maps_s.append(self._time_s)
            first_s = self._lost_maps_s[0]
            if len(self._lost_maps_s) == MAPS_LOST and self._time_s - first_s < MAPS_LOST_S:
                raise FilterDivergedError(f'{MAPS_LOST} new maps within {self._time_s - first_s:.0f} s')

    def _serve(self, state: State) -> None:
        self._served, self._trusted_s, self.on_probation = state, self._time_s, False
        if self._time_s - self._checkpoint_s >= CHECKPOINT_S:
            self._checkpoint, self._candidate = self._candidate, state
            self._checkpoint_s = self._time_s
