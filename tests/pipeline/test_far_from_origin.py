"""Models far from the origin, as in coordinates of the Earth: meshes stay whole."""

import numpy as np
import pycolmap
import pytest

from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

trimesh = pytest.importorskip("trimesh", reason="meshes are read with trimesh")
pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

ECEF = (4_358_067.0, 506_612.0, 4_614_943.0)


@pytest.mark.parametrize("shift", [ECEF, (1e9, 1e9, 1e9)])
def test_meshes_of_all_formats_keep_their_triangles(small, tmp_path, shift):
    model = pycolmap.Reconstruction(str(small[1]))
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array(shift)))
    (tmp_path / "model").mkdir()
    model.write_binary(str(tmp_path / "model"))
    output = tmp_path / "out"
    paths = Paths(image_path=small[0], input_path=tmp_path / "model", output_path=output)
    options = PipelineOptions(num_threads=2, report=False)
    report = run("mesh", paths, options, exports=("obj", "glb"))
    assert "so far from the origin" in "".join(found["text"] for found in report["findings"])
    counts = next(stage["counts"] for stage in report["stages"] if stage["name"] == "mesh")
    for name in ("mesh.ply", "mesh.obj", "mesh.glb"):
        mesh = trimesh.load(output / name, force="mesh", process=False)
        assert len(mesh.faces) == counts["faces"] > 1000
        # Textures repeat vertices at the borders of their charts.
        assert len(np.unique(mesh.vertices, axis=0)) > 0.99 * counts["vertices"]
        a, b, c = (mesh.triangles[:, corner] for corner in range(3))
        assert (np.linalg.norm(np.cross(b - a, c - a), axis=1) == 0).mean() < 0.01
