"""A SEQUENCE.toml as a SequenceProblem.

Not here: keys and allowed values (``schema.py``), frames (``frames.py``), rough poses
(``poses.py``), control points (``control.py``).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, GeometryError
from sightline.geometry.checks import read_only
from sightline.geometry.earth import from_geodetic, to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.surface import Dem, Surface
from sightline.imaging.rasters import open_raster
from sightline.io.acquisition.acquired import InputFolder, input_files, sha256
from sightline.io.acquisition.ground import exchanged_words, raster_corners, surface_of
from sightline.io.acquisition.schema import WorldSection
from sightline.io.camera_schema import refuse_folding, wide_words
from sightline.io.config import read_toml, validate
from sightline.io.formats.envi import read_envi_wavelengths
from sightline.io.formats.gps_places import exchanged
from sightline.io.sequence.control import control_of, placed_by_control
from sightline.io.sequence.frame_files import FrameFile, Probe
from sightline.io.sequence.frames import (
    FrameList,
    excluded,
    probe_frames,
    read_frames,
    shape_of,
    with_events,
)
from sightline.io.sequence.matched_rows import is_local, radii_of
from sightline.io.sequence.models import model_attitudes
from sightline.io.sequence.poses import check_places, starting_poses
from sightline.io.sequence.positions import place_of
from sightline.io.sequence.rigs import (
    RigImages,
    lost_images,
    read_rig,
    refuse_asynchronous,
    refuse_other_shapes,
    rig_camera,
)
from sightline.io.sequence.schema import LEAST_NM, CubeSection, SequenceCamera, SequenceFile, WavelengthRange
from sightline.io.whereabouts import level_axes_at, span_doubts
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.flight.outlook import unit_doubts
from sightline.photogrammetry.flight.problem import SequenceProblem, seen_ground
from sightline.photogrammetry.flight.rig import RigCamera
from sightline.photogrammetry.sightings import Images
from sightline.result import set_source

Array = NDArray[np.float64]

#: What is said of a focal length that is known badly and kept all the same.
_NOT_REFINED = (
    "what that moves poses by, heights above ground first of all, is not in their sigmas; [camera] "
    'focal_length_sigma_px, or focal_length = "estimate", has it found with the poses'
)
#: Relative 1-sigma of a focal length that EXIF gives for film of 36 mm.
_FILM_SIGMA = 0.1
#: mm; diagonal of such film.
_FILM_DIAGONAL = float(np.hypot(36.0, 24.0))
#: Share of the frames whose middle may look beside the ground before a warning.
_BESIDE_SHARE = 0.02


#: nm; middles of what the bands of a colour photograph see: red, green, blue.
_RGB_NM = (650.0, 550.0, 470.0)


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """A SEQUENCE.toml with what only its files and its page need.

    Attributes
    ----------
    path : Path
    name : str
        Title of the report.
    problem : SequenceProblem
    world : WorldSection
        Axes of the tables of the file, and of ``poses.csv``.
    cube : CubeSection
        Which maps are wanted.
    files : tuple of Path
        Image of each frame.
    inputs : tuple of Path
        Every other file that was read.
    doubts : tuple of str
        What was given and is hardly meant; the problem's warnings have it too.
    rig_files : tuple of tuple of Path or None
        Images of each camera of a rig, one per capture; empty where there is one camera.
    """

    path: Path
    name: str
    problem: SequenceProblem
    world: WorldSection
    cube: CubeSection
    files: tuple[Path, ...] = field(repr=False)
    inputs: tuple[Path, ...] = field(repr=False)
    doubts: tuple[str, ...] = ()
    rig_files: tuple[tuple[Path | None, ...], ...] = field(default=(), repr=False)

    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of every input file by its name, and of all images together as ``frames``."""
        images = hashlib.sha256()
        for path in [p for row in self.rig_files for p in row if p is not None] or self.files:
            images.update((sha256(path) if path.is_file() else "none").encode())
        return {path.name: sha256(path) for path in self.inputs} | {"frames": images.hexdigest()}


