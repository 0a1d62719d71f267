#!/usr/bin/env python3
"""Writes the parts of docs/architecture.md that the code tells: rooms, modules, libraries.

A room is a group of modules; imports go from later rooms to earlier ones, never back. A module that
is new wants a place in `ROOMS`.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "colmap_edges"
TARGET = ROOT / "docs" / "architecture.md"

# In the order in which they may import each other.
ROOMS = {
    "ground": (
        "errors", "array_types", "csr", "joining", "declared_options", "options", "edges", "stages",
        "kernels", "cache",
        "scheduling", "executors", "memory", "input_files", "plausibility",
    ),
    "COLMAP and pictures": (
        "colmap_files", "model", "thinning", "images", "workspace", "ownership", "output",
        "info", "triangulation",
    ),
    "2D edges": (
        "blur", "detection", "enlargement", "masks", "backdrop", "corners", "edge_graph",
        "graph_store", "image_graphs",
    ),
    "3D edges by chains": (
        "view_selection", "side_likelihood", "chain_depths", "view_graphs", "cross_check",
        "refinement", "runs", "significance", "occlusion", "linking", "gaps",
        "chain_positions", "junctions", "sorting", "traced_scene", "tracing",
    ),
    "3D edges by the paper": (
        "edge_field", "matching", "correspondences", "following", "visibility", "paper_tracing",
    ),
    "poses": ("bundle_adjustment",),
    "files and mesh": ("edge_io", "silhouettes", "meshing", "overlay"),
    "report": (
        "diagnosis", "report", "report.contents", "report.charts", "report.page",
        "report.pictures", "report.scene3d", "report.tracks", "viewer",
    ),
    "run": ("pipeline",),
    "evaluation": (
        "evaluation", "evaluation.arrays", "evaluation.benchmark", "evaluation.clouds",
        "evaluation.curves", "evaluation.depth", "evaluation.dtu", "evaluation.edges",
        "evaluation.held_out", "evaluation.observations", "evaluation.peers",
        "evaluation.pictures", "evaluation.ply", "evaluation.poses", "evaluation.raycasting",
        "evaluation.results", "evaluation.scene", "evaluation.statistics", "evaluation.strecha",
        "evaluation.tables", "evaluation.visible_curves",
    ),
    "command line": ("flags", "terminal", "cli", "__main__"),
}  # fmt: skip
# Modules that may import a library that others must do without.
LIBRARIES = {
    "pycolmap": ("model", "triangulation", "evaluation.poses"),
    "cv2": (
        "backdrop",
        "blur",
        "detection",
        "images",
        "masks",
        "overlay",
        "silhouettes",
        "report.pictures",
        "viewer",
        "evaluation.pictures",
    ),
    "networkx": ("matching",),
    "plotly": ("report.page",),
    "pymeshlab": ("meshing", "evaluation.clouds"),
    "click": ("flags", "terminal", "cli"),
    "rich": ("terminal",),
    "distributed": ("executors",),
    "rerun": ("viewer",),
    "matplotlib": (),
}


def module_name(path: Path) -> str:
    """`report.page` of colmap_edges/report/page.py; nothing of the package itself."""
    name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return re.sub(r"\.?__init__$", "", name)


def module_paths() -> dict[str, Path]:
    """Every module but the package itself, whose names are imported when first used."""
    paths = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
    del paths[""]
    return paths


def imported_names(path: Path) -> Iterator[str]:
    """Every name that a file imports, anywhere in it: `a.b`, and `a.b.c` of `from a.b import c`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imports() -> dict[str, set[str]]:
    """The modules of the package that each one imports."""
    paths = module_paths()
    found: dict[str, set[str]] = {module: set() for module in paths}
    for module, path in paths.items():
        for name in imported_names(path):
            package, _, other = name.partition(".")
            while package == "colmap_edges" and other and other not in paths:
                other = other.rpartition(".")[0]  # what is imported is not a module, but of one
            if package == "colmap_edges" and other:
                found[module].add(other)
    return found


def libraries() -> dict[str, set[str]]:
    """The modules that import each library."""
    found: dict[str, set[str]] = {name: set() for name in LIBRARIES}
    for module, path in module_paths().items():
        for name in {name.partition(".")[0] for name in imported_names(path)} & set(found):
            found[name].add(module)
    return found


def room_arrows() -> list[tuple[str, str]]:
    """(from, to): a room whose work another uses, left out where a room between tells it."""
    room_of = {module: room for room, modules in ROOMS.items() for module in modules}
    uses: dict[str, set[str]] = {room: set() for room in ROOMS}
    for module, others in imports().items():
        uses[room_of[module]] |= {room_of[other] for other in others} - {room_of[module]}
    reach: dict[str, set[str]] = {}
    for room in ROOMS:
        reach[room] = uses[room].union(*(reach[used] for used in uses[room]))
    return [
        (used, room)
        for room in ROOMS
        for used in ROOMS
        if used in uses[room] and not any(used in reach[other] for other in uses[room])
    ]


def diagram() -> str:
    """The rooms and who uses whom, as mermaid draws them."""
    ids = {room: f"r{index}" for index, room in enumerate(ROOMS)}
    lines = ["```mermaid", "flowchart TD"]
    lines += [f'  {ids[room]}["{room}"]' for room in ROOMS]
    lines += [f"  {ids[used]} --> {ids[room]}" for used, room in room_arrows()]
    return "\n".join([*lines, "```"])


def first_line(path: Path) -> str:
    """What a module's docstring begins with."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0]


def module_table() -> str:
    """Every module with its one job, room by room."""
    paths = module_paths()
    lines = ["| room | module | its job |", "|---|---|---|"]
    for room, modules in ROOMS.items():
        for module in modules:
            link = paths[module].relative_to(ROOT)
            lines.append(f"| {room} | [{module}](../{link}) | {first_line(paths[module])} |")
    return "\n".join(lines)


def library_table() -> str:
    """Libraries that are kept to few modules."""
    lines = ["| library | imported only by |", "|---|---|"]
    for library, modules in LIBRARIES.items():
        lines.append(f"| {library} | {', '.join(f'`{m}`' for m in modules) or 'nothing'} |")
    return "\n".join(lines)


def page(text: str) -> str:
    """The page with its parts made anew; each stands between a comment and `<!-- end -->`."""
    for name, make in (("rooms", diagram), ("modules", module_table), ("libraries", library_table)):
        begin = text.index(f"<!-- {name} -->\n") + len(f"<!-- {name} -->\n")
        text = f"{text[:begin]}{make()}\n{text[text.index('<!-- end -->', begin) :]}"
    return text


if __name__ == "__main__":
    TARGET.write_text(page(TARGET.read_text(encoding="utf-8")), encoding="utf-8")
