"""Makes a random scene of a family with its truth."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from zoo import FAMILIES, cad, facades, rooms, tabletop
from zoo.camera import PATHS, Grid, Rig, Size, View, draw_camera, draw_views, write_cameras
from zoo.casting import Caster
from zoo.geometry import Array, Random, unite
from zoo.light import LampLit, Stage, illuminate
from zoo.points import disturb, find_tracks, model_of, triangulated
from zoo.render import Sensor, see, typical_light, write_image
from zoo.truth import TrueCurves, contrasts_in, find_curves, shown, write_truth

MAKERS = (rooms.make, facades.make, cad.make, tabletop.smooth, tabletop.clutter)  # of FAMILIES
BRIGHT = 0.75  # light, of 1 at white, that typical bright pixels are exposed to


def draw_settings(random: Random, num_views: int | None) -> SimpleNamespace:
    """Draw everything but the bodies and the camera."""

    def often(share: float, value: float) -> float:
        return value if random.random() < share else 0.0

    drawn = int(random.integers(12, 31))
    return SimpleNamespace(
        num_views=num_views or drawn,
        path=PATHS[random.integers(len(PATHS))],
        noise=random.uniform(0.2, 2.0),  # of the sensor, gray levels
        shot_noise=random.uniform(0.2, 2.0),  # of the light at white, gray levels
        blur_px=random.uniform(0.35, 0.9),  # of the lens, standard deviation
        jpeg_quality=int(often(0.8, random.integers(50, 99))),  # 0: PNG
        exposure_percentile=random.uniform(85, 98),  # of the light that is shown as `BRIGHT`
        exposure_spread=often(0.4, random.uniform(0.03, 0.2)),  # of its logarithm over the views
        moving_light=bool(often(0.15, 1)),  # the lamp moves from view to view
        unit=10 ** often(0.5, random.uniform(-3, 4)),  # world units per metre
        turned=bool(often(0.3, 1)),  # the world's axes
        num_points=int(often(0.9, 10 ** random.uniform(1.3, 3.5))),  # maximum of SfM points
        point_noise_px=random.uniform(0.3, 0.5),  # of their observations
        pose_error_px=often(0.5, random.uniform(0.1, 0.5)),  # in sparse/
    )


def make_scene(
    family: str, seed: int, folder: Path, size: Size | None = None, num_views: int | None = None
) -> None:
    """Write a scene: images/, sparse/, surface.ply, curves.npz, true_cameras.json, scene.json.

    The same family and seed give the same bytes.

    Args:
        family: One of `FAMILIES`.
        seed: Of everything that is random.
        folder: Where to write; created.
        size: Of the images, pixels; default: 640x480.
        num_views: Number of views; default: drawn.
    """
    random = np.random.default_rng([seed, FAMILIES.index(family)])
    settings = draw_settings(random, num_views)
    stage = MAKERS[FAMILIES.index(family)](random)
    camera = draw_camera(random, size or (640, 480), wide=bool(stage.place.spots))
    surface = unite(stage.bodies)
    rig = Rig(camera, free_views(random, stage, settings, camera, Caster(surface)))
    centers = np.array([view.centre() for view in rig.views])
    distance = float(np.median(np.linalg.norm(centers - stage.place.middle, axis=1)))
    spacing = 1.5 * distance / camera.focal_length_x  # 1.5 pixels in the typical view
    curves = find_curves(surface, stage.bodies, rig, spacing)
    lit = illuminate(stage, surface, camera)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    contrasts = write_images(random, lit, settings, rig, folder / "images", curves)
    curves = shown(curves, contrasts, float(np.hypot(settings.noise, settings.shot_noise)))
    count, noise_px = settings.num_points, settings.point_noise_px
    tracks = find_tracks(random, lit, curves, rig, count, noise_px)
    world = draw_world(random, settings)
    error = settings.pose_error_px / camera.focal_length_x
    found = Rig(camera, [disturb(random, view, error, distance) for view in rig.views])
    points = place(world, triangulated(tracks, found))
    model = model_of(tracks, points, Rig(camera, [view.moved(*world) for view in found.views]))
    (folder / "sparse").mkdir(exist_ok=True)
    model.write_binary(folder / "sparse")
    placed = replace(surface, vertices=place(world, surface.vertices))
    curves = replace(curves, points=place(world, curves.points), radii=world[0] * curves.radii)
    names = np.array([view.name for view in rig.views])
    write_truth(folder, placed, stage.bodies, curves, view_names=names)
    rig = Rig(camera, [view.moved(*world) for view in rig.views])
    intrinsics = write_cameras(folder / "true_cameras.json", rig)
    record = {"family": family, "seed": seed, **settings.__dict__, "camera": intrinsics}
    record |= {"extent": stage.place.extent * settings.unit, **drawn(stage)}
    (folder / "scene.json").write_text(json.dumps(record, indent=1) + "\n")


def free_views(
    random: Random, stage: Stage, settings: SimpleNamespace, camera: pycolmap.Camera, caster: Caster
) -> list[View]:
    """Views that nothing stands directly before."""
    suffix = "jpg" if settings.jpeg_quality else "png"
    grid = Grid.of(camera).centers[:: camera.width // 4 + 1]
    for _ in range(20):
        views = draw_views(random, stage.place, camera, settings.path, settings.num_views)
        nearest = min(caster.hits(view.centre(), view.rays(grid))[1].min() for view in views)
        if nearest > 0.1 * stage.place.extent:
            break
    return [replace(view, name=f"{Path(view.name).stem}.{suffix}") for view in views]


def exposed(lit: LampLit, rig: Rig, percentile: float) -> LampLit:
    """The same with the light of that percentile of the pixels with a body as `BRIGHT`."""
    centers = Grid.of(rig.camera).centers
    level = typical_light(lit, rig, centers[:: max(1, len(centers) // 2000)], percentile)
    return replace(lit, white=level / BRIGHT / lit.stage.exposure)


def write_images(
    random: Random,
    lit: LampLit,
    settings: SimpleNamespace,
    rig: Rig,
    folder: Path,
    curves: TrueCurves,
) -> Array:
    """Render the views; returns the (E, V) contrasts of the curves' segments in them."""
    contrasts = np.zeros(curves.visible.shape)
    grid = Grid.of(rig.camera)
    light, middle = lit.light, lit.stage.place.middle
    lit = exposed(lit, rig, settings.exposure_percentile)
    for i, view in enumerate(rig.views):
        if settings.moving_light:
            angle = np.radians(6 * (i - len(rig.views) / 2))
            turn = Rotation.from_rotvec((0, 0, angle)).as_matrix()
            moved = middle + turn @ (light.position - middle)
            lit = lit.relit(replace(light, position=moved))
        sensor = Sensor(
            gain=np.exp(random.normal(0, settings.exposure_spread)),
            blur_px=settings.blur_px,
            noise=settings.noise,
            shot_noise=settings.shot_noise,
            quality=settings.jpeg_quality,
        )
        gray = write_image(folder / view.name, see(lit, view, grid), sensor, random)
        contrasts[:, i] = contrasts_in(gray, curves, view, rig.camera)
    return contrasts


def draw_world(random: Random, settings: SimpleNamespace) -> tuple[float, Array, Array]:
    """Scale, rotation and translation from the stage, in metres, to the world."""
    rotation = Rotation.random(random_state=random).as_matrix() if settings.turned else np.eye(3)
    return settings.unit, rotation, settings.unit * random.normal(0, 2, 3)


def place(world: tuple[float, Array, Array], points: Array) -> Array:
    """Points (N, 3) in the world."""
    scale, rotation, translation = world
    return scale * points @ rotation.T + translation


def drawn(stage: Stage) -> dict[str, Any]:
    """The randomly drawn values of a stage, for scene.json."""
    light = {key: np.asarray(value).tolist() for key, value in asdict(stage.light).items()}
    light["reach"] = None if np.isinf(stage.light.reach) else stage.light.reach
    materials = {name: asdict(material) for name, material in stage.materials.items()}
    return {"light": light, "materials": materials, **stage.facts}
