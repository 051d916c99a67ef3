"""Soak: hours of measurements through the live calibrator, faster than real time, with a fault every minute.

Each session is a start of the robot: a new calibrator reads the calibration that the last one saved. Memory,
threads and files must stay constant, and no calibration may be converged and wrong.
"""

from __future__ import annotations

import gc
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any, Protocol, TypeAlias

import numpy as np

from gyrocal_ros.bench.faults.semantic import FAULTS, Moment, SemanticFault, faulty
from gyrocal_ros.data import (
    NS_PER_S,
    CameraIntrinsics,
    FeatureObservations,
    ImuSample,
    Measurement,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.msgs.topics import BODY_FRAME, CAMERA_FRAME, IMU_FRAME
from gyrocal_ros.msgs.transforms import IDENTITY, Transform
from gyrocal_ros.pipeline.calibration import Calibration, load_calibration
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

SESSION_S = 300.0
"""Length of a session, unless another one is given."""
ROW_S = 600.0
"""Interval of the rows within a long session."""
SCALE_FACTOR = 0.93
"""True scale factor of the robot, in all sessions."""
PERIOD_S, FAULT_S, FREE_S = 60.0, 20.0, 120.0
"""Interval between faults, their length, and the time at the start of a session without any."""
MIDDLE_S = 30.0
"""Time that a fault is given at its start: those that begin in the middle of a recording begin then."""
TRANSIENT = (
    *('gyro noise', 'gyro outliers', 'gyro sticks', 'gyro bias jumps', 'gyro reads in steps'),
    *('imu stamps jitter', 'image stamps jitter', 'imu lost', 'imu gaps', 'images lost', 'camera dark'),
    *('image noise', 'image outliers', 'camera frozen', 'features without numbers', 'ids exchanged'),
    *('wheels scaled', 'wheels stand', 'wheels turn wrongly', 'encoder overflows', 'specific force in g'),
)
"""Faults that may come and go."""


class Calibrator(Protocol):
    """The live calibrator, as far as it is used here."""

    @property
    def calibration(self) -> Calibration: ...
    @property
    def has_work(self) -> bool: ...
    def transforms(self, transforms: Sequence[Transform]) -> None: ...
    def camera(self, camera: CameraIntrinsics, frame: str, now_s: float) -> None: ...
    def imu(self, sample: ImuSample, frame: str, now_s: float) -> object: ...
    def wheels(self, sample: WheelSample, now_s: float) -> object: ...
    def features(self, seen: FeatureObservations, frame: str, now_s: float) -> None: ...
    def work(self) -> object: ...
    def status(self, now_s: float) -> object: ...
    def save_if_due(self, now_s: float) -> None: ...
    def close(self) -> None: ...


Start: TypeAlias = Callable[[Path, float], Calibrator]
"""Function that starts a calibrator with a calibration file, at a time."""


@dataclass(slots=True)
class Judgement:
    """Calibrations that were judged, once a minute and when they were saved."""

    judged: int = 0
    converged: int = 0
    beyond_3_sigma: int = 0
    worst_sigma: float = 0.0
    faults: list[str] = field(default_factory=list)
    """Names and sizes of the faults in the meantime."""

    def add(self, calibration: Calibration) -> None:
        """Compare a calibration with the truth."""
        self.judged += 1
        if calibration.converged:
            sigma = abs(calibration.scale_factor - SCALE_FACTOR) / calibration.scale_factor_std
            self.converged += 1
            self.beyond_3_sigma += sigma > 3.0
            self.worst_sigma = max(self.worst_sigma, sigma)


def soak(sessions: int, start: Start, session_s: float = SESSION_S) -> Iterator[dict[str, Any]]:
    """Run sessions one after the other; yield a row for every ten minutes and for each end of a session.

    Args:
        sessions: their number; it is also the seed of the faults.
        start: starts the calibrator.
        session_s: length of a session.
    """
    random = Random(f'soak {sessions}')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'calibration.yaml'
        for number in range(sessions):
            begin_s = number * session_s
            for now_s, judgement in _drive(start(file, begin_s), number, begin_s, session_s, random):
                if file.exists():
                    judgement.add(load_calibration(file))
                gc.collect()  # what is left is kept by somebody
                yield {
                    'hours': now_s / 3600.0,
                    'faults': len(judgement.faults),
                    'judged': judgement.judged,
                    'converged': judgement.converged,
                    'beyond 3 sigma': judgement.beyond_3_sigma,
                    'worst sigma': judgement.worst_sigma,
                    'memory MB': _resident_bytes() / 1e6,
                    'threads': threading.active_count(),
                    'files': len(list(Path(folder).iterdir())),
                    'open files': len(list(Path('/proc/self/fd').iterdir())),
                    'last fault': judgement.faults[-1] if judgement.faults else '',
                }


def _drive(
    calibrator: Calibrator, seed: int, begin_s: float, session_s: float, random: Random
) -> Iterator[tuple[float, Judgement]]:
    """Drive one session; yield the time and the judgement of every ten minutes, and at the end."""
    scenario = find_scenario('cleaning')
    errors = replace(scenario.errors, scale_factor=SCALE_FACTOR)
    scenario = replace(scenario, duration_s=session_s, imu_hz=100, camera_hz=10, errors=errors)
    source = SimSource(scenario, seed)
    assert source.rig.camera is not None
    calibrator.transforms(
        [
            Transform(BODY_FRAME, CAMERA_FRAME, source.rig.camera_mount),
            Transform(BODY_FRAME, IMU_FRAME, IDENTITY),
        ]
    )
    calibrator.camera(source.rig.camera, CAMERA_FRAME, begin_s)
    numbers, memory, judgement = np.random.default_rng(seed), dict[str, Any](), Judgement()
    fault, size, next_s, second = SemanticFault(()), 0.0, FREE_S, 0
    for sample in source.measurements():
        time_s = (sample.t_ns - source.span.start_ns) / NS_PER_S
        if time_s >= next_s:
            name = random.choice(TRANSIENT)
            fault, size = FAULTS[name], random.choice(FAULTS[name].sizes)
            judgement.faults.append(f'{name} {size:g}')
            memory, next_s = {}, next_s + PERIOD_S
        since_s = time_s - (next_s - PERIOD_S)
        at = Moment(MIDDLE_S + since_s, size, numbers, memory)
        measured = faulty(sample, fault, at, source.rig) if since_s < FAULT_S else sample
        if measured is not None:
            _take(calibrator, replace(measured, t_ns=measured.t_ns + nanoseconds(begin_s)), begin_s + time_s)
        if int(time_s) > second:
            second = int(time_s)
            calibrator.status(begin_s + time_s)
            calibrator.save_if_due(begin_s + time_s)
            if second % PERIOD_S == 0:
                judgement.add(calibrator.calibration)
            if second % ROW_S == 0:
                yield begin_s + time_s, judgement
                judgement = Judgement()
    calibrator.close()
    yield begin_s + session_s, judgement


def _take(calibrator: Calibrator, sample: Measurement, now_s: float) -> None:
    if isinstance(sample, ImuSample):
        calibrator.imu(sample, IMU_FRAME, now_s)
    elif isinstance(sample, WheelSample):
        calibrator.wheels(sample, now_s)
    elif isinstance(sample, FeatureObservations):
        calibrator.features(sample, CAMERA_FRAME, now_s)
    while calibrator.has_work:
        calibrator.work()


def _resident_bytes() -> int:
    """Return the memory that the process has now; Linux only."""
    try:
        pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    except OSError as error:
        raise GyrocalError('the memory of the process is not known', where='bench soak') from error
    return pages * 4096
