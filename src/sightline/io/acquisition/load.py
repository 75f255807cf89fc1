"""An ACQUISITION.toml made ready to use: image sources, nominal cameras, the ground, sensors.

Here is what the contract's words mean: units are already SI, defaults are filled in, files are
opened and checked. Nothing is estimated.

Not here: keys and allowed values (``schema.py``), what comes out (``acquired.py``),
trajectories and surfaces (``platform.py``, ``ground.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.expected_cost import Cost, frames_cost, spin_cost, strip_cost
from sightline.applications.line_of_sight import ready_strip
from sightline.applications.spin_attitude import SpinOptions, seen_again
from sightline.errors import EstimationError, FormatError, GeometryError, InputError, SightlineError, naming
from sightline.estimation.prior import Spectrum, TabulatedPsd
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import Acquisition, InputFolder, input_files, world_kind
from sightline.io.acquisition.apparent import bent_bands
from sightline.io.acquisition.bands import build_bands
from sightline.io.acquisition.frames import build_frames, lens_knowledge
from sightline.io.acquisition.ground import (
    assumed_ground,
    build_surface,
    check_coverage,
    check_overlap,
    check_sampling,
    check_seen,
    keys_left_out,
)
from sightline.io.acquisition.looks import look_doubts, otherwise_written, sensor_doubts
from sightline.io.acquisition.model_bands import build_model_bands
from sightline.io.acquisition.platform import to_world
from sightline.io.acquisition.schema import (
    AcquisitionFile,
    CameraModelPlatform,
    KnownAttitude,
    SensorSection,
    SpinPlatform,
)
from sightline.io.acquisition.spin import spin_of
from sightline.io.acquisition.stages import check_covered
from sightline.io.acquisition.strips import attitude_sigma, chip_knowledge
from sightline.io.config import read_toml, validate
from sightline.io.formats import tables
from sightline.io.formats.ccsds import need_epoch
from sightline.io.formats.line_scan import shared_grid
from sightline.io.formats.products.makers import TURNING
from sightline.io.formats.sentinel1 import is_sentinel1, read_sentinel1_attitude
from sightline.io.quantities import ANGLE_SIGMA
from sightline.matching.select import Selection
from sightline.motion.frames.passes import FrameOptions
from sightline.motion.gyros import departures
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.strip.control_only import one_band_words
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.strip import RecoverOptions
from sightline.result import set_source

Array = NDArray[np.float64]

__all__ = ["Acquisition", "load_acquisition", "read_acquisition", "ready_to_recover"]


def read_acquisition(path: Path) -> AcquisitionFile:
    """The validated content of an ACQUISITION.toml, no file it names opened."""
    return validate(AcquisitionFile, read_toml(path), path)


def load_acquisition(path: str | Path, *, look: bool = True, describe: bool = False) -> Acquisition:
    """An ACQUISITION.toml as images, cameras, ground and sensors.

    Parameters
    ----------
    path : path
        The TOML file; the files it names are relative to it.
    look : bool
        Read a few lines of every image to find truncated, constant or saturated ones early.
    describe : bool
        Only the geometry is asked for: images that are not there are named in `absent`, and taken to be as
        large as others, or as the keys say.

    Returns
    -------
    Acquisition

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed.
    SpanError
        If positions or attitudes do not cover the images.
    GeometryError
        If the elevation raster does not cover the strip, or an image shares no ground with any other.
    """
    return _loaded(Path(path), look=look, sizes={} if describe else None)


def acquisition_of_size(path: Path, sizes: Mapping[str, tuple[int, int]]) -> Acquisition:
    """The geometry of an ACQUISITION.toml whose images are yet to be made, of so many lines and columns.

    Parameters
    ----------
    path : Path
        The TOML file.
    sizes : mapping
        Lines and columns of the image of each band, by its name.

    Raises
    ------
    InputError, FormatError, SpanError, GeometryError
        As `load_acquisition`.
    """
    return _loaded(path, look=False, sizes=sizes)


def _loaded(path: Path, *, look: bool, sizes: Mapping[str, tuple[int, int]] | None) -> Acquisition:
    """The file and what it names; images that are not there described where `sizes` are given."""
    config = read_acquisition(path)
    with input_files(path, config) as files:
        files.describing, files.sizes = sizes is not None, sizes or {}
        acquired = _acquisition(path, config, files, look=look)
    for image in (*acquired.bands, *acquired.frames):
        set_source(image, acquired)
    return acquired


def _acquisition(path: Path, config: AcquisitionFile, files: InputFolder, *, look: bool) -> Acquisition:
    """The file with everything that it names."""
    modelled = isinstance(config.platform, CameraModelPlatform)
    bands = (build_model_bands if modelled else build_bands)(config, files, look=look)
    check_covered(bands, path)
    frames = build_frames(config, files, look=look)
    cameras: list[PushbroomCamera | FrameCamera] = [
        *(band.camera for band in bands),
        *(frame.camera for frame in frames),
    ]
    names = [*(band.name for band in bands), *(frame.name for frame in frames)]
    surface, control = build_surface(config, files, cameras), read_control(config, files, names)
    still = _still(config, files, alone=control is None)
    left_out: tuple[str, ...] = ()
    bands = bent_bands(config, bands, surface, files)
    cameras[: len(bands)] = [band.camera for band in bands]
    if isinstance(config.platform, SpinPlatform) and frames:
        # a spinning camera sees the sky for most of its turn, and with it some of its frames
        check_seen(path, surface, cameras)
    else:
        sweeps = config.platform.kind == "spin" or config.pointing.kind == "scan-mirror"
        # where nothing is looked into, images need not be there
        with _absent_first(path, files.absent if look else ()):
            check_coverage(
                path, surface, cameras, names, sweeps=sweeps,
                otherwise=lambda camera: otherwise_written(config, camera, surface, files.fixed_from_given),
            )  # fmt: skip
            check_sampling(path, surface, cameras, names)
            if bands and not modelled:
                left_out = keys_left_out(surface, bands)
            if len(cameras) > 1:
                try:
                    check_overlap(path, surface, cameras, names, still=bool(still))
                except GeometryError as error:  # left out keys may be why
                    raise GeometryError("; ".join([str(error), *left_out])) from error
    reference = cameras[0].trajectory
    sensors = tuple(read_sensor(entry, files, config, reference) for entry in config.attitude_sensor)
    exposed = np.concatenate([camera.times(np.array([0.0, camera.shape[0] - 1.0])) for camera in cameras])
    return Acquisition(
        path=path,
        name=config.acquisition.name,
        epoch=config.acquisition.epoch,
        bands=bands,
        frames=frames,
        surface=surface,
        height_sigma=config.surface.height_sigma,
        sensors=sensors,
        control_points=control,
        known_motion=read_known_motion(config, files),
        lens=lens_knowledge(config, frames[0].image.shape if frames else None),
        matching=read_matching(config, files, names, [camera.shape for camera in cameras]),
        platform=config.platform.kind,
        world=world_kind(config),
        spin=spin_of(config),
        chip=chip_knowledge(config),
        attitude_sigma=attitude_sigma(config),
        parallax_sigma=config.surface.parallax_sigma,
        inputs=tuple(files.used),
        assumed=assumed_ground(config.surface),
        sources=tuple(files.said),
        reference_et=files.reference_et,
        body=files.body,
        absent=tuple(files.absent),
        still=still,
        doubts=(
            *dict.fromkeys(files.doubts),
            *left_out,
            *look_doubts(config, cameras, names, surface, files.fixed_from_given),
            *sensor_doubts(
                sensors, (float(exposed.min()), float(exposed.max())), config.platform.attitude_sigma or 0.0
            ),
        ),
    )


def _still(config: AcquisitionFile, files: InputFolder, *, alone: bool) -> str:
    """Why the images of a file cannot hold motion; empty where they may. `alone`: without control points."""
    if len(config.band) == 1:
        return one_band_words(config.band[0].name) if alone else ""
    grid = None if config.frame else shared_grid(files.grids)
    return "" if grid is None else grid.reason


@contextmanager
def _absent_first(path: Path, absent: Sequence[str]) -> Iterator[None]:
    """What is wrong with images of which some are only described begins with those: they may be the cause."""
    try:
        yield
    except SightlineError as error:
        if not absent:
            raise
        text = str(error).removeprefix(f"{path}: ")
        raise type(error)(f"{path}: {few_absent(absent)}; as described, {text}") from error


def few_absent(absent: Sequence[str]) -> str:
    """The first image that is not there, and how many more there are not."""
    more = f" (and {len(absent) - 1} more images)" if len(absent) > 1 else ""
    return f"{absent[0]}{more}"


def ready_to_recover(acquired: Acquisition, method: str = "joint") -> Cost:
    """What ``recover`` refuses before it matches anything, and what it will take.

    Parameters
    ----------
    acquired : Acquisition
    method : str
        One of ``RecoverOptions.method``.

    Raises
    ------
    InputError, EstimationError
        As the recovery itself, with the file named; where the images hold no motion.
    """
    frames, given = acquired.frames, acquired.matching
    if acquired.still and len(acquired.bands) == 1:
        raise InputError(f"{acquired.path}: {acquired.still}")
    if acquired.still:
        raise EstimationError(f"{acquired.path}: {acquired.still}")
    with _absent_first(acquired.path, acquired.absent), naming(acquired.path):
        if frames and acquired.spin is not None:
            spun = SpinOptions.from_matching(given)
            lags = max((pair.lag for pair in seen_again(frames)), default=1)
            lines, columns = frames[0].image.shape
            cost = spin_cost(frames, lines * columns / float(np.prod(spun.window)), lags)
        elif frames:
            cost = frames_cost(
                frames, acquired.surface, FrameOptions.from_matching(given), acquired.height_sigma
            )
        else:
            options = RecoverOptions.from_matching(given, method)
            cost = strip_cost(acquired.bands, options, acquired.surface)
            cost.check()
            known, sensors, control = acquired.known_motion, acquired.sensors, acquired.control_points
            ready_strip(acquired.bands, acquired.surface, sensors, control, known, options)
        cost.check()
    return cost


def read_sensor(
    entry: SensorSection, files: InputFolder, config: AcquisitionFile, reference: Trajectory
) -> AttitudeSensor:
    """The table of one ``[[attitude_sensor]]``; rates are beside the attitude that `reference` holds."""
    path = files(entry.table)
    if is_sentinel1(path):
        start, end, angles, sigma = _rates_of_sentinel1(path, entry, files, config, reference)
    elif entry.kind == "star-tracker":
        t, angles, sigma = tables.read_star_tracker(path)
        start, end = t, t
    else:
        start, end, angles, sigma = tables.read_gyro(path)
    return AttitudeSensor(
        name=entry.name or Path(entry.table).stem,
        kind=entry.kind,
        t_start=start,
        t_end=end,
        angles=angles,
        sigma=sigma,
        alignment_sigma=entry.alignment_sigma,
        bias_sigma=entry.bias_sigma,
        correlation_time=entry.correlation_time,
    )


def _rates_of_sentinel1(
    path: Path, entry: SensorSection, files: InputFolder, config: AcquisitionFile, reference: Trajectory
) -> tuple[Array, Array, Array, Array]:
    """A gyro's increments by the rates of a table of Sentinel-1, as of `tables.read_gyro`."""
    if entry.kind != "gyro" or config.world.frame == "local":
        raise FormatError(
            f"{files.toml}: [[attitude_sensor]] {entry.table}: is a table of Sentinel-1, whose rates are "
            'read as kind = "gyro" beside Earth-fixed attitudes; its quaternions are the output of the '
            "filter over them: give them as attitudes of [platform]"
        )
    read = read_sentinel1_attitude(path, need_epoch(path, config.acquisition.epoch))
    begin, end = reference.span
    used = (read.t >= begin) & (read.t <= end)
    if used.sum() < 3:
        raise FormatError(
            f"{path}: {int(used.sum())} of its rates lie within the attitudes of [platform], from "
            f"{begin:.6g} to {end:.6g} s; three or more are needed: is it of another pass, or epoch?"
        )
    if read.contradicted:
        raise FormatError(
            f"{path}: {read.contradicted}; rates that agree with the quaternions are read as a gyro: "
            "correct the table, or leave this [[attitude_sensor]] out"
        )
    t = read.t[used]
    angles = departures(t, read.turned[used], reference.at(t).world_from_body, TURNING)
    sigma, words = read.noise()
    if sigma < ANGLE_SIGMA.least:
        raise FormatError(
            f"{path}: its rates are the turns between its quaternions, whose errors they do not show: leave "
            "this [[attitude_sensor]] out"
        )
    files.said.append(f"{path.name}: {words}")
    # a random walk, also where rows are missing
    return t[:-1], t[1:], angles, sigma * np.sqrt(np.diff(t) / np.median(np.diff(read.t)))


