#!/usr/bin/env python3
"""Writes docs/options.md: every option with its default, meaning and unit, from the code."""

from dataclasses import fields
from pathlib import Path

from colmap_edges.cli.flags import Flag, make_flags
from colmap_edges.options import PRESETS, PipelineOptions

TARGET = Path(__file__).resolve().parents[1] / "docs" / "options.md"
HEAD = """# Options

Made by `scripts/document_options.py`. `colmap-edges mesh --help` shows those in bold,
`--help_full` all. Flags may be written with hyphens and in any case; in a TOML file (`--config`)
groups are tables, and one file serves all commands: each takes the keys that it knows. Numbers
have a range, both ends of it included; beyond it they mean nothing in their unit, or ask for more
than machines have. In Python the group `EdgeGraph` is `colmap_edges.options.EdgeGraphOptions`.
No option is in world units: defaults hold for any scale of the model. Where a run reads, also masks
(`--mask_path`), writes, keeps what later runs reuse (`--cache_path`) and works (`--scheduler`) are
no options of it; see [recipes](recipes.md).

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
    """The whole page."""
    flags = make_flags({entry.name for entry in fields(PipelineOptions)})
    lines = []
    for group in sorted({group_of(f) for f in flags}, key=[group_of(f) for f in flags].index):
        lines += [f"## {group or 'The whole run'}", "", "| flag | values | default | meaning |"]
        lines += ["|---|---|---|---|", *(row(f) for f in flags if group_of(f) == group), ""]
    lines += ["## `--quality`", "", "| preset | sets |", "|---|---|"]
    for name, groups in PRESETS.items():
        values = [f"`{g}.{k}` {v}" for g, options in groups.items() for k, v in options.items()]
        lines.append(f"| {name} | {', '.join(values) or 'the defaults'} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    TARGET.write_text(options_page(), encoding="utf-8")
