"""Compiled loops of the line cameras against rays written out, where every number of the camera is unlike."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import polynomial
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.compiled import only_read
from sightline.geometry.camera_kernels import _curve, _slope_weights, curve_at, find_lines, line_rays

#: Tangents (x, y) of the detector by column, polynomials up to the third degree: those cubics carry exactly.
ALONG, ACROSS = (-0.013, 1.1e-4, -2e-8, 1e-10), (0.02, 4e-6, 3e-8, -2e-10)
COLUMNS, LINES, FIRST = 121, 57, -4.0
#: World_from_camera, which turns and bends by a few hundredths, and the place of the camera, by line.
TURN = np.multiply.outer([1.0, 1e-4, -3e-6, 2e-8], Rotation.from_rotvec([2.8, 0.3, -0.4]).as_matrix())
TURN[1:] *= np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3, 3))
WAY = np.array([[40.0, -30.0, 900.0], [0.05, 0.9, 0.02], [1e-3, 2e-4, -3e-3], [2e-6, -5e-6, 1e-6]])
ORIGIN = np.array([7e5, -2e5, 3e5])


def detector(kind: str) -> np.ndarray:
    """Tangents (columns, 2): bent, straight and aslant, or of three pixels, too few for a cubic."""
    if kind == "bent":
        column = np.arange(float(COLUMNS))
        return np.stack([polynomial.polyval(column, ALONG), polynomial.polyval(column, ACROSS)], axis=1)
    count = 3 if kind == "three pixels" else COLUMNS
    share = np.linspace(0.0, 1.0, count)[:, None]
    return (1.0 - share) * [-0.011, 0.013] + share * [0.009, 0.019]


def table() -> np.ndarray:
    """Poses (lines + margin, 12), one each line from `FIRST` on."""
    line = FIRST + np.arange(LINES + 8.0)
    return np.hstack([polynomial.polyval(line, TURN.reshape(4, 9)).T, polynomial.polyval(line, WAY).T])


def tangents_beyond(tangents: np.ndarray, kind: str, column: np.ndarray) -> np.ndarray:
    """(N, 2): by the polynomials within the row, on along its first or last two pixels beyond it."""
    last = len(tangents) - 1
    out = np.stack([np.interp(column, np.arange(last + 1.0), tangents[:, k]) for k in (0, 1)], axis=1)
    if kind == "bent":
        out = np.stack([polynomial.polyval(column, ALONG), polynomial.polyval(column, ACROSS)], axis=1)
    early, late = column < 0.0, column > last
    out[early] = tangents[0] + column[early, None] * (tangents[1] - tangents[0])
    out[late] = tangents[-1] + (column[late, None] - last) * (tangents[-1] - tangents[-2])
    return out


@pytest.mark.parametrize("kind", ["bent", "straight", "three pixels"])
def test_a_line_looks_where_its_pose_and_its_row_of_pixels_say_and_points_there_are_found(kind):
    rng, tangents = np.random.default_rng(5), detector(kind)
    last = len(tangents) - 1
    pixels = rng.uniform([0.0, -0.3 * last], [LINES - 1.0, 1.3 * last], (60, 2))
    seen = tangents_beyond(tangents, kind, pixels[:, 1])
    at = np.empty_like(seen)
    curve_at(*only_read(tangents, pixels[:, 1]), at)
    # float64 of hundredths, weights of a few times one
    assert_allclose(at, seen, rtol=0.0, atol=1e-15)

    matrices = np.moveaxis(polynomial.polyval(pixels[:, 0], TURN), 2, 0)
    away = np.einsum("nij,nj->ni", matrices, np.column_stack([seen, np.ones(60)]))
    start = ORIGIN + polynomial.polyval(pixels[:, 0], WAY).T
    origins, directions = np.empty((2, 60, 3))
    given = np.where(np.arange(60)[:, None] == 7, np.nan, pixels)
    line_rays(*only_read(given, table()), FIRST, *only_read(ORIGIN, tangents), origins, directions)
    keep = np.arange(60) != 7
    assert np.isnan(origins[7]).all() and np.isnan(directions[7]).all()
    # 1e6 m in float64; directions of length 1
    assert_allclose(origins[keep], start[keep], rtol=0.0, atol=1e-9)
    unit = away / np.linalg.norm(away, axis=1, keepdims=True)
    assert_allclose(directions[keep], unit[keep], rtol=0.0, atol=1e-14)

    # the same points are found again, but for columns and lines that are not asked for
    axis = (tangents[-1] - tangents[0]) / np.linalg.norm(tangents[-1] - tangents[0])
    curve = np.stack([tangents @ axis, tangents @ np.array([-axis[1], axis[0]])], axis=1)
    points = start + rng.uniform(700.0, 1100.0, (60, 1)) * away
    lines, columns = (3.5, 49.25), (-0.1 * last, 1.05 * last)
    poses, planes = table(), np.empty((0, 4))
    if kind != "bent":
        # the miss in camera axes, which these nearly turned axes lead into by their inverse
        normal = np.linalg.solve(
            poses[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1),
            np.array([[-axis[1]], [axis[0]], [-curve[0, 1]]]),
        )[..., 0]
        planes = np.column_stack([normal, np.einsum("ni,ni->n", poses[:, 9:], normal)])
    found = np.empty((60, 2))
    find_lines(
        *only_read(points, poses), FIRST, *only_read(ORIGIN, axis, curve), kind != "bent", lines, columns,
        *only_read(planes), found,
    )  # fmt: skip
    asked = (pixels >= [lines[0], columns[0]]).all(axis=1) & (pixels <= [lines[1], columns[1]]).all(axis=1)
    assert 20 < asked.sum() < 50
    assert_allclose(np.isfinite(found).all(axis=1), asked)
    # a place of 1e6 m is known to 1e-10 m, a pixel is 0.1 m wide and a line 0.9 m: 1e-9, a few times over
    assert_allclose(found[asked], pixels[asked], rtol=0.0, atol=1e-8)


def test_slopes_of_a_row_of_pixels_are_the_derivatives_of_its_cubic():
    tangents = detector("bent")
    for column in (0.25, 1.0, 17.9, 60.0, COLUMNS - 1.6):
        slopes = [polynomial.polyval(column, polynomial.polyder(c)) for c in (ALONG, ACROSS)]
        assert_allclose(_curve(*only_read(tangents), column)[2:], slopes, rtol=0.0, atol=1e-14)
    # weights of the slope of x^k at the nodes 0 to 3 give k x^(k - 1)
    for x in (-0.4, 0.0, 1.3, 3.7):
        found = np.vander(np.arange(4.0), 4, increasing=True).T @ _slope_weights(x)
        assert_allclose(found, [0.0, 1.0, 2.0 * x, 3.0 * x * x], rtol=0.0, atol=1e-13)
