#!/usr/bin/env python3
"""Measure the overhead of tracing a synthetic city on local workers of one thread each.

Writes a table with a row for each number of workers: wall seconds; CPU seconds in tasks, of the
workers outside of tasks, and of the starting process with the scheduler; megabytes sent to and
returned by tasks. CPU seconds are comparable also on a machine with other load.
"""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from synthetic_city import City, make_city, see_city, write_city

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.edges2d.edge_graph import build_edge_graph
from colmap_edges.edges2d.graphs import CacheBackend, Graphs
from colmap_edges.edges2d.image_graphs import KIND, DetectedEdges, arrays_of
from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation.tables import markdown
from colmap_edges.images.background import NO_BACKGROUND_MASK
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.trace import trace
from colmap_edges.runtime.cache import Cache
from colmap_edges.runtime.executors import Workers, cluster_workers, local_workers

LOOK = ((800, 600), 2)  # size of an image, windows a row and column of a wall
HEADER = ("workers", "wall s", "in tasks", "around them", "started process", "no work", "edges")
SENT = ("tasks", "MB sent", "MB back")


class Measured(Executor):
    """Passes calls to another executor; counts their CPU seconds and transferred bytes."""

    def __init__(self, executor: Executor) -> None:
        """Nothing yet."""
        self.executor = executor
        self.count, self.sent, self.received, self.seconds = 0, 0, 0, 0.0

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a call; arguments and results are transferred as bytes, pickled once."""
        call = pickle.dumps((function, args, kwargs), protocol=5)
        self.count, self.sent = self.count + 1, self.sent + len(call)
        result: Future[Any] = Future()
        inner = self.executor.submit(timed, call)
        inner.add_done_callback(lambda done: self.take(done, result))
        return result

    def take(self, done: Future[tuple[bytes, float]], result: Future[Any]) -> None:
        """Unpack the result of a call."""
        try:
            packed, seconds = done.result()
            self.received, self.seconds = self.received + len(packed), self.seconds + seconds
            result.set_result(pickle.loads(packed))
        except BaseException as error:
            result.set_exception(error)


def timed(call: bytes) -> tuple[bytes, float]:
    """The result of a pickled call, pickled, and its CPU seconds."""
    function, args, kwargs = pickle.loads(call)
    begin = time.thread_time()  # of the task alone: other threads of a worker send and receive
    result = function(*args, **kwargs)
    seconds = time.thread_time() - begin
    return pickle.dumps(result, protocol=5), seconds


def keep_graphs(city: City, model: Model, options: PipelineOptions, cache: Cache) -> Graphs:
    """The edge graphs of a city in a cache, from which workers read them."""
    keys = {index: f"{index:064x}" for index in range(len(model.views))}
    for index, view in enumerate(model.views):
        graph, dropped = build_edge_graph(see_city(city, view), view, options.edge_graph)
        found = DetectedEdges(
            graph=graph,
            dropped=dropped,
            num_chains=0,
            num_chain_pixels=0,
            background_mask=NO_BACKGROUND_MASK,
        )
        cache.save(KIND, keys[index], arrays_of(found))
    return Graphs(options.max_graph_memory_gb * 1e9 / 2, CacheBackend(cache, keys))


def trace_timed(
    model: Model, graphs: Graphs, options: PipelineOptions, workers: Workers
) -> tuple[float, float, int]:
    """Wall and CPU seconds of this process, and edges."""
    wall, cpu = time.perf_counter(), time.process_time()
    traced, _ = trace(model, graphs, options, lambda: None, workers)
    return time.perf_counter() - wall, time.process_time() - cpu, traced.edges.num_edges


def ready() -> float:
    """Import the code of the tasks in a worker; its CPU seconds afterwards."""
    import colmap_edges.edges3d.chains.tracing  # noqa: F401

    return time.process_time()


def row_of_cluster(model: Model, graphs: Graphs, options: PipelineOptions, count: int) -> list[Any]:
    """The figures of tracing on `count` worker processes."""
    from distributed import Client, LocalCluster

    backend = graphs.backend
    assert isinstance(backend, CacheBackend)
    with (
        LocalCluster(
            n_workers=count, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0"
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
        cluster_workers(cluster.scheduler_address, backend.cache) as workers,
    ):
        before = sum(client.run(ready).values())
        measured = Measured(workers.views)
        workers = replace(workers, images=measured, views=measured)
        wall, cpu, edges = trace_timed(model, graphs, options, workers)
        around = sum(client.run(time.process_time).values()) - before - measured.seconds
    return [count, wall, cpu, around, edges, measured]


@click.command(help=__doc__)
@click.option("--num_views", default=100, show_default=True)
@click.option("--workers", "counts", type=int, multiple=True, default=(1, 2, 4), show_default=True)
@exit_on_error()
def main(num_views: int, counts: tuple[int, ...]) -> None:
    options = PipelineOptions(num_threads=1)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_city(make_city(num_views, 650, *LOOK), folder / "input")
        model = load_model(folder / "input")
        graphs = keep_graphs(
            make_city(num_views, 0, *LOOK), model, options, Cache(folder / "cache")
        )
        with local_workers(1) as workers:
            wall, alone, edges = trace_timed(model, graphs, options, workers)
        found = ["none", wall, alone, 0.0, edges, Measured(workers.views)]
        rows = [written(found, alone)]
        for count in counts:
            rows.append(written(row_of_cluster(model, graphs, options, count), alone))
            click.echo(" ".join(rows[-1]), err=True)
    print(markdown((*HEADER, *SENT), rows))


def written(row: list[Any], work: float) -> list[str]:
    """A row of the table; overhead is the CPU seconds beyond those of one thread of one process."""
    name, wall, cpu, around, edges, measured = row
    total = measured.seconds + around + cpu
    return [
        str(name),
        *(f"{seconds:.1f}" for seconds in (wall, measured.seconds, around, cpu)),
        f"{max(1 - work / total, 0):.0%}",
        *(str(edges), str(measured.count)),
        *(f"{size / 1e6:.0f}" for size in (measured.sent, measured.received)),
    ]


if __name__ == "__main__":
    main()
