"""What is up, by images and straight edges, in frames turned in every way."""

from types import SimpleNamespace

import numpy as np
import pytest
from curve_edges import edges_of, segment

from colmap_edges.core.similarity import to_z_up
from colmap_edges.core.upright import up_direction, upward
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import OptionError
from colmap_edges.export.upright import direction, nearest_axis


def looking(azimuth_deg, pitch_deg, roll_deg=0.0):
    """A view in a world with z up; positive pitches look down."""
    a, p, r = np.radians([azimuth_deg, pitch_deg, roll_deg])
    forward = np.array([np.cos(p) * np.cos(a), np.cos(p) * np.sin(a), -np.sin(p)])
    right = np.array([np.sin(a), -np.cos(a), 0])
    down = np.cross(forward, right)
    right, down = np.cos(r) * right + np.sin(r) * down, np.cos(r) * down - np.sin(r) * right
    return SimpleNamespace(rotation=np.array([right, down, forward]))


def turned(views, world):
    """The views in a frame that is the world turned by a (3, 3) rotation."""
    return [SimpleNamespace(rotation=view.rotation @ world.T) for view in views]


SETS = {
    "around": [looking(a, 30) for a in range(0, 360, 20)],
    "half around": [looking(a, 30) for a in range(0, 181, 20)],
    "a wall": [looking(90, 0), looking(85, 2), looking(95, -2)],
    "straight down": [looking(0, 90, r) for r in (0, 180, 0, 180, 90, 270)],
    "one picture on its side": [looking(a, 10, 90 * (a == 40)) for a in range(0, 360, 20)],
}
WORLDS = [to_z_up(np.array(up, float)) for up in ((0, -1, 0), (0.3, -0.8, 0.4), (0, 0, -1))]


def off_deg(found, wanted):
    return np.degrees(np.arccos(np.clip(found @ wanted, -1, 1)))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("world", WORLDS, ids=str)
def test_images_tell_what_is_up(name, world):
    found = up_direction(turned(SETS[name], world))
    assert off_deg(found, world @ [0, 0, 1]) < 12


def house(world, tilt=0.0):
    """Curves of a box under a slanted roof, in the frame of a turned world."""
    s = np.radians(35)
    ways = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (np.cos(s), 0, np.sin(s)), (-np.cos(s), 0, np.sin(s))]
    rng = np.random.default_rng(0)
    starts = rng.normal(0, 1, (30, 3))
    lines = [
        segment(start, start + np.array(ways[i % 5]) * (1 + i % 3), 20) @ world.T
        for i, start in enumerate(starts)
    ]
    return fit_curves(edges_of(lines, [False] * len(lines)))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("world", WORLDS, ids=str)
def test_straight_edges_make_it_precise(name, world):
    found = upward(turned(SETS[name], world), house(world))
    assert off_deg(found, world @ [0, 0, 1]) < 0.1


def test_a_nearly_upright_model_keeps_its_axis():
    for degrees, kept in ((4, True), (6, False)):
        t = np.radians(degrees)
        world = to_z_up(np.array([np.sin(t), 0, np.cos(t)])).T
        found = upward(turned(SETS["around"], world))
        assert (found.tolist() == [0, 0, 1]) == kept


def test_axes_have_names():
    assert nearest_axis(np.array([0.1, -0.9, 0.3])) == "-y"
    np.testing.assert_array_equal(direction("-x"), [-1, 0, 0])
    np.testing.assert_allclose(direction([0, 3, 4]), [0, 0.6, 0.8])
    for bad in ("w", "", None, [1, 2], [0, 0, 0], [np.nan, 1, 2], ["a", 1, 2]):
        with pytest.raises(OptionError, match="give three numbers or one of: x, y, z, -x, -y, -z"):
            direction(bad)
