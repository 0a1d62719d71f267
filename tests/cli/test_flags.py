from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import get_type_hints

import click
import pytest

from colmap_edges.cli import flags
from colmap_edges.declared_options import Options, group_prefix, is_option, option
from colmap_edges.errors import OptionError
from colmap_edges.options import PipelineOptions


@dataclass(frozen=True, kw_only=True)
class InnerOptions(Options):
    radius_px: float = option(4.0, "Radius, in pixels", within=(0, 9))


@dataclass(frozen=True, kw_only=True)
class OuterOptions(Options):
    inner: InnerOptions = field(default_factory=InnerOptions)
    steps: int = option(3, "Steps", within=(1, 9))
    wanted: bool = option(True, "Whether it is wanted")


def parse(*args):
    command = click.Command(
        "test",
        params=flags.group_flags(OuterOptions),
        callback=lambda **values: flags.changed_options(OuterOptions(), "Outer.", values),
        context_settings={"token_normalize_func": flags.normalize},
    )
    return command.main(args, standalone_mode=False)


def test_no_flags_give_the_defaults():
    assert parse() == OuterOptions()


def test_values_reach_groups_within_groups():
    options = parse("--Inner.radius_px", "2.5", "--outer.STEPS", "7", "--Outer.wanted", "0")
    assert options == OuterOptions(inner=InnerOptions(radius_px=2.5), steps=7, wanted=False)


def test_ranges_are_checked():
    with pytest.raises(OptionError, match=r"Outer\.steps is 0; it must be from 1 to 9"):
        parse("--Outer.steps", "0")


@pytest.mark.parametrize("args", [["--Outer.steps", "1.5"], ["--Inner.radius_px", "wide"]])
def test_wrong_types_are_usage_errors(args):
    with pytest.raises(click.UsageError):
        parse(*args)


def leaves(group, prefix=""):
    """Every option of a group and the groups within it, as (flag, field)."""
    hints = get_type_hints(group)
    for entry in fields(group):
        kind = hints[entry.name]
        if is_dataclass(kind):
            yield from leaves(kind, group_prefix(kind))
        elif is_option(entry):
            yield prefix + entry.name, entry


def test_every_option_has_one_flag_with_help():
    every = dict(leaves(PipelineOptions))
    made = flags.make_flags({entry.name for entry in fields(PipelineOptions)})
    assert sorted(flag.opts[0] for flag in made) == sorted(f"--{name}" for name in every)
    assert all(entry.metadata["help"] for entry in every.values())
    assert len({flag.name for flag in made}) == len(made)


def read(tmp_path, data):
    """The options that the command `outer` has from a file; `other` has flags of its own."""
    path = tmp_path / "config.toml"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    found = []

    def callback(ctx, _param, value):
        ctx.default_map = flags.read_config(ctx, value)

    config = click.Option(
        ["--config"],
        type=click.Path(path_type=Path),
        is_eager=True,
        expose_value=False,
        callback=callback,
    )
    params = [
        config,
        click.Option(["--output_path"], type=click.Path()),
        click.Option(["--overwrite"], is_flag=True),
        click.Option(["--kind"], type=flags.Word(("BIN", "TXT"))),
        *flags.group_flags(OuterOptions),
    ]
    program = click.Group(context_settings={"token_normalize_func": flags.normalize})
    program.add_command(
        click.Command("outer", params=params, callback=lambda **values: found.append(values))
    )
    program.add_command(
        click.Command("other", params=[click.Option(["--Mesh.size", "size"], type=float)])
    )
    program.main(["outer", "--config", str(path)], standalone_mode=False)
    return found[0]


def test_a_file_serves_all_commands(tmp_path):
    values = read(tmp_path, "[Outer]\nsteps = 7\nwanted = 0\n[Mesh]\nsize = 2.5\n")
    assert (values["outer__steps"], values["outer__wanted"]) == (7, False)
    assert not any("mesh" in name for name in values)


def test_a_file_may_begin_with_a_mark_of_its_encoding(tmp_path):
    values = read(tmp_path, b"\xef\xbb\xbfoutput_path = 'out'\r\noverwrite = true\r\nkind = 'txt'")
    assert (values["output_path"], values["overwrite"], values["kind"]) == ("out", True, "TXT")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('output_path = ["a", "b"]', "output_path is ['a', 'b']; it must be a text in quotes"),
        ("output_path = 3", "output_path is 3; it must be a text in quotes"),
        (
            "output_path = 1979-05-27",
            "output_path is datetime.date(1979, 5, 27); it must be a text",
        ),
        ("overwrite = 'yes'", "overwrite is 'yes'; it must be true or false"),
        ("Outer.steps = '3'", "Outer.steps is '3'; it must be an integer"),
        ("Outer.steps = 3.0", "Outer.steps is 3.0; it must be an integer"),
        ("Outer.steps = true", "Outer.steps is True; it must be an integer"),
        ("Outer.wanted = 0.0", "Outer.wanted is 0.0; it must be true or false"),
        ("Outer.wanted = 2", "2' is neither 0 nor 1"),
        ("Inner.radius_px = '4'", "Inner.radius_px is '4'; it must be a number"),
        ("Inner.radius_px = true", "Inner.radius_px is True; it must be a number"),
        ("Mesh.size = 'big'", "Mesh.size is 'big'; it must be a number"),
        ("kind = 'PLY'", "'PLY' is not one of: BIN, TXT"),
        ("Outer.stepz = 3", "unknown key Outer.stepz; did you mean Outer.steps"),
        ("Outer.steps = " + 9 * "[" + 9 * "]", "it must be an integer"),
        ("Outer.steps = " + 9000 * "[" + 9000 * "]", "too deep"),
        ("a" + 9000 * ".a" + " = 1", "too deep"),
        ("Outer.steps = " + 5000 * "9", "cannot read"),
        (b"\xff\xfe", "cannot read"),
    ],
)
def test_mistakes_in_a_file_are_one_line_errors(tmp_path, text, message):
    with pytest.raises(click.UsageError) as error:
        read(tmp_path, text)
    assert message in error.value.format_message()
    assert "\n" not in error.value.format_message()


def test_messages_about_options_name_flags():
    command = click.Command("test", params=flags.make_flags({"random_seed", "visibility"}))
    for message, expected in (
        ("random_seed is -1; it must be more", "--random_seed is -1; it must be more"),
        ("Visibility.min_views is 0", "--Visibility.min_views is 0"),
        ("give mask_path, or random_seed", "give mask_path, or --random_seed"),
    ):
        assert flags.with_dashes(message, command) == expected
