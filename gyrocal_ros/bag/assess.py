"""Assessment of a recording: issues derived from the statistics of its scan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from gyrocal_ros.bag.assess_stamps import (
    ERROR,
    MAX_CLOCK_OFFSET_S,
    NOTE,
    WARNING,
    clock_offset_s,
    issue_of,
    stamp_issues,
    synchronisation_issues,
    unusable_stamps,
)
from gyrocal_ros.bag.feature_stats import NEAR_PART, FeatureStats
from gyrocal_ros.bag.scan import BagScan, TopicScan
from gyrocal_ros.bag.selection import NEEDED_ROLES
from gyrocal_ros.bag.topic_stats import TurnComparison, TurnStats, compare_turns, turn_delay
from gyrocal_ros.model.faulty_readings import FaultyGyro
from gyrocal_ros.msgs import clouds
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.msgs.topics import Role

MAX_NAN_SHARE = 0.1
"""Share of messages with NaN above which a topic cannot be used."""
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
FAHRENHEIT_C = 62.0, 140.0
"""The same in degrees Fahrenheit: 17 to 60 deg C."""
MIN_FEATURES = 4.0
"""Minimum of the mean number of features per image."""
MIN_IMAGES = 20
"""Number of images from which features that none of them share are no chance."""
MAX_OUTSIDE_SHARE, MIN_EXTENT_PX = 0.05, 3.0
"""Share of features outside of the image, and extent of all of them, from which they are no pixels of it."""
MANY_FEATURES, FEW = 300, 0.005
"""Number of features from which more than this part of them lies in the right and in the lower part."""
AXES_ADVICE = 'publish its mounting on /tf_static, or correct the order of the axes in its driver or firmware'
TURN_ADVICE = 'turn on the spot, a few full turns to each side, some slow and some fast'


def assess(bag: BagScan, *, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of a recording.

    Args:
        bag: statistics of the recording.
        reorder_window_s: delay up to which a message is still sorted in.
    """
    stamped = []
    for scan in bag.topics:
        unusable = list(unusable_stamps(scan))
        yield from unusable
        if not unusable:
            stamped.append(scan)
    imus = [scan for scan in stamped if scan.role is Role.IMU]
    for scan in stamped:
        yield from stamp_issues(scan, reorder_window_s)
        yield from _nan_issues(scan)
        if imus and scan.role in NEEDED_ROLES and scan.role is not Role.IMU:
            yield from synchronisation_issues(scan, imus[0], reorder_window_s)
    for imu in imus:
        yield from _imu_issues(imu, bag, _compare_with_imu(imu, stamped, bag))
    wheels, features = bag.of_role(Role.WHEELS), bag.of_role(Role.FEATURES)
    temperature = bag.of_role(Role.TEMPERATURE)
    if wheels:
        yield from _wheel_issues(wheels, imus, bag, is_stamped=wheels in stamped)
    if features:
        yield from _feature_issues(features, imus, bag, is_stamped=features in stamped)
    if temperature:
        yield from _temperature_issues(temperature, *bag.temperatures_c)


def _temperature_issues(temperature: TopicScan, lowest_c: float, highest_c: float) -> Iterator[BagIssue]:
    """Yield the issues of the unit of a thermometer."""
    name, text = temperature.topic.name, f'reads {lowest_c:.0f} to {highest_c:.0f}: '
    todo = 'the driver must publish degrees Celsius'
    if KELVIN_C[0] < lowest_c <= highest_c < KELVIN_C[1]:
        yield BagIssue(WARNING, 'unit_kelvin', name, f'{text}kelvin, not degrees Celsius', todo)
    elif FAHRENHEIT_C[0] < lowest_c <= highest_c < FAHRENHEIT_C[1]:
        text += 'degrees Fahrenheit? No gyro indoors is that hot in degrees Celsius'
        yield BagIssue(WARNING, 'unit_fahrenheit', name, text, todo)


