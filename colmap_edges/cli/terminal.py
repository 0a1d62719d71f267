"""Terminal output (with control characters escaped), logging, progress bars, signals."""

from __future__ import annotations

import io
import logging
import os
import shutil
import signal
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import click

from colmap_edges.errors import printable
from colmap_edges.runtime.platform import ending_signals
from colmap_edges.runtime.stages import Progress, no_progress

HANDLED: list[int] = []  # signals handled during a run
RECEIVED: list[int] = []  # signals received so far


def show_usage_error(error: click.ClickException) -> None:
    """Print click's message about a usage error."""
    text = io.StringIO()
    error.show(file=text)
    say(*text.getvalue().rstrip("\n").split("\n"), err=True)


def say(*lines: str, err: bool = False) -> None:
    """Print lines to standard output or error, with control characters escaped."""
    try:
        click.echo("\n".join(map(printable, lines)), err=err)
    except OSError:
        if not err:
            raise
        silence(sys.stderr)  # nothing else can report it


def silence(stream: TextIO) -> None:
    """Lead a stream that cannot be written to the null device, else Python exits with 120."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


def open_streams() -> None:
    """Open closed standard streams to the null device, and replace unencodable characters.

    Otherwise the next opened files would get their descriptors, and libraries would write there.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(
                errors="backslashreplace"
            )  # characters outside the locale's encoding


class LogFormatter(logging.Formatter):
    """Formats log records with control characters escaped, and ours as sentences."""

    def __init__(self, verbose: bool) -> None:
        """With `verbose`, also show which module warns."""
        super().__init__("%(levelname)s %(name)s: %(message)s")
        self.verbose = verbose

    def formatMessage(self, record: logging.LogRecord) -> str:
        """The record's line."""
        if record.name.startswith("colmap_edges.") and not self.verbose:
            return printable(f"{record.levelname.capitalize()}: {record.message}")
        return printable(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:
        """The lines of a traceback."""
        return "\n".join(map(printable, super().formatException(ei).split("\n")))


class StderrHandler(logging.StreamHandler):  # type: ignore[type-arg, unused-ignore]
    """Writes to what standard error is at the time, so that lines do not run into a live bar."""

    @property
    def stream(self) -> Any:
        """The stream, which progress bars replace while they are shown."""
        return sys.stderr

    @stream.setter
    def stream(self, _value: Any) -> None:
        """Ignore the stream that the base class would keep."""


def start_logging(verbose: bool) -> None:
    """Log warnings to standard error; with `verbose` also this program's debug messages.

    Debug messages of libraries are not shown.
    """
    handler = StderrHandler()
    handler.setFormatter(LogFormatter(verbose))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.getLogger("colmap_edges").setLevel(logging.DEBUG if verbose else logging.WARNING)


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Yield a function that shows one progress bar per stage if standard error is a terminal."""
    if not sys.stderr.isatty():
        yield no_progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(30),
        TextColumn("{task.fields[steps]:>11}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}
        whole = bars.add_task("in all", total=None, steps="", left="")

        def show(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=total, steps="", left="")
            steps = f"{done:,}/{total:,}" if total > 1 else ""
            left = time_left(bars.tasks[tasks[name]])
            bars.update(tasks[name], completed=done, total=total, steps=steps, left=left)

        yield show
        bars.update(whole, total=1, completed=1)


def time_left(task: Any) -> str:
    """How long a stage of several steps will still take, at the speed of the steps so far."""
    if task.finished or not task.completed or task.elapsed is None:
        return ""
    seconds = task.elapsed * (task.total / task.completed - 1)
    return f"about {duration(seconds)} left"


def duration(seconds: float) -> str:
    """A time in words, such as "8.6 s" or "12 min 3 s"."""
    if seconds < 60:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def wrapped(line: str, width: int) -> list[str]:
    """A line broken between words; further lines are indented below its text."""
    # The names in a summary take ten columns.
    indent = " " * 10 if line[:10].rstrip().endswith(":") else "  "
    return textwrap.wrap(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ) or [line]


def tell(*lines: str) -> None:
    """Print lines of text to standard output, broken between words on a terminal."""
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
        lines = tuple(part for line in lines for part in wrapped(printable(line), width))
    say(*lines)


def handled_signals() -> list[int]:
    """The signals that end a run, without those that the parent ignores (as nohup does)."""
    return [number for number in ending_signals() if signal.getsignal(number) != signal.SIG_IGN]


def handle_signals(signals: list[int]) -> None:
    """Install signal handlers that end the run with its output cleaned up."""
    for number in signals:
        signal.signal(number, on_signal)


def on_signal(number: int, _frame: Any) -> None:
    """Raise an exception so that unfinished output is cleaned up."""
    if RECEIVED and number not in (signal.SIGINT, signal.SIGTERM):
        return  # both shell and kernel send SIGHUP when a terminal closes
    RECEIVED.append(number)
    raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)
