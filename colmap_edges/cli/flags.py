"""Command-line flags and TOML keys, made from the option dataclasses."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeGuard, TypeVar, get_type_hints

import click

from colmap_edges.declared_options import (
    Options,
    group_prefix,
    is_option,
    range_text,
    shown,
)
from colmap_edges.options import PipelineOptions, chosen_preset
from colmap_edges.runtime.input_files import read_text

T = TypeVar("T", bound=Options)


class ZeroOrOne(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A boolean flag as in COLMAP: 0 or 1; true and false are accepted, too."""

    name = "0|1"

    def convert(self, value: Any, param: Any, ctx: Any) -> bool:
        """Convert the given text to a boolean."""
        words = {"0": False, "1": True, "false": False, "true": True}
        if str(value).lower() not in words:
            self.fail(f"{value!r} is neither 0 nor 1", param, ctx)
        return words[str(value).lower()]


class Word(click.Choice):  # type: ignore[type-arg, unused-ignore]
    """A case-insensitive choice; messages use the spelling of the help."""

    def __init__(self, choices: Iterable[str]) -> None:
        """Take one of `choices`."""
        super().__init__(tuple(choices), case_sensitive=False)

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        """Convert the given text to one of the choices."""
        for word in self.choices:
            if str(value).lower() == word.lower():
                return str(word)
        self.fail(f"{value!r} is not one of: {', '.join(self.choices)}", param, ctx)


def normalize(token: str) -> str:
    """A flag in lower case with underscores, for case-insensitive lookup."""
    return token.lower().replace("-", "_")


def is_group(kind: Any) -> TypeGuard[type[Options]]:
    """Whether the type of a field is an option group."""
    return is_dataclass(kind)


def flag_type(kind: Any, metadata: Mapping[str, Any]) -> tuple[Any, str]:
    """The type click converts a flag's value to, and what help shows for it."""
    if metadata["choices"]:
        return Word(metadata["choices"]), "|".join(metadata["choices"])
    if kind is bool:
        return ZeroOrOne(), ZeroOrOne.name
    return kind, range_text(metadata["within"], "..")


class Flag(click.Option):
    """A flag that may be shown in the full help only."""

    def __init__(self, *args: Any, basic: bool = True, **kwargs: Any) -> None:
        """Make a click option; `basic` flags are in the short help."""
        super().__init__(*args, **kwargs)
        self.basic = basic


def make_flag(entry: Field[Any], kind: Any, prefix: str = "") -> click.Option:
    """Make the flag of one option; `prefix` is the name of its group and a dot."""
    metadata = entry.metadata
    flag = prefix + entry.name
    default: Any = entry.default
    value_type, metavar = flag_type(kind, metadata)
    return Flag(
        [f"--{flag}", parameter_name(flag)],
        type=value_type,
        metavar=metavar,
        help=f"{metadata['help']} [{int(default) if kind is bool else default}]",
        basic=not prefix or metadata["basic"],
    )


def parameter_name(flag: str) -> str:
    """The parameter name by which click stores the value of a flag."""
    return normalize(flag).replace(".", "__")


def names_of_stages(*stages: str) -> set[str]:
    """Names of the fields of PipelineOptions that belong to some stages."""
    return {entry.name for entry in fields(PipelineOptions) if entry.metadata["stage"] in stages}


def make_flags(names: set[str]) -> list[click.Option]:
    """Make the flags of the named fields of PipelineOptions; a group gives one flag per option."""
    flags = []
    hints = get_type_hints(PipelineOptions)
    for entry in fields(PipelineOptions):
        kind = hints[entry.name]
        if entry.name in names:
            flags += group_flags(kind) if is_group(kind) else [make_flag(entry, kind)]
    return flags


def group_flags(group: type[Options]) -> list[click.Option]:
    """Make the flags of an option group and of the groups within it; plain fields have none."""
    hints = get_type_hints(group)
    flags: list[click.Option] = []
    for entry in fields(group):  # type: ignore[arg-type]
        kind = hints[entry.name]
        if is_group(kind):
            flags += group_flags(kind)
        elif is_option(entry):
            flags.append(make_flag(entry, kind, group_prefix(group)))
    return flags


def options_from_flags(values: dict[str, Any]) -> PipelineOptions:
    """Make the options from the values of flags; flags that are None keep the preset's value.

    Raises:
        OptionError: if a value is outside its range.
    """
    start = chosen_preset(values.get("method"), values.get("quality"))
    return changed_options(start, "", values)


