"""Every script is run by a test."""

import ast
import os

import pytest
from project import ROOT, SCRIPTS

FILES = sorted(path for path in SCRIPTS.iterdir() if path.is_file())


def names_in_tests() -> set[str]:
    """Every string that is written in a test but this one."""
    paths = [p for p in (ROOT / "tests").rglob("test_*.py") if p.name != "test_every_script.py"]
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in paths)
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {node.value for node in nodes if isinstance(node.value, str)}


def test_every_script_is_run_by_a_test():
    assert len(FILES) > 20
    assert sorted({path.name for path in FILES} - names_in_tests()) == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_scripts_have_a_description(path):
    first, second, *_ = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".py":
        assert first == "#!/usr/bin/env python3"
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    else:
        assert first == "#!/usr/bin/env bash"
        assert second.startswith("# ")
    assert os.access(path, os.X_OK)
