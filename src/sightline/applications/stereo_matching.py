"""S2 from images: conjugate points of a stereo problem found in its frames.

Not here: the search (``photogrammetry/match_frames.py``), the orientation (``stereo_orientation.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sightline.applications.stereo_orientation import StereoProblem
from sightline.errors import InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Ellipsoid, Plane, Surface
from sightline.geometry.trajectory import Trajectory
from sightline.imaging.source import ImageSource
from sightline.photogrammetry.match_frames import TrackPlan, match_frames

#: The ground lies within so many sigmas of a surface known by its sigma.
_HEIGHT_SIGMAS = 3.0


def planned_cameras(problem: StereoProblem) -> tuple[FrameCamera, ...]:
    """The camera of each image with its planned pose, in the order of the problem's images."""
    images = problem.images
    out = []
    for row in range(len(images)):
        camera = int(images.camera[row])
        t = images.t[row : row + 1]
        path = Trajectory(t, images.position[row : row + 1], t, images.world_from_body[row : row + 1])
        mount = FixedMount(problem.mounts[camera])
        out.append(FrameCamera(problem.detectors[camera], path, mount, float(t[0])))
    return tuple(out)


def match_problem(
    problem: StereoProblem, sources: Sequence[ImageSource], plan: TrackPlan | None = None
) -> StereoProblem:
    """The same problem with points found in its images in place of its tracks.

    Parameters
    ----------
    problem : StereoProblem
        Its tracks and point names are not used.
    sources : sequence of ImageSource
        One per row of `problem.images`.
    plan : TrackPlan, optional
        By default heights within three sigmas of the surface that the problem knows, or within 1 km of the
        ellipsoid (the plane z = 0).

    Returns
    -------
    StereoProblem
        Points numbered from 0.

    Raises
    ------
    InputError
        If there is not one image per pose, or points of control name points of the old tracks.
    EstimationError
        If no point is found in two images.
    """
    if len(sources) != len(problem.images):
        raise InputError(
            f"one image per pose is needed: {len(problem.images)} poses, {len(sources)} images; check "
            "images.csv against cameras.csv"
        )
    if problem.control is not None:
        raise InputError(
            "control points name points of `matches` or `observations`, which are not given here; leave them "
            "out, or list what they were measured at"
        )
    surface: Surface = Plane() if problem.radii is None else Ellipsoid(*problem.radii)
    if problem.heights is not None:
        surface = problem.heights.surface
        reach = _HEIGHT_SIGMAS * problem.heights.sigma
        plan = TrackPlan(height_range=reach) if plan is None else plan
    tracks = match_frames(sources, planned_cameras(problem), surface, plan)
    return replace(problem, tracks=tracks, point_names=np.arange(int(tracks.point.max()) + 1, dtype=float))
