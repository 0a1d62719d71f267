"""Executors of the work on images and views: local threads or a dask cluster.

Tasks are calls of plain functions (`concurrent.futures`), one per image or per view with its
neighbours, so that stages are independent of where they run.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.cache import Cache, code_version
from colmap_edges.runtime.scheduling import Schedule

# Bounds of what a run waits for, seconds.
ANSWER_S = 10  # an answer of the scheduler
WORKERS_S = 20  # a worker, at the start and after the last one was lost
WATCH_S = 1  # a result, until the cluster is asked whether it still has workers

Call = tuple[Callable[..., Any], tuple[Any, ...]]  # a function and its arguments
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Executors and resources of a run.

    Attributes:
        images: runs tasks of one image each, or of one view that needs no result of others.
        views: runs tasks of one view each whose edges other views must not trace again.
        num_view_tasks: useful number of concurrent tasks of `views`.
        threads_per_view: number of threads that each of these tasks uses.
        remote: whether tasks run in other processes, which read edge graphs from the cache.
        cache: cache of earlier results, if any.
        advance: called after each task of a view.
        check: raises an error if results can no longer come; called while none come.
    """

    images: Executor
    views: Executor
    num_view_tasks: int
    threads_per_view: int
    remote: bool = False
    cache: Cache | None = None
    advance: Callable[[], None] = lambda: None
    check: Callable[[], Any] = lambda: None


@contextmanager
def local_workers(num_threads: int, cache: Cache | None = None) -> Iterator[Workers]:
    """Threads of this process: one per image; views are traced one by one, each by all threads."""
    with ThreadPoolExecutor(num_threads) as images, ThreadPoolExecutor(1) as views:
        yield Workers(
            images=images, views=views, num_view_tasks=1, threads_per_view=num_threads, cache=cache
        )


