import itertools

import pytest

from colmap_edges.options import EdgeGraphOptions, MeshingOptions, PipelineOptions, TracingOptions
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.report.funnel import funnel

READ = {"images_with_poses": 10, "images_without_poses": 0, "points3D": 500}
DETECT = {"images": 10, "images_without_edges": 0, "chain_pixels": 9000, "edge_pixels": 9000}
CHAINS = {
    "views": 10,
    "views_without_neighbors": 0,
    "samples": 1000,
    "samples_with_depth": 700,
    "samples_confirmed": 600,
    "samples_in_runs": 500,
    "points_traced": 400,
    "points_observed_enough": 300,
    "points_of_curves": 250,
}
PAPER = {
    "pepcs": {"pepcs_from_sfm_points": 800, "pepcs_from_pecs": 200},
    "starts": {"accepted": 100, "on_known_edge": 300, "too_few_views": 600},
    "outliers": {"min_views": 4, "points_before": 900, "points_after": 800},
}
WRITE = {"median_residual_px": 0.2}
PAPER_OPTIONS = PipelineOptions(tracing=TracingOptions(method="paper"))


def stages(read=(), detect=(), trace=(), write=(), mesh=(), details=CHAINS, edges=40):
    """Records of a run in which all went well but for what is given."""
    traced = {"edges": edges, "edge_points": 5 * edges, "details": {**details, **dict(trace)}}
    return [
        {"name": "read", "counts": {**READ, **dict(read)}},
        {"name": "detect", "counts": {**DETECT, **dict(detect)}},
        {"name": "trace", "counts": traced},
        {"name": "write", "counts": {**WRITE, **dict(write)}},
        {"name": "mesh", "counts": {"faces": 900, **dict(mesh)}},
    ]


@pytest.mark.parametrize(
    ("options", "details"), [(PipelineOptions(), CHAINS), (PAPER_OPTIONS, PAPER)]
)
def test_good_run_has_no_findings(options, details):
    assert diagnose(stages(details=details), options) == []


@pytest.mark.parametrize(
    ("lost", "text", "remedy"),
    [
        ({"read": {"images_with_poses": 2}}, "must be seen in 3", "take more images"),
        (
            {"read": {"points3D_too_far": 7}},
            "SfM points at infinity, which are not used",
            "tri_angle",
        ),
        (
            {"detect": {"images_without_edges": 10, "edge_pixels": 0, "images_masked": 9}},
            "no edge was detected in the unmasked parts of any of 10 images",
            "check the masks",
        ),
        (
            {"detect": {"images_without_edges": 10, "edge_pixels": 0, "edge_images": 10}},
            "no edge was found in the edge images of 10 images",
            "leave out --edge_path",
        ),
        (
            {"detect": {"images_masked": 9}, "edges": 0},
            "masks hide parts of the images in which no 3D edge was found: 9 of 10",
            "invert them",
        ),
        ({"mesh": {"faces": 0}}, "the mesh is empty", "--Meshing.background_weight 0"),
        ({"mesh": {"far_from_origin": 1}}, "mesh.ply holds 64-bit ones", "--alignment_type enu"),
        (
            {"read": {"images_without_poses": 20}},
            "images without a pose, which are not used: 20 of 30",
            "mapper",
        ),
        ({"read": {"points3D": 0}}, "no SfM points", "point_triangulator"),
        (
            {"detect": {"images_without_edges": 10, "edge_pixels": 0}},
            "no edge was detected in any of 10 images",
            "--Detection.min_chain_points",
        ),
        (
            {"detect": {"damaged": ["a.jpg", "b.jpg", "c.jpg", "d.jpg"]}},
            "images that could not be read, 4 of 10, were left out: a.jpg, b.jpg, c.jpg, ...",
            "replace the damaged files",
        ),
        ({"detect": {"images_without_edges": 2}}, "images without any edge: 2 of 10", "blurred"),
        (
            {"trace": {"views_without_neighbors": 10}},
            "no two images see the same part",
            "--ViewSelection.max_angle_deg",
        ),
        (
            {"trace": {"views_without_neighbors": 3}},
            "images that overlap with no other, and gave no edges: 3 of 10",
            "--ViewSelection.max_angle_deg",
        ),
        (
            {"trace": {"samples_with_depth": 20, "samples_confirmed": 19, "samples_in_runs": 18}},
            "98 % of 1,000 samples on 2D edges found no depth",
            "--ChainDepth.max_disagreement_px (now 1.2)",
        ),
        (
            {"trace": {"samples_confirmed": 70, "samples_in_runs": 60}},
            "90 % of 700 depths were not confirmed",
            "--ViewSelection.num_neighbors (now 6)",
        ),
        ({"trace": {"samples_in_runs": 60}}, "90 % of 600", "--Tracing.min_agreeing_views (now 2)"),
        (
            {"trace": {"points_observed_enough": 40}},
            "90 % of 400 traced edge points",
            "--Tracing.min_observations (now 3)",
        ),
        (
            {"trace": {"points_of_curves": 30}},
            "90 % of 300 edge points have uncertain depths",
            "--Tracing.max_false_edges (now 1)",
        ),
        ({"edges": 0}, "no 3D edge was found", "--Tracing.min_observations"),
        (
            {"write": {"median_residual_px": 1.4}},
            "median reprojection error of edges is 1.40 px",
            "adjuster",
        ),
    ],
)
def test_each_loss_is_named_with_its_remedy(lost, text, remedy):
    *_, finding = diagnose(stages(**lost), PipelineOptions())
    assert text in finding.text
    assert remedy in finding.remedy


