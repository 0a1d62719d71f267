"""Command-line flags, and keys of the TOML file, from the option dataclasses."""

from __future__ import annotations

import difflib
import sys
from dataclasses import Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeGuard, TypeVar, get_type_hints

import click

from colmap_edges.input_files import read_text
from colmap_edges.options import Options, PipelineOptions, preset

T = TypeVar("T", bound=Options)


def zero_or_one(value: Any) -> bool:
    """Take a truth value as COLMAP writes it, 0 or 1; also true and false."""
    words = {"0": False, "1": True, "false": False, "true": True}
    if str(value).lower() not in words:
        raise click.BadParameter(f"{value!r} is neither 0 nor 1")
    return words[str(value).lower()]


def normalize(token: str) -> str:
    """Flags are found whatever their case and with - for _."""
    return token.lower().replace("-", "_")


def is_group(kind: Any) -> TypeGuard[type[Options]]:
    """Whether the type of a field is an option group."""
    return is_dataclass(kind)


def group_name(group: type[Options]) -> str:
    """COLMAP's name of an option group: EdgeGraphOptions is EdgeGraph."""
    return group.__name__.removesuffix("Options")


def flag_type(kind: Any, choices: tuple[str, ...] | None) -> tuple[Any, str]:
    """The type click converts a flag's value to, and what help shows for it."""
    if choices:
        return click.Choice(choices, case_sensitive=False), "|".join(choices)
    names = {bool: (zero_or_one, "0|1"), int: (int, "INT"), float: (float, "FLOAT")}
    return names[kind]


class Flag(click.Option):
    """A flag that knows whether the short help shows it."""

    def __init__(self, *args: Any, basic: bool = True, **kwargs: Any) -> None:
        """Make a flag as click does."""
        super().__init__(*args, **kwargs)
        self.basic = basic


def make_flag(entry: Field[Any], kind: Any, group: str = "") -> click.Option:
    """Make the flag of one option; `group` is the name before the dot."""
    metadata = entry.metadata
    flag = f"{group}.{entry.name}" if group else entry.name
    default: Any = entry.default
    value_type, metavar = flag_type(kind, metadata.get("choices"))
    return Flag(
        [f"--{flag}", parameter_name(flag)],
        type=value_type,
        metavar=metavar,
        help=f"{metadata['help']} [{int(default) if kind is bool else default}]",
        basic=not group or metadata["basic"],
    )


def parameter_name(flag: str) -> str:
    """The name under which click keeps the value of a flag."""
    return normalize(flag).replace(".", "__")


def make_flags(names: set[str]) -> list[click.Option]:
    """Make the flags of the named fields of PipelineOptions; a group gives one an option."""
    flags = []
    hints = get_type_hints(PipelineOptions)
    for entry in fields(PipelineOptions):
        kind = hints[entry.name]
        if entry.name in names:
            flags += group_flags(kind) if is_group(kind) else [make_flag(entry, kind)]
    return flags


def group_flags(group: type[Options]) -> list[click.Option]:
    """Make the flags of an option group and of the groups within it."""
    hints = get_type_hints(group)
    flags: list[click.Option] = []
    for entry in fields(group):  # type: ignore[arg-type]
        kind = hints[entry.name]
        if is_group(kind):
            flags += group_flags(kind)
        else:
            flags.append(make_flag(entry, kind, group_name(group)))
    return flags


def options_from_flags(values: dict[str, Any]) -> PipelineOptions:
    """Make the options from the values of flags; those that are None are as in the preset.

    Raises:
        OptionError: when a value is out of its range.
    """
    return changed_options(preset(values.get("quality") or "medium"), "", values)


def changed_options(group: T, prefix: str, values: dict[str, Any]) -> T:
    """One group, and the groups within it, with the values of flags."""
    chosen: dict[str, Any] = {}
    for name, kind in get_type_hints(type(group)).items():
        if is_group(kind):
            chosen[name] = changed_options(getattr(group, name), f"{group_name(kind)}.", values)
        elif values.get(parameter_name(prefix + name)) is not None:
            chosen[name] = values[parameter_name(prefix + name)]
    return replace(group, **chosen)  # type: ignore[type-var]


def read_config(ctx: click.Context, path: Path) -> dict[str, str]:
    """Values by parameter name of a TOML file with the flags' names as keys.

    Raises:
        click.UsageError: when it cannot be read or holds a key that is no flag.
    """
    known = {
        normalize(flag.removeprefix("--")): param
        for param in ctx.command.params
        for flag in param.opts
        if flag.startswith("--") and flag not in ("--config", "--help", "--help_full")
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
        return dict(tomllib.loads(read_text(path)))
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
