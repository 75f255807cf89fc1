"""S2's estimate by an oriented plane (equations 5 to 8, corrected): six angles and how the ground slopes.

Each ray is cut with the level plane through the aim point; both cameras of a pair must then mean one place,
but for depths that grow with the image coordinates and with time: a1 u + a2 t u + b1 v + b2 t v in each
camera. The cut moves along the plane as the ray turns, which the source drops and this keeps. See
docs/theory/s2.md.

Not here: estimates that hold whatever the relief (``epipolar.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.checks import Array, as_vector
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.estimating_equations import marginal_information, observe
from sightline.photogrammetry.pair.pairs import PairOrientation, SightingPairs, position_turns
from sightline.photogrammetry.pair.relief import relief_spread
from sightline.photogrammetry.sightings import Sightings

#: Most linearisations, and the step (rad) after which none follows: what it leaves is of second order.
_STEPS, _STEP = 5, 1e-5
#: Unknowns: six angles, and for each camera the slopes along u and v and their rates.
_UNKNOWNS = 14


def common_aim(sightings: Sightings) -> Array:
    """Point that the optical axes of all images pass nearest by.

    Parameters
    ----------
    sightings : Sightings

    Returns
    -------
    (3,)
        m, world axes.

    Raises
    ------
    InputError
        Axes so nearly parallel that they meet nowhere.
    """
    axis = (
        sightings.world_from_body[sightings.pose]
        @ sightings.body_from_camera[sightings.camera[sightings.image], :, 2][..., None]
    )
    first = np.unique(sightings.pose, return_index=True)[1]
    axis, place = axis[first, :, 0], sightings.position[sightings.pose[first]]
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    values = np.linalg.eigvalsh(across.sum(axis=0))
    # the least eigenvalue is the sum of the squared angles from a common direction
    if values[0] < 1e-6 * len(first):
        raise InputError(
            "the optical axes are parallel: the cameras have no common aim point, which the plane needs; "
            "give the aim point, or use epipolar or ml-track"
        )
    return np.asarray(np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, place)))


@dataclass(frozen=True)
class _Cut:
    """Rays of one camera of each pair, cut with the plane. Vectors are (3, N), world axes.

    ray : of unit depth along the camera's axis.
    rise : (N,), vertical part of `ray`.
    depth : (N,), m.
    place : m, where the plane is met.
    turned : (3, 3, N): change of `place` with a turn about each body axis.
    sighted : (2, 3, N): change of `place` per px of noise times that noise.
    """

    ray: Array
    rise: Array
    depth: Array
    place: Array
    turned: Array
    sighted: Array


@dataclass(frozen=True)
class _Rows:
    """Linear equations columns[:, :14] . unknowns + columns[:, -1] = 0, three (world axes) for each pair.

    columns : (3, 21, N): the unknowns, moves of the first position and of the second, the misfit, m.
    """

    columns: Array
    cuts: tuple[_Cut, _Cut]


def orient_by_plane(
    pairs: SightingPairs, noise: PoseNoise, *, aim_point: Array, vertical: Array
) -> PairOrientation:
    """S2's estimate by an oriented plane, with the corrections that make it one.

    Parameters
    ----------
    pairs : SightingPairs
        At least five.
    noise : PoseNoise
        Of the poses in hand; the noise of the sightings is their own `sigma_px`.
    aim_point : (3,)
        m, world axes: a point of the level plane, see `common_aim`. An error of its height passes for one
        of the difference of the pitches.
    vertical : (3,)
        Normal of the plane, unit vector.

    Returns
    -------
    PairOrientation
        `residual_px` is how far the second camera sees the two places of a pair apart: mostly relief.

    Notes
    -----
    Relief is an error of this method and mostly the largest. Its share of the covariance is built from the
    heights above the fitted plane and the distance over which they go together, both measured on the
    residuals. It is true to 10 % where heights go together over less than a tenth of the scene. Waves as long
    as the scene leave the sigma of yaw 5 to 30 % low; for one lone mountain, or without any other noise, it
    does not hold.
    """
    if 3 * len(pairs) < _UNKNOWNS:
        raise InputError(f"{_UNKNOWNS} unknowns need five pairs or more, got {len(pairs)}; match more points")
    aim, up = as_vector(aim_point, "aim_point"), as_vector(vertical, "vertical")
    angles = np.zeros((2, 3))
    for _ in range(_STEPS):
        rows = _rows(pairs, angles, aim, up)
        sums = _shot_sums(pairs, rows)
        normal = sums[:, :, :_UNKNOWNS].sum(axis=0)
        equations = observe(normal)
        found = equations.solve(sums[:, :, -1].sum(axis=0))
        step = found[:6].reshape(2, 3)
        angles = (Rotation.from_rotvec(angles) * Rotation.from_rotvec(step)).as_rotvec()
        if np.abs(step).max() < _STEP or len(equations.unobservable):
            break
    left = rows.columns[:, -1] + np.einsum("rpn,p->rn", rows.columns[:, :_UNKNOWNS], found)
    meat = _image_meat(rows) + _pose_meat(pairs, noise, sums) + _relief_meat(pairs, rows, left, up)
    covariance, information = equations.covariance(meat)
    touched = equations.touched[:6].reshape(2, 3)
    return PairOrientation(
        np.where(touched, np.nan, angles),
        covariance[:6, :6],
        marginal_information(information, 6),
        _of_angles(equations.unobservable),
        np.zeros((2, 3)),
        _seen_apart(pairs, rows, left),
    )


def _of_angles(directions: Array) -> Array:
    """Unit vectors (G, 6) along which unobservable directions (H, 14) move the angles."""
    moving = np.linalg.svd(directions[:, :6], full_matrices=False)
    return np.asarray(moving[2][moving[1] > 1e-3])


def _cut(pairs: SightingPairs, which: int, angles: Array, aim: Array, up: Array) -> _Cut:
    """Cut the rays of one camera, turned by `angles` (3,), with the plane."""
    sightings, rows = pairs.sightings, pairs.rows[which]
    images = pairs.images[which]
    mount = sightings.body_from_camera[sightings.camera[images[0]]]
    body = sightings.world_from_body[images] @ Rotation.from_rotvec(angles).as_matrix()
    count = np.diff(pairs.starts)

    def spread(matrix: Array) -> Array:
        """Of each shot (K, ...) to each pair (..., N)."""
        return np.repeat(np.moveaxis(matrix, 0, -1), count, axis=-1)

    x, y = sightings.tangents[rows].T
    camera = spread(body @ mount)
    ray = camera[:, 0] * x + camera[:, 1] * y + camera[:, 2]
    rise = up @ ray
    place = spread(sightings.position[images])
    depth = -(up @ (place - aim[:, None])) / rise
    if not (depth > 0.0).all():
        raise InputError("a ray does not come down to the level plane: check the aim point and the attitudes")

    def moved(change: Array) -> Array:
        """Change (3, N) of the place with that of the ray."""
        return np.asarray(depth * (change - ray * ((up @ change) / rise)))

    v = mount @ np.stack([x, y, np.ones_like(x)])
    axes = spread(body)
    # e_i x v, in world axes
    turned = np.stack(
        [
            moved(axes[:, 2] * v[1] - axes[:, 1] * v[2]),
            moved(axes[:, 0] * v[2] - axes[:, 2] * v[0]),
            moved(axes[:, 1] * v[0] - axes[:, 0] * v[1]),
        ]
    )
    a, b, c, d = sightings.px_per_tangent[rows].reshape(-1, 4).T
    size = sightings.sigma_px[rows] / (a * d - b * c)
    sighted = np.stack(
        [
            moved(camera[:, 0] * (size * d) - camera[:, 1] * (size * c)),
            moved(camera[:, 1] * (size * a) - camera[:, 0] * (size * b)),
        ]
    )
    return _Cut(ray, rise, depth, place + depth * ray, turned, sighted)


def _rows(pairs: SightingPairs, angles: Array, aim: Array, up: Array) -> _Rows:
    """Equations of all pairs, linearised at `angles` and no slopes."""
    cuts = _cut(pairs, 0, angles[0], aim, up), _cut(pairs, 1, angles[1], aim, up)
    columns = np.empty((3, _UNKNOWNS + 7, len(pairs)))
    t = pairs.sightings.t[pairs.images[0]]
    time = ((t - t.mean()) / (float(np.ptp(t)) or 1.0))[pairs.shot]
    for which, (cut, sign) in enumerate(zip(cuts, (1.0, -1.0), strict=True)):
        columns[:, 3 * which : 3 * which + 3] = sign * np.swapaxes(cut.turned, 0, 1)
        # slopes as shares of the depth, of the order of an angle
        away = (sign * float(cut.depth.mean())) * cut.ray
        for axis, u in enumerate(pairs.sightings.tangents[pairs.rows[which]].T):
            at = 6 + 4 * which + 2 * axis
            columns[:, at] = u * away
            columns[:, at + 1] = time * columns[:, at]
        at = _UNKNOWNS + 3 * which
        fall = (-sign / cut.rise) * cut.ray
        columns[:, at : at + 3] = fall[:, None] * up[:, None] + sign * np.eye(3)[:, :, None]
    columns[:, -1] = cuts[0].place - cuts[1].place
    return _Rows(columns, cuts)


def _shot_sums(pairs: SightingPairs, rows: _Rows) -> Array:
    """Products (K, 14, 21) of the unknowns' columns with all, summed over the pairs of each shot."""
    shots = zip(pairs.starts[:-1], pairs.starts[1:], strict=True)
    return np.stack([sum(axis[:_UNKNOWNS, i:j] @ axis[:, i:j].T for axis in rows.columns) for i, j in shots])


