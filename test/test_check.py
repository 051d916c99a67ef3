"""A check reports every issue of a bag once, and none for a good bag."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import UnionType
from typing import Any

import numpy as np
import pytest
from small_bags import CAMERA, RIG, START_NS, drive, turned_imu, write

from gyrocal_ros.bag.check import CheckReport, check_bag, checked_bag
from gyrocal_ros.bag.rewrite import RawMessage, decode, encode, rewrite_bag
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.cli.main import main
from gyrocal_ros.cli.warned_bag import warned_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    NS_PER_S,
    FeatureObservations,
    Frame,
    ImuSample,
    Measurement,
    Rig,
    TemperatureSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import FilterDivergedError, RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.issues import BagIssue, Severity, worst_per_kind

SHARED = Path(__file__).resolve().parent.parent.parent / 'shared' / 'data' / 'robot-localization-bags'
JACKAL = SHARED / 'test2_jackal.bag'
needs_recordings = pytest.mark.skipif(not SHARED.is_dir(), reason='the third-party recordings are missing')


def check(path: Path, samples: Iterable[Measurement] | None = None, **options: Any) -> CheckReport:
    return check_bag(write(path / 'bag', samples), Config(), **options)


def issues_by_kind(report: CheckReport) -> dict[str, BagIssue]:
    """Return the issues by kind; there must be one of each."""
    by_kind = {issue.kind: issue for issue in report.issues}
    assert len(by_kind) == len(report.issues), report.issues
    return by_kind


def with_changed(kind: type[Any] | UnionType, change: Callable[[Any], Any]) -> list[Measurement]:
    """Return the drive with every sample of a kind changed, or left out if `change` returns None."""
    changed = (change(sample) if isinstance(sample, kind) else sample for sample in drive())
    return [sample for sample in changed if sample is not None]


def time_s(sample: Any) -> float:
    return (sample.t_ns - START_NS) / NS_PER_S


def test_a_good_bag(tmp_path: Path) -> None:
    report = check(tmp_path)
    assert report.usable
    assert report.issues == ()
    assert report.duration_s == pytest.approx(10.0, abs=0.1)
    imu = next(topic for topic in report.topics if topic.role == 'imu/data_raw')
    assert (imu.name, imu.type_name, imu.count) == ('/imu/data_raw', 'sensor_msgs/msg/Imu', 1000)
    assert imu.rate_hz == pytest.approx(100.0)
    assert (imu.start_s, imu.end_s, imu.longest_gap_s) == pytest.approx((0.0, 9.99, 0.0))
    assert {topic.name: topic.role for topic in report.topics if 'a' in topic.role}[
        '/battery_state'
    ] == 'covariate'


# --- numbers -------------------------------------------------------------------------------------


def scale_rates(factor: float) -> Callable[[ImuSample], ImuSample]:
    return lambda item: replace(item, rate_rad_s=scaled(factor, item.rate_rad_s))


def scale_forces(factor: float) -> Callable[[ImuSample], ImuSample]:
    return lambda item: replace(item, specific_force_m_s2=scaled(factor, item.specific_force_m_s2))


def scale_yaw(factor: float) -> Callable[[ImuSample], ImuSample]:
    return lambda item: replace(item, rate_rad_s=(*item.rate_rad_s[:2], factor * item.rate_rad_s[2]))


def lean(pitch_deg: float) -> Callable[[ImuSample], ImuSample]:
    pitch = math.radians(pitch_deg)
    force = (-9.8 * math.sin(pitch), 0.0, 9.8 * math.cos(pitch))
    return lambda item: replace(item, specific_force_m_s2=force)


def scaled(factor: float, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = vector
    return factor * x, factor * y, factor * z


@pytest.mark.parametrize(
    'kind, change, expected, severity',
    [
        (ImuSample, scale_rates(math.degrees(1.0)), 'unit_degrees', Severity.ERROR),
        (ImuSample, scale_rates(0.0), 'dead_imu', Severity.ERROR),
        (ImuSample, scale_yaw(1e-4), 'dead_imu', Severity.ERROR),
        (ImuSample, scale_rates(-1.0), 'opposite_turns', Severity.WARNING),
        (ImuSample, scale_rates(1.5), 'turns_disagree', Severity.WARNING),
        (ImuSample, scale_forces(1 / 9.81), 'unit_g', Severity.WARNING),
        (ImuSample, scale_forces(0.6), 'odd_gravity', Severity.WARNING),
        (ImuSample, scale_forces(0.0), 'no_accelerometer', Severity.NOTE),
        (ImuSample, scale_forces(math.nan), 'no_accelerometer', Severity.NOTE),
        (ImuSample, lean(6.0), 'tilted_imu', Severity.NOTE),
        (
            WheelSample,
            lambda s: replace(s, yaw_rate_rad_s=57.3 * s.yaw_rate_rad_s),
            'unit_degrees',
            Severity.WARNING,
        ),
        (
            WheelSample,
            lambda s: replace(s, speed_m_s=0.0, yaw_rate_rad_s=0.0),
            'dead_wheels',
            Severity.WARNING,
        ),
        (WheelSample, lambda s: replace(s, yaw_rate_rad_s=0.0), 'no_wheel_turns', Severity.WARNING),
        (
            FeatureObservations,
            lambda s: FeatureObservations(s.t_ns, s.ids[:2], s.pixels[:2]),
            'few_features',
            Severity.WARNING,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, ids=np.zeros_like(s.ids)),
            'damaged_features',
            Severity.ERROR,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, pixels=np.where(s.pixels < 35.5, math.nan, s.pixels)),
            'not_finite',
            Severity.WARNING,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, ids=s.ids + 100 * round(10.0 * time_s(s))),
            'no_tracks',
            Severity.ERROR,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, pixels=s.pixels + [20.0, 0.0]),
            'outside_image',
            Severity.WARNING,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, pixels=s.pixels / 2.0),
            'empty_part',
            Severity.WARNING,
        ),
        (
            FeatureObservations,
            lambda s: replace(s, pixels=s.pixels / 64.0 - 0.6),
            'no_pixels',
            Severity.WARNING,
        ),
        (
            TemperatureSample,
            lambda s: replace(s, temperature_c=s.temperature_c + 273.15),
            'unit_kelvin',
            Severity.WARNING,
        ),
        (
            TemperatureSample,
            lambda s: replace(s, temperature_c=1.8 * s.temperature_c + 32.0),
            'unit_fahrenheit',
            Severity.WARNING,
        ),
    ],
)
def test_implausible_numbers(
    tmp_path: Path, kind: type, change: Callable[[Any], Any], expected: str, severity: Severity
) -> None:
    issues = issues_by_kind(check(tmp_path, with_changed(kind, change)))
    assert list(issues) == [expected]
    assert issues[expected].severity is severity


@pytest.mark.parametrize(('shift', 'sign', 'axis'), [(1, 1.0, 'x'), (2, -1.0, '-y')])
def test_exchanged_axes_are_named(tmp_path: Path, shift: int, sign: float, axis: str) -> None:
    def exchange(item: ImuSample) -> ImuSample:
        rates = np.roll(item.rate_rad_s, shift) * sign
        return replace(item, rate_rad_s=(rates[0], rates[1], rates[2] + 1e-3 * math.sin(item.t_ns)))

    issue = issues_by_kind(check(tmp_path, with_changed(ImuSample, exchange)))['exchanged_axes']
    assert issue.severity is Severity.ERROR
    assert f'its {axis} axis turns as /wheel/odometry' in issue.text


@pytest.mark.parametrize(('late_s', 'side'), [(0.2, 'behind'), (-0.15, 'ahead of'), (0.05, '')])
def test_delayed_wheels(tmp_path: Path, late_s: float, side: str) -> None:
    def rate(at_s: float) -> float:
        return 0.6 * math.sin(0.7 * at_s) + 0.5 * math.sin(1.9 * at_s + 1.0) + 0.3 * math.sin(3.1 * at_s)

    def turned(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample):
            return replace(item, rate_rad_s=(*item.rate_rad_s[:2], rate(time_s(item))))
        if isinstance(item, WheelSample):
            return replace(item, yaw_rate_rad_s=rate(time_s(item) - late_s))
        return item

    issues = issues_by_kind(check(tmp_path, map(turned, drive(30.0))))
    assert ('delayed_turns' in issues) == bool(side)
    if side:
        assert issues['delayed_turns'].severity is Severity.WARNING
        found = re.fullmatch(
            rf'its turns are (.*) s {side} those of /imu/data_raw', issues['delayed_turns'].text
        )
        # The wheels come every 0.05 s, so that a turn is counted half of that late.
        assert found and float(found[1]) == pytest.approx(abs(late_s + 0.025), abs=0.025)


@pytest.mark.parametrize(
    ('late_s', 'mirrored', 'upward', 'expected'),
    [
        (0.0, 1.0, 1.0, []),
        (0.05, 1.0, -1.0, []),
        (0.3, 1.0, 1.0, ['delayed_turns']),
        (-0.2, 1.0, -1.0, ['delayed_turns']),
        (0.0, -1.0, 1.0, ['opposite_turns']),
        (0.0, -1.0, -1.0, ['opposite_turns']),
    ],
)
def test_images_that_turn_late_or_the_other_way(
    tmp_path: Path, late_s: float, mirrored: float, upward: float, expected: list[str]
) -> None:
    """A camera that looks up sees the ceiling turn to the right in its image while the robot turns left."""

    def yaw(at_s: float) -> float:
        return -0.9 * math.cos(0.7 * at_s) - 0.26 * math.cos(1.9 * at_s + 1.0) - 0.1 * math.cos(3.1 * at_s)

    def turned(item: Measurement) -> Measurement:
        if isinstance(item, ImuSample):
            rate = (yaw(time_s(item) + 5e-3) - yaw(time_s(item) - 5e-3)) / 0.01
            return replace(item, rate_rad_s=(*item.rate_rad_s[:2], rate))
        if isinstance(item, WheelSample):
            rate = (yaw(time_s(item)) - yaw(time_s(item) - 0.05)) / 0.05
            return replace(item, yaw_rate_rad_s=rate)
        if isinstance(item, FeatureObservations):
            angles = 0.9 * np.arange(6.0) - upward * yaw(time_s(item) - late_s)
            pixels = np.column_stack([32.0 + mirrored * 20.0 * np.cos(angles), 24.0 + 20.0 * np.sin(angles)])
            return FeatureObservations(item.t_ns, np.arange(6), pixels)
        return item

    R_bs = RIG.camera_mount.R_bs if upward > 0.0 else np.diag([1.0, -1.0, -1.0])
    rig = replace(RIG, camera_mount=replace(RIG.camera_mount, R_bs=R_bs))
    report = check_bag(write(tmp_path / 'bag', map(turned, drive(30.0)), rig), Config())
    assert [issue.kind for issue in report.issues] == expected
    assert all(issue.topic == '/ceiling_camera/features' for issue in report.issues)
    if late_s in (0.3, -0.2):
        found = re.match(r'its turns are (.*) s (behind|ahead of) those', report.issues[0].text)
        assert found and float(found[1]) == pytest.approx(abs(late_s), abs=0.05)
        assert (found[2] == 'behind') == (late_s > 0.0)


def test_degrees_without_wheels_for_comparison(tmp_path: Path) -> None:
    samples = [scale_rates(50.0)(item) if isinstance(item, ImuSample) else item for item in drive()]
    report = check(tmp_path, [item for item in samples if not isinstance(item, WheelSample)])
    assert issues_by_kind(report)['unit_degrees'].topic == '/imu/data_raw'


def test_nan(tmp_path: Path) -> None:
    def with_nan_rate(sample: ImuSample) -> ImuSample:
        return replace(sample, rate_rad_s=(math.nan, 0.0, 0.0)) if 4.0 < time_s(sample) < 4.1 else sample

    issues = issues_by_kind(check(tmp_path, with_changed(ImuSample, with_nan_rate)))
    assert list(issues) == ['not_finite']
    assert '9 of 1000' in issues['not_finite'].text


def test_readings_that_no_motion_explains(tmp_path: Path) -> None:
    rng, kept = np.random.default_rng(1), (0.0, 0.0, 0.0)

    def with_faults(sample: ImuSample) -> ImuSample:
        nonlocal kept
        x, y, z = sample.rate_rad_s
        if 8.05 < time_s(sample) < 8.305:
            return replace(sample, rate_rad_s=kept)
        if abs(time_s(sample) - 4.0) < 0.001:
            return replace(sample, rate_rad_s=(x, y, z - 5.0))
        kept = (x, y, z + 0.001 * rng.standard_normal())
        return replace(sample, rate_rad_s=kept)

    issues = issues_by_kind(check(tmp_path, with_changed(ImuSample, with_faults)))
    assert set(issues) == {'spikes', 'frozen_readings'}
    assert '1 reading of the gyro is far' in issues['spikes'].text
    assert '25 readings of the gyro repeat' in issues['frozen_readings'].text


def test_speeds_that_no_motion_explains(tmp_path: Path) -> None:
    def with_spike(sample: WheelSample) -> WheelSample:
        return replace(sample, speed_m_s=6.0) if 4.0 < time_s(sample) < 4.04 else sample

    issues = issues_by_kind(check(tmp_path, with_changed(WheelSample, with_spike)))
    assert list(issues) == ['spikes'] and '1 speed is far' in issues['spikes'].text
    assert issues['spikes'].topic == '/wheel/odometry'


@pytest.mark.parametrize(
    'R_ib, words',
    [(np.diag([1.0, -1.0, -1.0]), '180 deg about x'), (np.diag([1.0, -1.0, -1.0])[[2, 1, 0]], 'deg about y')],
)
def test_gravity_on_the_wrong_axis(tmp_path: Path, R_ib: np.ndarray, words: str) -> None:
    issues = issues_by_kind(check(tmp_path, turned_imu(drive(), R_ib)))
    assert list(issues) == ['imu_mount']
    assert words in issues['imu_mount'].todo


def test_a_robot_that_never_turns(tmp_path: Path) -> None:
    def straight(sample: Any) -> Any:
        if isinstance(sample, WheelSample):
            return replace(sample, yaw_rate_rad_s=0.0)
        return replace(sample, rate_rad_s=(0.0, 0.0, 0.02 + 0.01 * math.sin(40 * time_s(sample))))

    issues = issues_by_kind(check(tmp_path, with_changed(ImuSample | WheelSample, straight)))
    assert list(issues) == ['no_turns']
    assert issues['no_turns'].severity is Severity.ERROR
    assert 'turn on the spot' in issues['no_turns'].todo


def test_a_robot_that_turns_to_one_side(tmp_path: Path) -> None:
    def left(sample: Any) -> Any:
        if isinstance(sample, WheelSample):
            return replace(sample, yaw_rate_rad_s=abs(sample.yaw_rate_rad_s))
        return replace(sample, rate_rad_s=(0.0, 0.0, abs(sample.rate_rad_s[2])))

    assert list(issues_by_kind(check(tmp_path, with_changed(ImuSample | WheelSample, left)))) == [
        'one_way_turns'
    ]


# --- stamps --------------------------------------------------------------------------------------


def test_a_gap(tmp_path: Path) -> None:
    issues = issues_by_kind(
        check(tmp_path, with_changed(ImuSample, lambda s: None if 3.0 < time_s(s) < 5.5 else s))
    )
    assert list(issues) == ['gap']
    assert '1 gap, the longest 2.5 s, 3.0 s after the start' in issues['gap'].text


def test_lost_samples_are_no_irregular_stamps(tmp_path: Path) -> None:
    lossy = with_changed(ImuSample, lambda s: None if round(100 * time_s(s)) % 7 == 3 else s)
    issues = issues_by_kind(check(tmp_path, lossy))
    assert (
        list(issues) == ['lost_samples'] and '14% of the samples are missing' in issues['lost_samples'].text
    )


def test_stamps_in_bursts_are_no_lost_samples(tmp_path: Path) -> None:
    """Four samples of a message of the bus got the time of its arrival, with the steps of a clock."""

    def in_fours(sample: Any, t: float) -> tuple[float, float]:
        number = round(100 * t)
        return (0.01 * (number - number % 4) + 2e-4 * (number % 4) if is_imu(sample) else t), t

    issues = issues_by_kind(check_restamped(tmp_path, in_fours))
    assert list(issues) == ['irregular_stamps']
    assert 'in bursts: 0.2 ms apart, 10 ms on average' in issues['irregular_stamps'].text


def check_restamped(path: Path, change: Callable[[Any, float], tuple[float, float]]) -> CheckReport:
    """Check the drive with its stamps and times of recording (s since the start) changed."""
    with new_bag(path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for sample in drive():
            stamp_s, recorded_s = change(sample, time_s(sample))
            t_ns, recorded_ns = (START_NS + round(value * NS_PER_S) for value in (stamp_s, recorded_s))
            if isinstance(sample, FeatureObservations):
                sample = FeatureObservations(t_ns, sample.ids, sample.pixels)
            else:
                sample = replace(sample, t_ns=t_ns)
            bag.write(sample, recorded_ns=recorded_ns)
    return check_bag(path / 'bag', Config())


def is_imu(sample: Measurement, from_s: float = 0.0, to_s: float = 99.0) -> bool:
    return isinstance(sample, ImuSample) and from_s <= time_s(sample) < to_s


@pytest.mark.parametrize(
    'change, expected',
    [
        (lambda s, t: (5.0 if is_imu(s, 5.0, 5.2) else t, t), {'repeated_stamps', 'gap'}),
        (lambda s, t: (t - 0.2 if is_imu(s, 5.0, 5.1) else t, t), {'backward_stamps', 'gap'}),
        (lambda s, t: (t + 0.008 * (round(100 * t) % 2) if is_imu(s) else t, t), {'irregular_stamps'}),
        (lambda s, t: (t + 0.002 * (round(100 * t) % 2) if is_imu(s) else t, t), set()),
        (lambda s, t: (t, t + 0.015 * (round(100 * t) % 2) if is_imu(s) else t), {'backward_stamps'}),
        (lambda s, t: (t + 0.06 * (t % 2.0) / 2.0 if is_imu(s) else t, t), {'backward_stamps'}),
        (lambda s, t: (t + 60.0 if is_imu(s, 5.0) else t, t), {'clock_jump'}),
        (lambda s, t: (t - 60.0 if is_imu(s, 5.0, 5.005) else t, t), {'clock_jump'}),
        (lambda s, t: (t, t + 2.0 if isinstance(s, FeatureObservations) and t > 5.0 else t), {'late'}),
        (lambda s, t: (t - 0.8 if is_imu(s) else t, t), {'clocks_differ'}),
        (
            lambda s, t: (t + 3.0 if is_imu(s, 5.0, 5.5) else t, t),
            {'backward_stamps', 'clocks_differ', 'gap', 'late', 'other_clock'},
        ),
        (lambda s, t: (t, t + 1000.0), {'other_clock'}),
    ],
)
def test_stamps(
    tmp_path: Path, change: Callable[[Any, float], tuple[float, float]], expected: set[str]
) -> None:
    report = check_restamped(tmp_path, change)
    assert {issue.kind for issue in report.issues} == expected
    assert report.usable


@pytest.mark.parametrize('offset_s', [2.0, -2.0, 100.0])
def test_clocks_too_far_apart_to_be_used_together(tmp_path: Path, offset_s: float) -> None:
    """Within two seconds the messages of one topic would already be too late to be sorted in."""
    report = check_restamped(tmp_path, lambda s, t: (t - offset_s if is_imu(s) else t, t))
    errors = {issue.kind for issue in report.issues if issue.severity is Severity.ERROR}
    assert errors == {'clocks_differ'}


def test_unset_stamps(tmp_path: Path) -> None:
    report = check_restamped(tmp_path, lambda s, t: (-START_NS / NS_PER_S if is_imu(s) else t, t))
    assert issues_by_kind(report)['unset_stamps'].severity is Severity.ERROR


@pytest.mark.parametrize(
    ('kind', 'stamp_s'),
    [
        (ImuSample, lambda t: 5.0),
        (ImuSample, math.floor),
        (ImuSample, lambda t: math.floor(t) + 1e-3 * (t % 1.0)),
        (FeatureObservations, lambda t: 5.0),
    ],
)
def test_stamps_that_are_no_times_of_measurements(
    tmp_path: Path, kind: type, stamp_s: Callable[[float], float]
) -> None:
    """All alike, of whole seconds, or with microseconds in place of nanoseconds: no turn is missed then."""
    report = check_restamped(tmp_path, lambda s, t: (stamp_s(t) if isinstance(s, kind) else t, t))
    errors = [issue for issue in report.issues if issue.severity is Severity.ERROR]
    assert [issue.kind for issue in errors] == ['unusable_stamps']
    assert errors[0].topic == ('/imu/data_raw' if kind is ImuSample else '/ceiling_camera/features')


def test_a_topic_that_covers_only_a_part_of_the_time(tmp_path: Path) -> None:
    late = with_changed(FeatureObservations, lambda s: s if time_s(s) > 3.0 else None)
    assert list(issues_by_kind(check(tmp_path, late))) == ['begins_late']
    early = with_changed(WheelSample, lambda s: s if time_s(s) < 6.0 else None)
    assert list(issues_by_kind(check(tmp_path / 'early', early))) == ['ends_early']


def test_an_imu_that_covers_only_a_part_of_the_time(tmp_path: Path) -> None:
    short = with_changed(ImuSample, lambda s: s if 3.0 < time_s(s) < 6.0 else None)
    issues = check(tmp_path, short).issues
    texts = [issue.text for issue in issues if issue.topic == '/imu/data_raw']
    assert any('ends' in text and 'before /ceiling_camera/features' in text for text in texts)
    assert any('begins' in text and 'after /wheel/odometry' in text for text in texts)


def test_messages_that_are_sent_again_are_neither_gaps_nor_turns(tmp_path: Path) -> None:
    """A broker that repeats each message a second later."""
    with new_bag(tmp_path / 'bag') as bag:
        bag.write_rig(RIG, START_NS)
        for sample in drive():
            bag.write(sample)
            if isinstance(sample, WheelSample) and time_s(sample) > 1.0:
                again = replace(sample, t_ns=sample.t_ns - NS_PER_S)
                bag.write(again, recorded_ns=sample.t_ns)
    report = check_bag(tmp_path / 'bag', Config())
    assert {issue.kind for issue in report.issues} == {'backward_stamps'}


def test_the_speed_of_the_wheels_in_another_unit(tmp_path: Path) -> None:
    fast = with_changed(WheelSample, lambda s: replace(s, speed_m_s=1000.0 * s.speed_m_s))
    issue = issues_by_kind(check(tmp_path, fast))['not_finite']
    assert issue.severity is Severity.ERROR and 'unit' in issue.todo


def changed_copy(path: Path, kind: str, change: Callable[[Any], list[Any]]) -> CheckReport:
    """Check a copy of the drive with other messages in place of each message of a type."""

    def rewritten(message: RawMessage) -> list[RawMessage]:
        if message.type_name != kind:
            return [message]
        contents = change(decode(message))
        return [replace(message, content=encode(content, kind)) for content in contents]

    rewrite_bag(write(path / 'drive'), path / 'changed', rewritten)
    return check_bag(path / 'changed', Config())


def test_a_calibration_of_the_camera_that_changes(tmp_path: Path) -> None:
    def with_another(info: Any) -> list[Any]:
        other = copy.deepcopy(info)
        other.k = np.full(9, 40.0)
        return [info, info, other]

    issue = issues_by_kind(changed_copy(tmp_path, topics.CAMERA_INFO, with_another))['camera_changes']
    assert issue.severity is Severity.WARNING


def test_a_camera_calibrated_at_another_resolution(tmp_path: Path) -> None:
    def with_half_the_intrinsics(info: Any) -> list[Any]:
        info.k = 0.5 * info.k
        return [info]

    def with_half_the_size(info: Any) -> list[Any]:
        info.width, info.height, info.k = info.width // 2, info.height // 2, 0.5 * info.k
        return [info]

    (tmp_path / 'centre').mkdir()
    (tmp_path / 'size').mkdir()
    off = issues_by_kind(changed_copy(tmp_path / 'centre', topics.CAMERA_INFO, with_half_the_intrinsics))
    assert off['off_centre'].severity is Severity.WARNING
    small = changed_copy(tmp_path / 'size', topics.CAMERA_INFO, with_half_the_size)
    assert any('camera_info is that of' in issue.text for issue in small.issues) and not small.usable
    whole = changed_copy(tmp_path, topics.CAMERA_INFO, lambda info: [info])
    assert not {'off_centre'} & {issue.kind for issue in whole.issues}


def test_a_frame_of_the_imu_that_no_transform_leads_to(tmp_path: Path) -> None:
    def with_imu_link(message: Any) -> list[Any]:
        link = copy.deepcopy(message.transforms[0])
        link.child_frame_id = 'imu_board'
        message.transforms.append(link)
        return [message]

    issue = issues_by_kind(changed_copy(tmp_path, topics.TRANSFORMS, with_imu_link))['imu_frame']
    assert "'imu_link', but one to 'imu_board'" in issue.text


def test_a_slow_imu(tmp_path: Path) -> None:
    slow = with_changed(ImuSample, lambda s: s if round(time_s(s) * 100) % 10 == 0 else None)
    assert '10 messages a second' in issues_by_kind(check(tmp_path, slow))['slow'].text


# --- topics --------------------------------------------------------------------------------------


def test_a_missing_camera_calibration_and_wrong_remaps(tmp_path: Path) -> None:
    with new_bag(tmp_path / 'bag') as bag:
        for sample in drive():
            bag.write(sample)
    report = check_bag(tmp_path / 'bag', Config(), remap={'wheel/odometry': '/wheel/odom'})
    assert not report.usable
    errors = [str(issue) for issue in report.issues if issue.severity is Severity.ERROR]
    assert any(
        '/wheel/odom: there is no such topic; did you mean /wheel/odometry?' in error for error in errors
    )
    assert any('the camera has no calibration' in error for error in errors)


def test_candidate_topics_are_checked(tmp_path: Path) -> None:
    """A wrong mounting is detected although the topic has another name."""
    path = write(tmp_path / 'bag', turned_imu(drive(), np.diag([1.0, -1.0, -1.0])))
    report = check_bag(path, Config(), remap={'imu/data_raw': '/nowhere'})
    assert {'missing_topic', 'imu_mount'} <= {issue.kind for issue in report.issues}


def test_an_image_of_another_size(tmp_path: Path) -> None:
    images = with_changed(FeatureObservations, lambda s: Frame(s.t_ns, np.zeros((24, 32), np.uint8)))
    assert '32x24' in issues_by_kind(check(tmp_path, images))['camera'].text


def test_a_camera_that_is_not_calibrated(tmp_path: Path) -> None:
    rig = Rig(replace(CAMERA, fx_px=0.0), RIG.camera_mount)
    report = check_bag(write(tmp_path / 'bag', rig=rig), Config())
    assert 'not calibrated' in issues_by_kind(report)['camera'].text


def test_the_worst_issue_of_each_kind() -> None:
    issues = [
        BagIssue(severity, kind, '', '')
        for severity, kind in [(Severity.NOTE, 'gap'), (Severity.WARNING, 'late'), (Severity.WARNING, 'gap')]
    ]
    assert worst_per_kind(issues) == [issues[2], issues[1]]


# --- the command ---------------------------------------------------------------------------------


def test_the_command_prints_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / 'bag', with_changed(ImuSample, lambda s: None if 3.0 < time_s(s) < 5.5 else s))
    assert main(['check', str(path)]) == 0
    out = capsys.readouterr().out
    assert '/ceiling_camera/features' in out
    assert 'warning: /imu/data_raw: 1 gap' in out
    assert 'This bag can be used for a calibration.' in out


def test_the_command_prints_one_json_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / 'bag', with_changed(TruthSample, lambda s: None))
    assert main(['check', str(path), '--json', '-r', 'imu/data_raw:=/imu/data_raw']) == 0
    report = json.loads(capsys.readouterr().out)
    assert report['usable'] is True
    assert report['findings'] == []
    assert {topic['role'] for topic in report['topics']} >= {'imu/data_raw', 'wheel/odometry', 'covariate'}


@pytest.mark.parametrize('option', [[], ['--json']])
def test_the_command_fails_where_the_bag_cannot_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: list[str]
) -> None:
    path = write(tmp_path / 'bag', with_changed(ImuSample, scale_rates(0.0)))
    assert main(['check', str(path), *option]) == 2
    captured = capsys.readouterr()
    assert 'dead_imu' in captured.out if option else 'error: /imu/data_raw: the gyro' in captured.out
    assert captured.err == (
        f'gyrocal: error: {path}: this bag cannot be used for a calibration; mend the errors above\n'
    )


@pytest.mark.parametrize(
    'arguments', [['nothing'], ['bag', '-r', 'imu'], ['bag', '--config', 'nothing.yaml'], []]
)
def test_the_command_refuses_bad_input_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'bag', drive(1.0))
    assert main(['check', *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.startswith('gyrocal: error: ') and captured.err.count('\n') == 1


# --- a check while the recording is read ---------------------------------------------------------


@pytest.fixture
def passes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the topics of all messages that are read from now on."""
    read: list[str] = []
    raw_messages = Storage.raw_messages

    def counted(storage: Storage, used: Collection[Topic]) -> Iterator[tuple[str, int, bytes]]:
        for message in raw_messages(storage, used):
            read.append(message[0])
            yield message

    monkeypatch.setattr(Storage, 'raw_messages', counted)
    return read


