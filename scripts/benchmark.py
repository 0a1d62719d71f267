#!/usr/bin/env python3
"""Measure speed and memory: of the stages of runs, of a cluster, the mesher and view selection.

CPU seconds are comparable also on a machine with other load.
"""

from __future__ import annotations

import json
import os
import pickle
import platform
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from synthetic_city import City, flight, make_city, see_city, without_points, write_city

import colmap_edges
from colmap_edges.colmap.model import Model, load_model, model_from_reconstruction
from colmap_edges.colmap.workspace import find_images, find_model
from colmap_edges.edges2d.edge_graph import build_edge_graph
from colmap_edges.edges2d.graphs import CacheBackend, Graphs
from colmap_edges.edges2d.image_graphs import KIND, DetectedEdges, arrays_of
from colmap_edges.edges3d.chains.view_selection import select_views
from colmap_edges.errors import ColmapEdgesError, exit_on_error
from colmap_edges.evaluation.tables import markdown
from colmap_edges.images.background import NO_BACKGROUND_MASK
from colmap_edges.options import MeshingOptions, PipelineOptions
from colmap_edges.pipeline.trace import trace
from colmap_edges.runtime.cache import Cache
from colmap_edges.runtime.executors import Workers, cluster_workers, local_workers
from colmap_edges.surfaces.mesher import mesh_points

ROOT = Path(__file__).resolve().parents[1]
MEASURES = ("wall_s", "cpu_s", "peak_mb")
Stages = dict[str, dict[str, Any]]  # entries of report.json by stage


class Scene(NamedTuple):
    """A folder with images and a model, or a synthetic city of `num_views` images."""

    path: Path
    num_views: int = 0


class Variant(NamedTuple):
    """A source tree and flags."""

    name: str
    tree: Path
    flags: list[str]


@click.group(help=__doc__)
def main() -> None:
    pass


@main.command()
@click.option("--data_path", type=Path, help="Folder of scenes, each with images and a model.")
@click.option("--scene", "names", multiple=True, help="Scene of data_path [all]; can be repeated.")
@click.option(
    "--synthetic", type=int, multiple=True, help="Images of a synthetic city; repeatable."
)
@click.option("--points_per_view", default=650, show_default=True, help="SfM points of a city.")
@click.option("--command", default="mesh", type=click.Choice(("reconstruct", "mesh")))
@click.option("--runs", default=3, show_default=True, help="Runs of which medians are taken.")
@click.option("--flags", default="", help="Flags for all variants, as one string.")
@click.option("--compare", metavar="COMMIT", help="Compare with a build of this commit.")
@click.option("--setting", metavar="FLAGS", help="Compare with the same code with these flags.")
@click.option("--output_path", type=Path, default=Path("benchmark.json"), show_default=True)
def run(
    data_path: Path | None,
    names: tuple[str, ...],
    synthetic: tuple[int, ...],
    points_per_view: int,
    command: str,
    runs: int,
    flags: str,
    compare: str | None,
    setting: str | None,
    output_path: Path,
) -> None:
    """Wall seconds, CPU seconds and peak memory of the stages of runs, as medians.

    With --compare or --setting, two variants run alternately, so that other load affects both
    alike. Writes JSON and prints a table.
    """
    if compare and setting:
        raise click.UsageError("give either --compare or --setting")
    with (
        tempfile.TemporaryDirectory() as temporary,
        variants_of(shlex.split(flags), compare, setting) as variants,
    ):
        scenes = [
            *data_scenes(data_path, names),
            *(city_scene(n, points_per_view, Path(temporary)) for n in synthetic),
        ]
        if not scenes:
            raise click.UsageError("no scenes; give --data_path or --synthetic")
        records = measure(scenes, variants, command, runs, Path(temporary))
    result = {"machine": machine(), "command": command, "runs": runs, "scenes": records}
    output_path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(table(records))


def data_scenes(data_path: Path | None, names: tuple[str, ...]) -> list[Scene]:
    """The scenes of a folder, those named or all."""
    if data_path is None:
        return []
    data_path = data_path.resolve()
    if not data_path.is_dir():
        raise ColmapEdgesError(f"data_path {data_path} is not a folder")
    chosen = names or sorted(p.name for p in data_path.iterdir() if (p / "images").is_dir())
    return [Scene(data_path / name) for name in chosen]


def city_scene(num_views: int, points_per_view: int, folder: Path) -> Scene:
    """Make a city and its model in a separate process, whose memory is not measured."""
    scene = Scene(folder / f"city-{num_views}", num_views)
    execute(city_command(scene, "--points_per_view", str(points_per_view), "--only_write"), ROOT)
    return scene


def city_command(scene: Scene, *arguments: str) -> list[str]:
    """The command that works on a city."""
    script, of = ROOT / "scripts" / "synthetic_city.py", ["--num_views", str(scene.num_views)]
    return [sys.executable, str(script), *of, *arguments, "--folder", str(scene.path)]


