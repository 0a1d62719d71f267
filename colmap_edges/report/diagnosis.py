"""Diagnosis of a run from its counts: where edges were lost, and which option to change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from colmap_edges.errors import counted
from colmap_edges.options import PipelineOptions
from colmap_edges.report.findings import (
    MIN_VIEWS,
    Counts,
    Finding,
    images_findings,
    named,
    needed_views,
)
from colmap_edges.report.funnel import CHAIN_STEPS, counts_by_stage

CHECK_POSES = "check the poses (`colmap bundle_adjuster`); "
MASKS_REMEDY = (
    "check the masks: edges are detected only where masks are not black; invert them if they are "
    "the other way round, or leave out --mask_path"
)


def diagnose(stages: Sequence[Mapping[str, Any]], options: PipelineOptions) -> list[Finding]:
    """Find the steps at which a run lost edges.

    Args:
        stages: records of the stages, as in report.json.
        options: the options of the run.

    Returns:
        The findings in the order of the stages; empty if there is no problem.
    """
    counts = counts_by_stage(stages)
    findings = [*images_findings(counts.get("read", {}), options)]
    findings += detection_findings(counts.get("detect", {}), options)
    enough = counts.get("read", {}).get("images_with_poses", MIN_VIEWS) >= MIN_VIEWS
    if trace := counts.get("trace"):
        fits = poses_fit(counts.get("read", {}))
        if enough and counts.get("detect", {}).get("edge_pixels", 1):
            paper = options.tracing.method == "paper"
            findings += (paper_findings if paper else chain_findings)(trace, options, fits)
        if trace["edges"] == 0:
            findings += masks_findings(counts.get("detect", {}))
            findings.insert(0, no_edges(options, "mesh" in counts, bool(findings)))
    findings += residual_findings(counts.get("write", {}), counts.get("read", {}))
    if counts.get("mesh", {}).get("faces") == 0:
        findings.append(empty_mesh(counts["mesh"], options))
    if counts.get("mesh", {}).get("far_from_origin"):
        findings.append(far_mesh(options))
    return findings


def poses_fit(read: Counts) -> bool:
    """Whether SfM points reproject so closely that poses and cameras are not at fault."""
    residual = read.get("median_residual_px")
    return residual is not None and residual <= 1


def detection_findings(detect: Counts, options: PipelineOptions) -> Iterator[Finding]:
    """Findings about detection: images without edges, filtered chains."""
    images, empty = detect.get("images", 0), detect.get("images_without_edges", 0)
    if damaged := detect.get("damaged"):
        yield Finding(
            f"images that could not be read, {len(damaged)} of {images}, were left out: "
            f"{named(damaged)}",
            "replace the damaged files and run again",
        )
        images -= len(damaged)
    if images and empty == images and detect.get("edge_images"):
        yield Finding(
            f"no edge was found in the edge images of {counted(images, 'image')}",
            "check the edge images: white on black, lines of at least "
            "--Detection.min_chain_points; or leave out --edge_path",
        )
    elif images and empty == images and not detect.get("images_masked"):
        yield Finding(
            f"no edge was detected in any of {counted(images, 'image')}",
            "check the images (blank, blurred, dark?); detect shorter chains with "
            "--Detection.min_chain_points",
        )
    elif images and empty == images:
        yield Finding(
            f"no edge was detected in the unmasked parts of any of {counted(images, 'image')}",
            MASKS_REMEDY,
        )
    elif empty:
        yield Finding(
            f"images without any edge: {empty} of {images}",
            "check these images (blank, blurred, dark?)",
        )
    found, left = detect.get("chain_pixels", 0), detect.get("edge_pixels", 0)
    if options.edge_graph.filter_regular_length and left < 0.4 * found:
        yield Finding(
            f"{share(found - left, found)} of edge pixels were dropped with chains below the "
            "regular-length threshold",
            "set --EdgeGraph.filter_regular_length 0",
        )


def chain_findings(trace: Counts, options: PipelineOptions, fits: bool) -> Iterator[Finding]:
    """Findings about tracing by depths along chains; `fits` is the result of `poses_fit`."""
    views, lonely = trace.get("views", 0), trace.get("views_without_neighbors", 0)
    if views and lonely == views:
        yield Finding(
            "no two images see the same part of the scene from different positions",
            "check poses and overlap; for very wide baselines raise --ViewSelection.max_angle_deg",
        )
        return
    if lonely:
        yield Finding(
            f"images that overlap with no other, and gave no edges: {lonely} of {views}",
            "take images between them and the others, or raise --ViewSelection.max_angle_deg",
        )
    losses = chain_losses(options, fits)
    for step in CHAIN_STEPS:
        least, what, remedy = losses.get(step.after, (0.0, "", ""))
        start, left = trace.get(step.before, 0), trace.get(step.after, 0)
        if left < least * start:
            yield Finding(f"{share(start - left, start)} of {start:,} {what}", remedy)


def chain_losses(options: PipelineOptions, fits: bool) -> dict[str, tuple[float, str, str]]:
    """Share kept below which a step is reported, loss and remedy, by the count after it."""
    tracing, neighbors = options.tracing, options.view_selection.num_neighbors
    why = ", although the poses fit the SfM points: foliage and fine texture have no edges in space"
    poses, why = ("", why) if fits else (CHECK_POSES, "")
    views = f"{poses}compare more views with --ViewSelection.num_neighbors (now {neighbors})"
    return {
        "samples_with_depth": (
            0.1,
            f"samples on 2D edges found no depth that views agree on{why}",
            f"{views}, or allow larger errors with --ChainDepth.max_disagreement_px "
            f"(now {options.chain_depth.max_disagreement_px:g})",
        ),
        "samples_confirmed": (0.3, f"depths were not confirmed by another view{why}", views),
        "samples_in_runs": (
            0.3,
            "confirmed depths lie in runs that are too short or confirmed by too few views",
            f"lower --Tracing.min_agreeing_views (now {tracing.min_agreeing_views}) or "
            f"--ChainDepth.sample_step_points (now {options.chain_depth.sample_step_points})",
        ),
        "points_observed_enough": (
            0.4,
            "traced edge points are observed in too few views",
            f"lower --Tracing.min_observations (now {tracing.min_observations}), or take more "
            "overlapping images",
        ),
        "points_of_curves": (
            0.4,
            "edge points have uncertain depths, or lie on curves that may be accidental",
            "take images with wider baselines, or raise --Tracing.max_false_edges "
            f"(now {tracing.max_false_edges:g})",
        ),
    }


def paper_findings(trace: Counts, options: PipelineOptions, fits: bool) -> Iterator[Finding]:
    """Findings about the paper's correspondences; `fits` is the result of `poses_fit`."""
    pepcs, starts = trace.get("pepcs", {}), trace.get("starts", {})
    total = pepcs.get("pepcs_from_sfm_points", 0) + pepcs.get("pepcs_from_pecs", 0)
    if total == 0:
        yield Finding(
            "no 2D edge is near an SfM point, so no correspondence was found",
            "use --method chains, which needs no SfM points near edges",
        )
        return
    known = starts.get("on_covered_stretch", 0) + starts.get("on_known_edge", 0)
    tried, accepted = sum(starts.values()) - known, starts.get("accepted", 0)
    if tried and accepted < 0.02 * tried:
        found = ("accepted", "on_covered_stretch", "on_known_edge")
        reasons = {name: count for name, count in starts.items() if name not in found}
        remedies = {
            "too_few_views": "take more overlapping images, or use --method chains",
            "no_valid_selection": "raise --Following.max_error_px",
            "ambiguous_selection": "lower --Following.max_error_px",
        }
        worst = max(reasons, key=lambda name: reasons[name])
        yield Finding(
            f"{share(tried - accepted, tried)} of {counted(tried, 'start')} could not be "
            f"followed, mostly because of: {worst.replace('_', ' ')}",
            ("" if fits or worst != "no_valid_selection" else CHECK_POSES)
            + remedies.get(worst, "use --method chains"),
        )
    outliers = trace.get("outliers", {})
    before, after = outliers.get("points_before", 0), outliers.get("points_after", 0)
    if before and after < 0.4 * before:
        yield Finding(
            f"{share(before - after, before)} of {before:,} edge points are seen in fewer "
            f"than {outliers['min_views']:g} views",
            f"lower --Visibility.min_views (now {options.visibility.min_views}), or take "
            "more overlapping images",
        )


