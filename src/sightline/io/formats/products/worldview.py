"""WorldView and QuickBird, level 1B: one XML file, or IMD with ATT, EPH and GEO (RPB and TIL) as text.

Everything is Earth-fixed: no date is refused, and none needs a table of leap seconds or of Earth orientation.
Attitudes hold neither aberration nor refraction: without them the model is 20 to 40 px off the maker's own
rational polynomials, with them 0.1 to 0.3 px.

Not here: text as a tree (``worldview_text.py``), what light does on its way (``geometry/apparent.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import read_bytes
from sightline.errors import FormatError
from sightline.geometry.apparent import APPARENT
from sightline.geometry.earth import WGS84
from sightline.geometry.interpolation import interpolate
from sightline.geometry.trajectory import Trajectory
from sightline.io.formats.instants import elapsed, parse_utc
from sightline.io.formats.line_scan import (
    MOST_LINES,
    MOST_SAMPLES,
    Instants,
    LineScanModel,
    OneGrid,
    SensorMotion,
    assemble,
    shared_instants,
)
from sightline.io.formats.products.makers import time_label, turned_by, words
from sightline.io.formats.products.product import (
    GroundMark,
    Pixels,
    Product,
    ProductBand,
    Tile,
    bands_of,
    image_name,
)
from sightline.io.formats.products.tree import LARGEST, Part, read_xml
from sightline.io.formats.products.worldview_text import read_text_set
from sightline.products.rpc import TERMS, Rpc

Array = NDArray[np.float64]

#: What is expected, for messages.
WHAT = "metadata of a WorldView or QuickBird product, level 1B,"
#: Records used before the first line and after the last: beyond lie jumps of the filter that made them.
_BESIDE = 4
#: rad; what a record departs from its neighbours by where the filter was joined: within an image 0.15 urad.
_JUMP = 0.5e-6
#: What a jump is of the median departure at least: fast turns of the body are no jumps.
_JUMP_RATIO = 10.0
#: Images of which both sides are multiples of this may be padded.
_BLOCK = 1024
#: m from the Earth's centre at which such satellites fly; tangents of their pixels.
_RADII, _PIXELS = (6.5e6, 7.6e6), (1e-7, 1e-4)
#: Part by which the line rate may differ from the list of line times; m/s by which velocities may from
#: positions, of which they are not the rates then.
_RATES, _SPEED = 0.05, 1.0
#: Part of the trace by which a covariance may be negative once projected, and quaternions not of length 1.
_ROUNDING = 1e-3
#: Corners: name, and whether it is of the last line, of the last column.
_CORNERS = (("UL", 0, 0), ("UR", 0, 1), ("LR", 1, 1), ("LL", 1, 0))
#: The instant that seconds of models count from.
_ORIGIN = datetime.fromisoformat("2000-01-01T12:00:00+00:00")


@dataclass(frozen=True, eq=False)
class _Records:
    """A table of ATT or EPH in the time of the image: `t` (N,), s from TLCTIME; `values` (N, K)."""

    name: str
    t: Array
    values: Array


def read_worldview(path: Path, reference: tuple[float, float] | None = None, band: int = 1) -> Product:
    """A WorldView or QuickBird product of level 1B.

    Parameters
    ----------
    path : Path
        XML, or the IMD of a set of text files that lie beside it.
    reference : (float, float), optional
        t = 0 of another model; the first line if not given.
    band : int
        Which of its bands the model is of, from 1, where each has a detector line of its own.

    Returns
    -------
    Product

    Raises
    ------
    FormatError
        If a part is missing (the GEO of a text set by its name), cut short, contradicts another, or holds a
        distortion: how that is to be applied is not verified.
    """
    root = read_xml(path, WHAT) if _is_xml(path) else read_text_set(path, WHAT)
    imd, image = root.part("IMD"), root.part("IMD/IMAGE")
    if imd.has("MAP_PROJECTED_PRODUCT"):
        raise FormatError(
            f"{path}: is a map-projected product, resampled onto the ground: no line of it was exposed at "
            "one time; order level 1B (Basic)"
        )
    start, place = image.text("TLCTIME"), f"{path}: {image.place}/TLCTIME"
    whole, fraction = parse_utc(start, place, years=None)
    told, real = _sizes(root)
    line_times, even = _line_times(image, real[0])
    later_lines = line_times if told[0] <= real[0] else _line_times(image, told[0])[0]
    positions = _around(_records(root.part("EPH"), "EPHEMLIST", 13, start), later_lines)
    attitudes = _around(_records(root.part("ATT"), "ATTLIST", 15, start), later_lines)
    said = _checked(root, positions, attitudes, line_times)
    motion, jumps = _motion(root, positions, attitudes, line_times)
    begin = (whole - _ORIGIN).total_seconds()
    reference = reference or (begin, fraction + float(line_times[0]))
    later = (begin - reference[0]) + (fraction - reference[1])
    bands = _bands(root)
    directions, doubts, alike = _directions(root.part("GEO"), real[1], [one.name for one in bands], band)
    camera = assemble(motion, directions, line_times, even=even, later=later)
    model = LineScanModel(
        camera,
        WGS84,
        reference,
        tuple(f"{path.name}: {line}" for line in (*said, *jumps, *doubts)),
        scale="UTC",
        lacks=APPARENT,
        one_grid=_one_grid(path) if alike else None,
        padded=told if told != real else None,
    )
    rpc = _rpc(root)
    heights, marks = _marks(root, real)
    return Product(
        path=path,
        kind=f"{words(image, 'SATID', 'satellite without name')}, level 1B",
        name=path.stem,
        model=model,
        epoch=time_label(whole, reference[1] + (reference[0] - begin)),
        bands=bands,
        pixels=_pixels(root, real),
        height=rpc.height[0] if heights is None and rpc is not None else heights,
        marks=marks,
        rpc=rpc,
        attitude_sigma=_attitude_sigma(root.part("ATT"), attitudes),
        assumed=_assumed(image, told, real),
        unknown=(
            "errors of attitudes and orbit are given as one for the whole strip: they say nothing of jitter, "
            "and records are smoothed above some 2 Hz",
        ),
    )


def _is_xml(path: Path) -> bool:
    head = read_bytes(path, WHAT, most=LARGEST)[:64]
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<", b"\xff\xfe", b"\xfe\xff"))


def _sizes(root: Part) -> tuple[tuple[int, int], tuple[int, int]]:
    """Lines and columns that are told, and the real ones: files in blocks may be padded."""
    imd = root.part("IMD")
    told = imd.count("NUMROWS", 2, MOST_LINES), imd.count("NUMCOLUMNS", 2, MOST_SAMPLES)
    if root.has("TIL/TILESIZEY") and len(root.parts("TIL/TILE")) < 2:
        # tiles may be larger than the one image in them
        sizes = [root.part("TIL").count(f"TILESIZE{axis}", 2, MOST_LINES) for axis in "YX"]
        return told, (min(sizes[0], told[0]), min(sizes[1], told[1]))
    lines, columns = told
    if lines % _BLOCK or columns % _BLOCK:
        return told, told
    rows = _tlc(imd.part("IMAGE"))
    if len(rows) > 1 and 2 <= rows[-1, 0] < lines:
        lines = int(rows[-1, 0])
    elif root.has("RPB/IMAGE"):
        lines = min(lines, int(2 * root.part("RPB/IMAGE").positive("LINESCALE")))
    if root.has("RPB/IMAGE"):
        columns = min(columns, int(2 * root.part("RPB/IMAGE").positive("SAMPSCALE")))
    return told, (lines, columns)


def _tlc(image: Part) -> Array:
    """Rows (N, 2) of the list of line times: line, s from TLCTIME."""
    rows = image.table("TLCLISTList/TLCLIST", 2)
    if len(rows) != image.count("NUMTLC", 1, MOST_LINES):
        raise image.refused(
            "TLCLIST",
            f"holds {len(rows)} entries, not the NUMTLC {image.number('NUMTLC'):g}: is it cut short?",
        )
    if (np.diff(rows, axis=0) <= 0.0).any():
        raise image.refused("TLCLIST", "holds lines or times that do not increase")
    return rows


def _line_times(image: Part, lines: int) -> tuple[Array, bool]:
    """s from TLCTIME of the centre of every line, and whether they are evenly spaced."""
    rows, rate = _tlc(image), image.positive("AVGLINERATE")
    line = np.arange(float(lines))
    if len(rows) == 1:
        return rows[0, 1] + (line - rows[0, 0]) / rate, True
    slopes = np.diff(rows[:, 1]) / np.diff(rows[:, 0])
    if abs(slopes.mean() * rate - 1.0) > _RATES:
        raise image.refused(
            "AVGLINERATE",
            f"is {rate:g}, TLCLIST has {1.0 / slopes.mean():g} lines a second; they must agree (Hz and s)",
        )
    t = np.interp(line, rows[:, 0], rows[:, 1])
    t += np.minimum(line - rows[0, 0], 0.0) * slopes[0] + np.maximum(line - rows[-1, 0], 0.0) * slopes[-1]
    return t, len(rows) == 2


def _records(part: Part, name: str, width: int, start: str) -> _Records:
    """The records of EPH or ATT."""
    values = part.table(f"{name}List/{name}", width)
    told = part.count("NUMPOINTS", 1, MOST_LINES)
    if len(values) != told:
        raise part.refused(
            name, f"holds {len(values)} records, not the NUMPOINTS {told}: is the file cut short?"
        )
    if (np.diff(values[:, 0]) <= 0.0).any():
        raise part.refused(name, "holds records whose numbers do not increase")
    place = f"{part.path}: {part.place}/STARTTIME"
    began = elapsed(part.text("STARTTIME"), parse_utc(start, place, years=None), place, years=None)
    return _Records(
        f"{part.place}/{name}", began + (values[:, 0] - 1.0) * part.positive("TIMEINTERVAL"), values[:, 1:]
    )


def _around(records: _Records, line_times: Array) -> _Records:
    """The records about the lines, and some beside them."""
    first = int(np.searchsorted(records.t, line_times[0], side="right")) - 1 - _BESIDE
    last = int(np.searchsorted(records.t, line_times[-1])) + _BESIDE
    kept = slice(max(first, 0), min(last + 1, len(records.t)))
    t = records.t[kept] if kept.start < kept.stop else records.t
    return _Records(records.name, t, records.values[kept] if len(t) < len(records.t) else records.values)


def _checked(root: Part, positions: _Records, attitudes: _Records, line_times: Array) -> list[str]:
    """What is said of the records; refused where their units, their order or their time cannot be right."""

    def refused(name: str, why: str) -> FormatError:
        return FormatError(f"{root.path}: {name} {why}")

    said = [Instants(r.name, r.t).check(line_times, refused) for r in (positions, attitudes)]
    radius = np.linalg.norm(positions.values[:, :3], axis=1)
    if not ((radius > _RADII[0]) & (radius < _RADII[1])).all():
        raise refused(
            positions.name,
            f"holds a place {radius.min():.6g} from the Earth's centre; m, Earth-fixed, are expected",
        )
    length = np.linalg.norm(attitudes.values[:, :4], axis=1)
    if (np.abs(length - 1.0) > _ROUNDING).any():
        raise refused(
            attitudes.name,
            f"holds a quaternion of length {length[np.argmax(np.abs(length - 1.0))]:.6g}, not 1",
        )
    if len(positions.t) > 2:
        rates = np.gradient(positions.values[:, :3], positions.t, axis=0, edge_order=2)
        apart = float(np.linalg.norm(rates - positions.values[:, 3:6], axis=1).max())
        if apart > _SPEED:
            said.append(
                f"{positions.name} holds velocities {apart:.3g} m/s off the rates of its places; they are "
                "not used"
            )
    direction = words(root.part("IMD/IMAGE"), "SCANDIRECTION", "not told")
    if direction.lower() != "forward":
        said.append(
            f"SCANDIRECTION is {direction}: only forward scans are verified against their maker's RPC"
        )
    return [line for line in said if line]


def _motion(
    root: Part, positions: _Records, attitudes: _Records, line_times: Array
) -> tuple[SensorMotion, list[str]]:
    """Where the camera is and how it is turned, and what is said of jumps of the attitudes."""
    geo = root.part("GEO")
    camera = Rotation.from_quat([geo.number(f"CAMERA_ATTITUDE/QCS{k}") for k in (1, 2, 3, 4)])
    arm = np.array([geo.number(f"PERSPECTIVE_CENTER/C{axis}") for axis in "XYZ"])
    turns, t = Rotation.from_quat(attitudes.values[:, :4]), attitudes.t
    jumps = _jumps(turns)
    pieces = np.split(np.arange(len(t)), jumps)
    tracks = [(t[piece], turns[piece]) for piece in pieces]
    between = np.array([0.5 * (t[k - 1] + t[k]) for k in jumps])

    def body(when: Array) -> Rotation:
        quaternions = np.empty((len(when), 4))
        piece = np.searchsorted(between, when)
        for number, (nodes, given) in enumerate(tracks):
            here = piece == number
            if here.any():
                quaternions[here] = _turned(nodes, given, when[here]).as_quat()
        return Rotation.from_quat(quaternions)

    def place(when: Array) -> Array:
        at = interpolate(positions.t, np.ascontiguousarray(positions.values[:, :3]), when)
        return np.asarray(at + body(when).apply(arm)) if arm.any() else at

    tables = [Instants(r.name, r.t) for r in (attitudes, positions)]
    motion = SensorMotion(shared_instants(tables), place, lambda when: body(when) * camera)
    inside = [k for k in jumps if line_times[0] < t[k] and t[k - 1] < line_times[-1]]
    said = [
        f"{attitudes.name} jumps at {t[k]:.2f} s after TLCTIME, within the image: the records on either side "
        "are not joined"
        for k in inside
    ]
    if arm.any():
        said.append(f"PERSPECTIVE_CENTER is {np.linalg.norm(arm):.3g} m off: not verified on any file")
    return motion, said


def _jumps(turns: Rotation) -> list[int]:
    """Records at which the attitude jumps: it departs from the run of those before and after."""
    if len(turns) < 6:
        return []
    steps = (turns[:-1].inv() * turns[1:]).as_rotvec()
    departs = np.linalg.norm(steps[1:-1] - 0.5 * (steps[:-2] + steps[2:]), axis=1)
    limit = max(_JUMP, _JUMP_RATIO * float(np.median(departs)))
    peaks = (departs > limit) & (departs >= np.maximum(np.r_[0.0, departs[:-1]], np.r_[departs[1:], 0.0]))
    return [int(k) + 2 for k in np.flatnonzero(peaks)]


def _turned(nodes: Array, turns: Rotation, when: Array) -> Rotation:
    """Attitude at times: cubic between records, turning on evenly beyond them."""
    if len(nodes) == 1:
        return turns[np.zeros(len(when), dtype=np.intp)]
    known = Trajectory(nodes[[0, -1]], np.zeros((2, 3)), nodes, turns)
    return turned_by(nodes, turns, lambda inside: known.at(inside).world_from_body)(when)


def _directions(geo: Part, columns: int, names: list[str], band: int) -> tuple[Array, list[str], bool]:
    """Where each column looks (columns, 3), mm; what is said of it; whether all bands share it."""
    for name in ("ALIST", "ALISTList/ALIST", "BLIST", "BLISTList/BLIST"):
        for part in geo.parts(f"OPTICAL_DISTORTION/{name}"):
            if (part.element.text or "").strip() and part.numbers(".").any():
                raise geo.refused(
                    f"OPTICAL_DISTORTION/{name}",
                    "holds a distortion; how it is applied is not verified on any file: refused",
                )
    distance = geo.positive("PRINCIPAL_DISTANCE/PD")
    looks = _arrays(geo)
    unlike = {array for arrays in looks.values() for array in arrays}
    if any(len(set(arrays)) > 1 for arrays in looks.values()) or (
        len(unlike) > 1 and not (set(names) <= set(looks) and 1 <= band <= len(names))
    ):
        raise geo.refused(
            "DETECTOR_MOUNTING",
            f"holds {len(unlike)} unlike detector arrays (of {', '.join(looks)}, the image's bands are "
            f"{', '.join(names)}); products of one virtual detector line, or of one for each band, are read",
        )
    x, y, rotation, pitch = looks[names[band - 1]][0] if len(unlike) > 1 else next(iter(unlike))
    if not _PIXELS[0] < pitch / distance < _PIXELS[1]:
        raise geo.refused(
            "DETECTOR_MOUNTING",
            f"has a DETPITCH of {pitch:g} with a PD of {distance:g}: no camera's pixel; both are in mm",
        )
    angle, k = np.radians(rotation), np.arange(float(columns))
    said = [] if rotation == 0.0 else [f"DETROTANGLE is {rotation:g} degrees: not verified on any file"]
    rows = [x + k * pitch * np.sin(angle), y - k * pitch * np.cos(angle), np.full(columns, distance)]
    return np.column_stack(rows), said, len(unlike) == 1


def _arrays(geo: Part) -> dict[str, list[tuple[float, ...]]]:
    """Origin x, y (mm), rotation (degrees) and pitch (mm) of the detector arrays of each band."""
    mounting = geo.part("DETECTOR_MOUNTING")
    found: dict[str, list[tuple[float, ...]]] = {}
    for element in mounting.element:
        if element.tag.startswith("BAND_"):
            part = Part(geo.path, f"{mounting.place}/{element.tag}", element, geo.what)
            arrays = [
                tuple(array.number(name) for name in ("DETORIGINX", "DETORIGINY", "DETROTANGLE", "DETPITCH"))
                for array in part.parts("DETECTOR_ARRAY")
            ]
            if arrays:
                found[element.tag.removeprefix("BAND_")] = arrays
    if not found:
        raise geo.refused("DETECTOR_MOUNTING", "holds no BAND_... with a DETECTOR_ARRAY")
    return found


def _one_grid(path: Path) -> OneGrid:
    return OneGrid(
        str(path.resolve()),
        f"all bands of {path.name} have one table of line times and one detector line: their maker has "
        "resampled them onto it, so that they show all ground at one time; give with it the panchromatic (or "
        "the multispectral) product of the same strip, level 1B: sightline init PAN.XML MULTI.XML",
    )


def _bands(root: Part) -> tuple[ProductBand, ...]:
    """The bands of the image, in the order of the metadata, which is that of the file."""
    imd = root.part("IMD")
    names = [child.tag.removeprefix("BAND_") for child in imd.element if child.tag.startswith("BAND_")]
    if not names:
        names = [imd.text("BANDID")]
    files = [tile.text("FILENAME") for tile in root.parts("TIL/TILE") if tile.has("FILENAME")]
    return bands_of(names, [image_name(file) for file in files])


def _pixels(root: Part, real: tuple[int, int]) -> Pixels | None:
    """Tiles side by side, where there are several."""
    parts = [part for part in root.parts("TIL/TILE") if part.has("FILENAME")]
    if len(parts) < 2:
        return None
    tiles = []
    for part in parts:
        line, column = (part.count(f"UL{axis}OFFSET", 0, MOST_LINES) for axis in ("ROW", "COL"))
        last, right = (part.count(f"LR{axis}OFFSET", 0, MOST_LINES) for axis in ("ROW", "COL"))
        size = min(last + 1, real[0]) - line, min(right + 1, real[1]) - column
        if min(size) < 1:
            raise part.refused(
                "LRROWOFFSET", "ends before the tile begins, or the tile lies beyond the image"
            )
        tiles.append(Tile(image_name(part.text("FILENAME")), line, column, *size))
    bits = words(root.part("IMD"), "BITSPERPIXEL", "16")
    return Pixels(tuple(tiles), "Byte" if bits == "8" else "UInt16")


def _marks(root: Part, shape: tuple[int, int]) -> tuple[float | None, tuple[GroundMark, ...]]:
    """Mean height (m) of the corners where it is given, and the corners."""
    bands = [child.tag for child in root.part("IMD").element if child.tag.startswith("BAND_")]
    places = [*(root.part(f"IMD/{tag}") for tag in bands), *root.parts("TIL/TILE")]
    holder = next((p for p in places if all(p.has(f"{c}LON") for c, _, _ in _CORNERS)), None)
    if holder is None or (holder not in places[: len(bands)] and len(root.parts("TIL/TILE")) > 1):
        return None, ()
    high = all(holder.has(f"{corner}HAE") for corner, _, _ in _CORNERS)
    marks = tuple(
        GroundMark(
            corner,
            float(last_line * (shape[0] - 1)),
            float(last_column * (shape[1] - 1)),
            holder.number(f"{corner}LON"),
            holder.number(f"{corner}LAT"),
            holder.number(f"{corner}HAE") if high else None,
        )
        for corner, last_line, last_column in _CORNERS
    )
    return float(np.mean([mark.height for mark in marks])) if high else None, marks


def _rpc(root: Part) -> Rpc | None:
    """The maker's rational polynomials in the order of RPC00B; None where they are missing or in another."""
    if not root.has("RPB/IMAGE") or root.part("RPB").text("SPECID") == "RPC00A":
        return None
    image = root.part("RPB/IMAGE")

    def range_of(name: str) -> tuple[float, float]:
        return image.number(f"{name}OFFSET"), image.positive(f"{name}SCALE")

    def terms(name: str) -> Array:
        return image.numbers(f"{name}List/{name}", TERMS)

    return Rpc(
        range_of("LINE"),
        range_of("SAMP"),
        range_of("LAT"),
        range_of("LONG"),
        range_of("HEIGHT"),
        terms("LINENUMCOEF"),
        terms("LINEDENCOEF"),
        terms("SAMPNUMCOEF"),
        terms("SAMPDENCOEF"),
    )


