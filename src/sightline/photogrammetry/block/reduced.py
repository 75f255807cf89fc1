"""Normal equations of a block, reduced to its global unknowns: poses first, or points first.

Every shot's own unknowns are independent of the other shots' but for the points they share. Where few
points are tracked through many shots, shots are eliminated one by one and a dense system of the points is
left; its cost is linear in the number of shots. Where points are many and tracks short, points are eliminated
one by one and a banded system of the shots is left.

Not here: how rows come about (``bundle_kernels.py``), iteration (``bundle.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dtrtri

from sightline.errors import EstimationError
from sightline.estimation.banded import BandedFactor
from sightline.geometry.checks import Array
from sightline.photogrammetry.block.bundle_kernels import couple, eliminate_points, taken_by_points
from sightline.photogrammetry.block.pose_unknowns import PoseUnknowns
from sightline.photogrammetry.sightings import Index

#: 1/m^2: what is known of a point beforehand (1000 km), so that a point on one ray alone stays solvable.
LOOSE = 1e-12
#: The same as a share of what is known of the point in all, well above rounding.
_RIDGE = 1e-13
#: Numbers kept at once while shots are eliminated.
_CHUNK = 4_000_000
#: Numbers up to which the eliminated shots are kept for further right-hand sides.
KEPT = 30_000_000


@dataclass(frozen=True, eq=False)
class Curvature:
    """J^T J of a block at one state, priors of points included, those of poses not.

    Attributes
    ----------
    rows : (N, 2, D + 3)
        Changes of the whitened sightings with x of their image and with their point.
    weight : (N,)
    image, point : (N,) int
    of_images : (M, D, D)
    of_points : (n, 3, 3)
    known_points : (n, 3, 3) or None
        The share of `of_points` that is known beforehand.
    """

    rows: Array
    weight: Array
    image: Index
    point: Index
    of_images: Array
    of_points: Array
    known_points: Array | None = None


def poses_first(curvature: Curvature, unknowns: PoseUnknowns) -> bool:
    """Whether eliminating shots first is the cheaper order (both costs in multiplications)."""
    if unknowns.precision is not None:
        return False
    points, own = len(curvature.of_points), unknowns.own
    span = _span(curvature, unknowns)
    dense = unknowns.shots * own * (3.0 * points) ** 2 + (3.0 * points) ** 3 / 3.0
    lengths = np.bincount(curvature.point, minlength=points).astype(np.float64)
    # a compiled loop does about a tenth of what a matrix product does in the same time
    banded = 10.0 * 108.0 * float((lengths**2).sum()) + unknowns.shots * own * (own * (span + 1.0)) ** 2
    return dense < banded


def _span(curvature: Curvature, unknowns: PoseUnknowns) -> int:
    """Most shots between the first and the last sighting of a point."""
    shot = unknowns.shot[curvature.image]
    last = np.full(len(curvature.of_points), -1)
    first = np.full(len(curvature.of_points), unknowns.shots)
    np.maximum.at(last, curvature.point, shot)
    np.minimum.at(first, curvature.point, shot)
    return max(int((last - first).max()), 0)


def _in_shots(of_images: Array, unknowns: PoseUnknowns) -> Array:
    """Blocks (M, D, D) of images as blocks (K, n D, n D) of shots."""
    k, n, d = unknowns.shots, unknowns.slots, unknowns.width
    out = np.zeros((k, n, d, n, d))
    out[unknowns.shot, unknowns.slot, :, unknowns.slot, :] = of_images
    return out.reshape(k, n * d, n * d)


class PosesFirst:
    """Shots eliminated first; a dense system of points and globals is left."""

    def __init__(self, curvature: Curvature, unknowns: PoseUnknowns) -> None:
        self._unknowns = unknowns
        shots, points = unknowns.shots, len(curvature.of_points)
        columns = 3 * points + unknowns.globals
        of_shots = _in_shots(curvature.of_images, unknowns)
        own = np.eye(unknowns.own) + np.swapaxes(unknowns.by_shot, 1, 2) @ of_shots @ unknowns.by_shot
        self._root = np.linalg.cholesky(own)
        inverse = np.linalg.inv(self._root)
        to_white = inverse @ np.swapaxes(unknowns.by_shot, 1, 2)
        by_global = of_shots @ unknowns.by_global
        reduced = np.zeros((columns, columns), order="F")
        kept = []
        order = np.argsort(unknowns.shot[curvature.image], kind="stable")
        shot_of = unknowns.shot[curvature.image][order]
        size = max(1, _CHUNK // (of_shots.shape[1] * columns))
        for begin in range(0, shots, size):
            end = min(begin + size, shots)
            rows = order[np.searchsorted(shot_of, begin) : np.searchsorted(shot_of, end)]
            coupling = np.zeros((end - begin, of_shots.shape[1], columns))
            place = np.stack([unknowns.shot - begin, unknowns.slot], axis=1)
            couple(
                curvature.rows[rows], curvature.weight[rows], curvature.image[rows], curvature.point[rows],
                place, unknowns.width, coupling,
            )  # fmt: skip
            shared = unknowns.by_global[begin:end]
            reduced[3 * points :, : 3 * points] += np.einsum(
                "kag,kap->gp", shared, coupling[:, :, : 3 * points], optimize=True
            )
            coupling[:, :, 3 * points :] = by_global[begin:end]
            white = to_white[begin:end] @ coupling
            flat = white.reshape(-1, columns)
            # a a^T of the transposed view is flat^T flat; only its lower half is made
            reduced = dsyrk(-1.0, flat.T, beta=1.0, c=reduced, lower=1, overwrite_c=1)
            if shots * white[0].size <= KEPT:
                kept.append(white)
        for axis in range(3):
            for other in range(axis + 1):
                at = 3 * np.arange(points)
                reduced[at + axis, at + other] += curvature.of_points[:, axis, other]
        diagonal = np.arange(3 * points)
        reduced[diagonal, diagonal] += LOOSE
        corner = np.einsum("kag,kah->gh", unknowns.by_global, by_global, optimize=True)
        corner += np.diag(unknowns.global_information)
        reduced[3 * points :, 3 * points :] += np.tril(corner)
        self._white = np.concatenate(kept) if kept else None
        try:
            self._points_root = np.linalg.cholesky(reduced[: 3 * points, : 3 * points])
        except np.linalg.LinAlgError:
            raise EstimationError(UNSOLVABLE) from None
        self._bridge = solve_triangular(
            self._points_root, reduced[3 * points :, : 3 * points].T, lower=True, check_finite=False
        )
        corner = np.tril(reduced[3 * points :, 3 * points :])
        corner = corner + np.tril(corner, -1).T
        self.information = corner - self._bridge.T @ self._bridge

    @property
    def reusable(self) -> bool:
        """Whether right-hand sides of later states can be solved too."""
        return self._white is not None

    def _whitened(self, shots: Array) -> Array:
        return np.linalg.solve(self._root, shots[..., None])[..., 0]

    def condense(self, shots: Array, points: Array, common: Array) -> Array:
        """Right-hand side (G,) left for the globals."""
        held, right = self._right(shots, points, common)
        inner = solve_triangular(self._points_root, right[:held], lower=True, check_finite=False)
        return np.asarray(right[held:] - self._bridge.T @ inner)

    def _right(self, shots: Array, points: Array, common: Array) -> tuple[int, Array]:
        """Right-hand side of points and globals once shots are eliminated, and how many belong to points."""
        assert self._white is not None
        right = np.concatenate([points.ravel(), common])
        right -= np.einsum("kac,ka->c", self._white, self._whitened(shots), optimize=True)
        return points.size, right

    def solve(self, shots: Array, points: Array, common: Array, step: Array) -> tuple[Array, Array]:
        """Steps (K, 6 n) and (n, 3) for right-hand sides, the globals having taken `step` (G,)."""
        assert self._white is not None
        held, right = self._right(shots, points, common)
        inner = solve_triangular(self._points_root, right[:held], lower=True, check_finite=False)
        moved = solve_triangular(
            self._points_root, inner - self._bridge @ step, lower=True, trans="T", check_finite=False
        )
        taken = self._white @ np.concatenate([moved, step])
        own = np.linalg.solve(np.swapaxes(self._root, 1, 2), (self._whitened(shots) - taken)[..., None])
        return own[..., 0], moved.reshape(-1, 3)

    def point_covariance(self, covariance: Array) -> Array:
        """Covariance (n, 3, 3) of the points, `covariance` (G, G) that of the globals."""
        root = np.asarray(dtrtri(self._points_root, lower=1)[0])
        points = len(root) // 3
        blocks = root.reshape(-1, points, 3)
        given = np.einsum("rna,rnb->nab", blocks, blocks, optimize=True)
        back = (root.T @ self._bridge).reshape(points, 3, -1)
        return given + back @ covariance @ np.swapaxes(back, 1, 2)


class PointsEliminated:
    """What is left of a block for shots and globals once its points are eliminated.

    `apart` (n,) bool: points whose sums are not made here, `taken` names them.
    """

    def __init__(
        self, curvature: Curvature, unknowns: PoseUnknowns, apart: NDArray[np.bool_] | None = None
    ) -> None:
        self._unknowns, self._curvature, self._apart = unknowns, curvature, apart
        self._inverse = invert_points(curvature.of_points)
        self._span = _span(self._near(), unknowns)
        tied = unknowns.precision
        #: Shots over which one is tied to another.
        self.reach = self._span if tied is None else max(self._span, tied.shape[1] - 1)

    def _near(self) -> Curvature:
        """Without the sightings of points that are apart; a copy, which is not kept."""
        return self._curvature if self._apart is None else _of_points(self._curvature, ~self._apart)

    def _blocks(self) -> Array:
        """(K, 1 + span, n D, n D): [k, s] has the rows of shot k, the columns of shot k - s."""
        unknowns, curvature = self._unknowns, self._near()
        width, slots, shots = unknowns.width, unknowns.slots, unknowns.shots
        blocks = np.zeros((shots, self._span + 1, slots * width, slots * width))
        blocks[:, 0] = _in_shots(curvature.of_images, unknowns)
        order, first = _by_point(curvature, unknowns)
        eliminate_points(
            curvature.rows[order], curvature.weight[order], first, curvature.image[order], unknowns.shot,
            unknowns.slot, _known_rows(curvature), width, blocks,
        )  # fmt: skip
        return blocks

    def assembled(self) -> tuple[Array, Array, Array]:
        """Normal equations: band (6 n (1 + reach), 6 n K), lower; border (K, 6 n, G); corner (G, G)."""
        shots, own = self._unknowns.shots, self._unknowns.own
        band = np.zeros((own * (self.reach + 1), shots * own))

        def place(step: int, there: Index, small: Array) -> None:
            for a in range(own):
                for b in range(a + 1 if step == 0 else own):
                    band[step * own + a - b, own * there + b] = small[:, a, b]

        border, corner = self.sums(place)
        return band, border, corner

    def sums(self, place: Callable[[int, Index, Array], None]) -> tuple[Array, Array]:
        """Border (K, 6 n, G) and corner (G, G); blocks of shots are given away step by step.

        `place` is called with a step, shots `there` and blocks (len(there), 6 n, 6 n), which have the rows of
        shots `there` + step and the columns of `there`.
        """
        unknowns, blocks, span = self._unknowns, self._blocks(), self._span
        width, slots, shots = unknowns.width, unknowns.slots, unknowns.shots
        border = np.zeros((shots, unknowns.own, unknowns.globals))
        corner = np.diag(unknowns.global_information)
        for step in range(self.reach + 1):
            here, there = np.arange(step, shots), np.arange(shots - step)
            block = blocks[step:, step] if step <= span else np.zeros((1, slots * width, slots * width))
            small = np.swapaxes(unknowns.by_shot[here], 1, 2) @ block @ unknowns.by_shot[there]
            small += unknowns.prior_block(step)
            place(step, there, small)
            if step > span:
                continue
            shared, moved = unknowns.by_global[here], unknowns.by_global[there]
            border[here] += np.swapaxes(unknowns.by_shot[here], 1, 2) @ block @ moved
            add = np.einsum("kag,kab,kbh->gh", shared, block, moved, optimize=True)
            corner = corner + add
            if step:
                border[there] += (
                    np.swapaxes(unknowns.by_shot[there], 1, 2) @ np.swapaxes(block, 1, 2) @ shared
                )
                corner = corner + add.T
        return border, corner

    def taken(self) -> tuple[Index, Index, Array]:
        """Image, point (N,) and factors (N, 3, D) of the sightings of points that are `apart`.

        Two sightings i and j of one point take factor_i^T factor_j from the block of their images.
        """
        width = self._unknowns.width
        assert self._apart is not None
        far = _of_points(self._curvature, self._apart)
        order, first = _by_point(far, self._unknowns)
        out = np.empty((len(order), 3, width))
        taken_by_points(far.rows[order], far.weight[order], first, _known_rows(far), width, out)
        return far.image[order], far.point[order], out

    def eliminate(self, shots: Array, points: Array, common: Array) -> tuple[Array, Array]:
        """Right-hand sides of shots (K, 6 n) and globals (G,) once points are eliminated."""
        held = np.einsum("nab,nb->na", self._inverse, points)
        taken = gather(self._unknowns, self._along(held))
        return shots - taken[0], common - taken[1]

    def _along(self, points: Array) -> Array:
        """E times `points` (n, 3): what they do to the departures (M, D) of the images."""
        c, width = self._curvature, self._unknowns.width
        seen = np.einsum("nka,na->nk", c.rows[:, :, width:], points[c.point]) * c.weight[:, None]
        pulled = np.einsum("nka,nk->na", c.rows[:, :, :width], seen)
        out = np.zeros((len(self._unknowns.shot), width))
        for a in range(width):
            out[:, a] = np.bincount(c.image, pulled[:, a], minlength=len(out))
        return out

    def points(self, points: Array, own_step: Array, step: Array) -> Array:
        """Steps (n, 3) of points for their right-hand sides, shots and globals having taken theirs."""
        c, width = self._curvature, self._unknowns.width
        departures = self._unknowns.departures(own_step, step)
        seen = np.einsum("nka,na->nk", c.rows[:, :, :width], departures[c.image]) * c.weight[:, None]
        pulled = np.einsum("nka,nk->na", c.rows[:, :, width:], seen)
        right = np.array(points)
        for a in range(3):
            right[:, a] -= np.bincount(c.point, pulled[:, a], minlength=len(right))
        return np.asarray(np.einsum("nab,nb->na", self._inverse, right))


class PointsFirst:
    """Points eliminated first; a banded system of the shots, bordered by the globals, is left."""

    reusable = True

    def __init__(self, curvature: Curvature, unknowns: PoseUnknowns) -> None:
        self._unknowns = unknowns
        self._left = PointsEliminated(curvature, unknowns)
        band, border, corner = self._left.assembled()
        try:
            self._factor = BandedFactor(band)
        except EstimationError:
            raise EstimationError(UNSOLVABLE) from None
        self._border = border.reshape(self._factor.n, -1)
        self._bridge = self._factor.solve(self._border)
        self.information = corner - self._border.T @ self._bridge

    def condense(self, shots: Array, points: Array, common: Array) -> Array:
        """Right-hand side (G,) left for the globals."""
        own, right = self._left.eliminate(shots, points, common)
        return np.asarray(right - self._bridge.T @ own.ravel())

    def solve(self, shots: Array, points: Array, common: Array, step: Array) -> tuple[Array, Array]:
        """Steps (K, 6 n) and (n, 3) for right-hand sides, the globals having taken `step` (G,)."""
        own, _ = self._left.eliminate(shots, points, common)
        solved = self._factor.solve(own.ravel())
        own_step = (solved - self._bridge @ step).reshape(shots.shape)
        return own_step, self._left.points(points, own_step, step)

    def form_covariance(self, covariance: Array, forms: Array) -> Array:
        """Covariance (M, D, n) of all departures with `forms` (M, D, n), weights of n sums of them.

        `covariance` (G, G) is that of the globals.
        """
        own, common = gather(self._unknowns, forms)
        flat = own.reshape(self._factor.n, -1)
        step = covariance @ (common - self._bridge.T @ flat)
        taken = self._factor.solve(flat) - self._bridge @ step
        return self._unknowns.departures(taken.reshape(own.shape), step)

    @cached_property
    def _inverse(self) -> Array:
        """Band of the inverse of the shots' equations: of each shot with itself and with the next."""
        return self._factor.inverse_band(2 * self._unknowns.own - 1)

    def departure_covariance(self, covariance: Array) -> Array:
        """Covariance (M, D, D) of the departure of each image, `covariance` (G, G) that of the globals."""
        u = self._unknowns
        own = u.own
        band = self._inverse
        inner = np.zeros((u.shots, own, own))
        at = own * np.arange(u.shots)
        for a in range(own):
            for b in range(a + 1):
                inner[:, a, b] = inner[:, b, a] = band[a - b, at + b]
        common = self._by_common()
        whole = u.by_shot @ inner @ np.swapaxes(u.by_shot, 1, 2)
        whole += common @ covariance @ np.swapaxes(common, 1, 2)
        split = whole.reshape(u.shots, u.slots, u.width, u.slots, u.width)
        return split[u.shot, u.slot, :, u.slot, :]

    def following_covariance(self, covariance: Array, count: int) -> Array | None:
        """Covariance (count - 1, D, D) of the first `count` images but the first (rows) with those before.

        `covariance` (G, G) is that of the globals. None where their shots are not solved one after the other.
        """
        u = self._unknowns
        if (np.diff(u.shot[:count]) != 1).any():
            return None
        own, before, after = u.own, u.shot[: count - 1], u.shot[1:count]
        later = np.empty((count - 1, own, own))
        for a in range(own):
            for b in range(own):
                later[:, a, b] = self._inverse[own + a - b, own * before + b]
        by_own, _ = u.of_images()
        common = self._by_common().reshape(u.shots, u.slots, u.width, -1)
        held, held_next = common[before, u.slot[: count - 1]], common[after, u.slot[1:count]]
        out = by_own[1:count] @ later @ np.swapaxes(by_own[: count - 1], 1, 2)
        return np.asarray(out + held_next @ covariance @ np.swapaxes(held, 1, 2))

    def _by_common(self) -> Array:
        """(K, n D, G): departures = by_shot (own, the globals known) + this times the globals."""
        u = self._unknowns
        return np.asarray(u.by_global - u.by_shot @ self._bridge.reshape(u.shots, u.own, -1))

    def point_covariance(self, covariance: Array) -> None:
        """Not kept in this order: triangulate the points with the poses found."""
        return None


