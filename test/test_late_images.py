"""A camera whose stamps are far off, found by the turns of the image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import readings, recording_of, turning_rad_s

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, FeatureObservations
from gyrocal_ros.diagnose.analysis.late_images import late_images
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search.recovery import first_run
from gyrocal_ros.diagnose.search.search import search
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.model.image_turn import turn_between
from gyrocal_ros.model.recording import ImageTurns, RecordingSummary
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S, HZ, IMAGE_S = 60.0, 100.0, 0.1


def recorded(offset_s: float, noise_rad: float = 2e-3, scale: float = -0.9) -> RecordingSummary:
    """Return a recording whose images are stamped late by this, of a camera that looks down."""
    rate = np.interp(
        np.arange(0.0, DURATION_S, 1.0 / HZ),
        np.linspace(0.0, DURATION_S, len(turning_rad_s(DURATION_S))),
        turning_rad_s(DURATION_S),
    )
    return seen_turning(rate, offset_s, noise_rad, scale)


def seen_turning(
    rate: Array, offset_s: float, noise_rad: float = 2e-3, scale: float = -0.9
) -> RecordingSummary:
    """Return the same of a robot that turns with these rates (n,) in rad/s."""
    made = readings(rate, HZ)
    time_s = np.arange(len(rate)) / HZ
    turned = np.cumsum(rate) / HZ
    edges_s = np.arange(3.0, DURATION_S - 3.0, IMAGE_S)
    turn = scale * np.diff(np.interp(edges_s - offset_s, time_s, turned))
    turn += noise_rad * np.random.default_rng(0).standard_normal(len(turn))
    edges_ns = np.round(edges_s * NS_PER_S).astype(np.int64)
    return replace(recording_of(made), image_turns=ImageTurns(edges_ns[:-1], edges_ns[1:], turn))


@pytest.mark.parametrize('offset_s', [-1.2, -0.15, 0.12, 0.4, 1.5])
def test_a_large_offset_is_found_to_hundredths(offset_s: float) -> None:
    effect = late_images(recorded(offset_s))
    assert effect is not None and effect.name == 'camera_time_offset'
    assert effect.coefficients[0].prior_mean == pytest.approx(offset_s, abs=0.011)


@pytest.mark.parametrize('offset_s', [0.0, 0.03, -0.08])
def test_a_small_offset_is_left_to_the_filter(offset_s: float) -> None:
    assert late_images(recorded(offset_s)) is None


@pytest.mark.parametrize('turned_deg', [90.0, -45.0])
def test_one_turn_shows_a_large_offset_unless_it_is_small(turned_deg: float) -> None:
    """A robot may turn to one side only, and seldom."""
    time_s = np.arange(0.0, DURATION_S, 1.0 / HZ)
    is_turning = (time_s > 20.0) & (time_s < 20.0 + abs(math.radians(turned_deg)))
    effect = late_images(seen_turning(np.where(is_turning, math.copysign(1.0, turned_deg), 0.0), 0.3))
    if abs(turned_deg) < 60.0:
        assert effect is None
    else:
        assert effect is not None and effect.coefficients[0].prior_mean == pytest.approx(0.3, abs=0.011)


def test_what_the_turns_do_not_show_is_not_claimed() -> None:
    late = recorded(0.4)
    assert late.image_turns is not None
    strange = np.random.default_rng(1).normal(0.0, 0.05, len(late.image_turns.turn_rad))
    at_rest = 1e-3 * strange
    for turns in (strange, at_rest):
        assert late_images(replace(late, image_turns=replace(late.image_turns, turn_rad=turns))) is None
    assert late_images(replace(late, image_turns=None)) is None
    assert late_images(recorded(3.0)) is None, 'farther than is searched'


def test_the_turn_between_two_images_is_that_of_the_features_they_share() -> None:
    rng = np.random.default_rng(2)
    pixels = rng.uniform(0.0, 480.0, (6, 2))
    turn, shift = math.radians(12.0), np.array([30.0, -8.0])
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    before = FeatureObservations(0, np.arange(6), pixels)
    after = FeatureObservations(1, np.array([9, 5, 3, 1, 0]), np.vstack([[[1.0, 2.0]], pixels[[5, 3, 1, 0]]]))
    moved = replace(after, pixels=after.pixels @ rotation + shift)
    assert turn_between(before, moved) == pytest.approx(turn)
    assert turn_between(before, FeatureObservations(1, np.array([0, 1, 8]), pixels[:3])) is None


@pytest.mark.slow
@pytest.mark.parametrize('offset_s', [0.5, -0.2])
def test_the_diagnosis_names_the_offset_and_nothing_else(offset_s: float) -> None:
    hidden = HiddenEffect(find_effect('camera_time_offset'), (offset_s,))
    scenario = replace(find_scenario('cleaning'), duration_s=90.0, imu_hz=100, camera_hz=5)
    source = SimSource(scenario, 3, hidden=(hidden,))
    summary = summarise_recording(source)
    searched = search(
        default_model(), summary, lambda model, tried: calibrate(source, Config(), model, candidates=tried)
    )
    found = diagnose(searched, summary)
    assert [item.effect.name for item in found.missing] == ['camera_time_offset']
    assert found.missing[0].values == pytest.approx([offset_s], abs=1e-3)


def test_a_model_that_has_an_offset_keeps_it() -> None:
    model = replace(default_model(), effects=(*default_model().effects, find_effect('camera_time_offset')))
    source = SimSource(replace(find_scenario('cleaning'), duration_s=20.0), 0)
    summary = replace(summarise_recording(source), image_turns=recorded(0.4).image_turns)
    first, additions = first_run(
        model, summary, lambda model, tried: calibrate(source, Config(), model, candidates=tried)
    )
    assert not additions and first.model == model
