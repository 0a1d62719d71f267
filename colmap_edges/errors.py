"""Errors that a user can act on: each names what, where and the remedy in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


class ColmapEdgesError(Exception):
    """Bad input, options or environment; its message is one clear line for the user."""


class ImageError(ColmapEdgesError):
    """An image file is damaged; a run can go on without it."""


class NotAFileError(ColmapEdgesError, OSError):
    """A pipe, a device or a folder is where a file should be."""


class OptionError(ColmapEdgesError, ValueError):
    """An option's value is outside its range."""


def printable(text: str) -> str:
    """`text` with control characters, line breaks too, and what else is no sign, as escapes.

    Names of files may hold them, and steer the terminal that shows them.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@contextmanager
def exit_on_error(*others: type[Exception]) -> Iterator[None]:
    """End a script whose input is bad, or that meets one of `others`, with one line and exit 1."""
    known: tuple[type[Exception], ...] = (ColmapEdgesError, *others)
    try:
        yield
    except known as error:
        sys.exit(f"error: {printable(str(error))}")
