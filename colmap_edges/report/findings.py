"""Findings about a run, and those about its input model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from colmap_edges.errors import counted
from colmap_edges.options import PipelineOptions

Counts = Mapping[str, Any]
MIN_VIEWS = 3  # minimum number of views of an edge: two always agree, the third confirms the depth


class Finding(NamedTuple):
    """One finding about a run.

    Attributes:
        text: the problem, with its numbers.
        remedy: how to solve it, with the flag if there is one.
    """

    text: str
    remedy: str


def images_findings(read: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """Findings about the input model."""
    posed, unposed = read.get("images_with_poses", 0), read.get("images_without_poses", 0)
    flag, needed = needed_views(options)
    if 0 < posed < max(needed, MIN_VIEWS):
        lower = f", or set {flag} {posed}" if posed >= MIN_VIEWS else ""
        files = max(read.get("image_files", 0), posed + unposed)
        more = "take more images"
        if files > 2 * posed:
            more = f"map more of the {files} images (see COLMAP's log why it left them out)"
        yield Finding(
            f"the model has poses of only {counted(posed, 'image')}, but a 3D edge must be "
            f"seen in {max(needed, MIN_VIEWS)}",
            f"{more}{lower}",
        )
    if posed < 0.7 * (posed + unposed):
        yield Finding(
            f"images without a pose, which are not used: {unposed} of {posed + unposed}",
            "register more of them with `colmap mapper` (more overlap, more features)",
        )
    yield from model_findings(read)
    if far := read.get("points3D_too_far"):
        yield Finding(
            "SfM points at infinity, which are not used, but are in the written model: "
            f"{far:,} of {far + read.get('points3D', 0):,}",
            "delete them with `colmap point_filtering` and its --min_tri_angle",
        )
    if posed and read.get("points3D") == 0:
        yield Finding(
            "the model has no SfM points, so depths and neighbours come from poses alone",
            "run `colmap point_triangulator` on the model first",
        )


def model_findings(read: Counts) -> Iterator[Finding]:
    """Findings about images that are left out, points without tracks, and other models."""
    if names := read.get("images_contradicted"):
        yield Finding(
            "images whose poses do not fit the points3D that they observe are not used: "
            f"{len(names)} ({named(names)})",
            "adjust the model with `colmap bundle_adjuster`, or delete these images from it",
        )
    if copies := read.get("images_copied"):
        copy, original = copies[0]
        yield Finding(
            f"copies of other images at the same pose are not used: {len(copies)} ({copy} is "
            f"one of {original})",
            "delete the copies from the model",
        )
    if read.get("points3D") and read.get("observations") == 0:
        yield Finding(
            f"the {read['points3D']:,} points3D of the model have no tracks, so they are not "
            "used; depths and neighbours come from poses alone",
            "run `colmap point_triangulator` on the model first",
        )
    others, posed = read.get("other_models", {}), read.get("images_with_poses", 0)
    larger = max(others, key=others.__getitem__, default="")
    folder, _, number = read.get("model", "").rpartition("/")
    if others and (others[larger] > posed or int(min(others, key=int)) < int(number)):
        sizes = ", ".join(f"{folder}/{name} with {count}" for name, count in others.items())
        yield Finding(
            f"the model {folder}/{number} is used, with {posed} images; beside it, there is "
            f"{sizes}",
            f"give another, such as {folder}/{larger}, as --input_path, or map the images "
            "into one model",
        )


def named(names: Sequence[str]) -> str:
    """The first of some names, as a list in a sentence."""
    return f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"


def needed_views(options: PipelineOptions) -> tuple[str, int]:
    """The flag for the minimum number of views of an edge, and its value."""
    if options.tracing.method == "paper":
        return "--Visibility.min_views", options.visibility.min_views
    return "--Tracing.min_observations", options.tracing.min_observations
