#!/usr/bin/env python3
"""Writes docs/options.md and docs/constants.md, the tables of options and constants.

With --check it writes nothing and fails if a page does not match the code.
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

Made by `scripts/document_options.py`. `colmap-edges mesh --help` shows the options in bold,
`--help_full` all. Flags can be written with hyphens and in any case. In a TOML file (`--config`)
groups are tables; one file serves all commands, and each command reads the keys that it has. Ranges
include both ends. In Python the group `EdgeGraph` is `colmap_edges.options.EdgeGraphOptions`.

No option is in world units: defaults hold for any scale of the model. Lengths in pixels of the
given images are converted once per run to pixels of the upsampled images, in which edges are
detected. `report.json` holds the options as given (`options`) and the converted ones (`settings`).
Flags for inputs, outputs, the cache and the cluster are described in the [recipes](recipes.md).
All other values are [constants](constants.md) of the method.

"""
CONSTANTS_HEAD = """# Constants

Made by `scripts/document_options.py`. These values belong to the method and have no flag; values
for users are [options](options.md). They are fields of the option classes in
[colmap_edges/options](../colmap_edges/options/__init__.py), have a range, and can be set from
Python: `RefinementOptions(noise_px=0.2)`. `scripts/halve_and_double.py` halves and doubles each and
prints the changes; [experiments](experiments.md) has a table.

Together with the tolerances among the options they define the observation model:

- **Noise across a chain.** A chain point deviates across its chain by `Refinement.noise_px`
  (standard deviation). `robust_scale_px`, `max_smoothing_distance_px` and the standard deviations
  of depths (bounded by `max_sigma_ratio`) are multiples of it. Along the epipolar line the noise
  is divided by the sine of the angle between both, which `min_epipolar_angle_deg` bounds.
- **Errors of poses and distortion.** They shift whole stretches of chains by some pixels of the
  given images. The options `ChainDepth.max_disagreement_px` and `Refinement.max_residual_px`, the
  constant `Refinement.search_radius_px` and the tolerances of the paper's tracing allow for them.
  Only these lengths are converted to pixels of the upsampled images.
- **Missing observations.** An edge is unoccluded in a view with the probability `visibility_rate`,
  and then detected with `detection_rate`. `min_log_likelihood_ratio` and `break_penalty` are log
  odds under this model.
- **Wrong observations.** Any chain can be near by chance; the option `Tracing.max_false_edges`
  bounds the number of accidental edges. View-dependent contours have larger residuals than edges;
  `max_residual_ratio` separates them.
- **Intensities.** The distribution of intensity differences between views is learned from each
  scene; `side_gray_weight` weights the photometric term against the noise across edges.

The other constants set how densely curves are sampled, when pieces are joined to one edge, and the
weights of rays in the mesher. Numbers used by a single module are defined at its top and
[listed below](#single-modules).

"""
MODULES_HEAD = """
## Single modules

Numbers of single steps, grouped by kind. They have no range and cannot be set from Python.
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
    "Intensities (0 to 255)": ("LEVELS", "DEVIATION", "DIFFERENCE"),
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
    "Limits that trade time for accuracy": ("",),
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
    for name, sets in PRESETS.items():
        values = [
            f"`{key}{option and '.'}{option}` {value}"
            for key, given in sets.items()
            for option, value in (given if isinstance(given, dict) else {"": given}).items()
        ]
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
        listed = (entry.default, values, entry.metadata["help"], entry.metadata["source"])
        lines.append(f"| `{name}` | {' | '.join(map(str, listed))} |")
    return CONSTANTS_HEAD + "\n".join(lines) + "\n" + MODULES_HEAD + module_tables() + "\n"


def module_numbers() -> Iterator[tuple[str, str, str, str]]:
    """Name, value, meaning and module of each number at the top of a module of the method."""
    package = DOCS.parent / "colmap_edges"
    for path in sorted(
        path for name in METHOD for path in (package / name, *package.glob(f"{name}/**/*.py"))
    ):
        lines = path.read_text(encoding="utf-8").splitlines() if path.suffix == ".py" else []
        above: list[str] = []  # lines of the comment before
        for line in lines:
            found = re.fullmatch(r"([A-Z][A-Z0-9_]+) = (-?[\d_.e+-]+)(?:  # (.*))?", line)
            if found:
                meaning = found[3] or " ".join(above)
                yield found[1], found[2], meaning, path.relative_to(package).as_posix()
            above = [*above, line.removeprefix("# ")] if line.startswith("# ") else []


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
