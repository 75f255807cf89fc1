"""Compiled loops of ``triangulate.py``: one point after another, over its sightings.

Not here: which sightings belong together, and what poses are (``triangulate.py``).
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np

from sightline.compiled import njit

#: Gauss-Newton steps at most; rays that meet converge in three or four.
_STEPS = 12
#: Steps below this part of the distance are rounding.
_DONE = 1e-11
#: A point whose distance is known worse than to this part is not found.
_FAR = 1.0 / 3.0


@njit(cache=True, nogil=True)
def _inverse(a, out):
    """Inverse of a symmetric 3 x 3; False where it has none."""
    c0 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c1 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c2 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c0 + a[0, 1] * c1 + a[0, 2] * c2
    # rounding of the products above
    scale = a[0, 0] * a[1, 1] * a[2, 2]
    if not det > 1e-15 * scale:
        return False
    out[0, 0] = c0 / det
    out[0, 1] = out[1, 0] = c1 / det
    out[0, 2] = out[2, 0] = c2 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = out[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det
    return True


@njit(cache=True, nogil=True)
def _rows_of(q, weighed, out):
    """Change (2, 3) of weighed pixels with a point's camera coordinates `q`."""
    tx, ty = q[0] / q[2], q[1] / q[2]
    for i in range(2):
        out[i, 0] = weighed[i, 0] / q[2]
        out[i, 1] = weighed[i, 1] / q[2]
        out[i, 2] = -(weighed[i, 0] * tx + weighed[i, 1] * ty) / q[2]


@njit(cache=True, nogil=True)
def _start(rows, pose, tangents, turned, place, x):
    """The point nearest to all rays; False where they are parallel."""
    a, b, inverse = np.zeros((3, 3)), np.zeros(3), np.empty((3, 3))
    origin = place[pose[rows[0]]]
    d = np.empty(3)
    for s in rows:
        m = turned[pose[s]]
        norm = np.sqrt(1.0 + tangents[s, 0] ** 2 + tangents[s, 1] ** 2)
        along = 0.0
        for i in range(3):
            d[i] = (m[0, i] * tangents[s, 0] + m[1, i] * tangents[s, 1] + m[2, i]) / norm
            along += d[i] * (place[pose[s], i] - origin[i])
        for i in range(3):
            b[i] += place[pose[s], i] - origin[i] - d[i] * along
            a[i, i] += 1.0
            for j in range(3):
                a[i, j] -= d[i] * d[j]
    if not _inverse(a, inverse):
        return False
    for i in range(3):
        x[i] = origin[i] + inverse[i, 0] * b[0] + inverse[i, 1] * b[1] + inverse[i, 2] * b[2]
    return True


@njit(cache=True, nogil=True)
def _step(rows, pose, tangents, weighed, turned, place, x, a, b):
    """Normal equations `a`, `b` of one point at `x`; its distance, or NaN where a camera has it behind."""
    a[:] = 0.0
    b[:] = 0.0
    q, by_q, by_x = np.empty(3), np.empty((2, 3)), np.empty((2, 3))
    distance = 0.0
    for s in rows:
        m, c = turned[pose[s]], place[pose[s]]
        for i in range(3):
            q[i] = m[i, 0] * (x[0] - c[0]) + m[i, 1] * (x[1] - c[1]) + m[i, 2] * (x[2] - c[2])
        if not q[2] > 0.0:
            return np.nan
        distance += np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2) / len(rows)
        _rows_of(q, weighed[s], by_q)
        miss_x, miss_y = tangents[s, 0] - q[0] / q[2], tangents[s, 1] - q[1] / q[2]
        for i in range(2):
            miss = weighed[s, i, 0] * miss_x + weighed[s, i, 1] * miss_y
            for j in range(3):
                by_x[i, j] = by_q[i, 0] * m[0, j] + by_q[i, 1] * m[1, j] + by_q[i, 2] * m[2, j]
                b[j] += by_x[i, j] * miss
        for i in range(3):
            for j in range(3):
                a[i, j] += by_x[0, i] * by_x[0, j] + by_x[1, i] * by_x[1, j]
    return distance


@njit(cache=True, nogil=True)
def _meets(rows, pose, tangents, weighed, turned, place, x, inverse):
    """Point `x` and the inverse of its normal equations; False where there is none."""
    if len(rows) < 2 or not _start(rows, pose, tangents, turned, place, x):
        return False
    a, b = np.empty((3, 3)), np.empty(3)
    for _ in range(_STEPS):
        distance = _step(rows, pose, tangents, weighed, turned, place, x, a, b)
        if not np.isfinite(distance) or not _inverse(a, inverse):
            return False
        size = 0.0
        for i in range(3):
            move = inverse[i, 0] * b[0] + inverse[i, 1] * b[1] + inverse[i, 2] * b[2]
            x[i] += move
            size += move * move
        if size <= (_DONE * distance) ** 2:
            break
    else:
        if size > (1e-6 * distance) ** 2:
            return False
    worst = inverse[0, 0] + inverse[1, 1] + inverse[2, 2]
    return worst <= (_FAR * distance) ** 2


@njit(cache=True, nogil=True)
def meet(begin, order, pose, tangents, weighed, turned, place, points, inverse):
    """Points (n, 3) that `order[begin[i]:begin[i + 1]]` see, and inverse normal equations (n, 3, 3).

    pose (N,), tangents (N, 2), weighed (N, 2, 2) pixels per tangent over sigma; turned (P, 3, 3)
    camera_from_world and place (P, 3) of the poses. NaN where there is no point.
    """
    for i in range(len(points)):
        rows = order[begin[i] : begin[i + 1]]
        if not _meets(rows, pose, tangents, weighed, turned, place, points[i], inverse[i]):
            points[i] = np.nan
            inverse[i] = np.nan


