"""The ground under a cube: heights of the points that were found, or the surface that was given.

Not here: the surface through points (``products/ground_model.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.robust import robust_sigma
from sightline.geometry.checks import read_only
from sightline.geometry.surface import Dem, Ellipsoid, Plane, Surface, level_surface
from sightline.photogrammetry.flight.found_ground import level_ground
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Tracks
from sightline.products.cube_grid import MapSystem
from sightline.products.frame_cube import FrameViews, Heights, map_outlines
from sightline.products.ground_model import GroundModel, fit_ground

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class UsedGround:
    """Heights that are used.

    Attributes
    ----------
    heights : callable
        m (...) at map places x, y (...).
    words : str
        Which, and why.
    sigma : float
        m; what points miss it by, robust rms.
    model : GroundModel or None
        Where they are those of the points found.
    level : Surface or None
        Level ground at the height of the points found, where that is nearer to them than the surface given.
    """

    heights: Heights
    words: str
    sigma: float
    model: GroundModel | None = None
    level: Surface | None = None


def choose_ground(
    problem: SequenceProblem,
    poses: FramePoses,
    tracks: Tracks,
    system: MapSystem,
    surface: str,
    margin: float = 1.2,
) -> UsedGround:
    """Heights of the points found, or of the surface given, whichever fits the points better.

    A single height that points do not bear out, as that where none is given, gives way to theirs. The given
    surface is kept where points miss it by no more than `margin` times what they miss their own by.
    """
    given, words = given_heights(problem.surface, system), "the surface given"
    points = system.places(poses.points)
    sigma = _height_sigmas(poses, tracks, problem)
    missed, level = _missed(points, given), None
    if surface == "given":
        return UsedGround(given, f"{words}, as asked for", missed)
    found_level = level_ground(problem, poses)
    if isinstance(found_level, Plane | Ellipsoid) and found_level is not problem.surface:
        at = given_heights(found_level, system)
        if missed > margin * (closer := _missed(points, at)):
            given, missed, level = at, closer, found_level
            words = f"level ground at the points' middle height, {found_level.height:.5g} m,"
    try:
        model = fit_ground(points, sigma)
    except EstimationError as error:
        if surface == "model":
            raise
        return UsedGround(given, f"{words.rstrip(',')}: {error}", missed, level=level)
    if surface == "auto" and missed <= margin * model.sigma:
        return UsedGround(
            given, f"{words.rstrip(',')}, which points meet to {missed:.3g} m", missed, level=level
        )
    said = (
        f"{int(model.used.sum())} points found, which a surface through the others meets to "
        f"{model.sigma:.3g} m"
    )
    if surface == "auto":
        said += f" and {words} to {missed:.3g} m"
    return UsedGround(model.at, f"heights of the {said}", model.sigma, model, level)


def _missed(points: Array, heights: Heights) -> float:
    """m, robust rms; what points (n, 3) of the map miss ground by."""
    flat = points[np.isfinite(points).all(axis=1)]
    off = flat[:, 2] - heights(flat[:, 0], flat[:, 1])
    known = off[np.isfinite(off)]
    return robust_sigma(known) if len(known) else np.inf


def _height_sigmas(poses: FramePoses, tracks: Tracks, problem: SequenceProblem) -> Array:
    """m (n,), up to a common factor: sigma of each point's height by the directions it was seen from."""
    count = len(poses.points)
    good = ~poses.rejected[: len(tracks)] & (tracks.point < count)
    point, line = tracks.point[good], tracks.pixels[good] / problem.detector.focal_length_px
    weight = tracks.sigma_px[good] ** -2.0
    total = np.bincount(point, weight, minlength=count)
    spread = np.zeros(count)
    with np.errstate(invalid="ignore", divide="ignore"):
        for axis in range(2):
            mean = np.bincount(point, weight * line[:, axis], minlength=count) / total
            spread += np.bincount(point, weight * (line[:, axis] - mean[point]) ** 2, minlength=count)
        return np.asarray(1.0 / np.sqrt(spread))


def given_heights(surface: Surface, system: MapSystem) -> Heights:
    """Heights (...) of a surface at map places."""

    def heights(x: Array, y: Array) -> Array:
        if isinstance(surface, Plane | Ellipsoid):
            return np.full(np.shape(x), surface.height)
        places = np.stack([np.ravel(x), np.ravel(y), np.zeros(np.size(x))], axis=1)
        if isinstance(surface, Dem):
            return surface.height_at(read_only(system.world(places))).reshape(np.shape(x))
        raise InputError(f"a cube needs ground to lie on, not {type(surface).__name__}")

    return heights


def frame_outlines(
    problem: SequenceProblem, system: MapSystem, ground: UsedGround, views: FrameViews
) -> tuple[Array, Array]:
    """Map places (M, n, 2) around each frame where its lines of sight meet the ground on the whole; and a few
    times as many, on the lowest and on the highest ground too.
    """
    middle, low, high = _levels(problem, ground)

    def on(surface: Surface) -> Array:
        return map_outlines(views, lambda p, d: system.places(surface.intersect(read_only(p), read_only(d))))

    parts = [on(level_surface(problem.radii, h)) for h in ((middle,) if low == high else (middle, low, high))]
    return parts[0], np.concatenate(parts, axis=1)


def _levels(problem: SequenceProblem, ground: UsedGround) -> tuple[float, float, float]:
    """m: usual, lowest and highest ground."""
    surface = problem.surface if ground.level is None else ground.level
    if ground.model is not None:
        heights = ground.model.heights
        return float(np.median(heights)), float(heights.min()), float(heights.max())
    if isinstance(surface, Plane | Ellipsoid):
        return (surface.height,) * 3
    if isinstance(surface, Dem):
        return float(np.nanmedian(surface.ellipsoidal)) + surface.offset, *surface.height_range
    raise InputError(f"a cube needs ground to lie on, not {type(surface).__name__}")
