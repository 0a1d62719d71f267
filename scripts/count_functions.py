#!/usr/bin/env python3
"""Prints how long functions are, by language, and fails where one is over `MAX_LINES`.

Lines count from the name to the end, decorators left out, docstrings and comments counted.
"""

import ast
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import lizard

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("colmap_edges", "meshing", "scripts", "tests")
LANGUAGES = {".py": "Python", ".cc": "C++", ".h": "C++", ".js": "JavaScript"}
MAX_LINES = 60


class Function(NamedTuple):
    """A function, where it is and how long."""

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
        if path.suffix in LANGUAGES:
            find = python_functions if path.suffix == ".py" else other_functions
            functions[LANGUAGES[path.suffix]].extend(find(path))
    return {name: sorted(found, reverse=True) for name, found in functions.items()}


def main() -> None:
    """Print the table and what is too long."""
    too_long = []
    for language, functions in functions_by_language().items():
        lengths = [function.lines for function in functions]
        print(
            f"{language}: {len(lengths)} functions, median {statistics.median(lengths):g} lines, "
            f"longest {lengths[0]} ({functions[0].name})"
        )
        too_long += [function for function in functions if function.lines > MAX_LINES]
    for function in too_long:
        print(f"{function.path}:{function.start}: {function.name} has {function.lines} lines")
    sys.exit(bool(too_long))


if __name__ == "__main__":
    main()
