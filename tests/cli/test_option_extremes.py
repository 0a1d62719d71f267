"""Every option at and beyond the ends of its range: runs end soon, or give a one-line error.

The long version runs more values of every option, and through the command line.
"""

import json
import math
import time
from dataclasses import fields, replace
from itertools import count

import click
import pytest
import scenes

from colmap_edges.cli import flags
from colmap_edges.declared_options import group_prefix, is_option
from colmap_edges.errors import OptionError
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

WORDS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-300", "-1", "0", "-0.0", str(10**20)),
    *("", " ", "abc", "1,5", "0x10", "1_0", "9" * 5000, "\0", "é", "None", "true", "2147483648"),
)
LIMIT_S, LIMIT_MB = 30, 2000
PAPER = {"matching", "correspondence", "following", "visibility", "sampling"}


def options():
    """Every option, as (field of PipelineOptions or nothing, its own field)."""
    for entry in fields(PipelineOptions):
        if is_option(entry):
            yield "", entry
        else:
            own = fields(entry.default_factory)
            yield from ((entry.name, inner) for inner in own if is_option(inner))


def test_options_in_pixels_are_in_those_of_the_given_images():
    lengths = [entry for _, entry in options() if entry.name.endswith("_px")]
    assert lengths
    assert all("given images" in entry.metadata["help"] for entry in lengths)


def flag_of(group, entry):
    made = getattr(PipelineOptions(), group) if group else PipelineOptions()
    return group_prefix(type(made)) + entry.name


NUMBERS = [
    pytest.param(group, entry, id=flag_of(group, entry))
    for group, entry in options()
    if entry.metadata["within"]
]
OTHERS = [(group, entry) for group, entry in options() if not entry.metadata["within"]]


def around(entry):
    """Values of a number's type at, just inside and just outside the ends of its range."""
    low, high = map(type(entry.default), entry.metadata["within"])
    if isinstance(entry.default, int):
        return [low, low + 1, high - 1, high], [low - 1, high + 1]
    next_to = math.nextafter
    inside = [low, next_to(low, math.inf), next_to(high, -math.inf), high]
    return inside, [next_to(low, -math.inf), next_to(high, math.inf)]


def parser(group, entry):
    """A function from the text of one flag's value to the options it makes."""
    made = flags.make_flags({group or entry.name})
    (flag,) = (each for each in made if each.opts[0] == f"--{flag_of(group, entry)}")
    command = click.Command(
        "test", params=[flag], callback=lambda **values: flags.options_from_flags(values)
    )
    return lambda text: command.main([f"{flag.opts[0]}={text}"], standalone_mode=False)


def test_values_of_all_flags_are_taken_or_refused_in_one_line(show):
    taken = refused = 0
    for group, entry in options():
        parse = parser(group, entry)
        within = entry.metadata["within"]
        inside, outside = around(entry) if within else ([], [])
        for text in (*WORDS, *map(repr, inside + outside)):
            try:
                made = parse(text)
            except (click.UsageError, OptionError) as error:
                message = getattr(error, "message", str(error))
                assert entry.name in str(getattr(error, "param", "")) + message
                assert "\n" not in message
                assert text not in map(repr, inside)
                refused += 1
                continue
            value = getattr(getattr(made, group) if group else made, entry.name)
            assert type(value) is type(entry.default)
            assert not within or within[0] <= value <= within[1]
            assert text not in map(repr, outside)
            taken += 1
    show(f"values of flags: {taken + refused}, {taken} taken, {refused} refused")
    assert taken > 180
    assert refused > 800


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A function that runs a tiny scene with some options, and checks what is written.

    Runs share a cache, so that each does only what its option changes.
    """
    folder = tmp_path_factory.mktemp("tiny")
    images, model = scenes.make_scene(num_views=5, width=160, height=120).write(folder / "scene")
    numbers = count()

    def work(options, command="mesh"):
        output = folder / f"out{next(numbers)}"
        paths = Paths(
            image_path=images,
            input_path=model,
            output_path=output,
            cache_path=folder / "cache",
        )
        started = time.process_time()  # other programs may be at work, too
        report = run(command, paths, options)
        assert time.process_time() - started < LIMIT_S
        text = (output / "report.json").read_text()
        assert json.loads(text, parse_constant=pytest.fail)["stages"] == report["stages"]
        assert max(stage["peak_mb"] for stage in report["stages"]) < LIMIT_MB
        found = {stage["name"]: stage["counts"] for stage in report["stages"]}
        if command == "mesh" and found["mesh"]["faces"] == 0:
            assert any("the mesh is empty" in finding["text"] for finding in report["findings"])
        return found

    return work


SHORT = PipelineOptions(report=False)


def changed(group, name, value, made=SHORT):
    """Options with one changed, and those without which that one does nothing."""
    if group in PAPER:
        made = replace(made, tracing=TracingOptions(method="paper"))
    if group == "bundle_adjustment":
        made = replace(made, refine_poses=True)
    if name.startswith("vote"):
        made = replace(made, meshing=replace(made.meshing, method="carve"))
    if not group:
        return replace(made, **{name: value})
    return replace(made, **{group: replace(getattr(made, group), **{name: value})})


@pytest.mark.parametrize(("group", "entry"), NUMBERS)
def test_runs_end_at_both_ends_of_every_range(tiny, group, entry, soak, show):
    inside, _ = around(entry)
    low, high = inside[0], inside[-1]
    values = [value for value in (low, high) if value != entry.default]  # of which others are
    if soak:
        middle = math.sqrt(low * high) if low > 0 else (low + high) / 2
        values = [*inside, type(low)(middle), *near_zero(low, high)]
    command = "mesh" if soak or group in ("", "meshing") else "reconstruct"
    # Faces are found before there is a mesh.
    made = SHORT if soak or group != "meshing" else replace(SHORT, use_faces=False)
    for value in values:
        tiny(changed(group, entry.name, value, made), command)
    show(f"{flag_of(group, entry)}: {len(values)} runs")


def near_zero(low, high):
    """Values beside 0, where it is in the range of fractions."""
    return [1e-300, 1e-9] if isinstance(low, float) and low <= 0 < high else []


def other_values(entry):
    """The values of a choice or a truth value that are not its default."""
    return sorted({*(entry.metadata["choices"] or (False, True))} - {entry.default})


def test_runs_with_every_choice_and_truth_value(tiny, soak, show):
    """One by one what turns stages off, and in the long version all; else several in a run."""
    alone, together = [], {}
    for group, entry in OTHERS:
        if entry.name in ("use_edges", "masks_are_background"):  # need or contradict others
            continue
        for at, value in enumerate(other_values(entry)):
            if soak or entry.name.startswith("use_"):
                alone.append(changed(group, entry.name, value))
            else:
                together[at] = changed(group, entry.name, value, together.get(at, SHORT))
    runs = [*alone, *together.values()]
    for options in runs:
        tiny(options)
    show(f"words and truth values: {len(runs)} runs")


def test_the_reference_has_edges_and_a_mesh(tiny):
    """A scene in which nothing is found would pass everything."""
    found = tiny(SHORT)
    assert found["trace"]["edges"] > 5
    assert found["mesh"]["faces"] > 300