@contextmanager
def cluster_workers(scheduler: str, cache: Cache) -> Iterator[Workers]:
    """The workers of a dask.distributed cluster; tasks of lost workers are repeated.

    Args:
        scheduler: address of the scheduler, such as tcp://host:8786.
        cache: cache in a folder that this process and all workers can access, like the images.

    Raises:
        ColmapEdgesError: if dask is missing, the scheduler does not answer for `ANSWER_S` seconds,
            there is no worker for `WORKERS_S` seconds, a task repeatedly ends its worker, or
            workers have another version of the code.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise ColmapEdgesError(
            f"a scheduler needs dask ({error}); pip install 'colmap-edges[cluster]'"
        ) from error
    try:
        try_connection(scheduler)
        client = Client(scheduler, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise ColmapEdgesError(
            f"cannot reach the scheduler {scheduler}: {str(error) or 'no answer'}; "
            "check the address, and that `dask scheduler` runs there"
        ) from error
    tracebacks = ("distributed", "distributed.client", "distributed.core", "tornado.application")
    levels = {logger: logger.level for logger in map(logging.getLogger, tracebacks)}
    try:
        for logger in levels:
            logger.setLevel(logging.CRITICAL)
        watch = ClusterWatch(scheduler, client)
        while not watch.num_threads():
            time.sleep(WATCH_S / 10)
        check_versions(client)
        executor = client.get_executor(pure=False)
        yield Workers(
            images=executor,
            views=executor,
            num_view_tasks=2 * watch.num_threads(),  # so that no worker idles
            threads_per_view=1,
            remote=True,
            cache=cache,
            check=watch.num_threads,
        )
    except CancelledError as error:
        raise ColmapEdgesError(
            f"the scheduler {scheduler} was lost; start it and its workers again: the next run "
            "continues with what is in the cache"
        ) from error
    except KilledWorker as error:
        raise ColmapEdgesError(
            f"a task at the scheduler {scheduler} repeatedly ended its worker; give workers more "
            "memory, and see their logs"
        ) from error
    finally:
        with suppress(OSError, TimeoutError, asyncio.TimeoutError):  # a silent scheduler
            client.close(timeout=2)
        for logger, level in levels.items():
            logger.setLevel(level)


def try_connection(address: str) -> None:
    """Connect to a scheduler and disconnect; a client without a scheduler blocks for ever.

    Raises:
        TimeoutError: if there is no answer for `ANSWER_S` seconds.
        OSError, ValueError, TypeError, RuntimeError: as distributed, for a bad address.
    """
    from distributed.comm import connect

    async def attempt() -> None:
        comm = await asyncio.wait_for(connect(address, timeout=ANSWER_S), ANSWER_S)
        await comm.close()

    def run() -> None:
        try:
            done.set_result(asyncio.run(attempt()))
        except asyncio.TimeoutError as error:  # an error of its own before Python 3.11
            done.set_exception(TimeoutError(f"no answer for {ANSWER_S} s", *error.args))
        except Exception as error:
            done.set_exception(error)

    done: Future[None] = Future()
    Thread(target=run, daemon=True).start()  # which Ctrl-C need not wait for
    done.result()


class ClusterWatch:
    """Tells whether a cluster still works."""

    def __init__(self, scheduler: str, client: Any) -> None:
        """Watch the cluster of a distributed.Client at the address `scheduler`."""
        self.scheduler, self.client = scheduler, client
        self.alone_since: float | None = None

    def num_threads(self) -> int:
        """Number of threads of all workers.

        Raises:
            ColmapEdgesError: if the scheduler does not answer for `ANSWER_S` seconds, or if there
                was no worker for `WORKERS_S` seconds.
        """
        try:
            ask = self.client.scheduler.ncores
            found = int(sum(self.client.sync(ask, callback_timeout=ANSWER_S).values()))
        except (OSError, AttributeError, RuntimeError, asyncio.TimeoutError) as error:
            raise ColmapEdgesError(
                f"the scheduler {self.scheduler} does not answer; start it and its workers again: "
                "the next run continues with what is in the cache"
            ) from error
        now = time.monotonic()
        self.alone_since = None if found else self.alone_since or now
        if self.alone_since is not None and now - self.alone_since > WORKERS_S:
            raise ColmapEdgesError(
                f"the scheduler {self.scheduler} had no workers for {WORKERS_S} s; start some: "
                f"dask worker {self.scheduler}"
            )
        return found


def check_versions(client: Any) -> None:
    """Check that the workers of a distributed.Client have this version of the code.

    Raises:
        ColmapEdgesError: naming one that does not.
    """
    others = [at for at, found in client.run(code_version).items() if found != code_version()]
    if others:
        raise ColmapEdgesError(
            f"worker {others[0]} has other versions of colmap-edges or its libraries; "
            "install the same there"
        )


def run_all(
    executor: Executor,
    calls: Iterable[Call],
    advance: Callable[[], None] = lambda: None,
    check: Callable[[], Any] = lambda: None,
) -> list[Any]:
    """Run calls (function, arguments); returns results in order; the first error stops the rest.

    `advance` is called after each call, from any thread; `check` as in `Workers`.
    """
    futures: list[Future[Any]] = []
    try:
        for function, arguments in calls:
            futures.append(executor.submit(function, *arguments))
            futures[-1].add_done_callback(lambda _: advance())
        return [first_done([future], check).pop().result() for future in futures]
    finally:
        stop(futures)


def in_threads(function: Callable[[T], R], items: Iterable[T], num_threads: int) -> list[R]:
    """The results of a function for some items, in order; several at the same time."""
    with ThreadPoolExecutor(num_threads) as pool:
        return list(pool.map(function, items))


def run_scheduled(
    workers: Workers,
    schedule: Schedule,
    call: Callable[[int], Call],
    finish: Callable[[int, Any], None],
) -> None:
    """Run one call per view in the order of a schedule, several at a time.

    Args:
        workers: the executors.
        schedule: the views and their dependencies.
        call: makes the call of a view when it is due.
        finish: receives a view and its result before views that depend on it are started.
    """
    running: dict[Future[Any], int] = {}
    try:
        while True:
            while len(running) < workers.num_view_tasks and (view := schedule.take()) is not None:
                function, arguments = call(view)
                running[workers.views.submit(function, *arguments)] = view
            if not running:
                return
            for future in first_done(running, workers.check):
                view = running.pop(future)
                finish(view, future.result())
                schedule.finish(view)
    finally:
        stop(running)


def first_done(futures: Iterable[Future[Any]], check: Callable[[], Any]) -> set[Future[Any]]:
    """Wait until a call is done; calls `check` every `WATCH_S` seconds."""
    while not (done := wait(futures, timeout=WATCH_S, return_when=FIRST_COMPLETED).done):
        check()
    return done


def stop(futures: Iterable[Future[Any]]) -> None:
    """Cancel the calls that have not started and wait for the others.

    Cancelled calls are not waited for: a cluster's executor never notifies `wait` of a future
    that was cancelled while its result arrived.
    """
    wait([future for future in futures if not future.cancel()])


def thread_count(options: PipelineOptions) -> int:
    """Number of threads set in the options, limited to a useful number."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    return (
        # More threads only take memory, one image each.
        min(options.num_threads, 4 * cores) if options.num_threads > 0 else cores
    )


@contextmanager
def open_workers(
    options: PipelineOptions, cache_path: Path | None = None, scheduler: str = ""
) -> Iterator[Workers]:
    """The workers of a run: those of a cluster, or threads of this process."""
    cache = Cache(cache_path) if cache_path else None
    if scheduler and cache:
        with cluster_workers(scheduler, cache) as workers:
            yield workers
    else:
        with local_workers(thread_count(options), cache) as workers:
            yield workers
