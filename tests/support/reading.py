"""What reads each kind of input, as the program does."""

from __future__ import annotations

import warnings
from pathlib import Path

import click
import numpy as np
import valid

from colmap_edges.cli import info
from colmap_edges.cli import main as cli
from colmap_edges.cli.flags import options_from_flags
from colmap_edges.colmap.model import load_model
from colmap_edges.colmap.writing import write_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu, neus, strecha
from colmap_edges.evaluation.metrics import depth, raycasting
from colmap_edges.evaluation.readers import curves
from colmap_edges.export import peers
from colmap_edges.export.edges_json import load_edges
from colmap_edges.images.files import read_image
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.stages import Stages

CLEAR_ERRORS = (ColmapEdgesError, click.UsageError)
warnings.simplefilter("ignore")
context = {}


def warm_up(kind: str, source: Path) -> None:
    """Read the valid input once: libraries are loaded, and a reader that always fails shows."""
    context["model"] = valid.view_model()
    READERS[kind](source)


def read_model(folder: Path) -> None:
    """Read a model and write it again with no edge added."""
    model = load_model(folder)
    info.describe_model(model)
    written = folder.with_name(folder.name + "-written")  # apart from what is damaged
    try:
        write_model(model, Edges3D.none(), written)
        load_model(written)
    finally:
        valid.remove(written)


def read_pictures(folder: Path) -> None:
    """Read each picture as that of a view of the right size and find its edges."""
    model = context["model"]
    detect_stage(model, folder, PipelineOptions(num_threads=1), Stages())


def read_any_pictures(folder: Path) -> None:
    """Read pictures of many formats."""
    for path in sorted(folder.iterdir()):
        read_image(valid.view_named(path.name), folder)


def read_config(folder: Path) -> None:
    """Parse a command line with a configuration file."""
    args = ["--image_path", "a", "--input_path", "b", "--output_path", "c"]
    command = cli.cli.commands["mesh"]
    made = command.make_context("mesh", [*args, "--config", str(folder / "config.toml")])
    options_from_flags(made.params)


def read_curves(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        found = curves.read_curves(path)
        if len(found.points):
            with np.errstate(all="ignore"):
                curves.Curves.lengths(found)


def read_meshes(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        mesh = raycasting.load_mesh(path)
        caster = raycasting.RayCaster(mesh.vertices, mesh.faces)
        caster.cast(np.zeros(3), np.eye(3))


def read_dtu(folder: Path) -> None:
    dtu.load_reference(folder, 6)
    dtu.posed_images(folder, 6)


def read_repackaged_dtu(folder: Path) -> None:
    neus.posed_images(folder)


def read_strecha(folder: Path) -> None:
    strecha.posed_images(folder)


def read_depths(folder: Path) -> None:
    depth.load_reference_depths(folder, context["model"])


def read_peer(name: str):
    def read(folder: Path) -> None:
        peers.load(folder / name if name else folder, context["model"])

    return read


def read_output(folder: Path) -> None:
    info.describe(folder)
    load_edges(folder, context["model"])


def run_all(folder: Path) -> None:
    """Mesh a model with edges, from damaged models and images."""
    paths = Paths(
        image_path=folder / "images",
        input_path=folder / "sparse",
        output_path=folder.with_name(folder.name + "-out"),
    )
    try:
        run("mesh", paths, PipelineOptions(num_threads=1), overwrite=True)
    finally:
        valid.remove(paths.output_path)


READERS = {
    "model-bin": read_model,
    "model-bin-3.11": read_model,
    "model-bin-rigs": read_model,
    "model-txt": read_model,
    "model-txt-rigs": read_model,
    "pictures": read_pictures,
    "picture-formats": read_any_pictures,
    "config": read_config,
    "curves": read_curves,
    "meshes": read_meshes,
    "dtu": read_dtu,
    "dtu-repackaged": read_repackaged_dtu,
    "strecha": read_strecha,
    "depths": read_depths,
    "line3dpp": read_peer("lines.txt"),
    "limap1": read_peer("alltracks.txt"),
    "limap1-tracks": read_peer(""),
    "limap2": read_peer(""),
    "openmvg": read_peer("sfm.json"),
    "output": read_output,
    "run": run_all,
}
