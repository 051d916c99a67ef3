"""Detection of rest."""

from __future__ import annotations

from dataclasses import replace

import pytest
from contracts import eventful_block

from gyrocal_ros.data import MotionBlock, nanoseconds
from gyrocal_ros.ekf.rest import RestDetector

SETTLE_S = 0.5


def block(start_s: float, end_s: float, *, at_rest: bool = True, gap_s: float = 0.0) -> MotionBlock:
    return replace(
        eventful_block(),
        start_ns=nanoseconds(start_s),
        end_ns=nanoseconds(end_s),
        wheels_at_rest=at_rest,
        gap_s=gap_s,
    )


def at_rest(*blocks: MotionBlock) -> list[bool]:
    detector = RestDetector()
    return [detector.is_at_rest(item, SETTLE_S) for item in blocks]


def test_rest_begins_after_the_settling_time() -> None:
    blocks = [block(0.2 * step, 0.2 * (step + 1)) for step in range(5)]
    assert at_rest(*blocks) == [False, False, True, True, True]


def test_one_long_block_is_enough() -> None:
    assert at_rest(block(0.0, 0.6)) == [True]
    assert at_rest(block(0.0, 0.5)) == [False], 'the settling time has to be exceeded'


@pytest.mark.parametrize('interruption', [{'at_rest': False}, {'gap_s': 0.01}], ids=['moved', 'IMU gap'])
def test_motion_or_a_gap_restarts_the_settling_time(interruption: dict[str, float]) -> None:
    interrupted = block(0.6, 0.7, **interruption)  # type: ignore[arg-type]
    found = at_rest(block(0.0, 0.6), interrupted, block(0.7, 1.1), block(1.1, 1.3))
    assert found == [True, False, False, True]
