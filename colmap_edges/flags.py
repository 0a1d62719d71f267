"""Command-line flags, and keys of the TOML file, from the option dataclasses."""

from __future__ import annotations

import difflib
import sys
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, get_type_hints

import click

from colmap_edges.options import Options, PipelineOptions

Flags = dict[str, tuple[str, str]]  # parameter's name -> (group's field or "", option's field)


def zero_or_one(value: Any) -> bool:
    """Take a truth value as COLMAP writes it, 0 or 1; also true and false."""
    words = {"0": False, "1": True, "false": False, "true": True}
    if str(value).lower() not in words:
        raise ValueError(f"{value!r} is neither 0 nor 1")
    return words[str(value).lower()]


def normalize(token: str) -> str:
    """Flags are found whatever their case and with - for _."""
    return token.lower().replace("-", "_")


def group_name(group: type[Options]) -> str:
    """COLMAP's name of an option group: EdgeGraphOptions is EdgeGraph."""
    return group.__name__.removesuffix("Options")


def make_flag(entry: Field[Any], kind: type, group: str = "") -> click.Option:
    """Make the flag of one option; `group` is the name before the dot."""
    metadata = entry.metadata
    types: dict[type, Any] = {bool: zero_or_one, int: int, float: float, str: str}
    metavars = {bool: "0|1", int: "INT", float: "FLOAT"}
    choices = metadata.get("choices")
    flag = f"{group}.{entry.name}" if group else entry.name
    default = int(entry.default) if isinstance(entry.default, bool) else entry.default
    return click.Option(
        [f"--{flag}", normalize(flag).replace(".", "__")],
        type=click.Choice(choices, case_sensitive=False) if choices else types[kind],
        metavar="|".join(choices) if choices else metavars.get(kind),
        help=f"{metadata['help']} [{default}]",
    )


def make_flags(names: set[str]) -> list[click.Option]:
    """Make the flags of the named fields of PipelineOptions; a group gives one an option."""
    flags = []
    hints = get_type_hints(PipelineOptions)
    for entry in fields(PipelineOptions):
        kind = hints[entry.name]
        if entry.name not in names:
            continue
        if not issubclass(kind, Options):
            flags.append(make_flag(entry, kind))
            continue
        inner = get_type_hints(kind)
        flags += [make_flag(e, inner[e.name], group_name(kind)) for e in fields(kind)]
    return flags


def options_from_flags(values: dict[str, Any]) -> PipelineOptions:
    """Make the options from the values of flags; those that are None keep their default.

    Raises:
        OptionError: when a value is out of its range.
    """
    hints = get_type_hints(PipelineOptions)
    chosen: dict[str, Any] = {}
    for name, kind in hints.items():
        if issubclass(kind, Options):
            prefix = normalize(group_name(kind)) + "__"
            given = {e.name: values.get(prefix + normalize(e.name)) for e in fields(kind)}
            chosen[name] = kind(**{k: v for k, v in given.items() if v is not None})
        elif values.get(name) is not None:
            chosen[name] = values[name]
    return PipelineOptions(**chosen)


def read_config(ctx: click.Context, path: Path) -> dict[str, str]:
    """Values by parameter name of a TOML file with the flags' names as keys.

    Raises:
        click.UsageError: when it cannot be read or holds a key that is no flag.
    """
    known = {
        normalize(flag.removeprefix("--")): param
        for param in ctx.command.params
        for flag in param.opts
        if flag.startswith("--") and flag not in ("--config", "--help")
    }
    values = {}
    for key, value in flatten(load_toml(path)).items():
        param = known.get(normalize(key))
        if param is None:
            spelled = {n: p.opts[0].removeprefix("--") for n, p in known.items()}
            near = difflib.get_close_matches(normalize(key), known, 1, 0)
            hint = f"; the nearest is {spelled[near[0]]}" if near else ""
            raise click.UsageError(f"{path}: unknown key {key}{hint}")
        values[str(param.name)] = str(value)
    return values


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        return dict(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise click.UsageError(f"cannot read {path}: {error}") from error


def flatten(tables: dict[str, Any]) -> dict[str, Any]:
    """Keys of tables joined by a dot."""
    flat = {}
    for key, value in tables.items():
        if isinstance(value, dict):
            flat.update({f"{key}.{inner}": v for inner, v in flatten(value).items()})
        else:
            flat[key] = value
    return flat
