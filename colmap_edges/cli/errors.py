"""Error handling of the command line: one line on standard error and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import click

from colmap_edges.cli.flags import with_dashes
from colmap_edges.cli.terminal import STOPPED, say, start_logging
from colmap_edges.errors import ColmapEdgesError, OptionError


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
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise click.exceptions.Exit(1) from error
    except (ColmapEdgesError, OSError, MemoryError) as error:
        if STOPPED:
            raise
        if verbose:
            say(*traceback.format_exc().rstrip().split("\n"), err=True)
        say(f"Error: {str(error).strip() or 'out of memory'}", err=True)
        raise click.exceptions.Exit(1) from error
