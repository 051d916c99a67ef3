"""Effects of camera and way while the camera stays in place: no shift of a feature tells of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose_before_adding
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.features.known_depth import TellingWay, weighted_scores
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

EFFECTS = tuple(
    map(
        find_effect,
        ('scale_cubic', 'camera_position', 'turn_slip', 'lateral_drift', 'camera_time_offset')
        + ('rolling_shutter', 'camera_tilt'),
    )
)


def test_what_images_show_depends_on_the_motion() -> None:
    effects = sort_effects(EFFECTS, more=2)
    scale, offset, more = 1.0, 1.0, [1.0, 1.0]

    def shown(depth_or_way: float, readout: float, tilt: float) -> list[float]:
        return [scale, *[depth_or_way] * 5, offset, readout, tilt, tilt, *more]

    assert effects.shown(moves=False, turns=False).tolist() == shown(0.0, 0.0, 0.0)
    assert effects.shown(moves=False, turns=True).tolist() == shown(0.0, 1.0, 1.0), 'spins show a tilt'
    assert effects.shown(moves=True, turns=False).tolist() == shown(1.0, 0.0, 1.0)
    assert effects.shown(moves=True, turns=True).tolist() == shown(1.0, 1.0, 1.0)


def test_weights_are_those_of_the_scores() -> None:
    stats = UpdateStats(3.0, 2, 0.5, np.arange(9.0).reshape(3, 3), np.array([1.0, 2.0, 3.0]))
    weighted = weighted_scores(stats, np.array([1.0, 0.0, 1.0]))
    assert weighted.information is not None and weighted.score is not None
    np.testing.assert_array_equal(weighted.information, [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [6.0, 0.0, 8.0]])
    assert weighted.score.tolist() == [1.0, 0.0, 3.0]
    assert (weighted.nis, weighted.dof, weighted.log_determinant) == (3.0, 2, 0.5)
    without = UpdateStats(3.0, 2, 0.5)
    assert weighted_scores(without, np.ones(3)) is without


def spinning(
    lever_m: float, seed: int, drive: str = 'spins', hidden: tuple[HiddenEffect, ...] = ()
) -> tuple[ExaminedModel, Diagnosis]:
    """Examine a robot that spins on the spot."""
    usual = find_scenario(drive)
    errors = replace(usual.errors, pixel_noise_px=0.5, wheel_noise_m=0.01)
    changes = {'duration_s': 120.0, 'imu_hz': 100, 'camera_hz': 5, 'features': 30, 'errors': errors}
    source = SimSource(replace(usual, mount_xyz_m=(lever_m, 0.0, 0.1), **changes), seed, hidden=hidden)  # type: ignore[arg-type]
    recorded = summarise_recording(source)
    config = Config()
    examined = examine(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    return examined, diagnose_before_adding(examined, None, (), recorded)


@pytest.mark.parametrize(('lever_m', 'seed'), [(0.012, 2), (0.012, 5), (0.06, 2), (0.1, 4)])
def test_spins_accuse_nothing(lever_m: float, seed: int) -> None:
    """The principal point seemed 4 to 6 sigma off."""
    examined, found = spinning(lever_m, seed)
    assert [item.effect.name for item in examined.ranked if item.is_significant] == []
    assert found.not_judged.keys() >= {'wheel_scale', 'focal_length'}


@pytest.mark.parametrize('tilt_rad', [0.01, -0.04])
def test_spins_show_a_tilted_camera(tilt_rad: float) -> None:
    hidden = HiddenEffect(find_effect('camera_tilt'), (tilt_rad, -0.5 * tilt_rad))
    examined, found = spinning(0.06, 2, hidden=(hidden,))
    assert examined.ranked[0].effect.name == 'camera_tilt' and examined.ranked[0].is_significant
    assert 'camera_position' in found.not_judged


def test_a_drive_judges_the_camera() -> None:
    examined, found = spinning(0.012, 2, drive='lanes')
    judged = examined.find('camera_position')
    assert judged is not None and judged.could_show
    assert 'camera_position' not in found.not_judged


def test_a_new_map_has_to_be_measured_again() -> None:
    source = SimSource(replace(find_scenario('lanes'), duration_s=12.0), 2)
    slam = EkfSlam(default_model(), Config(), source.rig)
    stream = SlamStream(slam)
    has_moved = []
    for measurement in source.measurements():
        stream.step(measurement)
        has_moved.append(slam._image_model().has_moved)
    assert not has_moved[0] and has_moved[-1] and sorted(has_moved) == has_moved, 'once it has moved it has'
    slam.start_new_time_base(slam.state.t_ns)
    assert not slam._image_model().has_moved


@pytest.mark.parametrize(('new', 'tells'), [(0.4, True), (0.6, False)])
def test_the_way_tells_as_long_as_most_features_have_seen_it(new: float, tells: bool) -> None:
    """A robot that spins after a drive loses the features of the drive one by one."""
    source = SimSource(replace(find_scenario('lanes'), duration_s=12.0), 2)
    slam = EkfSlam(default_model(), Config(), source.rig)
    stream = SlamStream(slam)
    for measurement in source.measurements():
        stream.step(measurement)
    state, view, way = slam.state, slam.view(), TellingWay()
    count = len(state.landmarks.ids)
    spun = replace(state.landmarks, last_seen_ns=np.full(count, state.t_ns), anchor_rows=np.full(count, -1))
    anchors = replace(spun.anchors, p_wc=np.tile(view.p_wc - [2.0, 0.0, 0.0], (count, 1)))
    way.see(replace(state, landmarks=replace(spun, anchors=anchors)), view)
    assert way.tells
    here = replace(anchors, p_wc=np.tile(view.p_wc, (count, 1)))
    is_new = np.arange(count) < new * count
    ids = np.where(is_new, spun.ids + 10**6, spun.ids)
    state = replace(state, landmarks=replace(spun, anchors=here, ids=ids))
    way.see(state, view)
    assert way.tells == tells
    way.see(replace(state, t_ns=state.t_ns + 1), view)
    assert way.tells == tells, 'an image without features changes nothing'