def load_sequence(path: str | Path) -> SequenceProblem:
    """The problem of a SEQUENCE.toml.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    SequenceProblem
        Frames that cannot be used are in it, each with the reason.

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed; also for the tables it names, and where no frame is left.
    GeometryError
        If no frame looks at the ground.
    """
    return read_sequence(Path(path)).problem


def read_sequence(path: Path) -> FrameSequence:
    """Everything a SEQUENCE.toml says; errors as of `load_sequence`."""
    file = validate(SequenceFile, read_toml(path), path)
    with input_files(path, file) as files:
        sequence = _sequence(path, file, files)
    set_source(sequence.problem, sequence)
    return sequence


def _sequence(path: Path, file: SequenceFile, files: InputFolder) -> FrameSequence:
    """The file with everything that it names."""
    camera, rig = file.first_camera, read_rig(file, files)
    if rig is not None:
        refuse_asynchronous(rig)
        refuse_other_shapes(path, rig)
        camera = rig.sections[0].as_camera()
    frames = with_events(read_frames(file, files) if rig is None else rig.frames_of(0), file, files)
    mount = camera.mounting
    start = starting_poses(file, files, frames, mount)
    probes = probe_frames(frames)
    shape = camera.shape or shape_of(probes)
    if shape is None:
        raise FormatError(f"{frames.path}: no frame can be read: {probes[0].reason}; check the files")
    channel_nm = tuple(camera.channel_nm or ())
    if rig is None and camera.wavelength_nm is None and camera.mosaic_nm is None and not channel_nm:
        channel_nm = _usual_channels(frames, probes)
    channels = len(channel_nm)
    reasons = excluded(frames, probes, shape, len(camera.channel_nm or ()))
    key = "camera" if rig is None else "camera[1]"
    detector, focal_sigma, lens_words = sequence_detector(camera, files, frames, shape, key)
    _check_mosaic(camera, shape, path)
    _check_readout(camera, frames, path)
    bands = {p.bands for p, reason in zip(probes, reasons, strict=True) if not reason}
    control, tracks = control_of(file, files, frames, shape)
    if rig is None or len(frames.names) > 1:  # of one capture the offsets are sought, no path
        check_places(path, start.known, control, file.surface.height_sigma)
    images = start.images
    if control is not None and tracks is not None and not np.isfinite(start.known.position).any():
        images = placed_by_control(images, control, tracks, detector, mount)
    surface, ground_words = _ground(file, files, images, detector, mount)
    cameras = () if rig is None else _rig_cameras(rig, files, detector, model_attitudes(file, files))
    problem = SequenceProblem(
        frames=frames.names,
        t=frames.t,
        sources=tuple(FrameFile(p, shape, "luminance" if bands != {1} else 1) for p in frames.files),
        detector=detector,
        mount=mount,
        images=images,
        known=start.known,
        surface=surface,
        height_sigma=file.surface.height_sigma,
        readout_time=camera.readout_time,
        readout_sigma=camera.readout_time_sigma,
        overlap=file.subset.overlap,
        excluded=reasons,
        mosaic_nm=None if camera.mosaic_nm is None else read_only(np.array(camera.mosaic_nm)),
        channel_nm=channel_nm,
        channels=tuple(
            tuple(FrameFile(p, shape, k) for k in range(1, channels + 1))
            for p in (frames.files if channels else ())
        ),
        focal_length_sigma_px=focal_sigma,
        control=control,
        control_tracks=tracks,
        radii=radii_of(file),
        epoch=frames.epoch,
        rig=cameras,
        warnings=(
            *frames.warnings,
            *lens_words,
            *start.warnings,
            *_exchanged_words(file, frames, start.images, control, surface),
            *ground_words,
            *(_lost(frames, reasons) if rig is None else lost_images(rig, cameras)),
        ),
    )
    doubts = (*unit_doubts(problem), *_span_doubts(problem, file))
    problem = replace(problem, warnings=(*problem.warnings, *doubts))
    return FrameSequence(
        path, file.sequence.name, problem, file.world, file.cube, frames.files, tuple(files.used),
        (*wide_words(detector), *doubts), () if rig is None else rig.files,
    )  # fmt: skip


