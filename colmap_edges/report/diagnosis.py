"""Diagnoses from the counts of a run where edges were lost, and names the option to change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from colmap_edges.options import PipelineOptions

Counts = Mapping[str, Any]
# Shares below which a step has lost so much that the user should know.
MIN_CONFIRMED_SHARE = 0.3
MIN_DEPTH_SHARE = 0.1
MIN_TRACED_SHARE = 0.3
MIN_KEPT_SHARE = 0.4
MIN_FOLLOWED_SHARE = 0.02
MIN_POSED_SHARE = 0.7
LARGE_RESIDUAL_PX = 1.0
MAX_NAMES = 3
MIN_VIEWS = 3  # in which an edge must be seen: any two agree on some depth, and one confirms it
MASKS_REMEDY = (
    "look at the masks: edges are looked for where they are not black; invert them if they are "
    "the other way round, or leave out --mask_path"
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing a user should know about a run.

    Attributes:
        text: what was found, with its numbers.
        remedy: what to do about it; names the flag where one matters.
    """

    text: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Step:
    """What is left after one step of a run.

    Attributes:
        name: what is counted.
        count: how many are left.
        unit: what they are: pixels, samples, points or edges.
        share: the part of what went in, where both are counted in the same unit.
    """

    name: str
    count: int
    unit: str
    share: float | None = None


def counts_by_stage(stages: Sequence[Mapping[str, Any]]) -> dict[str, Counts]:
    """The counts of each stage by its name; those of details are put beside the others."""
    found: dict[str, Counts] = {}
    for stage in stages:
        counts = stage["counts"]
        name = "trace" if stage["name"] == "trace again" else stage["name"]
        found[name] = {**counts, **counts.get("details", {})}
    return found


def diagnose(stages: Sequence[Mapping[str, Any]], options: PipelineOptions) -> list[Finding]:
    """Say in plain words where a run lost edges.

    Args:
        stages: records of the stages, as in report.json.
        options: the options of the run.

    Returns:
        The findings in the order of the stages; none when all went well.
    """
    counts = counts_by_stage(stages)
    findings = [*images_findings(counts.get("read", {}), options)]
    findings += detection_findings(counts.get("detect", {}), options)
    enough = counts.get("read", {}).get("images_with_poses", MIN_VIEWS) >= MIN_VIEWS
    if trace := counts.get("trace"):
        if enough and counts.get("detect", {}).get("edge_pixels", 1):
            paper = options.tracing.method == "paper"
            findings += (paper_findings if paper else chain_findings)(trace, options)
        if trace["edges"] == 0:
            findings += masks_findings(counts.get("detect", {}))
        if trace["edges"] == 0 and not findings:
            findings.append(no_edges(trace, options))
    findings += residual_findings(counts.get("write", {}))
    if counts.get("mesh", {}).get("faces") == 0:
        findings.append(empty_mesh(counts["mesh"], options))
    return findings


