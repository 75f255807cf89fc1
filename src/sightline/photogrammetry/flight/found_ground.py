"""The ground that the images of a sequence show, beside the one given.

Not here: heights of the maps (``products/cube_ground.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.geometry.checks import Array
from sightline.geometry.earth import to_geodetic
from sightline.geometry.surface import Ellipsoid, Plane, Surface, level_surface
from sightline.photogrammetry.block.point_priors import HeightPrior
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem

#: Points from which on their median is the height of the ground.
_ENOUGH = 10
#: Share of the flying height by which the given ground may be off before a warning; sigmas likewise.
_OFF_SHARE, _OFF_SIGMAS = 0.05, 3.0


def found_heights(problem: SequenceProblem, poses: FramePoses) -> Array:
    """Heights (n,) m of the points found: above the ellipsoid, or z of a flat world."""
    points = poses.points[np.isfinite(poses.points).all(axis=1)]
    if problem.radii is None:
        return np.asarray(points[:, 2])
    return np.asarray(to_geodetic(points, problem.radii)[:, 2])


def level_ground(problem: SequenceProblem, poses: FramePoses) -> Surface:
    """The given surface; where that is a single height and points were found, level ground at theirs."""
    if not isinstance(problem.surface, Plane | Ellipsoid):
        return problem.surface
    heights = found_heights(problem, poses)
    if len(heights) < _ENOUGH:
        return problem.surface
    return level_surface(problem.radii, float(np.median(heights)))


def ground_warnings(problem: SequenceProblem, poses: FramePoses) -> list[str]:
    """A warning where the ground that was found is not the one given (or taken, where none was).

    Nothing is said where the sigmas of the poses allow the difference: without positions or control points
    every height is possible.
    """
    sigma_z = np.sqrt(np.abs(poses.covariance[:, :3, :3]).sum(axis=(1, 2)))
    loose = float(np.median(sigma_z[np.isfinite(sigma_z)])) if np.isfinite(sigma_z).any() else np.inf
    points = poses.points[np.isfinite(poses.points).all(axis=1)]
    if len(points) < _ENOUGH or not np.isfinite(loose):
        return []
    surface = HeightPrior(problem.surface, 1.0, problem.radii)
    above, flying = surface.above(points)[0], surface.above(np.asarray(poses.position))[0]
    if not (np.isfinite(above).any() and np.isfinite(flying).any()):
        return []
    off = float(np.nanmedian(above))
    distance = abs(float(np.nanmedian(flying)) - off)
    if abs(off) <= max(_OFF_SHARE * distance, _OFF_SIGMAS * np.hypot(loose, problem.height_sigma)):
        return []
    height = float(np.median(found_heights(problem, poses)))
    where = "above the ellipsoid" if problem.radii is not None else "of z"
    return [
        f"the ground that the images show lies {abs(off):.4g} m {'above' if off > 0.0 else 'below'} that "
        f"of [surface], at {height:.5g} m {where}: give it (height and height_sigma, or a dem), or check "
        "heights of the positions and the focal length"
    ]
