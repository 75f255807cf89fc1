"""Which frames a sequence has, when each was exposed, and which of its files can be used.

Not here: pixels (``frame_files.py``), poses (``poses.py``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.formats.exif import Exif, NoExifTime, read_exif
from sightline.io.formats.instants import seconds_from_epoch
from sightline.io.formats.tables import check_images, check_times, header_of
from sightline.io.formats.xmp import Xmp, read_xmp
from sightline.io.sequence.frame_files import Probe, probe, reason_of
from sightline.io.sequence.schema import SequenceFile
from sightline.io.sequence.times import first_instant, read_timed

Array = NDArray[np.float64]

FRAMES = ("frame", "t", "image")
#: What a folder of frames may hold; further files in it are not looked at.
SUFFIXES = (".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2")
_NAMED = "`frames` names a folder of photographs, or a table frame,t,image"
#: s by which frames may lie beside their event marks: EXIF has whole seconds, clocks drift.
_CLOCK = 2.0
#: s, and times the median step between frames, beyond which a pause may be one between two flights.
PAUSE, PAUSE_STEPS = 60.0, 50.0


@dataclass(frozen=True, eq=False)
class FrameList:
    """Frames in the order of their times.

    Attributes
    ----------
    path : Path
        Table or folder they are from.
    names : tuple of str
    t : (M,)
        s from `epoch`.
    files : tuple of Path
    epoch : str or None
    exif : tuple of Exif or None
        Of each photograph; empty for a table.
    xmp : tuple of Xmp or None
    warnings : tuple of str
    broken : tuple of str
        Why what each photograph says of itself cannot be read, "" where it can; empty for a table.
    marks : Path or None
        Event marks that the times are of, where there are such.
    """

    path: Path
    names: tuple[str, ...]
    t: Array
    files: tuple[Path, ...]
    epoch: str | None
    exif: tuple[Exif | None, ...] = ()
    xmp: tuple[Xmp | None, ...] = ()
    warnings: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    marks: Path | None = None


def read_frames(file: SequenceFile, files: InputFolder) -> FrameList:
    """Frames of a SEQUENCE.toml: of its table, or of the photographs in its folder."""
    path = files.path(file.frames)
    frames = (
        _of_folder(path, file.sequence.epoch)
        if path.is_dir()
        else _of_table(files(file.frames, advice=_NAMED), file, files)
    )
    return frames if len(frames.t) < 3 else _with_pauses(frames)


def with_events(frames: FrameList, file: SequenceFile, files: InputFolder) -> FrameList:
    """The frames at the times of their event marks; as they are where there are none.

    Raises
    ------
    FormatError
        If marks and frames are not as many, or the frames' own times do not go with them.
    """
    if file.events is None:
        return frames
    path = files(file.events)
    named = ("frame",) if "frame" in header_of(path) else ()
    table = read_timed(path, (*named, "t"), frames.epoch, text=named)
    t = np.asarray(table["t"], dtype=np.float64)
    if named:
        marks = tuple(str(word) for word in table["frame"])
        refuse_repeated(path, marks)
        row = {name: k for k, name in enumerate(marks)}
        at = [
            row.get(name, row.get(image.name, -1))
            for name, image in zip(frames.names, frames.files, strict=True)
        ]
        if -1 in at:
            raise FormatError(
                f"{path}: frame {frames.names[at.index(-1)]!r} has no row, and {at.count(-1)} frames in all; "
                "every frame has its mark: add them, or leave the frames out"
            )
        t = t[at]
    elif len(t) != len(frames.t):
        raise FormatError(
            f"{path}: holds {len(t)} event marks for {len(frames.t)} frames; one for each in their order is "
            "expected: remove marks without a photograph, or give a column `frame` with the name of each"
        )
    check_times(path, t)
    _check_marks(path, frames, t)
    return replace(frames, t=t, marks=path)


def _check_marks(path: Path, frames: FrameList, t: Array) -> None:
    """FormatError where the frames' own times do not go with the marks but for a constant."""
    if len(t) < 2:
        return
    late = frames.t - t
    late = np.abs(late - np.median(late))
    k = int(late.argmax())
    if late[k] > _CLOCK:
        raise FormatError(
            f"{path}: the mark of {frames.names[k]} is {late[k]:.3g} s beside its time in "
            f"{'its EXIF' if frames.exif else frames.path.name}, the usual difference of the clocks "
            f"taken off; {_CLOCK:g} s are allowed, as EXIF counts seconds: do marks and frames go one by "
            "one? Give a column `frame` with the name of each"
        )


def _of_table(path: Path, file: SequenceFile, files: InputFolder) -> FrameList:
    epoch = file.sequence.epoch or first_instant(path)
    table = read_timed(path, FRAMES, epoch, text=("frame", "image"))
    names = tuple(str(word) for word in table["frame"])
    refuse_repeated(path, names)
    t = np.asarray(table["t"], dtype=np.float64)
    check_times(path, t)
    images = [str(word) for word in table["image"]]
    check_images(path, images)
    return FrameList(path, names, t, tuple(files.path(name) for name in images), epoch)


def refuse_repeated(path: Path, names: Sequence[str]) -> None:
    """FormatError where a frame has two rows, or no name."""
    if "" in names:
        raise FormatError(f"{path}: row {list(names).index('') + 1} has no frame; every row names its frame")
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise FormatError(f"{path}: frame {name!r} has {count} rows; a frame has one; remove the others")


