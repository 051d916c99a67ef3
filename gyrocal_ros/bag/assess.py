"""Assessment of a recording: issues derived from the statistics of its scan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from gyrocal_ros.bag.feature_stats import FeatureStats
from gyrocal_ros.bag.scan import BagScan, TopicScan
from gyrocal_ros.bag.selection import NEEDED_ROLES
from gyrocal_ros.bag.topic_stats import EventStats, TurnComparison, TurnStats, compare_turns, turn_delay
from gyrocal_ros.data import seconds
from gyrocal_ros.model.faulty_readings import FaultyGyro
from gyrocal_ros.msgs import clouds
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import Role

ERROR, WARNING, NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE

MIN_RATE_HZ = {Role.IMU: 15.0, Role.WHEELS: 8.0, Role.FEATURES: 4.0, Role.IMAGE: 4.0, Role.HEADING: 1.0}
"""Minimum rate of a topic; slower ones follow turns badly."""
MAX_NAN_SHARE = 0.1
"""Share of messages with NaN above which a topic cannot be used."""
MAX_UNCOVERED_S = 2.0
"""Limit of the time at the start or the end that the IMU, or another topic, does not cover."""
MAX_CLOCK_OFFSET_S = 0.5
"""Limit of the offset between the stamps of two topics that use the same clock."""
MAX_UNEVEN_SHARE, MAX_LOST_SHARE = 0.02, 0.02
"""Share of irregular intervals of the IMU above which its stamps are not the times of measurement, and share
of its samples that are lost above which that is reported."""
MAX_STAMP_OFFSET_S = 1.0
"""Limit of the offset between the stamps and the time of recording on the same clock."""

DEGREES = 180.0 / math.pi
MIN_TURN_DEG, FEW_TURNS_DEG = 20.0, 180.0
"""Total turns below which the scale factor is not observable, and weakly observable."""
ONE_WAY_SHARE = 0.1
"""Share of the total turn below which one direction counts as missing."""
MAX_TILT_RAD, MAX_LEAN_RAD = math.radians(3.0), math.radians(40.0)
"""Lean of an IMU against gravity that is reported, and up to which it is a tilt."""
MAX_RATE_RAD_S = 20.0
"""Limit of the turning rate of a robot on a floor; higher readings are probably in degrees."""
MAX_TURN_RATIO, MIN_CORRELATION = 1.2, 0.85
"""Limits of the ratio and the correlation of the turns of two sensors that agree."""
MAX_REFERENCE_RATIO, MIN_REFERENCE_CORRELATION = 2.0, 0.7
"""Ratio of turns beyond which, and correlation below which, a heading reference is unfit; below the negative
of the correlation the sign is reversed."""
MAX_TURN_DELAY_S, DELAY_SIGMA = 0.1, 3.0
"""Delay of the turns of the wheels that is too long, by some of its standard deviations."""
TURNED_RAD = math.pi / 2.0
"""Total turn of the gyro from which a robot has driven."""
KELVIN_C = 200.0, 500.0
"""Readings of a thermometer between which they are in kelvin."""
MIN_FEATURES = 4.0
"""Minimum of the mean number of features per image."""
AXES_ADVICE = 'publish its mounting on /tf_static, or correct the order of the axes in its driver or firmware'
STAMP_AT_MEASUREMENT = (
    'turns are integrated over wrong times; let the driver stamp at the measurement, not on arrival'
)
TURN_ADVICE = 'turn on the spot, a few full turns to each side, some slow and some fast'


def assess(bag: BagScan, *, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of a recording.

    Args:
        bag: statistics of the recording.
        reorder_window_s: delay up to which a message is still sorted in.
    """
    stamped = [scan for scan in bag.topics if scan.stamps.unset < scan.stamps.count]
    for scan in bag.topics:
        if scan not in stamped:
            yield _issue(
                scan, ERROR, 'unset_stamps', 'all stamps are zero', 'the driver must set header.stamp'
            )
    imus = [scan for scan in stamped if scan.role is Role.IMU]
    for scan in stamped:
        yield from _stamp_issues(scan, reorder_window_s)
        yield from _nan_issues(scan)
        if imus and scan.role in NEEDED_ROLES and scan.role is not Role.IMU:
            yield from _synchronisation_issues(scan, imus[0], reorder_window_s)
    for imu in imus:
        yield from _imu_issues(imu, bag, _compare_with_imu(imu, stamped, bag))
    wheels, features = bag.of_role(Role.WHEELS), bag.of_role(Role.FEATURES)
    temperature = bag.of_role(Role.TEMPERATURE)
    if wheels:
        yield from _wheel_issues(wheels, imus, bag, is_stamped=wheels in stamped)
    if features:
        yield from _feature_issues(features, imus, bag, is_stamped=features in stamped)
    lowest_c, highest_c = bag.temperatures_c
    if temperature and KELVIN_C[0] < lowest_c <= highest_c < KELVIN_C[1]:
        text = f'reads {lowest_c:.0f} to {highest_c:.0f}: kelvin, not degrees Celsius'
        todo = 'the driver must publish degrees Celsius'
        yield BagIssue(WARNING, 'unit_kelvin', temperature.topic.name, text, todo)


