"""Tests of samples that share a stamp."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from live_robot import measured, source, switched_on
from small_bags import drive, write

from gyrocal_ros.bag.check import check_bag
from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ImuSample, Measurement
from gyrocal_ros.msgs.bursts import LONGEST_NS, MANY, Bursts

MS = 1_000_000
SIZE = 5


def samples(count: int, every_ms: int = 10, start_ms: int = 1000) -> list[ImuSample]:
    return [
        ImuSample((start_ms + every_ms * k) * MS, (0.0, 0.0, 0.01 * k), (0.0, 0.0, 9.8)) for k in range(count)
    ]


def in_bursts(measurements: Iterable[Measurement], size: int = SIZE) -> Iterator[Measurement]:
    """Stamp IMU samples like the last of their burst, at whose time they are all published."""
    held: list[ImuSample] = []
    for item in measurements:
        if not isinstance(item, ImuSample):
            yield item
            continue
        held.append(item)
        if len(held) == size:
            yield from (replace(sample, t_ns=item.t_ns) for sample in held)
            held = []


def spread(measurements: Iterable[Measurement]) -> list[ImuSample]:
    bursts = Bursts()
    return [due for item in measurements if isinstance(item, ImuSample) for due in bursts.add(item)]


def test_samples_with_stamps_of_their_own_pass_at_once() -> None:
    bursts = Bursts()
    for sample in samples(100):
        assert list(bursts.add(sample)) == [sample]


def test_bursts_get_their_stamps_back() -> None:
    true = samples(200)
    known = {sample.rate_rad_s: sample.t_ns for sample in true}
    result = spread(in_bursts(true))[2 * MANY :]
    assert len(result) > 100
    assert all(sample.t_ns == known[sample.rate_rad_s] for sample in result)


def test_a_sample_that_is_sent_twice_is_no_burst() -> None:
    twice = [sample for sample in samples(100) for _ in range(2)]
    assert spread(twice) == twice


def test_after_a_gap_only_the_last_sample_of_a_burst_is_used() -> None:
    later = samples(10 * SIZE, start_ms=1000 + 200 * 10 + 10 * LONGEST_NS // MS)
    result = spread([*in_bursts(samples(200)), *in_bursts(later)])
    after = [sample for sample in result if sample.t_ns >= later[0].t_ns]
    assert after[0].rate_rad_s == later[SIZE - 1].rate_rad_s
    assert after[1:] == later[SIZE : SIZE + len(after) - 1]


def test_a_bag_with_bursts_reads_as_one_without(tmp_path: Path) -> None:
    noisy = [
        replace(item, rate_rad_s=(1e-6 * place, 0.0, 0.1)) if isinstance(item, ImuSample) else item
        for place, item in enumerate(drive())
    ]
    path = write(tmp_path / 'bag', in_bursts(noisy))
    read = [item for item in open_bag(path, Config()).measurements() if isinstance(item, ImuSample)]
    written = {item.t_ns: item for item in noisy if isinstance(item, ImuSample)}
    late = [item for item in read if item.t_ns > read[0].t_ns + 500 * MS]
    assert len(late) > 850 and all(written[item.t_ns] == item for item in late)
    (issue,) = [item for item in check_bag(path, Config()).issues if item.kind == 'repeated_stamps']
    assert 'are spread over the time since the one before' in str(issue)


@pytest.mark.slow
def test_a_robot_whose_imu_stamps_bursts_is_calibrated() -> None:
    new, plain = switched_on(), switched_on()
    new.run(in_bursts(measured()))
    plain.run(measured())
    found, expected = new.live.calibration, plain.live.calibration
    assert found.converged
    assert abs(found.scale_factor - source().truth.scale_factor) < 4.0 * found.scale_factor_std
    assert found.scale_factor_std == pytest.approx(expected.scale_factor_std, rel=0.2)
