"""COLMAP models, text and binary: ``cameras``, ``images`` and ``points3D``, each ``.txt`` or ``.bin``.

COLMAP's pixels are (x, y) = (column, line) with 0 at the corner of the first pixel, so that half a pixel is
added to ours; its poses are camera_from_world: a quaternion with the scalar first, and the world's origin in
camera axes; camera axes are ours. Sightings of no point are written as such, and left out in reading.
Cameras of a rig have ``rigs`` and ``frames`` beside these (COLMAP 3.12 and later): how each sits in the
first, and one pose per capture; without them one image is one frame. Images hold their poses too, which is
what is read.

Not here: which poses and points of a result are written (``io/results/stereo_exports.py``,
``io/results/sequence_exports.py``).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import LARGE, read_bytes, read_text
from sightline.errors import FormatError, InputError, reads, said_by
from sightline.geometry.instrument import AreaDetector
from sightline.io.formats.reconstruction import Reconstruction, by_image
from sightline.writing import whole

Array = NDArray[np.float64]

#: Coordinate of the centre of the first pixel.
CORNER = 0.5
#: Number and parameters of the camera models that are understood.
MODELS = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "FULL_OPENCV": (6, 12),
}
#: Relative difference of the two focal lengths up to which pixels are square.
_SQUARE = 1e-3
#: Number of the kind of sensor that a camera is.
_CAMERA = 0
_SIGHT = np.dtype([("x", "<f8"), ("y", "<f8"), ("id", "<i8")])


def camera_of(detector: AreaDetector) -> tuple[str, list[float]]:
    """Model and parameters of a detector: PINHOLE, or the OpenCV models where there is distortion."""
    line, column = detector.principal_point_px
    f = detector.focal_length_px
    values = [f, f, column + CORNER, line + CORNER]
    if not detector.distortion:
        return "PINHOLE", values
    given = [*detector.distortion, *([0.0] * (5 - len(detector.distortion)))]
    if given[4]:
        return "FULL_OPENCV", values + given + [0.0] * 3
    return "OPENCV", values + given[:4]


def detector_of(
    path: Path, name: str, model: str, shape: tuple[int, int], values: Sequence[float]
) -> AreaDetector:
    """A detector from model and parameters; FormatError for a model that cannot be one."""
    if model not in MODELS:
        raise FormatError(f"{path}: camera model {model} is not understood; understood: {', '.join(MODELS)}")
    if len(values) != MODELS[model][1]:
        raise FormatError(
            f"{path}: camera {name}: {model} takes {MODELS[model][1]} parameters, not {len(values)}"
        )
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        fx = fy = values[0]
        cx, cy, *distortion = values[1:]
    else:
        fx, fy, cx, cy, *distortion = values
    if abs(fx - fy) > _SQUARE * abs(fx):
        raise FormatError(
            f"{path}: camera {name}: focal lengths {fx:.6g} and {fy:.6g} px differ: pixels that are "
            "not square are "
            "not understood"
        )
    if any(distortion[5:]):
        raise FormatError(
            f"{path}: camera {name}: k4, k5, k6 of FULL_OPENCV are not understood; they must be 0"
        )
    principal = cy - CORNER, cx - CORNER
    return AreaDetector(
        name, shape, (fx + fy) / 2.0, principal, tuple(distortion[:5]) if any(distortion) else ()
    )


def write_colmap_model(folder: Path, model: Reconstruction, *, binary: bool = False) -> None:
    """A model in `folder`, which is made; the three files of the form asked for.

    Parameters
    ----------
    folder : Path
    model : Reconstruction
    binary : bool
        ``.bin`` in place of ``.txt``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    bad = [name for name in model.names if any(c.isspace() for c in name)]
    if bad:
        raise InputError(f"the image name {bad[0]!r} has a space, which COLMAP models cannot hold")
    rows, place = by_image(model.image, len(model.names))
    camera_from_world = model.world_from_camera.inv()
    x, y, z, w = camera_from_world.as_quat().T
    poses = np.column_stack([w, x, y, z, -camera_from_world.apply(np.array(model.position))])
    seen = [
        np.column_stack(
            [model.pixels[r][:, ::-1] + CORNER, np.where(model.point[r] < 0, -1, model.point[r] + 1)]
        )
        if len(r)
        else np.empty((0, 3))
        for r in rows
    ]
    tracks = _tracks(model, place)
    if binary:
        _replace(folder / "cameras.bin", _camera_bytes(model))
        _replace(folder / "images.bin", _image_bytes(model, poses, seen))
        _replace(folder / "points3D.bin", _point_bytes(model, tracks))
        if model.captures:
            _replace(folder / "rigs.bin", _rig_bytes(model))
            _replace(folder / "frames.bin", _frame_bytes(model))
    else:
        _replace(folder / "cameras.txt", _text(_camera_lines(model)))
        _replace(folder / "images.txt", _text(_image_lines(model, poses, seen)))
        _replace(folder / "points3D.txt", _text(_point_lines(model, tracks)))
        if model.captures:
            _replace(folder / "rigs.txt", _text(_rig_lines(model)))
            _replace(folder / "frames.txt", _text(_frame_lines(model)))


