from dataclasses import dataclass, field, fields, is_dataclass
from typing import get_type_hints

import click
import pytest

from colmap_edges import flags
from colmap_edges.errors import OptionError
from colmap_edges.options import Options, PipelineOptions, option


@dataclass(frozen=True, kw_only=True)
class InnerOptions(Options):
    radius_px: float = option(4.0, "Radius, in pixels")


@dataclass(frozen=True, kw_only=True)
class OuterOptions(Options):
    inner: InnerOptions = field(default_factory=InnerOptions)
    steps: int = option(3, "Steps", ge=1)
    wanted: bool = option(True, "Whether it is wanted")


def parse(*args):
    command = click.Command(
        "test",
        params=flags.group_flags(OuterOptions),
        callback=lambda **values: flags.changed_options(OuterOptions(), "Outer.", values),
        context_settings={"token_normalize_func": flags.normalize},
    )
    return command.main(args, standalone_mode=False)


def test_nothing_given_is_the_defaults():
    assert parse() == OuterOptions()


def test_values_reach_groups_within_groups():
    options = parse("--Inner.radius_px", "2.5", "--outer.STEPS", "7", "--Outer.wanted", "0")
    assert options == OuterOptions(inner=InnerOptions(radius_px=2.5), steps=7, wanted=False)


def test_ranges_are_checked():
    with pytest.raises(OptionError, match=r"Outer\.steps is 0; it must be >= 1"):
        parse("--Outer.steps", "0")


@pytest.mark.parametrize("args", [["--Outer.steps", "1.5"], ["--Inner.radius_px", "wide"]])
def test_wrong_types_are_usage_errors(args):
    with pytest.raises(click.UsageError):
        parse(*args)


def leaves(group, prefix=""):
    """Every option of a group and the groups within it, as (flag, default)."""
    hints = get_type_hints(group)
    for entry in fields(group):
        kind = hints[entry.name]
        if is_dataclass(kind):
            yield from leaves(kind, flags.group_name(kind) + ".")
        else:
            yield prefix + entry.name, entry


def test_every_option_has_one_flag_with_help():
    every = dict(leaves(PipelineOptions))
    made = flags.make_flags({entry.name for entry in fields(PipelineOptions)})
    assert sorted(flag.opts[0] for flag in made) == sorted(f"--{name}" for name in every)
    assert all(entry.metadata["help"] for entry in every.values())
    assert len({flag.name for flag in made}) == len(made)
