"""Renders of the scene with Blender's Cycles."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np
import pycolmap
from mathutils import Matrix
from PIL import Image

from zoo.camera import View
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
    folder: Path,
    surface: Surface,
    bodies: list[Body],
    camera: pycolmap.Camera,
    views: list[View],
    seed: int = 0,
) -> None:
    """Render every view into `folder` as a JPEG."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_surface(surface, bodies)
    add_lights()
    configure(camera)
    taker = add_camera(camera)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        raw = Path(temporary) / "raw.png"
        for number, view in enumerate(views, start=1000 * seed):
            place(taker, view)
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
    """A plain material, or a blotchy one that gives blobs to match but few edges."""
    colour, roughness, metallic, contrast = MATERIALS[name]
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    if contrast:
        add_blotches(material.node_tree, shader, colour, contrast)
    elif roughness > 0.5:
        shader.inputs["Specular IOR Level"].default_value = 0.1
    return material


def add_blotches(
    tree: bpy.types.NodeTree, shader: bpy.types.Node, colour: tuple[float, ...], contrast: float
) -> None:
    """Modulate the base colour by smooth noise of several scales, from 0.5 m down to 5 cm."""
    shader.inputs["Specular IOR Level"].default_value = 0.1
    position = tree.nodes.new("ShaderNodeTexCoord")
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 5.0
    noise.inputs["Detail"].default_value = 4.0
    noise.inputs["Roughness"].default_value = 0.9
    tree.links.new(position.outputs["Object"], noise.inputs["Vector"])
    spread = tree.nodes.new("ShaderNodeMapRange")
    spread.inputs["From Min"].default_value, spread.inputs["From Max"].default_value = 0.25, 0.75
    spread.inputs["To Min"].default_value = 1.0 - contrast
    spread.inputs["To Max"].default_value = 1.0 + contrast
    tree.links.new(noise.outputs["Fac"], spread.inputs["Value"])
    mix = tree.nodes.new("ShaderNodeVectorMath")
    mix.operation = "SCALE"
    mix.inputs[0].default_value = colour
    tree.links.new(spread.outputs["Result"], mix.inputs["Scale"])
    tree.links.new(mix.outputs["Vector"], shader.inputs["Base Color"])


def add_lights() -> None:
    """Add a wide sun, a lamp that the glossy bodies mirror, and a sky brighter on one side."""
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 2.4, np.radians(25)
    add_object("sun", sun, (-0.8, -0.3, 1.0))
    lamp = bpy.data.lights.new("lamp", "AREA")
    lamp.energy, lamp.size = 400.0, 1.6
    add_object("lamp", lamp, (5.0, -5.0, 7.5))
    add_sky()


def add_object(name: str, data: bpy.types.Light, position: tuple[float, float, float]) -> None:
    """Put a light at `position`, shining towards the origin."""
    light = bpy.data.objects.new(name, data)
    light.matrix_world = axes_matrix(np.asarray(position, float), np.asarray(position, float))
    bpy.context.scene.collection.objects.link(light)


def axes_matrix(position: Array, back: Array) -> Matrix:
    """The pose at `position` whose local z axis is `back`."""
    z = back / np.linalg.norm(back)
    x = np.cross((0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.column_stack([x, np.cross(z, x), z, position])
    return Matrix(pose.tolist())


def add_sky() -> None:
    """Light the scene from all sides, most from above and from the left."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    direction = nodes.new("ShaderNodeTexCoord")
    dot = nodes.new("ShaderNodeVectorMath")
    dot.operation = "DOT_PRODUCT"
    dot.inputs[1].default_value = (-0.55, -0.25, 0.8)
    links.new(direction.outputs["Generated"], dot.inputs[0])
    ramp = nodes.new("ShaderNodeMapRange")
    ramp.inputs["From Min"].default_value = -1.0
    ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 0.08, 0.55
    links.new(dot.outputs["Value"], ramp.inputs["Value"])
    background = nodes["Background"]
    background.inputs["Color"].default_value = (0.80, 0.90, 1.0, 1.0)
    links.new(ramp.outputs["Result"], background.inputs["Strength"])


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


def place(camera: bpy.types.Object, view: View) -> None:
    """Move Blender's camera, which looks along -z with y up, to a true view."""
    pose = np.eye(4)
    pose[:3, :3] = view.cam_from_world[:, :3].T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = view.centre()
    camera.matrix_world = Matrix(pose.tolist())


def save_jpeg(raw: Path, path: Path, seed: int) -> None:
    """Add sensor noise of 0.8 gray levels to a render and write it as a JPEG."""
    with Image.open(raw) as image:
        pixels = np.asarray(image.convert("RGB"), np.float64)
    noise = np.random.default_rng(seed).normal(0.0, 0.8, pixels.shape)
    noisy = np.clip(np.rint(pixels + noise), 0, 255).astype(np.uint8)
    Image.fromarray(noisy).save(path, quality=92, optimize=True)