def _wheel_issues(
    wheels: TopicScan, imus: Sequence[TopicScan], bag: BagScan, *, is_stamped: bool
) -> Iterator[BagIssue]:
    """Yield the issues of wheels that are late or dead, and of their readings."""
    for imu in imus if is_stamped else ():
        turns = bag.turns[wheels.role], imu, bag.imus[imu.topic.name].turns
        yield from _delay_issues(wheels, *turns, 'or is the odometry filtered?')
    turned_rad = (sum(map(abs, bag.imus[imu.topic.name].turns.left_right_rad)) for imu in imus)
    if not bag.wheels_move and max(turned_rad, default=0.0) > TURNED_RAD:
        text = 'the encoders read zero throughout, though the gyro turns'
        yield _issue(wheels, WARNING, 'dead_wheels', text, 'check their wires and their driver')
    if count := bag.wheels.spikes:
        noun = 'speed is' if count == 1 else 'speeds are'
        text = f'{count} {noun} far from those before and after'
        yield _issue(wheels, WARNING, 'spikes', text, 'they are replaced; check the wires of the encoders')


def _feature_issues(
    features: TopicScan, imus: Sequence[TopicScan], bag: BagScan, *, is_stamped: bool
) -> Iterator[BagIssue]:
    """Yield the issues of features: few, damaged, without a place, or turning otherwise than the gyro."""
    if bag.feature_count < MIN_FEATURES * features.stamps.count:
        mean = bag.feature_count / features.stamps.count
        yield _issue(features, WARNING, 'few_features', f'{mean:.1f} features an image', 'check the tracker')
    if bag.features:
        yield from _damaged_features(features, bag.features)
        for imu in imus if is_stamped else ():
            yield from _image_turn_issues(features, bag.features, imu, bag.imus[imu.topic.name].turns)


def _damaged_features(scan: TopicScan, features: FeatureStats) -> Iterator[BagIssue]:
    """Yield the issues of point clouds that cannot be used, and of features without a place."""
    if features.damaged:
        severity = ERROR if features.damaged > MAX_NAN_SHARE * features.count else WARNING
        text = f'{features.damaged} of {features.count} point clouds cannot be used: {features.reason}'
        yield _issue(scan, severity, 'damaged_features', text, clouds.REMEDY)
    if features.lost:
        text = f'{features.lost} of {features.features} features have no place in the image (NaN, or far off)'
        yield _issue(scan, WARNING, 'not_finite', text, f'they are left out; {clouds.REMEDY}')


