"""Options and constants as fields of dataclasses that declare type, range and help."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, replace
from numbers import Integral, Real
from typing import Any, TypeVar

from colmap_edges.errors import OptionError

T = TypeVar("T", bound="Options")
MAX_SHOWN = 60  # characters of a value in a message
# What is taken for an option of a type, and how messages call that.
KINDS: dict[type, tuple[Any, str]] = {
    bool: (bool, "True or False"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
    str: (str, "a word"),
}


def option(
    default: Any,
    help: str,
    *,
    within: tuple[float, float] | None = None,
    choices: tuple[str, ...] | None = None,
    basic: bool = False,
    given_px: bool = False,
    source: str | None = None,
) -> Any:
    """Declare one option: its default, whose type is the option's, and one line of help.

    It gets a flag, a key of the TOML file and a line of docs/options.md.

    Args:
        default: what holds when nothing else is said.
        help: one line, with the unit.
        within: smallest and largest value; numbers need both, so that no number that a user
            gives can stop a run, or keep it from ending.
        choices: of a word, those that there are.
        basic: whether the short help of the command line shows the option.
        given_px: whether it is a length in pixels of the given images that stages need in those of
            the upsampled images; `colmap_edges.options.resolved` converts it.
        source: where the value comes from, of a `constant`.

    Raises:
        TypeError: for a number without a range, or a range of what is none.
    """
    is_number = isinstance(default, int | float) and not isinstance(default, bool)
    if is_number != (within is not None):
        raise TypeError(f"{help!r}: numbers, and nothing else, have a smallest and a largest value")
    declared = {"within": within, "choices": choices, "basic": basic, "given_px": given_px}
    return field(default=default, metadata={"help": help, "source": source, **declared})


def constant(default: Any, meaning: str, source: str, **declared: Any) -> Any:
    """Declare one constant of the method: a field as `option` makes, but nothing for users.

    It has no flag and no key. Tests and scripts/halve_and_double.py set it from Python, within its
    range. docs/constants.md lists it with its meaning and its source, where its value comes from.
    """
    return option(default, meaning, source=source, **declared)


def is_constant(entry: Field[Any]) -> bool:
    """Whether a field was declared by `constant`."""
    return bool(entry.metadata.get("source"))


class Options:
    """Base of the option groups: holds every field to its declared type and range."""

    def __post_init__(self) -> None:
        """Raise `OptionError` for the first value of another type or outside its range."""
        for entry in fields(self):  # type: ignore[arg-type]
            name = f"{group_prefix(type(self))}{entry.name}"
            object.__setattr__(self, entry.name, checked(name, getattr(self, entry.name), entry))


def group_prefix(group: type[Options]) -> str:
    """What stands before the names of a group's options in flags, files and messages.

    COLMAP's name of the group and a dot; nothing for what concerns the whole run.
    """
    name = group.__name__.removesuffix("Options")
    return "" if name == "Pipeline" else f"{name}."


def checked(name: str, value: Any, entry: Field[Any]) -> Any:
    """`value` as the type of the option `entry`: of numpy's numbers Python's.

    Raises:
        OptionError: when it is of another type, or not in the range or among the choices.
    """
    if entry.default_factory is not MISSING:
        return checked_group(name, value, entry.default_factory)
    kind: type = type(entry.default)
    accepted, what = KINDS[kind]
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise OptionError(f"{name} is {shown(value)}; it must be {what}")
    choices, within = entry.metadata["choices"], entry.metadata["within"]
    if choices and value not in choices:
        raise OptionError(f"{name} is {shown(value)}; choose one of: {', '.join(choices)}")
    if within and not within[0] <= value <= within[1]:
        raise OptionError(f"{name} is {shown(value)}; it must be from {range_text(within, ' to ')}")
    return kind(value)


def checked_group(name: str, value: Any, kind: Callable[[], Any]) -> Any:
    """`value` if it is a group of the class `kind`.

    Raises:
        OptionError: when it is not.
    """
    if not isinstance(value, type(kind())):
        raise OptionError(f"{name} is {shown(value)}; it must be {type(kind()).__name__}(...)")
    return value


def range_text(within: tuple[float, float], between: str) -> str:
    """The ends of a range, as short as they can be written."""
    return between.join(f"{bound:.10g}" for bound in within)


def shown(value: Any) -> str:
    """A value in a message, which is one short line whatever it is."""
    try:
        text = " ".join((str(value) if isinstance(value, Real) else repr(value)).split())
    except ValueError:  # Python does not write out whole numbers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "..."


def derived(group: T, **values: Any) -> T:
    """`group` with values that were made from others; beyond a range's end they are that end."""
    for entry in fields(group):  # type: ignore[arg-type]
        within = entry.metadata.get("within")
        if within and entry.name in values:
            values[entry.name] = min(max(values[entry.name], within[0]), within[1])
    return replace(group, **values)  # type: ignore[type-var]
