"""Assessment of the stamps of a recording: issues of each topic on its own, and beside those of the IMU."""

from __future__ import annotations

from collections.abc import Iterator

from gyrocal_ros.bag.scan import TopicScan
from gyrocal_ros.bag.selection import NEEDED_ROLES
from gyrocal_ros.bag.topic_stats import EventStats
from gyrocal_ros.data import seconds
from gyrocal_ros.msgs.bursts import MANY
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import Role

ERROR, WARNING, NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE

MIN_RATE_HZ = {Role.IMU: 15.0, Role.WHEELS: 8.0, Role.FEATURES: 4.0, Role.IMAGE: 4.0, Role.HEADING: 1.0}
"""Minimum rate of a topic; slower ones follow turns badly."""
MAX_UNCOVERED_S = 2.0
"""Limit of the time at the start or the end that the IMU, or another topic, does not cover."""
MAX_CLOCK_OFFSET_S = 0.5
"""Limit of the offset between the stamps of two topics that use the same clock."""
MAX_UNEVEN_SHARE, MAX_LOST_SHARE = 0.02, 0.02
"""Share of irregular intervals of the IMU above which its stamps are not the times of measurement, and share
of its samples that are lost above which that is reported."""
MAX_STAMP_OFFSET_S = 1.0
"""Limit of the offset between the stamps and the time of recording on the same clock."""
MIN_FOLLOWED_SHARE, MIN_DIFFERENT_SHARE = 0.1, 0.005
"""Share of the time of recording in which samples of the IMU follow each other closely enough to integrate a
turn, and share of stamps that are not those of the message before: with less a topic cannot be used."""
STAMP_AT_MEASUREMENT = (
    'turns are integrated over wrong times; let the driver stamp at the measurement, not on arrival'
)


def clock_offset_s(scan: TopicScan, imu: TopicScan) -> float:
    """Return the offset by which the stamps of a topic are behind those of the IMU."""
    return scan.stamps.min_delay_s - imu.stamps.min_delay_s


def issue_of(scan: TopicScan, severity: Severity, kind: str, text: str, todo: str = '') -> BagIssue:
    """Return an issue of a topic; only those of topics that a calibration needs are more than a note."""
    return BagIssue(severity if scan.role in NEEDED_ROLES else NOTE, kind, scan.topic.name, text, todo)


def unusable_stamps(scan: TopicScan) -> Iterator[BagIssue]:
    """Yield an error where the stamps of a topic cannot be the times of its measurements."""
    stamps, todo = scan.stamps, 'the driver must set header.stamp to the time of each measurement'
    repeated, recorded_s = stamps.repeated.count, stamps.recorded_s
    if stamps.unset == stamps.count:
        yield issue_of(scan, ERROR, 'unset_stamps', 'all stamps are zero', 'the driver must set header.stamp')
    elif scan.role is Role.IMU and stamps.followed_s < MIN_FOLLOWED_SHARE * recorded_s:
        text = f'its stamps follow each other closely in {stamps.followed_s:.1f} of {recorded_s:.1f} s only'
        yield issue_of(scan, ERROR, 'unusable_stamps', f'{text}: no turn can be integrated', todo)
    elif repeated and stamps.count - repeated <= max(1.0, MIN_DIFFERENT_SHARE * stamps.count):
        text = f'{repeated} of {stamps.count} stamps repeat the one before'
        yield issue_of(scan, ERROR, 'unusable_stamps', text, todo)


