"""CSV tables ↔ arrays: exact headers, every number checked, errors that name file and row.

Positions, attitudes, star-tracker and gyro tables, control points, line times, viewing
directions; ``motion.csv``, ``truth.csv``, ``attitude.csv``, ``spectrum.csv``, ``differences.csv``.

Not here: CCSDS messages (``ccsds.py``), sensor-model files (``isd.py``).
"""

from __future__ import annotations

import csv
import io
import posixpath
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from sightline.access import read_text
from sightline.errors import FormatError, InputError, foreign_errors, reads
from sightline.io.quantities import (
    ANGLE_SIGMA,
    LENGTH_SIGMA,
    PIXEL_SIGMA,
    QUATERNION_TOLERANCE,
    Within,
    shown,
)
from sightline.motion.estimators.differences import AngleDifferences
from sightline.writing import whole

Array = NDArray[np.float64]

POSITIONS = ("t", "x", "y", "z")
ATTITUDES = ("t", "qx", "qy", "qz", "qw")
STAR_TRACKER = ("t", "roll", "pitch", "yaw", "sigma")
FEATURES = ("image", "line", "column")
PSD = ("f", "roll", "pitch", "yaw")
GYRO = ("t_start", "t_end", "roll", "pitch", "yaw", "sigma")
CONTROL = ("x", "y", "z", "sigma")
CONTROL_POINTS = (*CONTROL, "image", "line", "column")
DIRECTIONS = ("column", "x", "y", "z")
LINE_TIMES = ("line", "t")
MIRROR_ANGLES = ("t", "angle")
ANGLES = ("roll", "pitch", "yaw")
TRUTH = ("t", *ANGLES)
MOTION = (
    "t",
    *ANGLES,
    *(f"sigma_{axis}" for axis in ANGLES),
    *(f"sigma_absolute_{axis}" for axis in ANGLES),
    "observed",
    "line",
)
SPECTRUM = ("frequency", *(f"{kind}_{axis}" for kind in ("psd", "error", "observed") for axis in ANGLES))

#: px; control points of an image that are nearer to each other are one: nobody measures as well.
SAME_PIXEL = 1e-3
#: Lines of the tallest window that a control point may be the mean of.
MOST_LINES = 10_000.0
#: Sigmas of a control point by their causes: px of the two pixel coordinates, m of each of the ground.
_EACH = ["sigma_line", "sigma_column", "sigma_ground"]
#: Rows that are words at a time where a table is written.
ROWS_AT_ONCE = 8192
#: Columns that hold instants.
_TIMES = ("t", "t_start", "t_end")
#: No quantity of a table is as large in its unit: from here on they stand for none, as NetCDF's 9.97e36 does.
FILL = 1e30
_QUOTE = '"'
#: What a cell in quotes alone can hold.
_QUOTED = re.compile(r'[",\r\n]|^\s*#')


@dataclass(frozen=True, eq=False)
class MotionTable:
    """The columns of ``motion.csv`` (or of ``truth.csv``, which has the first four).

    Attributes
    ----------
    t : (N,)
        s from the epoch.
    angles : (N, 3)
        rad; roll, pitch, yaw.
    sigma, sigma_absolute : (N, 3) or None
        rad, 1-sigma; None in a table of truth.
    observed : (N,) bool or None
        False where only the prior or interpolation speaks.
    lines : (N,) int or None
        Lines of the first image, gone on before and after it; None of frames, and where a table says nothing.
    """

    t: Array
    angles: Array
    sigma: Array | None = None
    sigma_absolute: Array | None = None
    observed: NDArray[np.bool_] | None = None
    lines: NDArray[np.int64] | None = None


