#!/usr/bin/env python3
"""Writes docs/options.md and docs/constants.md: options and constants with what they mean.

With --check writes nothing, and fails where a page is not as the code.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from colmap_edges.cli.flags import Flag, make_flags
from colmap_edges.declared_options import group_prefix, is_constant, range_text
from colmap_edges.options import PRESETS, PipelineOptions

DOCS = Path(__file__).resolve().parents[1] / "docs"
HEAD = """# Options

Made by `scripts/document_options.py`. `colmap-edges mesh --help` shows those in bold,
`--help_full` all. Flags may be written with hyphens and in any case; in a TOML file (`--config`)
groups are tables, and one file serves all commands: each takes the keys that it knows. Numbers
have a range, both ends of it included; beyond it they mean nothing in their unit, or ask for more
than machines have. In Python the group `EdgeGraph` is `colmap_edges.options.EdgeGraphOptions`.
No option is in world units: defaults hold for any scale of the model. Pixels are those of the given
images; where the images are upsampled for detection, a run converts them once. `report.json` holds
the options as given under `options`, and all settings as used, in pixels of the upsampled images,
under `settings`. Chains have one point for each pixel of the upsampled images. Where a run reads,
also masks (`--mask_path`) and edge images (`--edge_path`), writes, keeps what later runs reuse
(`--cache_path`) and works (`--scheduler`) are no options of it; see [recipes](recipes.md). Values
that are no options are [constants](constants.md) of the method.

"""
CONSTANTS_HEAD = """# Constants

Made by `scripts/document_options.py`. These values belong to the method and have no flag; what a
user can want to turn are [options](options.md). They are fields beside the options in
[colmap_edges/options](../colmap_edges/options/__init__.py), held to a range and settable from
Python: `RefinementOptions(noise_px=0.2)`. `scripts/halve_and_double.py` halves and doubles each and
prints what changes; [experiments](experiments.md) has a table.

Together with the tolerances among the options they state one model of what is observed:

- **Noise across a chain.** A chain point is off across its chain by `Refinement.noise_px` (standard
  deviation). `robust_scale_px`, `max_smoothing_distance_px` and the standard deviations of depths,
  which `max_sigma_ratio` bounds, are counted in it. Along the epipolar line it is larger by one
  over the sine of the angle between both, which `min_epipolar_angle_deg` bounds.
- **Errors of poses and lenses.** They move whole stretches of chains by pixels of the given images:
  the options `ChainDepth.max_disagreement_px` and `Refinement.max_residual_px`, and
  `Refinement.search_radius_px`; in the paper's way of tracing its tolerances. Only these lengths
  are converted where images are upsampled.
- **Missing observations.** An edge is not hidden in a view with the chance `visibility_rate`, and
  detected where it is visible with `detection_rate`. `min_log_likelihood_ratio` and `break_penalty`
  are log odds under this model.
- **Wrong observations.** Any chain can be near by chance; the option `Tracing.max_false_edges`
  bounds how many edges that makes. View-dependent contours scatter more than edges, which
  `max_residual_ratio` bounds.
- **Intensities.** How much the sides of an edge differ between views is learned from each scene;
  `side_gray_weight` weighs the photometric term against the noise across.

