"""The stages from images to edges, curves, background and faces, for folders and for Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from colmap_edges.colmap.lenses import has_one_coefficient
from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Picture
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.edges2d.image_graphs import Visitors
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.images.background import BackgroundRays, Backgrounds
from colmap_edges.images.taking import ImageTaker
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import Detection, detect_stage
from colmap_edges.pipeline.mesh import (
    background_stage,
    face_stage,
    round_stage,
    sky_stage,
)
from colmap_edges.pipeline.patches import patch_stage
from colmap_edges.pipeline.paths import Paths, image_folder
from colmap_edges.pipeline.trace import trace_stage
from colmap_edges.poses.distortion import refine_distortion
from colmap_edges.report.contents import ImagePicture
from colmap_edges.report.pictures import PictureVisitor
from colmap_edges.report.rerun_viewer import NO_VIEWER, Viewer
from colmap_edges.runtime.executors import Workers, thread_count
from colmap_edges.runtime.stages import Stages, plain_counts
from colmap_edges.surfaces.faces.finding import NO_FACES, Faces
from colmap_edges.surfaces.faces.grids import make_grid
from colmap_edges.surfaces.outlines2d import find_outlines
from colmap_edges.surfaces.patches.finding import NO_PATCHES, Patches, picture_columns
from colmap_edges.surfaces.sky.regions import small_picture


@dataclass(frozen=True)
class Found:
    """Everything that a run reconstructs before it writes and meshes.

    Attributes:
        model: the model at the working scale, with refined lenses and poses if they were wanted.
        traced: the 3D edges and the view-dependent contours.
        curves: the curves that fit the edges.
        background: rays to the background or the sky; None without one.
        faces: planar faces between the edges, and round faces.
        patches: points where images have texture.
        pictures: reduced pictures of the images, if they were wanted.
    """

    model: Model
    traced: TracedEdges
    curves: Curves3D
    background: BackgroundRays | None
    faces: Faces
    patches: Patches
    pictures: Sequence[ImagePicture]


def find_edges(
    model: Model,
    paths: Paths,
    settings: PipelineOptions,
    stages: Stages,
    workers: Workers,
    *,
    for_mesh: bool,
    with_pictures: bool = False,
    viewer: Viewer = NO_VIEWER,
) -> Found:
    """Run the stages from the images of a model to its edges.

    Args:
        model: the model at the working scale.
        paths: where its images are, and masks and edge images, if there are any.
        settings: the options, as `resolved` for the model's scale.
        stages: the stages of the run.
        workers: executor of the work on images and views.
        for_mesh: whether to find what the mesh needs: the background or, unless `use_sky` is 0, the
            sky; faces and patches, unless `use_faces` and `use_patches` are 0.
        with_pictures: whether to take reduced pictures of the images.
        viewer: viewer that shows intermediate results.
    """
    given, model = model, lens_stage(model, settings, stages)
    taker = PictureVisitor(len(model.views)) if with_pictures else None
    grids = ImageTaker(make_grid) if for_mesh and settings.use_faces else None
    finds_patches = (for_mesh and settings.use_patches) or settings.write_patches
    finely = partial(make_grid, num_columns=picture_columns(model))
    textures = ImageTaker(finely) if finds_patches else None
    finds_open = for_mesh and settings.meshing.background_weight > 0
    small = ImageTaker(small_picture) if finds_open and settings.use_sky else None
    images, masks, maps = image_folder(paths), paths.mask_path, paths.edge_path
    visitor = Visitors.of(taker, grids, textures, small)
    detection = detect_stage(model, images, settings, stages, visitor, workers, masks, maps)
    pictures = taker.pictures() if taker else ()
    for picture in pictures:
        viewer.show_picture(model.views[picture.view], picture)
    model, traced = trace_stage(model, detection, settings, stages, workers)
    threads = thread_count(settings)
    outlines = (
        find_outlines(model.views, detection.graphs, traced.edges, threads) if grids else None
    )
    detection.graphs.release()
    if model is not given:
        viewer.show_model(model)
    viewer.show_edges(traced.edges)
    curves = curve_stage(traced.edges, settings, stages)
    found = (model, traced.edges, detection, small, settings, stages)
    background, hidden = background_or_sky(*found) if finds_open else (None, Backgrounds())
    faces, patches = NO_FACES, NO_PATCHES
    if grids and outlines:
        round_faces = round_stage(model, traced.edges, curves, outlines, settings, stages)
        faces = face_stage(model, traced.edges, grids.taken, settings, stages, hidden, round_faces)
        viewer.show_faces(faces.faces)
    if textures:
        patches = patch_stage(model, traced, textures.taken, settings, stages, hidden)
    return Found(model, traced, curves, background, faces, patches, pictures)


def lens_stage(model: Model, settings: PipelineOptions, stages: Stages) -> Model:
    """Refine the distortion of lenses and with it the poses, if held-out SfM points fit better."""
    if not settings.refine_poses or not any(map(has_one_coefficient, model.views)):
        return model
    with stages.stage("lenses") as stage:
        refined, counts = refine_distortion(model, settings.bundle_adjustment, settings.random_seed)
        stage.counts = plain_counts(counts)
    return refined


def background_or_sky(
    model: Model,
    edges: Edges3D,
    detection: Detection,
    small: ImageTaker[Picture] | None,
    settings: PipelineOptions,
    stages: Stages,
) -> tuple[BackgroundRays | None, Backgrounds]:
    """Find the background or, without one, the sky in small pictures; and where views show it."""
    if background := background_stage(model, detection, edges, settings, stages):
        return background, Backgrounds(detection.background_masks)
    return sky_stage(model, edges, small.taken, stages) if small else (None, Backgrounds())


def curve_stage(edges: Edges3D, settings: PipelineOptions, stages: Stages) -> Curves3D:
    """Fit lines, arcs, circles, ellipses and splines to the edges."""
    with stages.stage("curves") as stage:
        regularize, threads = settings.curves.regularize, thread_count(settings)
        curves = fit_curves(edges, regularize=regularize, num_threads=threads)
        stage.counts = {"curves": curves.num_curves}
    return curves