@contextmanager
def variants_of(
    flags: list[str], compare: str | None, setting: str | None
) -> Iterator[list[Variant]]:
    """The variants to compare; a commit is built in a temporary worktree."""
    own = Variant("this tree", ROOT, flags)
    if setting is not None:
        yield [own, Variant(setting, ROOT, [*flags, *shlex.split(setting)])]
    elif compare is None:
        yield [own]
    else:
        git = ["git", "-C", str(ROOT), "worktree"]
        with tempfile.TemporaryDirectory() as folder:
            tree = Path(folder) / "tree"
            execute([*git, "add", "--detach", str(tree), compare], ROOT)
            try:
                execute([str(tree / "scripts" / "build"), sys.executable], tree)
                yield [own, Variant(compare, tree, flags)]
            finally:
                execute([*git, "remove", "--force", str(tree)], ROOT)


def measure(
    scenes: list[Scene], variants: list[Variant], command: str, runs: int, folder: Path
) -> list[dict[str, Any]]:
    """Run all variants in turn on each scene; the medians by scene, variant and stage."""
    records = []
    for scene in scenes:
        taken: list[list[Stages]] = [[] for _ in variants]
        for number in range(runs):
            for variant, found in zip(variants, taken, strict=True):
                line = f"{scene.path.name}, {variant.name}: run {number + 1} of {runs}"
                click.echo(line, err=True)
                found.append(run_once(scene, variant, command, folder))
        for variant, found in zip(variants, taken, strict=True):
            counts = {name: stage.get("counts") for name, stage in found[-1].items()}
            record = {"scene": scene.path.name, "variant": variant.name, "counts": counts}
            records.append(record | {"stages": medians(found)})
    return records


def run_once(scene: Scene, variant: Variant, command: str, folder: Path) -> Stages:
    """Records by stage of one run in a separate process."""
    if scene.num_views:
        report = folder / "report.json"
        arguments = city_command(scene, "--report", str(report))
    else:
        output = folder / "output"
        report = output / "report.json"
        arguments = [sys.executable, "-m", "colmap_edges", command, "--overwrite"]
        arguments += ["--image_path", str(find_images(scene.path))]
        arguments += ["--input_path", str(find_model(scene.path)), "--output_path", str(output)]
    whole = execute([*arguments, *variant.flags], variant.tree)
    records = json.loads(report.read_text(encoding="utf-8"))["stages"]
    # Each stage resets the process's peak, so that its own is that since the last stage began.
    whole["peak_mb"] = max(whole["peak_mb"], *(record["peak_mb"] for record in records))
    return {record["name"]: record for record in records} | {"whole process": whole}


def execute(command: list[str], tree: Path) -> dict[str, float]:
    """Run a command with the package of another source tree, or this process's own; its measures.

    Raises:
        ColmapEdgesError: with the last line it wrote, when it fails.
    """
    package = Path(colmap_edges.__file__).parents[1] if tree == ROOT else tree
    environment = os.environ | {"PYTHONPATH": str(package), "PYTHONSAFEPATH": "1"}
    begin = time.perf_counter()
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, cwd=tree, env=environment, stdout=log, stderr=log)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - begin
        log.seek(0)
        lines = log.read().decode(errors="replace").strip().splitlines()
    if process.returncode:
        last = lines[-1] if lines else f"exit code {process.returncode}"
        raise ColmapEdgesError(f"{shlex.join(command)} failed: {last}")
    cpu = usage.ru_utime + usage.ru_stime
    return {"wall_s": wall, "cpu_s": cpu, "peak_mb": megabytes(usage)}


def megabytes(usage: resource.struct_rusage) -> float:
    """Peak memory of a process."""
    return usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def peak_mb() -> float:
    """Peak memory of this process."""
    return megabytes(resource.getrusage(resource.RUSAGE_SELF))


def medians(runs: list[Stages]) -> dict[str, dict[str, float]]:
    """Medians over runs of every measure of every stage."""
    return {
        stage: {
            name: round(statistics.median(run[stage][name] for run in runs), 3) for name in MEASURES
        }
        for stage in runs[0]
    }


