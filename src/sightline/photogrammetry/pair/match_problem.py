"""S2 from images: conjugate points of a stereo problem found in its frames.

Not here: the search (``photogrammetry/match_frames.py``), the orientation
(``applications/stereo_orientation.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sightline.errors import EstimationError, InputError
from sightline.execution import Step, no_step
from sightline.geometry.surface import Surface, level_surface
from sightline.imaging.source import ImageSource
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.match_frames import TrackPlan, match_frames
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Index, Tracks, as_index

#: The ground lies within so many sigmas of a surface known by its sigma.
_HEIGHT_SIGMAS = 3.0


def match_problem(
    problem: StereoProblem,
    sources: Sequence[ImageSource],
    *,
    image: Index | None = None,
    surface: Surface | None = None,
    floor_px: float = 0.0,
    plan: TrackPlan | None = None,
    step: Step = no_step,
) -> StereoProblem:
    """The same problem with points found in its images in place of its tracks.

    Parameters
    ----------
    problem : StereoProblem
        Its tracks and point names are not used, but for control points that were seen in pixels of their own
        and are all that its tracks hold.
    sources : sequence of ImageSource
        Pictures.
    image : (len(sources),) int, optional
        Row of `problem.images` that each picture belongs to; all, in their order, unless given.
    surface : Surface, optional
        The ground, as well as it is known; that of the problem's heights unless given, or its ellipsoid, or
        the plane z = 0.
    floor_px : float
        px; added to the sigma of every match in quadrature: what the lens and the ground do that the noise of
        images does not show.
    plan : TrackPlan, optional
        In place of `floor_px` and of heights within three sigmas of a surface whose sigma the problem knows,
        or else within 1 km.
    step : callable
        As of `match_frames`.

    Returns
    -------
    StereoProblem
        Points numbered from 0.

    Raises
    ------
    InputError
        If pictures and poses do not agree, or points of control name points of the old tracks.
    EstimationError
        If no point is found in two images.
    """
    rows = np.arange(len(problem.images)) if image is None else as_index(image, "image", len(problem.images))
    if len(sources) != len(rows):
        raise InputError(
            f"one image per pose is needed: {len(rows)} poses, {len(sources)} images; check images.csv "
            "against cameras.csv"
        )
    if problem.control is not None and not np.isin(problem.tracks.point, problem.control.point).all():
        raise InputError(
            "control points name points of `matches` or `observations`, which are not given with images; "
            "leave them out, or say where they were seen: camera,shot,line,column"
        )
    if surface is None:
        surface = level_surface(problem.radii)
        if problem.heights is not None:
            surface = problem.heights.surface
    if plan is None:
        reach = TrackPlan().height_range
        if problem.heights is not None:
            reach = _HEIGHT_SIGMAS * problem.heights.sigma
        plan = TrackPlan(height_range=reach, floor_px=floor_px)
    cameras = frame_cameras(problem.images, problem.detectors, problem.mounts)
    try:
        found = match_frames(sources, [cameras[row] for row in rows], surface, plan, step)
    except EstimationError:
        raise EstimationError(_nothing_found(len(sources), plan)) from None
    tracks = Tracks(rows[found.image], found.point, found.pixels, found.sigma_px)
    count = int(found.point.max()) + 1
    names = np.arange(count, dtype=float)
    if problem.control is None:
        return replace(problem, tracks=tracks, point_names=names)
    known = problem.tracks
    tracks = Tracks(
        np.concatenate([tracks.image, known.image]),
        np.concatenate([tracks.point, known.point + count]),
        np.concatenate([tracks.pixels, known.pixels]),
        np.concatenate([tracks.sigma_px, known.sigma_px]),
    )
    control = replace(problem.control, point=problem.control.point + count)
    names = np.concatenate([names, problem.point_names])
    return replace(problem, tracks=tracks, point_names=names, control=control)


def _nothing_found(pictures: int, plan: TrackPlan) -> str:
    """What may be wrong where no point is found, in the words of a STEREO.toml."""
    return (
        f"no point was found in two of {pictures} pictures: they show no common texture where the planned "
        "poses place it; check that images.csv gives each camera and shot its own picture, that planned "
        "poses and mount look at the same ground, and [surface] (height, dem): points are sought within "
        f"{plan.height_range:g} m of it, three times height_sigma (1000 m without one); enlarge height_sigma "
        "if the ground may lie further"
    )
