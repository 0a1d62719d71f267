#!/usr/bin/env python3
"""Write the generated parts of docs/architecture.md: folders, modules, libraries.

Which folder may import which is a contract of import-linter in pyproject.toml.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "colmap_edges"
TARGET = ROOT / "docs" / "architecture.md"
# Libraries that only some modules are allowed to import.
LIBRARIES = {
    "pycolmap": (
        "colmap.model",
        "colmap.triangulation",
        "colmap.writing",
        "evaluation.metrics.poses",
    ),
    "cv2": (
        "edges2d.blur",
        "edges2d.detection",
        "edges2d.edge_maps",
        "edges2d.faint_chains",
        "evaluation.pictures",
        "images.background",
        "images.files",
        "images.masks",
        "report.overlay",
        "report.pictures",
        "report.rerun_viewer",
        "report.still",
        "surfaces.faces.decision",
        "surfaces.faces.faint_lines",
        "surfaces.faces.grids",
        "surfaces.faces.outlines",
        "surfaces.silhouettes",
    ),
    "networkx": ("export.graph",),
    "pandas": ("export.tables",),
    "plotly": ("report.page",),
    "plyfile": ("evaluation.readers.ply",),
    "pymeshlab": ("evaluation.metrics.clouds", "surfaces.simplify"),
    "click": (
        "cli.errors",
        "cli.export_command",
        "cli.flags",
        "cli.help",
        "cli.main",
        "cli.run_commands",
        "cli.terminal",
        "cli.version",
    ),
    "rich": ("cli.terminal",),
    "distributed": ("runtime.executors",),
    "ezdxf": (),
    "OCP": ("export.step",),
    "rerun": ("report.rerun_viewer",),
    "matplotlib": (),
}


def module_name(path: Path) -> str:
    """`report.page` of colmap_edges/report/page.py; `report` of its __init__.py."""
    name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return re.sub(r"\.?__init__$", "", name)


def module_paths() -> dict[str, Path]:
    """Every module and folder but the package itself, folders before their modules."""
    found = {module_name(path): path for path in PACKAGE.rglob("*.py")}
    del found[""]
    return dict(sorted(found.items(), key=lambda pair: (folder_rank(pair[0]), pair[0])))


def folder_rank(module: str) -> int:
    """The rank of a module's folder among the layers, lowest first."""
    names = [name for layer in reversed(layers()) for name in layer]
    folder = module.partition(".")[0]
    return names.index(folder) if folder in names else len(names)


def layers() -> list[list[str]]:
    """The folders of each layer, the uppermost first."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = project["tool"]["importlinter"]["contracts"][0]
    return [layer.split(" | ") for layer in contract["layers"]]


def imported_libraries(path: Path) -> Iterator[str]:
    """The packages that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module).partition(".")[0]


def libraries() -> dict[str, set[str]]:
    """The modules that import each library."""
    found: dict[str, set[str]] = {name: set() for name in LIBRARIES}
    for module, path in module_paths().items():
        for name in {*imported_libraries(path)} & {*found}:
            found[name].add(module)
    return found


def first_line(path: Path) -> str:
    """The first line of a module's docstring."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0]


def layer_list() -> str:
    """The folders, lowest first, with their purposes."""
    lines = []
    for layer in reversed(layers()):
        for name in layer:
            folder = PACKAGE / name
            path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
            lines.append(f"- [{name}](../{path.relative_to(ROOT)}): {first_line(path)}")
    return "\n".join(lines)


def module_table() -> str:
    """Every module with its purpose, by folder."""
    lines = ["| module | its job |", "|---|---|"]
    for module, path in module_paths().items():
        if path.name != "__init__.py":
            lines.append(f"| [{module}](../{path.relative_to(ROOT)}) | {first_line(path)} |")
    return "\n".join(lines)


def library_table() -> str:
    """Libraries that are kept to few modules."""
    lines = ["| library | imported only by |", "|---|---|"]
    for library, modules in LIBRARIES.items():
        lines.append(f"| {library} | {', '.join(f'`{m}`' for m in modules) or 'nothing'} |")
    return "\n".join(lines)


PARTS = {"folders": layer_list, "modules": module_table, "libraries": library_table}


def page(text: str) -> str:
    """The page with its generated parts updated; each is between a comment and `<!-- end -->`."""
    for name, make in PARTS.items():
        begin = text.index(f"<!-- {name} -->\n") + len(f"<!-- {name} -->\n")
        text = f"{text[:begin]}{make()}\n{text[text.index('<!-- end -->', begin) :]}"
    return text


if __name__ == "__main__":
    TARGET.write_text(page(TARGET.read_text(encoding="utf-8")), encoding="utf-8")
