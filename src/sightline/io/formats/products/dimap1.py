"""DIMAP 1, SPOT 5 level 1A: look tables and corrected attitudes.

Row r (from 1) is exposed SCENE_CENTER_TIME + (r - SCENE_CENTER_LINE) LINE_PERIOD. Orbital axes: Z up, X along
V x Z, Y = Z x X, of the velocity relative to the Earth. u = M(yaw, pitch, roll) unit(-tan PSI_Y, tan PSI_X,
-1). Corrected attitudes lead straight to the ground: aberration is in them, or in none of the model.

Not here: products on a map, SPOT 1 to 4.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.io.formats.line_scan import MOST_LINES, MOST_SAMPLES, OneGrid
from sightline.io.formats.products.makers import (
    Orbit,
    check_level,
    epoch_of,
    line_period,
    line_scan,
    marks_inside,
    orbit_of,
    record_times,
    some,
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

_WHAT = "DIMAP 1 metadata of a SPOT 5 product of level 1A (METADATA.DIM)"
_STAMP = "Data_Strip/Sensor_Configuration/Time_Stamp"
_LOOKS = "Data_Strip/Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles"
_POINTS = "Data_Strip/Ephemeris/Points/Point"
_DORIS = "Data_Strip/Ephemeris/Doris_Points/Doris_Point"
_ANGLES = "Data_Strip/Satellite_Attitudes/Corrected_Attitudes/Corrected_Attitude/Angles"
#: rad of attitudes and looks at most: more are degrees.
_MOST_ANGLE = 1.0
_STILL = (
    "all bands have one table of looks and one time for each line (DIMAP 1, level 1A), so that they show all "
    "ground at one time; give with it another product of the same strip, whose bands see it at another time"
)
#: m by which DORIS may lie off the ephemeris unsaid; both round to 0.01 m.
_APART = 5.0
#: Axes as the file has them (z up) ↔ sensor axes (z to the ground).
_DOWN = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))


def read_dimap1(path: Path, reference: tuple[float, float] | None = None, band: int = 1) -> Product:
    """A SPOT 5 product of level 1A: arguments and errors as of `read_product`; `band` is a BAND_INDEX."""
    data = read_xml(path, _WHAT)
    _check_kind(data)
    start = data.text(f"{_STAMP}/SCENE_CENTER_TIME")
    rows = data.count("Raster_Dimensions/NROWS", 2, MOST_LINES)
    row = np.arange(rows, dtype=np.float64) + 1.0
    t = line_period(data, f"{_STAMP}/LINE_PERIOD", {"s": 1.0}) * (
        row - data.number(f"{_STAMP}/SCENE_CENTER_LINE")
    )
    orbit = _orbit(data, start)
    instants, angles = _corrected(data, start)

    looks, alike = _looks(data, band)

    def world_from_sensor(when: Array) -> Rotation:
        return _orbital(orbit, when) * _attitude(_evenly_on(instants, angles, when))

    model = line_scan(
        path,
        start,
        t,
        (instants, world_from_sensor),
        orbit,
        _DOWN.apply(looks),
        reference,
        doubts=(*_doris_doubts(data, start, orbit), *_cut(data)),
        one_grid=OneGrid(str(path.resolve()), _STILL) if alike else None,
    )
    marks, beyond = marks_inside(_marks(data), model.camera.shape)
    return Product(
        path=path,
        kind=f"SPOT {words(data, 'Dataset_Sources/Source_Information/Scene_Source/MISSION_INDEX', '5')} "
        "(DIMAP 1, level 1A)",
        name=words(data, "Dataset_Id/DATASET_NAME", path.stem),
        model=model,
        epoch=epoch_of(start, float(t[0])),
        bands=_bands(data),
        pixels=_pixels(data),
        height=0.0,
        marks=marks,
        assumed=(
            "the ground lies at 0 m, where the product gives its vertices",
            "attitudes lead straight to the ground: neither aberration nor refraction is applied",
        ),
        unknown=beyond,
    )


def _check_kind(data: Part) -> None:
    """FormatError for products of another level or satellite."""
    check_level(
        data,
        ("Metadata_Id/METADATA_FORMAT", "1"),
        ("Data_Processing/PROCESSING_LEVEL", "1A"),
        "1B and products on a map are resampled",
    )
    if not data.has(_LOOKS):
        raise data.refused(_LOOKS, "is missing: SPOT 1 to 4 describe looks otherwise, which is not read")


def _vectors(rows: list[Part], key: str) -> Array:
    return np.array([[row.number(f"{key}/{axis}") for axis in "XYZ"] for row in rows])


def _orbit(data: Part, start: str) -> Orbit:
    """Positions and velocities relative to the Earth."""
    rows = some(data, _POINTS, 2)
    place, speed = _vectors(rows, "Location"), _vectors(rows, "Velocity")
    return orbit_of(data, _POINTS, record_times(rows, "TIME", start), place, speed, inertial=False)


def doris_orbit(data: Part, start: str) -> Orbit:
    """Points of DORIS, in s from an instant of UTC: their labels are TAI, their units cm and mm/s."""
    rows = some(data, _DORIS, 2)
    t = record_times(rows, "TIME", start) - data.number("Data_Strip/Satellite_Time/TAI_TUC")
    place, speed = 1e-2 * _vectors(rows, "Location"), 1e-3 * _vectors(rows, "Velocity")
    return orbit_of(data, _DORIS, t, place, speed, inertial=False)


def _doris_doubts(data: Part, start: str, orbit: Orbit) -> tuple[str, ...]:
    """What is said where DORIS and the ephemeris contradict each other."""
    if len(data.parts(_DORIS)) < 2:
        return ()
    doris = doris_orbit(data, start)
    both = (doris.t >= orbit.t[0]) & (doris.t <= orbit.t[-1])
    apart = np.linalg.norm(orbit.positions(doris.t[both]) - doris.position[both], axis=1)
    if not (apart > _APART).any():
        return ()
    return (
        f"{data.path.name}: points of DORIS (labels in TAI, by TAI_TUC) lie up to {apart.max():.4g} m off "
        "the ephemeris, which is used: is one of them of another pass?",
    )


def _corrected(data: Part, start: str) -> tuple[Array, Array]:
    """Times (s) and yaw, pitch, roll (N, 3) rad of the corrected attitudes."""
    rows = [row for row in data.parts(_ANGLES) if words(row, "OUT_OF_RANGE", "N") == "N"]
    if len(rows) < 2:
        raise data.refused(_ANGLES, f"has {len(rows)} records within range, two or more are needed")
    angles = np.array([[row.number(key) for key in ("YAW", "PITCH", "ROLL")] for row in rows])
    _check_radians(data, _ANGLES, angles)
    return record_times(rows, "TIME", start), angles


def _check_radians(data: Part, name: str, angles: Array) -> None:
    if np.abs(angles).max() > _MOST_ANGLE:
        raise data.refused(name, f"holds an angle of {np.abs(angles).max():.4g}; radians are read")


def _evenly_on(t: Array, values: Array, when: Array) -> Array:
    """Linear between the rows, and straight on beyond the ends."""
    interval = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    share = ((when - t[interval]) / (t[interval + 1] - t[interval]))[:, None]
    return np.asarray((1.0 - share) * values[interval] + share * values[interval + 1])


def _orbital(orbit: Orbit, when: Array) -> Rotation:
    """world_from_orbital: Z up, X = V x Z, Y along the flight."""
    up = orbit.positions(when)
    up /= np.linalg.norm(up, axis=1)[:, None]
    side = np.cross(orbit.velocities(when), up)
    side /= np.linalg.norm(side, axis=1)[:, None]
    return Rotation.from_matrix(np.stack([side, np.cross(up, side), up], axis=2))


def _attitude(angles: Array) -> Rotation:
    """orbital_from_sensor of yaw, pitch, roll (N, 3); M = Rx(-pitch) Ry(-roll) Rz(yaw), axes of the file."""
    yaw, pitch, roll = angles.T
    return Rotation.from_euler("XYZ", np.stack([-pitch, -roll, yaw], axis=1)) * _DOWN


def _looks(data: Part, band: int) -> tuple[Array, bool]:
    """(columns, 3) vectors of a band, axes as in the file; whether all bands of the file share them."""
    columns = data.count("Raster_Dimensions/NCOLS", 2, MOST_SAMPLES)
    place = "Data_Strip/Data_Strip_Coordinates/FIRST_PIXEL_RAW"
    first = data.count(place, 1, MOST_SAMPLES) if data.has(place) else 1
    parts = some(data, _LOOKS, 1)
    tables = {part.count("BAND_INDEX", 1, 100): _look_table(data, part) for part in parts}
    # a table of one band is that of all
    detectors, angles = tables.get(band) or next(iter(tables.values()))
    if band not in tables and len(tables) > 1:
        raise data.refused(
            _LOOKS,
            f"has no table of band {band}, but of {', '.join(map(str, tables))}; is image_band another?",
        )
    wanted = np.arange(columns) + first
    lacking = ~np.isin(wanted, detectors)
    if lacking.any():
        raise data.refused(
            _LOOKS,
            f"holds detectors {detectors[0]} to {detectors[-1]}, but NCOLS is {columns}: "
            f"{int(lacking.sum())} columns from column {int(np.argmax(lacking)) + 1} on have no look; the "
            "table was cut: fetch the whole file",
        )
    x, y = angles[np.searchsorted(detectors, wanted)].T
    alike = all(np.array_equal(other, angles) for _, other in tables.values())
    several = data.count("Raster_Dimensions/NBANDS", 1, 100) > 1
    return np.stack([-np.tan(y), np.tan(x), -np.ones(columns)], axis=1), alike and several


def _look_table(data: Part, part: Part) -> tuple[NDArray[np.intp], Array]:
    """Detectors (N,), counted from 1, and PSI_X, PSI_Y (N, 2) rad of one band."""
    rows = some(part, "Look_Angles_List/Look_Angles", 2)
    detectors = np.array([row.count("DETECTOR_ID", 1, MOST_SAMPLES) for row in rows])
    angles = np.array([[row.number("PSI_X"), row.number("PSI_Y")] for row in rows])
    if (np.diff(detectors) <= 0).any():
        raise data.refused(_LOOKS, "holds detectors that do not increase from row to row")
    _check_radians(data, _LOOKS, angles)
    return detectors, angles


def _cut(data: Part) -> tuple[str, ...]:
    """What is said where places of the file are of columns that the image does not have."""
    columns = data.number("Raster_Dimensions/NCOLS")
    ties = [
        part.number("TIE_POINT_DATA_X") for part in data.parts("Geoposition/Geoposition_Points/Tie_Point")
    ]
    places = {"TIE_POINT_DATA_X": max(ties, default=0.0)}
    if data.has(f"{_STAMP}/SCENE_CENTER_COL"):
        places = {"SCENE_CENTER_COL": data.number(f"{_STAMP}/SCENE_CENTER_COL"), **places}
    beyond = [f"{name} is {value:.0f}" for name, value in places.items() if value > columns]
    if not beyond:
        return ()
    return (
        f"{data.path.name}: NCOLS is {columns:.0f}, but {' and '.join(beyond)}: the image was cut, and "
        "places of columns that it does not have are not used, whatever columns the file calls them",
    )


def _marks(data: Part) -> tuple[GroundMark, ...]:
    """Tie points within the columns of the image: centres of pixels, at the height they tell."""
    columns = data.number("Raster_Dimensions/NCOLS")
    ties = enumerate(data.parts("Geoposition/Geoposition_Points/Tie_Point"), 1)
    return tuple(
        GroundMark(
            f"tie point {number}",
            tie.number("TIE_POINT_DATA_Y") - 1.0,
            tie.number("TIE_POINT_DATA_X") - 1.0,
            tie.number("TIE_POINT_CRS_X"),
            tie.number("TIE_POINT_CRS_Y"),
            tie.number("TIE_POINT_CRS_Z") if tie.has("TIE_POINT_CRS_Z") else 0.0,
        )
        for number, tie in ties
        if tie.number("TIE_POINT_DATA_X") <= columns
    )


def _bands(data: Part) -> tuple[ProductBand, ...]:
    """Every band, in its order in the file."""
    given = [part.element.get("href", "") for part in data.parts("Data_Access/Data_File/DATA_FILE_PATH")]
    names = [
        words(part, "BAND_DESCRIPTION") for part in data.parts("Image_Interpretation/Spectral_Band_Info")
    ]
    count = data.count("Raster_Dimensions/NBANDS", 1, 100)
    if len(names) != count or len(set(names)) != count or not all(names):
        names = [f"band {number}" for number in range(1, count + 1)]
    return bands_of(names, [image_name(file) for file in given])


def _pixels(data: Part) -> Pixels | None:
    """Bare numbers, where the file holds such: lines of all bands in turn."""
    files = data.parts("Data_Access/Data_File/DATA_FILE_PATH")
    if words(data, "Data_Access/DATA_FILE_FORMAT") != "RAW" or len(files) != 1:
        return None
    lines, columns = (data.count(f"Raster_Dimensions/{key}", 2, MOST_LINES) for key in ("NROWS", "NCOLS"))
    layout, bits = (
        words(data, "Raster_Encoding/BANDS_LAYOUT", "BIL"),
        words(data, "Raster_Encoding/NBITS", "8"),
    )
    if layout != "BIL" or bits not in ("8", "16"):
        raise data.refused("Raster_Encoding", f"is {layout[:20]} of {bits[:20]} bits; BIL of 8 or 16 is read")
    skipped = (
        data.count("Raster_Encoding/SKIPBYTES", 0, 1_000_000) if data.has("Raster_Encoding/SKIPBYTES") else 0
    )
    tile = Tile(image_name(files[0].element.get("href", "")), 0, 0, lines, columns)
    big = words(data, "Raster_Encoding/BYTEORDER", "M") == "M"
    return Pixels((tile,), "Byte" if bits == "8" else "UInt16", skipped, big)
