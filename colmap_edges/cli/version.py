"""Versions of this program and its libraries."""

from __future__ import annotations

import click

from colmap_edges import __version__


def version_text() -> str:
    """Versions of this program and its libraries, one per line."""
    from importlib.metadata import PackageNotFoundError, version  # brings mail and sockets

    parts = [f"colmap-edges {__version__}"]
    names = {"pycolmap": "pycolmap", "OpenCV": "opencv-contrib-python-headless", "numpy": "numpy"}
    for name, distribution in names.items():
        try:
            parts.append(f"{name} {version(distribution)}")
        except PackageNotFoundError:
            continue
    return ", ".join([*parts, cgal_text()])


def cgal_text() -> str:
    """Version of CGAL that the mesher was built with."""
    try:
        from colmap_edges import _mesher
    except ImportError:
        return "not built, so no meshing"
    return f"CGAL {_mesher.cgal_version}"


def show_version(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    """Print the versions and exit."""
    if value and not ctx.resilient_parsing:
        click.echo(version_text())
        ctx.exit()
