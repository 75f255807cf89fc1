"""What `tie` ties: images and cameras of an ACQUISITION, a STEREO or a SEQUENCE.toml; it with control points.

Not here: the control points (``applications/reference_tie.py``).
"""

from __future__ import annotations

import csv
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import check_file, located, remote_name
from sightline.errors import FormatError, InputError
from sightline.geometry.camera import Camera
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.geometry.surface import Dem, level_surface
from sightline.imaging.source import ImageSource
from sightline.io.acquisition.load import load_acquisition, read_acquisition
from sightline.io.acquisition.schema import WorldSection
from sightline.io.config import schema_of
from sightline.io.formats.dem import Bounds, read_dem
from sightline.io.formats.tables import csv_cell
from sightline.io.init.bands import path_from
from sightline.io.names import toml_string, toml_value
from sightline.io.sequence.load import read_sequence
from sightline.io.stereo.load import read_stereo, read_stereo_file
from sightline.photogrammetry.frame_cameras import frame_cameras

Array = NDArray[np.float64]

#: Degrees around what cameras see that is read of a large DEM.
_AROUND = 0.1
#: m; farther from the ellipsoid lies no body's level surface.
_FARTHEST_GEOID = 1e5


@dataclass(frozen=True, eq=False)
class TiedImages:
    """Images that are to be tied to a reference.

    Attributes
    ----------
    path : Path
    kind : str
        "acquisition", "stereo" or "sequence".
    name : str
    names : tuple of str
    images, cameras : tuple
    local : bool
        The world is flat: x east, y north, z up.
    radii : (equatorial, polar)
        m.
    to_table : callable
        World points (N, 3) in the axes of ``[world]``.
    inputs : tuple of Path
        Files that were read.
    """

    path: Path
    kind: str
    name: str
    names: tuple[str, ...]
    images: tuple[ImageSource, ...]
    cameras: tuple[Camera, ...]
    local: bool
    radii: tuple[float, float]
    to_table: Callable[[Array], Array]
    inputs: tuple[Path, ...]


def load_tied(path: Path) -> TiedImages:
    """Images and cameras of an ACQUISITION.toml, a STEREO.toml with `images`, or a SEQUENCE.toml.

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed.
    InputError
        If it is another kind of file.
    """
    kind = schema_of(path)
    if kind == "acquisition":
        acquired = load_acquisition(path)
        config = read_acquisition(path)
        radii = getattr(acquired.surface, "radii", None)
        if radii is None:
            radii = (getattr(acquired.surface, "a", WGS84[0]), getattr(acquired.surface, "b", WGS84[1]))
        local = acquired.world == "local"
        return TiedImages(
            path, kind, acquired.name, acquired.names, acquired.images, acquired.cameras, local, radii,
            _to_table(config.world, radii, local), acquired.inputs,
        )  # fmt: skip
    if kind == "stereo":
        return _stereo_images(path)
    if kind == "sequence":
        sequence = read_sequence(path)
        problem = sequence.problem
        usable = [k for k, reason in enumerate(problem.excluded) if not reason]
        cameras = frame_cameras(problem.images, [problem.detector], [problem.mount])
        local, radii = problem.radii is None, problem.radii or WGS84
        return TiedImages(
            path, kind, sequence.name, tuple(problem.frames[k] for k in usable),
            tuple(problem.sources[k] for k in usable), tuple(cameras[k] for k in usable), local, radii,
            _to_table(sequence.world, radii, local), sequence.inputs,
        )  # fmt: skip
    raise InputError(
        f"{path}: is a {kind} file; `tie` takes an ACQUISITION.toml ([[band]] or [[frame]]), a STEREO.toml "
        "(images) or a SEQUENCE.toml"
    )


def _stereo_images(path: Path) -> TiedImages:
    """Pictures of a STEREO.toml, called "camera/shot" as its control points call them."""
    stereo = read_stereo(path)
    problem, pictures = stereo.problem, stereo.pictures
    if pictures is None:
        raise InputError(
            f"{path}: names no pictures; `tie` needs images = FILE (camera,shot,image); of [[strip]] tie the "
            "ACQUISITION.toml"
        )
    every = frame_cameras(problem.images, problem.detectors, problem.mounts)
    rows = pictures.image.tolist()
    names = tuple(
        f"{problem.cameras[problem.images.camera[row]]}/{problem.shot_names[problem.images.shot[row]]:g}"
        for row in rows
    )
    local, radii = problem.radii is None, problem.radii or WGS84
    return TiedImages(
        path, "stereo", stereo.name, names, tuple(pictures.sources), tuple(every[row] for row in rows), local,
        radii, _to_table(read_stereo_file(path).world, radii, local), stereo.inputs,
    )  # fmt: skip


