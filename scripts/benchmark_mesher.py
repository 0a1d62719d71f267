#!/usr/bin/env python3
"""Mesh a synthetic scene of any size; print seconds per step and the peak memory."""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from colmap_edges.options import MeshingOptions
from colmap_edges.surfaces.mesher import mesh_points


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--num_points", type=int, default=1_000_000)
    parser.add_argument("--rays_per_point", type=int, default=5)
    parser.add_argument("--num_cameras", type=int, default=500)
    parser.add_argument("--num_threads", type=int, default=0, help="0 takes all cores")
    arguments = parser.parse_args()
    scene = make_terrain(arguments.num_points, arguments.rays_per_point, arguments.num_cameras)
    print_memory("scene made")
    begin, begin_cpu = time.perf_counter(), time.process_time()
    mesh = mesh_points(*scene, MeshingOptions(), num_threads=arguments.num_threads)
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - begin_cpu
    for name, value in mesh.stats.items():
        print(f"{name:28} {value:.6g}")
    print(f"{len(mesh.faces)} faces in {seconds:.1f} s, {cpu_seconds:.1f} CPU s")
    print_memory("meshed")


def make_terrain(
    num_points: int, rays_per_point: int, num_cameras: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Noisy points on hills a hundred units wide, seen by the cameras nearest above them."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 100, (2, num_points))
    hills = 3 * np.sin(0.3 * x) * np.cos(0.2 * y) + np.abs(np.sin(2 * x + y))
    points = np.column_stack([x, y, hills + rng.normal(0, 0.01, num_points)])
    side = int(np.ceil(np.sqrt(num_cameras)))
    steps = 100 * (np.arange(side) + 0.5) / side
    centers = np.stack([*np.meshgrid(steps, steps), np.full((side, side), 25.0)], -1).reshape(-1, 3)
    near = np.clip(np.floor(points[:, :2] / 100 * side).astype(int), 1, side - 2)
    around = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1)])
    seen = near[:, None] + around[:rays_per_point]
    cameras = (seen[..., 1] * side + seen[..., 0]).astype(np.int32)
    offsets = cameras.shape[1] * np.arange(num_points + 1, dtype=np.int64)
    return points, offsets, cameras.ravel(), centers


def print_memory(when: str) -> None:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{when}: peak memory {peak:.2f} GiB")


if __name__ == "__main__":
    main()
