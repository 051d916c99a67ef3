"""Points that slide leave the map: their depth changes by more than that of a fixed point can."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from filter_states import some_state

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, IntArray
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.landmarks import forget
from gyrocal_ros.ekf.features.sliding import MAX_SURPRISE, SlidingPoints
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

STD = 0.02
"""Standard deviation of the inverse depths at first."""
STATE = some_state()
IDS = STATE.landmarks.ids


def known_to(depths: Array | float, part: float) -> State:
    """Return a state whose inverse depths have changed by so much, and are known to a part of `STD`."""
    mean, covariance = STATE.mean.copy(), STATE.covariance.copy()
    places = np.arange(STATE.robot_size + 2, STATE.anchors_start, 3)
    mean[places] = 0.4 + np.asarray(depths)
    covariance[places, places] = (part * STD) ** 2
    return replace(STATE, mean=mean, covariance=covariance)


def only(place: int, change: float) -> Array:
    """Return changes (5,) of which one is not zero."""
    return np.where(np.arange(len(IDS)) == place, change, 0.0)


def found(*states: State) -> IntArray:
    """Return what slides in the last of several states."""
    sliding = SlidingPoints()
    return [sliding.find(state) for state in states][-1]


@pytest.mark.parametrize(('sigmas', 'slides'), [(3.9, False), (4.1, True), (-4.1, True)])
def test_a_depth_may_change_by_what_was_still_to_be_learned(sigmas: float, slides: bool) -> None:
    change = sigmas * STD * np.sqrt(1.0 - 0.5**2)
    after = found(known_to(0.0, 1.0), known_to(only(2, change), 0.5))
    assert after.tolist() == ([IDS[2]] if slides else [])


def test_a_change_says_nothing_before_the_depth_is_better_known() -> None:
    assert not len(found(known_to(0.0, 1.0), known_to(only(2, 10.0 * STD), 0.8)))


def test_changes_count_from_when_the_depth_was_known_better() -> None:
    """A wrong guess at first does not hide what comes later."""
    later = known_to(only(2, 0.9 * STD), 0.05)
    assert found(known_to(0.0, 1.0), known_to(0.0, 0.2), later).tolist() == [IDS[2]]
    assert not len(found(known_to(0.0, 1.0), later))


def test_where_all_depths_change_no_point_is_to_blame() -> None:
    wrong = 6.0 * STD * np.array([1.0, -1.2, 1.1, -0.9, 1.0])
    assert not len(found(known_to(0.0, 1.0), known_to(wrong, 0.5)))
    assert found(known_to(0.0, 1.0), known_to(wrong + only(2, 30.0 * STD), 0.5)).tolist() == [IDS[2]]


def test_a_feature_that_left_the_map_begins_anew() -> None:
    without = forget(STATE, IDS[:1])
    assert MAX_SURPRISE < 25.0
    assert found(known_to(0.0, 1.0), known_to(only(0, 5.0 * STD), 0.5)).tolist() == [IDS[0]]
    assert not len(found(known_to(0.0, 1.0), without, known_to(only(0, 5.0 * STD), 0.5)))


def leaves_the_map(seed: int) -> bool:
    """Return True if a feature that slides outwards by a fifth of a thousandth in each image is dropped."""
    drive = find_scenario('cleaning')
    errors = replace(drive.errors, pixel_noise_px=0.1)
    source = SimSource(replace(drive, duration_s=20.0, imu_hz=100, errors=errors), seed)
    camera, items = source.rig.camera, list(source.measurements())
    assert camera is not None
    seen = Counter(i for item in items if isinstance(item, FeatureObservations) for i in item.ids.tolist())
    slider, dropped, images = seen.most_common(1)[0][0], set(), 0
    stream = SlamStream(EkfSlam(default_model(), Config(), source.rig))
    for item in items:
        if isinstance(item, FeatureObservations) and slider in item.ids:
            images += 1
            rays = np.column_stack([bearing(camera, item.pixels), np.ones(len(item.ids))])
            rays[item.ids == slider, :2] *= 1.0 + 2e-4 * images
            item = replace(item, pixels=project(camera, rays))
        for record in stream.step(item):
            dropped.update(record.update.dropped_ids.tolist())
    return slider in dropped


def test_corners_behind_a_beam_leave_the_map() -> None:
    assert sum(map(leaves_the_map, range(1, 9))) >= 6