def _wheel_issues(
    wheels: TopicScan, imus: Sequence[TopicScan], bag: BagScan, *, is_stamped: bool
) -> Iterator[BagIssue]:
    """Yield the issues of wheels that are late or dead, and of their readings."""
    for imu in imus if is_stamped else ():
        turns = bag.turns[wheels.role], imu, bag.imus[imu.topic.name].turns
        yield from _delay_issues(wheels, *turns, 'or is the odometry filtered?')
    turned_rad = max(
        (sum(map(abs, bag.imus[imu.topic.name].turns.left_right_rad)) for imu in imus), default=0.0
    )
    if not bag.wheels_move and turned_rad > TURNED_RAD:
        text = 'the encoders read zero throughout, though the gyro turns'
        yield issue_of(wheels, WARNING, 'dead_wheels', text, 'check their wires and their driver')
    elif not bag.wheels_turn and turned_rad > TURNED_RAD:
        text = 'reads no turn throughout, though the gyro turns'
        yield issue_of(wheels, WARNING, 'no_wheel_turns', text, 'the driver must set twist.twist.angular.z')
    if count := bag.wheels.spikes:
        noun = 'speed is' if count == 1 else 'speeds are'
        text = f'{count} {noun} far from those before and after'
        yield issue_of(wheels, WARNING, 'spikes', text, 'they are replaced; check the wires of the encoders')


def _feature_issues(
    features: TopicScan, imus: Sequence[TopicScan], bag: BagScan, *, is_stamped: bool
) -> Iterator[BagIssue]:
    """Yield the issues of features: few, damaged, without a place, or turning otherwise than the gyro."""
    if bag.feature_count < MIN_FEATURES * features.stamps.count:
        mean = bag.feature_count / features.stamps.count
        yield issue_of(
            features, WARNING, 'few_features', f'{mean:.1f} features an image', 'check the tracker'
        )
    if bag.features:
        yield from _unusable_features(features, bag.features)
        for imu in imus if is_stamped else ():
            yield from _image_turn_issues(features, bag.features, imu, bag.imus[imu.topic.name].turns)


def _unusable_features(scan: TopicScan, features: FeatureStats) -> Iterator[BagIssue]:
    """Yield the issues of clouds that cannot be used, and of features that are not tracked or no pixels."""
    if features.damaged:
        severity = ERROR if features.damaged > MAX_NAN_SHARE * features.count else WARNING
        text = f'{features.damaged} of {features.count} point clouds cannot be used: {features.reason}'
        yield issue_of(scan, severity, 'damaged_features', text, clouds.REMEDY)
    if not features.are_tracked and features.with_features >= MIN_IMAGES:
        text = 'no id of a feature occurs in two images'
        yield issue_of(scan, ERROR, 'no_tracks', text, 'the tracker must keep the id of a feature')
    if features.with_features and features.farthest_px < MIN_EXTENT_PX:
        text = f'all features lie within {MIN_EXTENT_PX:g} pixels of the corner of the image'
        yield issue_of(scan, WARNING, 'no_pixels', text, 'the tracker must publish pixels')
    elif features.outside > MAX_OUTSIDE_SHARE * features.features:
        share, (width_px, height_px) = features.outside / features.features, features.size_px
        text = f'{share:.0%} of the features lie outside of the {width_px}x{height_px} pixels of camera_info'
        todo = 'calibrate the camera at the resolution of its images'
        yield issue_of(scan, WARNING, 'outside_image', text, todo)
    elif features.features >= MANY_FEATURES and not features.lost and (empty := _empty_part(features)):
        part, (width_px, height_px) = f'{empty} {1.0 - NEAR_PART:.0%}', features.size_px
        text = f'hardly any feature lies in the {part} of the {width_px}x{height_px} pixels'
        todo = 'is camera_info that of another resolution?'
        yield issue_of(scan, WARNING, 'empty_part', text, todo)
    if features.lost:
        text = f'{features.lost} of {features.features} features have no place in the image (NaN, or far off)'
        yield issue_of(scan, WARNING, 'not_finite', text, f'they are left out; {clouds.REMEDY}')


def _empty_part(features: FeatureStats) -> str:
    """Return which part of the image hardly any feature is in; empty where there is none."""
    parts = (('right', features.right), ('lower', features.below))
    return ' and the '.join(name for name, count in parts if count < FEW * features.features)


def _image_turn_issues(
    scan: TopicScan, features: FeatureStats, imu: TopicScan, turns: TurnStats
) -> Iterator[BagIssue]:
    """Yield the issues of images that turn otherwise than the gyro, or at another time."""
    if abs(clock_offset_s(scan, imu)) > MAX_CLOCK_OFFSET_S:
        return
    compared = compare_turns(turns, features.turns)
    if compared and compared.correlation < -MIN_REFERENCE_CORRELATION:
        text = f'its features turn in the opposite direction to {imu.topic.name}'
        todo = 'is the image mirrored, or camera or IMU upside down? publish their mounting on /tf_static'
        yield issue_of(scan, WARNING, 'opposite_turns', text, todo)
    yield from _delay_issues(scan, features.turns, imu, turns, '`gyrocal diagnose` finds the offset')


