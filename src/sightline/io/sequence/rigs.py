"""Cameras of a rig: which image is of which capture and camera, and what is known of how each sits.

By a table capture,camera,t,image, by patterns of file names, or by tags of the files.

Not here: keys (``schema.py``), tags (``io/formats/xmp.py``), what offsets are
(``photogrammetry/flight/rig.py``).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.instrument import AreaDetector
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.formats.exif import Exif
from sightline.io.formats.instants import seconds_from_epoch
from sightline.io.formats.tables import check_times, header_of
from sightline.io.formats.xmp import Xmp
from sightline.io.sequence.frame_files import FrameFile, probe
from sightline.io.sequence.frames import SUFFIXES, FrameList, read_photograph_tags
from sightline.io.sequence.positions import place_of
from sightline.io.sequence.schema import (
    RIG_ANGLE_SIGMA,
    RIG_PLACE_SIGMA,
    RigCameraSection,
    SequenceCamera,
    SequenceFile,
)
from sightline.io.sequence.times import first_instant, read_timed
from sightline.photogrammetry.flight.rig import RigCamera

Array = NDArray[np.float64]

COLUMNS = ("capture", "camera", "t", "image")
#: Files at the head of a folder that show whether it holds images of a rig.
_HEAD = 16
#: rad; 1-sigma of orientations by tags of the maker, as cameras shift in use.
_TAG_SIGMA = 0.0087
#: m, and rad: by what positions and angles that cameras of one capture give may differ for one body.
_SAME_PLACE, _SAME_ANGLE = 1.0, np.radians(1.0)
#: m; radius of the Earth, for lengths of some metres.
_EARTH = 6.37e6
NO_IMAGE = "no image of this camera in this capture"


@dataclass(frozen=True, eq=False)
class RigImages:
    """Images of a rig, sorted by camera and capture.

    Attributes
    ----------
    sections : tuple of RigCameraSection
        C cameras; made of tags where the file lists none.
    captures : FrameList
        M; files and tags are those of the first camera, tags of another where it has no image.
    files : tuple of tuple of Path or None
        C x M.
    tags : tuple of tuple of (Exif or None, Xmp or None)
        C x M.
    """

    sections: tuple[RigCameraSection, ...]
    captures: FrameList
    files: tuple[tuple[Path | None, ...], ...]
    tags: tuple[tuple[tuple[Exif | None, Xmp | None], ...], ...]

    def frames_of(self, camera: int) -> FrameList:
        """The captures as frames of one camera."""
        here = [path or self.captures.path / NO_IMAGE for path in self.files[camera]]
        broken = tuple("" if path else NO_IMAGE for path in self.files[camera])
        exif, xmp = zip(*self.tags[camera], strict=True)
        return replace(self.captures, files=tuple(here), exif=exif, xmp=xmp, broken=broken)


@dataclass(frozen=True, eq=False)
class _Image:
    """One image of a rig."""

    capture: str
    camera: str
    path: Path
    t: float | None = None
    exif: Exif | None = None
    xmp: Xmp | None = None


def read_rig(file: SequenceFile, files: InputFolder) -> RigImages | None:
    """Images of a rig; None where `frames` are those of one camera.

    Raises
    ------
    FormatError
        If images cannot be assigned, or cameras did not expose together.
    """
    path = files.path(file.frames)
    listed = tuple(file.camera) if isinstance(file.camera, list) else ()
    if not path.is_dir():
        if not listed:
            return None
        return _of_table(file, files(file.frames), files, listed)
    if any(camera.images for camera in listed):
        return _by_names(path, file, listed)
    if not listed and not _holds_rig(path):
        return None
    return _by_tags(path, file, listed)


def _holds_rig(folder: Path) -> bool:
    """Whether the first images of a folder are of several cameras."""
    cameras = {_camera_tag(read_photograph_tags(path)[1]) for path in _images_in(folder)[:_HEAD]}
    return len(cameras - {None}) > 1


def _images_in(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))


def _camera_tag(xmp: Xmp | None) -> int | None:
    return None if xmp is None else xmp.rig_camera


def _of_table(
    file: SequenceFile, path: Path, files: InputFolder, listed: tuple[RigCameraSection, ...]
) -> RigImages:
    """Images by a table."""
    header = header_of(path)
    if "capture" not in header or "camera" not in header:
        raise FormatError(
            f"{path}: the header is {','.join(header)!r}; of several [[camera]] {','.join(COLUMNS)!r} is "
            "expected"
        )
    epoch = file.sequence.epoch or first_instant(path)
    table = read_timed(path, COLUMNS, epoch, text=("capture", "camera", "image"))
    names = [camera.name for camera in listed]
    rows = []
    for capture, camera, t, image in zip(*(table[key] for key in COLUMNS), strict=True):
        if camera not in names:
            raise FormatError(
                f"{path}: camera {camera!r} is none of the [[camera]]: {', '.join(names)}; correct the name"
            )
        rows.append(_Image(str(capture), str(camera), files.path(str(image)), float(t)))
    for name in names:
        if not any(row.camera == name for row in rows):
            raise FormatError(
                f"{path}: camera {name!r} is in no row of {path.name}; add rows of its images, or leave its "
                "[[camera]] out"
            )
    return _sorted(path, rows, listed, epoch)


def _by_names(folder: Path, file: SequenceFile, listed: tuple[RigCameraSection, ...]) -> RigImages:
    """Images by patterns of their names."""
    rows = []
    for camera in listed:
        if camera.images is None or camera.images.count("*") != 1:
            raise FormatError(
                f"{folder}: images of camera {camera.name!r}: {camera.images!r}; a pattern with one * is "
                'expected of every [[camera]], such as "IMG_*_1.tif"; the * stands for the capture'
            )
        before, after = camera.images.split("*")
        pattern = re.compile(re.escape(Path(before + "x").name[:-1]) + r"(.+)" + re.escape(after))
        place = (folder / (before + "x")).parent
        if not place.is_dir():
            raise FormatError(f"{place}: no such folder; check images of camera {camera.name!r}")
        own = [(pattern.fullmatch(path.name), path) for path in sorted(place.iterdir())]
        found = [(match[1], path) for match, path in own if match is not None]
        if not found:
            raise FormatError(
                f"{folder}: no file is called {camera.images!r} (camera {camera.name!r}); check the pattern"
            )
        for capture, path in found:
            exif, xmp, _ = read_photograph_tags(path)
            rows.append(_Image(capture, camera.name, path, None, exif, xmp))
    return _sorted(folder, rows, listed, file.sequence.epoch)


def _by_tags(folder: Path, file: SequenceFile, listed: tuple[RigCameraSection, ...]) -> RigImages:
    """Images by the tags of a rig."""
    tagged = [(path, *read_photograph_tags(path)) for path in _images_in(folder)]
    numbers = sorted(
        {xmp.rig_camera for _, _, xmp, _ in tagged if xmp is not None and xmp.rig_camera is not None}
    )
    if len(numbers) < 2:
        raise FormatError(
            f"{folder}: the images' tags name {len(numbers)} cameras (RigCameraIndex), {len(listed)} "
            "[[camera]] are given; give images = PATTERN for each, or a table capture,camera,t,image"
        )
    if listed and len(listed) != len(numbers):
        raise FormatError(
            f"{folder}: the images' tags name {len(numbers)} cameras (RigCameraIndex "
            f"{', '.join(map(str, numbers))}), {len(listed)} [[camera]] are given; one for each is expected, "
            "in that order, or images = PATTERN in each"
        )
    names = [camera.name for camera in listed] or _names_by_tags(
        [next(x for _, _, x, _ in tagged if x is not None and x.rig_camera == number) for number in numbers]
    )
    sections = listed or tuple(_section(file, name) for name in names)
    rows = []
    for path, exif, xmp, _ in tagged:
        if xmp is None or xmp.rig_camera is None:
            continue
        capture = xmp.capture or ("" if exif is None else exif.time)
        if not capture:
            raise FormatError(
                f"{path}: neither CaptureId nor a time says of which capture it is; give images = PATTERN in "
                "each [[camera]]"
            )
        rows.append(_Image(capture, names[numbers.index(xmp.rig_camera)], path, None, exif, xmp))
    return _sorted(folder, rows, sections, file.sequence.epoch, by_file=True)


def _names_by_tags(xmp: Sequence[Xmp]) -> list[str]:
    """Names of cameras: of their bands, numbered where those are alike or missing."""
    names = [(x.band or f"camera {x.rig_camera}").replace(",", "-") for x in xmp]
    twice = {name for name, count in Counter(names).items() if count > 1}
    return [f"{name} {x.rig_camera}" if name in twice else name for name, x in zip(names, xmp, strict=True)]


def _section(file: SequenceFile, name: str) -> RigCameraSection:
    """A camera that the tags name, sitting as ``[camera]`` says."""
    camera = file.camera
    assert isinstance(camera, SequenceCamera)
    more = camera.model_fields_set - {"mount", "body_from_camera"}
    if more:
        raise FormatError(
            f"the photographs are of several cameras of a rig, [camera] gives {', '.join(sorted(more))} of "
            "one: write a [[camera]] for each, or leave that out"
        )
    return RigCameraSection.model_validate(
        {"name": name, **{key: getattr(camera, key) for key in camera.model_fields_set}}
    )


def _sorted(
    path: Path,
    rows: list[_Image],
    sections: tuple[RigCameraSection, ...],
    epoch: str | None,
    *,
    by_file: bool = False,
) -> RigImages:
    """Images by camera and capture, captures in the order of their times."""
    cells: dict[tuple[str, str], _Image] = {}
    for row in rows:
        if (row.capture, row.camera) in cells:
            raise FormatError(
                f"{path}: capture {row.capture!r} has two images of camera {row.camera!r}: "
                f"{cells[row.capture, row.camera].path.name} and {row.path.name}; give each capture its own"
            )
        cells[row.capture, row.camera] = row
    names = list(dict.fromkeys(row.capture for row in rows))
    every = {name: [cells.get((name, section.name)) for section in sections] for name in names}
    exifs = [row.exif for row in rows if row.exif is not None]
    start = epoch or (min(e.time for e in exifs) if exifs else None)
    times = {name: _time_of(path, name, [r for r in every[name] if r is not None], start) for name in names}
    order = sorted(names, key=lambda name: times[name])
    if len(set(times.values())) < len(times):
        spread = np.array([times[name] for name in order])
        same = np.concatenate([[0.0], np.where(np.diff(spread) > 0.0, 0.0, 1.0)])
        if same.any():
            raise FormatError(
                f"{path}: captures {order[int(same.argmax()) - 1]!r} and {order[int(same.argmax())]!r} have "
                "the same time; give a table capture,camera,t,image with the time of each"
            )
    t = np.array([times[name] for name in order])
    check_times(path, t)
    first = [next(r for r in every[name] if r is not None) for name in order]
    labels = tuple(r.path.name if by_file else name for r, name in zip(first, order, strict=True))
    captures = FrameList(
        path, labels, t, tuple(r.path for r in first), start if exifs or epoch else epoch,
        tuple(r.exif for r in first) if exifs else (), tuple(r.xmp for r in first) if exifs else (),
    )  # fmt: skip
    table = [[every[name][c] for name in order] for c in range(len(sections))]
    return RigImages(
        sections,
        captures,
        tuple(tuple(None if r is None else r.path for r in row) for row in table),
        tuple(tuple((None, None) if r is None else (r.exif, r.xmp) for r in row) for row in table),
    )


def _time_of(path: Path, capture: str, rows: Sequence[_Image], start: str | None) -> float:
    """s; of a capture, that of its first image that has one."""
    for row in rows:
        if row.t is not None:
            return row.t
    for row in rows:
        if row.exif is not None and start is not None:
            return seconds_from_epoch(row.exif.time, start, str(row.path))
    raise FormatError(
        f"{path}: no image of capture {capture!r} has a time in its EXIF; give a table capture,camera,t,image"
    )


def rig_camera(
    images: RigImages,
    camera: int,
    detector: AreaDetector,
    focal_sigma_px: float,
    model: tuple[Sequence[str], Rotation] | None = None,
) -> RigCamera:
    """One camera of a rig as an object.

    Parameters
    ----------
    images : RigImages
    camera : int
    detector : AreaDetector
    focal_sigma_px : float
        px; 1-sigma of its focal length.
    model : (sequence of str, Rotation), optional
        Names of images and world_from_camera of each, by another program.
    """
    section, frames = images.sections[camera], images.frames_of(camera)
    channels = len(section.channel_nm or ())
    reasons, bands = [], set()
    for path, why in zip(frames.files, frames.broken, strict=True):
        found = None if why else probe(path)
        reason = why if found is None else found.reason
        if found is not None and not reason and found.shape != detector.shape:
            reason = f"{found.shape} px in place of {detector.shape}"
        if found is not None and not reason:
            bands.add(found.bands)
            if channels and found.bands != channels:
                reason = f"{found.bands} bands in place of the {channels} of channel_nm"
        reasons.append(reason)
    kind: int | str = "luminance" if bands - {1} else 1
    orientation, sigma, prior = _orientation(images, camera, detector, model)
    xmp = next((x for _, x in images.tags[camera] if x is not None), None)
    wavelength = section.wavelength_nm or (None if xmp is None else xmp.wavelength_nm)
    relative = focal_sigma_px / detector.focal_length_px
    return RigCamera(
        section.name,
        detector,
        section.mounting,
        tuple(FrameFile(path, detector.shape, kind) for path in frames.files),
        tuple(reasons),
        np.nan if wavelength is None or channels else wavelength,
        orientation,
        0.0 if camera == 0 else sigma,
        np.array(section.position_offset),
        np.full(3, 0.0 if camera == 0 else section.position_offset_sigma),
        0.0 if camera == 0 else (1.0 if np.isinf(relative) else relative),
        prior,
        tuple(section.channel_nm or ()),
        tuple(
            tuple(FrameFile(path, detector.shape, k) for path in frames.files) for k in range(1, channels + 1)
        ),
    )


def _orientation(
    images: RigImages,
    camera: int,
    detector: AreaDetector,
    model: tuple[Sequence[str], Rotation] | None,
) -> tuple[Rotation, float, str]:
    """How a camera is turned against the first, its sigma, and who says so."""
    section = images.sections[camera]
    given = section.orientation_offset_sigma
    if section.orientation_offset is not None:
        sigma = RIG_ANGLE_SIGMA if given is None else given
        return Rotation.from_rotvec(section.orientation_offset), sigma, "given"
    mount = images.sections[0].mounting
    by_model = None if model is None or camera == 0 else _turn_in_model(images, camera, *model)
    if by_model is not None:
        turn = mount * by_model * section.mounting.inv()
        return turn, _TAG_SIGMA if given is None else given, "given by the model"
    own, first = (next((x for _, x in images.tags[c] if x is not None), None) for c in (camera, 0))
    here, there = (None if x is None else x.rig_from_camera() for x in (own, first))
    if here is not None and there is not None:
        turn = there.inv() * here
        return (
            mount * turn * section.mounting.inv(),
            _TAG_SIGMA if given is None else given,
            "given by RigRelatives",
        )
    off = None if own is None else own.optical_centre_px
    if off is not None:
        zero = np.zeros(2) if first is None or first.optical_centre_px is None else first.optical_centre_px
        line, column = (off - zero) / detector.focal_length_px
        # the sign is the maker's affair: its own size as sigma holds for either
        sigma = max(_TAG_SIGMA, float(np.hypot(line, column))) if given is None else given
        turn = Rotation.from_rotvec([line, -column, 0.0])
        mount = section.mounting
        return mount * turn * mount.inv(), sigma, "given by the optical centre"
    return Rotation.identity(), RIG_ANGLE_SIGMA if given is None else given, "assumed, as none is given"


def _turn_in_model(
    images: RigImages, camera: int, names: Sequence[str], world_from_camera: Rotation
) -> Rotation | None:
    """first_camera_from_camera by the poses of a model, mean of all captures; None where none has both."""
    row = {name.replace("\\", "/").rsplit("/", 1)[-1]: k for k, name in enumerate(names)}
    pairs = [
        (row[one.name], row[other.name])
        for one, other in zip(images.files[0], images.files[camera], strict=True)
        if one is not None and other is not None and one.name in row and other.name in row
    ]
    if not pairs:
        return None
    first, here = (world_from_camera[[pair[k] for pair in pairs]] for k in (0, 1))
    return (first.inv() * here).mean()


def lost_images(images: RigImages, cameras: Sequence[RigCamera]) -> tuple[str, ...]:
    """How many images that there should be cannot be used, and the first; captures without the first camera.

    Parameters
    ----------
    images : RigImages
    cameras : sequence of RigCamera
        Of those images, with why each cannot be used.

    Raises
    ------
    FormatError
        If no image of a camera can be used.
    """
    words = []
    for c, camera in enumerate(cameras):
        if not camera.usable.any():
            capture = next(k for k, path in enumerate(images.files[c]) if path is not None)
            raise FormatError(
                f"{images.captures.path}: no image of camera {camera.name!r} can be used; the first, "
                f"{images.files[c][capture]}: {camera.excluded[capture]}; correct them, or leave its "
                "[[camera]] out"
            )
    given = sum(path is not None for row in images.files for path in row)
    lost = [
        (capture, c, reason)
        for c, camera in enumerate(cameras)
        for capture, reason in enumerate(camera.excluded)
        if reason and images.files[c][capture] is not None
    ]
    if lost:
        capture, c, reason = min(lost)
        words.append(
            f"{len(lost)} of {given} images of the rig cannot be used; the first, "
            f"{images.files[c][capture]} (camera {cameras[c].name}): {reason}"
        )
    without = [k for k, path in enumerate(images.files[0]) if path is None]
    if without:
        words.append(
            f"{len(without)} of {len(images.captures.names)} captures have no image of the first camera, "
            f"{cameras[0].name}; the first is {images.captures.names[without[0]]}"
        )
    return tuple(words)


def refuse_other_shapes(toml: Path, images: RigImages) -> None:
    """FormatError where images of a camera can be read, and none has the shape that is given for it."""
    for c, section in enumerate(images.sections):
        if section.shape is None:
            continue
        first = None
        for path in images.files[c]:
            shape = None if path is None else probe(path).shape
            if shape == section.shape:
                break
            first = first or (None if shape is None else (path, shape))
        else:
            if first is not None:
                raise FormatError(
                    f"{toml}: camera[{c + 1}].shape = {list(section.shape)} of {section.name!r} is that of "
                    f"none of its images: the first, {first[0]}, is {first[1][0]} x {first[1][1]}; give "
                    "lines and columns of its images, or leave shape out"
                )


def refuse_asynchronous(images: RigImages) -> None:
    """FormatError where places or angles that cameras give of themselves are not those of one body.

    Photographs of one capture have one place and attitude. Where the median of what places differ by is
    beyond what a lever arm can be, the cameras fired one after the other.
    """
    first = images.sections[0].name
    for c in range(1, len(images.sections)):
        moved, turned = [], []
        for (exif, xmp), (other, tags) in zip(images.tags[0], images.tags[c], strict=True):
            if exif is not None and other is not None:
                step = _metres(exif, other)
                if step is not None:
                    moved.append(step)
            if (
                xmp is not None
                and tags is not None
                and xmp.body_deg is not None
                and tags.body_deg is not None
            ):
                off = np.abs((tags.body_deg - xmp.body_deg + 180.0) % 360.0 - 180.0)
                turned.append(off[1:])
        place = np.array(moved)
        if not len(place) or float(np.median(place)) <= _SAME_PLACE:
            continue
        words = f"their GPS differ by {place.min():.2g} to {place.max():.2g} m" + _speed_words(images, place)
        if turned and float(np.max(turned)) > np.degrees(_SAME_ANGLE):
            words += f", their own roll and pitch by up to {np.max(turned):.2g} degrees"
        raise FormatError(
            f"{images.captures.path}: cameras {first} and {images.sections[c].name} do not expose together: "
            f"of one capture {words}; a rig has one pose per capture: georeference each camera by itself, "
            "as a sequence of one [camera]"
        )


def _metres(one: Exif, other: Exif) -> float | None:
    """m on the ground between the places of two photographs."""
    (lon, lat, _), (other_lon, other_lat, _) = place_of(one, None)[0], place_of(other, None)[0]
    north = np.radians(other_lat - lat) * _EARTH
    east = np.radians(other_lon - lon) * _EARTH * np.cos(np.radians(lat))
    return float(np.hypot(north, east)) if np.isfinite(north + east) else None


def _speed_words(images: RigImages, apart: Array) -> str:
    """The time between exposures that places apart mean at the speed over ground."""
    steps, t = [], images.captures.t
    own = [exif for exif, _ in images.tags[0]]
    for k in range(1, len(own)):
        before, after = own[k - 1], own[k]
        far = None if before is None or after is None else _metres(before, after)
        if far is not None and t[k] > t[k - 1]:
            steps.append(far / (t[k] - t[k - 1]))
    if not steps or not float(np.median(steps)) > 0.0:
        return ""
    seconds = apart / float(np.median(steps))
    return f" ({seconds.min():.2g} to {seconds.max():.2g} s at {np.median(steps):.3g} m/s)"


__all__ = [
    "NO_IMAGE",
    "RIG_PLACE_SIGMA",
    "RigImages",
    "lost_images",
    "read_rig",
    "refuse_asynchronous",
    "refuse_other_shapes",
    "rig_camera",
]
