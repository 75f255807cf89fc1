"""DIMAP 2, level SENSOR (SPOT 6, SPOT 7, Pleiades, Pleiades Neo): the virtual camera of a product.

The maker has resampled all bands to one perfect line over a DEM: they share looks, times and attitude, and
the attitude is smooth. So neither its bands nor its records can tell motion.

Line l (from 0) is exposed START + l LINE_PERIOD; u = R(q) unit(Y, -X, 1), ratios X, Y polynomials of the
column. Attitudes are records, or each component of the quaternion is a polynomial of the time of day
(Pleiades 1A, 1B: Airbus, Pleiades Imagery User Guide). They hold the aberration of light. Vertices tell their
heights, or are of one that the file does not tell.

Not here: products on a map (ORTHO), the inventory's own metadata of Pleiades (``pleiades.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.camera import PushbroomCamera
from sightline.io.formats.instants import elapsed, parse_utc
from sightline.io.formats.line_scan import MOST_LINES, MOST_SAMPLES, OneGrid
from sightline.io.formats.products.makers import (
    Orbit,
    check_level,
    epoch_of,
    line_period,
    line_scan,
    marks_inside,
    one_height,
    orbit_of,
    polynomial_attitude,
    record_times,
    rotations,
    scaled,
    some,
    turned_by,
    words,
)
from sightline.io.formats.products.product import (
    GroundMark,
    Pixels,
    Product,
    ProductBand,
    Tile,
    bands_of,
    image_name,
)
from sightline.io.formats.products.tree import Part, read_xml

Array = NDArray[np.float64]

_WHAT = "DIMAP 2 metadata of level SENSOR (DIM_....XML)"
_MODEL = "Geometric_Data/Refined_Model"
_CALIBRATION = f"{_MODEL}/Geometric_Calibration/Instrument_Calibration"
_SECONDS = {"microsecond": 1e-6, "us": 1e-6, "millisecond": 1e-3, "ms": 1e-3, "second": 1.0, "s": 1.0}
_BANDS = f"{_CALIBRATION}/Band_Calibration_List/Band_Calibration"
#: Highest power of the column in a look; SPOT 6 has the first.
_POWERS = 5
_PARTS = "Raster_Data/Data_Access/Data_Files"
#: Bands of Pleiades Neo by the letters in the name of a file that holds some of them.
_LETTERS = {"R": "R", "G": "G", "B": "B", "N": "NIR", "E": "RE", "D": "DB"}
_TILING = "Raster_Data/Raster_Dimensions/Tile_Set/Regular_Tiling"
#: What GDAL calls whole numbers without sign by their bits.
_TYPES = {"8": "Byte", "12": "UInt16", "16": "UInt16"}
#: Lines by which the stated end of the image may lie beside its last line.
_END = 0.5

_STILL = (
    "bands are registered by their maker (DIMAP 2, level SENSOR): resampled to one virtual line over a DEM, "
    "all at lag 0, so they hold no motion; bands in sensor geometry would do (levels L0, L1A, L1B), with the "
    "lags of the detectors"
)


def read_dimap2(path: Path, reference: tuple[float, float] | None = None) -> Product:
    """A SENSOR product: arguments and errors as of `read_product`."""
    data = read_xml(path, _WHAT)
    _check_kind(data)
    start = data.text(f"{_MODEL}/Time/Time_Range/START")
    period = line_period(data, f"{_MODEL}/Time/Time_Stamp/LINE_PERIOD", _SECONDS)
    rows = data.count("Raster_Data/Raster_Dimensions/NROWS", 2, MOST_LINES)
    t = period * np.arange(rows, dtype=np.float64)
    names, looks = _looks(data)
    instants, attitude = _attitudes(data, start, float(t[-1]))
    orbit, inertial = _orbit(data, start)
    title = words(data, "Dataset_Identification/DATASET_NAME", path.stem)
    model = line_scan(
        path,
        start,
        t,
        (instants, attitude),
        orbit,
        looks,
        reference,
        doubts=_end(data, start, float(t[-1]), period),
        one_grid=OneGrid(title, _STILL),
    )
    marks, beyond = marks_inside(_marks(data), model.camera.shape)
    height, marks, ground = _ground(model.camera, marks)
    bands = _bands(data, names)
    return Product(
        path=path,
        kind=f"{words(data, 'Metadata_Identification/METADATA_PROFILE', 'DIMAP')} (DIMAP 2, level SENSOR)",
        name=title,
        model=model,
        epoch=epoch_of(start, 0.0),
        bands=bands,
        pixels=_pixels(data, len(names)),
        height=height,
        marks=marks,
        assumed=(
            *ground,
            *inertial,
            "attitudes lead straight to the ground: neither aberration nor refraction is applied",
            *(
                (f"bands stand in the image in the order {', '.join(band.name for band in bands)}",)
                if len(names) > 1
                else ()
            ),
        ),
        unknown=(
            "residual parallax: bands are registered over the maker's DEM; what it leaves is not modelled",
            "lags and looks of the real detectors, and the attitude that images see: not in a SENSOR product",
            *beyond,
        ),
    )


def _ground(
    camera: PushbroomCamera, marks: tuple[GroundMark, ...]
) -> tuple[float | None, tuple[GroundMark, ...], tuple[str, ...]]:
    """Height (m) of the ground, marks with theirs, and what is said of it."""
    told = [mark.height for mark in marks if mark.height is not None]
    if told and len(told) == len(marks):
        height = float(np.mean(told))
        return height, marks, (f"the ground lies at {height:.1f} m, the mean of the vertices of the product",)
    if len(marks) < 3:
        return None, marks, ()
    height, left = one_height(camera, marks)
    said = (
        f"the ground lies at {height:.1f} m: there the model meets the {len(marks)} vertices of the product, "
        f"which tell no height, to {left:.2g} m"
    )
    return height, tuple(replace(mark, height=height) for mark in marks), (said,)


def _check_kind(data: Part) -> None:
    """FormatError for products of another level or kind, and for other files of a product."""
    held = words(data, "Metadata_Identification/METADATA_SUBPROFILE", "PRODUCT")
    if held != "PRODUCT" or not (data.has("Geometric_Data") or data.has("Processing_Information")):
        raise FormatError(
            f"{data.path}: is a file of a DIMAP 2 product ({held[:20]}), but not the one that holds its "
            "model: give DIM_....XML, which lies beside its images"
        )
    check_level(
        data,
        ("Metadata_Identification/METADATA_FORMAT", "2"),
        ("Processing_Information/Product_Settings/PROCESSING_LEVEL", "SENSOR"),
        "products on a map hold no times of lines",
    )


def _orbit(data: Part, start: str) -> tuple[Orbit, tuple[str, ...]]:
    """Positions and velocities relative to the Earth, and what is said where the file's are not."""
    name = f"{_MODEL}/Ephemeris/Point_List/Point"
    rows = some(data, name, 2)
    place = np.array([scaled(row, "LOCATION_XYZ", {"m": 1.0, "km": 1e3}, 3) for row in rows])
    speed = np.array([scaled(row, "VELOCITY_XYZ", {"m/s": 1.0, "km/s": 1e3}, 3) for row in rows])
    orbit = orbit_of(data, name, record_times(rows, "TIME", start), place, speed, inertial=None)
    if np.array_equal(orbit.velocity, speed):
        return orbit, ()
    return orbit, ("velocities are relative to the stars, on Earth-fixed axes: so they agree with positions",)


