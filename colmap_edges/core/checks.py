"""Checks of arguments of the Python interface: types, numbers, paths and arrays.

Functions of the interface carry `checked`. Types of arrays declare their shapes as
`Annotated[FloatArray, "N", 3]`; equal letters stand for equal numbers within one object. Their
method `check` compares the arrays with these shapes and dtypes and checks the values. Stages of a
run exchange what they made themselves and check nothing.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Hashable
from functools import cache, wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import IntArray
from colmap_edges.declared_options import shown
from colmap_edges.errors import ColmapEdgesError, check_type

P = ParamSpec("P")
R = TypeVar("R")
Shape = tuple[str | int, ...]
MAX_COORDINATE = 1e30  # world units; products of five coordinates stay finite
MAX_INTEGER = 2**31 - 1


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function check its arguments against its annotations.

    Paths may be strings; integers are at least 0. Arguments of types with a method `check` are
    checked by it. Errors of files become a `ColmapEdgesError`.
    """
    names = signature(function)

    @wraps(function)
    def with_checks(*args: P.args, **kwargs: P.kwargs) -> R:
        given = names.bind(*args, **kwargs)
        hints = hints_of(function)
        for name, value in given.arguments.items():
            if name in hints:
                given.arguments[name] = checked_argument(name, value, hints[name])
        try:
            return function(*given.args, **given.kwargs)
        except ColmapEdgesError:
            raise
        except OSError as error:
            raise ColmapEdgesError(f"{error.filename or function.__name__}: {error}") from error

    return with_checks


@cache
def hints_of(owner: Hashable) -> dict[str, Any]:
    """The annotations of a function or class by name, without that of the result."""
    hints = get_type_hints(owner, include_extras=True)
    return {name: hint for name, hint in hints.items() if name != "return"}


def checked_argument(name: str, value: Any, hint: Any) -> Any:
    """The value of an argument, converted to a path if one is annotated.

    Raises:
        ColmapEdgesError: if the value does not fit the annotation.
    """
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if hint is Any or (value is None and type(None) in kinds):
        return value
    if Path in kinds:
        return path_of(name, value)
    kind = kinds[0]
    if get_origin(kind) is np.ndarray:
        check_array(name, value, kind)
    elif kind is int:
        check_number(name, value, 0)
    elif isinstance(kind, type):
        check_type(name, value, (bool, np.bool_) if kind is bool else (kind,))
    if hasattr(kind, "check"):
        value.check(name)
    return value


def path_of(name: str, value: Any) -> Path:
    """Convert an argument to a path.

    Raises:
        ColmapEdgesError: if it has another type, is empty, or no file can be named so.
    """
    check_type(name, value, (str, os.PathLike))
    try:
        text = os.fspath(value)
        if isinstance(text, bytes) or not text:
            raise ColmapEdgesError(f"{name} is {shown(text)}; give a path as text")
        os.lstat(text)
    except (ValueError, OSError) as error:
        if isinstance(error, ValueError) or error.errno in (errno.ENAMETOOLONG, errno.EINVAL):
            reason = error.strerror if isinstance(error, OSError) else error
            raise ColmapEdgesError(
                f"{name} is {shown(value)}, which is no name of a file ({reason}); give another"
            ) from error
    return Path(value)


def check_number(name: str, value: Any, low: float, *, integer: bool = True) -> None:
    """Check that an argument is a number of at least `low`, and neither a bool nor infinite.

    Raises:
        ColmapEdgesError: if it is not.
    """
    kind, what = (Integral, "an integer") if integer else (Real, "a number")
    fits = isinstance(value, kind) and not isinstance(value, bool)
    if not fits or not low <= float(value) <= (MAX_INTEGER if integer else MAX_COORDINATE):
        raise ColmapEdgesError(f"{name} is {shown(value)}; give {what} of at least {low:g}")