def test_a_bag_is_read_once_to_check_it_and_to_use_it(tmp_path: Path, passes: list[str]) -> None:
    unmoved = with_changed(WheelSample, lambda sample: replace(sample, speed_m_s=2.0 * sample.speed_m_s))
    path = write(tmp_path / 'bag', unmoved)
    expected = check_bag(path, Config())
    passes.clear()
    with checked_bag(path, Config(), with_covariates=False) as checked:
        measured = list(checked.source.measurements())
        once = passes.count('/imu/data_raw')
        assert list(checked.source.measurements()) and len(measured) > 1000
    assert checked.issues == expected.issues
    imu = next(topic for topic in expected.topics if topic.name == '/imu/data_raw')
    assert imu.count < once < 1.5 * imu.count, 'beside the pass only the first seconds are read'


def test_a_bag_that_is_not_read_to_its_end_is_checked_all_the_same(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', with_changed(ImuSample, scale_rates(0.0)))
    with (
        pytest.raises(RecordingError, match='zero'),
        checked_bag(path, Config(), with_covariates=False) as checked,
    ):
        next(iter(checked.source.measurements()))


def test_an_error_of_the_recording_explains_one_of_its_use(tmp_path: Path) -> None:
    path = write(tmp_path / 'bag', with_changed(ImuSample, scale_rates(0.0)))
    with pytest.raises(RecordingError, match='zero'), checked_bag(path, Config(), with_covariates=False):
        raise ZeroDivisionError
    good = write(tmp_path / 'good')
    with pytest.raises(ZeroDivisionError), checked_bag(good, Config(), with_covariates=False):
        raise ZeroDivisionError


def test_an_error_of_a_calibration_comes_with_the_warnings_of_the_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wheels that read nothing may be why it fails."""
    still = with_changed(WheelSample, lambda sample: replace(sample, speed_m_s=0.0, yaw_rate_rad_s=0.0))
    path = write(tmp_path / 'bag', still)
    (expected,) = [str(issue) for issue in check_bag(path, Config()).issues if issue.kind == 'dead_wheels']
    with (
        pytest.raises(FilterDivergedError),
        warned_bag(path, Config(), with_covariates=False) as checked,
    ):
        next(iter(checked.source.measurements()))
        raise FilterDivergedError('the innovations of the images exceed 5 px')
    assert f'gyrocal: warning: {expected}' in capsys.readouterr().err


# --- third-party recordings ----------------------------------------------------------------------


@needs_recordings
def test_wheels_that_slip_are_unfit_as_a_heading_reference() -> None:
    odometry = '/jackal_velocity_controller/odom'
    remap = {'imu/data_raw': '/imu/data', 'wheel/odometry': odometry}
    report = check_bag(JACKAL, Config(), remap=remap, heading_reference=odometry)
    issue = issues_by_kind(report)['turns_disagree']
    assert issue.severity is Severity.ERROR
    assert 'unfit as a heading reference' in issue.todo


@needs_recordings
def test_topics_of_a_foreign_bag_are_suggested() -> None:
    text = ' '.join(str(issue) for issue in check_bag(JACKAL, Config()).issues)
    assert 'give -r imu/data_raw:=/imu/data' in text
    assert 'give -r wheel/odometry:=/jackal_velocity_controller/odom' in text
    assert '--heading-reference /jackal_velocity_controller/odom' in text


@pytest.mark.slow
@needs_recordings
def test_an_imu_on_its_side_and_one_that_reads_zero() -> None:
    kinds = {issue.kind for issue in check_bag(SHARED / 'test1_husky.bag', Config()).issues}
    assert 'imu_mount' in kinds
    report = check_bag(SHARED / 'test1_2014_xsens_wheel_stereo.bag', Config())
    assert topic_of_issue(report, 'dead_imu') == '/my_odometry2imu/imu_data'


def topic_of_issue(report: CheckReport, kind: str) -> str:
    return next(issue.topic for issue in report.issues if issue.kind == kind)
