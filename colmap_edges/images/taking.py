"""Values computed from each image while it is in memory, such as a reduced picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from colmap_edges.core.arrays import BoolArray, Picture
from colmap_edges.core.view import View

T = TypeVar("T")


class ImageTaker(Generic[T]):
    """Takes a value of the image of each view, and keeps it by the view's index."""

    def __init__(self, take: Callable[[View, Picture, BoolArray | None], T]) -> None:
        """Take by a function of the view, its image, and which pixels are usable (None: all)."""
        self.take = take
        self.taken: dict[int, T] = {}

    def visit(
        self,
        index: int,
        view: View,
        read: Callable[[], Picture],
        found: object,
        usable: BoolArray | None = None,
    ) -> T:
        """Take the value of a view."""
        return self.take(view, read(), usable)

    def collect(self, index: int, kept: T) -> None:
        """Keep a value."""
        self.taken[index] = kept
