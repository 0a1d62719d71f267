from itertools import pairwise, product

import numpy as np
import pytest

from colmap_edges.edges2d.detection import detect_chains, detect_pixel_chains, gray_table, light_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import DetectionOptions

SIZE = 64


def image_of(share, dark=40, bright=210, gamma=2.2):
    """(H, W) uint8 grays of pixels of which (H, W) shares are bright: sums of light, encoded."""
    light = (1 - share) * (dark / 255) ** gamma + share * (bright / 255) ** gamma
    return np.rint(255 * light ** (1 / gamma)).astype(np.uint8)


def step_image(angle_deg, offset, size=SIZE, supersampling=32, gamma=2.2):
    """Anti-aliased step: bright where n . (x - centre) > offset, in COLMAP's pixels."""
    normal = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    fine = (np.arange(size * supersampling) + 0.5) / supersampling - size / 2
    bright = fine[None, :] * normal[0] + fine[:, None] * normal[1] > offset
    blocks = bright.reshape(size, supersampling, size, supersampling).mean(axis=(1, 3))
    return image_of(blocks, gamma=gamma), normal


@pytest.mark.parametrize("angle_deg", [0, 17, 43, 90, 133, 251])
@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.25])
def test_step_edge_is_found_to_a_few_hundredths_of_a_pixel(angle_deg, offset):
    image, normal = step_image(angle_deg, offset)
    chains = detect_chains(image, DetectionOptions())
    centred = chains.points - SIZE / 2
    inside = (np.abs(centred) < SIZE / 2 - 6).all(axis=1)
    assert inside.sum() > 40
    error = centred[inside] @ normal - offset
    assert np.abs(error).max() < 0.08
    assert np.sqrt(np.mean(error**2)) < 0.03
    np.testing.assert_allclose(chains.normals[inside] @ normal, 1, atol=0.01)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("turned_deg", [0, 180])
def test_edges_are_where_light_changes_whatever_the_tone_curve(gamma, turned_deg):
    errors = {}
    for assumed in (1.0, 2.2):
        signed = []
        for angle, offset in product((3, 24, 67, 84), (-0.4, -0.15, 0.1, 0.35)):
            image, normal = step_image(angle + turned_deg, offset, gamma=gamma)
            points = detect_chains(image, DetectionOptions(gamma=assumed)).points - SIZE / 2
            inside = (np.abs(points) < SIZE / 2 - 6).all(axis=1)
            signed.append(points[inside] @ normal - offset)
        errors[assumed] = np.mean(np.concatenate(signed))
    wrong = errors[3.2 - gamma]
    assert abs(errors[gamma]) < 0.01
    assert 0.08 < (wrong if gamma == 1 else -wrong) < 0.25  # grays put an edge on the dark side


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2])
def test_grays_come_back_from_light(gamma):
    gray = np.arange(2, 256, dtype=np.uint8)
    light = light_of(gray[None], gamma)
    assert light.min() > 0
    assert light.max() == 1
    points = np.column_stack([np.arange(len(gray)), np.zeros(len(gray))])
    across = np.tile([0.0, 1.0], (len(gray), 1))  # the only row goes on beyond the border
    found = _kernels.sample_sides(light, points, across, 3.0, gray_table(gamma))
    np.testing.assert_array_equal(found, np.column_stack([gray, gray]))


def test_gray_beside_an_edge_is_that_of_the_image_there():
    rng = np.random.default_rng(0)
    light = rng.random((20, 30)).astype(np.float32)
    points = rng.uniform(4, 15, (50, 2))
    angles = rng.uniform(0, 2 * np.pi, 50)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    table = np.arange(256).astype(np.uint8)
    found = _kernels.sample_sides(light, points, normals, 2.5, table)
    for side, away in enumerate((-2.5, 2.5)):
        expected = np.round(255 * bilinear(light, *(points + away * normals).T))
        np.testing.assert_allclose(found[:, side], expected, atol=1)
    assert _kernels.sample_sides(light, points[:0], normals[:0], 2.5, table).shape == (0, 2)
    with pytest.raises(ValueError, match="differ in number"):
        _kernels.sample_sides(light, points, normals[1:], 2.5, table)
    with pytest.raises(ValueError, match="table"):
        _kernels.sample_sides(light, points, normals, 2.5, table[:0])
    with pytest.raises(ValueError, match="image"):
        _kernels.sample_sides(light[:0], points, normals, 2.5, table)


