import json
import math
from dataclasses import FrozenInstanceError, asdict, fields

import numpy as np
import pytest

from colmap_edges.declared_options import derived, is_option, option
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.options import (
    ChainDepthOptions,
    DetectionOptions,
    EdgeGraphOptions,
    PipelineOptions,
    RefinementOptions,
    TracingOptions,
    chosen_preset,
    preset,
)

GROUPS = [
    PipelineOptions,
    *(entry.default_factory for entry in fields(PipelineOptions) if not is_option(entry)),
]
NUMBERS = [
    pytest.param(group, entry, id=f"{group.__name__}.{entry.name}")
    for group in GROUPS
    for entry in fields(group)
    if entry.metadata.get("within")
]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: DetectionOptions(gamma=0.1),
            "Detection.gamma is 0.1; it must be from 0.25 to 4",
        ),
        (
            lambda: DetectionOptions(min_chain_points=1),
            "Detection.min_chain_points is 1; it must be from 2 to 1000",
        ),
        (
            lambda: EdgeGraphOptions(max_gap_points=50.5),
            "EdgeGraph.max_gap_points is 50.5; it must be from 0 to 50",
        ),
        (
            lambda: TracingOptions(method="magic"),
            "Tracing.method is 'magic'; choose one of: chains, paper",
        ),
        (
            lambda: PipelineOptions(random_seed=-1),
            "random_seed is -1; it must be from 0 to 4294967295",
        ),
        (
            lambda: TracingOptions(num_rounds=10**5000),
            "Tracing.num_rounds is a number of thousands of digits; it must be from 1 to 10",
        ),
        (
            lambda: TracingOptions(num_rounds=2.0),
            "Tracing.num_rounds is 2.0; it must be an integer",
        ),
        (
            lambda: TracingOptions(num_rounds=True),
            "Tracing.num_rounds is True; it must be an integer",
        ),
        (
            lambda: TracingOptions(num_rounds="2"),
            "Tracing.num_rounds is '2'; it must be an integer",
        ),
        (lambda: DetectionOptions(gamma="2.2"), "Detection.gamma is '2.2'; it must be a number"),
        (lambda: DetectionOptions(gamma=None), "Detection.gamma is None; it must be a number"),
        (lambda: TracingOptions(method=1), "Tracing.method is 1; it must be a word"),
        (lambda: PipelineOptions(report=1), "report is 1; it must be True or False"),
        (
            lambda: PipelineOptions(detection=TracingOptions),
            "detection is <class 'colmap_edges.options.tracing.TracingOptions'>; "
            "it must be DetectionOptions(...)",
        ),
    ],
)
def test_range_error_names_group_field_value_and_bound(make, message):
    with pytest.raises(OptionError) as error:
        make()
    assert str(error.value) == message
    assert isinstance(error.value, ColmapEdgesError)


@pytest.mark.parametrize(("group", "entry"), NUMBERS)
def test_every_number_has_a_smallest_and_a_largest_value(group, entry):
    low, high = entry.metadata["within"]
    assert math.isfinite(low)
    assert low <= entry.default <= high < math.inf
    for bound in (low, high):
        assert getattr(group(**{entry.name: bound}), entry.name) == bound
    for outside in (low - 1, high + 1, math.nan, math.inf, -math.inf, 10**400):
        with pytest.raises(OptionError, match=rf"{entry.name} is .*; it must be "):
            group(**{entry.name: outside})


@pytest.mark.parametrize("default", [1, 1.0])
def test_no_number_can_be_declared_without_a_range(default):
    with pytest.raises(TypeError, match="need a range"):
        option(default, "Steps")


def test_numbers_of_numpy_become_those_of_json():
    options = DetectionOptions(min_chain_points=np.int64(20), gamma=np.float32(2))
    assert json.dumps(asdict(options)) == json.dumps(
        asdict(DetectionOptions(min_chain_points=20, gamma=2.0))
    )


def test_derived_values_end_where_their_range_does():
    options = ChainDepthOptions(sample_step_points=900)
    assert derived(options, sample_step_points=3600).sample_step_points == 1000


def test_every_option_has_a_line_of_help():
    for group in GROUPS:
        for entry in fields(group):
            if is_option(entry):
                assert entry.metadata["help"].strip()
                assert "\n" not in entry.metadata["help"]


def test_groups_are_frozen_and_made_afresh():
    first = PipelineOptions()
    assert first == PipelineOptions()
    with pytest.raises(FrozenInstanceError):
        first.refinement.noise_px = 1.0
    changed = PipelineOptions(refinement=RefinementOptions(noise_px=1.0))
    assert changed.refinement.noise_px == 1.0 != PipelineOptions().refinement.noise_px


def test_preset_of_the_paper():
    paper = chosen_preset("paper", None)
    assert paper == preset("paper")
    assert paper.tracing.method == "paper"
    assert paper.edge_graph.filter_regular_length
    assert (paper.edge_graph.max_gap_points, paper.matching.min_similarity) == (0, 0)
    meshing = paper.meshing
    assert meshing.method == "manifold"
    assert (meshing.vote_crossed, meshing.vote_near, meshing.vote_far) == (1, 0, 0)
    assert (meshing.vote_behind, meshing.vote_threshold) == (0, 2.1)
    assert chosen_preset("chains", None) == chosen_preset(None, "medium") == PipelineOptions()
    with pytest.raises(OptionError, match="no effect with --method paper"):
        chosen_preset("paper", "low")


def test_presets():
    assert preset("medium") == PipelineOptions()
    low, high = preset("low"), preset("high")
    for name in ("num_neighbors", "num_observing_views"):
        values = [getattr(p.view_selection, name) for p in (low, PipelineOptions(), high)]
        assert values == sorted(set(values))
    with pytest.raises(
        OptionError, match="there is no preset 'best'; choose one of: low, medium, high, paper"
    ):
        preset("best")