def machine() -> dict[str, Any]:
    """A description of the machine."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [f"model name: {platform.processor()}"]
    names = (line.split(": ")[1] for line in lines if line.startswith("model name"))
    return {
        "processor": next(names, ""),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "platform": platform.platform(),
        "python": platform.python_version(),
        "load_average": os.getloadavg(),
    }


def table(records: list[dict[str, Any]]) -> str:
    """The medians as a Markdown table; ratios are those of the first variant to the last."""
    compared = len({record["variant"] for record in records}) > 1
    heads = ["scene", "variant", "stage", "wall s", "CPU s", "peak MB"]
    heads += ["wall ratio", "CPU ratio", "memory ratio"] if compared else []
    rows = []
    for scene, group in groupby(records, lambda record: record["scene"]):
        variants = list(group)
        for stage in variants[0]["stages"]:
            for record in variants:
                found, other = (r["stages"].get(stage) for r in (record, variants[-1]))
                if found is None:
                    continue
                wall, cpu, peak = (found[name] for name in MEASURES)
                row = [scene, record["variant"], stage, f"{wall:.2f}", f"{cpu:.2f}", f"{peak:.0f}"]
                if compared:
                    base = other if other and record is not variants[-1] else {}
                    row += [f"{found[n] / base[n]:.2f}" if base.get(n) else "" for n in MEASURES]
                rows.append(row)
    return markdown(heads, rows)


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
    traced, _ = trace(model, graphs, options, workers)
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


@main.command()
@click.option("--num_views", default=100, show_default=True)
@click.option("--workers", "counts", type=int, multiple=True, default=(1, 2, 4), show_default=True)
def cluster(num_views: int, counts: tuple[int, ...]) -> None:
    """Overhead of tracing a synthetic city on local workers of one thread each.

    Writes a table with a row for each number of workers: wall seconds; CPU seconds in tasks, of
    the workers outside of tasks, and of the starting process with the scheduler; megabytes sent to
    and returned by tasks.
    """
    options, look = PipelineOptions(num_threads=1), ((800, 600), 2)  # pixels; windows in a row
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_city(make_city(num_views, 650, *look), folder / "input")
        model = load_model(folder / "input")
        graphs = keep_graphs(
            make_city(num_views, 0, *look), model, options, Cache(folder / "cache")
        )
        with local_workers(1) as workers:
            wall, alone, edges = trace_timed(model, graphs, options, workers)
        found = ["none", wall, alone, 0.0, edges, Measured(workers.views)]
        rows = [written(found, alone)]
        for count in counts:
            rows.append(written(row_of_cluster(model, graphs, options, count), alone))
            click.echo(" ".join(rows[-1]), err=True)
    header = ["workers", "wall s", "in tasks", "around them", "started process", "no work"]
    print(markdown([*header, "edges", "tasks", "MB sent", "MB back"], rows))


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


@main.command()
@click.option("--num_points", default=1_000_000, show_default=True)
@click.option("--rays_per_point", default=5, show_default=True)
@click.option("--num_cameras", default=500, show_default=True)
@click.option("--num_threads", default=0, help="0 takes all cores.")
def mesher(num_points: int, rays_per_point: int, num_cameras: int, num_threads: int) -> None:
    """Seconds per step and peak memory of meshing a synthetic scene of any size."""
    scene = make_terrain(num_points, rays_per_point, num_cameras)
    print(f"scene made: peak memory {peak_mb():.0f} MB")
    begin, begin_cpu = time.perf_counter(), time.process_time()
    mesh = mesh_points(*scene, MeshingOptions(), num_threads=num_threads)
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - begin_cpu
    for name, value in mesh.stats.items():
        print(f"{name:28} {value:.6g}")
    print(f"{len(mesh.faces)} faces in {seconds:.1f} s, {cpu_seconds:.1f} CPU s")
    print(f"meshed: peak memory {peak_mb():.0f} MB")


def make_terrain(
    num_points: int, rays_per_point: int, num_cameras: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Noisy points on hills a hundred units wide, seen by the cameras nearest above them."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 100, (2, num_points))
    hills = 3 * np.sin(0.3 * x) * np.cos(0.2 * y) + np.abs(np.sin(2 * x + y))
    points = np.column_stack([x, y, hills + rng.normal(0, 0.01, num_points)])
    side = int(np.ceil(np.sqrt(num_cameras)))
    steps = 100 * (np.arange(side) + 0.5) / side
    centers = np.stack([*np.meshgrid(steps, steps), np.full((side, side), 25.0)], -1).reshape(-1, 3)
    near = np.clip(np.floor(points[:, :2] / 100 * side).astype(int), 1, side - 2)
    around = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1)])
    seen = near[:, None] + around[:rays_per_point]
    cameras = (seen[..., 1] * side + seen[..., 0]).astype(np.int32)
    offsets = cameras.shape[1] * np.arange(num_points + 1, dtype=np.int64)
    return points, offsets, cameras.ravel(), centers


@main.command()
@click.option("--num_views", default=10_000, show_default=True)
def neighbors(num_views: int) -> None:
    """CPU seconds and peak memory of finding neighbours of many views without SfM points."""
    side = int(np.ceil(np.sqrt(num_views)))
    poses, _ = flight(num_views, side, np.random.default_rng(0))
    model = model_from_reconstruction(without_points(poses, (800, 600)))
    print(f"views made: peak memory {peak_mb():.0f} MB")
    begin = time.process_time()
    near = select_views(model, PipelineOptions().view_selection)
    seconds = time.process_time() - begin
    observing = np.mean([len(views) for views in near.observing_views])
    print(f"{seconds:.2f} CPU s for {num_views} views, {1e3 * seconds / num_views:.2f} ms each")
    print(f"{observing:.1f} observing views each, peak memory {peak_mb():.0f} MB")


if __name__ == "__main__":
    with exit_on_error():
        main()
