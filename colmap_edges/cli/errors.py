"""Error handling of the command line: one line on standard error and an exit code."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import click

from colmap_edges.cli.flags import with_dashes
from colmap_edges.cli.terminal import RECEIVED, say, silence, start_logging
from colmap_edges.errors import ColmapEdgesError, OptionError

# What libraries say of their own errors when the system refuses memory or threads.
REFUSALS = (
    *("bad_alloc", "Insufficient memory", "allocate memory", "failed to map segment"),
    "can't start new thread",
)


@contextmanager
def one_line_errors(verbose: bool) -> Iterator[None]:
    """Turn known errors into one line and exit 1; usage errors exit 2."""
    start_logging(verbose)
    try:
        yield
    except OptionError as error:
        command = click.get_current_context().command
        raise click.UsageError(with_dashes(str(error), command)) from error
    except BrokenPipeError as error:  # the reader of our output has closed the pipe
        silence(sys.stdout)
        raise click.exceptions.Exit(1) from error
    except Exception as error:
        text = one_line(error)
        if RECEIVED or text is None:
            raise
        if verbose:
            say(*traceback.format_exc().rstrip().split("\n"), err=True)
        say(f"Error: {text}", err=True)
        raise click.exceptions.Exit(1) from error


def one_line(error: Exception) -> str | None:
    """The line for the user about an error of his or of the system; None for one of this program's.

    Libraries also raise errors of their own if the system refuses memory or threads.
    """
    text = str(error).strip()
    if isinstance(error, MemoryError) or any(words in text for words in REFUSALS):
        return (
            f"the system refuses memory or threads ({text or 'out of memory'}); free memory, raise "
            "its limits (ulimit -v, ulimit -u), or give a smaller --num_threads"
        )
    return text if isinstance(error, ColmapEdgesError | OSError) else None
