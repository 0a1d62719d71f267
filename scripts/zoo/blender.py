"""Renders of the scene with Blender's Cycles."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pycolmap
from mathutils import Matrix
from PIL import Image

from zoo.camera import Rig
from zoo.geometry import CREASE_DEG, Array, Body, Surface

# Base colour, roughness, metallic, and contrast of the blotches (0: textureless).
MATERIALS = {
    "stone": ((0.28, 0.265, 0.235), 0.9, 0.0, 0.29),
    "stucco": ((0.50, 0.41, 0.30), 0.9, 0.0, 0.30),
    "tiles": ((0.42, 0.17, 0.11), 0.9, 0.0, 0.34),
    "sandstone": ((0.60, 0.46, 0.28), 0.9, 0.0, 0.30),
    "plaster": ((0.64, 0.63, 0.60), 0.9, 0.0, 0.0),
    "paint_dark": ((0.08, 0.12, 0.20), 0.8, 0.0, 0.0),
    "paint_light": ((0.66, 0.60, 0.40), 0.8, 0.0, 0.0),
    "ochre": ((0.65, 0.38, 0.10), 0.8, 0.0, 0.0),
    "matte_white": ((0.66, 0.66, 0.66), 0.9, 0.0, 0.0),
    "matte_blue": ((0.12, 0.25, 0.50), 0.9, 0.0, 0.0),
    "matte_green": ((0.18, 0.42, 0.24), 0.9, 0.0, 0.0),
    "matte_grey": ((0.55, 0.55, 0.57), 0.9, 0.0, 0.0),
    "glossy_red": ((0.50, 0.04, 0.04), 0.12, 0.0, 0.0),
    "glossy_black": ((0.35, 0.36, 0.38), 0.18, 1.0, 0.0),
}


def render_views(
    folder: Path, surface: Surface, bodies: list[Body], rig: Rig, seed: int = 0
) -> None:
    """Render every view into `folder` as a JPEG."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_surface(surface, bodies)
    add_lights()
    configure(rig.camera)
    taker = add_camera(rig.camera)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        raw = Path(temporary) / "raw.png"
        for number, view in enumerate(rig.views, start=1000 * seed):
            # Blender's camera looks along -z with y up.
            axes = view.cam_from_world[:, :3].T @ np.diag([1.0, -1.0, -1.0])
            taker.matrix_world = pose_of(axes, view.centre())
            bpy.context.scene.cycles.seed = number
            bpy.context.scene.render.filepath = str(raw)
            bpy.ops.render.render(write_still=True)
            save_jpeg(raw, folder / view.name, number)


def add_surface(surface: Surface, bodies: list[Body]) -> None:
    """Add the triangles, smooth but for the creases, each with its material."""
    mesh = bpy.data.meshes.new("scene")
    mesh.from_pydata(surface.vertices.tolist(), [], surface.faces.tolist())
    names = sorted({body.material for body in bodies})
    for name in names:
        mesh.materials.append(make_material(name))
    slot = np.array([names.index(body.material) for body in bodies], np.int32)
    mesh.polygons.foreach_set("material_index", slot[surface.face_body])
    mesh.polygons.foreach_set("use_smooth", np.ones(len(surface.faces), bool))
    mesh.set_sharp_from_angle(angle=np.radians(CREASE_DEG))
    mesh.update()
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("scene", mesh))


def make_material(name: str) -> bpy.types.Material:
    """A plain material, or a blotchy one that gives blobs to match but few edges.

    Blotches are smooth noise of several scales, from 0.5 m down to 5 cm.
    """
    colour, roughness, metallic, contrast = MATERIALS[name]
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    looks = {"Base Color": (*colour, 1.0), "Roughness": roughness, "Metallic": metallic}
    if contrast or roughness > 0.5:
        looks["Specular IOR Level"] = 0.1
    if contrast:
        at = tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]
        scales = {"Scale": 5.0, "Detail": 4.0, "Roughness": 0.9}
        noise = add_node(tree, "ShaderNodeTexNoise", {"Vector": at, **scales})
        span = {"From Min": 0.25, "From Max": 0.75, "To Min": 1 - contrast, "To Max": 1 + contrast}
        spread = add_node(tree, "ShaderNodeMapRange", {"Value": noise.outputs["Fac"], **span})
        factors = {0: colour, "Scale": spread.outputs["Result"]}
        mix = add_node(tree, "ShaderNodeVectorMath", factors, "SCALE")
        looks["Base Color"] = mix.outputs["Vector"]
    feed(tree, tree.nodes["Principled BSDF"], looks)
    return material


