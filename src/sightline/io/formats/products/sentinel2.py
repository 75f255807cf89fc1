"""Sentinel-2, level 1B: when the bands of a granule were exposed, by its own metadata and its datastrip's.

GPS_TIME is when line 1 of a band of a detector begins; lines follow each other by LINE_PERIOD (ms) at 10 m;
POSITION is the granule's first line, from 1, at 10 m. Points of the orbit are Earth-fixed, mm. Where columns
look is in calibration files (GIPP) that are no part of a product, so that no model is made of it.
Sources: names and places of the values, ESA, Sentinel-2 Products Specification Document; how lines are dated,
units and axes, ESA, Sen2VM (``DataStripManager``). No sample was at hand.

Not here: the acquisition that is made of it (``io/init/``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sightline.errors import FormatError, reads
from sightline.geometry.earth import to_geodetic
from sightline.io.formats.instants import clock, utc_text
from sightline.io.formats.products.makers import line_period, scaled, some, words
from sightline.io.formats.products.tree import Part, read_xml

_GRANULE = "metadata of a Sentinel-2 L1B granule (S2._OPER_MTD_L1B_GR_....xml)"
_DATASTRIP = "metadata of a Sentinel-2 L1B datastrip (S2._OPER_MTD_L1B_DS_....xml)"
_STAMPS = "Image_Data_Info/Sensor_Configuration/Time_Stamp"
_POINTS = "Satellite_Ancillary_Data_Info/Ephemeris/GPS_Points_List/GPS_Point"
#: Bands by their number in the datastrip, from 0.
_BANDS = ("B01", "B02", "B03", "B04", "B05", "B06", "B07", "B08", "B8A", "B09", "B10", "B11", "B12")
#: Bands of 10 m: the first is that from which lags count.
FINE = ("B02", "B03", "B04", "B08")
_MS = {"ms": 1e-3, "s": 1.0}
_MM = {"mm": 1e-3, "m": 1.0}
#: s by which bands of one detector see the ground after one another at most.
_LONGEST_LAG = 4.0
#: m above the ellipsoid within which the satellites fly.
_HEIGHTS = (7.6e5, 8.4e5)


@dataclass(frozen=True)
class GranuleTimes:
    """When the bands of 10 m of a granule were exposed.

    Attributes
    ----------
    detector : str
    position : int
        Its first line in the datastrip, from 1.
    epoch : str
        UTC of the centre of its first line in B02.
    lags : dict
        Band to the s by which it is exposed after B02.
    line_period : float
        s.
    height : float
        m of the satellite above the ellipsoid.
    """

    detector: str
    position: int
    epoch: str
    lags: dict[str, float]
    line_period: float
    height: float


@reads("metadata of Sentinel-2 L1B")
def read_granule_times(granule: Path, datastrip: Path) -> GranuleTimes:
    """Times of the bands of 10 m of a granule.

    Parameters
    ----------
    granule, datastrip : Path
        XML of both.

    Returns
    -------
    GranuleTimes

    Raises
    ------
    FormatError
        Names the file, and the value that is missing or wrong.
    """
    tile, strip = _plain(granule, _GRANULE), _plain(datastrip, _DATASTRIP)
    detector = tile.text("General_Info/DETECTOR_ID")
    _check_strip(tile, datastrip)
    position = tile.count("Geometric_Info/Granule_Position/POSITION", 1, 10_000_000)
    period = line_period(strip, f"{_STAMPS}/LINE_PERIOD", _MS)
    # instants of a day are told to 1e-11 s
    day = _stamp(strip, FINE[0], detector).text("GPS_TIME")[:10]
    begun = {band: _begin(strip, band, detector, day) for band in FINE}
    lags = {band: begun[band] - begun[FINE[0]] for band in FINE}
    far = max(lags, key=lambda band: abs(lags[band]))
    if abs(lags[far]) > _LONGEST_LAG:
        raise strip.refused(
            f"{_STAMPS}/Band_Time_Stamp",
            f"puts {far} {lags[far]:.4g} s after {FINE[0]}; bands see the ground within {_LONGEST_LAG:g} s",
        )
    t = begun[FINE[0]] + (position - 0.5) * period
    return GranuleTimes(detector, position, utc_text(t, day) + "Z", lags, period, _height(strip, t, day))


def datastrip_of(granule: Path) -> Path | None:
    """Metadata of the datastrip where products have it: ``DATASTRIP`` beside ``GRANULE``; else None."""
    folders = [granule.parent.parent.parent / "DATASTRIP", granule.parent / "DATASTRIP", granule.parent]
    wanted = _strip_name(_plain(granule, _GRANULE))
    for folder in folders:
        if folder.is_dir():
            found = [path for path in sorted(folder.rglob("*.xml")) if path.stem.startswith(wanted)]
            if wanted and len(found) == 1:
                return found[0]
    return None


def _strip_name(tile: Part) -> str:
    """How the file of a granule's datastrip begins: of ..._MSI_L1B_DS_... it is ..._MTD_L1B_DS_..."""
    name = words(tile, "General_Info/DATASTRIP_ID")
    # without the baseline at the end
    return name.rpartition("_N")[0].replace("_MSI_", "_MTD_")


