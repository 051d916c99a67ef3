"""Growth of time and memory with the number of features, the length of the bag and the rate of the IMU."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.bench.speed import gyrocal_process
from gyrocal_ros.config.declare import to_yaml
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.files import write_text_atomic
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

FEATURES = (5, 10, 15, 30, 60, 120)
LENGTHS_S = (60.0, 300.0, 1200.0, 3600.0, 7200.0)
IMU_HZ = (50, 100, 200, 500, 1000)
DURATION_S = 60.0
CORNERS_PER_FEATURE = 8
"""Number of corners on the ceiling per tracked feature, so that the camera always sees enough of them."""
MAP_PER_FEATURE = 2
"""Size of the map per tracked feature, as in the default settings: 15 features tracked, 30 in the map."""
LONGEST_IN_MEMORY_S = 1200.0
"""Maximum duration of a recording on which the filter alone is timed."""


@dataclass(frozen=True, slots=True)
class Size:
    """One recording, with the quantity that is varied and its value."""

    against: str
    value: float
    scenario: Scenario
    config: Config = Config()


def sizes() -> list[Size]:
    """Return all sizes; except for the quantity that is varied, the scenario is `lanes`."""
    lanes = replace(find_scenario('lanes'), duration_s=DURATION_S)
    return [
        *(_with_features(lanes, count) for count in FEATURES),
        *(Size('length (s)', length_s, replace(lanes, duration_s=length_s)) for length_s in LENGTHS_S),
        *(Size('IMU rate (Hz)', hz, replace(lanes, imu_hz=hz)) for hz in IMU_HZ),
    ]


def growth(quick: bool = False) -> Iterator[dict[str, Any]]:
    """Yield one row per size: the filter alone from memory, and a whole `gyrocal replay` of a bag."""
    before: dict[str, Any] = {}
    for size in sizes()[: 2 if quick else None]:
        found = _measured(size)
        last = before if before.get('against') == size.against else {}
        before = found | {
            'filter_exponent': _exponent(last, found, 'filter_s'),
            'replay_exponent': _exponent(last, found, 'replay_cpu_s'),
        }
        yield before


def _with_features(scenario: Scenario, count: int) -> Size:
    config = Config()
    features = replace(config.features, map_size=MAP_PER_FEATURE * count)
    corners = max(scenario.corners, CORNERS_PER_FEATURE * count)
    return Size(
        'features',
        count,
        replace(scenario, features=count, corners=corners),
        replace(config, features=features),
    )


def _measured(size: Size) -> dict[str, Any]:
    source = SimSource(size.scenario, 0)
    in_memory = size.scenario.duration_s <= LONGEST_IN_MEMORY_S
    filter_s, used = _filter_alone(source, size.config) if in_memory else (None, None)
    with tempfile.TemporaryDirectory() as folder:
        bag, settings = Path(folder) / 'bag', Path(folder) / 'settings.yaml'
        with new_bag(bag, 'mcap') as writer:
            writer.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
            for measurement in source.measurements():
                writer.write(measurement)
        write_text_atomic(settings, to_yaml(size.config))
        process = gyrocal_process('replay', str(bag), '--config', str(settings), '--json')
    return {
        'against': size.against,
        'size': size.value,
        'recorded_s': size.scenario.duration_s,
        'features_used': used,
        'filter_s': filter_s,
        'replay_s': process.cpu_s,
        'replay_cpu_s': process.cpu_s,
        'peak_mb': process.peak_mb,
    }


def _filter_alone(source: SimSource, config: Config) -> tuple[float, float]:
    """Return the processor time, s, over measurements in memory, and the features used per image."""
    measurements = list(source.measurements())
    slam = SlamStream(EkfSlam(default_model(), config, source.rig))
    began = time.process_time()
    records = [record for measurement in measurements for record in slam.step(measurement)]
    records += slam.finish()
    took_s = time.process_time() - began
    used = [record.update.used for record in records if record.update.used]
    return took_s, float(np.mean(used))


def _exponent(before: dict[str, Any], now: dict[str, Any], what: str) -> float | None:
    """Return the local exponent of a power law: 1 is proportional growth."""
    if not before or before[what] is None or now[what] is None:
        return None
    return math.log(now[what] / before[what]) / math.log(now['size'] / before['size'])
