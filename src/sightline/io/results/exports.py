"""A recovered line of sight → files of other programs: ``sightline export`` and ``export`` of a result.

What each form carries and loses is in ``docs/formats/export.md``.

Not here: the forms themselves (``io/formats/``), which result gives what (``kinds/``).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.export import (
    line_states,
    motion_shifts,
    poses_of,
    rates,
    states_at,
    without_motion,
)
from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Dem, Ellipsoid, Surface
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.ccsds import write_aem, write_oem
from sightline.io.formats.csm_files import (
    CsmNames,
    along_samples,
    csm_timing,
    inertial_states,
    isd_text,
    nearest_plane,
    state_text,
)
from sightline.io.formats.ephemeris_time import earth_from_j2000, et_of_utc
from sightline.io.formats.images import RasterImage
from sightline.io.formats.rpc_files import write_rpb, write_rpc_text
from sightline.io.formats.spice_files import (
    spacecraft_clock,
    spice_kernels,
    write_ck,
    write_jitter_table,
)
from sightline.io.formats.tables import ANGLES, write_columns
from sightline.io.names import file_stems
from sightline.io.results.catalog import strip_features, write_geoparquet, write_stac
from sightline.io.results.line_of_sight import AEM_FRAMES, on_another_body
from sightline.io.results.map_lookup import write_lookup
from sightline.products.rpc import Rpc, fit_rpc
from sightline.version import VERSION
from sightline.writing import whole_raster, whole_text

Array = NDArray[np.float64]

#: px; what the detector line of CSM may differ by from that of the camera.
LARGEST_LENS_PX = 0.01
#: px rms of lines or columns from which an RPC is refused; the same of the camera without its motion, beyond
#: which the strip is longer than one RPC can hold.
LARGEST_RPC_PX, LARGEST_STILL_PX = 1.0, 0.1
#: m; half of the least range of heights that an RPC is fitted over.
LEAST_HEIGHTS = 500.0
#: Lines of shifts that are computed at a time.
_BLOCK = 512
#: Bands whose frames have numbers of their own beside those of one spacecraft.
MOST_FRAMES = 9


@dataclass(frozen=True, eq=False)
class Exported:
    """What is exported.

    Attributes
    ----------
    name : str
        Title of the acquisition.
    t : (N,)
        s from the epoch.
    quat_xyzw : (N, 4)
        world_from_body, scalar last, at these times: refined.
    sigma : (N, 3) or None
        rad; of roll, pitch, yaw.
    epoch : str or None
        UTC of t = 0.
    frame : str or None
        Of the world axes in CCSDS messages; None where they have no name.
    position : (N, 3) or None
        m, world axes; None where nothing says it.
    acquisition : Acquisition or None
        Needed by all forms that hold a camera.
    cameras : dict of str to PushbroomCamera
        By band; with the recovered motion and statics.
    flight : bool
        Whether it is poses of a flight, which have no acquisition.
    footprints : tuple of dict
        GeoJSON features of the frames of a flight, or of images of several cameras, where they have a place
        on a body.
    folder : Path or None
        Where the result lies, if it does.
    files : tuple of str
        Names of its files, below it.
    cube : mapping or None
        Entry ``cube`` of the summary of a flight.
    radii : (equatorial, polar)
        m; of the body that `footprints` are on.
    only : tuple of str
        Forms that there are of such a result; empty: all.
    absolute_sigma : (N, 3) or None
        rad; of roll, pitch, yaw with what no image shows, where `sigma` is without it; infinite where nothing
        ties that.
    unseen : str
        What no image shows of the attitude and nothing ties, in words; empty: nothing.
    """

    name: str
    t: Array
    quat_xyzw: Array
    sigma: Array | None
    epoch: str | None
    frame: str | None
    position: Array | None = None
    acquisition: Acquisition | None = None
    cameras: Mapping[str, PushbroomCamera] = field(default_factory=dict)
    flight: bool = False
    footprints: tuple[dict[str, Any], ...] = ()
    folder: Path | None = None
    files: tuple[str, ...] = ()
    cube: Mapping[str, Any] | None = None
    radii: tuple[float, float] = WGS84
    only: tuple[str, ...] = ()
    absolute_sigma: Array | None = None
    unseen: str = ""

    def covers(self, to: str) -> tuple[tuple[dict[str, Any], ...], tuple[float, float]]:
        """GeoJSON features of what is covered, and the radii of the body."""
        if not self.flight and self.cameras:
            acquired, radii = self.needs_body(to)
            return tuple(strip_features(self.cameras, acquired.surface, radii)), radii
        if not self.footprints and not self.flight and self.only:
            raise InputError(
                f"--to {to} needs a place on a body, and these axes are local: give [world] another"
            )
        if not self.footprints and not self.flight:
            self.needs_body(to)
        if not self.footprints:
            raise InputError(
                f"--to {to} needs a place on the Earth, which this flight has not: give [world] an "
                "origin, or another frame, and run `sightline georeference` again"
            )
        return self.footprints, self.radii

    def needs_cameras(self, to: str) -> Acquisition:
        """The acquisition, where a form holds cameras of a strip.

        Raises
        ------
        InputError
            None is given, or it is of frames.
        """
        if self.flight:
            raise InputError(
                f"--to {to} holds the camera of a strip, and poses of a flight none; its folder holds models "
                "of its camera for other programs"
            )
        if self.acquisition is None:
            raise InputError(
                f"--to {to} holds a camera, which the result does not: add --acquisition FILE, the "
                "ACQUISITION.toml that it was recovered from"
            )
        if not self.cameras:
            raise InputError(f"--to {to} is of strips ([[band]]), and this is of frames")
        return self.acquisition

    def needs_body(self, to: str) -> tuple[Acquisition, tuple[float, float]]:
        """The acquisition and the radii of the body, where a form holds axes fixed to one."""
        axes, acquired = self.frame, self.acquisition
        local = axes == AEM_FRAMES["local"] if acquired is None else acquired.world != "earth-fixed"
        if local and not self.flight:
            raise InputError(
                f"--to {to} needs axes that are fixed to a body; these are local (level flight over a flat "
                'Earth): give [platform] kind = "ephemeris" or "camera-model"'
            )
        try:
            acquired = self.needs_cameras(to)
        except InputError as error:
            if self.flight or self.acquisition is not None:
                raise
            raise InputError(
                f'{error}, with axes that are fixed to a body ([platform] kind = "ephemeris" or '
                '"camera-model")'
            ) from None
        return acquired, surface_radii(acquired.surface)

    def needs_et(self, to: str) -> float:
        """s past J2000 (TDB) of t = 0."""
        known = None if self.acquisition is None else self.acquisition.reference_et
        if known is not None:
            return known
        if self.epoch is None:
            unless = ", unless its sensor model brings it" if self.acquisition is None else ""
            raise InputError(
                f"--to {to} needs the instant of t = 0: add [acquisition] epoch (UTC) to the ACQUISITION.toml"
                f"{unless}"
            )
        return et_of_utc(self.epoch)


def of_cameras(acquisition: Acquisition) -> Exported:
    """What an acquisition gives without a recovery: its cameras and attitudes as they are given.

    Raises
    ------
    InputError
        If it is of frames.
    """
    if not acquisition.bands:
        raise InputError(
            f"{acquisition.path}: frames are given; without a result cameras of strips ([[band]]) are "
            "exported"
        )
    camera = acquisition.bands[0].camera
    t = camera.times(np.arange(float(camera.lines)))
    pose, other = camera.trajectory.at(t), on_another_body(acquisition.surface)
    return Exported(
        acquisition.name,
        t,
        pose.world_from_body.as_quat(),
        None,
        acquisition.epoch,
        None if other else AEM_FRAMES[acquisition.world],
        pose.position,
        acquisition,
        {band.name: band.camera for band in acquisition.bands},
    )


def surface_radii(surface: Surface) -> tuple[float, float]:
    """Equatorial and polar radius (m) of the body that a surface is of."""
    if isinstance(surface, Ellipsoid):
        return surface.a, surface.b
    if isinstance(surface, Dem) and surface.radii is not None:
        return surface.radii
    return WGS84


def forms_of(exported: Exported) -> list[str]:
    """Forms that can hold a result as it is, as far as its kind, its axes and its times tell."""

    def held(to: str) -> bool:
        try:
            for needed in _NEEDS[to]:
                needed(exported, to)
        except InputError:
            return False
        return exported.sigma is not None or to not in OF_MOTION

    return [to for to in _NEEDS if to in (exported.only or _NEEDS) and held(to)]


def write_export(to: str, folder: Path, exported: Exported, kernels: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Write one form into a folder.

    Parameters
    ----------
    to : str
        One of EXPORTS.
    folder : Path
        Exists.
    exported : Exported
    kernels : tuple of Path
        SPICE kernels, for "ck" and "isis".

    Returns
    -------
    dict
        What was written, and how far it is from the result: the content of ``export.json``.

    Raises
    ------
    InputError
        If the form cannot hold what is exported, or something that it needs is missing.
    """
    if to not in EXPORTS:
        raise InputError(f"`to` is {to!r}; allowed are {', '.join(EXPORTS)}")
    if kernels and to not in WITH_KERNELS:
        raise InputError(f"--kernel is for --to {' and '.join(WITH_KERNELS)}; leave it out with --to {to}")
    if exported.only and to not in exported.only:
        raise InputError(
            f"--to {to} is of what `recover` and `georeference` find; of this result there are "
            f"{' and '.join(exported.only)}"
        )
    begun = time.perf_counter()
    try:
        _check_needs(to, exported)
        found = EXPORTS[to](folder, exported, kernels)
    except InputError as error:
        others = forms_of(exported)
        if to in others:
            raise
        raise InputError(f"{error}; as it is, this result gives --to {', '.join(others)}") from error
    inputs = {} if exported.acquisition is None else exported.acquisition.input_hashes()
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return {
        "name": exported.name,
        "version": VERSION,
        "to": to,
        "files": files,
        **found,
        "warnings": [*found.get("warnings", []), *([] if to in _NO_ATTITUDE else _unseen(exported))],
        "wall_seconds": time.perf_counter() - begun,
        "inputs": inputs,
    }


