"""Where the project's files are, and how its scripts are run."""

import os
import subprocess
from pathlib import Path

from forked import call_forked

import colmap_edges

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "tests" / "data" / "demo"
SCRIPTS = ROOT / "scripts"


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
