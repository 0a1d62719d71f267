"""Array types, and helpers for rows of different lengths in flat arrays (CSR)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
Record = TypeVar("Record")
Ragged = TypeVar("Ragged", bound="RaggedTable")
Picture = NDArray[np.uint8]  # (H, W) intensities or (H, W, 3) colours


class Table:
    """A dataclass whose fields are arrays (or records of them) with a row for each item."""

    def select(self: Record, rows: IntArray | BoolArray) -> Record:
        """The items at a numpy index."""
        chosen = {of.name: getattr(self, of.name)[rows] for of in fields(self)}  # type: ignore[arg-type]
        return replace(self, **chosen)  # type: ignore[type-var]


def joined_tables(parts: Sequence[Record]) -> Record:
    """The items of all tables of arrays, one after the other; at least one table."""
    names = [of.name for of in fields(parts[0])]  # type: ignore[arg-type]
    return type(parts[0])(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


@dataclass(frozen=True, kw_only=True)
class RaggedTable:
    """Rows of different lengths: (n + 1,) `offsets`, and further arrays with an item an entry."""

    offsets: IntArray

    @property
    def lengths(self) -> IntArray:
        """(n,) number of entries of each row."""
        return np.diff(self.offsets)

    @cached_property
    def owners(self) -> IntArray:
        """(N,) row of each entry."""
        return owners_of(self.offsets)

    def select(self: Ragged, rows: IntArray) -> Ragged:
        """The (m,) rows of these indices, in their order."""
        return self.cut(entries_of(self.offsets, rows), self.lengths[rows])

    def cut(self: Ragged, entries: IntArray, lengths: IntArray) -> Ragged:
        """The entries of these indices, cut into rows of (m,) lengths."""
        names = [of.name for of in fields(self) if of.name != "offsets"]
        chosen = {name: getattr(self, name).take(entries, axis=0) for name in names}
        return replace(self, offsets=offsets_of(lengths), **chosen)


def offsets_of(lengths: IntArray) -> IntArray:
    """(n + 1,) CSR offsets of n lengths."""
    offsets = np.zeros(len(lengths) + 1, np.int64)
    np.cumsum(lengths, out=offsets[1:])
    return offsets


def joined_offsets(parts: Sequence[IntArray]) -> IntArray:
    """CSR offsets of concatenated parts, given the (n + 1,) offsets of each part."""
    return offsets_of(np.concatenate([np.zeros(0, np.int64), *map(np.diff, parts)]))


def parts_of(values: NDArray[Any], offsets: IntArray) -> list[NDArray[Any]]:
    """The n parts of an array between (n + 1,) offsets; numpy's `split` takes 30 times as long."""
    bounds = offsets.tolist()
    return [values[first:last] for first, last in pairwise(bounds)]


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices of at most `size` of `count` rows, in turn, so that temporary arrays are small."""
    return (slice(first, min(first + size, count)) for first in range(0, count, size))


def order_of(keys: NDArray[np.integer[Any]], limit: int) -> IntArray:
    """(n,) indices that stably sort (n,) integers from 0 to below `limit`.

    Keys that fit 16 bits are converted, since numpy radix-sorts them ten times as fast.
    """
    fits = limit <= np.iinfo(np.uint16).max + 1
    return np.argsort(keys.astype(np.uint16) if fits else keys, kind="stable")


def row_numbers(rows: NDArray[np.integer[Any]]) -> IntArray:
    """(N,) numbers of (N, K) rows: equal for equal rows and in their lexicographic order.

    Single numbers sort much faster than rows.
    """
    numbers = np.zeros(len(rows), np.int64)
    for column in rows.T.astype(np.int64) if len(rows) else ():
        low, last = int(column.min()), int(numbers.max())
        span = int(column.max()) - low + 1
        if (last + 1) * span > np.iinfo(np.int64).max:
            numbers, column = (np.unique(of, return_inverse=True)[1] for of in (numbers, column))
            low, span = 0, len(rows)
        numbers = numbers * span + (column - low)
    return numbers


def owners_of(offsets: IntArray) -> IntArray:
    """(offsets[-1],) row index of each entry, for (n + 1,) offsets."""
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def joined_lists(lists: Sequence[Sequence[int] | IntArray]) -> tuple[IntArray, IntArray]:
    """(N,) list of each entry of lists of integers, and (N,) the entries, list by list."""
    lengths = np.fromiter(map(len, lists), np.int64, len(lists))
    entries = np.fromiter(chain.from_iterable(lists), np.int64, int(lengths.sum()))
    return np.repeat(np.arange(len(lists)), lengths), entries


def entries_of(offsets: IntArray, rows: IntArray) -> IntArray:
    """Indices of the entries of (m,) rows of (n + 1,) offsets, in the order of `rows`."""
    return ranges_of(offsets[rows], offsets[rows + 1])


def medians_of(values: FloatArray | IntArray, owners: IntArray, count: int) -> FloatArray:
    """(count,) medians of the finite ones of (N,) values of each owner; NaN without any."""
    finite = np.isfinite(values)
    values, owners = values[finite], owners[finite]
    values = values[np.lexsort((values, owners))]
    counts = np.bincount(owners, minlength=count)
    starts, some = np.cumsum(counts) - counts, counts > 0
    low, high = ((starts + half)[some] for half in ((counts - 1) // 2, counts // 2))
    medians = np.full(count, np.nan)
    medians[some] = (values[low] + values[high]) / 2
    return medians


def robust_sigma(values: FloatArray) -> float:
    """Standard deviation of normally distributed values about 0, from the median of their sizes."""
    return 1.4826 * float(np.median(np.abs(values)))


def evenly_chosen(count: int, most: int) -> IntArray:
    """At most `most` of the indices from 0 to below `count`, at even distances."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def ranges_of(starts: IntArray, ends: IntArray) -> IntArray:
    """The concatenated half-open ranges from (n,) starts to (n,) ends."""
    lengths = ends - starts
    return np.asarray(np.repeat(starts, lengths) + ranks_of(lengths))


