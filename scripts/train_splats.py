#!/usr/bin/env python3
"""Train Gaussian splats from the points of COLMAP models, and compare views that were held out.

Needs a separate environment: pip install torch pycolmap opencv-python-headless click

Each MODEL is a folder of the same registered images with other points, such as sparse/0 and
edges/sparse. All are trained alike, on a CPU, on images reduced to --width: colours without
spherical harmonics, L1 loss, Gaussians cloned or split where their places have large gradients,
as Kerbl et al. 2023. Every eighth image by name is held out. The last lines are the mean PSNR of
the held-out images for each model, at half of the steps and at the end.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np
import pycolmap
import torch
from torch import Tensor

NEAR = 1e-3  # of the scene's size: nothing nearer to a camera is drawn
MIN_ALPHA = 1 / 255
BLUR = 0.3  # variance in square pixels that pixels add, as in Kerbl et al.
RATES = {"means": 1.6e-4, "scales": 5e-3, "turns": 1e-3, "opacities": 5e-2, "colors": 1e-2}
GROW_EVERY = 100
GROW_GRADIENT = 2e-4  # of the loss by the place in the image, in halves of its width
HELD_OUT_EVERY = 8


@dataclass(frozen=True)
class Picture:
    """An image with its camera, (3, 3) rotation and (3,) translation from the world."""

    name: str
    colors: Tensor  # (H, W, 3) in 0..1
    rotation: Tensor
    translation: Tensor
    focal: Tensor  # (2,) pixels
    center: Tensor  # (2,) pixels


def read(model_path: Path, image_path: Path, width: int) -> tuple[list[Picture], np.ndarray]:
    """Undistorted pictures in the order of names, and the (N, 6) points with colours 0..1."""
    with tempfile.TemporaryDirectory() as folder:
        pycolmap.undistort_images(folder, model_path, image_path)
        model = pycolmap.Reconstruction(Path(folder) / "sparse")
        pictures = []
        for image in sorted(model.images.values(), key=lambda image: image.name):
            pixels = cv2.imread(str(Path(folder) / "images" / image.name))[:, :, ::-1]
            camera = image.camera
            scale = width / camera.width
            size = (width, round(camera.height * scale))
            small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA) / 255.0
            pose = image.cam_from_world()
            pictures.append(
                Picture(
                    image.name,
                    torch.tensor(small, dtype=torch.float32),
                    torch.tensor(pose.rotation.matrix(), dtype=torch.float32),
                    torch.tensor(pose.translation, dtype=torch.float32),
                    torch.tensor([camera.focal_length_x, camera.focal_length_y]).float() * scale,
                    torch.tensor([camera.principal_point_x, camera.principal_point_y]).float()
                    * scale,
                )
            )
    points = [np.r_[point.xyz, point.color / 255.0] for point in model.points3D.values()]
    return pictures, np.array(points)


def spacings(points: Tensor) -> Tensor:
    """(N,) distance to the third nearest point, (N, 3) float32 of points, a block at a time."""
    blocks = [
        torch.cdist(block, points).topk(min(4, len(points)), largest=False).values[:, -1]
        for block in points.split(1024)
    ]
    return torch.cat(blocks).clamp(min=1e-7)


def evened(points: np.ndarray, count: int) -> np.ndarray:
    """(count, 6): points drawn at random, or all and copies of some moved by their spacing."""
    rng = np.random.default_rng(0)
    chosen = points[rng.permutation(len(points))[:count]]
    copied = rng.integers(len(points), size=max(0, count - len(points)))
    copies = points[copied]
    around = spacings(torch.tensor(points[:, :3], dtype=torch.float32)).numpy()
    copies[:, :3] += around[copied, None] * rng.standard_normal((len(copies), 3))
    return np.concatenate((chosen, copies))


def start(points: np.ndarray) -> dict[str, Tensor]:
    """Gaussians at the points: as large as their spacing, a tenth opaque."""
    places = torch.tensor(points[:, :3], dtype=torch.float32)
    return {
        "means": places,
        "scales": spacings(places).log()[:, None].repeat(1, 3),
        "turns": torch.tensor([1.0, 0, 0, 0]).repeat(len(places), 1),
        "opacities": torch.full((len(places),), -2.2),
        "colors": torch.logit(torch.tensor(points[:, 3:]).float().clamp(0.02, 0.98)),
    }


def rotations(turns: Tensor) -> Tensor:
    """(N, 3, 3) of quaternions (N, 4), w first."""
    w, x, y, z = torch.nn.functional.normalize(turns, dim=1).T
    rows = (
        torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), 1),
        torch.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), 1),
        torch.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), 1),
    )
    return torch.stack(rows, 1)


def projected(splats: dict[str, Tensor], picture: Picture, near: float) -> tuple[Tensor, ...]:
    """Drawn Gaussians' indices, (K, 2) places, (K, 3) inverse covariances, depths, (K, 2) reach."""
    height, width = picture.colors.shape[:2]
    local = splats["means"] @ picture.rotation.T + picture.translation
    indices = (local[:, 2] > near).nonzero()[:, 0]
    local = local[indices]
    x, y, z = local.T
    places = torch.stack((x / z, y / z), 1) * picture.focal + picture.center
    zero = torch.zeros_like(z)
    limit = 1.3 * torch.tensor([width, height]) / picture.focal  # linear no farther out
    u, v = (x / z).clamp(-limit[0], limit[0]), (y / z).clamp(-limit[1], limit[1])
    jacobian = torch.stack((1 / z, zero, -u / z, zero, 1 / z, -v / z), 1).view(-1, 2, 3)
    jacobian = picture.focal[:, None] * jacobian
    axes = rotations(splats["turns"][indices]) * splats["scales"][indices].exp()[:, None, :]
    spread = jacobian @ picture.rotation @ axes
    cov = spread @ spread.transpose(1, 2)
    a, b, c = cov[:, 0, 0] + BLUR, cov[:, 0, 1], cov[:, 1, 1] + BLUR
    det = (a * c - b * b).clamp(min=1e-6)
    opacities = splats["opacities"][indices].sigmoid().detach()
    reach = 2 * (opacities / MIN_ALPHA).clamp(min=1).log()[:, None]
    radii = (reach * torch.stack((a, c), 1).detach()).sqrt()
    seen = ((places > -radii) & (places < torch.tensor([width, height]) + radii)).all(1)
    inverse = torch.stack((c / det, -b / det, a / det), 1)
    return indices[seen], places[seen], inverse[seen], z[seen], radii[seen]