def stamp_issues(scan: TopicScan, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of the stamps of a topic on its own."""
    stamps = scan.stamps

    def largest(events: EventStats, label: str) -> str:
        at_s = seconds(events.at_ns - stamps.first_ns)
        return f'{label} {abs(events.largest_s):.3g} s, {at_s:.1f} s after the start'

    if stamps.unset:
        yield issue_of(scan, WARNING, 'unset_stamps', f'{stamps.unset} stamps are zero', 'they are left out')
    if stamps.jumped.count:
        text = f'the stamps jump relative to the time of recording, {largest(stamps.jumped, "by up to")}'
        yield issue_of(scan, WARNING, 'clock_jump', text, 'a lasting jump starts a new time base')
    if count := stamps.repeated.count:
        text = f'{count} {"stamp repeats" if count == 1 else "stamps repeat"} the one before'
        spread = 'samples that share one are spread over the time since the one before; stamp each of them'
        todo = spread if scan.role is Role.IMU and count > MANY else 'such messages are left out'
        yield issue_of(scan, WARNING, 'repeated_stamps', text, todo)
    if count := stamps.backward.count:
        noun = 'stamp is' if count == 1 else 'stamps are'
        text = f'{count} {noun} earlier than the one before, {largest(stamps.backward, "by up to")}'
        todo = f'messages up to {reorder_window_s:g} s late are sorted in, later ones left out'
        yield issue_of(scan, WARNING, 'backward_stamps', text, todo)
    if scan.role is Role.IMU and stamps.uneven > MAX_UNEVEN_SHARE * stamps.count:
        text = (
            f'{stamps.uneven / stamps.count:.0%} of the intervals between stamps differ from the usual '
            f'{1e3 / stamps.rate_hz:.3g} ms by more than half'
        )
        yield issue_of(scan, WARNING, 'irregular_stamps', text, STAMP_AT_MEASUREMENT)
    elif scan.role is Role.IMU and stamps.lost > stamps.count:
        mean_ms = 1e3 * seconds(stamps.last_ns - stamps.first_ns) / stamps.count
        text = f'the stamps come in bursts: {1e3 / stamps.rate_hz:.3g} ms apart, {mean_ms:.2g} ms on average'
        yield issue_of(scan, WARNING, 'irregular_stamps', text, STAMP_AT_MEASUREMENT)
    elif scan.role is Role.IMU and stamps.lost > MAX_LOST_SHARE * stamps.count:
        text = f'{stamps.lost / (stamps.lost + stamps.count):.0%} of the samples are missing'
        todo = 'turns are integrated over longer intervals; look at the load of the computer'
        yield issue_of(scan, WARNING, 'lost_samples', text, todo)
    if count := stamps.gap.count:
        text = f'{count} {"gap" if count == 1 else "gaps"}, {largest(stamps.gap, "the longest")}'
        yield issue_of(scan, WARNING, 'gap', text, 'were messages lost while recording?')
    if not stamps.jumped.count:
        if stamps.max_delay_s - stamps.min_delay_s > reorder_window_s:
            text = f'messages were recorded up to {stamps.max_delay_s - stamps.min_delay_s:.1f} s late'
            yield issue_of(scan, WARNING, 'late', text, 'raise recording.reorder_window_s')
        if abs(stamps.min_delay_s) > MAX_STAMP_OFFSET_S:
            side = 'before' if stamps.min_delay_s > 0.0 else 'after'
            text = f'stamps are {abs(stamps.min_delay_s):.6g} s {side} the time of recording: another clock'
            yield issue_of(scan, NOTE, 'other_clock', text)
    if stamps.rate_hz < MIN_RATE_HZ.get(scan.role, 0.0):
        text = f'only {stamps.rate_hz:.3g} messages a second'
        yield issue_of(scan, WARNING, 'slow', text, f'at least {MIN_RATE_HZ[scan.role]:g} are recommended')


def synchronisation_issues(scan: TopicScan, imu: TopicScan, reorder_window_s: float) -> Iterator[BagIssue]:
    """Yield the issues of a topic that uses another clock than the IMU or does not cover its time."""
    if scan.stamps.jumped.count or imu.stamps.jumped.count:
        return
    offset_s = clock_offset_s(scan, imu)
    if abs(offset_s) > MAX_CLOCK_OFFSET_S:
        usual_s = abs(scan.stamps.mean_delay_s - imu.stamps.mean_delay_s)
        # All messages of the later topic would then come too late to be sorted in.
        severity = ERROR if min(abs(offset_s), usual_s) > reorder_window_s else WARNING
        side = 'behind' if offset_s > 0.0 else 'ahead of'
        text = f'its stamps are {abs(offset_s):.6g} s {side} those of {imu.topic.name}'
        yield issue_of(scan, severity, 'clocks_differ', text, 'use one clock for the stamps of all topics')
        return
    late_s = seconds(scan.stamps.first_ns - imu.stamps.first_ns)
    early_s = seconds(imu.stamps.last_ns - scan.stamps.last_ns)
    if abs(late_s) > MAX_UNCOVERED_S:
        topic, other = (scan, 'the IMU') if late_s > 0.0 else (imu, scan.topic.name)
        yield issue_of(topic, WARNING, 'begins_late', f'begins {abs(late_s):.1f} s after {other}')
    if abs(early_s) > MAX_UNCOVERED_S:
        topic, other = (scan, 'the IMU') if early_s > 0.0 else (imu, scan.topic.name)
        yield issue_of(topic, WARNING, 'ends_early', f'ends {abs(early_s):.1f} s before {other}')
