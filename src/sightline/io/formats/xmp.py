"""What cameras write into the XMP of a photograph: angles of a DJI gimbal, tags of a MicaSense rig.

DJI: angles of the camera in degrees against north, east, down: yaw clockwise from north, then pitch (0 at the
horizon, -90 straight down), then roll; at 0, 0, 0 the camera looks north, columns to the east, lines down.
Pix4D's camera tags (MicaSense, and others): focal length in px (or mm), principal point in mm from pixel
(0, 0)'s corner, distortion k1, k2, k3, p1, p2, central wavelength in nm, number of the camera in its rig,
RigRelatives: degrees about x (columns), y (lines), z (forward) of the camera, in which order it is turned
from the axes of the rig (reference_from_camera = Rx Ry Rz). DJI's lens: DewarpData
"date;fx,fy,cx,cy,k1,k2,p1,p2,k3" in px, cx and cy from the middle of the frame.

Not here: time and place (``exif.py``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import foreign_errors
from sightline.imaging.rasters import open_raster
from sightline.io.formats.exif import read_tags

Array = NDArray[np.float64]

_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
_DJI = "{http://www.dji.com/drone-dji/1.0/}"
_PIX4D = ("{http://pix4d.com/1.0}", "{http://pix4d.com/camera/1.0}", "{http://pix4d.com/camera/1.0/}")
#: What the images of one capture share.
_CAPTURES = (
    "{http://micasense.com/MicaSense/1.0/}CaptureId",
    _DJI + "CaptureUUID",
    *(space + "CaptureUUID" for space in _PIX4D),
)
_GIMBAL = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
#: Columns of the camera to the gimbal's right, lines to its down, the optical axis forward.
_GIMBAL_FROM_CAMERA = Rotation.from_matrix([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Xmp:
    """What XMP says about one photograph; None, or NaN, where it says nothing.

    Attributes
    ----------
    gimbal_deg : (3,) or None
        Yaw, pitch, roll of the camera, degrees, as DJI counts them.
    longitude_deg, latitude_deg : float or None
        Signed degrees.
    position_sigma : (3,) or None
        m, 1-sigma east, north, up, of an RTK fix.
    rig_camera : int or None
        Which camera of a rig.
    wavelength_nm : float or None
        Of its filter's centre.
    focal_length_px : float or None
    principal_point_px : (line, column) or None
    distortion : tuple of 5 floats
        k1, k2, p1, p2, k3; empty where there is none.
    band : str or None
        Name of the band of one image of a rig.
    capture : str or None
        Name that the images of one capture share.
    rig_relatives_deg : (3,) or None
        How the camera is turned in its rig.
    optical_centre_px : (2,) or None
        (line, column) by which its image lies off that of the rig's reference, as DJI gives it.
    principal_offset_px : (line, column) or None
        Of the principal point from the middle of the frame, where that is how it is given.
    body_deg : (3,) or None
        Yaw, pitch, roll that a camera of a rig gives for itself.
    """

    gimbal_deg: Array | None
    longitude_deg: float | None
    latitude_deg: float | None
    position_sigma: Array | None
    rig_camera: int | None
    wavelength_nm: float | None
    focal_length_px: float | None
    principal_point_px: tuple[float, float] | None
    distortion: tuple[float, ...]
    band: str | None = None
    capture: str | None = None
    rig_relatives_deg: Array | None = None
    optical_centre_px: Array | None = None
    principal_offset_px: tuple[float, float] | None = None
    body_deg: Array | None = None

    def rig_from_camera(self) -> Rotation | None:
        """Axes of the rig from those of the camera by RigRelatives."""
        angles = self.rig_relatives_deg
        return None if angles is None else Rotation.from_euler("XYZ", angles, degrees=True)

    def north_east_down_from_camera(self) -> Rotation | None:
        """Attitude of the camera by its gimbal."""
        return None if self.gimbal_deg is None else gimbal_attitude(self.gimbal_deg)


def gimbal_attitude(gimbal_deg: Array) -> Rotation:
    """north_east_down_from_camera of yaw, pitch, roll ((3,) or (N, 3), degrees) of a DJI gimbal."""
    return Rotation.from_euler("ZYX", gimbal_deg, degrees=True) * _GIMBAL_FROM_CAMERA


def read_xmp(path: Path) -> Xmp | None:
    """XMP of a photograph; None where it has none, FormatError where it is damaged."""
    with foreign_errors(path, "its XMP cannot be read", "leave it out, or write it anew"):
        with open_raster(path) as dataset:
            packet = next(iter(dataset.tags(ns="xml:XMP").values()), "")
        return None if not packet else parse_xmp(packet, _px_per_mm(read_tags(path)), path)


def _px_per_mm(tags: dict[str, str]) -> float | None:
    """Pixels per mm of the detector where EXIF gives it in mm or cm or inches."""
    per = {"2": 25.4, "3": 10.0, "4": 1.0}.get(tags.get("EXIF_FocalPlaneResolutionUnit", "").strip())
    value = _number(tags.get("EXIF_FocalPlaneXResolution", "").strip("() "))
    return None if per is None or value is None or value <= 0.0 else value / per


def parse_xmp(packet: str, px_per_mm: float | None = None, place: object = "the packet") -> Xmp | None:
    """The same from the text of the packet; lengths in mm need `px_per_mm` of the detector.

    None where it holds nothing; FormatError, which begins with `place`, where it is no XML.
    """
    start, end = packet.find("<x:xmpmeta"), packet.rfind("</x:xmpmeta>")
    if start < 0 and end < 0:
        return None
    with foreign_errors(place, "its XMP cannot be read", "leave it out, or write it anew"):
        root = ElementTree.fromstring(packet[max(start, 0) : end + len("</x:xmpmeta>") if end >= 0 else None])
    values = dict(_entries(root))

    def dji(name: str) -> float | None:
        return _number(values.get(_DJI + name))

    def rig(name: str) -> str | None:
        return next((values[space + name] for space in _PIX4D if space + name in values), None)

    gimbal = _all(dji(name) for name in _GIMBAL)
    wavelength, number = _number(rig("CentralWavelength")), _number(rig("RigCameraIndex"))
    lens = _lens(rig("PerspectiveFocalLength"), rig("PerspectiveFocalLengthUnits"), px_per_mm)
    principal, distortion = (
        _principal_point(rig("PrincipalPoint"), px_per_mm),
        _distortion(rig("PerspectiveDistortion")),
    )
    offset = None
    dewarp = _dewarp(values.get(_DJI + "DewarpData"))
    if dewarp is not None:
        lens, principal, offset, distortion = dewarp[0], None, dewarp[1], dewarp[2]
    bands = rig("BandName")
    return Xmp(
        gimbal,
        _first(dji("GpsLongitude"), dji("GpsLongtitude"), dji("Longitude")),
        _first(dji("GpsLatitude"), dji("Latitude")),
        _sigmas(_all(dji(name) for name in ("RtkStdLon", "RtkStdLat", "RtkStdHgt"))),
        None if number is None else int(number),
        wavelength,
        lens,
        principal,
        distortion,
        bands.strip() if bands and bands.strip() else None,
        next((values[name].strip() for name in _CAPTURES if values.get(name, "").strip()), None),
        _triple(rig("RigRelatives")),
        _all(dji(name) for name in ("RelativeOpticalCenterY", "RelativeOpticalCenterX")),
        offset,
        _all(_number(rig(name)) for name in ("Yaw", "Pitch", "Roll")),
    )


def _entries(root: ElementTree.Element) -> list[tuple[str, str]]:
    """Names with namespace and values: attributes, elements, and lists joined by commas."""
    found: list[tuple[str, str]] = []
    for description in root.iter(f"{_RDF}Description"):
        found += description.attrib.items()
        for child in description:
            items = [item.text or "" for item in child.iter(f"{_RDF}li")]
            found.append((child.tag, ",".join(items) if items else (child.text or "")))
    return found


def _number(text: str | None) -> float | None:
    try:
        value = float((text or "").strip())
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def _all(values: object) -> Array | None:
    """The numbers as an array, if all are there."""
    given = list(values)  # type: ignore[call-overload]
    return None if None in given else np.array(given, dtype=np.float64)


def _sigmas(values: Array | None) -> Array | None:
    """Sigmas, if they can be: an RTK fix that failed says zero."""
    return values if values is not None and (values > 0.0).all() else None


def _lens(focal: str | None, unit: str | None, px_per_mm: float | None) -> float | None:
    """Focal length in px; in mm by its unit, or because no lens has so few pixels."""
    value = _number(focal)
    if value is None or value <= 0.0:
        return None
    if unit == "mm" or (unit is None and value < 100.0):
        return None if px_per_mm is None else value * px_per_mm
    return value


def _principal_point(text: str | None, px_per_mm: float | None) -> tuple[float, float] | None:
    """(line, column), pixel centres whole, of "x,y" in mm from the corner of the detector."""
    parts = [_number(word) for word in (text or "").split(",")]
    if px_per_mm is None or len(parts) != 2 or parts[0] is None or parts[1] is None:
        return None
    return parts[1] * px_per_mm - 0.5, parts[0] * px_per_mm - 0.5


def _triple(text: str | None) -> Array | None:
    """Three numbers parted by commas; None where there are no three."""
    parts = (text or "").split(",")
    return _all(_number(word) for word in parts) if len(parts) == 3 else None


def _dewarp(text: str | None) -> tuple[float, tuple[float, float], tuple[float, ...]] | None:
    """Focal length, principal point from the middle (line, column), distortion of DJI's "date;fx,fy,..."."""
    parts = [_number(word) for word in (text or "").rpartition(";")[2].split(",")]
    values = [value for value in parts if value is not None]
    if len(values) != 9 or values[0] <= 0.0:
        return None
    return values[0], (values[3], values[2]), tuple(values[4:])


def _distortion(text: str | None) -> tuple[float, ...]:
    """k1, k2, p1, p2, k3 of "k1,k2,k3,p1,p2"."""
    parts = [_number(word) for word in (text or "").split(",")]
    values = [value for value in parts if value is not None]
    if len(values) != 5:
        return ()
    k1, k2, k3, p1, p2 = values
    return k1, k2, p1, p2, k3
