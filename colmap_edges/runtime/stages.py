"""Records counts, seconds and peak memory of each stage, and shows progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from colmap_edges.runtime.platform import peak_memory_mb, reset_peak_memory

# Called with the stage's name, the steps done and the steps in all.
Progress = Callable[[str, int, int], None]


def no_progress(name: str, done: int, total: int) -> None:
    """Show nothing."""


@dataclass
class Stage:
    """One stage while it runs and after.

    Attributes:
        name: what the stage is called.
        total: number of steps, for the progress bar.
        counts: what went in, what was kept, what was dropped by reason.
        wall_s: seconds by the clock.
        cpu_s: seconds of processor time over all threads.
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
        """Count one step as done; may be called from any thread."""
        with self.lock:
            self.done += 1
            self.progress(self.name, self.done, self.total)

    def record(self) -> dict[str, Any]:
        """What the report keeps of the stage."""
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
        """Start without stages; `progress` is told of every step."""
        self.progress = progress
        self.finished: list[Stage] = []

    @contextmanager
    def stage(self, name: str, total: int = 1) -> Iterator[Stage]:
        """Run the block as the stage `name` of `total` steps and keep its record."""
        stage = Stage(name, total, self.progress)
        reset_peak_memory()
        wall, cpu = time.perf_counter(), time.process_time()
        self.progress(name, 0, total)
        yield stage
        stage.wall_s, stage.cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        stage.peak_mb = peak_memory_mb()
        self.progress(name, total, total)
        self.finished.append(stage)

    def records(self) -> list[dict[str, Any]]:
        """Records of the finished stages."""
        return [stage.record() for stage in self.finished]


def plain_counts(stats: Mapping[str, Any]) -> dict[str, Any]:
    """`stats` as what JSON can hold.

    Numbers of numpy become Python's, whole ones integers, and None those that are no numbers.
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