def _attitude_sigma(part: Part, attitudes: _Records) -> float | None:
    """Largest error (rad) of the attitudes about any axis: one for the strip, not for each record."""
    largest = 0.0
    rows, columns = np.triu_indices(4)
    for values in np.unique(attitudes.values[:, 4:], axis=0):
        row = int(np.flatnonzero((attitudes.values[:, 4:] == values).all(axis=1))[0])
        x, y, z, w = attitudes.values[row, :4]
        of_quaternion = np.zeros((4, 4))
        of_quaternion[rows, columns] = of_quaternion[columns, rows] = values
        turn = 2.0 * np.array([[w, z, -y, -x], [-z, w, x, -y], [y, -x, w, -z]])
        variances = np.linalg.eigvalsh(turn @ of_quaternion @ turn.T)
        if variances[0] < -_ROUNDING * max(float(variances.sum()), 0.0):
            raise part.refused(
                "ATTLIST",
                f"holds a covariance that is not positive about the body's axes ({variances[0]:.3g})",
            )
        largest = max(largest, float(variances[-1]))
    return float(np.sqrt(largest)) if largest > 0.0 else None


def _assumed(image: Part, told: tuple[int, int], real: tuple[int, int]) -> tuple[str, ...]:
    """What was assumed of the file."""
    said = [
        "attitudes hold neither aberration, light time nor refraction, which are applied: so they agree with "
        "the maker's own rational polynomials and corners",
    ]
    if told != real:
        said.append(
            f"the image is {real[0]} x {real[1]} px, in a file padded to {told[0]} x {told[1]} px "
            "(NUMROWS, NUMCOLUMNS)"
        )
    if image.number("NUMTLC") == 1.0:
        said.append("line times: one entry (TLCLIST) and AVGLINERATE")
    return tuple(said)
