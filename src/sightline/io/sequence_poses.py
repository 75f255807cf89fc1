"""Rough poses of the frames of a sequence, from tables, ``geo.txt``, or EXIF and XMP, and how rough they are.

A frame for which nothing is said gets a pose between its neighbours', and sigmas that are infinite.

Not here: which frames there are (``sequence_frames.py``), the ground (``sequence.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes, to_geodetic
from sightline.io.acquired import InputFolder, attitude_to_world
from sightline.io.angle_tables import OPK, body_of_ypr, camera_of_opk, kind_of_angles
from sightline.io.exif import Exif
from sightline.io.gps_places import places
from sightline.io.odm import read_geo
from sightline.io.platform import points_to_world
from sightline.io.sequence_frames import FrameList, refuse_repeated
from sightline.io.sequence_schema import SequenceFile
from sightline.io.tables import check_quaternions, header_of, read_columns
from sightline.io.xmp import Xmp
from sightline.photogrammetry.frame_poses import RoughPoses
from sightline.photogrammetry.point_priors import level_axes
from sightline.photogrammetry.sightings import Images

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

POSITION_SIGMAS = ("sigma_x", "sigma_y", "sigma_z")
ATTITUDE_SIGMAS = ("sigma_roll", "sigma_pitch", "sigma_yaw")
QUATERNION = ("qx", "qy", "qz", "qw")
#: s by which the t of a table of poses may differ from that of the frame.
SAME_TIME = 1e-3
#: rad from straight down beyond which angles of a mapping camera are taken to be wrong.
_OFF_NADIR = np.radians(80.0)
#: Sigmas of positions by which the places that tell a heading are apart.
_HEADING_SIGMAS = 10.0
#: m; height of a camera of which nothing is known above the ground.
_ANY_HEIGHT = 100.0
_ENU_FROM_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Told:
    """Values of a table at their times, before they are carried to the frames.

    Attributes
    ----------
    frame : (n,) int
        Which frame each row is of; -1: of none.
    t : (n,)
        s.
    values : (n, k)
    sigma : (n, 3)
    axes : (n, 3, 3) or None
        Axes of computation from those the sigmas are along; None: the same.
    """

    frame: Index
    t: Array
    values: Array
    sigma: Array
    axes: Array | None = None


@dataclass(frozen=True, eq=False)
class StartingPoses:
    """Rough poses of all frames in the axes of computation.

    Attributes
    ----------
    images : Images
    known : RoughPoses
    warnings : tuple of str
    """

    images: Images
    known: RoughPoses
    warnings: tuple[str, ...]


def is_local(file: SequenceFile) -> bool:
    """Whether the world is flat: x east, y north, z up, no place on the Earth."""
    return file.world.frame == "local" and file.world.origin is None


def radii_of(file: SequenceFile) -> tuple[float, float] | None:
    """Of the ellipsoid whose normals are the verticals; None where the world is flat."""
    return None if is_local(file) else (file.surface.radii or WGS84)


def starting_poses(
    file: SequenceFile, files: InputFolder, frames: FrameList, mount: Rotation
) -> StartingPoses:
    """Rough poses of all frames; FormatError where a table is wrong or nothing is known at all."""
    warnings: list[str] = []
    placed = _positions(file, files, frames, warnings)
    radii = radii_of(file)
    count = len(frames.names)
    if placed is None:
        position, position_sigma = _anywhere(file, count), np.full((count, 3), np.inf)
        if radii is not None:
            raise FormatError(
                f"{files.toml}: no frame has a position: give positions = FILE or geo = FILE, "
                "photographs with GPS, "
                'or [world] frame = "local" for poses about a place of no meaning'
            )
        warnings.append("no positions: place, size and direction of the result are arbitrary")
    else:
        position, position_sigma = along(frames.t, placed), _sigma_of(placed, count)
        _say_how_many(warnings, position_sigma, "position")
    turned = _attitudes(file, files, frames, mount, position, warnings)
    guess = track_attitude(frames.t, position, position_sigma, radii)
    if turned is None:
        attitude, attitude_sigma = guess, np.full((count, 3), np.inf)
        warnings.append("no attitudes: taken as straight down, nose along the track")
    else:
        attitude, attitude_sigma = slerp_along(frames.t, turned), _sigma_of(turned, count)
        _say_how_many(warnings, attitude_sigma, "attitude")
    order = np.arange(count)
    return StartingPoses(
        Images(np.zeros(count, dtype=np.intp), order, frames.t, position, attitude),
        RoughPoses(
            position_sigma,
            attitude_sigma,
            file.position_bias_sigma,
            file.attitude_bias_sigma,
            _axes_of(placed, count),
        ),
        tuple(warnings),
    )


def _say_how_many(warnings: list[str], sigma: Array, what: str) -> None:
    none = int((~np.isfinite(sigma).all(axis=1)).sum())
    if none:
        warnings.append(
            f"{none} of {len(sigma)} frames have no {what} of their own: interpolated, sigma infinite"
        )


def _anywhere(file: SequenceFile, count: int) -> Array:
    """Positions of cameras of which nothing is known: one place above the ground."""
    return np.tile([0.0, 0.0, file.surface.height + _ANY_HEIGHT], (count, 1))


def _sigma_of(told: Told, count: int) -> Array:
    sigma = np.full((count, 3), np.inf)
    own = told.frame >= 0
    sigma[told.frame[own]] = told.sigma[own]
    return sigma


def _axes_of(told: Told | None, count: int) -> Array | None:
    """Axes (M, 3, 3) of the sigmas of all frames; of those without a row it does not matter."""
    if told is None or told.axes is None:
        return None
    axes = np.tile(np.eye(3), (count, 1, 1))
    own = told.frame >= 0
    axes[told.frame[own]] = told.axes[own]
    return axes


def along(t: Array, told: Told) -> Array:
    """Values (M, k) at times `t`: linear between rows, straight on beyond the ends."""
    if len(told.t) == 1:
        return np.tile(told.values, (len(t), 1))
    k = np.clip(np.searchsorted(told.t, t, side="right"), 1, len(told.t) - 1)
    part = ((t - told.t[k - 1]) / (told.t[k] - told.t[k - 1]))[:, None]
    return np.asarray((1.0 - part) * told.values[k - 1] + part * told.values[k])


def slerp_along(t: Array, told: Told) -> Rotation:
    """Attitudes at times `t` of quaternions: the shortest turn between rows, the nearest beyond the ends."""
    attitude = Rotation.from_quat(told.values)
    if len(told.t) == 1:
        return Rotation.concatenate([attitude] * len(t))
    return Slerp(told.t, attitude)(np.clip(t, told.t[0], told.t[-1]))


def _matched(path: Path, frames: FrameList, names: tuple[str, ...], t: Array | None) -> tuple[Index, Array]:
    """Frame of each row and its time; FormatError where no row is of a frame, or times differ."""
    refuse_repeated(path, names)
    number = {name: k for k, name in enumerate(frames.names)}
    number |= {path.name: k for k, path in enumerate(frames.files) if path.name not in number}
    frame = np.array([number.get(name, -1) for name in names], dtype=np.intp)
    if (frame < 0).all():
        raise FormatError(
            f"{path}: no row is of a frame: the first is of {names[0]!r}, the frames are called "
            f"{frames.names[0]!r}, ...; names must agree"
        )
    own = np.where(frame >= 0, frames.t[frame], np.nan)
    if t is None:
        return frame, own
    far = np.flatnonzero(np.abs(t - own) > SAME_TIME)
    if len(far):
        k = int(far[0])
        raise FormatError(
            f"{path}: frame {names[k]!r} has t = {t[k]:.9g}, in {frames.path.name} it is "
            f"{own[k]:.9g}; they must "
            "agree"
        )
    return frame, np.where(np.isfinite(own), own, t)


def _in_time(
    frame: Index, t: Array, values: Array, sigma: Array, kept: Bools, axes: Array | None = None
) -> Told | None:
    """Kept rows in the order of their times; None where there are none."""
    rows = np.flatnonzero(kept & np.isfinite(t))
    rows = rows[np.argsort(t[rows], kind="stable")]
    rows = rows[np.append(True, np.diff(t[rows]) > 0.0)] if len(rows) else rows
    if not len(rows):
        return None
    return Told(frame[rows], t[rows], values[rows], sigma[rows], None if axes is None else axes[rows])


def _positions(file: SequenceFile, files: InputFolder, frames: FrameList, warnings: list[str]) -> Told | None:
    """Positions that are told, in the axes of computation; None where there are none."""
    if file.positions is not None:
        return _table_positions(file, files(file.positions), frames, warnings)
    if file.geo is not None:
        return _geo_positions(file, files(file.geo), frames, warnings)
    if frames.exif:
        return _exif_positions(file, frames, warnings)
    return None


def _table_positions(file: SequenceFile, path: Path, frames: FrameList, warnings: list[str]) -> Told | None:
    header = header_of(path)
    with_sigma = [name for name in POSITION_SIGMAS if name in header]
    if with_sigma and len(with_sigma) < 3:
        raise FormatError(f"{path}: has {', '.join(with_sigma)} alone; sigma_x,sigma_y,sigma_z are expected")
    columns = ("frame", "t", "x", "y", "z", *with_sigma)
    table = read_columns(path, columns, text=("frame",), infinite=POSITION_SIGMAS)
    names = tuple(str(word) for word in table["frame"])
    frame, t = _matched(path, frames, names, np.asarray(table["t"], dtype=np.float64))
    values = np.column_stack([np.asarray(table[axis], dtype=np.float64) for axis in "xyz"])
    kept = np.ones(len(t), dtype=np.bool_)
    if file.world.frame == "lonlat":
        kept = places(t, values, names, str(path), warnings)
    sigma = _sigmas(path, table, with_sigma, len(t), file.position_sigma)
    position = points_to_world(values, file.world, file.surface.radii, path)
    return _in_time(frame, t, position, sigma, kept, _sigma_axes(file, position))


def _sigmas(
    path: Path, table: dict[str, list[str] | Array], names: list[str], count: int, default: float
) -> Array:
    """Sigmas (n, 3) of a table, positive; `default` where it has none."""
    if not names:
        return np.full((count, 3), default)
    sigma = np.column_stack([np.asarray(table[name], dtype=np.float64) for name in names])
    bad = np.argwhere(sigma <= 0.0)
    if len(bad):
        row, column = (int(k) for k in bad[0])
        raise FormatError(
            f"{path}: row {row + 1}: {names[column]} = {sigma[row, column]:g}; a 1-sigma error must "
            "be positive "
            "(inf: not known)"
        )
    return sigma


def _sigma_axes(file: SequenceFile, position: Array) -> Array | None:
    """Axes of computation (n, 3, 3) from those of the sigmas of a table; None: the same."""
    if is_local(file) or file.world.frame == "earth-fixed":
        return None
    if file.world.frame == "local" and file.world.origin is not None:
        lon, lat = np.radians(file.world.origin[:2])
        return np.tile(local_axes(lon, lat).as_matrix(), (len(position), 1, 1))
    return _level_axes(file, position)


def _level_axes(file: SequenceFile, position: Array) -> Array:
    """East, north, up (n, 3, 3) of each position, in the axes of computation."""
    lon, lat, _ = to_geodetic(position, radii_of(file) or WGS84).T
    return np.asarray(local_axes(lon, lat).as_matrix())


def _geodetic(file: SequenceFile, lonlat: Array) -> Array:
    """Points of computation of longitude, latitude (degrees), height."""
    return from_geodetic(np.column_stack([np.radians(lonlat[:, :2]), lonlat[:, 2]]), radii_of(file) or WGS84)


def _with_heights(file: SequenceFile, lonlat: Array, place: str) -> Array:
    """Heights that are not told are `altitude`."""
    none = ~np.isfinite(lonlat[:, 2])
    if none.any() and file.altitude is None:
        raise FormatError(
            f"{place}: {int(none.sum())} positions have no height; give altitude = m above the "
            "ellipsoid, or positions = "
            "FILE"
        )
    return np.column_stack([lonlat[:, :2], np.where(none, file.altitude or 0.0, lonlat[:, 2])])


def _geo_positions(file: SequenceFile, path: Path, frames: FrameList, warnings: list[str]) -> Told | None:
    geo = read_geo(path)
    frame, t = _matched(path, frames, geo.names, None)
    if geo.angles:
        warnings.append(f"{path.name}: its angles are not used; give attitudes = FILE")
    kept = places(t, geo.lonlat, geo.names, str(path), warnings)
    position = _geodetic(file, _with_heights(file, geo.lonlat, str(path)))
    flat = np.where(np.isfinite(geo.sigma), geo.sigma, file.position_sigma)
    return _in_time(frame, t, position, flat[:, [0, 0, 1]], kept, _level_axes(file, position))


def _exif_positions(file: SequenceFile, frames: FrameList, warnings: list[str]) -> Told | None:
    """GPS of photographs."""
    if is_local(file):
        warnings.append('[world] frame = "local" without origin: GPS of the photographs is not used')
        return None
    lonlat, sigma = (
        np.full((len(frames.names), 3), np.nan),
        np.full((len(frames.names), 3), file.position_sigma),
    )
    signs, bare = 0, 0
    for k, (exif, xmp) in enumerate(zip(frames.exif, frames.xmp, strict=True)):
        place, turned = place_of(exif, xmp)
        lonlat[k] = place
        signs += turned
        bare += exif is not None and exif.unreferenced and not turned
        if xmp is not None and xmp.position_sigma is not None:
            sigma[k] = xmp.position_sigma
    if signs:
        warnings.append(f"{signs} photographs: EXIF and XMP disagree on the hemisphere: that of XMP is taken")
    if bare:
        warnings.append(
            f"{bare} photographs give longitude or latitude without E, W, N, S: taken as east and north"
        )
    kept = places(frames.t, lonlat, frames.names, str(frames.path), warnings)
    if not kept.any():
        return None
    lonlat[~kept] = np.where(np.isfinite(lonlat[~kept]), lonlat[~kept], 0.0)
    lonlat = _with_heights(file, lonlat, str(frames.path))
    position = _geodetic(file, lonlat)
    return _in_time(np.arange(len(kept)), frames.t, position, sigma, kept, _level_axes(file, position))


def place_of(exif: Exif | None, xmp: Xmp | None) -> tuple[tuple[float, float, float], bool]:
    """Longitude, latitude (degrees), height of a photograph, NaN where not told; whether a sign was XMP's."""
    if exif is None or exif.longitude_deg is None or exif.latitude_deg is None:
        return (np.nan, np.nan, np.nan), False
    lon, lat = exif.longitude_deg, exif.latitude_deg
    turned = False
    if xmp is not None and xmp.longitude_deg is not None and xmp.latitude_deg is not None:
        turned = lon * xmp.longitude_deg < 0.0 or lat * xmp.latitude_deg < 0.0
        if turned:
            lon, lat = np.copysign(lon, xmp.longitude_deg), np.copysign(lat, xmp.latitude_deg)
    return (float(lon), float(lat), np.nan if exif.height is None else exif.height), turned