def fragments(places: Tensor, radii: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Every pixel of the boxes around the places: (F,) which Gaussian, (F,) which pixel."""
    low = (places - radii - 0.5).ceil().long()
    high = (places + radii - 0.5).floor().long() + 1
    size = torch.tensor([width, height])
    low, high = (torch.minimum(v.clamp(min=0), size) for v in (low, high))
    high = torch.maximum(low, high)
    wide, tall = (high - low).T
    counts = wide * tall
    which = torch.repeat_interleave(torch.arange(len(places)), counts)
    first = torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    place = torch.arange(len(which)) - first
    x = low[which, 0] + place % wide[which]
    y = low[which, 1] + place // wide[which]
    return which, y * width + x


def draw(splats: dict[str, Tensor], picture: Picture, near: float) -> tuple[Tensor, Tensor, Tensor]:
    """The (H, W, 3) picture, and the drawn Gaussians' indices and places in the image."""
    height, width = picture.colors.shape[:2]
    indices, places, inverse, depths, radii = projected(splats, picture, near)
    if places.requires_grad:
        places.retain_grad()
    with torch.no_grad():
        which, pixels = fragments(places, radii, width, height)
        centers = torch.stack((pixels % width + 0.5, pixels // width + 0.5), 1)
        opacities = splats["opacities"][indices].sigmoid()
        alphas = opacities[which] * falloff(places, inverse, which, centers)
        kept = alphas >= MIN_ALPHA
        which, pixels, centers = which[kept], pixels[kept], centers[kept]
        ranks = torch.empty_like(indices)
        ranks[depths.argsort()] = torch.arange(len(indices))
        order = (pixels * len(indices) + ranks[which]).argsort()
        which, pixels, centers = which[order], pixels[order], centers[order]
        starts = torch.searchsorted(pixels, pixels)  # first fragment of each one's pixel
    opacities = splats["opacities"][indices].sigmoid()
    alphas = (opacities[which] * falloff(places, inverse, which, centers)).clamp(max=0.99)
    passed = torch.log1p(-alphas.double()).cumsum(0)
    before = torch.cat((passed.new_zeros(1), passed))[:-1]
    weights = (before - before[starts]).exp().float() * alphas
    colors = splats["colors"][indices].sigmoid()[which] * weights[:, None]
    flat = torch.zeros(height * width, 3).index_add(0, pixels, colors)
    return flat.view(height, width, 3), indices, places


def falloff(places: Tensor, inverse: Tensor, which: Tensor, centers: Tensor) -> Tensor:
    """(F,) of the Gaussians at the centers of pixels."""
    dx, dy = (centers - places[which]).T
    a, b, c = inverse[which].T
    return torch.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)


def grow(
    splats: dict[str, Tensor], gradients: Tensor, size: float, max_splats: int
) -> dict[str, Tensor]:
    """Drop what is transparent; clone small Gaussians with large gradients, split large ones."""
    with torch.no_grad():
        alive = splats["opacities"].sigmoid() > 0.005
        room = max(0, max_splats - int(alive.sum()))
        wanting = (alive & (gradients > GROW_GRADIENT)).nonzero()[:, 0]
        wanting = wanting[gradients[wanting].argsort(descending=True)[:room]]
        big = splats["scales"][wanting].exp().amax(1) > 0.01 * size
        added = {name: values[wanting].clone() for name, values in splats.items()}
        axes = rotations(added["turns"]) * added["scales"].exp()[:, None, :]
        offsets = (axes @ torch.randn(len(wanting), 3, 1))[:, :, 0]
        added["means"] = added["means"] + offsets * big[:, None]
        added["scales"] = added["scales"] - np.log(1.6) * big[:, None]
        splats["scales"][wanting[big]] -= np.log(1.6)
        return {name: torch.cat((values[alive], added[name])) for name, values in splats.items()}


def optimizer(splats: dict[str, Tensor], size: float) -> torch.optim.Adam:
    """Adam over all parameters; rates of places are relative to the scene's size."""
    for values in splats.values():
        values.requires_grad_(True)
    return torch.optim.Adam(
        [
            {"params": [values], "lr": RATES[name] * (size if name == "means" else 1)}
            for name, values in splats.items()
        ],
        eps=1e-15,
    )


def psnr(splats: dict[str, Tensor], pictures: list[Picture], near: float) -> float:
    """Mean over pictures, dB."""
    with torch.no_grad():
        errors = [(draw(splats, p, near)[0] - p.colors).square().mean() for p in pictures]
    return float(np.mean([-10 * torch.log10(error) for error in errors]))


def train(
    model_path: Path,
    image_path: Path,
    width: int,
    steps: int,
    num_points: int,
    max_splats: int,
) -> tuple[int, int, float, float]:
    """Numbers of points and of Gaussians at the end, PSNR at half of the steps and at the end."""
    torch.manual_seed(0)
    pictures, points = read(model_path, image_path, width)
    held_out, kept = pictures[::HELD_OUT_EVERY], pictures.copy()
    for picture in held_out:
        kept.remove(picture)
    centers = torch.stack([-p.rotation.T @ p.translation for p in pictures])
    size = 1.1 * float((centers - centers.mean(0)).norm(dim=1).max())
    splats = start(evened(points, num_points) if num_points else points)
    adam = optimizer(splats, size)
    sums, counts = torch.zeros(len(splats["means"])), torch.zeros(len(splats["means"]))
    half = 0.0
    for step in range(1, steps + 1):
        picture = kept[int(torch.randint(len(kept), ()))]
        drawn, indices, places = draw(splats, picture, NEAR * size)
        (drawn - picture.colors).abs().mean().backward()
        with torch.no_grad():
            sums[indices] += places.grad.norm(dim=1) * width / 2
            counts[indices] += 1
        adam.step()
        adam.zero_grad()
        if step % GROW_EVERY == 0 and step <= steps * 3 // 4:
            splats = {name: values.detach() for name, values in splats.items()}
            splats = grow(splats, sums / counts.clamp(min=1), size, max_splats)
            adam = optimizer(splats, size)
            sums, counts = torch.zeros(len(splats["means"])), torch.zeros(len(splats["means"]))
        if step == steps // 2:
            half = psnr(splats, held_out, NEAR * size)
    return len(points), len(splats["means"]), half, psnr(splats, held_out, NEAR * size)


@click.command(help=__doc__)
@click.argument("models", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--image_path", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--width", default=128, help="Of the reduced images, in pixels.")
@click.option("--steps", default=600, help="Images shown in training, one at a step.")
@click.option("--num_points", default=0, help="Start all with this number; 0: with all they have.")
@click.option("--max_splats", default=40000, help="No more Gaussians than this are grown.")
@click.option("--num_threads", default=1)
def main(
    models: tuple[Path, ...],
    image_path: Path,
    width: int,
    steps: int,
    num_points: int,
    max_splats: int,
    num_threads: int,
) -> None:
    torch.set_num_threads(num_threads)
    for model in models:
        began = time.process_time()
        points, splats, half, end = train(model, image_path, width, steps, num_points, max_splats)
        click.echo(
            f"{model}: {points:,} points, {splats:,} Gaussians, PSNR {half:.2f} dB at half, "
            f"{end:.2f} dB at the end, {time.process_time() - began:.0f} CPU s"
        )


if __name__ == "__main__":
    main()