def _attitudes(data: Part, start: str, last: float) -> tuple[Array, Callable[[Array], Rotation]]:
    """Times (s) of the records, none of polynomials, and world_from_sensor of times; lines end at `last`."""
    name = f"{_MODEL}/Attitudes/Quaternion_List/Quaternion"
    polynomials = f"{_MODEL}/Attitudes/Polynomial_Quaternions"
    if not data.has(name) and data.has(polynomials):
        return np.empty(0), polynomial_attitude(data, polynomials, polynomials, start, (0.0, last))
    rows = some(data, name, 2)
    values = np.array([[row.number(f"Q{k}") for k in range(4)] for row in rows])
    t = record_times(rows, "TIME", start)
    return t, turned_by(t, rotations(data, name, values))


def _calibrated(data: Part) -> list[Part]:
    """What tells looks: that of each band, or of the instrument where bands have none of their own."""
    bands = data.parts(_BANDS)
    if bands:
        return bands
    if data.has(f"{_CALIBRATION}/Polynomial_Look_Angles"):
        return [data.part(_CALIBRATION)]
    raise data.refused(_BANDS, "is missing, which holds where columns look: was the file trimmed?")


def _look(band: Part) -> tuple[tuple[float, ...], ...]:
    """Coefficients of X and of Y by powers of the column, the constant first."""
    return tuple(
        tuple(
            band.number(f"Polynomial_Look_Angles/{axis}LOS_{k}")
            if k == 0 or band.has(f"Polynomial_Look_Angles/{axis}LOS_{k}")
            else 0.0
            for k in range(_POWERS)
        )
        for axis in "XY"
    )


