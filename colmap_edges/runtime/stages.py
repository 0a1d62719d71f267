"""Records of the counts, duration and peak memory of each stage, and progress callbacks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from colmap_edges.runtime.memory import return_freed_memory
from colmap_edges.runtime.platform import peak_memory_mb, reset_peak_memory

# Peak memory of a stage from which on what it freed is returned to the system after it: the next
# stages free arrays of other sizes, which do not fit into the gaps. This takes 20 ms a GB.
TRIMMED_MB = 500

# Called with the stage's name, the number of finished steps and their total number.
Progress = Callable[[str, int, int], None]


def no_progress(name: str, done: int, total: int) -> None:
    """Show nothing."""


@dataclass
class Stage:
    """One stage of a run, with its record.

    Attributes:
        name: name of the stage.
        total: number of steps, for the progress bar.
        counts: numbers of inputs, results, and dropped items by reason.
        wall_s: wall-clock seconds.
        cpu_s: CPU seconds of all threads.
        peak_mb: largest resident memory during the stage, megabytes.
    """

    name: str
    total: int
    progress: Progress
    counts: dict[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    done: int = 0
    lock: Lock = field(default_factory=Lock)

    def advance(self) -> None:
        """Count one step as finished, repeated ones only up to the total; thread-safe."""
        with self.lock:
            self.done = min(self.done + 1, self.total)
            self.progress(self.name, self.done, self.total)

    def record(self) -> dict[str, Any]:
        """The stage's entry in report.json."""
        return {
            "name": self.name,
            "counts": plain_counts(self.counts),
            "wall_s": round(self.wall_s, 3),
            "cpu_s": round(self.cpu_s, 3),
            "peak_mb": round(self.peak_mb, 1),
        }


class Stages:
    """The stages of a run, in order."""

    def __init__(self, progress: Progress = no_progress) -> None:
        """Start without stages; `progress` is called at every step."""
        self.progress = progress
        self.finished: list[Stage] = []

    @contextmanager
    def stage(self, name: str, total: int = 1) -> Iterator[Stage]:
        """Run the block as the stage `name` with `total` steps, and record it."""
        stage = Stage(name, total, self.progress)
        reset_peak_memory()
        wall, cpu = time.perf_counter(), time.process_time()
        self.progress(name, 0, total)
        yield stage
        stage.wall_s, stage.cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        stage.peak_mb = peak_memory_mb()
        self.progress(name, total, total)
        self.finished.append(stage)
        if stage.peak_mb > TRIMMED_MB:
            return_freed_memory()

    def records(self) -> list[dict[str, Any]]:
        """Records of the finished stages."""
        return [stage.record() for stage in self.finished]


def plain_counts(stats: Mapping[str, Any]) -> dict[str, Any]:
    """`stats` converted to JSON types.

    Numpy numbers become Python's, integral ones int, and non-finite ones None.
    """
    return {key: plain(value) for key, value in stats.items()}


def plain(value: Any) -> Any:
    """One value of `plain_counts`."""
    if isinstance(value, Mapping):
        return plain_counts(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return int(value) if value.is_integer() else round(value, 6)
    return value
