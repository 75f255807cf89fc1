"""Tables of a STEREO.toml → arrays: planned poses, conjugate points, control points, images.

Not here: what the whole means (``load.py``), whether its geometry can answer (``checks.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.io.formats.tables import (
    check_images,
    check_quaternions,
    header_of,
    line_of_row,
    read_columns,
    read_control_points,
    read_long_columns,
    sigma_columns,
)
from sightline.io.quantities import PIXEL_SIGMA

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CAMERAS = ("camera", "shot", "t", "x", "y", "z", "qx", "qy", "qz", "qw")
MATCHES = ("shot", "point", "line_1", "column_1", "line_2", "column_2")
OBSERVATIONS = ("camera", "shot", "point", "line", "column")
IMAGES = ("camera", "shot", "image")

#: s; images of one shot are exposed together, as far as clocks and rounded tables can say.
SAME_TIME = 1e-3
#: px beyond the edge of a frame at which a point cannot have been seen in it, noise of matching or not.
BEYOND_PX = 50.0
#: Names of cameras that are numbered.
_WHOLE = re.compile(r"[+-]?[0-9]+")
#: Names that are listed in a message.
LISTED = 8


@dataclass(frozen=True, eq=False)
class StereoPoseTable:
    """``cameras.csv``.

    Attributes
    ----------
    cameras : tuple of str
        Names, in the order of `camera_names`.
    camera : (M,) int
        Which of `cameras`.
    shot : (M,) int
        Which of `shots`.
    shots : (K,)
        Numbers of the shots, rising, as their times do.
    t : (M,)
        s from the epoch.
    position : (M, 3)
        As in the table.
    quat_xyzw : (M, 4)
        world_from_body, scalar last.
    """

    cameras: tuple[str, ...]
    camera: Index
    shot: Index
    shots: Array
    t: Array
    position: Array
    quat_xyzw: Array

    @cached_property
    def _rows(self) -> Index:
        """Row of each camera and shot; -1 where there is none."""
        rows = np.full((len(self.cameras), len(self.shots)), -1, dtype=np.intp)
        rows[self.camera, self.shot] = np.arange(len(self.camera))
        return rows

    def image_of(self, path: Path, camera: Index, shot: Array) -> Index:
        """Rows (N,) of this table by camera (N,) and number of shot (N,); FormatError where there is none.

        `path` is the table that asked.
        """
        place = np.clip(np.searchsorted(self.shots, shot), 0, len(self.shots) - 1)
        rows: Index = self._rows[camera, place]
        lost = np.flatnonzero((self.shots[place] != shot) | (rows < 0))
        if lost.size:
            row = int(lost[0])
            raise FormatError(
                f"{path}: line {line_of_row(path, row)} is of shot {shot[row]:g} of camera "
                f"{self.cameras[camera[row]]}, which the table of cameras does not have ({lost.size} such in "
                "all); add its pose, or remove the lines"
            )
        return rows


def camera_names(words: Sequence[str]) -> tuple[str, ...]:
    """Different names in the order of all tables: by value if all are whole numbers, else as first met."""
    names = dict.fromkeys(words)
    if all(_WHOLE.fullmatch(name) for name in names):
        return tuple(sorted(names, key=lambda name: (int(name), name)))
    return tuple(names)


def numbers_of(path: Path, names: Sequence[str], words: Sequence[str]) -> Index:
    """Which of `names` each of `words` is; FormatError for an unknown one."""
    number = {name: k for k, name in enumerate(names)}
    found = np.fromiter((number.get(word, -1) for word in words), dtype=np.intp, count=len(words))
    lost = np.flatnonzero(found < 0)
    if lost.size:
        raise FormatError(
            f"{path}: line {line_of_row(path, int(lost[0]))} names the camera {words[int(lost[0])]!r}, which "
            f"the table of cameras does not have; it has: {listed(names)}"
        )
    return found


def listed(names: Sequence[str]) -> str:
    """A few names, and how many more."""
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")


@reads("a CSV table")
def read_poses(path: Path) -> StereoPoseTable:
    """``camera,shot,t,x,y,z,qx,qy,qz,qw``: planned poses of every image."""
    table = read_long_columns(path, CAMERAS, text=("camera",))
    names = camera_names(table["camera"])
    if "" in names:
        row = table["camera"].index("") + 1
        raise FormatError(f"{path}: row {row} has no camera; every row names the camera of its image")
    camera = numbers_of(path, names, table["camera"])
    shot = whole_numbers(path, "shot", table["shot"])
    shots, place = np.unique(shot, return_inverse=True)
    _refuse_twice(path, names, camera, shot)
    _check_times(path, names, camera, table["t"])
    _check_shots(path, shots, place, table["t"])
    return StereoPoseTable(
        names,
        camera,
        np.asarray(place, dtype=np.intp),
        shots,
        table["t"],
        np.column_stack([table[axis] for axis in "xyz"]),
        check_quaternions(path, np.column_stack([table[q] for q in ("qx", "qy", "qz", "qw")])),
    )


def whole_numbers(path: Path, name: str, values: Array) -> Array:
    """The column, if it holds whole numbers."""
    bad = np.flatnonzero(values != np.round(values))
    if bad.size:
        raise FormatError(
            f"{path}: row {int(bad[0]) + 1}: {name} = {values[bad[0]]:g}; {name}s are whole numbers; are "
            "columns "
            "exchanged?"
        )
    return values


def _refuse_twice(path: Path, names: Sequence[str], camera: Index, shot: Array) -> None:
    twice = repeated(camera, shot)
    if twice is not None:
        first, again = twice
        raise FormatError(
            f"{path}: rows {first + 1} and {again + 1} are both shot {shot[again]:g} of camera "
            f"{names[camera[again]]}; a camera has one image in a shot: remove one, or give every exposure a "
            "shot of its own"
        )


def repeated(*keys: NDArray[Any]) -> tuple[int, int] | None:
    """The first two rows in which all keys agree; None where there are none."""
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for key in keys:
        same &= np.diff(key[order]) == 0
    if not same.any():
        return None
    pairs = np.stack([order[:-1][same], order[1:][same]], axis=1)
    first, again = np.sort(pairs[np.argmin(pairs.max(axis=1))])
    return int(first), int(again)


def _check_times(path: Path, names: Sequence[str], camera: Index, t: Array) -> None:
    """Rows of a camera are in the order of their times."""
    for number, name in enumerate(names):
        rows = np.flatnonzero(camera == number)
        bad = np.flatnonzero(np.diff(t[rows]) <= 0.0)
        if bad.size:
            a, b = rows[bad[0]], rows[bad[0] + 1]
            what = "duplicate" if t[a] == t[b] else "unordered"
            raise FormatError(
                f"{path}: {what} shots of camera {name}: t is {t[a]:.9g} in row {a + 1} and {t[b]:.9g} in "
                "row "
                f"{b + 1}; times must increase from shot to shot; sort the rows by time, or correct t"
            )


def _check_shots(path: Path, shots: Array, place: Index, t: Array) -> None:
    """Images of a shot are exposed together, and shots are numbered in the order of time."""
    first = np.full(len(shots), np.inf)
    last = np.full(len(shots), -np.inf)
    np.minimum.at(first, place, t)
    np.maximum.at(last, place, t)
    apart = np.flatnonzero(last - first > SAME_TIME)
    if apart.size:
        k = int(apart[0])
        raise FormatError(
            f"{path}: images of shot {shots[k]:g} are {last[k] - first[k]:.6g} s apart (t = {first[k]:.9g} "
            "and "
            f"{last[k]:.9g}); images of one shot are exposed together, within {SAME_TIME:g} s: correct t, or "
            "give every exposure a shot of its own and its points in observations"
        )
    wrong = np.flatnonzero(np.diff(first) <= 0.0)
    if wrong.size:
        k = int(wrong[0])
        raise FormatError(
            f"{path}: unordered shots: shot {shots[k]:g} is at t = {first[k]:.9g} and shot "
            f"{shots[k + 1]:g} at "
            f"{first[k + 1]:.9g}; shots are numbered in the order of time: renumber them, or correct t"
        )


@dataclass(frozen=True, eq=False)
class PointTable:
    """Points found in images, one row per sighting.

    Attributes
    ----------
    path : Path
        The table.
    image : (N,) int
        Row of the poses.
    point : (N,)
        Number as in the file.
    pixels : (N, 2)
        (line, column).
    sigma_px : (N,)
        px.
    pairs : int or None
        Of ``matches``: how many there are; sighting n of camera 1 and n + pairs of camera 2 are one match.
    """

    path: Path
    image: Index
    point: Array
    pixels: Array
    sigma_px: Array
    pairs: int | None = None


@reads("a CSV table")
def read_stereo_matches(path: Path, poses: StereoPoseTable, sigma_px: float | None) -> PointTable:
    """``shot,point,line_1,column_1,line_2,column_2[,sigma_px]`` of two cameras."""
    if len(poses.cameras) != 2:
        raise FormatError(
            f"{path}: matches are between two cameras, the table of cameras has {len(poses.cameras)} "
            f"({listed(poses.cameras)}); give observations = FILE (camera,shot,point,line,column)"
        )
    table = read_long_columns(path, MATCHES, optional=("sigma_px",))
    shot, point = (whole_numbers(path, name, table[name]) for name in ("shot", "point"))
    twice = repeated(shot, point)
    if twice is not None:
        raise FormatError(
            f"{path}: rows {twice[0] + 1} and {twice[1] + 1} are both point {point[twice[1]]:g} of shot "
            f"{shot[twice[1]]:g}; a point is found once in a shot: remove one of them"
        )
    count = len(shot)
    images = [poses.image_of(path, np.full(count, k, dtype=np.intp), shot) for k in range(2)]
    pixels = [np.column_stack([table[f"line_{k}"], table[f"column_{k}"]]) for k in (1, 2)]
    sigma = _sigma_px(path, table, count, sigma_px)
    return PointTable(
        path, np.concatenate(images), np.tile(point, 2), np.concatenate(pixels), np.tile(sigma, 2), count
    )


@reads("a CSV table")
def read_observations(
    path: Path, poses: StereoPoseTable, sigma_px: float | None, *, strips: bool = False
) -> PointTable:
    """``camera,shot,point,line,column[,sigma_px]`` of any number of cameras; of `strips` without shots."""
    names = tuple(name for name in OBSERVATIONS if not (strips and name == "shot"))
    table = read_long_columns(path, names, optional=("sigma_px",), text=("camera",))
    camera = numbers_of(path, poses.cameras, table["camera"])
    point = whole_numbers(path, "point", table["point"])
    shot = np.zeros(len(point)) if strips else whole_numbers(path, "shot", table["shot"])
    image = poses.image_of(path, camera, shot)
    refuse_seen_twice(path, image, point)
    pixels = np.column_stack([table["line"], table["column"]])
    return PointTable(path, image, point, pixels, _sigma_px(path, table, len(point), sigma_px))


def refuse_seen_twice(path: Path, image: Index, point: NDArray[Any]) -> None:
    """A point is found once in an image."""
    twice = repeated(image, point)
    if twice is not None:
        raise FormatError(
            f"{path}: rows {twice[0] + 1} and {twice[1] + 1} are both point {point[twice[1]]:g} in the same "
            "image; a point is found once in an image: remove one of them"
        )


def _sigma_px(path: Path, table: dict[str, Any], count: int, sigma_px: float | None) -> Array:
    """Sigma of each row: its own, else that of ``[noise]``."""
    if "sigma_px" not in table:
        if sigma_px is None:
            raise FormatError(
                f"{path}: has no column sigma_px and [noise] no sigma_px; give one of them (px, of each "
                "coordinate of a point)"
            )
        return np.full(count, sigma_px)
    return sigma_columns(path, table, ["sigma_px"], PIXEL_SIGMA)[:, 0]


@dataclass(frozen=True, eq=False)
class StereoControl:
    """Points of known coordinates.

    Attributes
    ----------
    position : (G, 3)
        As in the table.
    sigma : (G,)
        m.
    point : (G,) or None
        Number of each among the points of the file; None where the table has pixels of its own.
    seen : PointTable or None
        Where the points of this table were seen; `seen.point` counts the rows of `position` from 0.
    """

    position: Array
    sigma: Array
    point: Array | None
    seen: PointTable | None


@reads("a CSV table")
def read_stereo_control(path: Path, poses: StereoPoseTable, sigma_px: float | None) -> StereoControl:
    """``x,y,z,sigma`` and ``point``, or ``camera,shot,line,column``, or ``image,line,column``."""
    read = read_control_points(path, stereo=True)
    if read.point is not None:
        point = whole_numbers(path, "point", read.point)
        twice = repeated(point)
        if twice is not None:
            raise FormatError(
                f"{path}: rows {twice[0] + 1} and {twice[1] + 1} are both point {point[twice[1]]:g}; "
                "remove one"
            )
        return StereoControl(read.position, read.sigma, point, None)
    names, shots = _images_apart(path, read.image)
    camera = numbers_of(path, poses.cameras, names)
    image = poses.image_of(path, camera, whole_numbers(path, "shot", shots))
    different, place = np.unique(np.column_stack([read.position, read.sigma]), axis=0, return_inverse=True)
    which = np.asarray(place, dtype=np.float64).reshape(-1)
    refuse_seen_twice(path, image, which)
    own = {} if read.sigma_px is None else {"sigma_px": read.sigma_px}
    seen = PointTable(path, image, which, read.pixels, _sigma_px(path, own, len(which), sigma_px))
    return StereoControl(different[:, :3].copy(), different[:, 3].copy(), None, seen)


def _images_apart(path: Path, images: Sequence[str]) -> tuple[list[str], Array]:
    """Cameras and shots of ``camera/shot``."""
    cameras, shots = [], []
    for row, image in enumerate(images, 1):
        camera, slash, shot = image.rpartition("/")
        try:
            shots.append(float(shot))
        except ValueError:
            slash = ""
        if not slash or not camera:
            raise FormatError(
                f'{path}: row {row}: image = {image!r}; "camera/shot" is expected, such as "1/12"'
            )
        cameras.append(camera)
    return cameras, np.array(shots)


def check_in_frames(
    path: Path, image: Index, camera: Index, pixels: Array, shapes: Sequence[tuple[int, int]]
) -> None:
    """Refuse points that lie outside the frames.

    Parameters
    ----------
    path : Path
        The table of points, named in the message.
    image : (N,) int
        Row of the table of cameras.
    camera : (M,) int
        Of each image.
    pixels : (N, 2)
        (line, column).
    shapes : sequence of (lines, columns)
        One per camera.
    """
    last = np.array(shapes, dtype=np.float64)[camera[image]] - 1.0
    outside = ((pixels < -BEYOND_PX) | (pixels > last + BEYOND_PX)).any(axis=1)
    if not outside.any():
        return
    row = int(np.flatnonzero(outside)[0])
    swapped = pixels[outside][:, ::-1]
    fits = ((swapped >= -0.5) & (swapped <= last[outside] + 0.5)).all()
    hint = "are line and column exchanged?" if fits else "check [camera] shape and the columns"
    lines, columns = (int(n) + 1 for n in last[row])
    raise FormatError(
        f"{path}: a point at line {pixels[row, 0]:g}, column {pixels[row, 1]:g} lies outside its frame of "
        f"{lines} "
        f"lines x {columns} columns ({int(outside.sum())} such in all); {hint}"
    )


@dataclass(frozen=True, eq=False)
class ImageTable:
    """``images.csv``.

    Attributes
    ----------
    row : (M,) int
        Of the table of cameras, for each image.
    files, masks : tuple of str or None
        Paths as given.
    """

    row: Index
    files: tuple[str, ...]
    masks: tuple[str | None, ...]


@reads("a CSV table")
def read_image_list(path: Path, poses: StereoPoseTable) -> ImageTable:
    """``camera,shot,image[,mask]``: the picture of every pose that has one."""
    masked = "mask" in header_of(path)
    columns = (*IMAGES, "mask") if masked else IMAGES
    table = read_columns(path, columns, text=("camera", "image", "mask"))
    camera = numbers_of(path, poses.cameras, [str(word) for word in table["camera"]])
    shot = whole_numbers(path, "shot", np.asarray(table["shot"], dtype=np.float64))
    row = poses.image_of(path, camera, shot)
    twice = repeated(row)
    if twice is not None:
        raise FormatError(
            f"{path}: rows {twice[0] + 1} and {twice[1] + 1} are the same shot of the same camera; remove one"
        )
    files = tuple(str(word) for word in table["image"])
    check_images(path, files)
    masks = tuple(str(word) or None for word in table["mask"]) if masked else (None,) * len(files)
    return ImageTable(row, files, masks)