@reads("a CSV table")
def read_columns(
    path: Path, columns: Sequence[str], text: Sequence[str] = (), infinite: Sequence[str] = ()
) -> dict[str, list[str] | Array]:
    """The named columns of a CSV file with a header line.

    Parameters
    ----------
    path : Path
        The file; lines that start with ``#`` are comments.
    columns : sequence of str
        Names the header must have, exactly, in any order; further columns are ignored.
    text : sequence of str
        Those that hold words, given back as lists.
    infinite : sequence of str
        Those in which ``inf`` is allowed.

    Returns
    -------
    dict
        Name to (N,) array or list of words.

    Raises
    ------
    FormatError
        Names the file, the row (counted as an editor counts) and the column.
    """
    rows = _rows(path)
    header = [name.strip() for name in rows[0][1]]
    _check_header(path, header, columns)
    body = rows[1:]
    if not body:
        raise FormatError(f"{path}: no rows below the header {','.join(header)!r}; at least one is needed")
    for number, row in body:
        if len(row) != len(header):
            raise FormatError(
                f"{path}: line {number} has {len(row)} values, the header has {len(header)}; "
                + _row_advice(row, len(header))
            )
    result: dict[str, list[str] | Array] = {}
    for name in columns:
        at = header.index(name)
        words = [row[at].strip() for _, row in body]
        result[name] = words if name in text else _numbers(path, name, words, body, name in infinite)
    return result


def _check_header(path: Path, header: Sequence[str], columns: Sequence[str]) -> None:
    """FormatError where a column is missing, or there twice; another sign between names is recognised."""
    twice = [name for name in columns if header.count(name) > 1]
    if twice:
        raise FormatError(
            f"{path}: column {twice[0]!r} is there {header.count(twice[0])} times: the header is "
            f"{shown(','.join(header))}; keep the one that is meant"
        )
    missing = [name for name in columns if name not in header]
    if missing:
        other = next((sign for sign in (";", "\t", "|") if sign in header[0]), "")
        advice = f"; values are parted by commas, not by {other!r}, and hold decimal points" if other else ""
        raise FormatError(
            f"{path}: column {missing[0]!r} is missing: the header is {shown(','.join(header))}; "
            f"expected {','.join(columns)!r}{advice}"
        )


def _row_advice(row: Sequence[str], columns: int) -> str:
    """What to do about a row of another length than the header: commas may be decimal ones."""
    if len(row) > columns and sum(cell.strip().isdigit() for cell in row) >= len(row) - columns:
        return "are there decimal commas in it? Numbers are written with a decimal point (0.5)"
    return "correct that line"


@reads("a CSV table")
def read_long_columns(
    path: Path, columns: Sequence[str], optional: Sequence[str] = (), text: Sequence[str] = ()
) -> dict[str, Any]:
    """The same as `read_columns`, for tables of some hundred thousand rows.

    Parameters
    ----------
    path : Path
    columns : sequence of str
        Names the header must have, in any order.
    optional : sequence of str
        Names it may have.
    text : sequence of str
        Those that hold words.

    Returns
    -------
    dict
        Name to (N,) array of numbers or list of words; those of `optional` that are there.

    Raises
    ------
    FormatError
        As of `read_columns`.
    """
    rows = _lines(path)
    if not rows:
        raise FormatError(f"{path}: the file is empty; a header line and rows are expected")
    header = [name.strip() for name in next(_records(path, [rows[0][1]]))[1]]
    names = [*columns, *(name for name in optional if name in header)]
    lines = [line for _, line in rows[1:]]
    commas = len(header) - 1
    plain = all(header.count(name) == 1 for name in names) and len(lines) > 0
    if not plain or any(line.count(",") != commas or '"' in line for line in lines):
        return dict(read_columns(path, names, text))
    at = {name: header.index(name) for name in names}
    numbers = [name for name in names if name not in text]
    try:
        values = np.loadtxt(lines, delimiter=",", usecols=[at[n] for n in numbers], comments=None, ndmin=2)
    except ValueError:
        return dict(read_columns(path, names, text))
    if not (np.abs(values) < FILL).all():
        return dict(read_columns(path, names, text))
    table: dict[str, Any] = {name: values[:, k].copy() for k, name in enumerate(numbers)}
    for name in text:
        if name in at:
            table[name] = [line.split(",")[at[name]].strip() for line in lines]
    return table


@reads("a CSV table")
def header_of(path: Path, columns: Sequence[str] = ()) -> list[str]:
    """Names of the columns of a CSV file; FormatError where there is none, or one of `columns` is missing."""
    header = [name.strip() for name in _rows(path)[0][1]]
    _check_header(path, header, columns)
    return header