def read_known_motion(config: AcquisitionFile, files: InputFolder) -> KnownContent:
    """Tones, or the spectra of the table of ``[known_motion]``, and how well the attitude is known."""
    section, platform = config.known_motion, config.platform
    known = KnownContent(tuple(section.tones))
    if isinstance(platform, KnownAttitude):
        known = replace(
            known,
            attitude_sigma=platform.attitude_sigma,
            rate_sigma=platform.rate_sigma,
            attitude_added=float(np.linalg.norm(files.attitude_sigmas)),
        )
    if section.psd is None:
        return known
    f, density = tables.read_psd(files(section.psd))
    spectra = [Spectrum((TabulatedPsd(tuple(f.tolist()), tuple(column.tolist())),)) for column in density.T]
    return replace(known, tones=(), spectra=(spectra[0], spectra[1], spectra[2]))


def read_matching(
    config: AcquisitionFile, files: InputFolder, names: Sequence[str], shapes: Sequence[tuple[int, int]]
) -> dict[str, Any]:
    """What ``[matching]`` gives, by the names of ``RecoverOptions``; the selection as one of them.

    `names` and `shapes` (lines, columns) are those of the images.
    """
    given = config.matching.model_dump(exclude_none=True)
    chosen = {key: given.pop(key) for key in ("select", "strength", "points", "features") if key in given}
    if "select" not in chosen:
        return given
    options: dict[str, Any] = {"way": chosen.pop("select")}
    if "features" in chosen:
        path = files(chosen.pop("features"))
        images, pixels = tables.read_features(path)
        unknown = [name for name in images if name not in names]
        if unknown:
            raise FormatError(f"{path}: image {unknown[0]!r} is none of: {', '.join(names)}")
        numbers = np.array([names.index(name) for name in images])
        ends = np.array(shapes)[numbers] - 0.5
        outside = np.flatnonzero(((pixels < -0.5) | (pixels > ends)).any(axis=1))
        for row in outside[:1] if not files.absent else ():  # what is not there has no size
            at = "line {:.10g}, column {:.10g} of {}, which has {} x {}".format(
                *pixels[row], images[row], *shapes[numbers[row]]
            )
            files.doubts.append(
                f"{path}: {len(outside)} of {len(images)} features lie outside their images and choose no "
                f"window, the first in row {row + 1}: {at}"
            )
        options["features"] = {int(k): pixels[numbers == k] for k in np.unique(numbers)}
    return {**given, "selection": Selection(**options, **chosen)}


def read_control(
    config: AcquisitionFile, files: InputFolder, names: Sequence[str]
) -> ControlSightings | None:
    """Control points of the file and of the table it names; None if there are none."""
    table = config.acquisition.control_points
    given = tables.control_points(config.control_point, None if table is None else files(table))
    if given is None:
        return None
    unknown = [name for name in given.image if name not in names]
    if unknown:
        raise FormatError(
            f"{files.toml}: a control point names the image {unknown[0]!r}; images are: {', '.join(names)}"
        )
    numbers = np.array([names.index(name) for name in given.image], dtype=np.intp)
    return ControlSightings(
        to_world(given.position, config), given.sigma, numbers, given.pixels,
        config.acquisition.control_sigma_px, given.lines, given.each_px,
    )  # fmt: skip