def test_no_edges_are_the_first_finding():
    found = diagnose(stages(edges=0, read={"images_without_poses": 20}), PipelineOptions())
    assert [finding.text for finding in found] == [
        "no 3D edge was found, so that the mesh consists of SfM points alone",
        "images without a pose, which are not used: 20 of 30",
    ]
    assert found[0].remedy == "see the next note"


@pytest.mark.parametrize(
    ("lost", "text", "remedy"),
    [
        ({"trace": {"samples_confirmed": 70, "samples_in_runs": 60}}, "foliage", "compare more"),
        ({"write": {"median_residual_px": 1.4}}, "that of SfM points is 0.6 px", "motion blur"),
    ],
)
def test_poses_that_fit_the_sfm_points_are_not_blamed(lost, text, remedy):
    for residual, fits in ((0.6, True), (1.8, False)):
        (finding,) = diagnose(
            stages(read={"median_residual_px": residual}, **lost), PipelineOptions()
        )
        assert (text in finding.text) == fits
        assert (remedy in finding.remedy and "poses" not in finding.remedy) == fits
        assert ("bundle_adjuster" in finding.remedy) != fits


@pytest.mark.parametrize(
    ("meshing", "counts", "text", "remedy"),
    [
        (
            {"long_facet_factor": 1e-9},
            {"boundary_facets": 900, "long_facets_dropped": 900},
            "a side longer than 1e-09 distances to the cameras: 900 of 900",
            "--Meshing.long_facet_factor, or set it to 0",
        ),
        (
            {"min_component_faces": 1000},
            {"boundary_facets": 900, "component_faces_dropped": 890, "long_facets_dropped": 10},
            "connected components of fewer than 1,000: 890 of 900",
            "lower --Meshing.min_component_faces",
        ),
        (
            {"quality_weight": 900.0},
            {"points": 50, "boundary_facets": 0},
            "viewing rays to 50 points",
            "lower --Meshing.quality_weight (now 900)",
        ),
        (
            {"method": "carve", "vote_threshold": 5000.0},
            {"points": 50, "boundary_facets": 0},
            "all cells were labelled alike",
            "lower --Meshing.vote_threshold (now 5000)",
        ),
    ],
)
def test_an_empty_mesh_has_its_reason(meshing, counts, text, remedy):
    options = PipelineOptions(meshing=MeshingOptions(**meshing))
    mesh = {"name": "mesh", "counts": {"vertices": 0, "faces": 0, "details": counts}}
    (finding,) = diagnose([*stages(), mesh], options)
    assert text in finding.text
    assert remedy in finding.remedy


