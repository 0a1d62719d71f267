#!/usr/bin/env python3
"""Print lengths of functions and of the package; fail if a function exceeds `MAX_LINES`.

Lines of a function include docstrings, comments and blank lines, but not decorators. For the
package, without tests, lines by language, options and constants are counted.
"""

import ast
import re
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SEARCHED = sys.path.copy()

import lizard  # noqa: E402 - its import puts the program's folder first in sys.path

sys.path[:] = SEARCHED

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("colmap_edges", "meshing", "scripts", "tests")
LANGUAGES = {".py": "Python", ".cc": "C++", ".h": "C++", ".js": "JavaScript"}
MAX_LINES = 60
PACKAGE = ("colmap_edges", "meshing")
TESTS = ("tests.cc",)
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")


class Function(NamedTuple):
    """A function with its location and length."""

    lines: int
    path: Path
    start: int
    name: str


def python_functions(path: Path) -> Iterator[Function]:
    """All functions of a Python file, inner ones too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            yield Function(lines, path, node.lineno, node.name)


def other_functions(path: Path) -> Iterator[Function]:
    """All functions that lizard finds in a file."""
    for found in lizard.analyze_file(str(path)).function_list:
        yield Function(found.end_line - found.start_line + 1, path, found.start_line, found.name)


def functions_by_language(root: Path = ROOT) -> dict[str, list[Function]]:
    """The functions of the whole project, longest first."""
    functions: dict[str, list[Function]] = {name: [] for name in LANGUAGES.values()}
    for path in sorted(path for folder in FOLDERS for path in (root / folder).rglob("*")):
        if path.suffix in LANGUAGES and not path.name.endswith(".min.js"):  # a bundled library
            find = python_functions if path.suffix == ".py" else other_functions
            functions[LANGUAGES[path.suffix]].extend(find(path))
    return {name: sorted(found, reverse=True) for name, found in functions.items()}


def package_lines(root: Path = ROOT) -> dict[str, int]:
    """Lines of the package by language."""
    lines = dict.fromkeys(LANGUAGES.values(), 0)
    for path in sorted(path for folder in PACKAGE for path in (root / folder).rglob("*")):
        if path.suffix in LANGUAGES and path.name not in TESTS:
            lines[LANGUAGES[path.suffix]] += len(path.read_text(encoding="utf-8").splitlines())
    return lines


def count_options(root: Path = ROOT) -> int:
    """Options of all groups: the fields that modules of options/ declare by `option`."""
    trees = [
        ast.parse(path.read_text()) for path in (root / "colmap_edges" / "options").glob("*.py")
    ]
    groups = (node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    values = (
        line.value for group in groups for line in group.body if isinstance(line, ast.AnnAssign)
    )
    return sum(isinstance(v, ast.Call) and ast.unparse(v.func) == "option" for v in values)


def module_constants(path: Path) -> list[str]:
    """Upper-case names that a module of Python gives a value, not within functions or classes."""
    targets: list[ast.expr] = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            targets += node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets.append(node.target)
    names = (name.id for each in targets for name in ast.walk(each) if isinstance(name, ast.Name))
    return [name for name in names if CONSTANT.fullmatch(name)]


def print_package() -> None:
    """Print the size of the package, and the numbers of its options and constants."""
    lines = package_lines()
    print(f"The package: {lines['Python']} lines of Python, {lines['C++']} of C++")
    modules = sorted((ROOT / "colmap_edges").rglob("*.py"))
    constants = [len(module_constants(path)) for path in modules]
    print(
        f"Options: {count_options()}; module constants: {sum(constants)} "
        f"in {sum(map(bool, constants))} modules"
    )


def main() -> None:
    """Print the figures and the functions that are too long."""
    too_long = []
    for language, functions in functions_by_language().items():
        lengths = [function.lines for function in functions]
        print(
            f"{language}: {len(lengths)} functions, median {statistics.median(lengths):g} lines, "
            f"longest {lengths[0]} ({functions[0].name})"
        )
        too_long += [function for function in functions if function.lines > MAX_LINES]
    print_package()
    for function in too_long:
        print(f"{function.path}:{function.start}: {function.name} has {function.lines} lines")
    sys.exit(bool(too_long))


if __name__ == "__main__":
    main()
