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


def check_type(name: str, value: object, kinds: tuple[type, ...], others: str = "") -> None:
    """Check what a function was given.

    Args:
        name: of the argument.
        value: the argument.
        kinds: what it may be.
        others: in words, what else it may be.

    Raises:
        ColmapEdgesError: when it is none of `kinds`.
    """
    if not isinstance(value, kinds):
        wanted = [f"{kind.__module__.split('.')[0]}.{kind.__name__}" for kind in kinds]
        wanted = [text.removeprefix("builtins.") for text in wanted] + ([others] if others else [])
        found = type(value).__name__
        raise ColmapEdgesError(f"{name} is of type {found}; give {' or '.join(wanted)}")


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
