"""The bags of a fleet on a Dask cluster, on this machine or elsewhere; resumable."""

from __future__ import annotations

import hashlib
import itertools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.fleet.plan import PlannedBag
from gyrocal_ros.fleet.result import CALIBRATED, BagResult, failed
from gyrocal_ros.fleet.store import FleetStore, lost
from gyrocal_ros.fleet.work import Job, analyse, fingerprint

LOOPBACK = '127.0.0.1'
QUEUED = 4
"""Number of bags that are handed out per worker at a time: enough to keep it busy."""
THREAD_SETTINGS = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
"""Environment of the local workers: the filter's matrices are too small for threads."""
DASK_SETTINGS = {'distributed.worker.profile.enabled': False}
"""Dask samples the stacks of its workers: a fifth of their time, and 0.5 MB that are kept for every bag."""


@dataclass(frozen=True, slots=True)
class FleetRun:
    """Counts of a finished run over a fleet."""

    bags: int
    calibrated: int
    failed: int
    resumed: int
    """Bags whose result was there already."""
    wall_s: float
    work_s: float
    """Time that the workers spent on bags."""
    workers: int


@dataclass(frozen=True, slots=True)
class _Done:
    """Result of one task, with the time that it took the worker."""

    result: BagResult
    wall_s: float


def run_fleet(
    planned: Sequence[PlannedBag],
    job: Job,
    store: FleetStore,
    client: Any,
    report: Callable[[BagResult], None] = lambda result: None,
) -> FleetRun:
    """Work on all bags that have no result yet, then write the tables.

    The tables depend on bags, settings and version alone, not on the number of workers or their order.

    Args:
        planned: the bags.
        job: what to do with each.
        store: the folder of the fleet.
        client: a client of `dask.distributed`.
        report: called with each result.

    Raises:
        GyrocalError: the scheduler is gone, or a file cannot be written.
    """
    began_s, digest = time.perf_counter(), job.digest()
    keys: dict[str, str] = {}
    unread: dict[str, BagResult] = {}
    waiting: list[str] = []
    resumed = counted = 0
    for item in planned:
        try:
            keys[item.bag] = _key(digest, fingerprint(item.bag))
        except OSError as error:
            unread[item.bag] = failed(f'cannot be read ({error.strerror or error})', is_final=False)
            report(unread[item.bag])
            continue
        known = store.load(item.bag, keys[item.bag])
        if known is None:
            waiting.append(item.bag)
        else:
            resumed += 1
            report(known)
    work_s = 0.0
    for bag, done in _completed(client, waiting, job):
        if done.result.is_final:
            store.save(bag, keys[bag], done.result)
        else:
            unread[bag] = done.result
        work_s += done.wall_s
        report(done.result)

    def results() -> Iterator[BagResult]:
        nonlocal counted
        for item in planned:
            result = unread.get(item.bag) or store.load(item.bag, keys[item.bag]) or lost()
            counted += result.row['status'] == CALIBRATED
            yield result

    workers = len(client.scheduler_info(n_workers=-1)['workers'])
    store.write_tables(planned, results(), {'bags': len(planned), 'settings': digest} | _about(job))
    return FleetRun(
        bags=len(planned),
        calibrated=counted,
        failed=len(planned) - counted,
        resumed=resumed,
        wall_s=time.perf_counter() - began_s,
        work_s=work_s,
        workers=workers,
    )


@contextmanager
def cluster(scheduler: str | None = None, workers: int | None = None, port: int = 0) -> Iterator[Any]:
    """Yield a client of a Dask cluster.

    Args:
        scheduler: address of a running scheduler; None to start workers on this machine, which listen on
            the loopback interface alone.
        workers: number of local workers; None for one per core.
        port: port of the local dashboard; 0 for any free one.

    Raises:
        GyrocalError: the scheduler cannot be reached.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler:
        try:
            with Client(scheduler, timeout='10s', set_as_default=False) as client:
                yield client
        except (OSError, ValueError) as error:
            todo = 'start it with `dask scheduler`, and check address and firewall'
            raise GyrocalError(f'cannot be reached ({error})', where=scheduler, todo=todo) from error
        return
    os.environ.update(THREAD_SETTINGS)
    with (
        dask.config.set(DASK_SETTINGS),
        LocalCluster(
            n_workers=workers or os.cpu_count(),
            threads_per_worker=1,
            host=LOOPBACK,
            dashboard_address=f'{LOOPBACK}:{port}',
            memory_limit=None,
            silence_logs='CRITICAL',
        ) as local,
        Client(local, set_as_default=False) as client,
    ):
        yield client


def _completed(client: Any, bags: Sequence[str], job: Job) -> Iterator[tuple[str, _Done]]:
    """Yield the result of each bag as it becomes ready."""
    from distributed import CancelledError, as_completed
    from distributed.comm import CommClosedError

    left = iter(bags)
    threads = sum(client.nthreads().values()) or 1
    bag_of: dict[str, str] = {}

    def submit(bag: str) -> Any:
        future = client.submit(_timed, bag, job, pure=False, key=f'gyrocal-{len(bag_of)}-{_key(bag, "")[:8]}')
        bag_of[future.key] = bag
        return future

    try:
        first = [submit(bag) for bag in itertools.islice(left, QUEUED * threads)]
        running = as_completed(first, loop=client.loop)
        for future in running:
            bag = bag_of[future.key]
            error = future.exception()
            if isinstance(error, CancelledError | CommClosedError):
                raise error
            reason = f'its worker was lost ({type(error).__name__})'
            yield bag, future.result() if error is None else _Done(failed(reason, is_final=False), 0.0)
            future.release()
            following = next(left, None)
            if following is not None:
                running.add(submit(following))
    except (CancelledError, CommClosedError, TimeoutError) as error:
        todo = 'start it again, then run the same command to continue'
        raise GyrocalError('the connection is lost', where='Dask scheduler', todo=todo) from error


def _timed(bag: str, job: Job) -> _Done:
    began_s = time.perf_counter()
    return _Done(analyse(bag, job), time.perf_counter() - began_s)


def _key(*parts: str) -> str:
    return hashlib.sha256('\n'.join(parts).encode()).hexdigest()


def _about(job: Job) -> dict[str, Any]:
    from gyrocal_ros import __version__

    return {'version': __version__, 'model': dict(job.model)}