def _level(position: Array, radii: tuple[float, float] | None) -> Rotation:
    """World from east, north, up at positions (M, 3)."""
    up, east, north = level_axes(position, radii)
    return Rotation.from_matrix(np.stack([east, north, up], axis=-1))


def _attitudes(
    file: SequenceFile,
    files: InputFolder,
    frames: FrameList,
    mount: Rotation,
    position: Array,
    warnings: list[str],
) -> Told | None:
    """Attitudes that are told (quaternions world_from_body of computation); None where there are none."""
    radii = radii_of(file)
    if file.attitudes is not None:
        path = files(file.attitudes)
        told = _table_attitudes(file, path, frames, mount, position)
    elif frames.xmp:
        path, told = frames.path, _gimbal_attitudes(file, frames, mount, position)
    else:
        return None
    if told is None:
        return None
    down = -level_axes(_position_at(frames.t, position, told.t), radii)[0]
    looks = Rotation.from_quat(told.values).apply(mount.as_matrix()[:, 2])
    off = np.arccos(np.clip(np.einsum("ni,ni->n", down, looks), -1.0, 1.0))
    wrong = off > _OFF_NADIR
    if wrong.all():
        raise FormatError(
            f"{path}: by these attitudes the camera looks {np.degrees(np.median(off)):.0f} degrees "
            "from straight down, "
            "away from the ground, in every frame; check qx,qy,qz,qw (world_from_body, scalar last), "
            "[camera] mount, "
            "and [world]; or remove the attitudes"
        )
    if wrong.any():
        name = (
            frames.names[told.frame[wrong][0]] if told.frame[wrong][0] >= 0 else f"t = {told.t[wrong][0]:g}"
        )
        warnings.append(
            f"{path.name}: {int(wrong.sum())} attitudes look away from the ground (first: {name}): left out"
        )
    return _in_time(told.frame, told.t, told.values, told.sigma, ~wrong)


