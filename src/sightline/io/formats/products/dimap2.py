"""DIMAP 2, level SENSOR (SPOT 6, SPOT 7): the virtual camera of a product.

The maker has resampled all bands to one perfect line over a DEM: they share looks, times and attitude, and
the attitude is smooth. So neither its bands nor its records can tell motion.

Line l (from 0) is exposed START + l LINE_PERIOD; u = R(q) unit(Y, -X, 1), ratios X, Y linear in the column.
Attitudes hold the aberration of light. Vertices are of one height, which the file does not tell.

Not here: products on a map (ORTHO), Pleiades (``pleiades.py``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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
    rotations,
    some,
    times_of,
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
_LOOKS = ("XLOS_0", "XLOS_1", "YLOS_0", "YLOS_1")
_FILES = "Raster_Data/Data_Access/Data_Files/Data_File"
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
    instants, attitude = _attitudes(data, start)
    title = words(data, "Dataset_Identification/DATASET_NAME", path.stem)
    model = line_scan(
        path,
        start,
        t,
        (instants, turned_by(instants, attitude)),
        _orbit(data, start),
        looks,
        reference,
        doubts=_end(data, start, float(t[-1]), period),
        one_grid=OneGrid(title, _STILL),
    )
    marks, beyond = marks_inside(_marks(data), model.camera.shape)
    height, left = one_height(model.camera, marks) if len(marks) > 2 else (None, 0.0)
    return Product(
        path=path,
        kind=f"{words(data, 'Metadata_Identification/METADATA_PROFILE', 'DIMAP')} (DIMAP 2, level SENSOR)",
        name=title,
        model=model,
        epoch=epoch_of(start, 0.0),
        bands=_bands(data, names),
        pixels=_pixels(data),
        height=height,
        marks=tuple(replace(mark, height=height) for mark in marks),
        assumed=(
            *(() if height is None else (_ground(height, left, len(marks)),)),
            "attitudes lead straight to the ground: neither aberration nor refraction is applied",
            *(
                (f"bands stand in the image in the order of the metadata: {', '.join(names)}",)
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


def _ground(height: float, left: float, count: int) -> str:
    return (
        f"the ground lies at {height:.1f} m: there the model meets the {count} vertices of the product, "
        f"which tell no height, to {left:.2g} m"
    )


def _check_kind(data: Part) -> None:
    """FormatError for products of another level or kind."""
    check_level(
        data,
        ("Metadata_Identification/METADATA_FORMAT", "2"),
        ("Processing_Information/Product_Settings/PROCESSING_LEVEL", "SENSOR"),
        "products on a map hold no times of lines",
    )
    if not data.has(f"{_MODEL}/Attitudes/Quaternion_List/Quaternion"):
        raise data.refused(
            f"{_MODEL}/Attitudes/Quaternion_List",
            "is missing: attitudes as polynomials (DIMAP 2 of Pleiades) are not read: none was at hand",
        )


def _orbit(data: Part, start: str) -> Orbit:
    """Positions and velocities relative to the Earth."""
    name = f"{_MODEL}/Ephemeris/Point_List/Point"
    rows = some(data, name, 2)
    place = np.array([row.numbers("LOCATION_XYZ", 3) for row in rows])
    speed = np.array([row.numbers("VELOCITY_XYZ", 3) for row in rows])
    return orbit_of(data, name, times_of(rows, "TIME", start), place, speed, inertial=False)


def _attitudes(data: Part, start: str) -> tuple[Array, Rotation]:
    """Times (s) and world_from_sensor of the records."""
    name = f"{_MODEL}/Attitudes/Quaternion_List/Quaternion"
    rows = some(data, name, 2)
    values = np.array([[row.number(f"Q{k}") for k in range(4)] for row in rows])
    return times_of(rows, "TIME", start), rotations(data, name, values)


def _looks(data: Part) -> tuple[list[str], Array]:
    """Names of the bands, and (columns, 3) unit vectors of the look that they share."""
    columns = data.count("Raster_Data/Raster_Dimensions/NCOLS", 2, MOST_SAMPLES)
    name = f"{_CALIBRATION}/Band_Calibration_List/Band_Calibration"
    bands = some(data, name, 1)
    looks = np.array([[band.number(f"Polynomial_Look_Angles/{key}") for key in _LOOKS] for band in bands])
    if (looks != looks[0]).any():
        raise data.refused(name, "gives bands looks of their own; one look that all bands share is read")
    for key in ("YAW", "PITCH", "ROLL"):
        bias = f"{_CALIBRATION}/Instrument_Biases/{key}"
        if data.has(bias) and data.number(bias) != 0.0:
            raise data.refused(bias, "is not 0; which way it turns is not known, so that it is not guessed")
    first = bands[0].count("Swath_Range/FIRST_COL", 1, MOST_SAMPLES)
    last = bands[0].count("Swath_Range/LAST_COL", 1, MOST_SAMPLES)
    if last < columns:
        raise data.refused(
            f"{name}/Swath_Range/LAST_COL", f"is {last} of {columns} columns: some have no look"
        )
    k = np.arange(columns) + 1.0 - first
    x0, x1, y0, y1 = looks[0]
    return [band.text("BAND_ID") for band in bands], np.stack(
        [y0 + y1 * k, -(x0 + x1 * k), np.ones(columns)], axis=1
    )


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
    """Vertices and centre: centres of pixels, of no told height."""
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
        )
        for name, part in vertices + centre
    )


def _given(part: Part) -> str:
    """The file that a Data_File names."""
    return image_name(part.part("DATA_FILE_PATH").element.get("href", "") or words(part, "DATA_FILE_PATH"))


def _bands(data: Part, names: list[str]) -> tuple[ProductBand, ...]:
    """Every band, in its order in the file; several tiles are no one file."""
    return bands_of(names, [_given(part) for part in data.parts(_FILES)])


def _pixels(data: Part) -> Pixels | None:
    """Tiles side by side, where there are several."""
    files = data.parts(_FILES)
    if len(files) < 2:
        return None
    step = data.part(f"{_TILING}/NTILES_SIZE").element
    try:
        lines, columns = (int(step.get(key, "")) for key in ("nrows", "ncols"))
        places = [tuple(int(part.element.get(f"tile_{axis}", "")) - 1 for axis in "RC") for part in files]
    except ValueError:
        raise data.refused(_TILING, "does not say where the tiles of the image lie") from None
    whole = [data.count(f"Raster_Data/Raster_Dimensions/N{axis}S", 2, MOST_LINES) for axis in ("ROW", "COL")]
    if any(words(data, f"{_TILING}/OVERLAP_{axis}", "0") != "0" for axis in ("ROW", "COL")):
        raise data.refused(_TILING, "has tiles that overlap; tiles side by side are read")
    tiles = []
    for part, (row, column) in zip(files, places, strict=True):
        line, first = row * lines, column * columns
        if min(lines, columns) < 1 or not (0 <= line < whole[0] and 0 <= first < whole[1]):
            raise data.refused(_TILING, f"has a tile beyond the image ({_given(part)})")
        size = min(lines, whole[0] - line), min(columns, whole[1] - first)
        tiles.append(Tile(_given(part), line, first, *size))
    key = "Raster_Data/Raster_Encoding/NBITS"
    bits = words(data, key, "16")
    if bits not in _TYPES:
        raise data.refused(key, f"is {bits[:20]}; read are {', '.join(_TYPES)}")
    return Pixels(tuple(tiles), _TYPES[bits])