def images_findings(read: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """What the input model itself explains."""
    posed, unposed = read.get("images_with_poses", 0), read.get("images_without_poses", 0)
    flag, needed = needed_views(options)
    if 0 < posed < max(needed, MIN_VIEWS):
        lower = f", or set {flag} {posed}" if posed >= MIN_VIEWS else ""
        yield Finding(
            text=f"only {posed} images have poses, but a 3D edge must be seen in "
            f"{max(needed, MIN_VIEWS)}",
            remedy=f"take more images{lower}",
        )
    if posed < MIN_POSED_SHARE * (posed + unposed):
        yield Finding(
            text=f"{unposed} of {posed + unposed} images have no pose and are not used",
            remedy="register more of them with `colmap mapper` (more overlap, more features)",
        )
    if far := read.get("points3D_too_far"):
        yield Finding(
            text=f"{far} of {far + read.get('points3D', 0)} SfM points are at infinity and are not "
            "used; the written model still has them",
            remedy="delete them with `colmap point_filtering` and its --min_tri_angle",
        )
    if posed and read.get("points3D") == 0:
        yield Finding(
            text="the model has no SfM points, so depths and neighbours come from poses alone",
            remedy="run `colmap point_triangulator` on the model first",
        )


def needed_views(options: PipelineOptions) -> tuple[str, int]:
    """The flag that says in how many views an edge must be seen, and its value."""
    if options.tracing.method == "paper":
        return "--Visibility.min_views", options.visibility.min_views
    return "--Tracing.min_observations", options.tracing.min_observations


def detection_findings(detect: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """What detection explains: images without edges, chains that were filtered."""
    images, empty = detect.get("images", 0), detect.get("images_without_edges", 0)
    if damaged := detect.get("damaged"):
        yield Finding(
            text=f"{len(damaged)} of {images} images could not be read and were left out: "
            f"{', '.join(damaged[:MAX_NAMES])}{', ...' if len(damaged) > MAX_NAMES else ''}",
            remedy="replace the damaged files and run again",
        )
        images -= len(damaged)
    if images and empty == images and detect.get("edge_images"):
        yield Finding(
            text=f"no edge came of the edge images of {images} images",
            remedy="look at the edge images: white on black, lines of at least "
            "--Detection.min_chain_points; or leave out --edge_path",
        )
    elif images and empty == images and not detect.get("images_masked"):
        yield Finding(
            text=f"no edge was detected in any of {images} images",
            remedy="look at the images (blank, blurred, dark?); detect shorter chains with "
            "--Detection.min_chain_points",
        )
    elif images and empty == images:
        yield Finding(
            text=f"no edge was detected in any of {images} images where masks do not hide it",
            remedy=MASKS_REMEDY,
        )
    elif empty:
        yield Finding(
            text=f"{empty} of {images} images have no edge at all",
            remedy="look at these images (blank, blurred, dark?)",
        )
    found, left = detect.get("chain_pixels", 0), detect.get("edge_pixels", 0)
    if options.edge_graph.filter_regular_length and left < MIN_KEPT_SHARE * found:
        yield Finding(
            text=f"{share(found - left, found)} of edge pixels were dropped with chains that are "
            "short of the regular length",
            remedy="set --EdgeGraph.filter_regular_length 0",
        )


def chain_findings(trace: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """Where depths along chains were lost."""
    views, lonely = trace.get("views", 0), trace.get("views_without_neighbors", 0)
    if views and lonely == views:
        yield Finding(
            text="no two images look at the same part of the scene from different places",
            remedy="check poses and overlap; for very wide baselines raise "
            "--ViewSelection.max_angle_deg",
        )
        return
    if lonely:
        yield Finding(
            text=f"{lonely} of {views} images overlap with no other and gave no edges",
            remedy="take images between them and the others, or raise "
            "--ViewSelection.max_angle_deg",
        )
    for before, after, least, what, remedy in chain_steps(options):
        start, left = trace.get(before, 0), trace.get(after, 0)
        if start and left < least * start:
            text = f"{share(start - left, start)} of {start:,} {what}"
            yield Finding(text=text, remedy=remedy)


def chain_steps(options: PipelineOptions) -> list[tuple[str, str, float, str, str]]:
    """Counts before and after each step, the share that should stay, the loss, the remedy."""
    tracing = options.tracing
    return [
        (
            "samples",
            "samples_with_depth",
            MIN_DEPTH_SHARE,
            "samples on 2D edges found no depth that views agree on",
            "check the poses (`colmap bundle_adjuster`); compare more views with "
            "--ViewSelection.num_neighbors, or allow larger pose errors with "
            f"--ChainDepth.max_disagreement_px (now {options.chain_depth.max_disagreement_px:g})",
        ),
        (
            "samples_with_depth",
            "samples_confirmed",
            MIN_CONFIRMED_SHARE,
            "depths were not found again from another view",
            "check the poses (`colmap bundle_adjuster`); compare more views with "
            f"--ViewSelection.num_neighbors (now {options.view_selection.num_neighbors})",
        ),
        (
            "samples_confirmed",
            "samples_in_runs",
            MIN_TRACED_SHARE,
            "confirmed depths lie in runs that are short or unsure",
            f"lower --Tracing.min_agreeing_views (now {tracing.min_agreeing_views}) or "
            f"--ChainDepth.sample_step_points (now {options.chain_depth.sample_step_points})",
        ),
        (
            "points_traced",
            "points_observed_enough",
            MIN_KEPT_SHARE,
            "traced edge points are observed in too few views",
            f"lower --Tracing.min_observations (now {tracing.min_observations}), or take more "
            "overlapping images",
        ),
        (
            "points_observed_enough",
            "points_of_curves",
            MIN_KEPT_SHARE,
            "edge points have uncertain depths, or lie on curves that chance may have made",
            "take images from further aside, or raise --Tracing.max_false_edges "
            f"(now {tracing.max_false_edges:g})",
        ),
    ]


def paper_findings(trace: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """Where the paper's correspondences were lost."""
    pepcs, starts = trace.get("pepcs", {}), trace.get("starts", {})
    total = pepcs.get("pepcs_from_sfm_points", 0) + pepcs.get("pepcs_from_pecs", 0)
    if total == 0:
        yield Finding(
            text="no 2D edge is near an SfM point, so no correspondence was found",
            remedy="widen --Correspondence.inner_radius_px and --Matching.max_point_distance_px, "
            "or use --method chains, which needs no SfM points near edges",
        )
        return
    known = starts.get("on_covered_stretch", 0) + starts.get("on_known_edge", 0)
    tried, accepted = sum(starts.values()) - known, starts.get("accepted", 0)
    if tried and accepted < MIN_FOLLOWED_SHARE * tried:
        reasons = {k: v for k, v in starts.items() if k not in PAPER_NOT_LOST}
        worst = max(reasons, key=lambda name: reasons[name])
        yield Finding(
            text=f"{share(tried - accepted, tried)} of {tried:,} starts could not be followed, "
            f"most for: {worst.replace('_', ' ')}",
            remedy=PAPER_REMEDIES.get(worst, "use --method chains"),
        )
    outliers = trace.get("outliers", {})
    before, after = outliers.get("points_before", 0), outliers.get("points_after", 0)
    if before and after < MIN_KEPT_SHARE * before:
        yield Finding(
            text=f"{share(before - after, before)} of {before:,} edge points are seen in fewer "
            f"than {outliers['min_views']:g} views",
            remedy=f"lower --Visibility.min_views (now {options.visibility.min_views}), or take "
            "more overlapping images",
        )


PAPER_NOT_LOST = {"accepted", "on_covered_stretch", "on_known_edge"}
PAPER_REMEDIES = {
    "too_few_views": "take more overlapping images, or use --method chains",
    "no_valid_selection": "check the poses; raise --Following.max_error_px",
    "ambiguous_selection": "lower --Following.max_error_px or --Correspondence.outer_radius_px",
}


def no_edges(trace: Counts, options: PipelineOptions) -> Finding:
    """Nothing came out, and no step alone lost most."""
    return Finding(
        text="no 3D edge came out; what was found on the way does not reach "
        f"{options.tracing.min_curve_points} points seen in {needed_views(options)[1]} views",
        remedy=f"lower --Tracing.min_curve_points or {needed_views(options)[0]}",
    )


def empty_mesh(mesh: Counts, options: PipelineOptions) -> Finding:
    """No triangle is left: by which step, and what matters there."""
    meshing = options.meshing
    found, long = mesh.get("boundary_facets", 0), mesh.get("long_facets_dropped", 0)
    if long and long >= found / 2:
        return Finding(
            text=f"the mesh is empty: {long:,} of {found:,} triangles have a side longer than "
            f"{meshing.long_facet_factor:g} distances to the cameras",
            remedy="raise --Meshing.long_facet_factor, or set it to 0, which keeps all; "
            "and check the model for points far away from all others",
        )
    if found:
        return Finding(
            text=f"the mesh is empty: {found - long:,} of {found:,} triangles are in connected "
            f"components of fewer than {meshing.min_component_faces:,}",
            remedy="lower --Meshing.min_component_faces",
        )
    flag = "quality_weight" if meshing.method == "graphcut" else "vote_threshold"
    return Finding(
        text="the mesh is empty: no surface parts free space from solid; lines of sight to "
        f"{mesh.get('points', 0):,} points do not outweigh what asks for none",
        remedy=f"lower --Meshing.{flag} (now {getattr(meshing, flag):g}); where a backdrop or "
        "masks are background also try --Meshing.background_weight 0; give a model with more "
        "points, none of them far away from all others",
    )


def masks_findings(detect: Counts) -> Iterator[Finding]:
    """What masks have to do with it when no edge came out and some were detected."""
    images, masked = detect.get("images", 0), detect.get("images_masked", 0)
    if masked and detect.get("edge_pixels"):
        yield Finding(
            text=f"no 3D edge came out of what masks leave of {masked} of {images} images",
            remedy=MASKS_REMEDY,
        )


def residual_findings(write: Counts) -> Iterator[Finding]:
    """What the fit of the edges to the images says."""
    residual = write.get("median_residual_px")
    if residual is not None and residual > LARGE_RESIDUAL_PX:
        yield Finding(
            text=f"edges miss their observations by {residual:.2f} px (median), which is much",
            remedy="improve poses and cameras with `colmap bundle_adjuster` first",
        )


def funnel(stages: Sequence[Mapping[str, Any]], options: PipelineOptions) -> list[Step]:
    """What is left after each step of tracing, from edge pixels to edge points."""
    counts = counts_by_stage(stages)
    detect, trace = counts.get("detect", {}), counts.get("trace")
    if trace is None:
        return []
    steps = [Step(name="2D edge pixels", count=detect.get("edge_pixels", 0), unit=PIXELS)]
    for key, before, unit, name in FUNNELS[options.tracing.method]:
        if key in trace:
            part = trace[key] / trace[before] if before and trace.get(before) else None
            steps.append(Step(name=name, count=trace[key], unit=unit, share=part))
    steps.append(Step(name="3D edge points", count=trace.get("edge_points", 0), unit=POINTS))
    steps.append(Step(name="3D edges", count=trace.get("edges", 0), unit="edges"))
    return steps


PIXELS, SAMPLES, POINTS = "pixels of the images", "samples along 2D edges", "points in 3D"
FUNNELS = {
    "chains": (
        ("samples", "", SAMPLES, "samples"),
        ("samples_with_depth", "samples", SAMPLES, "with a depth that views agree on"),
        ("samples_confirmed", "samples_with_depth", SAMPLES, "confirmed from another view"),
        ("samples_in_runs", "samples_confirmed", SAMPLES, "in runs that are sure"),
        ("points_traced", "", POINTS, "traced along new stretches"),
        ("points_observed_enough", "points_traced", POINTS, "observed in enough views"),
        (
            "points_of_curves",
            "points_observed_enough",
            POINTS,
            "sure, on curves that chance does not make",
        ),
    ),
    "paper": (),
}


def share(part: float, whole: float) -> str:
    """`part` of `whole` in per cent."""
    return f"{100 * part / whole:.0f} %"
