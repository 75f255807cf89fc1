"""A STEREO.toml in plain words: what was understood, what is missing, what will be observable.

Not here: reading the file (``load.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.units import ARCSEC
from sightline.io.formats.instants import epoch_words
from sightline.io.stereo.checks import boresights
from sightline.io.stereo.load import Stereo
from sightline.photogrammetry.pair.problem import StereoProblem

Array = NDArray[np.float64]

#: rad of convergence below which heights, and with them pitch, are badly observable.
NARROW = np.radians(5.0)
#: Share of the frame that points should span for yaw.
SPAN = 0.5


def describe_stereo(stereo: Stereo) -> dict[str, Any]:
    """A problem in words: ``understood``, ``missing``, ``observable``, lists of sentences."""
    problem = stereo.problem
    return {
        "understood": _understood(stereo),
        "missing": _missing(stereo),
        "observable": _consequences(problem),
        "cameras": list(problem.cameras),
        "shots": len(problem.shot_names),
        "points": len(problem.point_names),
    }


def _understood(stereo: Stereo) -> list[str]:
    problem, images = stereo.problem, stereo.problem.images
    said = [
        f"{stereo.name}: {len(problem.cameras)} cameras ({', '.join(problem.cameras[:8])}), "
        f"{len(problem.shot_names)} shots over {np.ptp(images.t):.6g} s, {len(images)} images",
        f"{len(problem.point_names)} points in {len(problem.tracks)} sightings{_columns_of(stereo)}"
        if stereo.pictures is None
        else f"{len(stereo.pictures.sources)} pictures, in which points are to be found",
        f"noise of positions {problem.noise.position:g} m, of attitudes {problem.noise.attitude:.3g} rad "
        f"({problem.noise.attitude / ARCSEC:.3g} arcsec), "
        + (
            "attitudes measured by themselves"
            if problem.noise.aim_point is None
            else "attitudes rebuilt from positions for a common aim point"
        ),
    ]
    if problem.epoch is not None:
        said.append(epoch_words(problem.epoch))
    apart = separation(problem)
    if apart is not None:
        said.append(
            f"cameras of a shot are {apart[0] / 1e3:.4g} km apart, their axes converge at "
            f"{np.degrees(apart[1]):.3g} degrees"
        )
    if problem.heights is not None:
        said.append(f"points lie on a ground known to {problem.heights.sigma:g} m")
    if problem.control is not None:
        said.append(f"{len(problem.control.point)} control points")
    return said + list(problem.warnings)


def _columns_of(stereo: Stereo) -> str:
    """Of ``matches``: which camera is _1 and which is _2."""
    if stereo.pairs is None:
        return ""
    first, second = stereo.problem.cameras
    return f"; line_1, column_1 of matches are of camera {first}, line_2, column_2 of camera {second}"


def separation(problem: StereoProblem) -> tuple[float, float] | None:
    """Mean distance (m) and convergence (rad) of the first two images of each shot; None without pairs."""
    images = problem.images
    order = np.lexsort((images.camera, images.shot))
    shot = images.shot[order]
    first = np.flatnonzero(np.r_[True, np.diff(shot) > 0])
    pairs = first[first + 1 < len(order)]
    pairs = pairs[shot[pairs + 1] == shot[pairs]]
    if not len(pairs):
        return None
    a, b = order[pairs], order[pairs + 1]
    looks = boresights(images, problem.mounts)
    apart = np.linalg.norm(images.position[a] - images.position[b], axis=1)
    cosine = np.clip(np.einsum("ni,ni->n", looks[a], looks[b]), -1.0, 1.0)
    return float(apart.mean()), float(np.arccos(cosine).mean())


def _missing(stereo: Stereo) -> list[str]:
    problem = stereo.problem
    said = []
    if stereo.pictures is None and not len(problem.tracks):
        said.append("matches, observations or images: without points only the bound (--predict) can be had")
    if problem.epoch is None:
        said.append("[stereo] epoch: without it no attitude message (AEM) is written")
    if problem.heights is None and problem.control is None:
        said.append(
            "dem or control_points: heights make pitch observable, control points roll and pitch, absolutely"
        )
    return said


def _consequences(problem: StereoProblem) -> list[str]:
    """What the layout of shots and points will and will not make observable."""
    said = []
    if len(problem.shot_names) == 1 and problem.control is None and len(problem.cameras) > 1:
        said.append(
            "one shot only: a turn of both cameras about the line between them cannot be seen; give shots "
            "that span "
            "time, or control points"
        )
    apart = separation(problem)
    if apart is not None and apart[1] < NARROW:
        said.append(
            f"axes converge at {np.degrees(apart[1]):.2g} degrees only: heights and pitch will be known badly"
        )
    share = _span(problem)
    if share is not None and share < SPAN:
        said.append(
            f"points span {100 * share:.0f} % of the frame: yaw depends on that span; spread them over all "
            "of it"
        )
    return said or ["roll and pitch by the poses of many shots; yaw by points over the whole frame and time"]


def _span(problem: StereoProblem) -> float | None:
    """Least share of the diagonal of a frame that the points of a camera span; None without points."""
    if not len(problem.tracks):
        return None
    camera = problem.images.camera[problem.tracks.image]
    shares = []
    for number, detector in enumerate(problem.detectors):
        pixels = problem.tracks.pixels[camera == number]
        if len(pixels):
            shares.append(float(np.linalg.norm(np.ptp(pixels, axis=0)) / np.linalg.norm(detector.shape)))
    return min(shares)