def _usual_channels(frames: FrameList, probes: Sequence[Probe]) -> tuple[float, ...]:
    """nm of the bands of frames of which nothing says it: of three, red, green, blue; of more, not known.

    None where the frames differ in the number of their bands, or hold one (and perhaps alpha): panchromatic.
    """
    good = [(path, found.bands) for path, found in zip(frames.files, probes, strict=True) if not found.reason]
    counts = {bands for _, bands in good}
    if len(counts) != 1 or counts <= {1, 2}:
        return ()
    (count,) = counts
    with open_raster(good[0][0]) as dataset:
        colours = [getattr(one, "name", "") for one in dataset.colorinterp]
    if count == len(_RGB_NM) or (count == len(_RGB_NM) + 1 and colours[-1] == "alpha"):
        return _RGB_NM
    return (float("nan"),) * count


def _rig_cameras(
    rig: RigImages,
    files: InputFolder,
    first: AreaDetector,
    model: tuple[tuple[str, ...], Rotation] | None,
) -> tuple[RigCamera, ...]:
    """All cameras of a rig; `first` is the detector of the first, `model` attitudes by another program."""
    out = []
    for number, section in enumerate(rig.sections):
        frames, camera = rig.frames_of(number), section.as_camera()
        shape = camera.shape or shape_of(probe_frames(frames)) or first.shape
        detector, sigma, _ = sequence_detector(camera, files, frames, shape, f"camera[{number + 1}]")
        out.append(rig_camera(rig, number, detector, sigma, model))
    return tuple(out)


def _span_doubts(problem: SequenceProblem, file: SequenceFile) -> tuple[str, ...]:
    """A doubt where the places of a table of metres hardly differ."""
    known = np.isfinite(problem.known.position).all(axis=1)
    if file.world.frame != "local" or not known.any():
        return ()
    places = problem.images.position[known]
    if problem.radii is not None and file.world.origin is not None:
        lon, lat, height = file.world.origin
        origin = from_geodetic([[*np.radians([lon, lat]), height]], problem.radii)[0]
        places = (places - origin) @ level_axes_at(origin, problem.radii).T
    seen = np.linalg.norm(seen_ground(problem) - problem.images.position, axis=1)
    seen = seen[np.isfinite(seen)]
    return span_doubts(places, problem.t[known], float(np.median(seen))) if len(seen) else ()


def _exchanged_words(
    file: SequenceFile,
    frames: FrameList,
    images: Images,
    control: ControlPoints | None,
    surface: Surface,
) -> tuple[str, ...]:
    """A doubt where what gives the place disagrees by what exchanging latitude and longitude explains."""
    radii = radii_of(file)
    if radii is None:
        return ()
    places: dict[str, Array] = {}
    if file.world.frame == "local" and file.world.origin is not None:
        places["[world] origin"] = np.array(file.world.origin[:2])
    elif np.isfinite(images.position).all(axis=1).any():
        places["the positions"] = _place(images.position, radii)
    gps = np.array([place_of(exif, xmp)[0] for exif, xmp in zip(frames.exif, frames.xmp, strict=True)])
    if len(gps) and np.isfinite(gps[:, :2]).all(axis=1).any():
        places["GPS of the photographs"] = np.nanmedian(gps[:, :2], axis=0)
    if control is not None:
        places["the control points"] = _place(control.position, radii)
    if isinstance(surface, Dem) and surface.crs is not None:
        places["the dem"] = _place(raster_corners(surface), surface.radii)
    for (name, place), (other, there) in combinations(places.items(), 2):
        if exchanged(place, there):
            return (
                f"{name} (longitude {place[0]:.5g}, latitude {place[1]:.5g}) and {other} (longitude "
                f"{there[0]:.5g}, latitude {there[1]:.5g}) lie far apart, and together once latitude and "
                "longitude are exchanged: are they swapped in one of them?",
            )
    return ()


def _place(points: Array, radii: tuple[float, float]) -> Array:
    """Longitude and latitude (degrees) of the middle of points (N, 3) of the world."""
    known = points[np.isfinite(points).all(axis=1)]
    return np.degrees(to_geodetic(np.median(known, axis=0)[None], radii)[0, :2])