@reads("a CSV table")
def first_row(path: Path) -> dict[str, str]:
    """Cells of the first row of a CSV file by the names of their columns; none where there is no row."""
    rows = _rows(path)
    if len(rows) < 2:
        return {}
    return {name.strip(): cell.strip() for name, cell in zip(rows[0][1], rows[1][1], strict=False)}


def line_of_row(path: Path, row: int) -> int:
    """Line of a CSV file, as an editor counts, that holds row `row` (from 0) below the header."""
    rows = _rows(path)
    if row + 1 >= len(rows):
        raise FormatError(f"{path}: has {len(rows) - 1} rows below its header, row {row + 1} is asked for")
    return rows[row + 1][0]


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and cells of every row that is neither empty nor a comment."""
    rows = list(_records(path, _text_lines(path)))
    if not rows:
        raise FormatError(f"{path}: the file is empty; a header line and rows are expected")
    return rows


def _records(path: Path, lines: Sequence[str]) -> Iterator[tuple[int, list[str]]]:
    """The rows; a cell in quotes may go on over several lines, whatever these hold."""
    begun = 0  # line of the row at hand; 0 between rows

    def fed() -> Iterator[str]:
        nonlocal begun
        for number, line in enumerate(lines, 1):
            if begun or not _left_out(line):
                begun = begun or number
                yield line

    try:
        for row in csv.reader(fed()):
            yield begun, row
            begun = 0
    except csv.Error as error:
        raise FormatError(
            f"{path}: line {begun}: cannot be read as CSV ({error}); correct that line"
        ) from error


def _left_out(line: str) -> bool:
    """Whether a line is empty or a comment."""
    return not line.strip() or line.lstrip().startswith("#")


def _lines(path: Path) -> list[tuple[int, str]]:
    """Number and text of every line that is neither empty nor a comment."""
    return [(number, line) for number, line in enumerate(_text_lines(path), 1) if not _left_out(line)]


def _text_lines(path: Path) -> list[str]:
    text = read_text(path, "a CSV table", advice="check the name in the TOML file")
    return list(io.StringIO(text, newline=""))


def _numbers(
    path: Path, name: str, words: list[str], body: list[tuple[int, list[str]]], infinite: bool
) -> Array:
    """A column as floats; the first word that is not a finite number is named."""
    try:
        if any("_" in word for word in words):
            raise ValueError
        values = np.array(words, dtype=np.float64)
    except ValueError:
        for word, (number, _) in zip(words, body, strict=True):
            if not _is_number(word):
                raise FormatError(
                    f"{path}: line {number}, column {name!r}: {word!r} is not a number"
                    f"{_number_advice(name, word)}"
                ) from None
        raise
    bad = np.isnan(values) if infinite else ~(np.abs(values) < FILL)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        fill = "no quantity is as large, it stands for none"
        what = fill if np.isfinite(values[first]) else "finite numbers are expected"
        raise FormatError(
            f"{path}: line {body[first][0]}, column {name!r} is {words[first]} ({int(bad.sum())} such in "
            f"all); {what}; remove the row or supply the value"
        )
    return values


def _is_number(word: str) -> bool:
    """Whether a word is a number in a table: Python itself would take 1_000 for 1000."""
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word


def _number_advice(name: str, word: str) -> str:
    """What is expected in place of a word that is no number."""
    plain = word.replace("_", "")
    if plain != word and _is_number(plain):
        return f"; digits are written without underscores: {plain}"
    if name in _TIMES:
        return "; seconds from the epoch (t = 0) are expected, as 12.5"
    if re.fullmatch(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", word):
        return f"; numbers are written with a decimal point: {word.replace(',', '.')}"
    return ""


def check_images(path: Path, images: Sequence[str]) -> None:
    """FormatError where a row names no image, or that of another row: it would match itself perfectly."""
    met: dict[str, int] = {}
    for row, image in enumerate(images):
        if not image:
            raise FormatError(f"{path}: row {row + 1} names no image")
        first = met.setdefault(posixpath.normpath(image), row)
        if first != row:
            raise FormatError(
                f"{path}: rows {first + 1} and {row + 1} name the same image, {shown(image)}; each has "
                "another one"
            )


def check_times(path: Path, t: Array, name: str = "t") -> None:
    """Refuse times that do not increase from row to row; the message says which rows and what to do."""
    step = np.diff(t)
    if np.all(step > 0.0):
        return
    first = int(np.flatnonzero(step <= 0.0)[0])
    same = step[first] == 0.0
    raise FormatError(
        f"{path}: {'duplicate' if same else 'unordered'} times: {name!r} is {t[first]:.9g} in row "
        f"{first + 1} and "
        f"{t[first + 1]:.9g} in row {first + 2}; times must increase; "
        f"{'remove one of the two rows' if same else 'sort the rows by time'}"
    )


def _matrix(table: Mapping[str, list[str] | Array], names: Sequence[str]) -> Array:
    """Columns of a table side by side."""
    return np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])


@reads("a CSV table")
def read_positions(path: Path) -> tuple[Array, Array]:
    """``t,x,y,z``: times (N,) s and positions (N, 3), in whatever axes ``[world]`` says."""
    table = read_columns(path, POSITIONS)
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    return t, _matrix(table, POSITIONS[1:])


@reads("a CSV table")
def read_attitudes(path: Path) -> tuple[Array, Array]:
    """``t,qx,qy,qz,qw``: times (N,) s and unit quaternions (N, 4), scalar last, world_from_body.

    Raises
    ------
    FormatError
        If a quaternion is not of length 1; the commonest cause, a scalar that stands first, cannot
        be seen by length, so the header must say ``qx,qy,qz,qw``.
    """
    table = read_columns(path, ATTITUDES)
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    return t, check_quaternions(path, _matrix(table, ATTITUDES[1:]))


def check_quaternions(path: Path, quat_xyzw: Array) -> Array:
    """Quaternions (N, 4) scaled to length 1; FormatError if one is farther from it than rounding goes."""
    length = np.linalg.norm(quat_xyzw, axis=1)
    bad = np.abs(length - 1.0) > QUATERNION_TOLERANCE
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise FormatError(
            f"{path}: row {row + 1} holds a quaternion of length {length[row]:.6g}; "
            "attitudes are unit quaternions qx,qy,qz,qw; check the columns and their order"
        )
    return np.asarray(quat_xyzw / length[:, None])


@reads("a CSV table")
def read_star_tracker(path: Path) -> tuple[Array, Array, Array]:
    """``t,roll,pitch,yaw,sigma``: times (N,), angles (N, 3) rad, sigma (N,) rad."""
    table = read_columns(path, STAR_TRACKER)
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    return t, _matrix(table, ANGLES), sigma_columns(path, table, ["sigma"], ANGLE_SIGMA)[:, 0]


@reads("a CSV table")
def read_gyro(path: Path) -> tuple[Array, Array, Array, Array]:
    """``t_start,t_end,roll,pitch,yaw,sigma``: starts, ends (N,) s, increments (N, 3) rad, sigma (N,) rad."""
    table = read_columns(path, GYRO)
    start, end = _matrix(table, ["t_start"])[:, 0], _matrix(table, ["t_end"])[:, 0]
    check_times(path, start, "t_start")
    if np.any(end <= start):
        row = int(np.flatnonzero(end <= start)[0])
        raise FormatError(
            f"{path}: row {row + 1} ends at t_end = {end[row]:.9g}, not after t_start = {start[row]:.9g}; "
            "an increment needs a positive duration; are the two columns swapped?"
        )
    return start, end, _matrix(table, ANGLES), sigma_columns(path, table, ["sigma"], ANGLE_SIGMA)[:, 0]


def sigma_columns(
    path: Path, table: Mapping[str, Any], names: Sequence[str], bounds: Within, *, unknown: bool = False
) -> Array:
    """Columns of 1-sigma errors, (N, len(names)).

    Parameters
    ----------
    path : Path
        For messages.
    table : mapping
        As read.
    names : sequence of str
    bounds : Within
        What a TOML file may give of the kind.
    unknown : bool
        Whether inf, for what is not known, is allowed.

    Raises
    ------
    FormatError
        If one is not within the bounds.
    """
    sigma = _matrix(table, names)
    allowed = (sigma >= bounds.least) & (sigma <= bounds.most)
    bad = np.argwhere(~(allowed | (unknown & (sigma == np.inf)) | (bounds.zero & (sigma == 0.0))))
    if not len(bad):
        return sigma
    row, column = (int(k) for k in bad[0])
    value = sigma[row, column]
    ranged = bounds.zero or value > 0.0
    why = f" is not allowed: {bounds.words()}" if ranged else "; a 1-sigma error must be positive"
    raise FormatError(
        f"{path}: row {row + 1}: {names[column]} = {value:.6g}{why}{' (inf: not known)' if unknown else ''}"
    )


@dataclass(frozen=True, eq=False)
class ControlTable:
    """Control points as they are given, row by row.

    Attributes
    ----------
    position : (N, 3)
        In whatever axes ``[world]`` says.
    sigma : (N,)
        m.
    point : (N,) or None
        Number of each; None where they were seen in pixels of their own.
    image : list of str
        Where each was seen; ``camera/shot`` of stereo. None of them where rows are numbers of points.
    pixels : (N, 2)
        (line, column).
    sigma_px : (N,) or None
        px, of each pixel, where the table says it.
    lines : (N,) or None
        Lines that each place is the mean of, where the table says it.
    each_px : (N, 2) or None
        px; of line and of column, where the table says it, and in `sigma` the ground's own.
    """

    position: Array
    sigma: Array
    point: Array | None
    image: list[str]
    pixels: Array
    sigma_px: Array | None
    lines: Array | None = None
    each_px: Array | None = None


@reads("a CSV table")
def read_control_points(path: Path, *, stereo: bool = False) -> ControlTable:
    """``x,y,z,sigma,image,line,column[,lines][,sigma_line,sigma_column,sigma_ground]``; of stereo otherwise.

    Those have ``x,y,z,sigma``, and may have ``point`` in place of a pixel, ``camera,shot`` in place of
    ``image``, and ``sigma_px``.
    """
    said = header_of(path)
    header = said if stereo else list(CONTROL_POINTS)
    if "point" in header:
        table = read_columns(path, (*CONTROL, "point"))
        position, number = _matrix(table, "xyz"), _matrix(table, ["point"])[:, 0]
        sigma = sigma_columns(path, table, ["sigma"], LENGTH_SIGMA)[:, 0]
        return ControlTable(position, sigma, number, [], np.empty((0, 2)), None)
    named, words = (("image",), ("image",)) if "image" in header else (("camera", "shot"), ("camera",))
    if not set(named) <= set(header):
        raise FormatError(
            f"{path}: the header is {','.join(header)!r}; besides {','.join(CONTROL)} give point (of the "
            'table of points), or camera,shot,line,column, or image,line,column with image = "camera/shot"'
        )
    own = [name for name, where in (("sigma_px", header), ("lines", said)) if name in where]
    own += [] if stereo or not {*_EACH} <= {*said} else _EACH
    table = read_columns(path, (*CONTROL, *named, "line", "column", *own), text=words)
    images = [str(name) for name in table[words[0]]]
    if words == ("camera",):
        images = [f"{name}/{float(shot)!r}" for name, shot in zip(images, table["shot"], strict=True)]
    sigma = sigma_columns(path, table, ["sigma"], LENGTH_SIGMA)[:, 0]
    if _EACH[2] in own:
        sigma = sigma_columns(path, table, _EACH[2:], LENGTH_SIGMA)[:, 0]
    pixels = _each_once(images, _matrix(table, ("line", "column")), path)
    return ControlTable(
        _matrix(table, "xyz"), sigma, None, images, pixels,
        sigma_columns(path, table, ["sigma_px"], PIXEL_SIGMA)[:, 0] if "sigma_px" in own else None,
        _window_lines(path, table) if "lines" in own else None,
        sigma_columns(path, table, _EACH[:2], PIXEL_SIGMA) if _EACH[0] in own else None,
    )  # fmt: skip


def _each_once(images: Sequence[str], pixels: Array, table: Path | None, listed: int = 0) -> Array:
    """The pixels (N, 2) of control points, `listed` ones first, of which none stands twice in an image."""
    number = {image: k for k, image in enumerate(dict.fromkeys(images))}
    places = (
        np.column_stack([pixels, [number[image] for image in images]]) if len(images) else np.zeros((0, 3))
    )
    tree = cKDTree(places)
    # one after the other: all pairs of a table of one pixel are more than memory holds
    pairs = ((min(tree.query_ball_point(place, SAME_PIXEL)), row) for row, place in enumerate(places))
    again = next((pair for pair in pairs if pair[0] < pair[1]), None)
    if again is not None:
        one, other = (
            f"[[control_point]] {k + 1}" if k < listed else f"row {k - listed + 1} of {table}" for k in again
        )
        line, column = pixels[again[1]]
        raise FormatError(
            f"{other} is at the pixel of {one}: line {line:g}, column {column:g} of {images[again[1]]!r}; "
            "it would count twice: keep one of them"
        )
    return pixels


def _window_lines(path: Path, table: Mapping[str, list[str] | Array]) -> Array:
    """The column lines: 1 or more everywhere."""
    lines = _matrix(table, ["lines"])[:, 0]
    bad = np.flatnonzero((lines < 1.0) | (lines > MOST_LINES))
    if bad.size:
        row = int(bad[0])
        raise FormatError(
            f"{path}: row {row + 1}: lines = {lines[row]:.6g}; 1 (the place is of its own line) to "
            f"{MOST_LINES:g} are allowed, of which it is the mean"
        )
    return lines


class ControlEntry(Protocol):
    """One ``[[control_point]]``."""

    x: float
    y: float
    z: float
    sigma: float
    image: str
    line: float
    column: float


def control_points(listed: Sequence[ControlEntry], table: Path | None) -> ControlTable | None:
    """Control points that a TOML file lists and those of the table that it names; None if there are none."""
    images = [p.image for p in listed]
    pixels = np.array([(p.line, p.column) for p in listed], dtype=np.float64).reshape(-1, 2)
    own = ControlTable(
        np.array([(p.x, p.y, p.z) for p in listed], dtype=np.float64).reshape(-1, 3),
        np.array([p.sigma for p in listed], dtype=np.float64), None, images,
        _each_once(images, pixels, None, len(listed)), None,
    )  # fmt: skip
    if table is None:
        return own if len(listed) else None
    read = read_control_points(table)
    if not listed:
        return read
    if read.each_px is not None:
        raise FormatError(
            f"{table}: has {', '.join(_EACH)} of each point, and [[control_point]] are listed beside it; "
            "put all into the table"
        )
    lines = None if read.lines is None else np.concatenate([np.ones(len(listed)), read.lines])
    images = images + read.image
    pixels = _each_once(images, np.concatenate([pixels, read.pixels]), table, len(listed))
    return ControlTable(
        np.concatenate([own.position, read.position]), np.concatenate([own.sigma, read.sigma]), None,
        images, pixels, None, lines,
    )  # fmt: skip


@reads("a CSV table")
def read_features(path: Path) -> tuple[list[str], Array]:
    """``image,line,column``: image names and pixels (N, 2) of known features."""
    table = read_columns(path, FEATURES, text=("image",))
    if not len(table["line"]):
        raise FormatError(f"{path}: no feature; list at least one image,line,column")
    return [str(name) for name in table["image"]], _matrix(table, ("line", "column"))


@reads("a CSV table")
def read_psd(path: Path) -> tuple[Array, Array]:
    """``f,roll,pitch,yaw``: frequencies (N,) Hz, one-sided spectra (N, 3) rad^2/Hz."""
    table = read_columns(path, PSD)
    f, density = _matrix(table, ["f"])[:, 0], _matrix(table, ANGLES)
    if len(f) < 2:
        raise FormatError(f"{path}: {len(f)} row; a spectrum needs two frequencies or more")
    falls = np.flatnonzero((np.diff(f, prepend=-1.0) <= 0.0) | (f < 0.0))
    if falls.size:
        row = int(falls[0])
        raise FormatError(f"{path}: row {row + 1} has f = {f[row]:g}; f must increase from 0 Hz or more")
    bad = np.flatnonzero((density < 0.0).any(axis=1))
    if bad.size:
        raise FormatError(f"{path}: row {int(bad[0]) + 1} holds a negative density; rad^2/Hz is 0 or more")
    for axis, column in zip(ANGLES, density.T, strict=True):
        if not column.any():
            raise FormatError(
                f"{path}: {axis} is 0 at every frequency; give a small density if it hardly moves"
            )
    return f, density


@reads("a CSV table")
def read_directions(path: Path) -> Array:
    """``column,x,y,z``: unit viewing directions (columns, 3) in camera axes, one row per column from 0."""
    table = read_columns(path, DIRECTIONS)
    _check_count(path, "column", _matrix(table, ["column"])[:, 0])
    directions = _matrix(table, "xyz")
    length = np.linalg.norm(directions, axis=1)
    if np.any(length == 0.0) or np.any(directions[:, 2] <= 0.0):
        row = int(np.flatnonzero((length == 0.0) | (directions[:, 2] <= 0.0))[0])
        raise FormatError(
            f"{path}: row {row + 1} looks along {directions[row].tolist()}; "
            "camera z points to the scene, so z must be positive"
        )
    return np.asarray(directions / length[:, None])


@reads("a CSV table")
def read_line_times(path: Path) -> Array:
    """``line,t``: the centre of exposure of every line from 0, (lines,) s, increasing."""
    table = read_columns(path, LINE_TIMES)
    _check_count(path, "line", _matrix(table, ["line"])[:, 0])
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    return t


@reads("a CSV table")
def read_mirror_angles(path: Path) -> tuple[Array, Array]:
    """``t,angle``: times (N,) s, increasing, and angles of a scan mirror (N,) rad."""
    table = read_columns(path, MIRROR_ANGLES)
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    return t, _matrix(table, ["angle"])[:, 0]


def _check_count(path: Path, name: str, values: Array) -> None:
    """A counting column must run 0, 1, 2, ... without a gap."""
    wrong = np.flatnonzero(values != np.arange(len(values)))
    if wrong.size:
        row = int(wrong[0])
        raise FormatError(
            f"{path}: row {row + 1} has {name} = {values[row]:g}; {name}s must run 0, 1, 2, ... without a gap"
        )


@reads("a CSV table")
def read_motion(path: Path) -> MotionTable:
    """A ``motion.csv`` or a ``truth.csv``: whichever columns it has beyond t, roll, pitch, yaw."""
    header = [name.strip() for name in _rows(path)[0][1]]
    full = all(name in header for name in MOTION[:-1])
    names = tuple(name for name in MOTION if name in header) if full else TRUTH
    table = read_columns(path, names, text=("line",), infinite=MOTION[7:10])
    t = _matrix(table, ["t"])[:, 0]
    check_times(path, t)
    angles = _matrix(table, ANGLES)
    if not full:
        return MotionTable(t, angles)
    return MotionTable(
        t,
        angles,
        _matrix(table, MOTION[4:7]),
        _matrix(table, MOTION[7:10]),
        np.asarray(_matrix(table, ["observed"])[:, 0] != 0.0),
        _lines_of(path, table.get("line", [])),
    )


def _lines_of(path: Path, words: Sequence[str] | Array) -> NDArray[np.int64] | None:
    """The column `line`; None where it is empty."""
    if not any(words):
        return None
    with foreign_errors(path, "column 'line' holds no whole numbers", "give lines, or leave all empty"):
        return np.array([int(word) for word in words], dtype=np.int64)


def write_columns(
    path: Path, columns: Mapping[str, ArrayLike], formats: Mapping[str, str] | None = None
) -> None:
    """Columns as a CSV file, complete or not at all.

    Parameters
    ----------
    path : Path
        Written under a temporary name beside it, then renamed.
    columns : mapping
        Header to (N,) numbers or words.
    formats : mapping, optional
        Header to a ``%`` format; ``%.9g`` for numbers otherwise, times with 17 digits.
    """
    given, arrays = dict(formats or {}), {name: np.asarray(values) for name, values in columns.items()}
    if len({len(array) for array in arrays.values()}) > 1:
        raise ValueError(f"columns of unlike lengths: { {name: len(a) for name, a in arrays.items()} }")

    def cells(name: str, array: NDArray[Any]) -> list[str]:
        if array.dtype.kind in "US":
            return [csv_cell(str(word)) for word in array]
        if array.dtype.kind in "biu":
            return [str(int(value)) for value in array]
        form = given.get(name, "%.17g" if name == "t" or name.startswith("t_") else "%.9g")
        return [form % value for value in array.tolist()]

    count = len(next(iter(arrays.values()), ()))
    with (
        whole(path) as draft,
        draft.open("w", newline="", encoding="utf-8", errors="backslashreplace") as stream,
    ):
        stream.write(",".join(map(csv_cell, columns)) + "\n")
        # some rows at a time: words take ten times the room of numbers
        for first in range(0, count, ROWS_AT_ONCE):
            some = [cells(name, array[first : first + ROWS_AT_ONCE]) for name, array in arrays.items()]
            stream.writelines(",".join(row) + "\n" for row in zip(*some, strict=True))


def csv_cell(word: str) -> str:
    """A word as a cell: in quotes where it would otherwise be several cells, several lines or a comment."""
    return f'"{word.replace(_QUOTE, 2 * _QUOTE)}"' if _QUOTED.search(word) else word


def write_differences(path: Path, differences: Sequence[AngleDifferences], names: Sequence[str]) -> None:
    """``differences.csv``: angles(t + lag) - angles(t) of every pair of images, one row per axis, rad.

    Parameters
    ----------
    path : Path
    differences : sequence of AngleDifferences
    names : sequence of str
        Of the images that the differences number.
    """
    count = [3 * len(one) for one in differences]
    images = np.repeat(np.array([one.images for one in differences], dtype=np.intp).reshape(-1, 2), count, 0)

    def every(parts: list[Array]) -> Array:
        return np.concatenate(parts) if parts else np.empty(0)

    words = np.array(names, dtype=np.str_)
    columns = {
        "first": words[images[:, 0]],
        "second": words[images[:, 1]],
        "t": every([np.repeat(one.t, 3) for one in differences]),
        "lag": every([np.repeat(one.lag, 3) for one in differences]),
        "axis": np.tile(np.array(ANGLES), len(images) // 3),
        "value": every([one.angles.ravel() for one in differences]),
        "sigma": every([one.sigma().ravel() for one in differences]),
    }
    write_columns(path, columns, {"value": "%.12g"})


def write_motion(path: Path, motion: MotionTable) -> None:
    """``motion.csv`` by the contract: one row per line or frame, angles and sigmas in rad."""
    n = len(motion.t)
    if motion.sigma is None:
        raise InputError("a motion without sigma was given; `motion.csv` states one per line")
    absolute = np.full((n, 3), np.inf) if motion.sigma_absolute is None else motion.sigma_absolute
    observed = np.ones(n, dtype=bool) if motion.observed is None else motion.observed
    lines = [""] * n if motion.lines is None else motion.lines
    values = [motion.t, *motion.angles.T, *motion.sigma.T, *absolute.T, observed, lines]
    write_columns(path, dict(zip(MOTION, values, strict=True)), {axis: "%.12g" for axis in ANGLES})


def write_positions(path: Path, t: Array, positions: Array) -> None:
    """``t,x,y,z``, positions (N, 3) in m with full precision."""
    names = POSITIONS[1:]
    write_columns(
        path, dict(zip(POSITIONS, [t, *positions.T], strict=True)), {name: "%.17g" for name in names}
    )


def write_attitudes(path: Path, t: Array, quat_xyzw: Array) -> None:
    """``t,qx,qy,qz,qw``: world_from_body, scalar last, (N, 4), with full precision (``attitude.csv``)."""
    names = ATTITUDES[1:]
    write_columns(
        path, dict(zip(ATTITUDES, [t, *quat_xyzw.T], strict=True)), {name: "%.17g" for name in names}
    )


def write_spectrum(
    path: Path, frequency: Array, psd: Array, error: Array, observed: NDArray[np.bool_]
) -> None:
    """``spectrum.csv``: one-sided PSD (F, 3) rad^2/Hz per axis, that of its error, and where it was seen."""
    values = [frequency, *psd.T, *error.T, *np.asarray(observed, dtype=bool).T]
    write_columns(path, dict(zip(SPECTRUM, values, strict=True)))
