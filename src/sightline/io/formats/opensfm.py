"""OpenSfM's ``reconstruction.json``: cameras, shots and points.

World axes are east, north, up of a place on the Earth, ``reference_lla`` (degrees, m). A shot has
camera_from_world as a rotation vector, and the world's origin in camera axes; camera axes are ours. Lengths
in the image are parts of its larger side, from its middle; the centre of the first pixel has the pixel
coordinate 0, as ours. Sightings are in other files of OpenSfM and not here.

Of a rig ``rig_cameras`` (how each camera sits in the rig) and ``rig_instances`` (a pose per capture, and
which shot is of which camera) stand beside them, and as ``rig_cameras.json`` and ``rig_assignments.json``,
which OpenSfM begins with; shots hold their own poses too, which is what is read.

Not here: COLMAP models (``colmap.py``).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import read_json
from sightline.errors import FormatError, foreign_errors, reads
from sightline.geometry.instrument import AreaDetector
from sightline.io.formats.reconstruction import Reconstruction
from sightline.writing import whole_text

#: Relative difference of the two focal lengths up to which pixels are square.
_SQUARE = 1e-3
#: m; heights of references beyond which they are none.
_FARTHEST = 1e9

Array = NDArray[np.float64]


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
    if model.captures:
        _add_rig(path.parent, model, content)
    if reference is not None:
        longitude, latitude, height = reference
        content["reference_lla"] = {"latitude": latitude, "longitude": longitude, "altitude": height}
    whole_text(path, json.dumps([content], indent=1))


def _add_rig(folder: Path, model: Reconstruction, content: dict[str, Any]) -> None:
    """Rig cameras and instances of a reconstruction, and the two files that OpenSfM begins with."""
    cameras = {_name(k): _posed(pose) for k, pose in sorted(model.sensors().items())}
    of_capture: dict[int, dict[str, str]] = {}
    for name, camera, capture in zip(model.names, model.camera, model.capture, strict=True):
        of_capture.setdefault(int(capture), {})[name] = _name(int(camera))
    content["rig_cameras"] = cameras
    content["rig_instances"] = {
        model.captures[k]: {**_posed(pose), "rig_camera_ids": of_capture[k]}
        for k, pose in sorted(model.rig_poses().items())
    }
    known = {name: {**pose, "camera": name} for name, pose in cameras.items()}
    whole_text(folder / "rig_cameras.json", json.dumps(known, indent=1))
    assigned = {
        model.captures[k]: [list(pair) for pair in images.items()] for k, images in of_capture.items()
    }
    whole_text(folder / "rig_assignments.json", json.dumps(assigned, indent=1))


def _posed(pose: tuple[Rotation, Array]) -> dict[str, list[float]]:
    return {"rotation": pose[0].as_rotvec().tolist(), "translation": np.asarray(pose[1]).tolist()}


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


@reads("a reconstruction of OpenSfM")
def read_opensfm(path: Path) -> tuple[Reconstruction, tuple[float, float, float] | None]:
    """The first reconstruction of a ``reconstruction.json``, and its reference as of `write_opensfm`.

    Raises
    ------
    FormatError
        If the file is none, or holds a camera that is not understood.
    """
    what = "a reconstruction.json of OpenSfM"
    content = read_json(path, what, advice=f"give {what}")
    first = content[0] if isinstance(content, list) and content else content
    if not isinstance(first, dict) or not first.get("shots") or not first.get("cameras"):
        raise FormatError(f"{path}: no reconstruction with cameras and shots is in it")
    return _reconstruction(path, first), _reference(path, first)


def _reference(path: Path, content: dict[str, Any]) -> tuple[float, float, float] | None:
    place = content.get("reference_lla")
    if place is None:
        return None
    with foreign_errors(f"{path}: reference_lla", "not as OpenSfM has it", "degrees and metres are expected"):
        longitude, latitude, height = (float(place[key]) for key in ("longitude", "latitude", "altitude"))
    if not (abs(longitude) <= 360.0 and abs(latitude) <= 90.0 and abs(height) < _FARTHEST):
        raise FormatError(
            f"{path}: reference_lla: longitude {longitude:g}, latitude {latitude:g}, altitude {height:g} is "
            "no place; degrees and metres are expected"
        )
    return longitude, latitude, height


def _reconstruction(path: Path, content: dict[str, Any]) -> Reconstruction:
    cameras = list(content["cameras"])
    shots = content["shots"]
    turns = _vectors(path, "shots", "rotation", shots)
    camera_from_world = Rotation.from_rotvec(turns)
    moves = _vectors(path, "shots", "translation", shots)
    points = _vectors(path, "points", "coordinates", content.get("points", {}))
    return Reconstruction(
        tuple(shots),
        tuple(_detector(path, name, content["cameras"][name]) for name in cameras),
        np.array([cameras.index(shot["camera"]) for shot in shots.values()], dtype=np.intp),
        -camera_from_world.inv().apply(moves),
        camera_from_world.inv(),
        points,
        np.full(len(points), np.nan),
    )


def _vectors(path: Path, table: str, key: str, entries: dict[str, Any]) -> Array:
    """(n, 3) finite numbers of a key of all entries of a table."""
    place = f"{path}: {table}: {key}"
    with foreign_errors(place, "not as OpenSfM has it", "three numbers of each are expected"):
        vectors = np.array([entry[key] for entry in entries.values()], dtype=np.float64).reshape(-1, 3)
        if len(vectors) != len(entries):
            raise FormatError(f"{place}: three numbers of each are expected")
    if not np.isfinite(vectors).all():
        name = list(entries)[int(np.argmin(np.isfinite(vectors).all(axis=1)))]
        raise FormatError(f"{place} of {name!r} is not finite; remove it")
    return vectors


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