def _lost(frames: FrameList, reasons: Sequence[str]) -> tuple[str, ...]:
    """How many frames cannot be used, and the first of them."""
    lost = [k for k, reason in enumerate(reasons) if reason]
    if not lost:
        return ()
    k = lost[0]
    return (
        f"{len(lost)} of {len(reasons)} frames cannot be used; the first, {frames.names[k]}: {reasons[k]}",
    )


def sequence_detector(
    camera: SequenceCamera,
    files: InputFolder,
    frames: FrameList,
    shape: tuple[int, int],
    key: str = "camera",
) -> tuple[AreaDetector, float, tuple[str, ...]]:
    """The detector, 1-sigma (px) of its focal length, and what was noticed.

    What ``[camera]`` leaves out is taken from XMP, then EXIF of photographs.
    """
    focal, sigma, words = _focal_length(camera, files, frames, shape)
    tags = next((xmp for xmp in frames.xmp if xmp is not None and xmp.focal_length_px is not None), None)
    middle = (shape[0] - 1) / 2.0, (shape[1] - 1) / 2.0
    principal, distortion = camera.principal_point_px, tuple(camera.distortion)
    if tags is not None and camera.focal_length_px is None:
        principal = principal or tags.principal_point_px
        if principal is None and tags.principal_offset_px is not None:
            principal = middle[0] + tags.principal_offset_px[0], middle[1] + tags.principal_offset_px[1]
        distortion = distortion or tags.distortion
    principal = principal or middle
    off = [abs(p - m) > size for p, m, size in zip(principal, middle, shape, strict=True)]
    if any(off):
        words = (
            *words,
            f"the principal point (line {principal[0]:.6g}, column {principal[1]:.6g}) lies far outside "
            f"the frame of {shape[0]} lines x {shape[1]} columns: is [camera] principal_point_px in "
            "pixels, (line, column)?",
        )
    detector = AreaDetector("camera", shape, focal, principal, distortion, _wavelengths(camera, files, shape))
    if camera.distortion:
        refuse_folding(detector, f"{files.toml}: {key}.distortion")
    return detector, sigma, (*words, *wide_words(detector))


def _focal_length(
    camera: SequenceCamera, files: InputFolder, frames: FrameList, shape: tuple[int, int]
) -> tuple[float, float, tuple[str, ...]]:
    sigma = np.inf if camera.focal_length == "estimate" else camera.focal_length_sigma_px
    if camera.focal_length_px is not None:
        return camera.focal_length_px, sigma, ()
    for xmp in frames.xmp:
        if xmp is not None and xmp.focal_length_px is not None:
            return xmp.focal_length_px, sigma, (f"focal length by XMP: {xmp.focal_length_px:.5g} px",)
    for exif in frames.exif:
        if exif is not None and exif.focal_35mm is not None:
            focal = exif.focal_35mm / _FILM_DIAGONAL * float(np.hypot(*shape))
            words = f"focal length by EXIF: {focal:.4g} px +- {100 * _FILM_SIGMA:.0f} %"
            if sigma > 0.0:
                return focal, min(sigma, _FILM_SIGMA * focal), (f"{words}, refined from there",)
            return focal, 0.0, (f"{words}, taken as it is: {_NOT_REFINED}",)
    raise FormatError(
        f"{files.toml}: key 'camera.focal_length_px' is missing, and no photograph has it; add it "
        "(focal length in mm / pixel pitch in mm); where it is known roughly only, add focal_length = "
        '"estimate" beside such a rough value, to have it found with the poses'
    )


def _wavelengths(camera: SequenceCamera, files: InputFolder, shape: tuple[int, int]) -> Array | None:
    """Of each line, from the list or from the ENVI header."""
    given = camera.wavelength_nm
    if given is None:
        return None
    if isinstance(given, WavelengthRange):
        return np.linspace(given.first, given.last, shape[0])
    values = read_envi_wavelengths(files(given)) if isinstance(given, str) else np.array(given)
    place = files(given) if isinstance(given, str) else files.toml
    if len(values) != shape[0]:
        raise FormatError(
            f"{place}: {len(values)} wavelengths for frames of {shape[0]} lines; one per line is expected, "
            "from line 0 on, or [camera] wavelength_nm = { from = ..., to = ... } where they change evenly"
        )
    if values.min() < LEAST_NM:
        raise FormatError(
            f"{place}: wavelengths from {values.min():g} to {values.max():g} nm are no light that a camera "
            "sees; add `wavelength units = Micrometers` to the header if they are such, or give [camera] "
            "wavelength_nm as a list"
        )
    return np.asarray(values, dtype=np.float64)


