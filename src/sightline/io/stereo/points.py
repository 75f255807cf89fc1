"""Points of a STEREO.toml: its sightings and control points as one block, and the ground they lie on.

Not here: reading the tables (``tables.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, GeometryError
from sightline.geometry.earth import WGS84
from sightline.geometry.surface import Dem, Surface
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.ground import exchanged_view_words, exchanged_words, inside_raster, surface_of
from sightline.io.acquisition.platform import points_to_world
from sightline.io.stereo.checks import check_directions, check_enough
from sightline.io.stereo.schema import StereoFile
from sightline.io.stereo.tables import (
    PointTable,
    StereoControl,
    StereoPoseTable,
    check_in_frames,
    read_stereo_control,
)
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior
from sightline.photogrammetry.sightings import Tracks
from sightline.photogrammetry.triangulate import meet_rays

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Share of the points that may lie beside the DEM before the whole is refused.
UNCOVERED_SHARE = 0.02
#: Radii of the body up to which its ground may lie from its centre: rays that hardly converge meet anywhere.
FARTHEST_GROUND = 10.0


def block_of(
    file: StereoFile,
    files: InputFolder,
    poses: StereoPoseTable,
    table: PointTable | None,
    camera: Index,
    shapes: Sequence[tuple[int, int]],
    *,
    local: bool,
) -> tuple[Tracks, Array, ControlPoints | None]:
    """Sightings of all points, their numbers, and those of known coordinates.

    Parameters
    ----------
    file : StereoFile
    files : InputFolder
        Finds the table of control points.
    poses : PoseTable
    table : PointTable or None
        Points of the file; None where they are to be found yet.
    camera : (M,) int
        Of each image.
    shapes : sequence of (lines, columns)
        One per camera.
    local : bool
        The world is flat: coordinates stay as they are.
    """
    if table is not None:
        check_in_frames(table.path, table.image, camera, table.pixels, shapes)
    if table is None:
        nothing: Array = np.empty(0)
        table = PointTable(files.toml, np.empty(0, dtype=np.intp), nothing, np.empty((0, 2)), nothing)
    numbers, point = np.unique(table.point, return_inverse=True)
    image, pixels, sigma = table.image, table.pixels, table.sigma_px
    control = None
    if file.control_points is not None:
        path = files(file.control_points)
        read = read_stereo_control(path, poses, file.noise.sigma_px)
        places = read.position
        if not local:
            places = points_to_world(places, file.world, file.surface.radii, path)
        if read.seen is None:
            which = _known(path, read, numbers)
        else:
            check_in_frames(path, read.seen.image, camera, read.seen.pixels, shapes)
            # control points seen in pixels of their own are points of their own, numbered below all others
            which = len(numbers) + np.arange(len(places))
            first = min(0.0, float(numbers.min(initial=0.0))) - len(places)
            numbers = np.concatenate([numbers, first + np.arange(len(places))])
            point = np.concatenate([point, which[read.seen.point.astype(np.intp)]])
            image = np.concatenate([image, read.seen.image])
            pixels = np.concatenate([pixels, read.seen.pixels])
            sigma = np.concatenate([sigma, read.seen.sigma_px])
        control = ControlPoints(which, places, read.sigma)
    return Tracks(image, point, pixels, sigma), numbers, control


def _known(path: Path, read: StereoControl, numbers: Array) -> Index:
    """Which of the points each control point is."""
    point = np.asarray(read.point)
    place = np.clip(np.searchsorted(numbers, point), 0, max(len(numbers) - 1, 0))
    lost = np.flatnonzero(numbers[place] != point) if len(numbers) else np.arange(len(point))
    if lost.size:
        raise FormatError(
            f"{path}: row {int(lost[0]) + 1} names point {point[lost[0]]:g}, which the table of points does "
            "not have; give where it was seen (camera,shot,line,column), or correct the number"
        )
    return np.asarray(place, dtype=np.intp)


def without_single(
    tracks: Tracks, names: Array, control: ControlPoints | None
) -> tuple[Tracks, Array, ControlPoints | None, tuple[str, ...]]:
    """Points seen in one image only add nothing, unless their coordinates are known."""
    seen = np.bincount(tracks.point, minlength=len(names))
    kept = seen >= 2
    if control is not None:
        kept[control.point] |= seen[control.point] > 0
    if kept.all():
        return tracks, names, control, ()
    number = np.cumsum(kept) - 1
    rows = kept[tracks.point]
    fewer = Tracks(tracks.image[rows], number[tracks.point[rows]], tracks.pixels[rows], tracks.sigma_px[rows])
    if control is not None:
        control = ControlPoints(number[control.point], control.position, control.sigma)
    lost = int((~kept).sum())
    what = "1 point" if lost == 1 else f"{lost} points"
    return fewer, names[kept], control, (f"{what} seen in one image only: left out, nothing follows from it",)


def check_points(
    path: Path,
    cameras: int,
    tracks: Tracks,
    names: Array,
    control: ControlPoints | None,
    heights: HeightPrior | None,
) -> None:
    """Refuse fewer points than angles; see `check_enough`."""
    known = 0 if control is None else len(control.point)
    check_enough(path, cameras, tracks, len(names), control=known, heights=heights is not None)


def ground_of(
    file: StereoFile,
    files: InputFolder,
    path: Path,
    names: tuple[str, ...],
    camera: Index,
    tracks: Tracks,
    origins: Array,
    looks: Array,
    *,
    local: bool,
) -> tuple[HeightPrior | None, Surface, tuple[str, ...]]:
    """Height prior, ground, and what was noticed while looking where rays meet.

    Parameters
    ----------
    file : StereoFile
    files : InputFolder
        Finds rasters.
    path : Path
        The table of points, named in messages.
    names : tuple of str
        Of the cameras.
    camera : (N,) int
        Of each sighting.
    tracks : Tracks
        Sightings, none where points are to be found yet.
    origins, looks : (N, 3)
        m and unit vectors: rays of the sightings, else of the boresights.
    local : bool
        The world is flat, z up.
    """
    radii = file.surface.radii
    warnings: tuple[str, ...] = ()
    places: Array | None = None
    if len(tracks):
        _check_light(path, looks, tracks)
        meeting = meet_rays(origins, looks, tracks.point, int(tracks.point.max()) + 1)
        try:
            warnings, places = check_directions(path, names, camera, meeting), meeting.points
        except GeometryError as error:
            doubt = exchanged_view_words(origins, looks, None if local else (radii or WGS84))
            raise GeometryError(f"{error}{doubt}") from None
        if not local:
            _check_body(files.toml, meeting.points, radii or WGS84)
    section = file.surface
    if file.dem is not None:
        section = section.model_copy(update={"dem": file.dem, "height_sigma": file.dem_sigma})
    surface = surface_of(
        section, files, lambda ground: ground.intersect(origins, looks), local=local, radii=radii
    )
    if section.height_sigma <= 0.0:
        return None, surface, warnings
    if isinstance(surface, Dem) and places is not None:
        _check_dem(files(str(section.dem)), surface, places)
    return HeightPrior(surface, section.height_sigma, None if local else (radii or WGS84)), surface, warnings


def _check_body(toml: Path, points: Array, radii: tuple[float, float]) -> None:
    """Refuse points (n, 3) m that lie far above the body: its radii are in another unit."""
    found = points[np.isfinite(points).all(axis=1)]
    if not len(found):
        return
    distance = float(np.median(np.linalg.norm(found, axis=1)))
    if distance > FARTHEST_GROUND * max(radii):
        raise GeometryError(
            f"{toml}: the cameras look at points {distance:.4g} m from the centre of a body of [surface] "
            f"radii {max(radii):.7g} m: they cannot be its ground; give radii in metres, and positions from "
            "its centre"
        )


def _check_light(path: Path, looks: Array, tracks: Tracks) -> None:
    dark = np.flatnonzero(~np.isfinite(looks).all(axis=1))
    if dark.size:
        raise FormatError(
            f"{path}: pixel {tracks.pixels[dark[0]].tolist()} (line, column) lies where the lens brings no "
            f"light ({dark.size} such); check [camera] distortion and focal_length_px"
        )


def _check_dem(path: Path, dem: Dem, points: Array) -> None:
    """Refuse a raster beside which points lie."""
    found = points[np.isfinite(points).all(axis=1)]
    beside = 1.0 - float(np.mean(inside_raster(dem, found))) if len(found) else 1.0
    if beside > UNCOVERED_SHARE:
        raise GeometryError(
            f"{path}: the DEM does not cover the points: {100 * beside:.0f} % of them lie outside it; give a "
            f"larger DEM, or check its coordinate system and the poses{exchanged_words(dem, found)}"
        )
