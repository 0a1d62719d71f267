"""Executors of the work on images and views: local threads or a dask cluster.

Work is handed over as calls of plain functions (`concurrent.futures`), a task an image or a view
with its neighbours, so that stages do not know where they run.
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

CONNECT_S = 10  # in which a scheduler must answer
Call = tuple[Callable[..., Any], tuple[Any, ...]]  # a function and its arguments


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Who does the work.

    Attributes:
        images: runs tasks of one image each.
        views: runs tasks of one view and its neighbours each.
        num_view_tasks: tasks of `views` that are worth having at once.
        threads_per_view: threads that such a task takes for itself.
        remote: whether tasks run in other processes, to which edge graphs go by the cache.
        cache: results of earlier runs, if they are kept.
    """

    images: Executor
    views: Executor
    num_view_tasks: int
    threads_per_view: int
    remote: bool = False
    cache: Cache | None = None


@contextmanager
def local_workers(num_threads: int, cache: Cache | None = None) -> Iterator[Workers]:
    """Threads of this process: an image each, then all of them together on one view at a time.

    So few views are in memory at once, and the last one does not keep the others waiting.
    """
    with ThreadPoolExecutor(num_threads) as images, ThreadPoolExecutor(1) as views:
        yield Workers(
            images=images, views=views, num_view_tasks=1, threads_per_view=num_threads, cache=cache
        )


@contextmanager
def cluster_workers(scheduler: str, cache: Cache) -> Iterator[Workers]:
    """The workers of a dask.distributed cluster; tasks of workers that die run again.

    Args:
        scheduler: address of the scheduler, such as tcp://host:8786.
        cache: in a folder that this process and all workers see, as they must see the images.

    Raises:
        ColmapEdgesError: when dask is missing, the scheduler cannot be reached, or workers have
            another version of the code.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ColmapEdgesError(
            f"a scheduler needs dask ({error}); pip install 'colmap-edges[cluster]'"
        ) from error
    try:
        # Before there is a client: one that cannot be made waits and complains when it goes.
        with ThreadPoolExecutor(1) as apart:
            apart.submit(asyncio.run, try_connection(scheduler)).result()
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise ColmapEdgesError(f"cannot reach the scheduler {scheduler}: {error}") from error
    with client:
        client.wait_for_workers(1)
        others = [at for at, found in client.run(code_version).items() if found != code_version()]
        if others:
            raise ColmapEdgesError(f"worker {others[0]} has other versions of code or libraries")
        executor = client.get_executor(pure=False)
        yield Workers(
            images=executor,
            views=executor,
            num_view_tasks=2 * sum(client.nthreads().values()),  # none waits for the next
            threads_per_view=1,
            remote=True,
            cache=cache,
        )


async def try_connection(address: str) -> None:
    """Connect to a scheduler and hang up; raises what distributed raises for a bad address."""
    from distributed.comm import connect

    comm = await connect(address, timeout=CONNECT_S)
    await comm.close()


def run_all(
    executor: Executor,
    calls: Iterable[Call],
    advance: Callable[[], None] = lambda: None,
) -> list[Any]:
    """Results of calls (function, arguments), in their order; the first error stops the rest.

    `advance` is called when a call is done, from any thread.
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
    """Run a call a view in the order of a schedule, as many at once as is worth it.

    Args:
        workers: who does the work.
        schedule: the views.
        call: gives the call of a view, when its turn has come.
        finish: takes a view and its result before those that wait for the view are begun.
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
    """Cancel the calls that have not begun and wait for those that have.

    What was cancelled is not waited for: a cluster's executor never notifies `wait` of a future
    whose result came at the same time.
    """
    wait([future for future in futures if not future.cancel()])


# More only take memory, of an image each, and in the end the system has none to give.
MAX_THREADS_PER_CORE = 4


def thread_count(options: PipelineOptions) -> int:
    """Number of threads the options ask for, as far as that many are of any use."""
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
