#!/usr/bin/env python3
"""Writes docs/options.md, the tables of options.

With --check it writes nothing and fails if the page does not match the code.
"""

import sys
from dataclasses import fields
from pathlib import Path

from colmap_edges.cli.flags import Flag, make_flags
from colmap_edges.options import PRESETS, PipelineOptions

DOCS = Path(__file__).resolve().parents[1] / "docs"
HEAD = """# Options

Made by `scripts/document_options.py`. `colmap-edges mesh --help` shows the options in bold,
`--help_full` all. Flags can be written with hyphens and in any case. In a TOML file (`--config`)
groups are tables; one file serves all commands, and each command reads the keys that it has. Ranges
include both ends. In Python the group `EdgeGraph` is `colmap_edges.options.EdgeGraphOptions`.

No option is in world units: defaults hold for any scale of the model. Lengths in pixels of the
given images are converted once per run to pixels of the upsampled images, in which edges are
detected. `report.json` holds the options as given (`options`) and the converted ones (`settings`).
Flags for inputs, outputs, the cache and the cluster are described in the [recipes](recipes.md).
All other values are constants of the method: fields of the option classes in
[colmap_edges/options](../colmap_edges/options/__init__.py) with a comment each.

"""


def group_of(flag: Flag) -> str:
    """The part of a flag before the dot, or nothing."""
    return flag.opts[0].removeprefix("--").rpartition(".")[0]


def row(flag: Flag) -> str:
    """One line of the table: flag, values, default, meaning."""
    name = flag.opts[0].removeprefix("--")
    text, _, default = str(flag.help).removesuffix("]").rpartition(" [")
    marked = f"**`{name}`**" if flag.basic else f"`{name}`"
    kind = str(flag.metavar).replace("|", r" \| ")
    return f"| {marked} | {kind} | {default} | {text} |"


def options_page() -> str:
    """The whole page of options."""
    flags = make_flags({entry.name for entry in fields(PipelineOptions)})
    lines = []
    for group in sorted({group_of(f) for f in flags}, key=[group_of(f) for f in flags].index):
        lines += [f"## {group or 'The whole run'}", "", "| flag | values | default | meaning |"]
        lines += ["|---|---|---|---|", *(row(f) for f in flags if group_of(f) == group), ""]
    lines += ["## `--quality` and `--method paper`", "", "| preset | sets |", "|---|---|"]
    for name, sets in PRESETS.items():
        values = [
            f"`{key}{option and '.'}{option}` {value}"
            for key, given in sets.items()
            for option, value in (given if isinstance(given, dict) else {"": given}).items()
        ]
        lines.append(f"| {name} | {', '.join(values) or 'the defaults'} |")
    return HEAD + "\n".join(lines) + "\n"


def main() -> None:
    """Write the page, or check it."""
    path, text = DOCS / "options.md", options_page()
    if "--check" not in sys.argv[1:]:
        path.write_text(text, encoding="utf-8")
    elif not path.exists() or path.read_text(encoding="utf-8") != text:
        sys.exit(f"{path} is not as the code; run scripts/document_options.py")


if __name__ == "__main__":
    main()
