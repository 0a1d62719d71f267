"""Worlds of any size and place, and exports to odd places: a result or one line, and nothing lost.

The long version tries more of each and prints how many runs were refused.
"""

import os
import time

import numpy as np
import pycolmap
import pytest
from forked import call_forked

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

LIMIT_S = 30
SUFFIXES = ("step", "dxf", "glb", "obj", "ply")


def tried(words, **how):
    """Run the command, check that it ends soon and clearly; whether it was refused."""
    started = time.monotonic()
    done = call_forked(words, **how)
    assert time.monotonic() - started < LIMIT_S
    assert done.returncode in (0, 1), (words, done.stderr)
    assert "Traceback" not in done.stderr, (words, done.stderr)
    assert done.stderr.count("Error: ") == done.returncode, (words, done.stderr)
    return done.returncode == 1


def test_worlds_of_any_size_and_place(small, tmp_path, soak, show):
    """Points alone are moved, too: poses then do not see them."""
    scales = [10.0**power for power in range(-320, 301, 20)] if soak else [1e-310, 1e6]
    refused = 0
    for number, scale in enumerate(np.repeat(scales, 2)):
        model = pycolmap.Reconstruction(str(small[1]))
        if number % 2 and 1e-100 < scale < 1e100:
            model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.full(3, scale)))
        else:
            for point in model.points3D.values():
                point.xyz = point.xyz * scale
        folder = tmp_path / str(number)
        folder.mkdir()
        model.write_binary(str(folder))
        words = ["mesh", "--image_path", small[0], "--input_path", folder, "--report", "0"]
        refused += tried([*words, "--output_path", tmp_path / f"out{number}"])
    show(f"worlds of odd sizes and places: {2 * len(scales)} runs, {refused} refused")


def test_exports_to_odd_places(small, tmp_path, soak, show):
    """Links are not followed, and pipes and earlier files stay if there is no room."""
    words = ["reconstruct", "--image_path", small[0], "--input_path", small[1], "--report", "0"]
    run = tmp_path / "run"
    assert not tried([*words, "--output_path", run])
    runs = refused = 0
    for suffix in SUFFIXES if soak else ("ply",):
        mine = tmp_path / f"mine.{suffix}"
        link, pipe = tmp_path / f"link.{suffix}", tmp_path / f"pipe.{suffix}"
        mine.write_text("mine")
        link.symlink_to(mine)
        os.mkfifo(pipe)
        for target, size in ((link, 0), (pipe, 0), (mine, 64)):
            flags = ["--run_path", run, "--output_path", target, "--overwrite"]
            refused += tried(["export", *flags], file_size=size)
            assert mine.read_text() == "mine", (suffix, target)
            assert link.is_symlink() or target != link
            runs += 1
        assert pipe.is_fifo()
    show(f"exports to odd places: {runs} runs, {refused} refused")
