#!/usr/bin/env python3
"""Print the errors of the demo's meshes against the true surface, and draw the results."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import trimesh
from trials.pictures import looking

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View
from colmap_edges.evaluation.mesh_errors import against_depth
from colmap_edges.evaluation.metrics.depth import pixel_centers
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_mesh
from colmap_edges.evaluation.scenes import reference_of
from colmap_edges.evaluation.tables import NORMALS, SHARES, markdown
from colmap_edges.export.edges_json import load_edges
from colmap_edges.images.files import read_image
from colmap_edges.report.overlay import draw_edges

MESHES = ("without_edges", "with_edges")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("demo", type=Path, help="folder of the demo scene")
    parser.add_argument("output", type=Path, help="folder with the two runs; pictures go there")
    arguments = parser.parse_args()
    print(depth_errors(arguments.demo, arguments.output))
    model = load_model(arguments.demo / "sparse")
    for index in range(0, len(model.views), max(len(model.views) // 4, 1)):
        path = arguments.output / f"{Path(model.views[index].name).stem}.jpg"
        cv2.imwrite(str(path), picture(arguments.demo, arguments.output, model, index))
        print(f"{path}: photograph, 3D edges, textured; mesh without and with edges, from aside")


def depth_errors(demo: Path, output: Path) -> str:
    """Table of the errors of depth in all views of both meshes, in the demo's unit."""
    columns = ("mae", "rmse", "median", "p90", *SHARES, *NORMALS)
    reference = reference_of(demo / "surface.ply", ("all",), load_model(demo / "sparse"))
    rows = []
    for name in MESHES:
        mesh = load_mesh(output / name / "mesh.ply")
        caster = RayCaster(mesh.vertices, mesh.faces)
        found = against_depth(caster, reference.depths, None)["pooled"]
        rows.append([name.replace("_", " "), *(found[column] for column in columns)])
    return markdown(
        ("depth error in all views", *(name.replace("_", " ") for name in columns)), rows
    )


def picture(demo: Path, output: Path, model: Model, index: int) -> np.ndarray:
    """Photograph of a view, its 3D edges, textured mesh; both meshes, the textured from aside."""
    view = model.views[index]
    image = read_image(view, demo / "images")
    edges = draw_edges(image, index, model, load_edges(output / MESHES[1], model))
    without, plain = (shade(output / name / "mesh.ply", view) for name in MESHES)
    glb = output / MESHES[1] / "mesh.glb"
    top = [image, edges, textured(glb, view)]
    return np.vstack(
        [np.hstack(top), np.hstack([without, plain, textured(glb, aside(model, view))])]
    )


def aside(model: Model, view: View) -> View:
    """A view from where no camera stood: half as far again to the side, towards the points."""
    target = np.median(model.points3D_xyz, axis=0)
    offset = view.center - target
    across = np.cross(offset, view.rotation[1])
    return looking(view, view.center + across / 2, target)


def shade(mesh_path: Path, view: View) -> np.ndarray:
    """The mesh seen by a view, (H, W, 3) uint8, lit from the camera."""
    mesh = load_mesh(mesh_path)
    rays = unit(view.rays(pixel_centers((view.height, view.width))))
    normals = RayCaster(mesh.vertices, mesh.faces).hits(view.center, rays).normals
    light = np.abs(np.einsum("ij,ij->i", normals, rays))
    gray = np.where(np.isfinite(light), 40 + 200 * light, 255).astype(np.uint8)
    return cv2.cvtColor(gray.reshape(view.height, view.width), cv2.COLOR_GRAY2BGR)


def textured(mesh_path: Path, view: View) -> np.ndarray:
    """The mesh with its texture seen by a view, (H, W, 3) uint8."""
    mesh = load_mesh(mesh_path)
    rays = view.rays(pixel_centers((view.height, view.width)))
    centers = np.broadcast_to(view.center, rays.shape)
    places, seen, faces = mesh.ray.intersects_location(centers, rays, multiple_hits=False)
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[faces], places)
    coordinates = np.einsum("ni,nij->nj", weights, mesh.visual.uv[mesh.faces[faces]])
    colors = np.full((len(rays), 3), 255, np.uint8)
    colors[seen] = mesh.visual.material.to_color(coordinates)[:, 2::-1]
    return colors.reshape(view.height, view.width, 3)


if __name__ == "__main__":
    main()