def add_node(
    tree: bpy.types.NodeTree, kind: str, inputs: dict[str | int, Any], operation: str = ""
) -> bpy.types.Node:
    """A new node with its inputs."""
    node = tree.nodes.new(kind)
    if operation:
        node.operation = operation
    feed(tree, node, inputs)
    return node


def feed(tree: bpy.types.NodeTree, node: bpy.types.Node, inputs: dict[str | int, Any]) -> None:
    """Set inputs of a node to values, or to outputs of other nodes."""
    for name, value in inputs.items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[name])
        else:
            node.inputs[name].default_value = value


def add_lights() -> None:
    """Add a wide sun, a lamp that the glossy bodies mirror, and a sky brighter on one side."""
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 2.4, np.radians(25)
    lamp = bpy.data.lights.new("lamp", "AREA")
    lamp.energy, lamp.size = 400.0, 1.6
    for data, position in ((sun, (-0.8, -0.3, 1.0)), (lamp, (5.0, -5.0, 7.5))):
        light = bpy.data.objects.new(data.name, data)
        z = np.array(position) / np.linalg.norm(position)  # they shine towards the origin
        x = np.cross((0.0, 0.0, 1.0), z)
        x /= np.linalg.norm(x)
        light.matrix_world = pose_of(np.column_stack([x, np.cross(z, x), z]), position)
        bpy.context.scene.collection.objects.link(light)
    add_sky()


def add_sky() -> None:
    """Light the scene from all sides, most from above and from the left."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    ways = {0: tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], 1: (-0.55, -0.25, 0.8)}
    dot = add_node(tree, "ShaderNodeVectorMath", ways, "DOT_PRODUCT")
    span = {"From Min": -1.0, "To Min": 0.08, "To Max": 0.55}
    ramp = add_node(tree, "ShaderNodeMapRange", {"Value": dot.outputs["Value"], **span})
    light = {"Color": (0.80, 0.90, 1.0, 1.0), "Strength": ramp.outputs["Result"]}
    feed(tree, tree.nodes["Background"], light)


def pose_of(rotation: Array, position: Any) -> Matrix:
    """The pose with axes (3, 3), as columns, and position (3,)."""
    return Matrix([*np.column_stack([rotation, position]).tolist(), [0, 0, 0, 1]])


def configure(camera: pycolmap.Camera) -> None:
    """Set Cycles on the CPU with denoising, and a plain sRGB output."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 16
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    scene.cycles.max_bounces = 4
    scene.render.resolution_x, scene.render.resolution_y = camera.width, camera.height
    scene.render.use_persistent_data = True
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"


def add_camera(true: pycolmap.Camera) -> bpy.types.Object:
    """Add the camera with the true focal length and a centred principal point."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = true.focal_length_x * data.sensor_width / true.width
    camera = bpy.data.objects.new("camera", data)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    return camera


def save_jpeg(raw: Path, path: Path, seed: int) -> None:
    """Add sensor noise of 0.8 gray levels to a render and write it as a JPEG."""
    with Image.open(raw) as image:
        pixels = np.asarray(image.convert("RGB"), np.float64)
    noise = np.random.default_rng(seed).normal(0.0, 0.8, pixels.shape)
    noisy = np.clip(np.rint(pixels + noise), 0, 255).astype(np.uint8)
    Image.fromarray(noisy).save(path, quality=92, optimize=True)
