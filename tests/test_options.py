from dataclasses import FrozenInstanceError, fields

import pytest

from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.options import (
    DetectionOptions,
    EdgeGraphOptions,
    Options,
    PipelineOptions,
    RefinementOptions,
    TracingOptions,
    preset,
)

GROUPS = Options.__subclasses__()
LIMITED = [
    pytest.param(group, entry, key, bound, id=f"{group.__name__}.{entry.name}-{key}")
    for group in GROUPS
    for entry in fields(group)
    for key, bound in entry.metadata.get("limits", {}).items()
    if bound is not None
]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DetectionOptions(sigma_px=0.0), "Detection.sigma_px is 0.0; it must be > 0"),
        (
            lambda: DetectionOptions(min_chain_length_px=1),
            "Detection.min_chain_length_px is 1; it must be >= 2",
        ),
        (
            lambda: EdgeGraphOptions(max_join_angle_deg=90.5),
            "EdgeGraph.max_join_angle_deg is 90.5; it must be <= 90",
        ),
        (
            lambda: TracingOptions(method="magic"),
            "Tracing.method is 'magic'; choose one of: chains, paper",
        ),
    ],
)
def test_range_error_names_group_field_value_and_bound(make, message):
    with pytest.raises(OptionError) as error:
        make()
    assert str(error.value) == message
    assert isinstance(error.value, ColmapEdgesError)


@pytest.mark.parametrize(("group", "entry", "key", "bound"), LIMITED)
def test_every_bound_holds(group, entry, key, bound):
    outside = {"ge": bound - 1, "gt": bound, "le": bound + 1}[key]
    with pytest.raises(OptionError, match=rf"\.{entry.name} is .* must be .* {bound}$"):
        group(**{entry.name: outside})
    if key != "gt":
        assert getattr(group(**{entry.name: bound}), entry.name) == bound


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: group.__name__)
def test_not_a_number_is_in_no_range(group):
    for entry in fields(group):
        if any(bound is not None for bound in entry.metadata.get("limits", {}).values()):
            with pytest.raises(OptionError, match=f"{entry.name} is nan"):
                group(**{entry.name: float("nan")})


def test_every_option_has_a_line_of_help():
    for group in GROUPS:
        for entry in fields(group):
            if entry.metadata:
                assert entry.metadata["help"].strip()
                assert "\n" not in entry.metadata["help"]


def test_groups_are_frozen_and_made_afresh():
    first = PipelineOptions()
    assert first == PipelineOptions()
    with pytest.raises(FrozenInstanceError):
        first.refinement.noise_px = 1.0
    changed = PipelineOptions(refinement=RefinementOptions(noise_px=1.0))
    assert changed.refinement.noise_px == 1.0 != PipelineOptions().refinement.noise_px


def test_presets():
    assert preset("medium") == PipelineOptions()
    low, high = preset("low"), preset("high")
    for name in ("num_neighbors", "num_witnesses"):
        values = [getattr(p.view_selection, name) for p in (low, PipelineOptions(), high)]
        assert values == sorted(set(values))
    with pytest.raises(OptionError, match="quality is 'best'; choose one of: low, medium, high"):
        preset("best")
