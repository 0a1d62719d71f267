"""Makes scenes and runs versions of the program on them, each in a child process, and keeps all."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from trials import judging

PRODUCT = Path(__file__).resolve().with_name("product.py")
SCRIPTS = PRODUCT.parents[1]
ROOT = SCRIPTS.parent
MAKER = ("zoo", "make_scene.py")  # the sources that decide how a scene looks
JUDGE = ("colmap_edges/evaluation", "scripts/trials")  # ... how results are measured
COMPILED = ("meshing", "colmap_edges/kernels", "CMakeLists.txt")  # ... what the C++ extensions do
PYTHON, CPP = (".py", ".so"), (".cc", ".cpp", ".h", ".txt")
TIMEOUT_SECONDS = 900
KEPT_LINES = 30  # of the error output of a failed run


class TrialError(Exception):
    """A scene cannot be made or a version cannot be built; no result of the program."""


@dataclass(frozen=True, kw_only=True)
class Version:
    """A version of the program.

    Attributes:
        name: Of the folder of its results; changes with the code.
        root: Folder that holds the package.
    """

    name: str
    root: Path


@dataclass(frozen=True, kw_only=True)
class Store:
    """The folder in which scenes, versions, runs and results are kept."""

    path: Path

    def scene(self, family: str, seed: int) -> Path:
        """The folder of a scene; another maker makes another one."""
        return self.path / "scenes" / f"{family}_{seed}_{maker_digest()}"

    def run(self, version: Version, scene: Path) -> Path:
        """The meshes and edges of a scene."""
        return self.path / "runs" / version.name / f"{scene.name}.npz"

    def result(self, version: Version, scene: Path) -> Path:
        """The figures of a scene; they are measured again if the measuring changes."""
        return self.path / "results" / version.name / judge_digest() / f"{scene.name}.json"


def digest(paths: Iterable[Path], suffixes: tuple[str, ...] = PYTHON) -> str:
    """Digest of the files with some suffixes, among files and in folders."""
    found = hashlib.sha256()
    for path in paths:
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in suffixes:
                found.update(str(file.relative_to(path.parent)).encode() + b"\0")
                found.update(file.read_bytes())
    return found.hexdigest()[:12]


@cache
def maker_digest() -> str:
    """Digest of the sources of scenes, as they are when first asked for."""
    return digest(SCRIPTS / name for name in MAKER)


@cache
def judge_digest() -> str:
    """Digest of the sources of measures, as they are when first asked for."""
    return digest(ROOT / name for name in JUDGE)


def version_name(code: str) -> str:
    """Name of a version: of its code, and of the way in which it is run."""
    return f"{code}-{digest([PRODUCT])}"


def present_version() -> Version:
    """The version that Python imports: of this tree where it is first in the path, or installed."""
    spec = importlib.util.find_spec("colmap_edges")
    package = Path(str(spec and spec.origin)).parent
    sources = [path for path in sorted(package.iterdir()) if path.name != "evaluation"]
    return Version(name=version_name(f"present-{digest(sources)}"), root=package.parent)


def version_at(commit: str, store: Store) -> Version:
    """The version at a commit, taken from the repository and compiled unless its C++ is ours.

    Raises:
        TrialError: There is no such commit, or it does not compile.
    """
    full = call(["git", "rev-parse", "--verify", f"{commit}^{{commit}}"]).strip()
    root = store.path / "versions" / full[:12]
    if not root.is_dir():
        partial = root.with_name(f"{root.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        archive = store.path / "versions" / f"{root.name}.tar"
        call(["git", "archive", "--output", str(archive.resolve()), full])
        call(["tar", "-xf", str(archive.resolve()), "-C", str(partial)])
        archive.unlink()
        theirs, ours = (digest((tree / name for name in COMPILED), CPP) for tree in (partial, ROOT))
        if theirs == ours:
            for extension in (ROOT / "colmap_edges").rglob("*.so"):
                shutil.copy2(extension, partial / extension.relative_to(ROOT))
        else:
            call(["bash", str(partial / "scripts" / "build"), sys.executable])
        partial.rename(root)
    return Version(name=version_name(full[:12]), root=root)


def call(command: list[str]) -> str:
    """Run a command in the repository and return what it prints.

    Raises:
        TrialError: It fails.
    """
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TrialError(f"{' '.join(command)} failed: {tail(done.stderr)}")
    return done.stdout


def make(store: Store, family: str, seed: int) -> Path:
    """The folder of a scene, which is made unless it is there.

    Raises:
        TrialError: It cannot be made.
    """
    folder = store.scene(family, seed)
    if not folder.is_dir():
        partial = folder.with_name(f"{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.parent.mkdir(parents=True, exist_ok=True)
        maker = str(SCRIPTS / "make_scene.py")
        call([sys.executable, maker, family, str(seed), "--output_path", str(partial.resolve())])
        partial.rename(folder)
    return folder


def try_scene(
    store: Store, version: Version, family: str, seed: int, timeout: float = TIMEOUT_SECONDS
) -> dict[str, Any]:
    """The result of a version on a scene, from the store if it is there; failures are repeated.

    Returns:
        `family`, `seed`, and either the figures of `judging.judge` or `failure`: the reason in one
        line, with the end of the error output in `trace`.
    """
    scene = make(store, family, seed)
    kept = store.result(version, scene)
    if kept.is_file():
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    record: dict[str, Any] = {"family": family, "seed": seed, "version": version.name}
    run = store.run(version, scene)
    if not run.is_file() and (failure := run_product(version, scene, run, timeout)):
        return record | failure
    try:
        record |= judging.judge(scene, run)
    except Exception as error:  # whatever the program has written, the other scenes go on
        return record | {"failure": f"not measured: {type(error).__name__}: {error}"}
    write_whole(kept, json.dumps(record, indent=1) + "\n")
    return record


def run_product(version: Version, scene: Path, output: Path, timeout: float) -> dict[str, str]:
    """Run a version on a scene in a child process; returns how it failed, or nothing."""
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_suffix(".partial")
    command = [sys.executable, "-X", "faulthandler", *map(str, (PRODUCT, scene, partial))]
    try:
        done = subprocess.run(
            command,
            env=os.environ | {"PYTHONPATH": str(version.root)},
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return {"failure": f"no result after {timeout:g} s"}
    if done.returncode:
        return {"failure": reason(done.returncode, done.stderr), "trace": tail(done.stderr)}
    partial.replace(output)
    return {}


def reason(code: int, errors: str) -> str:
    """One line on how a process ended: its signal, or the last line of its errors."""
    if code < 0:
        return f"ended by {signal.Signals(-code).name}"
    lines = errors.strip().splitlines()
    return lines[-1] if lines else f"exit code {code}"


def tail(text: str) -> str:
    """The last lines of a text."""
    return "\n".join(text.strip().splitlines()[-KEPT_LINES:])


def write_whole(path: Path, text: str) -> None:
    """Write a file that is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