def _of_points(curvature: Curvature, among: NDArray[np.bool_]) -> Curvature:
    """The sightings of some points; sums over images stay whole."""
    c, rows = curvature, among[curvature.point]
    return replace(c, rows=c.rows[rows], weight=c.weight[rows], image=c.image[rows], point=c.point[rows])


def _by_point(curvature: Curvature, unknowns: PoseUnknowns) -> tuple[Index, Index]:
    """Order (N,) of sightings by point and shot, and where those of each point (n + 1,) begin in it."""
    order = np.lexsort((unknowns.shot[curvature.image], curvature.point)).astype(np.intp)
    numbers = np.arange(len(curvature.of_points) + 1)
    return order, np.searchsorted(curvature.point[order], numbers).astype(np.intp)


def _known_rows(curvature: Curvature) -> Array:
    """Rows (n, m, 3) whose squares are what is known of points beforehand."""
    count = len(curvature.of_points)
    loose = np.broadcast_to(np.sqrt(LOOSE) * np.eye(3), (count, 3, 3))
    if curvature.known_points is None:
        return np.ascontiguousarray(loose)
    size, axes = np.linalg.eigh(curvature.known_points)
    rows = np.sqrt(np.maximum(size, 0.0))[:, :, None] * np.swapaxes(axes, 1, 2)
    return np.concatenate([rows, loose], axis=1)