def _image_turn_issues(
    scan: TopicScan, features: FeatureStats, imu: TopicScan, turns: TurnStats
) -> Iterator[BagIssue]:
    """Yield the issues of images that turn otherwise than the gyro, or at another time."""
    if abs(_clock_offset_s(scan, imu)) > MAX_CLOCK_OFFSET_S:
        return
    compared = compare_turns(turns, features.turns)
    if compared and compared.correlation < -MIN_REFERENCE_CORRELATION:
        text = f'its features turn in the opposite direction to {imu.topic.name}'
        todo = 'is the image mirrored, or camera or IMU upside down? publish their mounting on /tf_static'
        yield _issue(scan, WARNING, 'opposite_turns', text, todo)
    yield from _delay_issues(scan, features.turns, imu, turns, '`gyrocal diagnose` finds the offset')


def _compare_with_imu(
    imu: TopicScan, stamped: list[TopicScan], bag: BagScan
) -> dict[str, tuple[TopicScan, TurnComparison]]:
    """Return the comparison of the turns of wheels and heading reference with the gyro, by topic."""
    comparisons = {}
    for scan in stamped:
        if scan.role in bag.turns and abs(_clock_offset_s(scan, imu)) < MAX_CLOCK_OFFSET_S:
            compared = compare_turns(bag.imus[imu.topic.name].turns, bag.turns[scan.role])
            if compared:
                comparisons[scan.topic.name] = scan, compared
    return comparisons


def _clock_offset_s(scan: TopicScan, imu: TopicScan) -> float:
    """Return the offset by which the stamps of a topic are behind those of the IMU."""
    return scan.stamps.min_delay_s - imu.stamps.min_delay_s


def _issue(scan: TopicScan, severity: Severity, kind: str, text: str, todo: str = '') -> BagIssue:
    return BagIssue(severity if scan.role in NEEDED_ROLES else NOTE, kind, scan.topic.name, text, todo)


