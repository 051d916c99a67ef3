"""Health: windows of counts, silent topics, recent events, and the message of several problems."""

from __future__ import annotations

from collections import Counter

from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.robot.health import RECENT_S, Expected, HealthLog, Level, Problem, Window, status
from gyrocal_ros.robot.problem_log import ProblemLog


def test_a_window_counts_the_growth_of_its_length() -> None:
    window = Window(5.0, 100.0, Counter(lost=3))
    counts, grown = Counter(lost=3), []
    for second in range(1, 13):
        counts['lost'] += second == 2
        grown.append(window.add(counts, 100.0 + second))
    assert [recent['lost'] for recent, _ in grown] == [0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]
    assert [passed_s for _, passed_s in grown] == [1.0, 2.0, 3.0, 4.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0]


def test_a_silent_topic_is_a_problem_from_its_limit_on() -> None:
    log, expected = HealthLog(0.0), [Expected(Role.IMU, 2.0, Level.ERROR, 'check the driver')]
    assert not list(log.silences(expected, 1.9))
    assert [problem.text for problem in log.silences(expected, 2.0)] == [
        'imu/data_raw: no message yet; check the driver'
    ]
    log.add_arrival(Role.IMU, 3.0)
    assert not list(log.silences(expected, 4.9))
    (problem,) = log.silences(expected, 6.0)
    assert problem == Problem(Level.ERROR, 'imu/data_raw: no message for 3 s; check the driver')


def test_an_event_is_reported_once_and_for_a_while() -> None:
    log = HealthLog(0.0)
    for at_s in (1.0, 2.0):
        log.add_event('the clock jumped', at_s)
    assert log.events(1.0 + RECENT_S) == ['the clock jumped']
    assert not log.events(2.1 + RECENT_S)


def test_the_worst_problem_comes_first_and_without_any_the_summary_is_the_message() -> None:
    problems = [Problem(Level.WARN, 'a'), Problem(Level.ERROR, 'b'), Problem(Level.WARN, 'c')]
    joined = status('fine', problems, {'n': 1})
    assert (joined.level, joined.message, joined.numbers) == (Level.ERROR, 'b; a; c', {'n': 1})
    assert (status('fine', [], {}).level, status('fine', [], {}).message) == (Level.OK, 'fine')


def test_a_problem_is_logged_at_once_and_again_while_it_lasts() -> None:
    """Texts that differ by numbers alone are one problem; another level is another one."""
    log = ProblemLog()

    def logged(now_s: float, *problems: Problem) -> list[str]:
        return [item.text for item in log.due(status('fine', problems, {}), now_s)]

    silent = [Problem(Level.WARN, f'imu/data_raw: no message for {k} s; check it') for k in (3, 4, 64)]
    worse = Problem(Level.ERROR, silent[1].text)
    assert logged(10.0, silent[0]) == [silent[0].text]
    assert logged(11.0, silent[1]) == []
    assert logged(12.0, silent[1], worse, Problem(Level.WARN, 'other')) == [worse.text, 'other']
    assert logged(71.0, silent[2]) == [silent[2].text]
    assert logged(72.0) == []
