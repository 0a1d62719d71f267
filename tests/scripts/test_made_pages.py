"""The scripts that generate pages from the code, and the one that counts functions."""

import os
import re
import runpy
import shutil
import subprocess
import sys

import pytest
from project import ROOT, SCRIPTS

count_functions = pytest.importorskip(
    "count_functions", reason="functions of C++ are counted with lizard"
)


@pytest.fixture
def copy(tmp_path):
    """The project's sources and pages, which a script may write to."""
    nothing_else = shutil.ignore_patterns("*.so", "__pycache__", "*.h", "*.cc")
    for name in ("colmap_edges", "scripts", "docs"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=nothing_else)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_page_is_written_anew(copy):
    path = copy / "docs" / "options.md"
    expected = path.read_text()
    path.unlink()
    runpy.run_path(str(copy / "scripts" / "document_options.py"), run_name="__main__")
    assert path.read_text() == expected


def test_outdated_page_is_reported(copy, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["document_options.py", "--check"])
    script = str(copy / "scripts" / "document_options.py")
    runpy.run_path(script, run_name="__main__")
    with (copy / "docs" / "options.md").open("a") as page:
        page.write("more\n")
    with pytest.raises(SystemExit, match=r"options.md is not as the code"):
        runpy.run_path(script, run_name="__main__")


def write_toy(root):
    """A project of few lines: two of Python, two of C++, and a test, which does not count."""
    for folder in ("colmap_edges/sub", "meshing", "tests", "scripts"):
        (root / folder).mkdir(parents=True)
    (root / "colmap_edges" / "options").mkdir()
    (root / "colmap_edges" / "options" / "a.py").write_text(
        "def option(default, help): ...\n"
        "class AOptions:\n    d: int = 1\n"
        "    a: int = option(1, 'a')\n    b: int = option(2, 'b')\n"
        "class BOptions:\n    c: float = option(0.5, 'c')\n    group: AOptions = field()\n"
    )
    (root / "colmap_edges" / "sub" / "module.py").write_text(
        "A_PX, (B2, _CD) = 1, (2, 3)\nD: int = 4\nT = TypeVar('T')\nE_F: int\nsmall = G = 5\n"
        "class K:\n    IN_CLASS = 6\ndef f():\n    IN_FUNCTION = 7\nLONG = 8\n"
    )
    (root / "meshing" / "core.cc").write_text("int F() {\n  return 1;\n}\n")
    (root / "meshing" / "tests.cc").write_text("int main() {}\n")
    (root / "tests" / "test_it.py").write_text("def test_it():\n    pass\n")


def test_lines_options_and_constants_of_a_toy(tmp_path):
    write_toy(tmp_path)
    lines = count_functions.package_lines(tmp_path)
    assert (lines["Python"], lines["C++"]) == (8 + 10, 3)
    assert count_functions.count_options(tmp_path) == 3
    module = tmp_path / "colmap_edges" / "sub" / "module.py"
    assert sorted(count_functions.module_constants(module)) == ["A_PX", "B2", "LONG", "_CD"]
    functions = count_functions.functions_by_language(tmp_path)
    assert [f.name for f in functions["Python"]] == ["test_it", "f", "option"]
    assert [f.name for f in functions["C++"]] == ["F", "main"]


def test_figures_are_printed_and_a_long_function_fails(tmp_path, monkeypatch, capsys):
    write_toy(tmp_path)
    long = "def long():\n" + "    pass\n" * count_functions.MAX_LINES
    (tmp_path / "scripts" / "long.py").write_text(long)
    (tmp_path / "scripts" / "page.js").write_text("function f() {\n  return 1;\n}\n")
    found = count_functions.functions_by_language(tmp_path)
    monkeypatch.setattr(count_functions, "functions_by_language", lambda: found)
    with pytest.raises(SystemExit) as ended:
        count_functions.main()
    assert ended.value.code == 1
    *lines, last = capsys.readouterr().out.splitlines()
    heads = ["Python:", "C++:", "JavaScript:", "The", "Options:"]
    assert [line.split()[0] for line in lines] == heads
    found = re.fullmatch(r"The package: (\d+) lines of Python, (\d+) of C\+\+", lines[3])
    assert min(map(int, found.groups())) > 1000
    assert last.endswith("long.py:1: long has 61 lines")


def test_modules_are_found_where_they_were(tmp_path):
    """Processes that tests start take the folders from which this one imports."""
    program = tmp_path / "program.py"
    program.write_text(
        "import sys\np = sys.path.copy()\nimport count_functions\nassert p == sys.path"
    )
    searched = os.pathsep.join([str(SCRIPTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": searched, "PYTHONSAFEPATH": "1"}
    subprocess.run([sys.executable, program], env=environment, check=True)
