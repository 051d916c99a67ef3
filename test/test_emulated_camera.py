"""The emulated ceiling camera."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from gyrocal_ros.data import Frame, TruthSample, nanoseconds
from gyrocal_ros.emulator.camera import (
    CLOCK_AHEAD_NS,
    COVERED_GREY,
    CameraFault,
    CameraFaultKind,
    EmulatedCamera,
    parse_camera_faults,
)
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.world import START_NS, SimSource

SOURCE = SimSource(replace(SCENARIOS['demo'], duration_s=1.0, standing_s=0.2), 1, images=True)
NOW_NS = START_NS + nanoseconds(1e6)


@cache
def camera(faults: str = '') -> EmulatedCamera:
    emulated = EmulatedCamera(SOURCE, parse_camera_faults(faults))
    emulated.start_ns = NOW_NS
    return emulated


@cache
def recorded() -> list[Frame]:
    return [item for item in SOURCE.measurements() if isinstance(item, Frame)]


@pytest.mark.slow
def test_it_takes_the_images_of_the_recording_in_real_time() -> None:
    emulated = camera()
    taken = [emulated.take(number) for number in range(3)]
    for frame, old in zip(taken, recorded(), strict=False):
        assert frame is not None
        assert frame.t_ns - NOW_NS == old.t_ns - START_NS
        np.testing.assert_array_equal(frame.image, old.image)
    assert len(camera()) == len(recorded())


@pytest.mark.slow
def test_an_image_is_due_at_the_end_of_its_exposure() -> None:
    assert camera().due_ns(3) == camera().stamp_ns(3) + nanoseconds(ImageConditions().exposure_s / 2.0)


@pytest.mark.slow
def test_missed_images_are_skipped() -> None:
    due_ns = camera().due_ns(4)
    assert camera().next_after(0, NOW_NS) == 1
    assert camera().next_after(0, due_ns) == 4
    assert camera().next_after(0, due_ns + 1) == 5
    assert camera().next_after(0, NOW_NS + nanoseconds(5.0)) == len(camera())


@pytest.mark.slow
def test_it_is_covered_and_switched_off_for_an_interval() -> None:
    faulty = camera('cover@0.15+0.2 off@0.4+0.2')
    frames = [faulty.take(number) for number in range(8)]
    dark = [frame is not None and bool((frame.image == COVERED_GREY).all()) for frame in frames]
    assert dark == [False, False, True, True, False, False, False, False]
    assert [frame is None for frame in frames] == [False] * 4 + [True] * 2 + [False] * 2


@pytest.mark.slow
def test_it_returns_the_true_pose() -> None:
    truths = {item.t_ns - START_NS: item for item in SOURCE.measurements() if isinstance(item, TruthSample)}
    now = camera().truth(5)
    before = truths[max(t for t in truths if t <= now.t_ns - NOW_NS)]
    np.testing.assert_allclose(now.position_m, before.position_m, atol=0.02)
    assert now.yaw_rad == pytest.approx(before.yaw_rad, abs=0.05)


@pytest.mark.slow
def test_a_clock_fault_shifts_the_stamps() -> None:
    early, late = camera(), camera('clock@0+1000')
    assert late.stamp_ns(3) - early.stamp_ns(3) == CLOCK_AHEAD_NS
    assert late.due_ns(3) == early.due_ns(3)
    frame = late.take(3)
    assert frame is not None and frame.t_ns == late.truth(3).t_ns == late.stamp_ns(3)


@pytest.mark.slow
def test_it_freezes_and_loses_images_for_an_interval() -> None:
    faulty = camera('freeze@0.15+0.2 lose@0.45+0.3')
    frames = [faulty.take(number) for number in range(8)]
    assert [frame is None for frame in frames] == [False, False, False, False, False, True, False, True]
    images = [frame.image for frame in frames[:5] if frame is not None]
    repeated = [bool((before == after).all()) for before, after in pairwise(images)]
    assert repeated == [False, False, True, False]


def test_faults_are_parsed() -> None:
    assert parse_camera_faults(' off@160+60  cover@1.5+0.5 ') == [
        CameraFault(CameraFaultKind.OFF, 160.0, 220.0),
        CameraFault(CameraFaultKind.COVER, 1.5, 2.0),
    ]
    assert parse_camera_faults('') == []


@pytest.mark.parametrize(
    ('text', 'message'),
    [('cover', 'is malformed'), ('dirt@1+2', "'dirt' is not a fault"), ('off@1.2.3+1', 'no valid times')],
)
def test_malformed_faults_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_camera_faults(text)
