"""A ceiling camera that is none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrocal_ros.data import Frame, TruthSample, nanoseconds
from gyrocal_ros.emulator.camera import (
    CLOCK_AHEAD_NS,
    COVERED_GREY,
    EmulatedCamera,
    Spell,
    Trouble,
    parse_spells,
)
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.sim.film import EXPOSURE_S
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import START_NS, SimSource

SOURCE = SimSource(replace(SCENARIOS['demo'], duration_s=1.0, standing_s=0.2), 1, images=True)
NOW_NS = START_NS + nanoseconds(1e6)


@cache
def camera(troubles: str = '') -> EmulatedCamera:
    made = EmulatedCamera(SOURCE, parse_spells(troubles))
    made.start_ns = NOW_NS
    return made


@cache
def recorded() -> list[Frame]:
    return [item for item in SOURCE.measurements() if isinstance(item, Frame)]


def test_it_takes_the_images_of_the_recording_now() -> None:
    taken = [camera().take(number) for number in range(3)]
    for frame, old in zip(taken, recorded(), strict=False):
        assert frame is not None
        assert frame.t_ns - NOW_NS == old.t_ns - START_NS
        np.testing.assert_array_equal(frame.image, old.image)
    assert len(camera()) == len(recorded())


def test_an_image_is_there_when_its_exposure_is_over() -> None:
    assert camera().due_ns(3) == camera().stamp_ns(3) + nanoseconds(EXPOSURE_S / 2.0)


def test_images_that_are_over_are_left_out() -> None:
    due_ns = camera().due_ns(4)
    assert camera().next_after(0, NOW_NS) == 1
    assert camera().next_after(0, due_ns) == 4
    assert camera().next_after(0, due_ns + 1) == 5
    assert camera().next_after(0, NOW_NS + nanoseconds(5.0)) == len(camera())


def test_it_is_covered_and_switched_off_for_a_while() -> None:
    troubled = camera('cover@0.15+0.2 off@0.4+0.2')
    frames = [troubled.take(number) for number in range(8)]
    dark = [frame is not None and bool((frame.image == COVERED_GREY).all()) for frame in frames]
    assert dark == [False, False, True, True, False, False, False, False]
    assert [frame is None for frame in frames] == [False] * 4 + [True] * 2 + [False] * 2


def test_it_knows_where_the_robot_is() -> None:
    truths = {item.t_ns - START_NS: item for item in SOURCE.measurements() if isinstance(item, TruthSample)}
    now = camera().truth(5)
    before = truths[max(t for t in truths if t <= now.t_ns - NOW_NS)]
    np.testing.assert_allclose(now.position_m, before.position_m, atol=0.02)
    assert now.yaw_rad == pytest.approx(before.yaw_rad, abs=0.05)


def test_a_clock_that_is_ahead_stamps_images_later() -> None:
    early, late = camera(), camera('clock@0+1000')
    assert late.stamp_ns(3) - early.stamp_ns(3) == CLOCK_AHEAD_NS
    assert late.due_ns(3) == early.due_ns(3)
    told = late.take(3)
    assert told is not None and told.t_ns == late.truth(3).t_ns == late.stamp_ns(3)


def test_troubles_are_read() -> None:
    assert parse_spells(' off@160+60  cover@1.5+0.5 ') == [
        Spell(Trouble.OFF, 160.0, 220.0),
        Spell(Trouble.COVER, 1.5, 2.0),
    ]
    assert parse_spells('') == []


@pytest.mark.parametrize(
    ('text', 'said'),
    [('cover', 'not understood'), ('dirt@1+2', "'dirt' is not known"), ('off@1.2.3+1', 'no times')],
)
def test_troubles_that_mean_nothing_are_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_spells(text)