def check_arrays(name: str, record: Any, **sizes: int) -> None:
    """Check that arrays of an object have the declared dtypes and shapes.

    Values are checked, too, of `points` and of standard deviations, whose names end with `sigmas`.

    Args:
        name: name of the object.
        record: the object, of a class whose annotations declare them.
        sizes: numbers that letters of the shapes stand for; others are taken from the arrays.

    Raises:
        ColmapEdgesError: naming the first array that does not fit.
    """
    kind: Any = type(record)
    for entry, hint in hints_of(kind).items():
        if get_origin(hint) is Annotated:
            array, *shape = get_args(hint)
            values = check_array(f"{name}.{entry}", getattr(record, entry), array)
            check_shape(f"{name}.{entry}", values.shape, tuple(shape), sizes)
            if entry.endswith("sigmas"):
                check_sigmas(f"{name}.{entry}", values)
            elif entry == "points":
                check_points(f"{name}.{entry}", values)


def check_array(name: str, values: Any, array: Any) -> NDArray[Any]:
    """Check that an argument is an array of the dtype of an annotation such as `FloatArray`.

    Raises:
        ColmapEdgesError: if it is not.
    """
    dtype = np.dtype(get_args(get_args(array)[1])[0])
    check_type(name, values, (np.ndarray,))
    if values.dtype != dtype:
        raise ColmapEdgesError(
            f"{name} has the dtype {values.dtype}; convert it with astype(numpy.{dtype})"
        )
    return np.asarray(values)


def check_shape(name: str, found: tuple[int, ...], shape: Shape, sizes: dict[str, int]) -> None:
    """Check a shape against a declared one, whose unknown letters are added to `sizes`.

    Raises:
        ColmapEdgesError: if they differ.
    """
    if len(found) == len(shape):
        for size, of in zip(found, shape, strict=True):
            letter, _, more = str(of).partition("+")
            if letter.isalpha() and size >= int(more or 0):
                sizes.setdefault(letter, size - int(more or 0))
    known = tuple(size_of(of, sizes) for of in shape)
    if found != known:
        wanted = str(known).replace("'", "")
        raise ColmapEdgesError(f"{name} has the shape {found}; it must be {wanted}")


def size_of(of: str | int, sizes: dict[str, int]) -> str | int:
    """The number that an entry of a shape stands for; the entry itself if it is unknown."""
    letter, _, more = str(of).partition("+")
    return sizes[letter] + int(more or 0) if letter in sizes else of


def check_offsets(name: str, offsets: NDArray[Any], count: int, least: int | IntArray = 0) -> None:
    """Check that (n + 1,) offsets rise from 0 to a number of entries, each by at least `least`.

    Raises:
        ColmapEdgesError: if they do not.
    """
    if offsets[[0, -1]].tolist() != [0, count] or (np.diff(offsets) < 0).any():
        raise ColmapEdgesError(f"{name} must rise from 0 to the number of entries, {count}")
    short = np.flatnonzero(np.diff(offsets) < least)
    if len(short):
        row = short[0]
        raise ColmapEdgesError(
            f"{name} gives {np.diff(offsets)[row]} entries to row {row}; give it at least "
            f"{np.broadcast_to(least, len(offsets) - 1)[row]}"
        )


def check_values(name: str, values: NDArray[Any], low: float, high: float) -> None:
    """Check that numbers are finite and from `low` to `high`.

    Raises:
        ColmapEdgesError: naming the first that is not.
    """
    bad = np.argwhere(~((values >= low) & (values <= high)))
    if len(bad):
        place = ", ".join(map(str, bad[0].tolist()))
        raise ColmapEdgesError(
            f"{name}[{place}] is {values[tuple(bad[0])]}; it must be from {low:g} to {high:g}"
        )


def check_points(name: str, points: NDArray[Any]) -> None:
    """Check that coordinates are finite, and products of five of them neither 0 nor infinite.

    Raises:
        ColmapEdgesError: if they are too large or too small.
    """
    check_values(name, points, -MAX_COORDINATE, MAX_COORDINATE)
    largest = np.abs(points).max(initial=0)
    if 0 < largest < 1 / MAX_COORDINATE:
        raise ColmapEdgesError(
            f"{name} are all within {largest:.3g} of 0, which is too small; scale the model up"
        )


def check_sigmas(name: str, sigmas: NDArray[Any]) -> None:
    """Check standard deviations: at least 0, or not finite where unknown.

    Raises:
        ColmapEdgesError: naming the first that is neither.
    """
    unknown = np.isnan(sigmas) | np.isposinf(sigmas)
    check_values(name, np.where(unknown, 0, sigmas), 0, MAX_COORDINATE)
