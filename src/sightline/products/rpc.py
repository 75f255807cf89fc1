"""Rational polynomials in the place of a camera: RPC00B, fitted over a lattice of pixels and heights.

Not here: the files that hold them (``io/formats/rpc_files.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import Camera
from sightline.geometry.earth import to_geodetic
from sightline.geometry.surface import Ellipsoid

Array = NDArray[np.float64]

#: Terms of each polynomial.
TERMS = 20
#: Pixels of the lattice along lines, along columns, and its heights; that of the check lies between them.
LATTICE = (41, 21, 7)
#: Turns of the fit: each weighs by the denominators of the one before.
_TURNS = 6
#: How strongly terms are held towards 0, in squares of half an image: the one whose check is nearest is kept.
DAMPINGS = (1e-20, 1e-18, 1e-16, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
#: Terms that are never held, and the least that a denominator, 1 in the middle, may come to.
_LINEAR, _LEAST_DENOMINATOR = 4, 0.1


@dataclass(frozen=True, eq=False)
class Rpc:
    """RPC00B: lines and columns as quotients of polynomials of longitude, latitude and height.

    Attributes
    ----------
    line, column, latitude, longitude, height : (float, float)
        Offset and scale: px (an integer is the centre of a pixel), degrees, m above the ellipsoid.
    line_numerator, line_denominator, column_numerator, column_denominator : (20,)
        In the order of RPC00B (STDI-0002, appendix E).
    rms_px, max_px : (float, float)
        px; what lines and columns differ by from the camera, on a lattice that the fit did not use.
    """

    line: tuple[float, float]
    column: tuple[float, float]
    latitude: tuple[float, float]
    longitude: tuple[float, float]
    height: tuple[float, float]
    line_numerator: Array
    line_denominator: Array
    column_numerator: Array
    column_denominator: Array
    rms_px: tuple[float, float] = (0.0, 0.0)
    max_px: tuple[float, float] = (0.0, 0.0)

    def project(self, places: Array) -> Array:
        """Pixels (N, 2), (line, column), of longitude, latitude (degrees), height (m), (N, 3)."""
        terms = _terms(*_normalised(places, self.longitude, self.latitude, self.height))
        lines = (terms @ self.line_numerator) / (terms @ self.line_denominator)
        columns = (terms @ self.column_numerator) / (terms @ self.column_denominator)
        return np.column_stack(
            [lines * self.line[1] + self.line[0], columns * self.column[1] + self.column[0]]
        )


def _normalised(
    places: Array, longitude: tuple[float, float], latitude: tuple[float, float], height: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """Normalised longitude, latitude, height (N,) each; longitudes on the side of the offset."""
    east = (places[:, 0] - longitude[0] + 180.0) % 360.0 - 180.0
    north, up = (places[:, 1] - latitude[0]) / latitude[1], (places[:, 2] - height[0]) / height[1]
    return east / longitude[1], north, up


def _terms(east: Array, north: Array, up: Array) -> Array:
    """The 20 terms of RPC00B (N, 20)."""
    l, p, h = east, north, up  # noqa: E741  # L, P, H of the standard
    return np.column_stack(
        [l**0, l, p, h, l * p, l * h, p * h, l * l, p * p, h * h, p * l * h, l**3, l * p * p, l * h * h,
         l * l * p, p**3, p * h * h, l * l * h, p * p * h, h**3]
    )  # fmt: skip


def fit_rpc(
    camera: Camera, shape: tuple[int, int], radii: tuple[float, float], heights: tuple[float, float]
) -> Rpc:
    """The rational polynomials nearest to a camera.

    Parameters
    ----------
    camera : Camera
        World axes fixed to an ellipsoid.
    shape : (int, int)
        Lines and columns of its image.
    radii : (float, float)
        m; equatorial and polar radius of the ellipsoid.
    heights : (float, float)
        m; lowest and highest above the ellipsoid for which it holds.

    Returns
    -------
    Rpc

    Raises
    ------
    InputError
        If the heights are no range.
    GeometryError
        If pixels look past the ellipsoid, or no rational polynomial holds the image.
    """
    if not (np.isfinite(heights).all() and heights[0] < heights[1]):
        raise InputError(f"`heights` must be a range in m, lower one first; got {heights}")
    pixels, places = _lattice(camera, shape, radii, heights, LATTICE, 0.0)
    places[:, 0] = np.degrees(np.unwrap(np.radians(places[:, 0])))
    ranges = [_offset_scale(values) for values in (*pixels.T, *places.T)]
    line, column, longitude, latitude, height = ranges
    longitude = ((longitude[0] + 180.0) % 360.0 - 180.0, longitude[1])
    terms = _terms(*_normalised(places, longitude, latitude, height))

    seen, grounds = _lattice(camera, shape, radii, heights, tuple(n + 7 for n in LATTICE), 0.37)
    best: Rpc | None = None
    for damping in DAMPINGS:
        quotients = [
            _quotient(terms, (pixels[:, k] - middle) / scale, damping)
            for k, (middle, scale) in enumerate((line, column))
        ]
        fitted = Rpc(line, column, latitude, longitude, height, *quotients[0], *quotients[1])
        apart = fitted.project(grounds) - seen
        rms, most = np.sqrt((apart**2).mean(axis=0)), np.abs(apart).max(axis=0)
        if np.isfinite(rms).all() and (best is None or np.hypot(*rms) < np.hypot(*best.rms_px)):
            best = replace(
                fitted, rms_px=(float(rms[0]), float(rms[1])), max_px=(float(most[0]), float(most[1]))
            )
    if best is None:
        raise GeometryError("no rational polynomial holds this image; cut the strip into shorter pieces")
    return best


def _lattice(
    camera: Camera,
    shape: tuple[int, int],
    radii: tuple[float, float],
    heights: tuple[float, float],
    counts: tuple[int, ...],
    shift: float,
) -> tuple[Array, Array]:
    """Pixels (N, 2) and longitude, latitude (degrees), height (m) of the ground that they see (N, 3).

    Inner pixels lie `shift` steps off their even places, so that no period of them hides motion.
    """
    axes = []
    for size, count in zip(shape, counts[:2], strict=True):
        even = np.linspace(0.0, size - 1.0, min(count, max(size, 2)))
        even[1:-1] += shift * (even[1] - even[0]) * np.sin(np.arange(1, len(even) - 1))
        axes.append(even)
    pixels = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    placed = []
    for height in np.linspace(*heights, counts[2]):
        ground = camera.locate(pixels, Ellipsoid(*radii, float(height)))
        if not np.isfinite(ground).all():
            raise GeometryError(
                f"some pixels look past the ellipsoid of radii {radii[0]:.6g} and {radii[1]:.6g} m raised by "
                f"{height:.6g} m; an RPC holds for images that see the ground everywhere"
            )
        lon, lat, above = to_geodetic(ground, radii).T
        placed.append(np.column_stack([np.degrees(lon), np.degrees(lat), above]))
    return np.tile(pixels, (counts[2], 1)), np.vstack(placed)


def _offset_scale(values: Array) -> tuple[float, float]:
    """Middle and half of a range; a half of 1 where there is none."""
    low, high = float(values.min()), float(values.max())
    return 0.5 * (low + high), 0.5 * (high - low) or 1.0


def _quotient(terms: Array, values: Array, damping: float) -> tuple[Array, Array]:
    """Numerator and denominator (20,) each, the latter beginning with 1, of values (N,).

    Least squares of (P - v Q) / Q', Q' of the turn before; all but the constant and linear terms of P are
    held towards 0 by `damping`: denominators shall not follow the motion of lines.
    """
    held = np.sqrt(damping * len(values)) * np.eye(2 * TERMS - 1)[_LINEAR:]
    none = np.zeros(len(held))
    weight = np.ones(len(values))
    solution = np.zeros(2 * TERMS - 1)
    for _ in range(_TURNS):
        rows = np.hstack([terms, -values[:, None] * terms[:, 1:]]) * weight[:, None]
        solution = np.linalg.lstsq(np.vstack([rows, held]), np.append(values * weight, none), rcond=None)[0]
        below = terms @ np.concatenate([[1.0], solution[TERMS:]])
        if (below < _LEAST_DENOMINATOR).any():
            return np.full(TERMS, np.nan), np.full(TERMS, np.nan)
        weight = np.asarray(1.0 / below)
    return solution[:TERMS], np.concatenate([[1.0], solution[TERMS:]])
