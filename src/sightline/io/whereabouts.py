"""Where a camera is and which way it goes, in words that show exchanged columns and mistaken units.

Not here: where the lines of sight go (``io/acquisition/looks.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.earth import local_axes, to_geodetic

Array = NDArray[np.float64]

_COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
#: Share of the distance to the ground that a path spans at least: below it nothing is seen from two sides.
_LEAST_SPAN = 0.01
#: m/s; slower than what flies.
_SLOWEST = 0.1
#: Degrees from the horizontal beyond which a direction is up or down.
_STEEP = 60.0


def level_axes_at(place: Array, radii: tuple[float, float] | None) -> Array:
    """East, north, up as rows (3, 3), at a place (3,); x, y, z of a flat world, which has no radii."""
    if radii is None:
        return np.eye(3)
    lon, lat, _ = to_geodetic(place[np.newaxis], radii)[0]
    return np.asarray(local_axes(lon, lat).as_matrix().T)


def place_words(place: Array, radii: tuple[float, float] | None) -> str:
    """A place (3,) m: ``2.35 E 48.85 N, 60 m``, or x, y, z of a flat world."""
    if radii is None:
        x, y, z = (_rounded(v, 3) for v in place)
        return f"x {x}, y {y}, z {z} m"
    lon, lat, height = to_geodetic(place[np.newaxis], radii)[0]
    lon, lat = np.degrees([lon, lat])
    east, north = "E" if lon >= 0.0 else "W", "N" if lat >= 0.0 else "S"
    return f"{_rounded(abs(lon), 6)} {east} {_rounded(abs(lat), 6)} {north}, {_rounded(height, 1)} m"


def _rounded(value: float, digits: int) -> str:
    """A number without zeros at its end, nor a sign of zero."""
    return f"{round(float(value), digits) + 0.0:.12g}"


def compass_words(direction: Array, axes: Array) -> str:
    """A direction (3,) of the world in level `axes` (3, 3): ``north-east``, ``up``."""
    east, north, up = axes @ direction
    level = float(np.hypot(east, north))
    if not level > 0.0 or abs(np.degrees(np.arctan2(up, level))) > _STEEP:
        return "up" if up > 0.0 else "down"
    return _COMPASS[round(float(np.degrees(np.arctan2(east, north))) / 45.0) % 8]


def flight_words(positions: Array, radii: tuple[float, float] | None) -> str:
    """Positions (n, 3) m in order of time: the first, and which way the last lies from it."""
    said = place_words(positions[0], radii)
    moved = positions[-1] - positions[0]
    if not np.linalg.norm(moved) > 0.0:
        return f"{said}, stands still"
    return f"{said}, flies {compass_words(moved, level_axes_at(positions[0], radii))}"


def span_doubts(positions: Array, t: Array, distance: float) -> tuple[str, ...]:
    """A doubt where positions (n, 3) m hardly differ, over times t (n,) and beside the distance (m) to
    what they see."""
    if len(positions) < 2:
        return ()
    span = float(np.linalg.norm(np.ptp(positions[:, :2], axis=0)))
    if not 0.0 < span < min(_LEAST_SPAN * distance, _SLOWEST * float(np.ptp(t))):
        return ()
    x, y = np.abs(positions[:, :2]).max(axis=0)
    degrees = 'degrees? then [world] frame = "lonlat"; or are they ' if x <= 360.0 and y <= 90.0 else ""
    return (f"positions span {span:.2g} m, seen from {distance:.3g} m: are they {degrees}in km?",)