def _plain(path: Path, what: str) -> Part:
    """The root of an XML file, prefixes of its names left out."""
    root = read_xml(path, what)
    for element in root.element.iter():
        element.tag = element.tag.rpartition(":")[2]
    return root


def _check_strip(tile: Part, datastrip: Path) -> None:
    """FormatError where the granule names another datastrip, by the file's name."""
    name, held = words(tile, "General_Info/DATASTRIP_ID"), _strip_name(tile)
    if held and "_MTD_L1B_DS_" in datastrip.stem and not datastrip.stem.startswith(held):
        raise FormatError(f"{datastrip}: is not the datastrip of {tile.path.name}, which is of {name[:120]}")


def _stamp(strip: Part, band: str, detector: str) -> Part:
    """What dates line 1 of a band."""
    place = f"{_STAMPS}/Band_Time_Stamp[@bandId='{_BANDS.index(band)}']"
    # 05 and 5 are one detector
    found = [
        one
        for one in strip.part(place).parts("Detector")
        if one.element.get("detectorId", "").lstrip("D0") == detector.lstrip("D0")
    ]
    if len(found) != 1:
        raise strip.refused(place, f"({band}) has {len(found)} Detector {detector[:8]}; one is needed")
    (stamp,) = found
    if stamp.count("REFERENCE_LINE", 0, 100_000_000) > 1:
        raise stamp.refused("REFERENCE_LINE", "is not the first line (0 or 1); others are not verified")
    return stamp


def _begin(strip: Part, band: str, detector: str, day: str) -> float:
    """s from a day (UTC) to when line 1 of a band begins."""
    stamp = _stamp(strip, band, detector)
    return clock("GPS", day, lambda _: 0.0)(stamp.text("GPS_TIME"), f"{strip.path}: {stamp.place}/GPS_TIME")


def _height(strip: Part, t: float, day: str) -> float:
    """m above the ellipsoid of the point of the orbit nearest to t (s from a day)."""
    read = clock("GPS", day, lambda _: 0.0)
    points = some(strip, _POINTS, 1)
    when = [read(point.text("GPS_TIME"), f"{strip.path}: {point.place}/GPS_TIME") for point in points]
    nearest = points[int(np.argmin(np.abs(np.array(when) - t)))]
    height = float(to_geodetic(scaled(nearest, "POSITION_VALUES", _MM, 3)[None])[0, 2])
    if not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise nearest.refused(
            "POSITION_VALUES",
            f"lies {height:.4g} m above the ellipsoid, not {_HEIGHTS[0]:g} to {_HEIGHTS[1]:g} m",
        )
    return height