def ranks_of(lengths: IntArray) -> IntArray:
    """Index of each entry within its row, for n consecutive rows of the given lengths."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


def grown(mask: BoolArray) -> BoolArray:
    """`mask` dilated by one entry to both sides."""
    result = mask.copy()
    result[1:] |= mask[:-1]
    result[:-1] |= mask[1:]
    return result


def runs_of(*arrays: NDArray[Any]) -> IntArray:
    """(N,) run of each entry, in which each of some (N,) arrays is constant."""
    begins = np.ones(len(arrays[0]), bool)
    begins[1:] = np.any([of[1:] != of[:-1] for of in arrays], axis=0)
    return np.cumsum(begins) - 1


def long_runs(mask: BoolArray, least: int, *others: NDArray[Any]) -> BoolArray:
    """`mask` without runs of fewer than `least` true entries; runs end where others change."""
    runs = runs_of(mask, *others)
    result: BoolArray = mask & (np.bincount(runs)[runs] >= least)
    return result


def flattened(record: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """The arrays of a dataclass of arrays and of such dataclasses, by dotted name."""
    arrays: dict[str, NDArray[Any]] = {}
    for entry in fields(record):
        value, name = getattr(record, entry.name), prefix + entry.name
        arrays |= flattened(value, f"{name}.") if is_dataclass(value) else {name: value}
    return arrays


def unflattened(kind: type[Record], arrays: Mapping[str, NDArray[Any]], prefix: str = "") -> Record:
    """The dataclass of the given kind from the arrays of `flattened`; its inverse."""
    values = {}
    for name, of in get_type_hints(kind).items():
        inner = is_dataclass(of) and isinstance(of, type)
        values[name] = (
            unflattened(of, arrays, f"{prefix}{name}.") if inner else arrays[prefix + name]
        )
    return kind(**values)
