"""Reads damaged inputs in worker processes that may crash, hang or eat memory without harm."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import traceback
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

MAX_SECONDS = 10.0
MAX_BYTES = 2 * 2**30
NO_FILE_RATIO = 0.06  # of the inputs in which something else is in the place of a file
NO_FILES = (os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/zero"))


class Job(NamedTuple):
    """A damaged copy of `source` to read as the kind it is; the seed decides the damage."""

    kind: str
    source: Path
    seed: int


@dataclass(frozen=True)
class Failure:
    """An input that ended in neither a result nor one clear line."""

    kind: str
    seed: int
    reason: str


def try_inputs(jobs: Sequence[Job], module: str = "reading") -> tuple[Counter, list[Failure]]:
    """Read damaged inputs.

    Args:
        jobs: what to read.
        module: holds READERS, functions of a folder by kind; CLEAR_ERRORS, what they may raise;
            and warm_up(kind, source).

    Returns:
        How often each (kind, outcome) came, with "result" and "error"; and the failures.
    """
    outcomes, failures = Counter(), []
    context = multiprocessing.get_context("spawn")
    at = 0
    with tempfile.TemporaryDirectory() as scratch:
        while at < len(jobs):
            ours, theirs = context.Pipe()
            args = (theirs, module, jobs[at:], Path(scratch))
            worker = context.Process(target=work, args=args)
            worker.start()
            theirs.close()
            at += watch(ours, worker, jobs[at:], outcomes, failures)
            worker.join()
    return outcomes, failures


def watch(pipe, worker, jobs, outcomes, failures) -> int:
    """Count what the worker says until it ends or is killed; return how many jobs are done."""
    if not pipe.poll(120) or pipe.recv() != "ready":
        raise RuntimeError(f"valid inputs of {sorted({job.kind for job in jobs})} cannot be read")
    for done, job in enumerate(jobs, 1):
        try:
            if not pipe.poll(MAX_SECONDS):
                worker.kill()
                outcome, detail = "failure", f"took longer than {MAX_SECONDS:g} s"
            else:
                outcome, detail = pipe.recv()
        except EOFError:
            worker.join()
            outcome, detail = "failure", f"killed the process (exit code {worker.exitcode})"
        outcomes[job.kind, outcome] += 1
        if outcome == "failure":
            failures.append(Failure(job.kind, job.seed, detail))
        if outcome == "failure" and detail.startswith(("took", "killed")):
            return done
    return len(jobs)


def work(pipe, module_name: str, jobs: Sequence[Job], scratch: Path) -> None:
    """Read the inputs one after another and tell the outcome of each."""
    module = importlib.import_module(module_name)  # its libraries stay out of the watcher
    silence()
    for kind, source in dict.fromkeys((job.kind, job.source) for job in jobs):
        module.warm_up(kind, source)
    limit_memory()
    pipe.send("ready")
    for job in jobs:
        folder = scratch / f"{job.kind}-{job.seed}"
        damaged_copy(job, folder)
        pipe.send(outcome_of(module, job.kind, folder))
        shutil.rmtree(folder, ignore_errors=True)


def silence() -> None:
    """Let libraries write what they want to nowhere."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)


def limit_memory() -> None:
    """Allow 2 GB in all, of which the libraries have taken some."""
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    virtual = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (virtual + MAX_BYTES - used,) * 2)


def damaged_copy(job: Job, folder: Path) -> None:
    """Copy a job's source with one file of it, sometimes two, damaged, or none any more."""
    from damage import damage

    shutil.copytree(job.source, folder)
    rng = np.random.default_rng([zlib.crc32(job.kind.encode()), job.seed])
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    if rng.random() < NO_FILE_RATIO:
        path = files[rng.integers(len(files))]
        path.unlink()
        NO_FILES[rng.integers(len(NO_FILES))](path)
        return
    for row in rng.integers(len(files), size=1 + int(rng.random() < 0.1)):
        files[row].write_bytes(damage(files[row].read_bytes(), rng))


def outcome_of(module, kind: str, folder: Path) -> tuple[str, str]:
    """What reading `folder` comes to."""
    try:
        module.READERS[kind](folder)
    except module.CLEAR_ERRORS as error:
        message = str(error)
        if not message or "\n" in message or len(message) > 600:
            return "failure", f"unclear message: {message[:200]!r}"
        return "error", message
    except BaseException:
        return "failure", traceback.format_exc(limit=-6)
    return "result", ""