def _looks(data: Part) -> tuple[list[str], Array]:
    """Names of the bands, and (columns, 3) unit vectors of the look that they share."""
    columns = data.count("Raster_Data/Raster_Dimensions/NCOLS", 2, MOST_SAMPLES)
    bands = _calibrated(data)
    looks = [_look(band) for band in bands]
    if any(look != looks[0] for look in looks):
        raise data.refused(_BANDS, "gives bands looks of their own; one look that all bands share is read")
    for key in ("YAW", "PITCH", "ROLL"):
        bias = f"{_CALIBRATION}/Instrument_Biases/{key}"
        if data.has(bias) and data.number(bias) != 0.0:
            raise data.refused(bias, "is not 0; which way it turns is not known, so that it is not guessed")
    first = bands[0].count("Swath_Range/FIRST_COL", 0, MOST_SAMPLES)
    last = bands[0].count("Swath_Range/LAST_COL", 1, MOST_SAMPLES)
    if last < columns:
        raise data.refused(
            f"{_BANDS}/Swath_Range/LAST_COL", f"is {last} of {columns} columns: some have no look"
        )
    k = np.arange(columns) + 1.0 - first
    x, y = (np.polynomial.polynomial.polyval(k, np.array(look)) for look in looks[0])
    return _names(data, bands), np.stack([y, -x, np.ones(columns)], axis=1)


def _names(data: Part, bands: list[Part]) -> list[str]:
    """Every band of the image; numbered where the file does not name so many."""
    count = data.count("Raster_Data/Raster_Dimensions/NBANDS", 1, 100)
    shown = [
        words(part, "BAND_ID")
        for part in data.parts("Raster_Data/Raster_Display/Raster_Index_List/Raster_Index")
    ]
    for names in ([words(band, "BAND_ID") for band in bands], shown):
        if len(names) == count == len(set(names)) and all(names):
            return names
    return [f"band {number}" for number in range(1, count + 1)]


def _end(data: Part, start: str, last: float, period: float) -> tuple[str, ...]:
    """What is said where the stated end of the image is not that of its last line."""
    name = f"{_MODEL}/Time/Time_Range/END"
    end = elapsed(data.text(name), parse_utc(start, f"{data.path}"), f"{data.path}: {name}")
    if abs(end - last) <= _END * period:
        return ()
    return (
        f"{data.path.name}: END lies {(end - last) / period:.4g} lines after the last of NROWS; lines were "
        "counted from START: is the image a part of another?",
    )


def _marks(data: Part) -> tuple[GroundMark, ...]:
    """Vertices and centre: centres of pixels, with a height where the file tells one."""
    extent = "Dataset_Content/Dataset_Extent"
    vertices = [(f"vertex {number}", part) for number, part in enumerate(data.parts(f"{extent}/Vertex"), 1)]
    centre = [("centre", part) for part in data.parts(f"{extent}/Center")]
    return tuple(
        GroundMark(
            name,
            part.number("ROW") - 1.0,
            part.number("COL") - 1.0,
            part.number("LON"),
            part.number("LAT"),
            part.number("H") if part.has("H") else None,
        )
        for name, part in vertices + centre
        if part.has("ROW") and part.has("COL")
    )


def _given(part: Part) -> str:
    """The file that a Data_File names."""
    return image_name(part.part("DATA_FILE_PATH").element.get("href", "") or words(part, "DATA_FILE_PATH"))