@pytest.mark.parametrize("column", [20, 33])
def test_edge_between_columns_is_at_their_border(column):
    image = np.full((40, 60), 50, np.uint8)
    image[:, column:] = 200
    chains = detect_chains(image, DetectionOptions())
    middle = (chains.points[:, 1] > 5) & (chains.points[:, 1] < 35)
    np.testing.assert_allclose(chains.points[middle, 0], column, atol=1e-5)
    np.testing.assert_allclose(chains.points[middle, 1] % 1, 0.5, atol=1e-5)
    np.testing.assert_allclose(chains.normals[middle], [[1, 0]] * middle.sum(), atol=1e-5)


def disc_image(radius=20.0):
    fine = (np.arange(4 * SIZE) + 0.5) / 4 - SIZE / 2
    dark = np.hypot(fine[None, :], fine[:, None]) < radius
    blocks = dark.reshape(SIZE, 4, SIZE, 4).mean(axis=(1, 3))
    return image_of(1 - blocks, 50, 220)


def test_chains_are_connected_pixels_of_the_least_length():
    pixels, offsets = detect_pixel_chains(disc_image(), 12)
    assert offsets[0] == 0
    assert offsets[-1] == len(pixels) > 100
    for first, last in pairwise(offsets):
        assert last - first >= 12
        assert np.abs(np.diff(pixels[first:last], axis=0)).max() == 1
    assert len(detect_pixel_chains(disc_image(), 1000)[1]) == 1


def test_disc_has_its_radius_and_normals_point_to_the_bright_side():
    chains = detect_chains(disc_image(), DetectionOptions())
    centred = chains.points - SIZE / 2
    radii = np.linalg.norm(centred, axis=1)
    assert abs(radii.mean() - 20) < 0.05
    assert np.abs(radii - 20).max() < 0.25
    outward = np.einsum("ij,ij->i", chains.normals, centred / radii[:, None])
    assert outward.min() > 0.98


def test_image_without_edges_has_no_chains():
    chains = detect_chains(np.full((30, 40), 128, np.uint8), DetectionOptions())
    assert chains.points.shape == chains.normals.shape == (0, 2)
    assert chains.offsets.tolist() == [0]


def bilinear(image, x, y):
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    x0, y0 = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    fx, fy = x - x0, y - y0
    top = image[y0, x0] * (1 - fx) + image[y0, x0 + 1] * fx
    bottom = image[y0 + 1, x0] * (1 - fx) + image[y0 + 1, x0 + 1] * fx
    return top * (1 - fy) + bottom * fy


def refine_reference(image, pixels):
    padded = np.pad(image.astype(float), 1, mode="edge")
    column, row = pixels.astype(int).T + 1
    window = np.array(
        [[padded[row + dy, column + dx] for dx in (-1, 0, 1)] for dy in (-1, 0, 1)]
    )  # of each pixel
    smooth = np.array([1, 2, 1])
    gradient_x = np.einsum("y,yn->n", smooth, window[:, 2] - window[:, 0])
    gradient_y = np.einsum("x,xn->n", smooth, window[2] - window[0])
    normal = np.column_stack([gradient_x, gradient_y])
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    def change(step):
        ahead, behind = (pixels + (step + side) * normal for side in (1, -1))
        return bilinear(image, *ahead.T) - bilinear(image, *behind.T)

    before, here, after = (change(step) for step in (-1, 0, 1))
    curvature = before - 2 * here + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curvature < 0, np.clip((before - after) / (2 * curvature), -1, 1), 0)
    return pixels + shift[:, None] * normal, normal


@pytest.mark.parametrize("seed", range(5))
def test_refinement_equals_the_reference_on_random_images(seed):
    rng = np.random.default_rng(seed)
    image = rng.random((23, 31)).astype(np.float32)
    corners = np.array([[0.0, 0], [30, 22], [0, 22], [30, 0]])
    pixels = np.concatenate([rng.integers(0, (31, 23), (600, 2)), corners])
    points, normals = _kernels.refine_subpixel(image, pixels)
    expected, expected_normals = refine_reference(image, pixels)
    np.testing.assert_allclose(normals, expected_normals, atol=1e-6)
    np.testing.assert_allclose(points, expected, atol=1e-5)
    assert np.linalg.norm(points - pixels, axis=1).max() <= 1 + 1e-12


def test_refinement_leaves_flat_places_and_refuses_no_image():
    flat = np.zeros((5, 6), np.float32)
    points, normals = _kernels.refine_subpixel(flat, np.array([[2.0, 3.0]]))
    np.testing.assert_array_equal(points, [[2, 3]])
    np.testing.assert_array_equal(normals, [[0, 0]])
    with pytest.raises(ValueError, match="empty"):
        _kernels.refine_subpixel(flat[:0], np.array([[2.0, 3.0]]))
