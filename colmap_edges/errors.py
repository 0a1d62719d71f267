"""Errors for users: each message is one line with the problem, its place and the remedy."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


class ColmapEdgesError(Exception):
    """Invalid input, options or environment; the message is one line for the user."""


class ImageError(ColmapEdgesError):
    """A damaged image file; the run can continue without it."""


class NotAFileError(ColmapEdgesError, OSError):
    """The path is a pipe, device or folder where a file is expected."""


class OptionError(ColmapEdgesError, ValueError):
    """An option's value is outside its range."""


def check_type(name: str, value: object, kinds: tuple[type, ...], others: str = "") -> None:
    """Check the type of a function's argument.

    Args:
        name: name of the argument.
        value: value of the argument.
        kinds: accepted types.
        others: further accepted values, in words.

    Raises:
        ColmapEdgesError: if the value has none of these types.
    """
    if not isinstance(value, kinds):
        wanted = [f"{kind.__module__.split('.')[0]}.{kind.__name__}" for kind in kinds]
        wanted = [text.removeprefix("builtins.") for text in wanted] + ([others] if others else [])
        found = type(value).__name__
        raise ColmapEdgesError(f"{name} is of type {found}; give {' or '.join(wanted)}")


def printable(text: str) -> str:
    """`text` with control characters, line breaks and other unprintable characters escaped.

    File names may contain them, and terminals would execute them.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(count: int, noun: str, plural: str = "") -> str:
    """A number with its noun: "1 image", "2,345 images"; the plural has an s unless given."""
    return f"{count:,} {noun if count == 1 else plural or f'{noun}s'}"


@contextmanager
def extra(use: str, name: str) -> Iterator[None]:
    """Import libraries of an extra of this package within the block.

    Args:
        use: what needs them.
        name: name of the extra.

    Raises:
        ColmapEdgesError: if one is not installed.
    """
    try:
        yield
    except ImportError as error:
        missing = (error.name or "a library").partition(".")[0]
        raise ColmapEdgesError(
            f"{use} needs {missing}, which is not installed; run: pip install "
            f"'colmap-edges[{name}]'"
        ) from error


@contextmanager
def exit_on_error(*others: type[Exception]) -> Iterator[None]:
    """Exit a script with one line and status 1 on a ColmapEdgesError or one of `others`."""
    known: tuple[type[Exception], ...] = (ColmapEdgesError, *others)
    try:
        yield
    except known as error:
        sys.exit(f"error: {printable(str(error))}")