def _parts(data: Part, names: list[str]) -> list[tuple[list[Part], tuple[str, ...]]]:
    """Files of each part of the image, and the bands that it holds: one part, or some bands in each."""
    parts = [part.parts("Data_File") for part in data.parts(_PARTS)]
    parts = [files for files in parts if files]
    if len(parts) < 2:
        return [(files, tuple(names)) for files in parts]
    each, over = divmod(len(names), len(parts))
    if over:
        raise data.refused(_PARTS, f"is there {len(parts)} times, for {len(names)} bands: unlike parts")
    held = [tuple(names[k * each : (k + 1) * each]) for k in range(len(parts))]
    by_name = [_lettered(files[0], names) for files in parts]
    if sorted(name for bands in by_name for name in bands) == sorted(names):
        held = by_name
    return list(zip(parts, held, strict=True))


def _lettered(file: Part, names: list[str]) -> tuple[str, ...]:
    """The bands that the name of a file spells: ``IMG_..._RGB_R1C1.TIF``; none where it spells none."""
    for word in _given(file).upper().replace("-", "_").split("_"):
        spelt = tuple(_LETTERS.get(letter, "") for letter in word)
        if len(spelt) > 1 and len(set(spelt)) == len(spelt) and set(spelt) <= set(names):
            return spelt
    return ()


def _bands(data: Part, names: list[str]) -> tuple[ProductBand, ...]:
    """Every band, in the order of the files; several tiles are no one file."""
    parts = _parts(data, names)
    if len(parts) < 2 or any(len(files) > 1 for files, _ in parts):
        ordered = [name for _, held in parts for name in held] or names
        return bands_of(ordered, [_given(file) for files, _ in parts for file in files])
    return tuple(band for files, held in parts for band in bands_of(held, [_given(files[0])]))


def _pixels(data: Part, bands: int) -> Pixels | None:
    """Tiles side by side, where there are several."""
    parts = _parts(data, [str(number) for number in range(bands)])
    if all(len(files) < 2 for files, _ in parts):
        return None
    step = data.part(f"{_TILING}/NTILES_SIZE").element
    files = [file for held, _ in parts for file in held]
    try:
        lines, columns = (int(step.get(key, "")) for key in ("nrows", "ncols"))
        places = [tuple(int(part.element.get(f"tile_{axis}", "")) - 1 for axis in "RC") for part in files]
    except ValueError:
        raise data.refused(_TILING, "does not say where the tiles of the image lie") from None
    whole = [data.count(f"Raster_Data/Raster_Dimensions/N{axis}S", 2, MOST_LINES) for axis in ("ROW", "COL")]
    if any(words(data, f"{_TILING}/OVERLAP_{axis}", "0") != "0" for axis in ("ROW", "COL")):
        raise data.refused(_TILING, "has tiles that overlap; tiles side by side are read")
    each = bands // len(parts)
    held_by = [(number * each, each) for number, (held, _) in enumerate(parts) for _ in held]
    tiles = []
    for part, (row, column), some_bands in zip(files, places, held_by, strict=True):
        line, first = row * lines, column * columns
        if min(lines, columns) < 1 or not (0 <= line < whole[0] and 0 <= first < whole[1]):
            raise data.refused(_TILING, f"has a tile beyond the image ({_given(part)})")
        size = min(lines, whole[0] - line), min(columns, whole[1] - first)
        tiles.append(Tile(_given(part), line, first, *size, some_bands if len(parts) > 1 else None))
    _check_cover(data, tiles, len(parts), whole)
    key = "Raster_Data/Raster_Encoding/NBITS"
    bits = words(data, key, "16")
    if bits not in _TYPES:
        raise data.refused(key, f"is {bits[:20]}; read are {', '.join(_TYPES)}")
    return Pixels(tuple(tiles), _TYPES[bits])


def _check_cover(data: Part, tiles: list[Tile], parts: int, whole: list[int]) -> None:
    """FormatError where tiles, none of which overlap, do not add up to the image."""
    distinct = {(tile.line, tile.column, tile.bands) for tile in tiles}
    area = sum(tile.lines * tile.columns for tile in tiles)
    if len(distinct) < len(tiles) or area != parts * whole[0] * whole[1]:
        raise data.refused(
            f"{_PARTS}/Data_File",
            f"lists {len(tiles)} tiles, {len(distinct)} of them unlike, which do not make up the image of "
            f"{whole[0]} x {whole[1]} px",
        )