def no_edges(options: PipelineOptions, is_meshed: bool, has_reason: bool) -> Finding:
    """The first finding for a run without 3D edges; the others may give the reason."""
    text = "no 3D edge was found"
    text += ", so that the mesh consists of SfM points alone" if is_meshed else ""
    if has_reason:
        return Finding(text, "see the next note")
    return Finding(
        f"{text}: no candidate has {counted(options.tracing.min_curve_points, 'point')} seen "
        f"in {needed_views(options)[1]} views",
        f"lower {needed_views(options)[0]}",
    )


def far_mesh(options: PipelineOptions) -> Finding:
    """The finding that 32-bit coordinates would distort the mesh."""
    kept = {
        "PLY": "mesh.ply holds 64-bit ones",
        "OBJ": "mesh.obj holds all digits",
        "GLB": "mesh.glb holds them relative to an offset",
    }[options.mesh_type]
    return Finding(
        "the model lies so far from the origin that coordinates of 32 bits would distort the "
        f"mesh; {kept}, but some programs round them when they read them",
        "move the origin into the scene, for example with `colmap model_aligner` and its "
        "--alignment_type enu, and run again",
    )


def empty_mesh(mesh: Counts, options: PipelineOptions) -> Finding:
    """The finding for an empty mesh: the step that dropped most, and its option."""
    meshing = options.meshing
    found, long = mesh.get("boundary_facets", 0), mesh.get("long_facets_dropped", 0)
    if long and long >= found / 2:
        return Finding(
            "the mesh is empty: triangles with a side longer than "
            f"{meshing.long_facet_factor:g} distances to the cameras: {long:,} of {found:,}",
            "raise --Meshing.long_facet_factor, or set it to 0 to keep all; "
            "check the model for points far away from all others",
        )
    if found:
        return Finding(
            "the mesh is empty: triangles in connected components of fewer than "
            f"{meshing.min_component_faces:,}: {found - long:,} of {found:,}",
            "lower --Meshing.min_component_faces",
        )
    flag = "quality_weight" if meshing.method == "graphcut" else "vote_threshold"
    return Finding(
        "the mesh is empty: all cells were labelled alike; the viewing rays to "
        f"{counted(int(mesh.get('points', 0)), 'point')} have too little weight",
        f"lower --Meshing.{flag} (now {getattr(meshing, flag):g}); with a backdrop or "
        "background masks also try --Meshing.background_weight 0; give a model with more "
        "points, none of them far away from all others",
    )


def masks_findings(detect: Counts) -> Iterator[Finding]:
    """The finding about masks if edges were detected but no 3D edge was found."""
    images, masked = detect.get("images", 0), detect.get("images_masked", 0)
    if masked and detect.get("edge_pixels"):
        yield Finding(
            f"masks hide parts of the images in which no 3D edge was found: {masked} of {images}",
            MASKS_REMEDY,
        )


def residual_findings(write: Counts, read: Counts) -> Iterator[Finding]:
    """Findings about the residuals of the edges, compared with those of the SfM points."""
    residual, fits = write.get("median_residual_px"), poses_fit(read)
    if residual is not None and residual > 1:
        yield Finding(
            f"the median reprojection error of edges is {residual:.2f} px, which is large"
            + (f"; that of SfM points is {read['median_residual_px']:.2g} px" if fits else ""),
            "check the images for motion blur, rolling shutter and things that moved"
            if fits
            else "improve poses and cameras with `colmap bundle_adjuster` first",
        )


def share(part: float, whole: float) -> str:
    """`part` of `whole` in per cent."""
    return f"{100 * part / whole:.0f} %"