The rest says how densely curves are sampled, when pieces are one edge, and how rays weigh in the
mesh. Numbers that only one module needs stand at its top and are [listed below](#single-modules).

"""
MODULES_HEAD = """
## Single modules

Numbers of one step alone, sorted by what they are. They have no range and are not set from Python.
"""
# Folders of the method, and of the numbers in them the kinds, by the ends of their names.
METHOD = ("images", "edges2d", "edges3d", "surfaces", "poses", "colmap/thinning.py")
KINDS = {
    "Pixels": ("_PX",),
    "Angles": ("_DEG", "COSINE", "SLOPE"),
    "Distances between points of a curve, and points counted along it": (
        *(
            "SPACINGS",
            "SHORT_GAP",
            "REACH",
            "DIRECTION_STEP",
            "POINTS",
            "ARM",
            "ROUNDED",
            "PLATEAU",
            "WINDOW",
        ),
        *("FINEST",),
    ),
    "Gray levels": ("LEVELS", "DEVIATION", "DIFFERENCE"),
    "Shares, ratios and odds": (
        *(
            "RATIO",
            "SHARE",
            "RATE",
            "MARGIN",
            "CONTRADICTED",
            "STRETCH",
            "SIGMAS",
            "SCORE",
            "LOG",
            "SCALE_STEP",
            "MIN_GAP",
        ),
        *("WEIGHT", "PRIOR", "GAIN", "ACROSS", "STRONGEST", "NEXT", "SCALE"),
    ),
    "How many are looked at: time against certainty": ("",),
}
TABLE = ["| constant | value | range | meaning | where it comes from |", "|---|---|---|---|---|"]


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
    for name, groups in PRESETS.items():
        values = [f"`{g}.{k}` {v}" for g, options in groups.items() for k, v in options.items()]
        lines.append(f"| {name} | {', '.join(values) or 'the defaults'} |")
    return HEAD + "\n".join(lines) + "\n"


def constants() -> Iterator[tuple[str, Field[Any]]]:
    """Every constant by its name with its group's."""
    for group in fields(PipelineOptions):
        if not group.metadata:
            kind = type(getattr(PipelineOptions(), group.name))
            for entry in filter(is_constant, fields(kind)):
                yield group_prefix(kind) + entry.name, entry


def constants_page() -> str:
    """The whole page of constants."""
    lines = [*TABLE]
    for name, entry in constants():
        within, choices = entry.metadata["within"], entry.metadata["choices"]
        values = range_text(within, "..") if within else r" \| ".join(choices)
        told = (entry.default, values, entry.metadata["help"], entry.metadata["source"])
        lines.append(f"| `{name}` | {' | '.join(map(str, told))} |")
    return CONSTANTS_HEAD + "\n".join(lines) + "\n" + MODULES_HEAD + module_tables() + "\n"


def module_numbers() -> Iterator[tuple[str, str, str, str]]:
    """Name, value, meaning and module of each number at the top of a module of the method."""
    package = DOCS.parent / "colmap_edges"
    for path in sorted(
        path for name in METHOD for path in (package / name, *package.glob(f"{name}/**/*.py"))
    ):
        lines = path.read_text(encoding="utf-8").splitlines() if path.suffix == ".py" else []
        for before, line in zip(["", *lines], lines, strict=False):
            found = re.fullmatch(r"([A-Z][A-Z0-9_]+) = (-?[\d_.e+-]+)(?:  # (.*))?", line)
            if found:
                meaning = found[3] or before.partition("# ")[2]
                yield found[1], found[2], meaning, path.relative_to(package).as_posix()


def module_tables() -> str:
    """The numbers of single modules, a table a kind."""
    kinds: dict[str, list[str]] = {kind: [] for kind in KINDS}
    for name, value, meaning, module in module_numbers():
        kind = next(kind for kind, ends in KINDS.items() if name.endswith(ends))
        link = f"[{module}](../colmap_edges/{module})"
        kinds[kind].append(f"| `{name}` | {value} | {meaning} | {link} |")
    head = "| constant | value | meaning | module |\n|---|---|---|---|"
    return "\n".join("\n".join((f"\n**{k}**\n", head, *rows)) for k, rows in kinds.items() if rows)


def main() -> None:
    """Write both pages, or check them."""
    pages = {DOCS / "options.md": options_page(), DOCS / "constants.md": constants_page()}
    for path, text in pages.items():
        if "--check" not in sys.argv[1:]:
            path.write_text(text, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            sys.exit(f"{path} is not as the code; run scripts/document_options.py")


if __name__ == "__main__":
    main()