def _position_at(t: Array, position: Array, at: Array) -> Array:
    """Positions (n, 3) at other times than those of the frames."""
    return np.column_stack([np.interp(at, t, axis) for axis in position.T])


def _table_attitudes(
    file: SequenceFile, path: Path, frames: FrameList, mount: Rotation, position: Array
) -> Told | None:
    header = header_of(path)
    kind = kind_of_angles(path)
    with_sigma = [name for name in ATTITUDE_SIGMAS if name in header]
    if with_sigma and len(with_sigma) < 3:
        raise FormatError(
            f"{path}: has {', '.join(with_sigma)} alone; sigma_roll,sigma_pitch,sigma_yaw are expected"
        )
    angles = QUATERNION if kind is None else kind
    timed = ("t",) if "t" in header or kind is None else ()
    table = read_columns(
        path, ("frame", *timed, *angles, *with_sigma), text=("frame",), infinite=ATTITUDE_SIGMAS
    )
    names = tuple(str(word) for word in table["frame"])
    frame, t = _matched(path, frames, names, np.asarray(table["t"], dtype=np.float64) if timed else None)
    values = np.column_stack([np.asarray(table[name], dtype=np.float64) for name in angles])
    if kind is None:
        attitude = attitude_to_world(Rotation.from_quat(check_quaternions(path, values)), file)
    else:
        level = _level(_position_at(frames.t, position, np.nan_to_num(t)), radii_of(file))
        body = camera_of_opk(values) * mount.inv() if kind == OPK else body_of_ypr(values)
        attitude = level * body
    sigma = _sigmas(path, table, with_sigma, len(t), file.attitude_sigma)
    return _in_time(frame, t, attitude.as_quat(), sigma, np.ones(len(t), dtype=np.bool_))