def _compare_with_imu(
    imu: TopicScan, stamped: list[TopicScan], bag: BagScan
) -> dict[str, tuple[TopicScan, TurnComparison]]:
    """Return the comparison of the turns of wheels and heading reference with the gyro, by topic."""
    comparisons = {}
    for scan in stamped:
        if scan.role in bag.turns and abs(clock_offset_s(scan, imu)) < MAX_CLOCK_OFFSET_S:
            compared = compare_turns(bag.imus[imu.topic.name].turns, bag.turns[scan.role])
            if compared:
                comparisons[scan.topic.name] = scan, compared
    return comparisons


def _nan_issues(scan: TopicScan) -> Iterator[BagIssue]:
    if scan.invalid:
        share = scan.invalid / scan.topic.count
        severity = ERROR if share > MAX_NAN_SHARE else WARNING
        text = f'{scan.invalid} of {scan.topic.count} messages are damaged, not finite or far too large'
        yield issue_of(scan, severity, 'not_finite', text, 'they are left out; check the driver and its unit')


def _imu_issues(
    imu: TopicScan, bag: BagScan, comparisons: Mapping[str, tuple[TopicScan, TurnComparison]]
) -> Iterator[BagIssue]:
    """Yield the issues of the readings of an IMU, and of the sensors whose turns are compared with it."""
    stats = bag.imus[imu.topic.name]
    if not stats.count:
        return
    if stats.zero_count == stats.count:
        text = 'the gyro reads exactly zero throughout'
        yield issue_of(imu, ERROR, 'dead_imu', text, 'choose another IMU topic')
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
        yield issue_of(imu, ERROR, 'dead_imu', text, 'check its z axis, or choose another IMU topic')
        return
    for scan, compared in comparisons.values():
        if _is_degrees(1.0 / compared.ratio):
            text = f'turns {abs(1.0 / compared.ratio):.0f} times as much as {scan.topic.name}: in degrees?'
            yield issue_of(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
            return
        axis = stats.turning_axis(bag.turns[scan.role])
        if axis and abs(compared.correlation) < MIN_REFERENCE_CORRELATION:
            text = (
                f'its {axis} axis turns as {scan.topic.name}, its z axis does not: the axes are exchanged, '
                'or the IMU is mounted otherwise'
            )
            yield issue_of(imu, ERROR, 'exchanged_axes', text, AXES_ADVICE)
            return
        yield from _turn_issues(scan, imu, compared)
    if stats.largest_rate_rad_s > MAX_RATE_RAD_S and not comparisons:
        text = f'reads up to {stats.largest_rate_rad_s:.0f} rad/s: in degrees?'
        yield issue_of(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
        return
    if left + right < MIN_TURN_DEG:
        text = f'the robot turns {left + right:.0f} deg in total: the scale factor is not observable'
        yield issue_of(imu, ERROR, 'no_turns', text, TURN_ADVICE)
    elif left + right < FEW_TURNS_DEG:
        text = f'the robot turns only {left + right:.0f} deg in total: the scale factor is weakly observable'
        yield issue_of(imu, WARNING, 'few_turns', text, TURN_ADVICE)
    elif min(left, right) < ONE_WAY_SHARE * (left + right):
        text = f'the robot turns {left:.0f} deg to the left, {right:.0f} deg to the right'
        yield issue_of(imu, NOTE, 'one_way_turns', text, 'turns to both sides are needed to separate effects')


def _faulty_readings(imu: TopicScan, faulty: FaultyGyro) -> Iterator[BagIssue]:
    """Yield the issues of readings that no motion explains."""
    if count := faulty.spikes:
        noun = 'reading of the gyro is' if count == 1 else 'readings of the gyro are'
        text = f'{count} {noun} far from those before and after'
        yield issue_of(imu, WARNING, 'spikes', text, 'they are left out; check the wires of the IMU')
    if count := faulty.frozen:
        text = f'{count} readings of the gyro repeat the one before, as if its driver had stalled'
        yield issue_of(imu, WARNING, 'frozen_readings', text, 'they are left out; check its driver')


def _accelerometer_issues(imu: TopicScan, force_m_s2: float, tilt_rad: float) -> Iterator[BagIssue]:
    if force_m_s2 < 0.3:
        yield issue_of(imu, NOTE, 'no_accelerometer', 'the accelerometer reads no gravity')
    elif 0.8 < force_m_s2 < 1.25:
        text = f'the accelerometer reads {force_m_s2:.2f}: g, not m/s^2'
        yield issue_of(imu, WARNING, 'unit_g', text, 'the driver must publish m/s^2')
    elif not 9.0 < force_m_s2 < 11.0:
        text = f'the accelerometer reads {force_m_s2:.3g} m/s^2 on average where 9.8 is expected'
        yield issue_of(imu, WARNING, 'odd_gravity', text, 'check its unit and its calibration')
    if MAX_TILT_RAD < tilt_rad < MAX_LEAN_RAD:
        text = (
            f'leans by {DEGREES * tilt_rad:.1f} deg against gravity on average: its yaw axis reads '
            f'{100.0 * (1.0 - math.cos(tilt_rad)):.2g} % of a turn less'
        )
        todo = 'corrected with a heading reference and three gyros; else publish its mounting on /tf_static'
        yield issue_of(imu, NOTE, 'tilted_imu', text, todo)


def _turn_issues(scan: TopicScan, imu: TopicScan, compared: TurnComparison) -> Iterator[BagIssue]:
    """Yield the issues of wheels or a heading reference whose turns differ from those of the gyro."""
    if _is_degrees(compared.ratio):
        text = f'turns {abs(compared.ratio):.0f} times as much as {imu.topic.name}: in degrees?'
        yield issue_of(scan, WARNING, 'unit_degrees', text, 'the driver must publish rad/s')
    elif compared.correlation < -MIN_REFERENCE_CORRELATION:
        text = f'turns in the opposite direction to {imu.topic.name}'
        todo = 'are left and right exchanged? is the IMU upside down? publish its mounting on /tf_static'
        yield issue_of(scan, WARNING, 'opposite_turns', text, todo)
    elif compared.correlation < MIN_CORRELATION or not 1.0 / MAX_TURN_RATIO < compared.ratio < MAX_TURN_RATIO:
        text = (
            f'turns {compared.other_deg:.0f} deg in total, {imu.topic.name} {compared.this_deg:.0f} deg '
            f'(correlation {compared.correlation:.2f})'
        )
        if scan.role is not Role.HEADING:
            todo = 'unfit as a heading reference; do the wheels slip?'
            yield issue_of(scan, WARNING, 'turns_disagree', text, todo)
        elif compared.correlation < MIN_REFERENCE_CORRELATION or not (
            1.0 / MAX_REFERENCE_RATIO < compared.ratio < MAX_REFERENCE_RATIO
        ):
            yield issue_of(scan, ERROR, 'turns_disagree', text, 'unfit as a heading reference')
        else:
            todo = 'a noisy, drifting or late reference takes longer; give a better one if there is one'
            if not 1.0 / MAX_TURN_RATIO < compared.ratio < MAX_TURN_RATIO:
                todo = 'one of the two scale factors is far off; do the wheels of the reference slip?'
            yield issue_of(scan, WARNING, 'turns_disagree', text, todo)


def _delay_issues(
    scan: TopicScan, turns: TurnStats, imu: TopicScan, by_gyro: TurnStats, question: str
) -> Iterator[BagIssue]:
    """Yield an issue of a sensor whose turns are stamped at other times than those of the gyro."""
    if abs(clock_offset_s(scan, imu)) > MAX_CLOCK_OFFSET_S:
        return  # said already
    delay = turn_delay(by_gyro, turns)
    if delay is not None and abs(delay.delay_s) - DELAY_SIGMA * delay.std_s > MAX_TURN_DELAY_S:
        side = 'behind' if delay.delay_s > 0.0 else 'ahead of'
        text = f'its turns are {abs(delay.delay_s):.2f} s {side} those of {imu.topic.name}'
        todo = f'let the driver stamp at the measurement, not on arrival; {question}'
        yield issue_of(scan, WARNING, 'delayed_turns', text, todo)


def _is_degrees(ratio: float) -> bool:
    """Return True if a ratio of two turns is about 180 / pi."""
    return 0.6 * DEGREES < abs(ratio) < 1.6 * DEGREES
