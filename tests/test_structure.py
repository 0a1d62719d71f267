"""The structure that docs/architecture.md tells is that of the code."""

import importlib
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def architecture():
    return runpy.run_path(str(ROOT / "scripts" / "document_architecture.py"))


def test_every_module_has_one_room(architecture):
    placed = [module for modules in architecture["ROOMS"].values() for module in modules]
    assert sorted(placed) == sorted(architecture["module_paths"]())


def test_imports_go_one_way(architecture):
    rooms = list(architecture["ROOMS"])
    place = {module: rooms.index(room) for room in rooms for module in architecture["ROOMS"][room]}
    imports = architecture["imports"]()
    assert imports["edge_graph"] >= {"detection", "model", "options", "csr"}
    back = [(m, o) for m, others in imports.items() for o in others if place[o] > place[m]]
    assert back == []


def test_no_module_imports_itself_by_way_of_others(architecture):
    imports = architecture["imports"]()
    while ready := [module for module, others in imports.items() if not others]:
        for module in ready:
            del imports[module]
        imports = {module: others - set(ready) for module, others in imports.items()}
    assert imports == {}


def test_libraries_are_imported_where_they_may_be(architecture):
    allowed = {name: set(modules) for name, modules in architecture["LIBRARIES"].items()}
    assert architecture["libraries"]() == allowed


def test_cores_know_no_python():
    cores = [
        path
        for folder in ("colmap_edges/kernels", "meshing")
        for path in (ROOT / folder).iterdir()
        if path.suffix in (".h", ".cc") and "bindings" not in path.name and path.name != "arrays.h"
    ]
    assert len(cores) > 25
    for path in cores:
        included = re.findall(r'#include [<"]([^>"]+)', path.read_text())
        python = [name for name in included if re.match(r"nanobind|Python\.h|.*bindings", name)]
        assert python + [name for name in included if name == "arrays.h"] == [], path


def test_page_is_as_the_code(architecture):
    written = architecture["TARGET"].read_text()
    assert architecture["page"](written) == written


def test_names_on_the_page_exist(architecture):
    text = architecture["TARGET"].read_text()
    modules = architecture["module_paths"]()
    told = set(re.findall(r"`([a-z_0-9.]+\.\w+)`", text)) - set(modules)
    pairs = [(module, name) for module, _, name in (each.rpartition(".") for each in told)]
    pairs = [(m, n) for m, n in pairs if m in modules and n not in ("html", "json", "ply", "py")]
    assert len(pairs) > 15
    for module, name in pairs:
        assert hasattr(importlib.import_module(f"colmap_edges.{module}"), name), (module, name)


def test_first_line_tells_the_one_job(architecture):
    for path in architecture["module_paths"]().values():
        line = architecture["first_line"](path)
        assert re.fullmatch(r".{8,}[.:]", line), path