def _image_meat(rows: _Rows) -> Array:
    """Spread (14, 14) of the right side by the noise of sightings, independent from pair to pair."""
    meat = np.zeros((_UNKNOWNS, _UNKNOWNS))
    for moved in (*rows.cuts[0].sighted, *rows.cuts[1].sighted):
        by_noise = _onto(rows, moved)
        meat += by_noise @ by_noise.T
    return meat


def _onto(rows: _Rows, vectors: Array) -> Array:
    """Columns of the unknowns times a vector (3, N) of each pair, (14, N)."""
    x, y, z = rows.columns[:, :_UNKNOWNS]
    return np.asarray(x * vectors[0] + y * vectors[1] + z * vectors[2])


def _pose_meat(pairs: SightingPairs, noise: PoseNoise, sums: Array) -> Array:
    """Spread (14, 14) of the right side by the errors of poses, each shared by all pairs of its shot."""
    turned, moved = sums[:, :, :6], sums[:, :, _UNKNOWNS : _UNKNOWNS + 6].copy()
    if noise.aim_point is not None:
        # an attitude in hand that is wrong by a turn: as if the angle sought were less by it
        turns = position_turns(pairs, noise)
        for which in range(2):
            own = turned[:, :, 3 * which : 3 * which + 3]
            for by in range(2):
                moved[:, :, 3 * by : 3 * by + 3] += own @ turns[which, by]
    parts = noise.attitude**2 * turned @ np.swapaxes(turned, 1, 2)
    return np.asarray((parts + noise.position**2 * moved @ np.swapaxes(moved, 1, 2)).sum(axis=0))


