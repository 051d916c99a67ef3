"""Tests of the processes for independent runs."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.json_summary import summarise_diagnosis
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.effects import EFFECTS, default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import ConfigError, FilterDivergedError, GyrocalError, IndefiniteCovarianceError
from gyrocal_ros.files import json_text
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.workers import Workers, usable_cores


def place_and_square(value: float) -> tuple[int, float]:
    return os.getpid(), value * value


def diverge_below_zero(value: float) -> float:
    if value < 0.0:
        raise IndefiniteCovarianceError
    return value


def chain(pool: Workers, value: float) -> float:
    """Two calls, of which the second needs the first."""
    _, once = pool.call(value)
    _, twice = pool.call(once)
    return float(twice)


def test_one_process_does_everything_itself() -> None:
    with Workers(place_and_square, 1) as pool:
        results = pool.side_by_side([partial(pool.call, value) for value in (1.0, 2.0, 3.0)])
    assert results == [(os.getpid(), 1.0), (os.getpid(), 4.0), (os.getpid(), 9.0)]


def test_a_single_task_starts_no_process() -> None:
    with Workers(place_and_square, 2) as pool:
        assert pool.side_by_side([partial(pool.call, 2.0)]) == [(os.getpid(), 4.0)]


def test_tasks_are_done_elsewhere_and_return_in_order() -> None:
    with Workers(place_and_square, 2) as pool:
        results = pool.side_by_side([partial(pool.call, float(value)) for value in range(12)])
    assert [square for _, square in results] == [float(value * value) for value in range(12)]
    assert 1 <= len({place for place, _ in results} - {os.getpid()}) <= 2


def test_a_task_may_make_one_call_after_the_other_and_have_tasks_itself() -> None:
    with Workers(place_and_square, 2) as pool:

        def both(value: float) -> list[float]:
            return pool.side_by_side([partial(chain, pool, value), partial(chain, pool, -value)])

        assert pool.side_by_side([partial(both, 2.0), partial(both, 3.0)]) == [[16.0, 16.0], [81.0, 81.0]]


def test_each_process_has_a_number_of_its_own() -> None:
    seen: list[int] = []

    def numbers(wait_s: float) -> list[int]:
        time.sleep(wait_s)
        return seen

    with Workers(numbers, 2, begin=seen.append) as pool:
        found = pool.side_by_side([partial(pool.call, 0.2) for _ in range(6)])
    assert seen == []
    assert {number for (number,) in found} == {0, 1}


def test_processes_see_what_the_function_refers_to_without_pickling_it() -> None:
    held = np.arange(5.0)

    with Workers(lambda place: float(held[place]), 2) as pool:
        assert pool.side_by_side([partial(pool.call, place) for place in (4, 2)]) == [4.0, 2.0]


def test_an_error_passes_to_the_task_that_made_the_call() -> None:
    def tried(pool: Workers, value: float) -> float | None:
        with suppress(FilterDivergedError):
            return float(pool.call(value))
        return None

    with Workers(diverge_below_zero, 2) as pool:
        assert pool.side_by_side([partial(tried, pool, value) for value in (1.0, -1.0, 2.0)]) == [
            1.0,
            None,
            2.0,
        ]
        with pytest.raises(IndefiniteCovarianceError, match='contradict each other'):
            pool.side_by_side([partial(pool.call, value) for value in (1.0, -1.0)])


@pytest.mark.parametrize(
    'error', [IndefiniteCovarianceError(), ConfigError('bad', where='model.yaml', todo='mend it')]
)
def test_errors_pass_between_processes_whole(error: GyrocalError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert (str(again), again.what, again.where, again.todo) == (
        str(error),
        error.what,
        error.where,
        error.todo,
    )


def test_a_process_that_is_killed_is_reported() -> None:
    with Workers(lambda number: os.kill(os.getpid(), number), 2) as pool:
        tasks = [partial(pool.call, signal.SIGKILL) for _ in range(2)]
        with pytest.raises(GyrocalError, match='was ended; free some memory, or use --jobs 1'):
            pool.side_by_side(tasks)


def is_alive(process: int) -> bool:
    """True unless a process has ended; one that nobody waits for counts as ended."""
    with suppress(FileNotFoundError, ProcessLookupError), open(f'/proc/{process}/stat') as stat:
        return stat.read().rpartition(')')[2].split()[0] != 'Z'
    return False


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGKILL])
def test_processes_end_with_their_parent(how: signal.Signals) -> None:
    code = textwrap.dedent("""
        import os, signal, time
        from functools import partial
        from gyrocal_ros.workers import Workers
        def work(seconds):
            os.write(1, b'%d\\n' % os.getpid())  # at once, also beside another process
            time.sleep(seconds)
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a job of a shell ignores it
        with Workers(work, 2) as pool:
            pool.side_by_side([partial(pool.call, 60.0), partial(pool.call, 60.0)])
    """)
    parent = subprocess.Popen(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert parent.stdout is not None
    children = [int(parent.stdout.readline()) for _ in range(2)]
    parent.send_signal(how)
    parent.wait(10.0)
    parent.stdout.close()
    end_s = time.monotonic() + 10.0
    while any(map(is_alive, children)) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not any(map(is_alive, children))


@pytest.mark.slow
@pytest.mark.usefixtures('library')
def test_a_search_with_processes_finds_exactly_the_same() -> None:
    source = recording('cleaning', 2, 60.0, (HiddenEffect(EFFECTS['turn_hysteresis'], (0.03, 12.0)),))
    recorded, here = summarise_recording(source), list[SensorModel]()

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        here.append(model)
        return calibrate(source, Config(), model, candidates=candidates)

    alone = find_missing(default_model(), recorded, remembered(run))
    runs_alone = len(here)
    with Workers(run, 2) as pool:
        together = find_missing(default_model(), recorded, remembered(pool.call, pool))
    assert len(here) - runs_alone < runs_alone, 'the others happened elsewhere'
    assert [item.effect for item in together.kept] == [item.effect for item in alone.kept]
    assert 'turn_hysteresis' in {item.effect.name for item in alone.kept}
    np.testing.assert_array_equal(together.last.run.state.mean, alone.last.run.state.mean)
    np.testing.assert_array_equal(together.last.run.state.covariance, alone.last.run.state.covariance)
    texts = {json_text(summarise_diagnosis(found, diagnose(found, recorded))) for found in (alone, together)}
    assert len(texts) == 1


def test_usable_cores_are_those_of_this_process() -> None:
    assert usable_cores() == len(os.sched_getaffinity(0))