def _check_mosaic(camera: SequenceCamera, shape: tuple[int, int], path: Path) -> None:
    mosaic = camera.mosaic_nm
    if mosaic is not None and (len(mosaic) > shape[0] or len(mosaic[0]) > shape[1]):
        raise FormatError(
            f"{path}: camera.mosaic_nm has {len(mosaic)} rows x {len(mosaic[0])} columns, a frame "
            f"{shape[0]} x "
            f"{shape[1]}; the pattern that repeats over the frame is expected"
        )


def _check_readout(camera: SequenceCamera, frames: FrameList, path: Path) -> None:
    """Frames follow one another: the last line of one is exposed before the first of the next."""
    if len(frames.t) > 1 and camera.readout_time > float(np.median(np.diff(frames.t))):
        raise FormatError(
            f"{path}: camera.readout_time = {camera.readout_time:g} s is longer than the "
            f"{float(np.median(np.diff(frames.t))):.4g} s from frame to frame; seconds are expected"
        )


def _ground(
    file: SequenceFile, files: InputFolder, images: Images, detector: AreaDetector, mount: Rotation
) -> tuple[Surface, tuple[str, ...]]:
    """The ground, and how many frames look beside it by their rough poses."""
    rays = _rays_of_frames(images, detector, mount)
    surface = surface_of(file.surface, files, _seen(*rays), local=is_local(file), radii=file.surface.radii)
    origins, directions = images.position, images.world_from_body.apply(mount.as_matrix()[:, 2])
    seen: NDArray[np.bool_] = np.asarray(
        np.isfinite(surface.intersect(origins, directions)).all(axis=1), dtype=np.bool_
    )
    if not seen.any():
        raise GeometryError(
            f"{files.toml}: no frame looks at the ground: by their rough poses all are below it, look "
            "away from it, or lie beside the dem; check z of the positions against [surface] height"
            + ("" if _height_given(file) else " (not given: 0 m is taken)")
            + ", [world], and the mount"
            + (exchanged_words(surface, origins) if isinstance(surface, Dem) else "")
        )
    words = []
    if not _height_given(file):
        above = "in z" if is_local(file) else "above the ellipsoid"
        words.append(
            f"[surface] gives no height of the ground: 0 m {above} is where the solution starts; heights are "
            "found from the images, as well as positions or control points give the scale"
        )
    beside = int((~seen).sum())
    if beside > _BESIDE_SHARE * len(seen):
        words.append(f"{beside} of {len(seen)} frames look beside the ground by their rough poses")
    return surface, tuple(words)


def _height_given(file: SequenceFile) -> bool:
    """Whether the file says how high the ground is."""
    return file.surface.dem is not None or "height" in file.surface.model_fields_set


def _rays_of_frames(images: Images, detector: AreaDetector, mount: Rotation) -> tuple[Array, Array]:
    """Rays of the corners and the middle of every frame."""
    lines, columns = detector.shape
    ends = [(0, 0), (0, columns - 1), (lines - 1, 0), (lines - 1, columns - 1)]
    pixels = np.array([*ends, ((lines - 1) / 2.0, (columns - 1) / 2.0)], dtype=np.float64)
    looks = mount.apply(detector.directions(pixels))
    world = np.einsum("mij,kj->mki", images.world_from_body.as_matrix(), looks)
    origins = np.repeat(images.position, len(pixels), axis=0)
    good = np.isfinite(world).all(axis=2).ravel()
    return read_only(origins[good]), read_only(world.reshape(-1, 3)[good])


def _seen(origins: Array, directions: Array) -> Callable[[Surface], Array]:
    return lambda surface: surface.intersect(origins, directions)
