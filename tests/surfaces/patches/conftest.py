import pytest
import textured_plane

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.surfaces.patches.finding import find_patches


@pytest.fixture(scope="session")
def scene():
    return textured_plane.make()


@pytest.fixture(scope="session")
def patches(scene):
    return find_patches(scene[0], Edges3D.none(), scene[1], 0, 2)


@pytest.fixture(scope="session")
def depths(patches):
    return patches.depths