def _tracks(model: Reconstruction, place: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Per point (n_k, 2): image number from 1, place of the sighting in it."""
    order = np.argsort(model.point, kind="stable")
    order = order[model.point[order] >= 0]
    pairs = np.column_stack([model.image[order] + 1, place[order]])
    counts = np.bincount(model.point[order], minlength=len(model.points))
    return np.split(pairs, np.cumsum(counts)[:-1]) if len(model.points) else []


def _replace(path: Path, parts: Iterable[bytes]) -> None:
    with whole(path) as draft, draft.open("wb") as stream:
        stream.writelines(parts)


def _text(lines: Iterable[str]) -> Iterable[bytes]:
    return (f"{line}\n".encode() for line in lines)


def _camera_lines(model: Reconstruction) -> Iterable[str]:
    for number, detector in enumerate(model.detectors, 1):
        name, values = camera_of(detector)
        lines, columns = detector.shape
        yield f"{number} {name} {columns} {lines} " + " ".join(f"{v:.17g}" for v in values)


def _image_lines(model: Reconstruction, poses: Array, seen: list[Array]) -> Iterable[str]:
    for k, name in enumerate(model.names):
        yield f"{k + 1} " + " ".join(f"{v:.17g}" for v in poses[k]) + f" {model.camera[k] + 1} {name}"
        yield " ".join(f"{column:.17g} {line:.17g} {point:.0f}" for column, line, point in seen[k].tolist())


def _point_lines(model: Reconstruction, tracks: list[NDArray[np.intp]]) -> Iterable[str]:
    for k in model.known:
        x, y, z = model.points[k]
        track = " ".join(f"{image} {at}" for image, at in tracks[k].tolist())
        yield f"{k + 1} {x:.17g} {y:.17g} {z:.17g} 128 128 128 {_residual(model, k):.9g} {track}"


def _residual(model: Reconstruction, k: int) -> float:
    """COLMAP's own value for a residual that is not known is -1."""
    value = float(model.residual_px[k])
    return value if np.isfinite(value) else -1.0


def _seven(pose: tuple[Rotation, Array]) -> list[float]:
    """Quaternion, scalar first, and translation."""
    x, y, z, w = pose[0].as_quat()
    return [w, x, y, z, *pose[1]]


def _frames(model: Reconstruction) -> list[tuple[int, list[float], list[tuple[int, int]]]]:
    """Number of each capture that has a pose, that pose, and its images: number of camera and of image."""
    return [
        (
            capture + 1,
            _seven(pose),
            [(int(model.camera[k]) + 1, int(k) + 1) for k in np.flatnonzero(model.capture == capture)],
        )
        for capture, pose in sorted(model.rig_poses().items())
    ]


def _rig_lines(model: Reconstruction) -> Iterable[str]:
    sensors = {camera: pose for camera, pose in model.sensors().items() if camera > 0}
    parts = [
        f"CAMERA {camera + 1} 1 " + " ".join(f"{v:.17g}" for v in _seven(pose))
        for camera, pose in sorted(sensors.items())
    ]
    yield " ".join([f"1 {len(sensors) + 1} CAMERA 1", *parts])


def _frame_lines(model: Reconstruction) -> Iterable[str]:
    for number, pose, images in _frames(model):
        data = " ".join(f"CAMERA {camera} {image}" for camera, image in images)
        yield f"{number} 1 " + " ".join(f"{v:.17g}" for v in pose) + f" {len(images)} {data}"


def _rig_bytes(model: Reconstruction) -> Iterable[bytes]:
    sensors = {camera: pose for camera, pose in model.sensors().items() if camera > 0}
    yield struct.pack("<QIIiI", 1, 1, len(sensors) + 1, _CAMERA, 1)
    for camera, pose in sorted(sensors.items()):
        yield struct.pack("<iIB7d", _CAMERA, camera + 1, 1, *_seven(pose))


def _frame_bytes(model: Reconstruction) -> Iterable[bytes]:
    frames = _frames(model)
    yield struct.pack("<Q", len(frames))
    for number, pose, images in frames:
        yield struct.pack("<II7dI", number, 1, *pose, len(images))
        for camera, image in images:
            yield struct.pack("<iIQ", _CAMERA, camera, image)


def _camera_bytes(model: Reconstruction) -> Iterable[bytes]:
    yield struct.pack("<Q", len(model.detectors))
    for number, detector in enumerate(model.detectors, 1):
        name, values = camera_of(detector)
        yield struct.pack("<iiQQ", number, MODELS[name][0], detector.shape[1], detector.shape[0])
        yield struct.pack(f"<{len(values)}d", *values)


def _image_bytes(model: Reconstruction, poses: Array, seen: list[Array]) -> Iterable[bytes]:
    yield struct.pack("<Q", len(model.names))
    for k, name in enumerate(model.names):
        yield struct.pack("<i7di", k + 1, *poses[k], int(model.camera[k]) + 1)
        yield name.encode() + b"\0"
        rows = np.empty(len(seen[k]), dtype=_SIGHT)
        rows["x"], rows["y"], rows["id"] = seen[k].T
        yield struct.pack("<Q", len(rows)) + rows.tobytes()


def _point_bytes(model: Reconstruction, tracks: list[NDArray[np.intp]]) -> Iterable[bytes]:
    yield struct.pack("<Q", len(model.known))
    for k in model.known:
        yield struct.pack("<Q3d3Bd", k + 1, *model.points[k], 128, 128, 128, _residual(model, k))
        yield struct.pack("<Q", len(tracks[k])) + tracks[k].astype("<i4").tobytes()


@reads("a COLMAP model")
def read_colmap_model(folder: Path) -> Reconstruction:
    """The model in a folder: binary where both forms are there, as COLMAP does.

    Raises
    ------
    FormatError
        Names the file that is missing, damaged, or holds a camera that is not understood.
    """
    paths = colmap_files(folder)
    read = _read_binary if paths[0].suffix == ".bin" else _read_text
    return _model(folder, *read(paths))


def colmap_files(folder: Path) -> tuple[Path, ...]:
    """The three files of the model in a folder; FormatError where one is missing."""
    for suffix in (".bin", ".txt"):
        paths = tuple(folder / f"{name}{suffix}" for name in ("cameras", "images", "points3D"))
        if all(path.is_file() for path in paths):
            return paths
    raise FormatError(
        f"{folder}: no COLMAP model: cameras, images and points3D, each .bin or .txt, are expected"
    )


def _model(
    folder: Path, cameras: dict[int, AreaDetector], images: list[Any], points: list[Any]
) -> Reconstruction:
    """Lists of what the files hold, as one object."""
    if not images:
        raise FormatError(f"{folder}: the model holds no image")
    number = {camera: k for k, camera in enumerate(cameras)}
    lost = [image for image in images if image[2] not in number]
    if lost:
        raise FormatError(
            f"{folder}: image {lost[0][3]!r} is of camera {lost[0][2]}, which cameras does not have"
        )
    images = sorted(images, key=lambda image: image[0])
    points = sorted(points, key=lambda point: point[0])
    ids = np.array([point[0] for point in points], dtype=np.int64)
    poses = np.array([image[1] for image in images], dtype=np.float64)
    camera_from_world = Rotation.from_quat(poses[:, [1, 2, 3, 0]])
    sights = [image[4][np.isin(image[4]["id"], ids)] for image in images]
    seen = np.concatenate(sights)
    return Reconstruction(
        tuple(image[3] for image in images),
        tuple(cameras.values()),
        np.array([number[image[2]] for image in images], dtype=np.intp),
        -camera_from_world.inv().apply(poses[:, 4:]),
        camera_from_world.inv(),
        np.array([point[1] for point in points], dtype=np.float64).reshape(-1, 3),
        np.array([point[2] if point[2] >= 0.0 else np.nan for point in points], dtype=np.float64),
        np.repeat(np.arange(len(images)), [len(s) for s in sights]),
        np.searchsorted(ids, seen["id"]),
        np.column_stack([seen["y"], seen["x"]]) - CORNER,
    )


def _read_text(paths: Sequence[Path]) -> tuple[dict[int, AreaDetector], list[Any], list[Any]]:
    cameras, images, points = {}, [], []
    path = paths[0]
    try:
        for words in _words(path):
            shape = int(words[3]), int(words[2])
            values = [float(word) for word in words[4:]]
            cameras[int(words[0])] = detector_of(path, words[0], words[1], shape, values)
        path = paths[1]
        lines = [line for line in _text_of(path).splitlines() if not line.startswith("#")]
        for head, tail in zip(lines[::2], [*lines[1::2], ""], strict=False):
            words = head.split()
            sights = np.array(tail.split(), dtype=np.float64).reshape(-1, 3)
            rows = np.empty(len(sights), dtype=_SIGHT)
            rows["x"], rows["y"], rows["id"] = sights.T
            pose = [float(word) for word in words[1:8]]
            images.append((int(words[0]), pose, int(words[8]), " ".join(words[9:]), rows))
        path = paths[2]
        for words in _words(path):
            points.append((int(words[0]), [float(word) for word in words[1:4]], float(words[7])))
    except (IndexError, ValueError, OverflowError) as error:
        raise FormatError(f"{path}: not a COLMAP text file ({said_by(error)}); write it anew") from error
    return cameras, images, points


def _text_of(path: Path) -> str:
    return read_text(path, "a COLMAP text file", most=LARGE)


def _words(path: Path) -> Iterable[list[str]]:
    for line in _text_of(path).splitlines():
        if line.strip() and not line.startswith("#"):
            yield line.split()


class _Bytes:
    """A binary file read from front to back."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, "a COLMAP binary file", most=LARGE), 0

    def take(self, form: str) -> tuple[Any, ...]:
        """Next values by a `struct` form."""
        values = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return values

    def word(self) -> str:
        """Next text up to a zero."""
        end = self.data.index(b"\0", self.at)
        text = self.data[self.at : end].decode("utf-8")
        self.at = end + 1
        return text

    def rows(self, kind: np.dtype[Any], count: int) -> NDArray[Any]:
        """Next records."""
        rows = np.frombuffer(self.data, kind, count, self.at)
        self.at += count * kind.itemsize
        return rows


def _read_binary(paths: Sequence[Path]) -> tuple[dict[int, AreaDetector], list[Any], list[Any]]:
    cameras, images, points = {}, [], []
    numbers = {number: name for name, (number, _) in MODELS.items()}
    path = paths[0]
    try:
        file = _Bytes(path)
        for _ in range(file.take("<Q")[0]):
            camera, model, columns, lines = file.take("<iiQQ")
            name = numbers.get(model, f"number {model}")
            count = MODELS.get(name, (0, 0))[1]
            shape = int(lines), int(columns)
            cameras[camera] = detector_of(path, str(camera), name, shape, file.take(f"<{count}d"))
        path = paths[1]
        file = _Bytes(path)
        for _ in range(file.take("<Q")[0]):
            image, *pose, camera = file.take("<i7di")
            images.append((image, pose, camera, file.word(), file.rows(_SIGHT, file.take("<Q")[0])))
        path = paths[2]
        file = _Bytes(path)
        for _ in range(file.take("<Q")[0]):
            point, x, y, z, _r, _g, _b, residual = file.take("<Q3d3Bd")
            file.rows(np.dtype("<i8"), file.take("<Q")[0])
            points.append((point, (x, y, z), residual))
    except (struct.error, ValueError, OverflowError) as error:
        raise FormatError(
            f"{path}: not a COLMAP binary file, or cut short ({said_by(error)}); write it anew"
        ) from error
    return cameras, images, points