def _unseen(exported: Exported) -> list[str]:
    """What of an attitude is not known however small its sigma: other programs do not read hidden.csv."""
    if not exported.unseen:
        return []
    return [
        f"{exported.unseen} show in no image, and nothing ties them to the ground: of these the attitude "
        "holds what is nearest to the given one, and sigma_roll, sigma_pitch, sigma_yaw are of the motion "
        "less these (sigma_absolute_* of motion.csv are inf); an [[attitude_sensor]] or control points tie "
        "them"
    ]


def _check_needs(to: str, exported: Exported) -> None:
    """InputError that names all that a form lacks: whoever mends one thing should not meet the next."""
    lacks: list[str] = []
    for needed in _NEEDS.get(to, ()):
        try:
            needed(exported, to)
        except InputError as error:
            lacks.append(str(error))
    if lacks:
        more = [text.removeprefix(f"--to {to} ") for text in lacks[1:] if text != lacks[0]]
        raise InputError("; it also ".join([lacks[0], *more]))


def _quaternions(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``quaternions.csv``: attitude, where it is known place, and sigma, at the times of the motion."""
    columns: dict[str, Any] = {"t": exported.t}
    if exported.position is not None:
        columns |= dict(zip("xyz", exported.position.T, strict=True))
    columns |= dict(zip(("qx", "qy", "qz", "qw"), exported.quat_xyzw.T, strict=True))
    if exported.sigma is not None:
        columns |= dict(zip((f"sigma_{axis}" for axis in ANGLES), exported.sigma.T, strict=True))
    if exported.absolute_sigma is not None:
        names = (f"sigma_absolute_{axis}" for axis in ANGLES)
        columns |= dict(zip(names, exported.absolute_sigma.T, strict=True))
    exact = dict.fromkeys(("x", "y", "z", "qx", "qy", "qz", "qw"), "%.17g")
    write_columns(folder / "quaternions.csv", columns, exact)
    return {"rows": len(exported.t), "axes": "world_from_body, scalar last"}


def _need_epoch(exported: Exported, to: str) -> str:
    """UTC of t = 0."""
    if exported.epoch is None:
        add = "add [acquisition] epoch (UTC of t = 0) and recover again"
        if exported.flight or exported.only:
            add = "add the epoch (UTC of t = 0) to the file and run the command again"
        raise InputError(f"--to {to} gives times in UTC: {add}")
    return exported.epoch


def _need_axes(exported: Exported, to: str) -> str:
    """Name of the axes of a CCSDS message."""
    # a folder names its axes in a message alone, and without an epoch it has none
    known = exported.flight or exported.acquisition is not None or exported.epoch is not None
    if exported.frame is None and known:
        where = "local, or of another body" if exported.flight else "of another body"
        raise InputError(
            f"--to {to} names its axes, and those of this result have no name there: they are {where}"
        )
    return exported.frame or ""


def _aem(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``attitude.aem``: the refined attitude of the body."""
    epoch, frame = _need_epoch(exported, "aem"), _need_axes(exported, "aem")
    name = exported.name.upper()
    write_aem(folder / "attitude.aem", exported.t, exported.quat_xyzw, epoch, object_name=name, frame=frame)
    return {"rows": len(exported.t), "axes": f"{frame} to SC_BODY_1"}


def _need_positions(exported: Exported, to: str) -> Array:
    """Positions that have velocities."""
    if exported.position is None:
        raise InputError(
            f"--to {to} gives positions, which the result does not hold: add --acquisition FILE, the "
            "ACQUISITION.toml that it was recovered from"
        )
    if len(exported.t) < 2:
        raise InputError(f"--to {to} gives velocities; one position alone has none")
    return exported.position


def _oem(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``orbit.oem``: positions and velocities of the body at the times of the motion."""
    epoch, frame = _need_epoch(exported, "oem"), _need_axes(exported, "oem")
    position = _need_positions(exported, "oem")
    velocity = rates(position, exported.t)
    name = exported.name.upper()
    write_oem(folder / "orbit.oem", exported.t, position, velocity, epoch, object_name=name, frame=frame)
    return {"rows": len(exported.t), "axes": frame}


def _stems(exported: Exported) -> dict[str, str]:
    """A file name for each band."""
    return dict(zip(exported.cameras, file_stems(exported.cameras), strict=True))


def _csm(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND.json``: a model state of usgscsm for each band."""
    acquired, radii = exported.needs_body("csm")
    et, bands = exported.needs_et("csm"), []
    for name, stem in _stems(exported).items():
        camera = exported.cameras[name]
        detector, states = along_samples(camera, line_states(camera))
        plane, residual = _plane(detector, name, "csm")
        text = state_text(
            camera,
            states,
            csm_timing(camera, et),
            plane,
            radii,
            CsmNames(stem, name, exported.name),
            _under_middle(camera, acquired.surface),
        )
        whole_text(folder / f"{stem}.json", text)
        bands.append({"name": name, "file": f"{stem}.json", "lens_px": residual})
    return {"bands": bands, "axes": "body-fixed"}


def _isd(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND.json``: an ISD for each band."""
    acquired, radii = exported.needs_body("isd")
    et, bands = exported.needs_et("isd"), []
    for name, stem in _stems(exported).items():
        camera = exported.cameras[name]
        timing = csm_timing(camera, et)
        states = line_states(camera)
        # instants past J2000 are resolved to 6e-8 s: poses are those of the instants that the file can hold
        states = states_at(camera, np.unique((states.t + et) - et))
        detector, states = along_samples(camera, states)
        plane, residual = _plane(detector, name, "isd")
        body, words = body_rotation(acquired, states.t, et)
        names = CsmNames(stem, name, exported.name)
        whole_text(folder / f"{stem}.json", isd_text(camera, states, timing, plane, radii, names, body))
        bands.append({"name": name, "file": f"{stem}.json", "lens_px": residual})
    return {"bands": bands, "axes": words}


def body_rotation(acquired: Acquisition, t: Array, et: float) -> tuple[tuple[Array, Rotation], str]:
    """Instants (s) and body-fixed from J2000 at each, over times `t`, and in words what J2000 is."""
    if acquired.body is not None:
        return acquired.body, "J2000, by the rotation of the body of the sensor model"
    ends = np.array([t[0], t[-1]]) if len(t) > 1 else np.array([t[0], t[0] + 1.0])
    if on_another_body(acquired.surface) or acquired.reference_et is not None:
        still = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
        return (ends, still), "J2000 of the file is the body-fixed axes: the body does not turn in it"
    return (ends, earth_from_j2000(ends + et)), "J2000 to Earth-fixed with UT1 = UTC and without polar motion"


def _ck(folder: Path, exported: Exported, kernels: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND.bc`` and ``BAND.tf``: attitude of the camera at every line, and the frame that it is of."""
    acquired, _ = exported.needs_body("ck")
    other = on_another_body(acquired.surface)
    if acquired.body is None and (other or acquired.reference_et is not None):
        raise InputError(
            "--to ck gives attitudes in J2000, and nothing says how the body turns; recover with an ISD, "
            "which does, or export csm"
        )
    bands = []
    words = _words(_stems(exported))
    with spice_kernels(kernels) as library:
        clock = spacecraft_clock(kernels)
        et = _et_by(library, exported, "ck")
        for number, (name, stem) in enumerate(_stems(exported).items()):
            camera = exported.cameras[name]
            states = line_states(camera)
            states = states_at(camera, np.unique((states.t + et) - et))
            if acquired.body is not None:
                states = inertial_states(states, acquired.body)
            if camera.middles != (0.0, 0.0):
                raise InputError(
                    f"{name}: --to ck stamps the attitude of a line with its time, which is that of another "
                    "stage than the middle one; describe the band with `time_reference` centre"
                )
            frame = f"SIGHTLINE_{words[name]}"
            identity = write_ck(
                folder / f"{stem}.bc", states.t + et, states.world_from_camera, clock, number=number,
                name=frame, reference="J2000" if acquired.body is not None else "ITRF93",
            )  # fmt: skip
            bands.append(
                {"name": name, "files": [f"{stem}.bc", f"{stem}.tf"], "frame": frame, "id": identity}
            )
    axes = "J2000" if acquired.body is not None else "ITRF93"
    return {"bands": bands, "axes": f"{axes} to camera: x to samples, y to lines, z to the scene"}


def _words(stems: Mapping[str, str]) -> dict[str, str]:
    """Names of bands as part of those of frames: capitals, digits and lines, 16 of them, no two alike.

    A name of the kernel pool has 32 letters, of which six are ``FRAME_`` and ten ``SIGHTLINE_``.
    """
    if len(stems) > MOST_FRAMES:
        raise InputError(
            f"--to ck: {len(stems)} bands; a spacecraft has numbers for {MOST_FRAMES} frames: export fewer"
        )
    words: dict[str, str] = {}
    for number, (name, stem) in enumerate(stems.items()):
        word = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in stem.upper())[
            :16
        ]
        words[name] = word if word not in words.values() else f"{word[:14]}_{number}"
    return words


def _et_by(library: Any, exported: Exported, to: str) -> float:
    """s past J2000 (TDB) of t = 0, by the leap second kernel where there is one."""
    acquired = exported.acquisition
    known = acquired is not None and acquired.reference_et is not None
    if known or exported.epoch is None:
        return exported.needs_et(to)
    try:
        return float(library.str2et(exported.epoch.strip().removesuffix("Z").replace("+00:00", "")))
    except library.exceptions.SpiceyError:  # no leap second kernel
        return exported.needs_et(to)


def _isis(folder: Path, exported: Exported, kernels: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND_jitter.txt``: sample px, line px and ET of every line: what the motion moved its middle by.

    As ``appjit`` of ISIS takes them, by its source (``PixelOffset``) and the kernels of HiRISE (samples run
    against y of the instrument, x points forward): where a pixel lies, less where it would without motion.
    """
    acquired, bands = exported.needs_cameras("isis"), []
    if kernels:
        with spice_kernels(kernels) as library:
            et = _et_by(library, exported, "isis")
    else:
        et = exported.needs_et("isis")
    for name, stem in _stems(exported).items():
        camera = exported.cameras[name]
        lines = np.arange(float(camera.lines))
        column = (camera.columns - 1) // 2
        moved = -motion_shifts(camera, acquired.surface, lines)[:, column]
        known = np.isfinite(moved).all(axis=1)
        rms = np.sqrt((moved[known] ** 2).mean(axis=0)) if known.any() else np.zeros(2)
        words = (
            f"{name}: where column {column} lies less where it would without the recovered motion",
            f"rms {rms[1]:.6f} px in samples, {rms[0]:.6f} px in lines",
            "sample px, line px, ET (s past J2000, TDB)",
        )
        times = (et + camera.times(lines))[known]
        write_jitter_table(folder / f"{stem}_jitter.txt", times, moved[known], words)
        largest = np.abs(moved[known]).max(axis=0, initial=0.0)
        bands.append(
            {"name": name, "file": f"{stem}_jitter.txt", "rms_px": rms.tolist(), "max_px": largest.tolist()}
        )
    return {"bands": bands, "axes": "samples, lines of each band: with the motion less without it"}


def _need_earth(exported: Exported, to: str) -> tuple[dict[str, Any], ...]:
    """What is covered of the Earth."""
    features, radii = exported.covers(to)
    if abs(radii[0] / WGS84[0] - 1.0) > 1e-3:
        raise InputError(
            f"--to {to} gives longitudes and latitudes of the Earth, and this is another body; give "
            "--to geoparquet"
        )
    return features


def _stac(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``stac.json``: what is covered and when, and the files of the result."""
    features, epoch = _need_earth(exported, "stac"), _need_epoch(exported, "stac")
    span = float(exported.t.min()), float(exported.t.max())
    return write_stac(
        folder, exported.name, features, span, epoch, exported.folder, exported.files, exported.cube
    )


def _geoparquet(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``footprints.parquet``: a row for each band or frame."""
    features, radii = exported.covers("geoparquet")
    return write_geoparquet(folder / "footprints.parquet", features, radii, exported.epoch)


def _igm(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND_igm`` and ``BAND_glt``: where each pixel lies on a map, and which pixel each place shows."""
    acquired, radii = exported.needs_body("igm")
    bands = []
    for name, stem in _stems(exported).items():
        bands.append(
            {"name": name, **write_lookup(folder, stem, exported.cameras[name], acquired.surface, radii)}
        )
    return {
        "bands": bands,
        "axes": "easting, northing, height (m) of each pixel; sample, line from 1 of each place",
    }


def _plane(detector: LineDetector, name: str, to: str) -> tuple[Any, float]:
    """Focal plane of CSM for a detector line, and px by which it differs."""
    plane, residual = nearest_plane(detector)
    if not residual <= LARGEST_LENS_PX:
        raise InputError(
            f"--to {to}: the detector line of {name!r} is met to {residual:.3g} px only, {LARGEST_LENS_PX:g} "
            "px are allowed: CSM holds even pixels behind a smooth distortion; CCDs that meet with steps are "
            "bands of their own"
        )
    return plane, residual


def _under_middle(camera: PushbroomCamera, surface: Surface) -> tuple[Array, float]:
    """Ground under the middle of an image (m, world axes), and m that a pixel covers there."""
    line, column = (camera.lines - 1) / 2.0, (camera.columns - 1) / 2.0
    ground = camera.locate([[line, column], [line, column + 1.0]], surface)
    if not np.isfinite(ground).all():
        position, _ = poses_of(camera, np.array([line]))
        return np.zeros(3), float(np.linalg.norm(position) * camera.detector.pixel_step)
    return ground[0], float(np.linalg.norm(ground[1] - ground[0]))


def _shifts(folder: Path, exported: Exported, _: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND_shifts.tif``: px, lines and columns, that the recovered motion moved each pixel by."""
    acquired, bands = exported.needs_cameras("shifts"), []
    for name, stem in _stems(exported).items():
        camera = exported.cameras[name]
        profile = {
            "driver": "GTiff", "width": camera.columns, "height": camera.lines, "count": 2,
            "dtype": "float32", "nodata": float("nan"), "compress": "deflate", "predictor": 3,
            "bigtiff": "if_safer",
        }  # fmt: skip
        largest, squares, count = np.zeros(2), np.zeros(2), 0
        with _new_raster(folder / f"{stem}_shifts.tif", profile) as raster:
            for number, words in enumerate(("d_line (px)", "d_column (px)"), 1):
                raster.set_band_description(number, words)
            for first in range(0, camera.lines, _BLOCK):
                last = min(first + _BLOCK, camera.lines)
                moved = motion_shifts(camera, acquired.surface, np.arange(float(first), last))
                window = (first, last), (0, camera.columns)
                raster.write(moved.transpose(2, 0, 1).astype(np.float32), window=window)
                largest = np.fmax(largest, np.nanmax(np.abs(moved), axis=(0, 1), initial=0.0))
                squares += np.nansum(moved**2, axis=(0, 1))
                count += int(np.isfinite(moved[..., 0]).sum())
        rms = np.sqrt(squares / max(count, 1))
        bands.append(
            {"name": name, "file": f"{stem}_shifts.tif", "rms_px": rms.tolist(), "max_px": largest.tolist()}
        )
    return {"bands": bands, "axes": "lines, columns of each band: without the motion less with it"}


def _rpc(folder: Path, exported: Exported, __: tuple[Path, ...]) -> dict[str, Any]:
    """``BAND_RPC.TXT``, ``BAND.RPB`` and, of rasters, ``BAND.tif`` with the RPC in its tags."""
    acquired, radii = exported.needs_body("rpc")
    bands, images = [], dict(zip(acquired.names, acquired.images, strict=True))
    for name, stem in _stems(exported).items():
        camera = exported.cameras[name]
        heights = _heights(camera, acquired, radii)
        fitted = _held(camera, name, radii, heights)
        _, gsd = _under_middle(camera, acquired.surface)
        write_rpc_text(folder / f"{stem}_RPC.TXT", fitted)
        rms_m = float(np.hypot(*fitted.rms_px)) * gsd
        write_rpb(folder / f"{stem}.RPB", fitted, satellite=exported.name, band=name, rms_m=rms_m)
        image = images[name]
        files = [f"{stem}_RPC.TXT", f"{stem}.RPB"]
        if isinstance(image, RasterImage):
            _tagged(folder / f"{stem}.tif", image, fitted)
            files.append(f"{stem}.tif")
        bands.append(
            {
                "name": name,
                "files": files,
                "rms_px": list(fitted.rms_px),
                "max_px": list(fitted.max_px),
                "heights": list(heights),
            }
        )
    return {"bands": bands, "axes": "longitude, latitude (degrees), height above the ellipsoid (m)"}


def _heights(
    camera: PushbroomCamera, acquired: Acquisition, radii: tuple[float, float]
) -> tuple[float, float]:
    """Lowest and highest (m) that an RPC is fitted over: those of the ground, and some more."""
    grid = np.meshgrid(
        np.linspace(0.0, camera.lines - 1.0, 33), np.linspace(0.0, camera.columns - 1.0, 17), indexing="ij"
    )
    ground = camera.locate(np.stack(grid, axis=-1).reshape(-1, 2), acquired.surface)
    ground = ground[np.isfinite(ground).all(axis=1)]
    if not len(ground):
        raise GeometryError("no pixel of the image sees the ground; an RPC has nothing to hold")
    heights = to_geodetic(ground, radii)[:, 2]
    more = max(LEAST_HEIGHTS - 0.5 * float(np.ptp(heights)), 3.0 * acquired.height_sigma)
    return float(heights.min()) - more, float(heights.max()) + more


def _held(
    camera: PushbroomCamera, name: str, radii: tuple[float, float], heights: tuple[float, float]
) -> Rpc:
    """The RPC of a camera; refused where it does not hold it."""
    fitted = fit_rpc(camera, camera.shape, radii, heights)
    if max(fitted.rms_px) <= LARGEST_STILL_PX:
        return fitted
    still = fit_rpc(without_motion(camera), camera.shape, radii, heights)
    if max(still.rms_px) > LARGEST_STILL_PX:
        raise InputError(
            f"--to rpc: the strip of {name!r}, {camera.lines} lines, is longer than one RPC can hold: even "
            f"without the recovered motion {still.rms_px[0]:.3g} px in lines and {still.rms_px[1]:.3g} px in "
            f"columns (rms) are left, {LARGEST_STILL_PX:g} px are allowed; cut it into shorter strips, or "
            "export csm"
        )
    if max(fitted.rms_px) > LARGEST_RPC_PX:
        raise InputError(
            f"--to rpc: the motion of {name!r} leaves {fitted.rms_px[0]:.3g} px in lines and "
            f"{fitted.rms_px[1]:.3g} px in columns (rms), which no RPC carries; {LARGEST_RPC_PX:g} px are "
            "allowed: export csm, or register the bands first"
        )
    return fitted


def _tagged(path: Path, image: RasterImage, rpc: Rpc) -> None:
    """The pixels of an image as they are stored, with what masks them, as GeoTIFF whose tags hold the RPC."""
    import rasterio
    from rasterio.rpc import RPC

    lines, columns = image.shape
    profile = {
        "driver": "GTiff", "width": columns, "height": lines, "count": 1, "dtype": str(image.dtype),
        "nodata": image.nodata, "compress": "deflate", "bigtiff": "if_safer",
    }  # fmt: skip
    tags = RPC(
        line_off=rpc.line[0], line_scale=rpc.line[1], samp_off=rpc.column[0], samp_scale=rpc.column[1],
        lat_off=rpc.latitude[0], lat_scale=rpc.latitude[1], long_off=rpc.longitude[0],
        long_scale=rpc.longitude[1], height_off=rpc.height[0], height_scale=rpc.height[1],
        line_num_coeff=rpc.line_numerator.tolist(), line_den_coeff=rpc.line_denominator.tolist(),
        samp_num_coeff=rpc.column_numerator.tolist(), samp_den_coeff=rpc.column_denominator.tolist(),
    )  # fmt: skip
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), _new_raster(path, profile) as raster:
        raster.rpcs = tags
        raster.set_band_description(1, image.description or "")
        for first in range(0, lines, _BLOCK):
            window = (first, min(first + _BLOCK, lines)), (0, columns)
            raster.write(image.read_stored(*window), 1, window=window)
            if image.has_mask:
                bad = image.mask(*window)
                good = np.ones((window[0][1] - first, columns), bool) if bad is None else ~bad
                raster.write_mask(good, window=window)


@contextmanager
def _new_raster(path: Path, profile: Mapping[str, Any]) -> Iterator[Any]:
    """A raster in the grid of an image, whole or not at all; that it lies nowhere on the Earth is no news."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with whole_raster(path) as draft, rasterio.open(draft, "w", **profile) as raster:
            yield raster


#: Writers of each form.
EXPORTS: dict[str, Callable[[Path, Exported, tuple[Path, ...]], dict[str, Any]]] = {
    "csm": _csm,
    "isd": _isd,
    "aem": _aem,
    "oem": _oem,
    "rpc": _rpc,
    "quaternions": _quaternions,
    "shifts": _shifts,
    "ck": _ck,
    "isis": _isis,
    "stac": _stac,
    "geoparquet": _geoparquet,
    "igm": _igm,
}
#: Forms that take SPICE kernels.
WITH_KERNELS: tuple[str, ...] = ("ck", "isis")
#: Forms for catalogues: what is covered, and when.
OF_PLACE: tuple[str, ...] = ("stac", "geoparquet")
#: What each form needs of a result besides kernels, which only those have who ask for theirs.
#: Forms without an attitude.
_NO_ATTITUDE = ("oem", "stac", "geoparquet")
_NEEDS: dict[str, tuple[Callable[[Exported, str], object], ...]] = {
    "csm": (Exported.needs_body, Exported.needs_et),
    "isd": (Exported.needs_body, Exported.needs_et),
    "aem": (_need_epoch, _need_axes),
    "oem": (_need_epoch, _need_axes, _need_positions),
    "rpc": (Exported.needs_body,),
    "quaternions": (),
    "shifts": (Exported.needs_cameras,),
    "isis": (Exported.needs_cameras, Exported.needs_et),
    "stac": (_need_earth, _need_epoch),
    "geoparquet": (Exported.covers,),
    "igm": (Exported.needs_body,),
}
#: Forms that hold what a recovered motion did, so that there are none without it.
OF_MOTION: tuple[str, ...] = ("shifts", "isis")