def _of_folder(folder: Path, epoch: str | None) -> FrameList:
    """Photographs of a folder, by the times in their EXIF."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    if not paths:
        raise FormatError(f"{folder}: holds no images ({', '.join(SUFFIXES)}); check `frames`")
    exif, xmp, broken = zip(*(read_photograph_tags(path) for path in paths), strict=True)
    known = [k for k, tags in enumerate(exif) if tags is not None]
    if not known:
        said = next((f" ({p.name}: {why})" for p, why in zip(paths, broken, strict=True) if why), "")
        raise FormatError(
            f"{folder}: no image has a time in its EXIF{said}; give frames = a table frame,t,image in place "
            "of the folder"
        )
    _refuse_rigs(folder, xmp)
    start = epoch or min(exif[k].time for k in known)
    t = np.array([seconds_from_epoch(exif[k].time, start, str(paths[k])) for k in known])
    warnings = []
    lost = [p.name for p, tags, why in zip(paths, exif, broken, strict=True) if tags is None and not why]
    if lost:
        warnings.append(
            f"{len(lost)} images have no time in their EXIF (the first is {lost[0]}): taken as between their "
            "neighbours by name"
        )
    t = np.interp(np.arange(len(paths)), known, t)
    order = np.argsort(t, kind="stable")
    t, spread = _spread(t[order])
    if spread:
        warnings.append(f"{spread} images share their EXIF second with others: spread evenly over it")
    names = tuple(paths[k].name for k in order)
    chosen = tuple(paths[k] for k in order)
    tags = tuple(exif[k] for k in order), tuple(xmp[k] for k in order)
    why = tuple(broken[k] for k in order)
    return FrameList(folder, names, t, chosen, start, *tags, tuple(warnings), why)


def read_photograph_tags(path: Path) -> tuple[Exif | None, Xmp | None, str]:
    """EXIF and XMP, None where it has none, and why they cannot be read."""
    try:
        xmp = read_xmp(path)
        return read_exif(path), xmp, ""
    except NoExifTime:
        return None, xmp, ""
    except FormatError as error:
        return None, None, reason_of(path, error)


def _refuse_rigs(folder: Path, xmp: Sequence[Xmp | None]) -> None:
    cameras = sorted({tags.rig_camera for tags in xmp if tags is not None and tags.rig_camera is not None})
    if len(cameras) > 1:
        raise FormatError(
            f"{folder}: photographs of {len(cameras)} cameras of a rig (RigCameraIndex "
            f"{', '.join(map(str, cameras))}); a sequence of one [camera] is expected: write a "
            "[[camera]] for each, or leave [camera] out"
        )


def _spread(t: Array) -> tuple[Array, int]:
    """Times that increase: those that are the same are spread evenly over what is left to the next second."""
    seconds, place, counts = np.unique(t, return_inverse=True, return_counts=True)
    if (counts == 1).all():
        return t, 0
    gap = np.minimum(np.append(np.diff(seconds), 1.0), 1.0)
    number = np.arange(len(t)) - (np.cumsum(counts) - counts)[place]
    return t + number * (gap / counts)[place], int(counts[counts > 1].sum())


def _with_pauses(frames: FrameList) -> FrameList:
    """Warn of a pause as between two flights."""
    step = np.diff(frames.t)
    long = np.flatnonzero((step > PAUSE) & (step > PAUSE_STEPS * np.median(step)))
    if not len(long):
        return frames
    k = int(long[0])
    words = (
        f"{len(long)} pauses, the first of {step[k]:.4g} s between frames {frames.names[k]} and "
        f"{frames.names[k + 1]}: are these {len(long) + 1} flights? Give each its own SEQUENCE.toml if so"
    )
    return FrameList(**{**vars(frames), "warnings": (*frames.warnings, words)})


def probe_frames(frames: FrameList) -> list[Probe]:
    """A look into every file."""
    return [probe(path) for path in frames.files]


def shape_of(probes: Sequence[Probe]) -> tuple[int, int] | None:
    """Shape of most frames; None where none can be read."""
    shapes = Counter(p.shape for p in probes if p.shape is not None)
    return shapes.most_common(1)[0][0] if shapes else None


def excluded(
    frames: FrameList, probes: Sequence[Probe], shape: tuple[int, int], channels: int
) -> tuple[str, ...]:
    """Why each frame cannot be used, "" where it can.

    Parameters
    ----------
    frames : FrameList
    probes : sequence of Probe
    shape : (lines, columns)
        Of the camera.
    channels : int
        Bands that the images need to have; 0: any number.

    Raises
    ------
    FormatError
        If no frame is left.
    """
    broken = frames.broken or ("",) * len(probes)
    reasons = tuple(why or _reason(p, shape, channels) for why, p in zip(broken, probes, strict=True))
    if all(reasons):
        common, count = Counter(reasons).most_common(1)[0]
        turned = all(p.shape == shape[::-1] for p in probes) and shape[0] != shape[1]
        raise FormatError(
            f"{frames.path}: none of {len(reasons)} frames can be used: {count} of them: {common}; "
            + (
                "are lines and columns exchanged in [camera] shape?"
                if turned
                else "check the files and [camera]"
            )
        )
    return reasons


def _reason(found: Probe, shape: tuple[int, int], channels: int) -> str:
    if found.shape is not None and found.shape != shape:
        return f"{found.shape[0]} lines x {found.shape[1]} columns in place of {shape[0]} x {shape[1]}"
    if not found.reason and channels and found.bands != channels:
        return f"{found.bands} bands in place of the {channels} of channel_nm"
    return found.reason