@njit(cache=True, nogil=True)
def _gains(m, c, mount, weighed, x, inverse, work, move, turn):
    """How much a point moves (3, 3) by its camera's move (world axes) and its turn (body axes).

    m, c: camera_from_world and place of the pose; `work` (4, 3, 3) is overwritten.
    """
    q, v, by_q, by_x, gain = work[0, 0], work[0, 1], work[1], work[2], work[3]
    for i in range(3):
        q[i] = m[i, 0] * (x[0] - c[0]) + m[i, 1] * (x[1] - c[1]) + m[i, 2] * (x[2] - c[2])
    for i in range(3):
        v[i] = mount[i, 0] * q[0] + mount[i, 1] * q[1] + mount[i, 2] * q[2]
    _rows_of(q, weighed, by_q)
    for i in range(2):
        for j in range(3):
            by_x[i, j] = by_q[i, 0] * m[0, j] + by_q[i, 1] * m[1, j] + by_q[i, 2] * m[2, j]
    for i in range(3):
        for k in range(2):
            gain[i, k] = inverse[i, 0] * by_x[k, 0] + inverse[i, 1] * by_x[k, 1] + inverse[i, 2] * by_x[k, 2]
    for k in range(2):
        # rows by the point in body axes; turned by w the body sees v + v x w
        a = by_q[k, 0] * mount[0, 0] + by_q[k, 1] * mount[0, 1] + by_q[k, 2] * mount[0, 2]
        b = by_q[k, 0] * mount[1, 0] + by_q[k, 1] * mount[1, 1] + by_q[k, 2] * mount[1, 2]
        e = by_q[k, 0] * mount[2, 0] + by_q[k, 1] * mount[2, 1] + by_q[k, 2] * mount[2, 2]
        by_q[k, 0], by_q[k, 1], by_q[k, 2] = b * v[2] - e * v[1], e * v[0] - a * v[2], a * v[1] - b * v[0]
    for i in range(3):
        for j in range(3):
            move[i, j] = gain[i, 0] * by_x[0, j] + gain[i, 1] * by_x[1, j]
            turn[i, j] = -gain[i, 0] * by_q[0, j] - gain[i, 1] * by_q[1, j]


@njit(cache=True, nogil=True)
def _add_product(a, b, out):
    """Add a (3, 3) times b (3, 3) to `out`."""
    for i in range(3):
        for j in range(3):
            out[i, j] += a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True, nogil=True)
def _add_square(a, factor, out):
    """Add `factor` times a (3, 3) a' to `out`."""
    for i in range(3):
        for j in range(3):
            out[i, j] += factor * (a[i, 0] * a[j, 0] + a[i, 1] * a[j, 1] + a[i, 2] * a[j, 2])


@njit(cache=True, nogil=True)
def spread(
    begin, order, pose, image, camera, weighed, turned, place, mounts, points, inverse,
    sigma_position, sigma_attitude, partner, sway, angle_covariance, covariance,
):  # fmt: skip
    """Add to `covariance` (n, 3, 3) what unknown poses do to points found by `meet`.

    image (N,), camera (M,), mounts (C, 3, 3) body_from_camera; sigma of each image's position (m, per axis)
    and attitude (rad, per axis); partner (M,) the image whose attitude goes with this one's position, -1 for
    none, sway (M, 2, 3, 3) rad/m; angle_covariance (3C, 3C).
    """
    at = np.full(len(camera), -1)
    longest = 0
    for i in range(len(points)):
        longest = max(longest, begin[i + 1] - begin[i])
    move, turn = np.empty((longest, 3, 3)), np.empty((longest, 3, 3))
    work, by_place, unseen = np.zeros((4, 3, 3)), np.empty((3, 3)), np.empty((3, 3))
    by_angles = np.empty((3, len(angle_covariance)))
    for i in range(len(points)):
        if not np.isfinite(points[i, 0]):
            continue
        rows, out = order[begin[i] : begin[i + 1]], covariance[i]
        by_angles[:] = 0.0
        for k in range(len(rows)):
            s = rows[k]
            at[image[s]] = k
            which = camera[image[s]]
            _gains(
                turned[pose[s]], place[pose[s]], mounts[which], weighed[s], points[i], inverse[i], work,
                move[k], turn[k],
            )  # fmt: skip
            for a in range(3):
                for b in range(3):
                    by_angles[a, 3 * which + b] += turn[k, a, b]
        # in loops: what numpy has for it takes longer to compile than all else here
        for j in range(len(angle_covariance)):
            for a in range(3):
                share = 0.0
                for m in range(len(angle_covariance)):
                    share += by_angles[a, m] * angle_covariance[m, j]
                for b in range(3):
                    out[a, b] += share * by_angles[b, j]
        for k in range(len(rows)):
            this = image[rows[k]]
            _add_square(turn[k], sigma_attitude**2, out)
            by_place[:] = move[k]
            other = partner[this]
            if other >= 0:
                _add_product(turn[k], sway[this, 0], by_place)
                if at[other] >= 0:
                    _add_product(turn[at[other]], sway[other, 1], by_place)
                else:
                    # the partner did not see the point, but where it was turned this camera
                    unseen[:] = 0.0
                    _add_product(turn[k], sway[this, 1], unseen)
                    _add_square(unseen, sigma_position**2, out)
            _add_square(by_place, sigma_position**2, out)
        for k in range(len(rows)):
            at[image[rows[k]]] = -1
