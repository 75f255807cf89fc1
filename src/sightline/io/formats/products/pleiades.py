"""Pleiades products of CNES's inventory (PHRDIMAP): the virtual camera of a product.

Line l (from 0) is exposed START + l SENSOR_LINE_PERIOD; each component of the quaternion is a polynomial of
the time of day; u = R(q) unit(PsiY, -PsiX, 1), Psi polynomials of the column. Velocities are relative to the
stars, though on Earth-fixed axes. Attitudes hold the aberration of light.

Not here: counters of gyros and quaternions (``pleiades_telemetry.py``), Airbus's own DIMAP 2 of Pleiades.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.io.formats.instants import elapsed, parse_utc
from sightline.io.formats.line_scan import MOST_LINES, MOST_SAMPLES, OneGrid
from sightline.io.formats.products.makers import (
    Orbit,
    epoch_of,
    line_period,
    line_scan,
    orbit_of,
    polynomial_attitude,
    read_coefficients,
    record_times,
    scaled,
    some,
    words,
)
from sightline.io.formats.products.product import Product, ProductBand, RawBands, bands_of, image_name
from sightline.io.formats.products.tree import Part, read_xml
from sightline.products.rpc import TERMS, Rpc

Array = NDArray[np.float64]

WHAT = "PHRDIMAP metadata of a Pleiades product (PHRDIMAP_....XML)"
_MODEL = "Geometric_Data/Sensor_Model_Characteristics"
START = f"{_MODEL}/UTC_Sensor_Model_Range/START"
_POINTS = f"{_MODEL}/Sensor_Ephemeris/Point_List/Point"
_POLYNOMIALS = f"{_MODEL}/Sensor_Attitudes/Polynomial_Models"
_VIEW = f"{_MODEL}/Sensor_Viewing_Model"
_RFM = "Geoposition/Rational_Sensor_Model/Global_RFM"
_MILLISECONDS = {"ms": 1e-3, "s": 1.0, "us": 1e-6}
#: The band whose lines count, and what they are counted in.
_PANCHROMATIC, _OF_PRODUCT = "PA", "PRODUCT"
#: s by which arrays of a band may see row 1 after one another: what lags are known to.
_ONE_TIME = 3e-3
_STILL = (
    "the image is resampled by its maker to one virtual line (Pleiades, level SENSOR), its attitude a "
    "polynomial: it holds no motion; raw bands in sensor geometry would do (levels L0, L1A): give their "
    "images to `sightline init` beside this file, which knows their lags"
)


def read_pleiades(path: Path, reference: tuple[float, float] | None = None) -> Product:
    """A PHRDIMAP product: arguments and errors as of `read_product`."""
    data = read_xml(path, WHAT)
    if not data.has(_MODEL):
        raise data.refused(
            _MODEL, "is missing: products on a map, and other makers' files, hold no such model"
        )
    start = data.text(START)
    period = line_period(data, f"{_MODEL}/SENSOR_LINE_PERIOD", _MILLISECONDS)
    t = period * np.arange(data.count("Raster_Dimensions/NROWS", 2, MOST_LINES), dtype=np.float64)
    title = words(data, "Dataset_Identification/DATASET_NAME", path.stem)
    orbit, attitude = pleiades_orbit(data, start), pleiades_attitude(data, start, float(t[-1]))
    model = line_scan(
        path, start, t, (t[:0], attitude), orbit, _looks(data), reference, one_grid=OneGrid(title, _STILL)
    )
    rpc = _rpc(data)
    return Product(
        path=path,
        kind=f"Pleiades {words(data, 'Data_Strip/Data_Strip_Identification/PLATFORM_SERIAL_NUMBER')} "
        f"(PHRDIMAP, level {words(data, 'Product_Characteristics/PROCESSING_LEVEL', 'SENSOR')})",
        name=title,
        model=model,
        epoch=epoch_of(start, 0.0),
        bands=_bands(data),
        height=None if rpc is None else rpc.height[0],
        rpc=rpc,
        raw=_raw(data, start),
        assumed=(
            "attitudes lead straight to the ground: neither aberration nor refraction is applied",
            *((f"the ground lies at {rpc.height[0]:g} m, the middle of the heights of the product's RFM",)
              if rpc is not None else ()),
        ),
        unknown=("looks of the real detectors: only the product's virtual line is described",),
    )  # fmt: skip


def _raw(data: Part, start: str) -> RawBands | None:
    """When the bands saw row 1 of the product, after the panchromatic one and after the model's line 0."""
    stamp = "Data_Strip/Sensor_Configuration/Time_Stamp"
    if not data.has(f"{stamp}/Band_TS_List/Band_TS"):
        return None
    zero = parse_utc(start, f"{data.path}")
    period = line_period(data, f"{stamp}/PA_LINE_PERIOD", _MILLISECONDS)
    first: dict[str, float] = {}
    doubt, uneven = "", []
    for part in some(data, f"{stamp}/Band_TS_List/Band_TS", 2):
        name = part.text("BAND_ID")
        if name in first:
            doubt = f"its Band_TS_List holds {name[:40]} twice"
        begun = [_row_1(one, zero, period) for one in some(part, "Array_TS_List/Array_TS", 1)]
        first[name] = sum(begun) / len(begun)
        if max(begun) - min(begun) > _ONE_TIME:
            uneven.append(f"{name} ({(max(begun) - min(begun)) * 1e3:.3g} ms)")
    if _PANCHROMATIC not in first:
        raise data.refused(f"{stamp}/Band_TS_List", f"holds no {_PANCHROMATIC}")
    lags = {name: t - first[_PANCHROMATIC] for name, t in sorted(first.items(), key=lambda item: item[1])}
    counted = words(data, f"{stamp}/ORIGIN_REFERENTIAL", _OF_PRODUCT)
    if uneven:
        doubt = f"its arrays see row 1 at unlike times: {', '.join(uneven)}"
    if counted != _OF_PRODUCT:
        doubt = f"its ORIGIN_REFERENTIAL is {counted[:40]}; rows of the product ({_OF_PRODUCT}) are read"
    return RawBands(lags, period, first[_PANCHROMATIC], doubt)