def _to_table(world: WorldSection, radii: tuple[float, float], local: bool) -> Callable[[Array], Array]:
    """The inverse of ``points_to_world``."""

    def convert(points: Array) -> Array:
        if world.frame == "lonlat" and not local:
            geodetic = to_geodetic(points, radii)
            return np.column_stack([np.degrees(geodetic[:, :2]), geodetic[:, 2]])
        if world.frame == "local" and world.origin is not None:
            lon, lat = np.radians(world.origin[:2])
            start = from_geodetic(np.array([[lon, lat, world.origin[2]]]), radii)
            return np.asarray(local_axes(lon, lat).inv().apply(points - start))
        return points

    return convert


def chosen_images(tied: TiedImages, asked: Sequence[str], most: int) -> list[int]:
    """Numbers of the images to tie: those asked for, else the first band, or frames evenly spread.

    Raises
    ------
    InputError
        If a name is of no image.
    """
    unknown = [name for name in asked if name not in tied.names]
    if unknown:
        shown = ", ".join(tied.names[:10]) + (", ..." if len(tied.names) > 10 else "")
        raise InputError(f"--image {unknown[0]}: no image has this name; there are: {shown}")
    if asked:
        return [tied.names.index(name) for name in dict.fromkeys(asked)]
    from sightline.geometry.camera import FrameCamera

    if not isinstance(tied.cameras[0], FrameCamera):
        return [0]
    count = len(tied.names)
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist()


def read_ground(path: Path, tied: TiedImages, geoid: str | None) -> Dem:
    """The DEM under the images; `geoid` a raster or a number (m) where its heights count from the geoid."""
    level: float | Path | None = None
    if geoid is not None:
        try:
            level = float(geoid)
        except ValueError:
            level = Path(geoid)
            check_file(level, "give a raster of geoid heights, or a number in metres")
        if isinstance(level, float) and not abs(level) <= _FARTHEST_GEOID:
            raise InputError(
                f"the geoid is given as {geoid} m above the ellipsoid; {-_FARTHEST_GEOID:g} to "
                f"{_FARTHEST_GEOID:g} m are allowed; the Earth's lies between -107 and 86 m"
            )
    bounds = None if tied.local else _bounds(tied)
    radii = None if tied.radii == WGS84 else tied.radii
    datum = None if level is None else "geoid"
    return read_dem(path, datum=datum, geoid=level, local=tied.local, radii=radii, bounds=bounds)


