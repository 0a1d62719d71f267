"""Where the project's files are, and how its scripts are run."""

import os
import subprocess
import sys
from pathlib import Path

import colmap_edges

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "tests" / "data" / "demo"
SCRIPTS = ROOT / "scripts"


def run_script(name, *arguments, code=0, **environment):
    """Run a script with the package under test; fail unless it ends with `code`."""
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    package = str(Path(colmap_edges.__file__).parents[1])
    program = [sys.executable] if name.endswith(".py") else ["bash"]
    done = subprocess.run(
        [*program, str(SCRIPTS / name), *map(str, arguments)],
        env=inherited | {"PYTHONPATH": package} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done
