"""Options as fields of dataclasses that declare range and help; constants are plain fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, replace
from numbers import Integral, Real
from typing import Any, TypeVar

from colmap_edges.errors import OptionError

T = TypeVar("T", bound="Options")
# Accepted types for an option of each type, and their name in messages.
KINDS: dict[type, tuple[Any, str]] = {
    bool: (bool, "True or False"),
    int: (Integral, "an integer"),
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
    stage: str = "",
) -> Any:
    """Declare an option: a dataclass field with default, range and help.

    An option has a flag, a TOML key and a row in docs/options.md.

    Args:
        default: default value; its type is the option's.
        help: one line, with the unit.
        within: minimum and maximum; required for numbers, so that no value breaks a run.
        choices: allowed values of a string option.
        basic: whether the short help of the command line shows the option.
        given_px: whether it is a length in pixels of the given images, which
            `colmap_edges.options.resolved` converts to pixels of the upsampled images.
        stage: the stage of an option of the whole run.

    Raises:
        TypeError: if a number has no range, or another type has one.
    """
    is_number = isinstance(default, int | float) and not isinstance(default, bool)
    if is_number != (within is not None):
        raise TypeError(f"{help!r}: numbers need a range, other types must not have one")
    declared = {"within": within, "choices": choices, "basic": basic, "given_px": given_px}
    return field(default=default, metadata={"help": help, "stage": stage, **declared})


def group(kind: type[T], stage: str) -> Any:
    """Declare a group of options of a stage."""
    return field(default_factory=kind, metadata={"stage": stage})


def constant(default: Any, **declared: Any) -> Any:
    """Declare a constant with the `choices` or `given_px` of `option`; others are plain fields."""
    return field(default=default, metadata=declared)


def is_option(entry: Field[Any]) -> bool:
    """Whether a field was declared by `option`; other values of the method are plain fields."""
    return "help" in entry.metadata


class Options:
    """Base of the option groups: checks the type of every field, and the range of options."""

    def __post_init__(self) -> None:
        """Raise `OptionError` for the first value of another type or outside its range."""
        for entry in fields(self):  # type: ignore[arg-type]
            name = f"{group_prefix(type(self))}{entry.name}"
            object.__setattr__(self, entry.name, checked(name, getattr(self, entry.name), entry))


def group_prefix(group: type[Options]) -> str:
    """The prefix of a group's option names in flags, files and messages.

    It is the group's name and a dot; empty for options of the whole run.
    """
    name = group.__name__.removesuffix("Options")
    return "" if name == "Pipeline" else f"{name}."


def checked(name: str, value: Any, entry: Field[Any]) -> Any:
    """`value` converted to the type of the option `entry`.

    Raises:
        OptionError: if it has another type, or is outside the range or the choices.
    """
    if entry.default_factory is not MISSING:
        return checked_group(name, value, entry.default_factory)
    kind: type = type(entry.default)
    accepted, what = KINDS[kind]
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise OptionError(f"{name} is {shown(value)}; it must be {what}")
    choices, within = entry.metadata.get("choices"), entry.metadata.get("within")
    if choices and value not in choices:
        raise OptionError(f"{name} is {shown(value)}; choose one of: {', '.join(choices)}")
    if within and not within[0] <= value <= within[1]:
        raise OptionError(f"{name} is {shown(value)}; it must be from {range_text(within, ' to ')}")
    return kind(value)


def checked_group(name: str, value: Any, kind: Callable[[], Any]) -> Any:
    """`value`, checked to be an option group of the class `kind`.

    Raises:
        OptionError: if it is not.
    """
    if not isinstance(value, type(kind())):
        raise OptionError(f"{name} is {shown(value)}; it must be {type(kind()).__name__}(...)")
    return value


def range_text(within: tuple[float, float], between: str) -> str:
    """A range as text, in the shortest notation."""
    return between.join(f"{bound:.10g}" for bound in within)


def shown(value: Any) -> str:
    """A value as one short line for a message."""
    try:
        text = " ".join((str(value) if isinstance(value, Real) else repr(value)).split())
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:60] + "..."


def derived(group: T, **values: Any) -> T:
    """`group` with computed values, clipped to their ranges."""
    for entry in fields(group):  # type: ignore[arg-type]
        within = entry.metadata.get("within")
        if within and entry.name in values:
            values[entry.name] = min(max(values[entry.name], within[0]), within[1])
    return replace(group, **values)  # type: ignore[type-var]
