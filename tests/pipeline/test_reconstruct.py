"""The pipeline as a function: of paths, of objects, and with wrong types."""

import numpy as np
import pycolmap
import pytest
from scenes import EDGES_ALONE

import colmap_edges
from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError


@pytest.mark.pipeline
def test_paths_and_objects_give_the_same_result(small):
    image_path, input_path = small
    by_paths = colmap_edges.reconstruct(str(input_path), str(image_path), EDGES_ALONE)
    given = pycolmap.Reconstruction(str(input_path))
    by_objects = colmap_edges.reconstruct(given, image_path, EDGES_ALONE)
    assert by_paths.edges.num_edges > 0
    np.testing.assert_array_equal(by_paths.edges.points, by_objects.edges.points)
    assert by_paths.reconstruction.num_points3D() == by_objects.reconstruction.num_points3D()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((42, "images"), "reconstruction is of type int; give pycolmap.Reconstruction or"),
        (("sparse", None), "image_path is of type NoneType; give str or os.PathLike"),
        (("sparse", "images", "high"), "options is of type str; give colmap_edges.PipelineOptions"),
        (("sparse", "images", None, 3), "cache_path is of type int; give str"),
        (("sparse", "images", None, None, [1]), "mask_path is of type list; give str"),
        (("no such folder", "images"), "no such folder"),
    ],
)
def test_wrong_types_are_one_line_errors(arguments, message):
    with pytest.raises(ColmapEdgesError, match=message) as caught:
        colmap_edges.reconstruct(*arguments)
    assert "\n" not in str(caught.value)


def test_models_are_made_of_reconstructions_only():
    with pytest.raises(ColmapEdgesError, match="reconstruction is of type dict"):
        model_from_reconstruction({})
    with pytest.raises(ColmapEdgesError, match="reconstruction is of type list"):
        colmap_edges.mesh([])
