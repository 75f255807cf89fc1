"""Compiled sums over sightings: residuals, and the normal equations of poses and points.

x of an image is (turn of the body, move, stretch of the focal length) as in ``pose_unknowns.py``. Whitened
residual r = S (tangents - (1 + stretch) q_xy / q_z), S = px_per_tangent / sigma_px,
q = C^T exp(-[w]x) R^T (X - position - move). Weights multiply what a sighting adds to the sums.

Not here: what is solved from the sums (``reduce_poses.py``, ``reduce_points.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.geometry.checks import Array
from sightline.photogrammetry.sightings import Index


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sight(
    point: Array,
    tangents: Array,
    scale: Array,
    position: Array,
    camera_from_world: Array,
    turn_in_camera: Array,
    x: Array,
    r: Array,
    by_x: Array,
) -> None:
    """Residual r (2) and its change -by_x (2, D) with x of one sighting; a move of the point is its reverse.

    ``camera_from_world`` is C^T exp(-[w]x) R^T; ``turn_in_camera`` is C^T J, J the right Jacobian of the
    rotation vector w: q changes by q x (C^T J dw).
    """
    d0 = point[0] - position[0] - x[3]
    d1 = point[1] - position[1] - x[4]
    d2 = point[2] - position[2] - x[5]
    m, j = camera_from_world, turn_in_camera
    q0 = m[0, 0] * d0 + m[0, 1] * d1 + m[0, 2] * d2
    q1 = m[1, 0] * d0 + m[1, 1] * d1 + m[1, 2] * d2
    q2 = m[2, 0] * d0 + m[2, 1] * d1 + m[2, 2] * d2
    # not its logarithm: over flat ground seen from above, focal length and heights grow in one straight line
    stretched = 1.0 + x[6] if len(x) > 6 else 1.0
    inverse = stretched / q2
    u, v = q0 * inverse, q1 * inverse
    a0, a1 = tangents[0] - u, tangents[1] - v
    for k in range(2):
        r[k] = scale[k, 0] * a0 + scale[k, 1] * a1
        g0, g1 = scale[k, 0] * inverse, scale[k, 1] * inverse
        g2 = -(g0 * q0 + g1 * q1) / q2
        c0, c1, c2 = g1 * q2 - g2 * q1, g2 * q0 - g0 * q2, g0 * q1 - g1 * q0
        for i in range(3):
            by_x[k, i] = c0 * j[0, i] + c1 * j[1, i] + c2 * j[2, i]
            by_x[k, 3 + i] = -(g0 * m[0, i] + g1 * m[1, i] + g2 * m[2, i])
        if len(x) > 6:
            by_x[k, 6] = (scale[k, 0] * u + scale[k, 1] * v) / stretched


@njit(cache=True, nogil=True, error_model="numpy")
def gradients(
    points: Array,
    image: Index,
    point: Index,
    pose: Index,
    tangents: Array,
    scale: Array,
    position: Array,
    camera_from_world: Array,
    turn_in_camera: Array,
    x: Array,
    weight: Array,
    r: Array,
    by_image: Array,
    by_point: Array,
) -> None:
    """Adds J^T r to `by_image` (M, D) and `by_point` (n, 3), and gives the whitened residuals r (N, 2)."""
    by_x = np.empty((2, x.shape[1]))
    for i in range(len(image)):
        m, n = image[i], point[i]
        _sight(points[n], tangents[i], scale[i], position[pose[i]], camera_from_world[pose[i]],
               turn_in_camera[m], x[m], r[i], by_x)  # fmt: skip
        for k in range(2):
            pull = weight[i] * r[i, k]
            for a in range(x.shape[1]):
                by_image[m, a] += by_x[k, a] * pull
            for a in range(3):
                by_point[n, a] -= by_x[k, 3 + a] * pull


@njit(cache=True, nogil=True, error_model="numpy")
def curvatures(
    points: Array,
    image: Index,
    point: Index,
    pose: Index,
    tangents: Array,
    scale: Array,
    position: Array,
    camera_from_world: Array,
    turn_in_camera: Array,
    x: Array,
    weight: Array,
    r: Array,
    of_images: Array,
    of_points: Array,
    rows: Array,
) -> None:
    """Adds J^T J to `of_images` (M, D, D) and `of_points` (n, 3, 3); J of each sighting goes to `rows`.

    rows (N, 2, D + 3): changes of the predicted, whitened sighting with x of its image and with the point.
    """
    width = x.shape[1]
    for i in range(len(image)):
        m, n = image[i], point[i]
        _sight(points[n], tangents[i], scale[i], position[pose[i]], camera_from_world[pose[i]],
               turn_in_camera[m], x[m], r[i], rows[i])  # fmt: skip
        for k in range(2):
            for a in range(3):
                rows[i, k, width + a] = -rows[i, k, 3 + a]
            for a in range(width):
                scaled = weight[i] * rows[i, k, a]
                for b in range(a + 1):
                    of_images[m, a, b] += scaled * rows[i, k, b]
            for a in range(3):
                scaled = weight[i] * rows[i, k, 3 + a]
                for b in range(a + 1):
                    of_points[n, a, b] += scaled * rows[i, k, 3 + b]
    for m in range(len(of_images)):
        for a in range(width):
            for b in range(a):
                of_images[m, b, a] = of_images[m, a, b]
    for n in range(len(of_points)):
        for a in range(3):
            for b in range(a):
                of_points[n, b, a] = of_points[n, a, b]


@njit(cache=True, nogil=True, error_model="numpy")
def statistics(
    rows: Array,
    weight: Array,
    point: Index,
    inverse: Array,
    r: Array,
    seen: float,
    out: Array,
    checked: Array,
    freedom: Array,
) -> None:
    """Squared residual over its expectation of each sighting, and whether both its directions are checked.

    Parameters
    ----------
    rows : (N, 2, D + 3); weight : (N,); point : (N,); r : (N, 2)
    inverse : (n, 3, 3)
        Covariance of each point, the poses given: what a sighting adds to its own point is its leverage.
    seen : float
        Share of a residual's variance below which a direction of it says nothing.
    out, checked, freedom : (N,)
        Results; `checked` is 0 or 1, `freedom` the squared residual that is expected of variance 1.
    """
    width = rows.shape[2] - 3
    for i in range(len(r)):
        n = point[i]
        h00, h01, h11 = 0.0, 0.0, 0.0
        for a in range(3):
            for b in range(3):
                v = inverse[n, a, b]
                h00 += rows[i, 0, width + a] * v * rows[i, 0, width + b]
                h01 += rows[i, 0, width + a] * v * rows[i, 1, width + b]
                h11 += rows[i, 1, width + a] * v * rows[i, 1, width + b]
        # the residual of a sighting that counts is smaller than its error, that of one left out larger
        sign = 1.0 - 2.0 * weight[i]
        s00, s01, s11 = 1.0 + sign * h00, sign * h01, 1.0 + sign * h11
        middle, half = 0.5 * (s00 + s11), np.hypot(0.5 * (s00 - s11), s01)
        high, low = middle + half, middle - half
        angle = 0.5 * np.arctan2(2.0 * s01, s00 - s11)
        along = np.cos(angle) * r[i, 0] + np.sin(angle) * r[i, 1]
        across = np.cos(angle) * r[i, 1] - np.sin(angle) * r[i, 0]
        out[i] = 0.0
        if high > seen:
            out[i] += along * along / high
        if low > seen:
            out[i] += across * across / low
        checked[i] = 1 if low > seen else 0
        freedom[i] = s00 + s11


@njit(cache=True, nogil=True, error_model="numpy")
def couple(
    rows: Array, weight: Array, image: Index, point: Index, place: Index, width: int, out: Array
) -> None:
    """Adds the coupling of poses and points, J_x^T J_point, of sightings to `out` (K, n D, 3 n_points).

    `place` (M, 2) gives the row of the shot in `out` and the slot of each image.
    """
    for i in range(len(image)):
        k, first = place[image[i], 0], width * place[image[i], 1]
        column = 3 * point[i]
        for a in range(width):
            for b in range(3):
                out[k, first + a, column + b] += weight[i] * (
                    rows[i, 0, a] * rows[i, 0, width + b] + rows[i, 1, a] * rows[i, 1, width + b]
                )


@njit(cache=True, nogil=True, error_model="numpy")
def _take(
    rows: Array, weight: Array, begin: int, count: int, known: Array, width: int, basis: Array, taken: Array
) -> None:
    """Part Q^T A (count, 3, D) of the sightings' rows A that their point takes; `basis` is scratch."""
    extra = len(known)
    size = 2 * count + extra
    for i in range(count):
        root = np.sqrt(weight[begin + i])
        for c in range(2):
            for b in range(3):
                basis[2 * i + c, b] = root * rows[begin + i, c, width + b]
    for i in range(extra):
        for b in range(3):
            basis[2 * count + i, b] = known[i, b]
    for b in range(3):
        for _ in range(2):
            for a in range(b):
                along = 0.0
                for i in range(size):
                    along += basis[i, a] * basis[i, b]
                for i in range(size):
                    basis[i, b] -= along * basis[i, a]
        length = 0.0
        for i in range(size):
            length += basis[i, b] ** 2
        length = np.sqrt(length)
        for i in range(size):
            basis[i, b] /= length
    for i in range(count):
        row, root = rows[begin + i], np.sqrt(weight[begin + i])
        for b in range(3):
            for a in range(width):
                taken[i, b, a] = root * (basis[2 * i, b] * row[0, a] + basis[2 * i + 1, b] * row[1, a])