def _gimbal_attitudes(file: SequenceFile, frames: FrameList, mount: Rotation, position: Array) -> Told | None:
    """Attitudes by the gimbals of photographs."""
    rows, turns = [], []
    for k, xmp in enumerate(frames.xmp):
        camera = None if xmp is None else xmp.north_east_down_from_camera()
        if camera is not None:
            rows.append(k)
            turns.append(camera)
    if not rows:
        return None
    frame = np.array(rows, dtype=np.intp)
    body = _level(position[frame], radii_of(file)) * _ENU_FROM_NED * Rotation.concatenate(turns) * mount.inv()
    sigma = np.full((len(rows), 3), file.attitude_sigma)
    return _in_time(frame, frames.t[frame], body.as_quat(), sigma, np.ones(len(rows), dtype=np.bool_))


def track_attitude(t: Array, position: Array, sigma: Array, radii: tuple[float, float] | None) -> Rotation:
    """Attitudes that look straight down, nose along the track, which noise of positions must not hide.

    Parameters
    ----------
    t : (M,)
        s.
    position : (M, 3)
        m, world axes.
    sigma : (M, 3)
        m, their 1-sigma.
    radii : (float, float) or None
        Of the ellipsoid; None where the world is flat.

    Returns
    -------
    Rotation
        M of them; to the north where nothing moves.
    """
    up, _, north = level_axes(position, radii)
    count = len(t)
    known = sigma[np.isfinite(sigma)]
    apart = _HEADING_SIGMAS * float(np.median(known)) if len(known) else 0.0
    half, at = 1, np.arange(count)
    while True:
        move = position[np.minimum(at + half, count - 1)] - position[np.maximum(at - half, 0)]
        level = move - np.einsum("ni,ni->n", move, up)[:, None] * up
        length = np.linalg.norm(level, axis=1)
        if float(np.median(length)) > apart or half >= count:
            break
        half *= 2
    still = length <= 0.0
    forward = np.where(still[:, None], north, level / np.where(still, 1.0, length)[:, None])
    return Rotation.from_matrix(np.stack([forward, np.cross(-up, forward), -up], axis=-1))
