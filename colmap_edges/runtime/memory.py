"""Control of how the C library (glibc) treats freed memory."""

from __future__ import annotations

from colmap_edges.runtime.platform import c_function


def reuse_freed_memory() -> None:
    """Let the C library reuse the memory of freed arrays.

    By default it returns large arrays to the system and requests new pages, which the system
    clears, and memory freed by one thread is reused by that thread only. Call this before threads
    are started.
    """
    mallopt = c_function("mallopt")
    if mallopt is not None:
        mallopt(-3, 1 << 28)  # M_MMAP_THRESHOLD
        mallopt(-1, 1 << 29)  # M_TRIM_THRESHOLD
        mallopt(-8, 1)  # M_ARENA_MAX


def return_freed_memory() -> None:
    """Let the C library return freed memory to the system."""
    trim = c_function("malloc_trim")
    if trim is not None:
        trim(0)
