"""A mesh's texture from the photographs of its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from colmap_edges.core.view import View
from colmap_edges.images.files import encoded, single_threaded_opencv
from colmap_edges.surfaces.mesh import Mesh, Texture
from colmap_edges.texture.atlas import Atlas
from colmap_edges.texture.charts import make_charts
from colmap_edges.texture.gains import find_gains
from colmap_edges.texture.levelling import level
from colmap_edges.texture.pictures import Images
from colmap_edges.texture.seen_faces import find_seen_faces
from colmap_edges.texture.view_choice import choose_views, neighbours


def textured(
    mesh: Mesh, views: Sequence[View], images: Images, texture_size: int, num_threads: int
) -> tuple[Mesh, dict[str, float]]:
    """Give a mesh a texture.

    Args:
        mesh: the mesh.
        views: the views of its model.
        images: their images and masks.
        texture_size: largest side of the texture, pixels.
        num_threads: number of threads; does not affect the result.

    Returns:
        The mesh with its texture, and counts of its parts.

    Raises:
        ColmapEdgesError: if the mesh has too many charts for a texture of this size, or a mask
            does not fit its image.
    """
    if not len(mesh.faces):
        return mesh, {"charts": 0}
    with single_threaded_opencv():
        return made(mesh, views, images, texture_size, num_threads)


def made(
    mesh: Mesh, views: Sequence[View], images: Images, texture_size: int, num_threads: int
) -> tuple[Mesh, dict[str, float]]:
    """Give a mesh with triangles a texture, as `textured` does."""
    seen = find_seen_faces(mesh, views, images, num_threads)
    gains = find_gains(seen, len(views))
    pairs, sides = neighbours(mesh.faces)
    chosen = choose_views(seen, gains, pairs)
    charts = make_charts(mesh, seen, gains, chosen, pairs)
    atlas = Atlas(mesh, charts, views, texture_size)
    atlas.fill(images, gains, num_threads)
    level(atlas, pairs, sides)
    height, width = atlas.packing.shape
    texture = Texture(
        jpeg=encoded(".jpg", atlas.picture, (cv2.IMWRITE_JPEG_QUALITY, 90)),
        points=atlas.pixels / [width, height],
        corners=charts.corners,
    )
    counts = {
        "charts": int((charts.views >= 0).sum()),
        "views_used": len(np.unique(charts.views[charts.views >= 0])),
        "faces_without_view": int((chosen < 0).sum()),
        "texture_width": width,
        "texture_height": height,
        "texture_scale": round(atlas.packing.scale, 4),
    }
    return replace(mesh, texture=texture), counts