def _relief_meat(pairs: SightingPairs, rows: _Rows, left: Array, up: Array) -> Array:
    """Spread (14, 14) of the right side by heights above the fitted plane; `left` (3, N) is the misfit."""
    one, two = rows.cuts
    apart = one.ray / one.rise - two.ray / two.rise
    point = np.unique(pairs.point, return_inverse=True)[1]
    count = np.bincount(point)

    def of_points(values: Array) -> Array:
        return np.stack([np.bincount(point, row) for row in np.atleast_2d(values)])

    # a height h moves the places by h ray / rise, so that they come apart by h times `apart`
    height = -of_points((apart * left).sum(axis=0))[0] / of_points((apart**2).sum(axis=0))[0]
    level = np.linalg.svd(up[None])[2][1:]
    place = of_points(level @ one.place) / count
    return relief_spread(place.T, height, of_points(_onto(rows, apart)).T)


def _seen_apart(pairs: SightingPairs, rows: _Rows, left: Array) -> Array:
    """Lengths (N,), px, of the misfits `left` (3, N) in the second camera's images."""
    sightings, second = pairs.sightings, pairs.rows[1]
    image = sightings.image[second]
    mount = sightings.body_from_camera[sightings.camera[image]]
    seen = np.einsum(
        "nba,cnb->nca", mount, np.einsum("nba,bn->na", sightings.world_from_body[image], left)[None]
    )
    x, y = sightings.tangents[second].T
    a, b, c = seen[:, 0].T
    tangents = np.stack([a - x * c, b - y * c], axis=-1) / rows.cuts[1].depth[:, None]
    return np.asarray(
        np.linalg.norm(np.einsum("nij,nj->ni", sightings.px_per_tangent[second], tangents), axis=1)
    )
