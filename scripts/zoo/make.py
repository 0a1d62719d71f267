"""Makes a random scene of a family with its truth."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from demo_scene.cameras import TrueCamera
from demo_scene.geometry import Surface, unite, write_surface
from scipy.spatial.transform import Rotation

from zoo import cad, facades, rooms, tabletop
from zoo.camera import PATHS, Grid, draw_camera, draw_views, moved
from zoo.points import disturb, find_tracks, triangulated, write_model
from zoo.render import Caster, Lit, Sensor, exposed, illuminate, relit, see, write_image
from zoo.stage import Array, Random, Stage
from zoo.truth import TrueCurves, as_arrays, contrasts_in, find_curves, shown

MAKERS = {
    "rooms": rooms.make,
    "facades": facades.make,
    "cad": cad.make,
    "smooth": tabletop.smooth,
    "clutter": tabletop.clutter,
}
FAMILIES = tuple(MAKERS)
SIZE = (640, 480)  # pixels
SPACING_PX = 1.5  # of the segments of curves, in the typical view


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is drawn for a scene apart from its bodies.

    Attributes:
        num_views: Number of views.
        path: How the camera moves; one of `PATHS`.
        noise: Of the sensor, gray levels.
        shot_noise: Of the light at white, gray levels.
        blur_px: Of the lens, standard deviation.
        jpeg_quality: 0: PNG.
        exposure_percentile: Percentile of the light that is shown as 0.75 of white.
        exposure_spread: Standard deviation of the exposure's logarithm over the views.
        moving_light: Whether the lamp moves from view to view.
        unit: World units per metre.
        turned: Whether the world's axes are turned.
        num_points: Maximum number of SfM points.
        point_noise_px: Of the observations of SfM points.
        pose_error_px: Of the poses in sparse/.
    """

    num_views: int
    path: str
    noise: float
    shot_noise: float
    blur_px: float
    jpeg_quality: int
    exposure_percentile: float
    exposure_spread: float
    moving_light: bool
    unit: float
    turned: bool
    num_points: int
    point_noise_px: float
    pose_error_px: float


def draw_settings(random: Random, num_views: int | None) -> Settings:
    """Draw everything but the bodies and the camera."""

    def often(share: float, value: float) -> float:
        return value if random.random() < share else 0.0

    drawn = int(random.integers(12, 31))
    return Settings(
        num_views=num_views or drawn,
        path=PATHS[random.integers(len(PATHS))],
        noise=random.uniform(0.2, 2.0),
        shot_noise=random.uniform(0.2, 2.0),
        blur_px=random.uniform(0.35, 0.9),
        jpeg_quality=int(often(0.8, random.integers(50, 99))),
        exposure_percentile=random.uniform(85, 98),
        exposure_spread=often(0.4, random.uniform(0.03, 0.2)),
        moving_light=bool(often(0.15, 1)),
        unit=10 ** often(0.5, random.uniform(-3, 4)),
        turned=bool(often(0.3, 1)),
        num_points=int(often(0.9, 10 ** random.uniform(1.3, 3.5))),
        point_noise_px=random.uniform(0.3, 0.5),
        pose_error_px=often(0.5, random.uniform(0.1, 0.5)),
    )


def make_scene(
    family: str,
    seed: int,
    folder: Path,
    *,
    size: tuple[int, int] = SIZE,
    num_views: int | None = None,
) -> None:
    """Write a scene: images/, sparse/, surface.ply, curves.npz, true_cameras.json, scene.json.

    The same family and seed give the same bytes.

    Args:
        family: One of `FAMILIES`.
        seed: Of everything that is random.
        folder: Where to write; created.
        size: Of the images, pixels.
        num_views: Number of views; default: drawn.
    """
    random = np.random.default_rng([seed, FAMILIES.index(family)])
    settings = draw_settings(random, num_views)
    stage = MAKERS[family](random)
    camera = draw_camera(random, size, wide=bool(stage.place.spots))
    surface = unite(stage.bodies)
    cameras = free_views(random, stage, settings, camera, Caster(surface))
    distance = typical_distance(stage, cameras)
    spacing = SPACING_PX * distance / camera.focal_length_x
    curves = find_curves(surface, stage.bodies, cameras, camera, spacing)
    lit = illuminate(stage, surface, camera)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    contrasts = write_images(random, lit, settings, cameras, camera, folder / "images", curves)
    curves = shown(curves, contrasts, float(np.hypot(settings.noise, settings.shot_noise)))
    tracks = find_tracks(
        random, lit, curves, cameras, camera, settings.num_points, settings.point_noise_px
    )
    world = draw_world(random, settings)
    error = settings.pose_error_px / camera.focal_length_x
    found = [disturb(random, view, error, distance) for view in cameras]
    points = place(world, triangulated(tracks, found, camera))
    model = write_model(tracks, points, [moved(view, *world) for view in found], camera)
    (folder / "sparse").mkdir(exist_ok=True)
    model.write_binary(folder / "sparse")
    cameras = [moved(view, *world) for view in cameras]
    write_truth(folder, world, surface, curves, stage, cameras)
    write_records(folder, settings, stage, camera, cameras, family, seed)


