"""Control points of a sequence: their coordinates, and where they were seen in which frames.

Not here: rough poses (``poses.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.platform import points_to_world
from sightline.io.formats.odm import read_gcp_list
from sightline.io.formats.tables import control_points
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.matched_rows import radii_of
from sightline.io.sequence.schema import SequenceFile
from sightline.io.stereo.tables import check_in_frames, refuse_seen_twice
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.sightings import Images, Tracks, rays_of
from sightline.photogrammetry.triangulate import meet_rays

Array = NDArray[np.float64]


def control_of(
    file: SequenceFile, files: InputFolder, frames: FrameList, shape: tuple[int, int]
) -> tuple[ControlPoints | None, Tracks | None]:
    """Control points and their sightings; None where there are none.

    Raises
    ------
    FormatError
        If one is of an unknown frame, seen twice in one, or lies outside it.
    """
    images: Sequence[str]
    if file.gcp_list is not None:
        path = files(file.gcp_list)
        listed = read_gcp_list(path)
        radians = np.column_stack([np.radians(listed.lonlat[:, :2]), listed.lonlat[:, 2]])
        position = from_geodetic(radians, radii_of(file) or WGS84)
        sigma, images, pixels = np.full(len(position), file.gcp_sigma), listed.images, listed.pixels
        _, point = np.unique(np.array(listed.names, dtype=str), return_inverse=True)
    else:
        table = None if file.control_points is None else files(file.control_points)
        given = control_points(file.control_point, table)
        if given is None:
            return None, None
        path, sigma, images, pixels = table or files.toml, given.sigma, given.image, given.pixels
        position = points_to_world(given.position, file.world, file.surface.radii, path)
        rows = np.column_stack([given.position, sigma])
        _, point = np.unique(rows, axis=0, return_inverse=True)
    point = np.asarray(point, dtype=np.intp).reshape(-1)
    image = _frames_of(path, images, frames)
    refuse_seen_twice(path, image, point.astype(np.float64))
    check_in_frames(path, image, np.zeros(len(frames.names), dtype=np.intp), pixels, [shape])
    _, first = np.unique(point, return_index=True)
    control = ControlPoints(np.arange(len(first)), position[first], sigma[first])
    return control, Tracks(image, point, pixels, np.full(len(point), file.control_sigma_px))


def placed_by_control(
    images: Images, control: ControlPoints, seen: Tracks, detector: AreaDetector, mount: Rotation
) -> Images:
    """Rough poses of which no place is given, put where control points are seen from.

    Parameters
    ----------
    images : Images
        Of all frames; their attitudes are used, their positions are not.
    control : ControlPoints
    seen : Tracks
        Where they were seen; `point` counts the rows of `control`.
    detector : AreaDetector
    mount : Rotation
        body <- camera.

    Returns
    -------
    Images
        All in one place, a start only: the middle of those from which frames see two points or more. Where
        no frame does, as given.
    """
    # a frame is where the lines meet along which it sees its points
    look = rays_of(images, [detector], [mount], seen)
    places = meet_rays(control.position[seen.point], look, seen.image, len(images)).points
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        return images
    return replace(images, position=np.tile(np.median(places, axis=0), (len(images), 1)))


def _frames_of(path: Path, images: Sequence[str], frames: FrameList) -> NDArray[np.intp]:
    """Which frame each image is, by the frame's name or that of its file."""
    number = {file.name: k for k, file in enumerate(frames.files)}
    number |= {name: k for k, name in enumerate(frames.names)}
    found = np.array([number.get(name, -1) for name in images], dtype=np.intp)
    lost = np.flatnonzero(found < 0)
    if len(lost):
        raise FormatError(
            f"{path}: row {int(lost[0]) + 1} names the image {images[int(lost[0])]!r}, which is no "
            "frame; frames are "
            f"called {frames.names[0]!r}, ..."
        )
    return found