def _row_1(array: Part, zero: tuple[datetime, float], period: float) -> float:
    """s from an instant to when an array of detectors saw row 1 of the product."""
    t = elapsed(array.text("ORIGIN_TIME"), zero, f"{array.path}: {array.place}/ORIGIN_TIME")
    if not array.has("ORIGIN_FULL_RES_LINE"):
        return t
    return t - (array.number("ORIGIN_FULL_RES_LINE") - 1.0) * period


def pleiades_orbit(data: Part, start: str) -> Orbit:
    """The ephemeris of the model, in s from an instant; velocities turned to those relative to the Earth."""
    rows = some(data, _POINTS, 2)
    place = np.array([scaled(row, "LOCATION_VALUES", {"m": 1.0, "km": 1e3}, 3) for row in rows])
    speed = np.array([scaled(row, "VELOCITY_VALUES", {"m/s": 1.0, "km/s": 1e3}, 3) for row in rows])
    return orbit_of(data, _POINTS, record_times(rows, "UTC_TIME", start), place, speed, inertial=True)


def pleiades_attitude(data: Part, start: str, last: float = 0.0) -> Callable[[Array], Rotation]:
    """earth_from_body of times in s from an instant, by the polynomials of the model; lines end at `last`."""
    return polynomial_attitude(data, f"{_MODEL}/Sensor_Attitudes", _POLYNOMIALS, start, (0.0, last))


def _looks(data: Part) -> Array:
    """(columns, 3) vectors, sensor axes."""
    columns = data.count("Raster_Dimensions/NCOLS", 2, MOST_SAMPLES)
    place = data.part(f"{_VIEW}/Position_In_Retina")
    first, last = (place.count(f"{end}_COL", 1, MOST_SAMPLES) for end in ("FIRST", "LAST"))
    if last - first + 1 < columns:
        raise place.refused("LAST_COL", f"is {last} of {columns} columns from {first} on: some have no look")
    k = np.arange(columns, dtype=np.float64)
    x, y = (
        np.polynomial.polynomial.polyval(
            k, read_coefficients(data, f"{_VIEW}/Viewing_Directions/Psi{axis}_Model")
        )
        for axis in "XY"
    )
    return np.stack([y, -x, np.ones(columns)], axis=1)


def _rpc(data: Part) -> Rpc | None:
    """The maker's RFM, ground to pixels; rows and columns of the file begin at 1."""
    if not data.has(f"{_RFM}/Inverse_Model"):
        return None

    def normal(name: str, first: float = 0.0) -> tuple[float, float]:
        part = data.part(f"{_RFM}/RFM_Validity/{name}")
        return part.number("B") - first, part.positive("A")

    row, column = (data.numbers(f"{_RFM}/Inverse_Model/F_{name}", 2 * TERMS) for name in ("ROW", "COL"))
    return Rpc(
        normal("Row", 1.0),
        normal("Col", 1.0),
        normal("Lat"),
        normal("Lon"),
        normal("Alt"),
        row[:TERMS],
        row[TERMS:],
        column[:TERMS],
        column[TERMS:],
    )


def _bands(data: Part) -> tuple[ProductBand, ...]:
    """Every band, in its order in the file."""
    found = data.parts("Product_Characteristics/Product_Image_Characteristics/Data_Access/Data_File")
    given = [
        words(part, "DATA_FILE_PATH") or part.part("DATA_FILE_PATH").element.get("href", "") for part in found
    ]
    names = [part.text("BAND_ID") for part in data.parts("Image_Interpretation/Spectral_Band_Info")] or ["PA"]
    return bands_of(names, [image_name(file) for file in given])