def _stamp_issues(scan: TopicScan, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of the stamps of a topic on its own."""
    stamps = scan.stamps

    def largest(events: EventStats, label: str) -> str:
        at_s = seconds(events.at_ns - stamps.first_ns)
        return f'{label} {abs(events.largest_s):.3g} s, {at_s:.1f} s after the start'

    if stamps.unset:
        yield _issue(scan, WARNING, 'unset_stamps', f'{stamps.unset} stamps are zero', 'they are left out')
    if stamps.jumped.count:
        text = f'the stamps jump relative to the time of recording, {largest(stamps.jumped, "by up to")}'
        yield _issue(scan, WARNING, 'clock_jump', text, 'a lasting jump starts a new time base')
    if count := stamps.repeated.count:
        text = f'{count} {"stamp repeats" if count == 1 else "stamps repeat"} the one before'
        yield _issue(scan, WARNING, 'repeated_stamps', text, 'such messages are left out')
    if count := stamps.backward.count:
        noun = 'stamp is' if count == 1 else 'stamps are'
        text = f'{count} {noun} earlier than the one before, {largest(stamps.backward, "by up to")}'
        todo = f'messages up to {reorder_window_s:g} s late are sorted in, later ones left out'
        yield _issue(scan, WARNING, 'backward_stamps', text, todo)
    if scan.role is Role.IMU and stamps.uneven > MAX_UNEVEN_SHARE * stamps.count:
        text = (
            f'{stamps.uneven / stamps.count:.0%} of the intervals between stamps differ from the usual '
            f'{1e3 / stamps.rate_hz:.3g} ms by more than half'
        )
        yield _issue(scan, WARNING, 'irregular_stamps', text, STAMP_AT_MEASUREMENT)
    elif scan.role is Role.IMU and stamps.lost > stamps.count:
        mean_ms = 1e3 * seconds(stamps.last_ns - stamps.first_ns) / stamps.count
        text = f'the stamps come in bursts: {1e3 / stamps.rate_hz:.3g} ms apart, {mean_ms:.2g} ms on average'
        yield _issue(scan, WARNING, 'irregular_stamps', text, STAMP_AT_MEASUREMENT)
    elif scan.role is Role.IMU and stamps.lost > MAX_LOST_SHARE * stamps.count:
        text = f'{stamps.lost / (stamps.lost + stamps.count):.0%} of the samples are missing'
        todo = 'turns are integrated over longer intervals; look at the load of the computer'
        yield _issue(scan, WARNING, 'lost_samples', text, todo)
    if count := stamps.gap.count:
        text = f'{count} {"gap" if count == 1 else "gaps"}, {largest(stamps.gap, "the longest")}'
        yield _issue(scan, WARNING, 'gap', text, 'were messages lost while recording?')
    if not stamps.jumped.count:
        if stamps.max_delay_s - stamps.min_delay_s > reorder_window_s:
            text = f'messages were recorded up to {stamps.max_delay_s - stamps.min_delay_s:.1f} s late'
            yield _issue(scan, WARNING, 'late', text, 'raise recording.reorder_window_s')
        if abs(stamps.min_delay_s) > MAX_STAMP_OFFSET_S:
            side = 'before' if stamps.min_delay_s > 0.0 else 'after'
            text = f'stamps are {abs(stamps.min_delay_s):.6g} s {side} the time of recording: another clock'
            yield _issue(scan, NOTE, 'other_clock', text)
    if stamps.rate_hz < MIN_RATE_HZ.get(scan.role, 0.0):
        text = f'only {stamps.rate_hz:.3g} messages a second'
        yield _issue(scan, WARNING, 'slow', text, f'at least {MIN_RATE_HZ[scan.role]:g} are recommended')


def _nan_issues(scan: TopicScan) -> Iterator[BagIssue]:
    if scan.invalid:
        share = scan.invalid / scan.topic.count
        severity = ERROR if share > MAX_NAN_SHARE else WARNING
        text = f'{scan.invalid} of {scan.topic.count} messages are damaged, not finite or far too large'
        yield _issue(scan, severity, 'not_finite', text, 'they are left out; check the driver and its unit')


def _synchronisation_issues(scan: TopicScan, imu: TopicScan, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of a topic that uses another clock than the IMU or does not cover its time."""
    if scan.stamps.jumped.count or imu.stamps.jumped.count:
        return
    offset_s = _clock_offset_s(scan, imu)
    if abs(offset_s) > MAX_CLOCK_OFFSET_S:
        usual_s = abs(scan.stamps.mean_delay_s - imu.stamps.mean_delay_s)
        # All messages of the later topic would then come too late to be sorted in.
        severity = ERROR if min(abs(offset_s), usual_s) > reorder_window_s else WARNING
        side = 'behind' if offset_s > 0.0 else 'ahead of'
        text = f'its stamps are {abs(offset_s):.6g} s {side} those of {imu.topic.name}'
        yield _issue(scan, severity, 'clocks_differ', text, 'use one clock for the stamps of all topics')
        return
    late_s = seconds(scan.stamps.first_ns - imu.stamps.first_ns)
    early_s = seconds(imu.stamps.last_ns - scan.stamps.last_ns)
    if abs(late_s) > MAX_UNCOVERED_S:
        topic, other = (scan, 'the IMU') if late_s > 0.0 else (imu, scan.topic.name)
        yield _issue(topic, WARNING, 'begins_late', f'begins {abs(late_s):.1f} s after {other}')
    if abs(early_s) > MAX_UNCOVERED_S:
        topic, other = (scan, 'the IMU') if early_s > 0.0 else (imu, scan.topic.name)
        yield _issue(topic, WARNING, 'ends_early', f'ends {abs(early_s):.1f} s before {other}')


def _imu_issues(
    imu: TopicScan, bag: BagScan, comparisons: Mapping[str, tuple[TopicScan, TurnComparison]]
) -> Iterator[BagIssue]:
    """Yield the issues of the readings of an IMU, and of the sensors whose turns are compared with it."""
    stats = bag.imus[imu.topic.name]
    if not stats.count:
        return
    if stats.zero_count == stats.count:
        text = 'the gyro reads exactly zero throughout'
        yield _issue(imu, ERROR, 'dead_imu', text, 'choose another IMU topic')
        return
    yield from _faulty_readings(imu, stats.faulty)
    yield from _accelerometer_issues(imu, stats.mean_force_m_s2, stats.tilt_rad)
    left, right = (turn * DEGREES for turn in stats.turns.left_right_rad)
    wheels = bag.turns.get(Role.WHEELS)
    by_wheels_deg = DEGREES * sum(wheels.left_right_rad) if wheels else 0.0
    if (
        wheels
        and by_wheels_deg > FEW_TURNS_DEG
        and left + right < MIN_TURN_DEG
        and not stats.turning_axis(wheels)
    ):
        text = f'reads a turn of {left + right:.0f} deg in total, the wheels turn {by_wheels_deg:.0f} deg'
        yield _issue(imu, ERROR, 'dead_imu', text, 'check its z axis, or choose another IMU topic')
        return
    for scan, compared in comparisons.values():
        if _is_degrees(1.0 / compared.ratio):
            text = f'turns {abs(1.0 / compared.ratio):.0f} times as much as {scan.topic.name}: in degrees?'
            yield _issue(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
            return
        axis = stats.turning_axis(bag.turns[scan.role])
        if axis and abs(compared.correlation) < MIN_REFERENCE_CORRELATION:
            text = (
                f'its {axis} axis turns as {scan.topic.name}, its z axis does not: the axes are exchanged, '
                'or the IMU is mounted otherwise'
            )
            yield _issue(imu, ERROR, 'exchanged_axes', text, AXES_ADVICE)
            return
        yield from _turn_issues(scan, imu, compared)
    if stats.largest_rate_rad_s > MAX_RATE_RAD_S and not comparisons:
        text = f'reads up to {stats.largest_rate_rad_s:.0f} rad/s: in degrees?'
        yield _issue(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
        return
    if left + right < MIN_TURN_DEG:
        text = f'the robot turns {left + right:.0f} deg in total: the scale factor is not observable'
        yield _issue(imu, ERROR, 'no_turns', text, TURN_ADVICE)
    elif left + right < FEW_TURNS_DEG:
        text = f'the robot turns only {left + right:.0f} deg in total: the scale factor is weakly observable'
        yield _issue(imu, WARNING, 'few_turns', text, TURN_ADVICE)
    elif min(left, right) < ONE_WAY_SHARE * (left + right):
        text = f'the robot turns {left:.0f} deg to the left, {right:.0f} deg to the right'
        yield _issue(imu, NOTE, 'one_way_turns', text, 'turns to both sides are needed to separate effects')


def _faulty_readings(imu: TopicScan, faulty: FaultyGyro) -> Iterator[BagIssue]:
    """Yield the issues of readings that no motion explains."""
    if count := faulty.spikes:
        noun = 'reading of the gyro is' if count == 1 else 'readings of the gyro are'
        text = f'{count} {noun} far from those before and after'
        yield _issue(imu, WARNING, 'spikes', text, 'they are left out; check the wires of the IMU')
    if count := faulty.frozen:
        text = f'{count} readings of the gyro repeat the one before, as if its driver had stalled'
        yield _issue(imu, WARNING, 'frozen_readings', text, 'they are left out; check its driver')


def _accelerometer_issues(imu: TopicScan, force_m_s2: float, tilt_rad: float) -> Iterator[BagIssue]:
    if force_m_s2 < 0.3:
        yield _issue(imu, NOTE, 'no_accelerometer', 'the accelerometer reads no gravity')
    elif 0.8 < force_m_s2 < 1.25:
        text = f'the accelerometer reads {force_m_s2:.2f}: g, not m/s^2'
        yield _issue(imu, WARNING, 'unit_g', text, 'the driver must publish m/s^2')
    elif not 9.0 < force_m_s2 < 11.0:
        text = f'the accelerometer reads {force_m_s2:.3g} m/s^2 on average where 9.8 is expected'
        yield _issue(imu, WARNING, 'odd_gravity', text, 'check its unit and its calibration')
    if MAX_TILT_RAD < tilt_rad < MAX_LEAN_RAD:
        text = (
            f'leans by {DEGREES * tilt_rad:.1f} deg against gravity on average: its yaw axis reads '
            f'{100.0 * (1.0 - math.cos(tilt_rad)):.2g} % of a turn less'
        )
        todo = 'corrected with a heading reference and three gyros; else publish its mounting on /tf_static'
        yield _issue(imu, NOTE, 'tilted_imu', text, todo)


def _turn_issues(scan: TopicScan, imu: TopicScan, compared: TurnComparison) -> Iterator[BagIssue]:
    """Yield the issues of wheels or a heading reference whose turns differ from those of the gyro."""
    if _is_degrees(compared.ratio):
        text = f'turns {abs(compared.ratio):.0f} times as much as {imu.topic.name}: in degrees?'
        yield _issue(scan, WARNING, 'unit_degrees', text, 'the driver must publish rad/s')
    elif compared.correlation < -MIN_REFERENCE_CORRELATION:
        text = f'turns in the opposite direction to {imu.topic.name}'
        todo = 'are left and right exchanged? is the IMU upside down? publish its mounting on /tf_static'
        yield _issue(scan, WARNING, 'opposite_turns', text, todo)
    elif compared.correlation < MIN_CORRELATION or not 1.0 / MAX_TURN_RATIO < compared.ratio < MAX_TURN_RATIO:
        text = (
            f'turns {compared.other_deg:.0f} deg in total, {imu.topic.name} {compared.this_deg:.0f} deg '
            f'(correlation {compared.correlation:.2f})'
        )
        if scan.role is not Role.HEADING:
            todo = 'unfit as a heading reference; do the wheels slip?'
            yield _issue(scan, WARNING, 'turns_disagree', text, todo)
        elif compared.correlation < MIN_REFERENCE_CORRELATION or not (
            1.0 / MAX_REFERENCE_RATIO < compared.ratio < MAX_REFERENCE_RATIO
        ):
            yield _issue(scan, ERROR, 'turns_disagree', text, 'unfit as a heading reference')
        else:
            todo = 'a noisy, drifting or late reference takes longer; give a better one if there is one'
            if not 1.0 / MAX_TURN_RATIO < compared.ratio < MAX_TURN_RATIO:
                todo = 'one of the two scale factors is far off; do the wheels of the reference slip?'
            yield _issue(scan, WARNING, 'turns_disagree', text, todo)


def _delay_issues(
    scan: TopicScan, turns: TurnStats, imu: TopicScan, by_gyro: TurnStats, question: str
) -> Iterator[BagIssue]:
    """Yield an issue of a sensor whose turns are stamped at other times than those of the gyro."""
    if abs(_clock_offset_s(scan, imu)) > MAX_CLOCK_OFFSET_S:
        return  # said already
    delay = turn_delay(by_gyro, turns)
    if delay is not None and abs(delay.delay_s) - DELAY_SIGMA * delay.std_s > MAX_TURN_DELAY_S:
        side = 'behind' if delay.delay_s > 0.0 else 'ahead of'
        text = f'its turns are {abs(delay.delay_s):.2f} s {side} those of {imu.topic.name}'
        todo = f'let the driver stamp at the measurement, not on arrival; {question}'
        yield _issue(scan, WARNING, 'delayed_turns', text, todo)


def _is_degrees(ratio: float) -> bool:
    """Return True if a ratio of two turns is about 180 / pi."""
    return 0.6 * DEGREES < abs(ratio) < 1.6 * DEGREES