def test_two_images_get_no_useless_advice():
    options = PipelineOptions(tracing=TracingOptions(min_observations=5))
    for posed, remedy in ((2, "take more images"), (4, "or set --Tracing.min_observations 4")):
        (finding,) = diagnose(stages(read={"images_with_poses": posed}), options)
        assert "must be seen in 5" in finding.text
        assert finding.remedy.endswith(remedy)
    two = stages(read={"images_with_poses": 2}, trace={"samples_with_depth": 0}, edges=0)
    first, finding = diagnose(two, PipelineOptions())
    assert first.text.startswith("no 3D edge was found")
    assert "must be seen in 3" in finding.text


def test_dropped_by_regular_length():
    options = PipelineOptions(edge_graph=EdgeGraphOptions(filter_regular_length=True))
    (finding,) = diagnose(stages(detect={"edge_pixels": 900}), options)
    assert finding.text.startswith("90 % of edge pixels were dropped")
    assert "filter_regular_length 0" in finding.remedy


@pytest.mark.parametrize(
    ("trace", "text", "remedy"),
    [
        ({"pepcs": {}}, "no 2D edge is near an SfM point", "--method chains"),
        (
            {"starts": {"accepted": 1, "no_valid_selection": 900, "too_few_views": 50}},
            "no valid selection",
            "--Following.max_error_px",
        ),
        (
            {"starts": {"accepted": 1, "no_valid_selection": 50, "too_few_views": 900}},
            "too few views",
            "overlapping",
        ),
        (
            {"outliers": {"min_views": 5, "points_before": 900, "points_after": 90}},
            "90 % of 900 edge points are seen in fewer than 5 views",
            "--Visibility.min_views (now 4)",
        ),
    ],
)
def test_losses_of_the_papers_tracing(trace, text, remedy):
    (finding,) = diagnose(stages(details=PAPER, trace=trace), PAPER_OPTIONS)
    assert text in finding.text
    assert remedy in finding.remedy


def test_flags_that_are_named_exist():
    from dataclasses import fields

    from colmap_edges.cli.flags import make_flags

    known = {flag.opts[0] for flag in make_flags({f.name for f in fields(PipelineOptions)})}
    runs = [
        stages(read={"images_with_poses": 2, "points3D": 0}),
        stages(detect={"images_without_edges": 10, "edge_pixels": 0}),
        stages(trace={"samples_with_depth": 1, "samples_confirmed": 0, "points_traced": 900}),
        stages(trace={"samples_confirmed": 3, "views_without_neighbors": 3}),
        stages(trace={"samples_in_runs": 1}, edges=0),
        [{"name": "mesh", "counts": {"faces": 0, "long_facets_dropped": 1, "boundary_facets": 1}}],
        [{"name": "mesh", "counts": {"faces": 0, "boundary_facets": 1}}],
        [{"name": "mesh", "counts": {"faces": 0}}],
    ]
    words = " ".join(f.remedy for run in runs for f in diagnose(run, PipelineOptions())).split()
    named = {word.strip(",.;()") for word in words if word.startswith("--")}
    assert len(named) >= 6
    assert named <= known


def test_funnel_gives_shares_of_like_counts():
    steps = {step.name: step for step in funnel(stages(), PipelineOptions())}
    assert steps["with a depth that views agree on"].share == pytest.approx(0.7)
    assert steps["observed in enough views"].share == pytest.approx(0.75)
    assert steps["2D edge pixels"].share is None
    assert steps["3D edges"].count == 40


def test_funnel_ends_with_contours_and_copies():
    found = funnel(stages(trace={"points_of_contours": 50}), PipelineOptions())
    steps = {step.name: (step.count, step.share) for step in found}
    assert steps["not on view-dependent contours"] == (200, pytest.approx(0.8))
    merged = "3D edge points, after copies from other views are merged"
    assert steps[merged] == (200, pytest.approx(1.0))
    only_contours = funnel(stages(trace={"points_of_contours": 250}, edges=0), PipelineOptions())
    assert [step.count for step in only_contours[-3:]] == [0, 0, 0]


def test_shares_are_of_steps_with_the_same_unit():
    steps = funnel(stages(), PipelineOptions())
    for before, step in itertools.pairwise(steps):
        assert step.share is None or step.unit == before.unit
    assert len({step.unit for step in steps}) == 4


def test_no_funnel_without_tracing():
    assert funnel(stages()[:2], PipelineOptions()) == []
