"""Where the project's files are, and how its scripts are run."""

import os
import subprocess
from pathlib import Path

import pycolmap
from forked import call_forked

import colmap_edges

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "tests" / "data" / "demo"
SCRIPTS = ROOT / "scripts"


def part_of_demo(folder, step):
    """Write the model of every n-th view of the demo into a new folder; give the folder."""
    model = pycolmap.Reconstruction(str(DEMO / "sparse"))
    names = sorted(image.name for image in model.images.values())[::step]
    for image in list(model.images.values()):
        if image.name not in names:
            model.deregister_frame(image.frame_id)
    folder.mkdir()
    model.write(str(folder))
    return folder


def run_script(name, *arguments, code=0, **environment):
    """Run a script with the package under test; fail unless it ends with `code`."""
    if name.endswith(".py"):
        done = call_forked(map(str, arguments), 600, SCRIPTS / name, **environment)
    else:
        inherited = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
        package = str(Path(colmap_edges.__file__).parents[1])
        done = subprocess.run(
            ["bash", str(SCRIPTS / name), *map(str, arguments)],
            env=inherited | {"PYTHONPATH": package} | environment,
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == code, done.stdout + done.stderr
    return done