def _bounds(tied: TiedImages) -> Bounds | None:
    """Longitudes and latitudes (degrees) of what cameras see, and some around it."""
    level = level_surface(tied.radii)
    seen = []
    for image, camera in ((tied.images[k], tied.cameras[k]) for k in (0, len(tied.images) // 2, -1)):
        axes = [np.linspace(0.0, side - 1.0, 3) for side in image.shape]
        probes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        seen.append(camera.locate(probes, level))
    points = np.concatenate(seen)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    lonlat = np.degrees(to_geodetic(points, tied.radii)[:, :2])
    (west, south), (east, north) = lonlat.min(axis=0) - _AROUND, lonlat.max(axis=0) + _AROUND
    return Bounds(west, south, east, north)


# ---------------------------------------------------------------------------- the file with control points


#: Of images in a table: a copy whose images are found from where it lies; keys that name such a table.
FRAMES = "frames.csv"
TABLES = {"sequence": "frames", "stereo": "images"}


def files_with_control_points(tied: TiedImages, folder: Path, sigma_px: float) -> dict[str, str]:
    """The TOML file with its control points, and the table of its frames where it has one, by their names.

    Parameters
    ----------
    tied : TiedImages
    folder : Path
        Where they will lie.
    sigma_px : float
        px; of the pixels of control points.

    Raises
    ------
    FormatError
        If control points cannot be added to the file.
    """
    text, more = with_control_points(tied, folder, sigma_px), {}
    if tied.kind in TABLES:
        named = tomllib.loads(tied.path.read_text(encoding="utf-8")).get(TABLES[tied.kind], "")
        table = located(tied.path.parent, str(named))
        if named and table.is_file():
            more[FRAMES] = _moved_table(table, tied.path.parent, folder)
            text = text.replace(toml_string(path_from(table, folder)), toml_string(FRAMES))
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(
            f"{tied.path}: control points cannot be added to a copy ({error}); add "
            "control_points and control_sigma_px by hand"
        ) from error
    return {f"{tied.kind}.toml": text, **more}


def _moved_table(table: Path, base: Path, folder: Path) -> str:
    """A table of frames with its images, which are found from `base`, as they are seen from a folder."""
    rows = list(csv.reader(line for line in table.read_text(encoding="utf-8").splitlines() if line.strip()))
    heads = next((row for row in rows if not row[0].startswith("#")), [])
    if "image" not in heads:
        return table.read_text(encoding="utf-8")
    files, out = [k for k, head in enumerate(heads) if head in ("image", "mask")], []
    for row in rows:
        moved = list(row)
        for at in files:
            if row is not heads and len(row) > at and row[at] and not row[0].startswith("#"):
                moved[at] = path_from(located(base, row[at]), folder)
        out.append(",".join(map(csv_cell, moved)))
    return "\n".join(out) + "\n"


def with_control_points(tied: TiedImages, folder: Path, sigma_px: float) -> str:
    """The TOML file with ``control_points.csv`` beside it, and every other file where it lies.

    Parameters
    ----------
    tied : TiedImages
    folder : Path
        Where it will lie.
    sigma_px : float
        px; of the pixels of control points.

    Returns
    -------
    str
        Comments and all else are kept; what control points were there is a comment now.
    """
    text = tied.path.read_text(encoding="utf-8")
    moved = {
        (where[-1], word): path_from(located(tied.path.parent, word), folder)
        for where, word in _words(tomllib.loads(text), ())
        if _is_file(tied.path.parent, where, word)
    }
    lines = [_moved(line, moved) for line in text.splitlines()]
    given = [
        "# by `sightline tie`: control points of a reference, and where this file lay before",
        'control_points = "control_points.csv"',
        f"control_sigma_px = {sigma_px:.4g}",
    ]
    old = re.compile(r"^\s*(control_points|control_sigma_px|gcp_list|gcp_sigma)\s*=")
    lines = [f"# {line}" if old.match(line) else line for line in lines]
    if tied.kind == "stereo":
        # its table of control points has a column for it
        given = [line for line in given if not line.startswith("control_sigma_px")]
    if tied.kind != "acquisition":
        lines = [*given, *lines]
    else:
        at = next((n for n, line in enumerate(lines) if re.match(r"^\s*\[acquisition\]", line)), None)
        lines = (
            ["[acquisition]", *given, "", *lines]
            if at is None
            else [*lines[: at + 1], *given, *lines[at + 1 :]]
        )
    return "\n".join(_allowed(lines, path_from(tied.path.parent, folder))) + "\n"


def _words(value: Any, where: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Keys and texts of all words in tables and lists."""
    if isinstance(value, str):
        yield where, value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _words(inner, (*where, str(key)))
    elif isinstance(value, list):
        for inner in value:
            yield from _words(inner, where)


def _is_file(folder: Path, where: tuple[str, ...], word: str) -> bool:
    """Whether a word is the name of a file or a folder that is there."""
    if not where or where[-1] in ("name", "kind", "epoch", "frame") or remote_name(Path(word)) is not None:
        return False
    if "\n" in word or len(word) > 4096:
        return False
    return located(folder, word).exists()


def _moved(line: str, moved: Mapping[tuple[str, str], str]) -> str:
    """A line of the file with names of files as they are seen from elsewhere."""
    found = re.match(r"""^(\s*(?:"?)([\w-]+)(?:"?)\s*=\s*)(.*)$""", line)
    if found is None:
        return line
    head, key, rest = found.groups()
    for (name, word), path in moved.items():
        if name == key:
            for written in (toml_string(word), f"'{word}'"):
                rest = rest.replace(written, toml_string(path))
    return head + rest


def _allowed(lines: list[str], folder: str) -> list[str]:
    """The file with the folder where it lay among those that its files may refer to."""
    at = next((n for n, line in enumerate(lines) if re.match(r"^\s*\[files\]", line)), None)
    if at is None:
        return [*lines, "", "[files]", f"allow = {toml_value([folder])}"]
    for n in range(at + 1, len(lines)):
        if re.match(r"^\s*allow\s*=\s*\[", lines[n]):
            more = re.sub(r"\[", f"[{toml_string(folder)}, ", lines[n], count=1)
            return [*lines[:n], more, *lines[n + 1 :]]
    return [*lines[: at + 1], f"allow = {toml_value([folder])}", *lines[at + 1 :]]
