"""OpenSfM's ``reconstruction.json``: cameras, shots and points.

World axes are east, north, up of a place on the Earth, ``reference_lla`` (degrees, m). A shot has
camera_from_world as a rotation vector, and the world's origin in camera axes; camera axes are ours. Lengths
in the image are parts of its larger side, from its middle; the centre of the first pixel has the pixel
coordinate 0, as ours. Sightings are in other files of OpenSfM and not here.

Not here: COLMAP models (``colmap.py``).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.instrument import AreaDetector
from sightline.io.reconstruction import Reconstruction
from sightline.writing import whole

#: Relative difference of the two focal lengths up to which pixels are square.
_SQUARE = 1e-3


def write_opensfm(
    path: Path, model: Reconstruction, reference: tuple[float, float, float] | None = None
) -> None:
    """A ``reconstruction.json`` of one reconstruction.

    Parameters
    ----------
    path : Path
    model : Reconstruction
        World axes east, north, up.
    reference : (3,), optional
        Longitude, latitude (degrees), height (m) of their origin.
    """
    content: dict[str, Any] = {
        "cameras": {_name(k): _camera(detector) for k, detector in enumerate(model.detectors)},
        "shots": {},
        "points": {
            str(k): {"coordinates": model.points[k].tolist(), "color": [128.0, 128.0, 128.0]}
            for k in model.known
        },
    }
    camera_from_world = model.world_from_camera.inv()
    turns, moves = camera_from_world.as_rotvec(), -camera_from_world.apply(np.array(model.position))
    for k, name in enumerate(model.names):
        content["shots"][name] = {
            "rotation": turns[k].tolist(),
            "translation": moves[k].tolist(),
            "camera": _name(int(model.camera[k])),
            "orientation": 1,
        }
    if reference is not None:
        longitude, latitude, height = reference
        content["reference_lla"] = {"latitude": latitude, "longitude": longitude, "altitude": height}
    with whole(path) as draft:
        draft.write_text(json.dumps([content], indent=1), encoding="utf-8")


def _name(camera: int) -> str:
    return f"camera {camera + 1}"


def _camera(detector: AreaDetector) -> dict[str, Any]:
    """Model "brown" of a detector."""
    lines, columns = detector.shape
    size = max(lines, columns)
    line, column = detector.principal_point_px
    k1, k2, p1, p2, k3 = (*detector.distortion, *([0.0] * (5 - len(detector.distortion))))
    focal = detector.focal_length_px / size
    return {
        "projection_type": "brown",
        "width": columns,
        "height": lines,
        "focal_x": focal,
        "focal_y": focal,
        "c_x": (column + 0.5 - columns / 2.0) / size,
        "c_y": (line + 0.5 - lines / 2.0) / size,
        "k1": k1,
        "k2": k2,
        "p1": p1,
        "p2": p2,
        "k3": k3,
    }


def read_opensfm(path: Path) -> tuple[Reconstruction, tuple[float, float, float] | None]:
    """The first reconstruction of a ``reconstruction.json``, and its reference as of `write_opensfm`.

    Raises
    ------
    FormatError
        If the file is none, or holds a camera that is not understood.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file; give a reconstruction.json of OpenSfM") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FormatError(f"{path}: cannot be read as JSON ({error})") from None
    first = content[0] if isinstance(content, list) and content else content
    if not isinstance(first, dict) or not first.get("shots") or not first.get("cameras"):
        raise FormatError(f"{path}: no reconstruction with cameras and shots is in it")
    try:
        return _reconstruction(path, first), _reference(first)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: not a reconstruction of OpenSfM: {error!r} is missing or wrong") from None


def _reference(content: dict[str, Any]) -> tuple[float, float, float] | None:
    place = content.get("reference_lla")
    return None if place is None else (place["longitude"], place["latitude"], place["altitude"])


def _reconstruction(path: Path, content: dict[str, Any]) -> Reconstruction:
    cameras = list(content["cameras"])
    shots = content["shots"]
    camera_from_world = Rotation.from_rotvec(
        np.array([shot["rotation"] for shot in shots.values()], dtype=float)
    )
    moves = np.array([shot["translation"] for shot in shots.values()], dtype=float)
    points = [point["coordinates"] for point in content.get("points", {}).values()]
    return Reconstruction(
        tuple(shots),
        tuple(_detector(path, name, content["cameras"][name]) for name in cameras),
        np.array([cameras.index(shot["camera"]) for shot in shots.values()], dtype=np.intp),
        -camera_from_world.inv().apply(moves),
        camera_from_world.inv(),
        np.array(points, dtype=float).reshape(-1, 3),
        np.full(len(points), np.nan),
    )


def _detector(path: Path, name: str, camera: dict[str, Any]) -> AreaDetector:
    kind = camera.get("projection_type", "perspective")
    if kind not in ("perspective", "brown", "radial", "simple_radial"):
        raise FormatError(
            f"{path}: camera {name!r} is of the kind {kind!r}, which is not understood; understood: "
            "perspective, "
            "brown, radial, simple_radial"
        )
    lines, columns = int(camera["height"]), int(camera["width"])
    size = max(lines, columns)
    fx = camera["focal"] if kind == "perspective" else camera["focal_x"]
    fy = fx if kind == "perspective" else camera["focal_y"]
    if abs(fx - fy) > _SQUARE * abs(fx):
        raise FormatError(f"{path}: camera {name!r}: pixels that are not square are not understood")
    cx, cy = camera.get("c_x", 0.0), camera.get("c_y", 0.0)
    distortion = tuple(float(camera.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2", "k3"))
    return AreaDetector(
        name,
        (lines, columns),
        (fx + fy) / 2.0 * size,
        (cy * size + lines / 2.0 - 0.5, cx * size + columns / 2.0 - 0.5),
        distortion if any(distortion) else (),
    )