def changed_options(group: T, prefix: str, values: dict[str, Any]) -> T:
    """An option group, with nested groups, updated by the values of flags."""
    chosen: dict[str, Any] = {}
    for name, kind in get_type_hints(type(group)).items():
        if is_group(kind):
            chosen[name] = changed_options(getattr(group, name), group_prefix(kind), values)
        elif values.get(parameter_name(prefix + name)) is not None:
            chosen[name] = values[parameter_name(prefix + name)]
    return replace(group, **chosen)  # type: ignore[type-var]


def flags_by_name(command: click.Command) -> dict[str, click.Parameter]:
    """The flags of a command and its subcommands, by normalized name."""
    own = {
        normalize(flag.removeprefix("--")): param
        for param in command.params
        for flag in param.opts
        if flag.startswith("--") and flag not in ("--config", "--help", "--help_full", "--version")
    }
    inner = command.commands.values() if isinstance(command, click.Group) else ()
    return {name: param for each in inner for name, param in flags_by_name(each).items()} | own


def in_given_case(error: click.NoSuchOption, words: Iterable[str]) -> click.NoSuchOption:
    """The error about an unknown flag, as it was typed, with flags as the help spells them.

    Args:
        error: click's error, whose names are normalized.
        words: words of the command line.
    """
    typed = (word.partition("=")[0] for word in words)
    found = next((word for word in typed if normalize(word) == normalize(error.option_name)), None)
    known = flags_by_name(error.ctx.command) if error.ctx else {}
    near = [known.get(normalize(name.removeprefix("--"))) for name in error.possibilities or ()]
    spelled = [param.opts[0] for param in near if param]
    return click.NoSuchOption(found or error.option_name, possibilities=spelled, ctx=error.ctx)


def with_dashes(message: str, command: click.Command) -> str:
    """A message in which names of options that `command` has as flags get leading dashes."""
    names = {param.opts[0].removeprefix("--") for param in flags_by_name(command).values()}
    words = message.split(" ")
    return " ".join(f"--{word}" if word.strip(",;:") in names else word for word in words)


def read_config(ctx: click.Context, path: Path) -> dict[str, str]:
    """Read a TOML file with flags as keys; returns its values by parameter name.

    One file serves all commands: keys of other commands are ignored.

    Raises:
        click.UsageError: if the file cannot be read, a key belongs to no command, or a value has
            the wrong type.
    """
    own = flags_by_name(ctx.command)
    known = {**flags_by_name(ctx.find_root().command), **own}
    values = {}
    for key, value in load_toml(path).items():
        param = known.get(normalize(key))
        if param is None:
            spelled = {n: p.opts[0].removeprefix("--") for n, p in known.items()}
            near = difflib.get_close_matches(normalize(key)[:60], known, 1, 0)
            hint = f"; did you mean {spelled[near[0]]}?" if near else ""
            raise click.UsageError(f"{path}: unknown key {key[:60]}{hint}")
        kinds, what = toml_kinds(param.type)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise click.UsageError(f"{path}: {key} is {shown(value)}; it must be {what}")
        if normalize(key) in own:
            values[str(param.name)] = str(value)
    return values


def toml_kinds(flag_type: Any) -> tuple[tuple[type, ...], str]:
    """The TOML types accepted for a flag type, and their name in messages."""
    if isinstance(flag_type, ZeroOrOne | click.types.BoolParamType):
        return (bool, int), "true or false"
    if isinstance(flag_type, click.types.IntParamType):
        return (int,), "an integer"
    if isinstance(flag_type, click.types.FloatParamType):
        return (int, float), "a number"
    if isinstance(flag_type, click.types.FuncParamType):  # of --rerun
        return (str, int), "0, 1 or a text in quotes"
    return (str,), "a text in quotes"


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; nested keys are joined by dots.

    Raises:
        click.UsageError: if the file cannot be read.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        return flatten(tomllib.loads(read_text(path).removeprefix("\ufeff")))
    except (OSError, ValueError) as error:
        raise click.UsageError(f"cannot read {path}: {error}") from error
    except RecursionError as error:
        raise click.UsageError(
            f"cannot read {path}: tables or lists are nested too deeply"
        ) from error


def flatten(tables: dict[str, Any]) -> dict[str, Any]:
    """Nested tables as one table with dotted keys."""
    flat = {}
    for key, value in tables.items():
        if isinstance(value, dict):
            flat.update({f"{key}.{inner}": v for inner, v in flatten(value).items()})
        else:
            flat[key] = value
    return flat
