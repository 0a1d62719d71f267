"""The demo scene: its bodies, in metres, z up, front towards -y, its views, and how it is made."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from manifold3d import Manifold

from zoo import mapping
from zoo.camera import Rig, Size, View, look_at, pinhole, write_cameras
from zoo.geometry import Body, unite
from zoo.solids import arc, ball, body, box, cylinder, lathe, prism, unite_all
from zoo.truth import cut_curves, write_truth

STAGES = ("geometry", "images", "sparse", "all")
SINK = 0.1  # depth by which a body enters the plinth, so that no two faces coincide


def make_bodies() -> Iterator[Body]:
    """All bodies; bodies that touch overlap a little, so that they unite."""
    for make in (
        ground, house, arch, column, washer, chamfered_box, hexagonal_prism, curved_wall, pear,
        glossy_sphere, glossy_torus, railing,
    ):  # fmt: skip
        yield from make()


def ground() -> Iterator[Body]:
    """The plinth: textured, with a two-coloured disc and two stripes let into its top."""
    plinth = box((-5, 5), (-3.75, 3.75), (-0.5, 0))
    disc, ring = (cylinder(1, r) for r in (0.45, 0.75))
    # Different depths: where the bottoms of two inlays coincide, their union leaves slivers.
    inner, plinth = plinth.split(disc.translate((-2.3, -0.7, -0.2)))
    outer, plinth = plinth.split(ring.translate((-2.3, -0.7, -0.3)))
    wide, plinth = plinth.split(box((-4.6, 1.7), (-3.5, -3.2), (-0.3, 1)))
    oblique = box((-0.9, 0.9), (-0.1, 0.1), (-0.3, 1)).rotate((0, 0, 35))
    narrow, plinth = plinth.split(oblique.translate((3.0, -2.0, 0)))
    yield Body("plinth", "stone", plinth)
    yield Body("plinth", "paint_dark", outer)
    yield Body("plinth", "paint_light", inner)
    yield Body("plinth", "paint_light", wide)
    yield Body("plinth", "paint_dark", narrow)


def house() -> Iterator[Body]:
    """A building: windows, door, steps, painted base, ledge, cornice and gable roof."""
    x, y = (-3.6, 0.2), (1.0, 3.0)
    walls = box(x, y, (-SINK, 2.4)) - house_openings()
    base, walls = walls.split(box((-5, 5), (-5, 5), (-1, 0.3)))
    ledge = box((x[0] - 0.08, x[1] + 0.08), (y[0] - 0.08, y[1] + 0.08), (1.22, 1.34))
    cornice = box((x[0] - 0.2, x[1] + 0.2), (y[0] - 0.2, y[1] + 0.2), (2.35, 2.55))
    gable = np.array([(-1.15, 0.0), (1.15, 0.0), (0.0, 0.95)])
    roof = prism(gable, x[1] - x[0] + 0.2).rotate((90, 0, 90)).translate((x[0] - 0.1, 2.0, 2.5))
    steps = [box((-2.3 - d, -1.1 + d), (0.7 - d, 1.2), (-SINK, 0.3 - d / 3)) for d in (0, 0.3, 0.6)]
    yield Body("house", "stucco", walls)
    yield Body("house", "paint_dark", base)
    yield Body("house", "plaster", ledge + cornice)
    yield Body("house", "tiles", roof)
    yield Body("house", "plaster", steps[0] + steps[1] + steps[2])


def house_openings() -> Manifold:
    """The volume of the recessed windows and of the arched door."""
    front = [(c, z) for c in (-3.05, -0.35) for z in (0.5, 1.55)] + [(-1.7, 1.62)]
    beside = [(c - 0.28, c + 0.28) for c in (1.55, 2.45)]
    windows = [box((c - 0.28, c + 0.28), (0.5, 1.16), (z, z + 0.6)) for c, z in front]
    windows += [box((0.0, 0.5), y, (z, z + 0.6)) for y in beside for z in (0.5, 1.55)]
    windows += [box((-4, -3.45), y, (1.55, 2.15)) for y in beside]
    half_disc = arc(0.35, 0, 180, 33) + np.array([0, 0.82])
    outline = np.vstack([[(-0.35, 0.3), (0.35, 0.3)], half_disc])
    door = prism(outline, 1.0).rotate((90, 0, 0)).translate((-1.7, 1.2, 0))
    return unite_all([*windows, door])


def arch() -> Iterator[Body]:
    """A gate: two straight legs under a half-ring."""
    outer, inner = arc(1.15, 0, 180, 65), arc(0.72, 180, 0, 49)
    feet = np.array([[(-1.15, -1.3), (-0.72, -1.3)], [(0.72, -1.3), (1.15, -1.3)]])
    outline = np.vstack([outer, feet[0], inner, feet[1]])
    gate = prism(outline, 0.55).rotate((90, 0, 0)).translate((0, 0.275, 1.2))
    yield body("arch", "sandstone", gate, (2.6, 2.2, 0), -18)


def column() -> Iterator[Body]:
    """A drum on a round base under a round capital, all rims sharp."""
    profile = [(0, -SINK), (0.52, -SINK), (0.52, 0.2), (0.36, 0.2), (0.36, 1.45)]
    profile += [(0.5, 1.45), (0.5, 1.65), (0, 1.65)]
    yield body("column", "plaster", lathe(profile), (4.15, 0.6, 0))


def washer() -> Iterator[Body]:
    """An upright disc with a round hole."""
    ring = cylinder(0.22, 0.68) - cylinder(1, 0.33).translate((0, 0, -0.5))
    upright = ring.rotate((90, 0, 28)).translate((1.15, 0.35, 0.62))
    yield Body("washer", "ochre", upright)


def chamfered_box() -> Iterator[Body]:
    """A textureless box with one corner cut off and a smaller one on its top."""
    block = box((-0.55, 0.55), (-0.45, 0.45), (-SINK, 1.0))
    block = block.trim_by_plane((-1, 1, -1), -0.93)
    top = box((-0.25, 0.3), (-0.2, 0.25), (0.9, 1.35)).rotate((0, 0, 20))
    yield body("box", "matte_white", block + top, (-4.15, -0.6, 0), 27)


def hexagonal_prism() -> Iterator[Body]:
    """A textureless hexagonal prism with a shallow pyramid as its top."""
    column = cylinder(0.8 + SINK, 0.55, 6).translate((0, 0, -SINK))
    tip = cylinder(0.45, 0.55, 6, 0.0).translate((0, 0, 0.8))
    yield body("hexagon", "matte_blue", column + tip, (3.9, -1.1, 0), 10)


def curved_wall() -> Iterator[Body]:
    """An S-shaped wall with a level top: smooth sides, sharp rims."""
    t = np.linspace(-1, 1, 81)
    line = np.column_stack([2.0 * t, 0.45 * np.sin(np.pi * t)])
    tangent = np.gradient(line, t, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal *= 0.11 / np.linalg.norm(normal, axis=1, keepdims=True)
    outline = np.vstack([line - normal, (line + normal)[::-1]])
    yield body("curved_wall", "matte_green", prism(outline, 0.55 + SINK), (-2.1, -2.25, -SINK))


def pear() -> Iterator[Body]:
    """A matte smooth body, whose silhouette is view-dependent."""
    t = np.linspace(0, np.pi, 49)
    radius = np.sin(t) * (0.42 - 0.13 * np.cos(t + np.pi)) + 0.05 * np.sin(t) * np.sin(3 * t)
    profile = np.column_stack([radius, -0.7 * np.cos(t) + 0.62])
    profile[[0, -1], 0] = 0.0
    yield body("pear", "matte_grey", lathe(profile), (0.0, -0.9, 0))


def glossy_sphere() -> Iterator[Body]:
    """A glossy ball, whose silhouette, highlights and reflections are view-dependent."""
    yield body("sphere", "glossy_red", ball(0.5, 49), (2.25, -0.75, 0.47))


def glossy_torus() -> Iterator[Body]:
    """A glossy ring that lies on the plinth."""
    profile = arc(0.17, 0, 360, 41)[:-1] + np.array([0.48, 0])
    yield body("torus", "glossy_black", lathe(profile), (1.2, -2.2, 0.13))


def railing() -> Iterator[Body]:
    """Thin posts and rails of square section."""
    half = 0.03
    posts = [box((x - half, x + half), (-half, half), (-SINK, 0.75)) for x in np.linspace(-1, 1, 6)]
    rails = [box((-1.05, 1.05), (-0.022, 0.022), (z - 0.022, z + 0.022)) for z in (0.35, 0.68)]
    yield body("railing", "matte_white", unite_all([*posts, *rails]), (3.65, -3.2, 0), 8)


def make_views() -> list[View]:
    """Two arcs of views around the scene and a few closer, higher and tilted ones."""
    middle = (0.0, 0.0, 0.6)
    poses = [(12.3, azimuth, 17.0, middle, 0.0) for azimuth in np.linspace(-80, 80, 11)]
    poses += [(12.0, azimuth, 40.0, middle, 0.0) for azimuth in np.linspace(-70, 70, 8)]
    poses += [
        (8.0, -28.0, 26.0, (-1.5, 0.2, 0.7), 0.0),
        (8.0, 30.0, 30.0, (1.6, 0.0, 0.5), 0.0),
        (12.0, 5.0, 66.0, (0.0, 0.2, 0.0), 90.0),
        (11.5, -12.0, 9.0, middle, 12.0),
        (10.5, 48.0, 55.0, middle, -15.0),
    ]
    return [look_at(f"view{i:02d}.jpg", *pose) for i, pose in enumerate(poses)]


def make_demo(
    stage: str, folder: Path, size: Size | None = None, num_views: int | None = None, seed: int = 0
) -> str:
    """Write one stage of the scene, of `STAGES`; arguments are those of `fixed.make_room`.

    There are 24 views of 1024x768 pixels unless asked for others.
    """
    size = size or (1024, 768)
    rig = Rig(pinhole(size, 1100 * size[0] / 1024), make_views()[:num_views])
    bodies = list(make_bodies())
    surface = unite(bodies)
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    if stage in ("geometry", "all"):
        curves, _, _ = cut_curves(surface, bodies, spacing=0.01)  # about one pixel
        write_truth(folder, surface, bodies, curves, face_body=surface.face_body.astype(np.uint8))
        write_cameras(folder / "true_cameras.json", rig)
        made.append(f"{len(surface.faces)} triangles, {len(curves.edges)} segments of curves")
    if stage in ("images", "all"):
        from zoo.blender import render_views

        render_views(folder / "images", surface, bodies, rig, seed)
        made.append(f"{len(rig.views)} images")
    if stage in ("sparse", "all"):
        made.append(mapping.reconstruct(folder / "images", folder / "sparse", rig))
    return "\n".join(made)
