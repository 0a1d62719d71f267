"""What the C library does with freed memory, where it can be told (glibc)."""

from __future__ import annotations

from colmap_edges.runtime.platform import c_function

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h
KEPT_BYTES = 1 << 29
LARGEST_KEPT_BYTES = 1 << 28


def reuse_freed_memory() -> None:
    """Have arrays of images live where those of the image before did.

    As it is the C library gives large arrays back to the system when they are freed, and gets as
    many pages for the next, which the system fills with zeros first; and what one thread freed is
    kept for that thread alone. To be called before there are threads.
    """
    mallopt = c_function("mallopt")
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(M_ARENA_MAX, 1)


def return_freed_memory() -> None:
    """Have the C library return to the system what was freed."""
    trim = c_function("malloc_trim")
    if trim is not None:
        trim(0)
