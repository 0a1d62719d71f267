"""The help of commands: basic or all flags, grouped by option group."""

from __future__ import annotations

from typing import Any

import click

FULL = f"{__name__}.full_help"


class Command(click.Command):
    """A command that lists the flags of each option group under the group's name."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a click command with the flag --help_full."""
        super().__init__(*args, **kwargs)
        self.params.append(full_help_flag())

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the flags without a group, then those of each group; --help_full writes all."""
        groups: dict[str, list[tuple[str, str]]] = {}
        left_out = 0
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record and not (FULL in ctx.meta or getattr(param, "basic", True)):
                left_out += 1
            elif record:
                group = param.opts[0].removeprefix("--").rpartition(".")[0]
                groups.setdefault(group, []).append(record)
        for group in sorted(groups, key=lambda name: name != ""):
            with formatter.section(group or "Options"):
                formatter.write_dl(groups[group], col_max=45)
        if left_out:
            with formatter.indentation():
                formatter.write(f"\n--help_full shows {left_out} more options of single steps.\n")


def show_full_help(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    """Print the full help and exit."""
    if value and not ctx.resilient_parsing:
        ctx.meta[FULL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def full_help_flag(
    help: str = "Show all options, also those of single steps, and exit",
) -> click.Option:
    """Make the flag --help_full."""
    return click.Option(
        ["--help_full"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show_full_help,
        help=help,
    )
