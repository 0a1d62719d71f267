"""Sparse linear systems of the poses: block pattern, gauge prior, solvers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import bsr_array, csr_array, eye_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import LinearOperator, cg

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.poses.problem import Problem

FEW_FRAMES = 10  # number of frames up to which the system is solved as a dense one
NARROW_FRAMES = 100  # bandwidth, in frames, up to which the band solver is used


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior information on the poses: blocks + held core held^T.

    Attributes:
        blocks: (F, 6, 6) information on each frame.
        held: (6 F, K) common directions in which the model is fixed.
        core: (K, K) information in these directions.
    """

    blocks: FloatArray
    held: FloatArray
    core: FloatArray

    @classmethod
    def none(cls, num_frames: int) -> Prior:
        """No information."""
        held, core = np.zeros((6 * num_frames, 0)), np.zeros((0, 0))
        return cls(blocks=np.zeros((num_frames, 6, 6)), held=held, core=core)

    @property
    def diagonal(self) -> FloatArray:
        """(F, 6) diagonal of the information matrix."""
        held = np.einsum("ik,ik->i", self.held @ self.core, self.held).reshape(-1, 6)
        return np.asarray(np.einsum("fii->fi", self.blocks) + held)

    def product(self, moved: FloatArray) -> FloatArray:
        """(6 F,) the information times (6 F,) moves."""
        alone = np.einsum("fij,fj->fi", self.blocks, moved.reshape(-1, 6)).ravel()
        return np.asarray(alone + self.product_held(moved))

    def product_held(self, moved: FloatArray) -> FloatArray:
        """(6 F,) the common part, held core held^T, times (6 F,) moves."""
        return np.asarray(self.held @ (self.core @ (self.held.T @ moved)))


def shared_frames(problem: Problem) -> csr_array:
    """(F, F) pattern of frames that share points, with the diagonal; columns ascending."""
    measured, count = problem.measured, problem.num_frames
    ones = np.ones(len(measured.views), np.float32)
    frames = problem.frames[measured.views]
    incidence = csr_array((ones, frames, measured.offsets), (len(problem.kinds), count))
    shared = (incidence.T @ incidence + eye_array(count, dtype=np.float32)).tocsr()
    shared.sort_indices()
    return shared


def solve_poses(
    pattern: csr_array,
    own: FloatArray,
    shared: FloatArray,
    prior: Prior,
    right: FloatArray,
) -> FloatArray:
    """(F, 6) solution of the poses' system, by conjugate gradients unless frames are few.

    If frames share points only with few successive ones, as along a street, the preconditioner is
    the band Cholesky factor of the system without the common prior. Otherwise it is the block
    diagonal, which suffices if each frame shares points with many others.

    Args:
        pattern: frames that share points, with B entries.
        own: (F, 6, 6) blocks to be added to the diagonal.
        shared: (B, 6, 6) blocks of `pattern`; the diagonal is changed.
        prior: the prior, of which the common part is added, but not the blocks.
        right: (F, 6) right side.

    Raises:
        LinAlgError: if the system is not positive definite.
    """
    count, size = len(own), right.size
    rows = np.repeat(np.arange(count), np.diff(pattern.indptr))
    shared[pattern.indices == rows] += own
    system = bsr_array((shared, pattern.indices, pattern.indptr), (size, size))
    if count <= FEW_FRAMES:
        factor = cho_factor(system.toarray() + prior.held @ prior.core @ prior.held.T)
        return np.asarray(cho_solve(factor, right.ravel())).reshape(-1, 6)
    order = reverse_cuthill_mckee(pattern, symmetric_mode=True)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    width = int(np.abs(rank[rows] - rank[pattern.indices]).max())
    if width <= NARROW_FRAMES:
        precondition = band_solver(system, rank, rows, width)
    else:
        precondition = block_solver(shared[pattern.indices == rows], prior)

    def product(moved: FloatArray) -> FloatArray:
        return np.asarray(system @ moved) + prior.product_held(moved)

    solution, _ = cg(
        LinearOperator((size, size), matvec=product, dtype=np.float64),
        right.ravel(),
        rtol=1e-8,
        maxiter=1000,
        M=LinearOperator((size, size), matvec=precondition, dtype=np.float64),
    )
    return np.asarray(solution, np.float64).reshape(-1, 6)


def band_solver(
    system: bsr_array, rank: IntArray, rows: IntArray, width: int
) -> Callable[[FloatArray], FloatArray]:
    """A solver by the band Cholesky factor, with frames ordered by rank."""
    size = system.shape[0]
    band = np.zeros((6 * width + 6, size))
    inner = np.arange(6)
    down = (6 * rank[rows])[:, None, None] + inner[:, None]
    along = (6 * rank[system.indices])[:, None, None] + inner
    down, along = np.broadcast_arrays(down, along)
    lower = down >= along
    band[(down - along)[lower], along[lower]] = system.data[lower]
    factor = cholesky_banded(band, overwrite_ab=True, lower=True)
    places = (6 * rank[:, None] + inner).ravel()

    def solve(right: FloatArray) -> FloatArray:
        sorted_right = np.empty(size)
        sorted_right[places] = right
        return np.asarray(cho_solve_banded((factor, True), sorted_right)[places])

    return solve


def block_solver(diagonal: FloatArray, prior: Prior) -> Callable[[FloatArray], FloatArray]:
    """A solver of the diagonal blocks (F, 6, 6) with their part of the prior."""
    held = prior.held.reshape(len(diagonal), 6, -1)
    inverse = np.linalg.inv(np.linalg.cholesky(diagonal + held @ prior.core @ held.swapaxes(1, 2)))

    def solve(right: FloatArray) -> FloatArray:
        scaled = np.einsum("fij,fj->fi", inverse, right.reshape(-1, 6))
        return np.asarray(np.einsum("fij,fi->fj", inverse, scaled).ravel())

    return solve
