#!/usr/bin/env python3
"""Write docs/api.md, the reference of the Python interface, from the docstrings."""

import ast
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / "docs" / "api.md"
HEAD = """# Python interface

Made by `scripts/document_api.py` from the docstrings. Arrays are numpy's, with shapes in brackets.
Unless stated otherwise, pixels are COLMAP's (the centre of the first one is (0.5, 0.5)) and lengths
are world units. Options are in [options.md](options.md), examples in [recipes.md](recipes.md).
Invalid input raises a `ColmapEdgesError`, whose text names the problem, its place and the remedy.

"""
# Documented names: module, names, and the module from which users import them.
PUBLIC = (
    ("pipeline.reconstruct", ("reconstruct", "EdgeReconstruction"), "colmap_edges"),
    ("core.edges3d", ("Edges3D",), "colmap_edges"),
    ("edges3d.curves.fitting", ("fit_curves",), "colmap_edges"),
    ("core.curves3d", ("Curves3D",), "colmap_edges"),
    ("evaluation.readers.results", ("read_edges", "WrittenEdges"), "colmap_edges"),
    ("export.graph", ("to_networkx",), "colmap_edges"),
    ("export.tables", ("to_pandas", "EdgeTables"), "colmap_edges"),
    ("surfaces.faces.finding", ("Faces",), "colmap_edges"),
    ("surfaces.faces.outlines", ("Face",), "colmap_edges"),
    ("surfaces.mesher", ("mesh",), "colmap_edges"),
    ("surfaces.mesh", ("Mesh",), "colmap_edges"),
    ("export.meshes", ("write_mesh",), "colmap_edges"),
    ("options.whole", ("PipelineOptions",), "colmap_edges"),
    ("options.presets", ("preset",), "colmap_edges"),
    ("errors", ("ColmapEdgesError",), "colmap_edges"),
    (
        "export.edges",
        ("write_ply", "write_obj", "write_json"),
        "colmap_edges.export.edges",
    ),
    ("export.glb", ("write_glb",), "colmap_edges.export.glb"),
    ("export.dxf", ("write_dxf",), "colmap_edges.export.dxf"),
    ("export.step", ("write_step",), "colmap_edges.export.step"),
    ("export.svg", ("write_svg",), "colmap_edges.export.svg"),
    ("export.limap", ("write_structures",), "colmap_edges.export.limap"),
    (
        "core.observations",
        ("Observations", "ChainObservations"),
        "colmap_edges.core.observations",
    ),
    (
        "colmap.triangulation",
        ("PosedImage", "posed_image", "triangulate"),
        "colmap_edges.colmap.triangulation",
    ),
    ("evaluation.run", ("run",), "colmap_edges.evaluation.run"),
)
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises):$")

Definition = ast.ClassDef | ast.FunctionDef


def definitions(module: str) -> dict[str, Definition]:
    """The classes and functions of a module by name."""
    path = ROOT / "colmap_edges" / f"{module.replace('.', '/')}.py"
    text = path.read_text(encoding="utf-8")
    found = (node for node in ast.parse(text).body if isinstance(node, Definition))
    return {node.name: node for node in found}


def signature(node: ast.FunctionDef) -> str:
    """A function's name, parameters and result, one parameter per line if they are many."""
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    parameters = re.split(r", (?![^[]*\])", ast.unparse(node.args))
    parameters = [re.sub(r"(: [^=]+)=", r"\1 = ", parameter) for parameter in parameters]
    line = f"{node.name}({', '.join(parameters)}){result}"
    if len(line) <= 96:
        return line
    return "\n".join([f"{node.name}(", *(f"    {each}," for each in parameters), f"){result}"])


def entries(lines: list[str]) -> Iterator[str]:
    """The entries of a section, each with the lines that continue it."""
    entry: list[str] = []
    for line in lines:
        if entry and not line.startswith(" "):
            yield " ".join(entry)
            entry = []
        entry.append(line.strip())
    if entry:
        yield " ".join(entry)


def section(title: str, body: str) -> list[str]:
    """A docstring's section as Markdown."""
    lines = textwrap.dedent(body).strip("\n").splitlines()
    if title == "Returns":
        return [f"{title}: {' '.join(line.strip() for line in lines)}", ""]
    found = (entry.partition(": ") for entry in entries(lines))
    return [f"{title}:", "", *(f"- `{name}`: {text}" for name, _, text in found), ""]


def markdown(docstring: str) -> str:
    """A docstring in Google's style as Markdown."""
    parts: list[str] = []
    lines = docstring.splitlines()
    while lines:
        line = lines.pop(0)
        found = SECTION.match(line)
        if not found:
            parts.append(line)
            continue
        body = []
        while lines and (not lines[0] or lines[0].startswith(" ")):
            body.append(lines.pop(0))
        parts += section(found[1], "\n".join(body))
    return "\n".join(parts).rstrip("\n")


def members(node: ast.ClassDef) -> Iterator[str]:
    """The public properties and methods of a class, one line each."""
    for member in node.body:
        if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
            first = (ast.get_docstring(member) or "").partition("\n")[0]
            is_property = any("property" in ast.unparse(d) for d in member.decorator_list)
            yield f"- `{member.name}{'' if is_property else '()'}`: {first}"


def described(node: Definition) -> str:
    """One entry of the page."""
    lines = [f"### {node.name}", ""]
    if isinstance(node, ast.FunctionDef):
        lines += ["```python", signature(node), "```", ""]
    lines.append(markdown(ast.get_docstring(node) or ""))
    if isinstance(node, ast.ClassDef) and (rows := list(members(node))):
        lines += ["", "Members:", "", *rows]
    return "\n".join(lines)


def api_page() -> str:
    """The whole page."""
    parts = []
    for place in dict.fromkeys(place for *_, place in PUBLIC):
        parts.append(f"## {place}")
        for module, names, where in PUBLIC:
            if where == place:
                found = definitions(module)
                parts += [described(found[name]) for name in names]
    return HEAD + "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    TARGET.write_text(api_page(), encoding="utf-8")
