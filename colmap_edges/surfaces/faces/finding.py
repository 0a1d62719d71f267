"""Detection of planar faces: planes from edges, labels in views, agreement of views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Int32Array, IntArray
from colmap_edges.core.checks import check_arrays, check_values
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.errors import check_type
from colmap_edges.images.files import square
from colmap_edges.surfaces.bodies import Body, within
from colmap_edges.surfaces.faces.decision import (
    MIN_PLAIN,
    Samples,
    are_believed,
    are_overexposed,
    are_plain,
    points_of_samples,
    sample_cells,
    thinned,
)
from colmap_edges.surfaces.faces.enclosure import are_enclosed, backdrops
from colmap_edges.surfaces.faces.evidence import Evidence, gather_evidence, joined
from colmap_edges.surfaces.faces.faint_lines import find_faint_lines
from colmap_edges.surfaces.faces.grids import (
    CELL_PX,
    Grid,
    blank_grid,
    cell_offsets,
    doubled,
    halved,
)
from colmap_edges.surfaces.faces.hypotheses import Planes, find_planes
from colmap_edges.surfaces.faces.labelling import (
    EvidenceWeights,
    evidence_arrays,
    label_cells,
    make_scene,
    refine_labels,
    split_by_view,
)
from colmap_edges.surfaces.faces.outlines import Face, outline_faces
from colmap_edges.surfaces.round_face import RoundFace

NUM_ROUNDS = 2  # rounds of labelling: first without, then with agreement between views


@dataclass(frozen=True, kw_only=True)
class Faces:
    """Planar and round faces of a scene.

    Attributes:
        faces: the faces, each a connected piece of a plane.
        points: N points on planar faces with observing views.
        face_ids: (N,) the planar face on which each of them lies.
        num_planes: number of plane hypotheses.
        num_cells: number of cells in all views.
        num_labelled: number of cells labelled with a plane.
        num_believed: number of labelled cells accepted by the agreement of views.
        round_faces: faces of revolution.
        round_points: points on them with observing views.
    """

    faces: list[Face]
    points: SeenPoints
    face_ids: Annotated[IntArray, "N"]
    num_planes: int
    num_cells: int
    num_labelled: int
    num_believed: int
    round_faces: list[RoundFace] = field(default_factory=list)
    round_points: SeenPoints = NO_POINTS

    def check(self, name: str = "faces", num_views: int | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_type(f"{name}.faces", self.faces, (list,))
        for index, face in enumerate(self.faces):
            check_type(f"{name}.faces[{index}]", face, (Face,))
        check_type(f"{name}.points", self.points, (SeenPoints,))
        self.points.check(f"{name}.points", num_views)
        check_arrays(name, self, N=len(self.points.points))
        check_values(f"{name}.face_ids", self.face_ids, 0, len(self.faces) - 1)
        check_type(f"{name}.round_points", self.round_points, (SeenPoints,))
        self.round_points.check(f"{name}.round_points", num_views)

    @property
    def area(self) -> float:
        """Of all faces together, square world units."""
        return float(sum(face.area for face in self.faces))


NO_FACES = Faces(
    faces=[],
    points=NO_POINTS,
    face_ids=np.zeros(0, np.int64),
    num_planes=0,
    num_cells=0,
    num_labelled=0,
    num_believed=0,
)


def find_faces(
    model: Model,
    edges: Edges3D,
    grids: Mapping[int, Grid],
    random_seed: int,
    num_threads: int,
    bodies: Sequence[Body] = (),
) -> Faces:
    """Find the planar faces between 3D edges and SfM points.

    Where points are on nearly all faces, the mesh has them already; overexposed images do not show
    what lies on a face. Then the mesh gets no points of faces, and those of a first labelling are
    returned.

    Args:
        model: gives the V views and the SfM points.
        edges: its 3D edges.
        grids: small pictures of the views by their index; views without one show nothing.
        random_seed: of the random choice of hypotheses.
        num_threads: threads; the result does not depend on them.
        bodies: what views see that is not background; there are no faces before it.
    """
    finer = [grids.get(v) or blank_grid(view) for v, view in enumerate(model.views)]
    pictures = [halved(picture) for picture in finer]
    evidence = gather_evidence(model, edges)
    planes = find_planes(evidence, model.camera_centers, np.random.default_rng(random_seed))
    if not len(planes.offsets):
        return NO_FACES
    # Gray is not compared yet, which takes the most time: any plane near the true one will do.
    weights = EvidenceWeights(correlation=0.0)
    given = (model, pictures, bodies, num_threads)
    first = label_scene(*given, evidence, planes, 1, weights)
    plain = are_plain(first.samples, model.views, pictures, evidence)[first.accepted]
    seen = (first.samples, first.accepted, first.planes, model.views, pictures, evidence)
    if not len(plain) or plain.mean() < MIN_PLAIN or are_overexposed(*seen):
        return first.faces(NO_FACES.points, NO_FACES.face_ids)
    before_backdrop = any(shown.any() for shown in backdrops(pictures))
    if not before_backdrop:
        # On objects before a backdrop, faint lines are shades of round bodies.
        labels = first.accepted_labels()
        evidence = joined(evidence, find_faint_lines(model, pictures, labels, first.planes))
        planes = find_planes(evidence, model.camera_centers, np.random.default_rng(random_seed))
    # With small cells, a ground as gray as the backdrop may be continued over it.
    small = None if before_backdrop else finer
    last = label_scene(*given, evidence, planes, NUM_ROUNDS, EvidenceWeights(), small)
    chosen = last.chosen()
    points = points_of_samples(last.samples, chosen, model.views, last.pictures)
    return last.faces(points, last.face_ids[chosen])


@dataclass(frozen=True, kw_only=True)
class LabelledScene:
    """Planes, labels of all views' cells with them, and what was accepted of these.

    Attributes:
        pictures: the views as small pictures.
        side: cells along a side of those that were labelled first.
        planes: the plane hypotheses.
        labels: of the cells of all views, -1 where there is no plane.
        samples: S places that labelled cells see.
        outlined: the faces that accepted samples lie on.
        face_ids: (S,) the face of each sample, -1 for those that are not accepted.
    """

    pictures: Sequence[Grid]
    side: int
    planes: Planes
    labels: Int32Array
    samples: Samples
    outlined: list[Face]
    face_ids: IntArray

    @property
    def accepted(self) -> IntArray:
        """Indices of the accepted samples."""
        return np.flatnonzero(self.face_ids >= 0)

    def chosen(self) -> IntArray:
        """Indices of accepted samples for the mesh, denser where small cells end at others."""
        near = np.zeros(len(self.samples.points), bool)
        if self.side > 1:
            borders = map(at_borders, split_by_view(self.labels, self.pictures))
            near = np.concatenate([of.ravel() for of in borders])[self.cells]
        return thinned(self.samples, self.accepted, near, self.side)

    @property
    def cells(self) -> IntArray:
        """(S,) cells of the samples, among those of all views."""
        own = self.samples.views[self.samples.offsets[:-1]]
        cells: IntArray = cell_offsets(self.pictures)[own] + self.samples.cells
        return cells

    def accepted_labels(self) -> list[Int32Array]:
        """(rows, columns) labels of each view, -1 also where they are not accepted."""
        cells = self.cells[self.accepted]
        labels = np.full_like(self.labels, -1)
        labels[cells] = self.labels[cells]
        return split_by_view(labels, self.pictures)

    def faces(self, points: SeenPoints, face_ids: IntArray) -> Faces:
        """The accepted faces, and points on them."""
        return Faces(
            faces=self.outlined,
            points=points,
            face_ids=face_ids,
            num_planes=len(self.planes.offsets),
            num_cells=self.labels.size,
            num_labelled=int(np.sum(self.labels >= 0)),
            num_believed=len(self.accepted),
        )


def label_scene(
    model: Model,
    pictures: Sequence[Grid],
    bodies: Sequence[Body],
    num_threads: int,
    evidence: Evidence,
    planes: Planes,
    num_rounds: int,
    weights: EvidenceWeights,
    finer: Sequence[Grid] | None = None,
) -> LabelledScene:
    """Label the cells of all views with planes, and accept what views agree on.

    `finer` are the pictures with cells half as large, in which borders of labels are refined.
    """
    known = evidence_arrays(evidence, planes, len(model.views))
    scene = make_scene(model, pictures, known, num_threads)
    labels, side = label_cells(scene, num_rounds, num_threads, weights), 1
    if finer is not None:
        side = 2
        labels, pictures = doubled(labels, pictures, finer), finer
        scene = make_scene(model, pictures, known, num_threads)
        labels = refine_labels(scene, labels, num_threads, weights)
    angles = np.array([CELL_PX / picture.focal_px for picture in pictures])
    samples = sample_cells(scene, labels, model.camera_centers, angles, num_threads)
    believed = are_believed(samples)
    believed &= are_enclosed(scene, samples, labels, pictures, num_threads, side)
    rows = np.flatnonzero(believed)
    rows = rows[within(bodies, samples.points[rows])]
    faces, face_ids = outline_faces(samples, rows, planes, model.camera_centers)
    return LabelledScene(
        pictures=pictures,
        side=side,
        planes=planes,
        labels=labels,
        samples=samples,
        outlined=faces,
        face_ids=face_ids,
    )


def at_borders(labels: Int32Array) -> BoolArray:
    """(rows, columns) whether one of the eight cells around a cell has another label, or none."""
    of, around = labels.astype(np.float32), square(1)
    return np.asarray((cv2.dilate(of, around) > of) | (cv2.erode(of, around) < of))
