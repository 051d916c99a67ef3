"""Views that stretch the path along one direction: no fault of a sensor, and not to be taken for one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block
from recordings import ModifiedSource, recording
from synthetic import score_statistics_of

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, Measurement, TruthSample, WheelSample
from gyrocal_ros.diagnose.analysis.ranking import rank, without_disturbed
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.library import DISTURBANCES, SHIPPED
from gyrocal_ros.effects.stretched_path import StretchedPath
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.pipeline.calibrate import calibrate

STRETCH = 0.05
STRETCHED = StretchedPath()
ON_GYRO, ON_CAMERA, ON_WHEELS = map(find_effect, ('scale_cubic', 'focal_length', 'turn_slip'))


def heading(angle_rad: float, values: tuple[float, float]) -> Array:
    """Return the displacement of a metre in one direction."""
    block = replace(
        eventful_block(),
        distance_m=np.full(len(eventful_block().dt_s), 1.0 / len(eventful_block().dt_s)),
        heading_rad=np.full(len(eventful_block().dt_s), angle_rad),
    )
    moved, by_values = STRETCHED.contribute(block, np.array(values))
    np.testing.assert_allclose(by_values @ values, moved)
    assert not by_values[2].any(), 'no height'
    return moved[:2]


class TestEffect:
    def test_what_it_adds_along_one_direction_it_takes_across(self) -> None:
        np.testing.assert_allclose(heading(0.0, (0.05, 0.0)), [0.05, 0.0], atol=1e-12)
        np.testing.assert_allclose(heading(0.5 * np.pi, (0.05, 0.0)), [0.0, -0.05], atol=1e-12)
        np.testing.assert_allclose(heading(np.pi, (0.05, 0.0)), [-0.05, 0.0], atol=1e-12)

    @pytest.mark.parametrize('angle_rad', [0.2, 1.0, 2.5])
    def test_any_direction(self, angle_rad: float) -> None:
        turned = 0.05 * np.cos(2.0 * angle_rad), 0.05 * np.sin(2.0 * angle_rad)
        along = np.array([np.cos(angle_rad), np.sin(angle_rad)])
        np.testing.assert_allclose(heading(angle_rad, turned), 0.05 * along, atol=1e-12)

    def test_it_is_no_effect_of_the_library(self) -> None:
        assert {effect.name for effect in DISTURBANCES}.isdisjoint(effect.name for effect in SHIPPED)


def judged(sizes: tuple[float, float, float, float], noise: float = 1.0) -> tuple[list[str], dict[str, str]]:
    """Judge effects on gyro, camera and wheels and a stretched path, of given sizes in a recording."""
    effects: tuple[Effect, ...] = (ON_GYRO, ON_CAMERA, ON_WHEELS, STRETCHED)
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(30, 20, 5))
    seen = columns @ np.array([*sizes, 0.0]) + noise * rng.normal(size=(30, 20))
    ranked, disturbed = without_disturbed(
        rank(score_statistics_of(columns, seen, effects), DEFAULT_SETTINGS), DEFAULT_SETTINGS
    )
    return [item.effect.name for item in ranked], disturbed


class TestWithoutDisturbed:
    def test_effects_that_explain_less_are_not_judged(self) -> None:
        names, disturbed = judged((0.3, 0.4, 2.0, 1.0))
        assert names == ['turn_slip', 'scale_cubic']
        assert disturbed == {'focal_length': STRETCHED.about.in_short}

    @pytest.mark.parametrize('size', [0.0, 0.009])
    def test_a_weak_one_disturbs_nothing(self, size: float) -> None:
        """Also one that is significant, but smaller than usual."""
        names, disturbed = judged((0.03, 0.0, 0.0, size), noise=0.01)
        assert set(names) == {'scale_cubic', 'focal_length', 'turn_slip'}
        assert disturbed == {}


def stretched(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    """Let the wheels say less than the features show along x, and more along y."""
    yaw_rad = 0.0
    for item in measurements:
        if isinstance(item, TruthSample):
            yaw_rad = item.yaw_rad
        if isinstance(item, WheelSample):
            item = replace(item, speed_m_s=item.speed_m_s / (1.0 + STRETCH * np.cos(2.0 * yaw_rad)))
        yield item


@pytest.fixture(scope='module')
def found() -> Diagnosis:
    source = ModifiedSource(recording(duration_s=120.0), stretched)
    recorded = summarise_recording(source)
    config = Config()
    searched = find_missing(
        default_model(), recorded, lambda model, tried: calibrate(source, config, model, candidates=tried)
    )
    return diagnose(searched, recorded)


class TestDiagnosis:
    def test_nothing_is_named_for_it(self, found: Diagnosis) -> None:
        assert found.missing == ()

    def test_effects_that_it_hides_are_not_judged(self, found: Diagnosis) -> None:
        hidden = {name for name, why in found.not_judged.items() if why == STRETCHED.about.in_short}
        assert hidden >= {'wheel_scale', 'turn_slip', 'lateral_drift', 'camera_position'}
        assert {find_effect(name).acts_on for name in hidden} <= {'wheels', 'ground', 'camera'}
        assert hidden.isdisjoint(item.effect.name for item in found.ranked)