def invert_points(of_points: Array) -> Array:
    """Inverses of blocks (n, 3, 3) of points, one ray's own (singular but for rounding) too."""
    ridge = LOOSE + _RIDGE * np.einsum("nii->n", of_points)
    return np.asarray(np.linalg.inv(of_points + ridge[:, None, None] * np.eye(3)), dtype=np.float64)


def gather(unknowns: PoseUnknowns, by_image: Array) -> tuple[Array, Array]:
    """Right-hand sides of the shots' own (K, 6 n, ...) and global (G, ...) unknowns.

    `by_image` (M, D, ...) is one of departures, or several beside each other.
    """
    shots, slots, width = unknowns.shots, unknowns.slots, unknowns.width
    stacked = np.zeros((shots, slots, *by_image.shape[1:]))
    stacked[unknowns.shot, unknowns.slot] = by_image
    flat = stacked.reshape(shots, slots * width, *by_image.shape[2:])
    own = np.einsum("kai,ka...->ki...", unknowns.by_shot, flat)
    return own, np.einsum("kag,ka...->g...", unknowns.by_global, flat, optimize=True)


UNSOLVABLE = (
    "the sightings do not tie the poses and points together (the normal equations are singular): points seen "
    "in two images or more are needed; check that matches, poses and [noise] belong together"
)
