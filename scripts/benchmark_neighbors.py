#!/usr/bin/env python3
"""Find the neighbours of many views without SfM points; print CPU seconds and peak memory."""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from synthetic_city import flight, without_points

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.edges3d.chains.view_selection import select_views
from colmap_edges.options import PipelineOptions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--num_views", type=int, default=10_000)
    num_views = parser.parse_args().num_views
    side = int(np.ceil(np.sqrt(num_views)))
    poses, _ = flight(num_views, side, np.random.default_rng(0))
    model = model_from_reconstruction(without_points(poses, (800, 600)))
    print(f"views made: peak memory {peak_mb():.0f} MB")
    begin = time.process_time()
    near = select_views(model, PipelineOptions().view_selection)
    seconds = time.process_time() - begin
    observing = np.mean([len(views) for views in near.observing_views])
    print(f"{seconds:.2f} CPU s for {num_views} views, {1e3 * seconds / num_views:.2f} ms each")
    print(f"{observing:.1f} observing views each, peak memory {peak_mb():.0f} MB")


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


if __name__ == "__main__":
    main()
