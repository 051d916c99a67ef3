"""From the figures of a recording to what a person should know about it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from gyrocal_ros.bag.scan import Seen, Watch
from gyrocal_ros.bag.selection import NEEDED_ROLES
from gyrocal_ros.bag.topic_stats import Agreement, ImuStats, WorstCase, compare_turns
from gyrocal_ros.data import seconds
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import Role

ERROR, WARNING, NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE

SLOWEST_HZ = {Role.IMU: 50.0, Role.WHEELS: 8.0, Role.FEATURES: 4.0, Role.IMAGE: 4.0, Role.HEADING: 2.0}
"""Slower topics follow turns badly."""
MAX_NAN_SHARE = 0.1
COVER_S = 2.0
"""A topic that begins so much later than the IMU, or ends so much earlier, misses a part."""
SAME_CLOCK_S, USUAL_DELAY_S = 0.5, 1.0

DEGREES = 180.0 / math.pi
LEAST_TURN_DEG, FEW_TURNS_DEG, ONE_WAY_SHARE = 20.0, 180.0, 0.1
FASTEST_RAD_S = 20.0
"""No robot on a floor turns faster; one that seems to does so in degrees."""
MAX_RATIO, LEAST_CORRELATION = 1.2, 0.85
"""Two sensors agree about turns within these."""
UNFIT_CORRELATION = 0.7
FEW_FEATURES = 4.0
TURN_ADVICE = 'turn on the spot, a few full turns to each side, some slow and some fast'


def assess(seen: Seen, *, reorder_window_s: float, clock_step_s: float) -> Iterator[BagIssue]:
    """Yield what is wrong or odd.

    Args:
        seen: what a pass over the recording has gathered.
        reorder_window_s: how late a message may be recorded and still be sorted in.
        clock_step_s: topics whose clocks differ by more than this cannot be used together.
    """
    stamped = [watch for watch in seen.watches if watch.stamps.unset < watch.stamps.count]
    for watch in seen.watches:
        if watch not in stamped:
            yield _found(
                watch, ERROR, 'unset_stamps', 'all stamps are zero', 'the driver must set header.stamp'
            )
    imus = [watch for watch in stamped if watch.role is Role.IMU]
    for watch in stamped:
        yield from _stamps(watch, reorder_window_s)
        yield from _numbers(watch)
        if imus and watch.role in NEEDED_ROLES and watch.role is not Role.IMU:
            yield from _beside_imu(watch, imus[0], clock_step_s)
    for imu in imus:
        yield from _imu(imu, seen.imus[imu.topic.name], _references(imu, stamped, seen))
    features = seen.of(Role.FEATURES)
    if features and seen.feature_count < FEW_FEATURES * features.stamps.count:
        mean = seen.feature_count / features.stamps.count
        yield _found(
            features, WARNING, 'few_features', f'{mean:.1f} features an image', 'look at the tracker'
        )


def _references(imu: Watch, stamped: list[Watch], seen: Seen) -> dict[str, tuple[Watch, Agreement]]:
    """Return how far wheels and heading reference, by topic, turn as the gyro does."""
    agreements = {}
    for watch in stamped:
        if watch.role in seen.turns and abs(_behind_s(watch, imu)) < SAME_CLOCK_S:
            agreement = compare_turns(seen.imus[imu.topic.name].turns, seen.turns[watch.role])
            if agreement:
                agreements[watch.topic.name] = watch, agreement
    return agreements


def _behind_s(watch: Watch, imu: Watch) -> float:
    """How far the stamps of a topic lie behind those of the IMU."""
    return watch.stamps.least_delay_s - imu.stamps.least_delay_s


def _found(watch: Watch, severity: Severity, kind: str, text: str, todo: str = '') -> BagIssue:
    return BagIssue(severity if watch.role in NEEDED_ROLES else NOTE, kind, watch.topic.name, text, todo)


def _stamps(watch: Watch, reorder_window_s: float) -> Iterator[BagIssue]:
    stamps = watch.stamps

    def worst(event: WorstCase, word: str) -> str:
        at_s = seconds(event.at_ns - stamps.first_ns)
        return f'{word} {abs(event.worst_s):.3g} s, {at_s:.1f} s after the start'

    if stamps.unset:
        yield _found(watch, WARNING, 'unset_stamps', f'{stamps.unset} stamps are zero', 'they are left out')
    if stamps.jumped.count:
        text = f'the stamps jump against the time of recording, {worst(stamps.jumped, "by up to")}'
        yield _found(watch, WARNING, 'clock_jump', text, 'a lasting jump starts a new time base')
    if count := stamps.repeated.count:
        yield _found(
            watch,
            WARNING,
            'repeated_stamps',
            f'{count} times a stamp is repeated',
            'such messages are left out',
        )
    if count := stamps.backward.count:
        text = f'{count} times a stamp lies before the last, {worst(stamps.backward, "by up to")}'
        todo = f'messages up to {reorder_window_s:g} s late are sorted in, later ones left out'
        yield _found(watch, WARNING, 'backward_stamps', text, todo)
    if count := stamps.gap.count:
        text = f'{count} {"gap" if count == 1 else "gaps"}, {worst(stamps.gap, "the longest")}'
        yield _found(watch, WARNING, 'gap', text, 'were messages lost while recording?')
    if not stamps.jumped.count:
        if stamps.most_delay_s - stamps.least_delay_s > reorder_window_s:
            text = f'messages were recorded up to {stamps.most_delay_s - stamps.least_delay_s:.1f} s late'
            yield _found(watch, WARNING, 'late', text, 'raise recording.reorder_window_s')
        if abs(stamps.least_delay_s) > USUAL_DELAY_S:
            side = 'before' if stamps.least_delay_s > 0.0 else 'after'
            text = f'stamps lie {abs(stamps.least_delay_s):.6g} s {side} the time of recording: another clock'
            yield _found(watch, NOTE, 'other_clock', text)
    if stamps.rate_hz < SLOWEST_HZ.get(watch.role, 0.0):
        text = f'only {stamps.rate_hz:.3g} messages a second'
        yield _found(watch, WARNING, 'slow', text, f'{SLOWEST_HZ[watch.role]:g} or more are wanted')


def _numbers(watch: Watch) -> Iterator[BagIssue]:
    if watch.not_finite:
        share = watch.not_finite / watch.stamps.count
        severity = ERROR if share > MAX_NAN_SHARE else WARNING
        text = f'{watch.not_finite} of {watch.stamps.count} messages are not finite (NaN)'
        yield _found(watch, severity, 'not_finite', text, 'they are left out; look after the driver')


def _beside_imu(watch: Watch, imu: Watch, clock_step_s: float) -> Iterator[BagIssue]:
    """Tell whether a topic goes with the IMU in clock and time."""
    if watch.stamps.jumped.count or imu.stamps.jumped.count:
        return
    apart_s = _behind_s(watch, imu)
    if abs(apart_s) > SAME_CLOCK_S:
        severity = ERROR if abs(apart_s) > clock_step_s else WARNING
        side = 'behind' if apart_s > 0.0 else 'ahead of'
        text = f'its stamps are {abs(apart_s):.6g} s {side} those of {imu.topic.name}'
        yield _found(watch, severity, 'clocks_differ', text, 'stamp all topics by one clock')
        return
    late_s = seconds(watch.stamps.first_ns - imu.stamps.first_ns)
    early_s = seconds(imu.stamps.last_ns - watch.stamps.last_ns)
    if late_s > COVER_S:
        yield _found(watch, WARNING, 'begins_late', f'begins {late_s:.1f} s after the IMU')
    if early_s > COVER_S:
        yield _found(watch, WARNING, 'ends_early', f'ends {early_s:.1f} s before the IMU')


def _imu(
    imu: Watch, stats: ImuStats, references: Mapping[str, tuple[Watch, Agreement]]
) -> Iterator[BagIssue]:
    if not stats.count:
        return
    if stats.at_zero == stats.count:
        text = 'the gyro reads exactly zero throughout'
        yield _found(imu, ERROR, 'dead_imu', text, 'choose another IMU topic')
        return
    yield from _accelerometer(imu, stats.mean_force_m_s2)
    for watch, agreement in references.values():
        if _is_degrees(1.0 / agreement.ratio):
            text = f'turns {abs(1.0 / agreement.ratio):.0f} times as much as {watch.topic.name}: in degrees?'
            yield _found(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
            return
        yield from _agreement(watch, imu, agreement)
    if stats.largest_rate_rad_s > FASTEST_RAD_S and not references:
        text = f'reads up to {stats.largest_rate_rad_s:.0f} rad/s: in degrees?'
        yield _found(imu, ERROR, 'unit_degrees', text, 'the driver must publish rad/s')
        return
    left, right = (turn * DEGREES for turn in stats.turns.left_right_rad)
    if left + right < LEAST_TURN_DEG:
        text = f'the robot turns {left + right:.0f} deg in all: the scale factor does not show'
        yield _found(imu, ERROR, 'no_turns', text, TURN_ADVICE)
    elif left + right < FEW_TURNS_DEG:
        text = f'the robot turns only {left + right:.0f} deg in all: the scale factor shows badly'
        yield _found(imu, WARNING, 'few_turns', text, TURN_ADVICE)
    elif min(left, right) < ONE_WAY_SHARE * (left + right):
        text = f'the robot turns {left:.0f} deg to the left, {right:.0f} deg to the right'
        yield _found(imu, NOTE, 'one_way_turns', text, 'turns to both sides tell the effects apart')


def _accelerometer(imu: Watch, force_m_s2: float) -> Iterator[BagIssue]:
    if force_m_s2 < 0.3:
        yield _found(imu, NOTE, 'no_accelerometer', 'the accelerometer reads no gravity')
    elif 0.8 < force_m_s2 < 1.25:
        text = f'the accelerometer reads {force_m_s2:.2f}: g, not m/s^2'
        yield _found(imu, WARNING, 'unit_g', text, 'the driver must publish m/s^2')
    elif not 9.0 < force_m_s2 < 11.0:
        text = f'the accelerometer reads {force_m_s2:.3g} m/s^2 on average where 9.8 is expected'
        yield _found(imu, WARNING, 'odd_gravity', text, 'look after its unit and its calibration')


def _agreement(watch: Watch, imu: Watch, agreement: Agreement) -> Iterator[BagIssue]:
    """Tell whether wheels or heading reference turn as the gyro does."""
    if _is_degrees(agreement.ratio):
        text = f'turns {abs(agreement.ratio):.0f} times as much as {imu.topic.name}: in degrees?'
        yield _found(watch, WARNING, 'unit_degrees', text, 'the driver must publish rad/s')
    elif agreement.correlation < -UNFIT_CORRELATION:
        todo = 'is the IMU upside down? publish how it is mounted on /tf_static'
        yield _found(watch, WARNING, 'opposite_turns', f'turns the other way than {imu.topic.name}', todo)
    elif agreement.correlation < LEAST_CORRELATION or not 1.0 / MAX_RATIO < agreement.ratio < MAX_RATIO:
        is_reference = watch.role is Role.HEADING
        text = (
            f'turns {agreement.other_deg:.0f} deg in all, {imu.topic.name} {agreement.this_deg:.0f} deg '
            f'(correlation {agreement.correlation:.2f})'
        )
        todo = 'unfit as a heading reference' + ('' if is_reference else '; do the wheels slip?')
        severity = ERROR if is_reference and agreement.correlation < UNFIT_CORRELATION else WARNING
        yield _found(watch, severity, 'turns_disagree', text, todo)


def _is_degrees(ratio: float) -> bool:
    return 0.6 * DEGREES < abs(ratio) < 1.6 * DEGREES
