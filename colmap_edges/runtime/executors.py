"""Executors of the work on images and views: local threads or a dask cluster.

Tasks are calls of plain functions (`concurrent.futures`), one per image or per view with its
neighbours, so that stages are independent of where they run.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.cache import Cache, code_version
from colmap_edges.runtime.scheduling import Schedule

CONNECT_S = 10  # seconds to wait for an answer of the scheduler
Call = tuple[Callable[..., Any], tuple[Any, ...]]  # a function and its arguments


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Executors and resources of a run.

    Attributes:
        images: runs tasks of one image each.
        views: runs tasks of one view and its neighbours each.
        num_view_tasks: useful number of concurrent tasks of `views`.
        threads_per_view: number of threads that each of these tasks uses.
        remote: whether tasks run in other processes, which read edge graphs from the cache.
        cache: cache of earlier results, if any.
    """

    images: Executor
    views: Executor
    num_view_tasks: int
    threads_per_view: int
    remote: bool = False
    cache: Cache | None = None


@contextmanager
def local_workers(num_threads: int, cache: Cache | None = None) -> Iterator[Workers]:
    """Threads of this process: one per image; views are traced one by one, each by all threads.

    This keeps few views in memory, and no thread idles while the last view is processed.
    """
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
        ColmapEdgesError: if dask is missing, the scheduler cannot be reached, or workers have
            another version of the code.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ColmapEdgesError(
            f"a scheduler needs dask ({error}); pip install 'colmap-edges[cluster]'"
        ) from error
    try:
        # Checked first: a client without a scheduler blocks, and logs errors when it is closed.
        with ThreadPoolExecutor(1) as apart:
            apart.submit(asyncio.run, try_connection(scheduler)).result()
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise ColmapEdgesError(f"cannot reach the scheduler {scheduler}: {error}") from error
    with client:
        client.wait_for_workers(1)
        others = [at for at, found in client.run(code_version).items() if found != code_version()]
        if others:
            raise ColmapEdgesError(
                f"worker {others[0]} has other versions of colmap-edges or its libraries; "
                "install the same there"
            )
        executor = client.get_executor(pure=False)
        yield Workers(
            images=executor,
            views=executor,
            num_view_tasks=2 * sum(client.nthreads().values()),  # so that no worker idles
            threads_per_view=1,
            remote=True,
            cache=cache,
        )


async def try_connection(address: str) -> None:
    """Connect to a scheduler and disconnect; raises distributed's error for a bad address."""
    from distributed.comm import connect

    comm = await connect(address, timeout=CONNECT_S)
    await comm.close()


def run_all(
    executor: Executor,
    calls: Iterable[Call],
    advance: Callable[[], None] = lambda: None,
) -> list[Any]:
    """Run calls (function, arguments); returns results in order; the first error stops the rest.

    `advance` is called after each call, from any thread.
    """
    futures: list[Future[Any]] = []
    try:
        for function, arguments in calls:
            futures.append(executor.submit(function, *arguments))
            futures[-1].add_done_callback(lambda _: advance())
        return [future.result() for future in futures]
    finally:
        stop(futures)


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
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                view = running.pop(future)
                finish(view, future.result())
                schedule.finish(view)
    finally:
        stop(running)


def stop(futures: Iterable[Future[Any]]) -> None:
    """Cancel the calls that have not started and wait for the others.

    Cancelled calls are not waited for: a cluster's executor never notifies `wait` of a future
    that was cancelled while its result arrived.
    """
    wait([future for future in futures if not future.cancel()])


# More threads only take memory, one image each.
MAX_THREADS_PER_CORE = 4


def thread_count(options: PipelineOptions) -> int:
    """Number of threads set in the options, limited to a useful number."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    return (
        min(options.num_threads, MAX_THREADS_PER_CORE * cores) if options.num_threads > 0 else cores
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