@njit(cache=True, nogil=True, error_model="numpy")
def taken_by_points(rows: Array, weight: Array, first: Index, known: Array, width: int, out: Array) -> None:
    """What points that are free take from the poses, as factors: E V^-1 E^T of i and j is out_i^T out_j.

    Arguments as of `eliminate_points`; `out` is (N, 3, D), of each sighting.
    """
    most = 0
    for n in range(len(first) - 1):
        most = max(most, first[n + 1] - first[n])
    basis = np.empty((2 * most + known.shape[1], 3))
    for n in range(len(first) - 1):
        count = first[n + 1] - first[n]
        _take(rows, weight, first[n], count, known[n], width, basis, out[first[n] : first[n + 1]])


@njit(cache=True, nogil=True, error_model="numpy")
def eliminate_points(
    rows: Array,
    weight: Array,
    first: Index,
    image: Index,
    shot: Index,
    slot: Index,
    known: Array,
    width: int,
    out: Array,
) -> None:
    """Subtracts what points that are free take from the poses: E V^-1 E^T, block by block of shots.

    Parameters
    ----------
    rows : (N, 2, D + 3); weight : (N,)
        Of sightings sorted by point, and within a point by shot.
    first : (n + 1,)
        Where the sightings of each point begin.
    image : (N,); shot, slot : (M,)
    known : (n, m, 3)
        Rows of what is known of each point beforehand; together of rank 3.
    out : (K, 1 + span, n D, n D)
        out[k, s]: rows of shot k, columns of shot k - s.

    Notes
    -----
    By an orthogonal basis Q of the points' columns, orthogonalised twice: E V^-1 E^T = (Q^T A)^T (Q^T A).
    Short tracks know a point's depth some hundred times worse than its direction, and what is left for the
    poses as a whole is smaller again: inverting V, whose condition is the square of that, would drown it.
    """
    extra = known.shape[1]
    most = 0
    for n in range(len(first) - 1):
        most = max(most, first[n + 1] - first[n])
    basis = np.empty((2 * most + extra, 3))
    taken = np.empty((most, 3, width))
    for n in range(len(first) - 1):
        count = first[n + 1] - first[n]
        _take(rows, weight, first[n], count, known[n], width, basis, taken)
        for i in range(count):
            mi = image[first[n] + i]
            ki, oi = shot[mi], width * slot[mi]
            for j in range(count):
                mj = image[first[n] + j]
                step = ki - shot[mj]
                if step < 0:
                    continue
                oj = width * slot[mj]
                for a in range(width):
                    for b in range(width):
                        out[ki, step, oi + a, oj + b] -= (
                            taken[i, 0, a] * taken[j, 0, b] + taken[i, 1, a] * taken[j, 1, b]
                            + taken[i, 2, a] * taken[j, 2, b]
                        )  # fmt: skip