def free_views(
    random: Random, stage: Stage, settings: Settings, camera: pycolmap.Camera, caster: Caster
) -> list[TrueCamera]:
    """Views that nothing stands directly before."""
    suffix = "jpg" if settings.jpeg_quality else "png"
    grid = Grid.of(camera).centers[:: camera.width // 4 + 1]
    for _ in range(20):
        views = draw_views(random, stage.place, camera, settings.path, settings.num_views)
        rays = [
            np.column_stack([grid, np.ones(len(grid))]) @ view.cam_from_world[:, :3]
            for view in views
        ]
        nearest = min(
            caster.hits(view.centre(), ray)[1].min() for view, ray in zip(views, rays, strict=True)
        )
        if nearest > 0.1 * stage.place.extent:
            break
    return [replace(view, name=f"{Path(view.name).stem}.{suffix}") for view in views]


def typical_distance(stage: Stage, cameras: list[TrueCamera]) -> float:
    """From the cameras to the scene's middle."""
    centers = np.array([view.centre() for view in cameras])
    return float(np.median(np.linalg.norm(centers - stage.place.middle, axis=1)))


def write_images(
    random: Random,
    lit: Lit,
    settings: Settings,
    cameras: list[TrueCamera],
    camera: pycolmap.Camera,
    folder: Path,
    curves: TrueCurves,
) -> Array:
    """Render the views; returns the (E, V) contrasts of the curves' segments in them."""
    contrasts = np.zeros(curves.visible.shape)
    grid = Grid.of(camera)
    size = (camera.width, camera.height)
    light = lit.stage.light
    lit = exposed(lit, cameras, grid, settings.exposure_percentile)
    for i, view in enumerate(cameras):
        if settings.moving_light:
            turn = Rotation.from_rotvec((0, 0, np.radians(6 * (i - len(cameras) / 2)))).as_matrix()
            middle = lit.stage.place.middle
            place = middle + turn @ (light.position - middle)
            lit = relit(lit, replace(light, position=place))
        sensor = Sensor(
            gain=np.exp(random.normal(0, settings.exposure_spread)),
            blur_px=settings.blur_px,
            noise=settings.noise,
            shot_noise=settings.shot_noise,
            quality=settings.jpeg_quality,
        )
        gray = write_image(folder / view.name, see(lit, view, grid, size), sensor, random)
        contrasts[:, i] = contrasts_in(gray, curves, view, camera)
    return contrasts


def draw_world(random: Random, settings: Settings) -> tuple[float, Array, Array]:
    """Scale, rotation and translation from the stage, in metres, to the world."""
    rotation = Rotation.random(random_state=random).as_matrix() if settings.turned else np.eye(3)
    return settings.unit, rotation, settings.unit * random.normal(0, 2, 3)


def place(world: tuple[float, Array, Array], points: Array) -> Array:
    """Points (N, 3) in the world."""
    scale, rotation, translation = world
    return scale * points @ rotation.T + translation


def write_truth(
    folder: Path,
    world: tuple[float, Array, Array],
    surface: Surface,
    curves: TrueCurves,
    stage: Stage,
    cameras: list[TrueCamera],
) -> None:
    """Write the true surface and curves."""
    placed = replace(surface, vertices=place(world, surface.vertices))
    write_surface(folder / "surface.ply", placed)
    curves = replace(curves, points=place(world, curves.points), radii=world[0] * curves.radii)
    np.savez_compressed(
        folder / "curves.npz",
        **as_arrays(curves, surface, stage.bodies),
        view_names=np.array([view.name for view in cameras]),
    )


def write_records(
    folder: Path,
    settings: Settings,
    stage: Stage,
    camera: pycolmap.Camera,
    cameras: list[TrueCamera],
    family: str,
    seed: int,
) -> None:
    """Write the true cameras, and everything that was drawn."""
    intrinsics = {
        "model": camera.model_name,
        "width": camera.width,
        "height": camera.height,
        "params": camera.params.tolist(),
    }
    poses = {view.name: view.cam_from_world.tolist() for view in cameras}
    record = {
        "family": family,
        "seed": seed,
        **asdict(settings),
        "camera": intrinsics,
        "extent": stage.place.extent * settings.unit,
        "light": {k: np.asarray(v).tolist() for k, v in asdict(stage.light).items()},
        "materials": {name: asdict(material) for name, material in stage.materials.items()},
        **stage.facts,
    }
    record["light"]["reach"] = None if np.isinf(stage.light.reach) else stage.light.reach
    for name, data in (
        ("true_cameras.json", {**intrinsics, "cam_from_world": poses}),
        ("scene.json", record),
    ):
        (folder / name).write_text(json.dumps(data, indent=1) + "\n")
