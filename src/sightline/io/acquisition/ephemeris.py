"""Orbits and attitudes of files, in whatever axes → Earth-fixed; attitudes that end early are continued.

Tables (CSV), CCSDS messages and SBET. What was understood, what is doubted and what it adds to the sigma of
the attitude is kept by the `InputFolder`.

Not here: axes of ``[world]`` (``platform.py``), how the Earth is turned (``geometry/earth_orientation.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, SpanError
from sightline.geometry.earth import WGS84
from sightline.geometry.earth_orientation import AXES
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.schema import AcquisitionFile, EphemerisPlatform, SpinPlatform
from sightline.io.acquisition.spin import must_cover
from sightline.io.formats import ccsds, ccsds_attitude, mean_elements, sbet, sentinel1, tables
from sightline.io.formats.ccsds_message import body_of, is_earth
from sightline.io.formats.earth_orientation import TurningEarth

Array = NDArray[np.float64]
Span = tuple[float, float]

#: Steps of a table of attitudes over which it is continued.
_CONTINUED = 2.0
#: Rows at an end of a table whose second differences say how straight it runs.
_END_ROWS = 12
#: m on the ground from which on an error of the Earth's orientation is doubted.
_FAR = 1.0


#: s by which times of a message are rounded at most: 1e-9, and instants far from t = 0 in double.
_ROUNDED = 1e-6


@dataclass(frozen=True, eq=False)
class GivenOrbit:
    """Positions of a file.

    Attributes
    ----------
    t : (N,)
        s.
    position : (N, 3)
        m, or as of ``[world]``.
    velocity : (N, 3) or None
        m/s.
    axes : str or None
        Of a message: a key of ``AXES``, or a name of axes fixed to another body; None: those of ``[world]``.
    centre : str
    useable : (first, last)
        s.
    sigma : float or None
        m per axis.
    words : str
        What the file is.
    doubt : str
        What it is not good for.
    """

    t: Array
    position: Array
    velocity: Array | None = None
    axes: str | None = None
    centre: str = ""
    useable: Span = (-np.inf, np.inf)
    sigma: float | None = None
    words: str = ""
    doubt: str = ""


@dataclass(frozen=True, eq=False)
class GivenAttitude:
    """Attitudes of a file: quaternions (N, 4) from body axes, scalar last; the rest as of `GivenOrbit`."""

    t: Array
    quat_xyzw: Array
    axes: str | None = None
    centre: str = ""
    useable: Span = (-np.inf, np.inf)
    words: str = ""
    doubt: str = ""


_Given = TypeVar("_Given", GivenOrbit, GivenAttitude)


def earth_of(config: AcquisitionFile, files: InputFolder) -> TurningEarth:
    """The turning Earth of ``[platform] earth_orientation``."""
    platform = config.platform
    named = platform.earth_orientation if isinstance(platform, EphemerisPlatform | SpinPlatform) else None
    return TurningEarth(config.acquisition.epoch, None if named is None else files(named))


def read_orbit(
    path: Path, epoch: str | None, *, span: Span | None = None, earth: TurningEarth | None = None
) -> GivenOrbit:
    """Positions of a CSV table, ours or of Sentinel-1, a CCSDS OEM or OMM, two-line elements or a SBET."""
    if sentinel1.is_sentinel1(path):
        t, position, velocity = sentinel1.read_sentinel1_orbit(path, ccsds.need_epoch(path, epoch))
        return GivenOrbit(t, position, velocity, "ITRF", "EARTH", words="an orbit of Sentinel-1, Earth-fixed")
    if sbet.is_sbet(path):
        flown = sbet.read_sbet(path, epoch, span)
        return GivenOrbit(
            flown.t, flown.position, axes="ITRF", centre="EARTH", words=flown.words, doubt=flown.doubt
        )
    kind = ccsds.is_ccsds(path, "OEM", "OMM")
    if kind is None and mean_elements.is_tle(path):
        kind = "TLE"
    if kind in ("TLE", "OMM"):
        return _propagated(path, kind, ccsds.need_epoch(path, epoch), span or (0.0, 0.0))
    if kind == "OEM":
        start = ccsds.need_epoch(path, epoch)
        earth = earth or TurningEarth(start)
        orbit = ccsds.read_oem(path, start, span=span, ut1_less_utc=earth.ut1_less_utc)
        words = f"an OEM about {orbit.centre.title()}, axes {orbit.axes}, times in {orbit.time_scale}"
        return GivenOrbit(
            orbit.t, orbit.position, orbit.velocity, orbit.axes, orbit.centre, orbit.useable, orbit.sigma,
            words + _joined(orbit.segments),
        )  # fmt: skip
    return GivenOrbit(*tables.read_positions(path))


def _propagated(path: Path, kind: str, epoch: str, span: Span) -> GivenOrbit:
    """Positions by mean elements, with their error."""
    read = mean_elements.read_tle if kind == "TLE" else mean_elements.read_omm
    orbit = read(path, epoch, span)
    when = f"{abs(orbit.age):.2g} days {'before' if orbit.age >= 0.0 else 'after'} the images"
    return GivenOrbit(
        orbit.t, orbit.position, orbit.velocity, "TEME", "EARTH", sigma=orbit.sigma,
        words=f"{'a TLE' if kind == 'TLE' else 'an OMM'} of {orbit.name}, of {when}, by SGP4 in axes TEME",
        doubt=f"{path.name}: mean elements of {when} are good to some {orbit.sigma / 1e3:.2g} km (1 km at "
        "their epoch, 2 km more with every day, 1 sigma); give an OEM or a table where places matter",
    )  # fmt: skip


def read_attitude(
    path: Path, epoch: str | None, *, span: Span | None = None, earth: TurningEarth | None = None
) -> GivenAttitude:
    """Attitudes of a CSV table, ours or of Sentinel-1, a CCSDS AEM or APM, or of a SBET."""
    if sentinel1.is_sentinel1(path):
        sensed = sentinel1.read_sentinel1_attitude(path, ccsds.need_epoch(path, epoch))
        apart = float(np.sqrt((sensed.apart**2).mean()))
        return GivenAttitude(
            sensed.t, sensed.inertial_from_body.as_quat(), "EME2000", "EARTH",
            words="attitudes of Sentinel-1 (GM2000), brought to the axes of its rates: x ahead, y right, z "
            f"the antenna's look; rates and quaternions agree to {apart:.2g} rad/s (rms)",
            doubt=f"{path.name}: {sensed.doubt}" if sensed.doubt else "",
        )  # fmt: skip
    if sbet.is_sbet(path):
        flown = sbet.read_sbet(path, epoch, span)
        return GivenAttitude(
            flown.t, flown.fixed_from_body.as_quat(), "ITRF", "EARTH", words=f"attitudes of {flown.words}"
        )
    kind = ccsds.is_ccsds(path, "AEM", "APM")
    if kind is None:
        return GivenAttitude(*tables.read_attitudes(path))
    start = ccsds.need_epoch(path, epoch)
    earth = earth or TurningEarth(start)
    read = ccsds_attitude.read_aem if kind == "AEM" else ccsds_attitude.read_apm
    given = read(path, start, span=span, ut1_less_utc=earth.ut1_less_utc)
    words = f"an {kind}, axes {given.axes}, times in {given.time_scale}{_joined(given.segments)}"
    return GivenAttitude(
        given.t, given.quat_xyzw, given.axes, given.centre, given.useable,
        f"{words}; {given.words}" if given.words else words,
    )  # fmt: skip


def _joined(segments: int) -> str:
    return f", {segments} segments joined" if segments > 1 else ""


def fixed_orbit(
    config: AcquisitionFile, path: Path, span: Span, earth: TurningEarth, files: InputFolder
) -> GivenOrbit:
    """Positions of a file that reach over a span (s), Earth-fixed (or fixed to their body) of messages."""
    given = read_orbit(path, config.acquisition.epoch, span=span, earth=earth)
    given = _to_the_ends(_of_table(given, config, "position_axes", path), span)
    must_cover(path, "positions", given.t[_rows(given.t, given.useable, span)], span)
    if given.axes is None:
        return given
    if config.world.frame != "earth-fixed":
        raise FormatError(
            f"{path}: a message is in axes of its own, Earth-fixed at the end; [world] frame must be "
            '"earth-fixed" or left out'
        )
    _check_body(path, given.axes, given.centre, config.surface.radii)
    files.said.append(f"{path.name}: {given.words}")
    if is_inertial(given.axes):
        fixed = earth.axes(given.axes, given.t)
        velocity = None if given.velocity is None else fixed.velocities(given.position, given.velocity)
        given = replace(given, position=fixed.positions(given.position), velocity=velocity)
    if given.doubt:
        files.doubts.append(given.doubt)
    if given.sigma:
        angle = given.sigma / _height(given, span, config.surface.radii)
        files.attitude_sigmas.append(angle)
        files.said.append(
            f"{path.name}: known to {given.sigma:.3g} m per axis, which counts as {angle:.2g} rad of attitude"
        )
    return given


def fixed_attitude(
    config: AcquisitionFile,
    path: Path,
    span: Span,
    earth: TurningEarth,
    files: InputFolder,
    places: tuple[Path, GivenOrbit],
) -> tuple[Array, Rotation, str | None]:
    """Times (N,), attitudes of a file that reach over a span (s), and the axes it was in.

    Those of a message are Earth-fixed (or fixed to its body: that of `places`); None: axes of ``[world]``.
    """
    given = read_attitude(path, config.acquisition.epoch, span=span, earth=earth)
    given = _to_the_ends(_of_table(given, config, "attitude_axes", path), span)
    kept = _rows(given.t, given.useable, span)
    t, attitude = continued(path, given.t[kept], Rotation.from_quat(given.quat_xyzw[kept]), span, files)
    if given.axes is None:
        return t, attitude, None
    if config.world.frame == "local":
        raise FormatError(f'{path}: a message is in axes of its own; [world] frame = "local" is for tables')
    _check_body(path, given.axes, given.centre, config.surface.radii)
    _check_one_body((path, given), places)
    if given.doubt:
        files.doubts.append(given.doubt)
    files.said.append(f"{path.name}: {given.words}")
    if is_inertial(given.axes):
        attitude = Rotation.from_matrix(earth.axes(given.axes, t).turn) * attitude
    return t, attitude, given.axes


def _to_the_ends(given: _Given, span: Span) -> _Given:
    """The same where its times end at a span but for what messages round: moved there."""
    t, (begin, end) = given.t.copy(), given.useable
    if span[0] < t[0] <= span[0] + _ROUNDED:
        t[0], begin = span[0], min(begin, span[0])
    if span[1] - _ROUNDED <= t[-1] < span[1]:
        t[-1], end = span[1], max(end, span[1])
    return replace(given, t=t, useable=(begin, end))


def _of_table(given: _Given, config: AcquisitionFile, key: str, path: Path) -> _Given:
    """The same in the axes of a key of ``[platform]``, for tables; a message says its own."""
    axes = getattr(config.platform, key, None)
    if axes is None:
        return given
    if given.axes is not None:
        raise FormatError(f"{path}: is a message, which says its axes itself; remove [platform] {key}")
    return replace(given, axes=axes, words=f"a table, axes {axes}")


def _rows(t: Array, useable: Span, span: Span) -> NDArray[np.bool_]:
    """Rows of a table that serve a span: those beyond what is useable only where it reaches over the span."""
    inside = (t >= useable[0]) & (t <= useable[1])
    reaches = useable[0] <= span[0] and span[1] <= useable[1]
    return np.ones(len(t), dtype=np.bool_) if reaches or inside.sum() < 2 else inside


def _check_body(path: Path, axes: str, centre: str, radii: tuple[float, float] | None) -> None:
    """FormatError where axes and body do not go together."""
    fixed = axes not in AXES
    if is_earth(centre) and not fixed:
        return
    name = centre.title() or "another body"
    if axes == "ITRF" or (fixed and centre and is_earth(centre)):
        raise FormatError(
            f"{path}: axes of another body than its CENTER_NAME = {centre}; correct one of both"
        )
    if not fixed:
        raise FormatError(
            f"{path}: axes {axes} about {name}: how {name} turns is known here of the Earth alone; convert "
            "to axes fixed to it (IAU_MARS for Mars), or make an ISD with its kernels (kind = camera-model)"
        )
    if radii is None:
        raise FormatError(
            f"{path}: axes fixed to {name}; give its [surface] radii = [equatorial, polar] in m"
        )


def _check_one_body(attitudes: tuple[Path, GivenAttitude], places: tuple[Path, GivenOrbit]) -> None:
    """FormatError where attitudes and positions of messages are in axes of unlike bodies."""
    said = [(path, given.axes, given.centre) for path, given in (places, attitudes) if given.axes is not None]
    bodies = [body_of(axes, centre) for _, axes, centre in said]
    if len(said) < 2 or not all(bodies) or bodies[0] == bodies[1]:
        return
    (place, axes, _), (path, other, _) = said
    raise FormatError(
        f"{place}: positions are in axes {axes} ({bodies[0].title()}), the attitudes of {path} in axes "
        f"{other} ({bodies[1].title()}); give both in axes of the body that is imaged"
    )


def is_inertial(axes: str | None) -> bool:
    """Whether axes turn against those fixed to a body."""
    return axes in AXES and axes != "ITRF"


def _height(given: GivenOrbit, span: Span, radii: tuple[float, float] | None) -> float:
    """m above the ground in the middle of a span, 1 km at least."""
    row = int(np.argmin(np.abs(given.t - 0.5 * sum(span))))
    return max(float(np.linalg.norm(given.position[row])) - max(radii or WGS84), 1e3)


def continued(
    path: Path, t: Array, attitude: Rotation, span: Span, files: InputFolder
) -> tuple[Array, Rotation]:
    """Attitudes that reach over a span: by at most two steps they are continued evenly, said, with a sigma.

    Raises
    ------
    SpanError
        If they end more than two of their steps before the images do, or begin so late.
    """
    missing = max(t[0] - span[0], 0.0), max(span[1] - t[-1], 0.0)
    if not any(missing):
        return t, attitude
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if max(missing) > _CONTINUED * step:
        try:
            must_cover(path, "attitudes", t, span)
        except SpanError as error:
            raise SpanError(
                f"{error}; they are continued by two of their steps at most ({step:.6g} s)"
            ) from None
    parts_t, parts, sigma = [t], [attitude], 0.0
    for ahead, share in ((False, missing[0] / step), (True, missing[1] / step)):
        if share <= 0.0:
            continue
        end, before = (-1, -2) if ahead else (0, 1)
        pace = (attitude[before].inv() * attitude[end]).as_rotvec() / abs(t[end] - t[before])
        further = attitude[end] * Rotation.from_rotvec(pace * share * step)
        parts_t.insert(len(parts_t) if ahead else 0, np.array([t[end] + (share if ahead else -share) * step]))
        parts.insert(len(parts) if ahead else 0, Rotation.concatenate([further]))
        sigma = max(sigma, _unevenness(t, attitude, ahead) * (share * step) * (share * step + step) / 2.0)
    files.attitude_sigmas.append(sigma)
    files.doubts.append(
        f"{path.name}: attitudes end {max(missing):.4g} s ({max(missing) / step:.2g} of their steps) "
        "before the "
        f"images do, or begin so late; they are continued evenly, known to {sigma:.2g} rad there"
    )
    return np.concatenate(parts_t), Rotation.concatenate(parts)


def _unevenness(t: Array, attitude: Rotation, ahead: bool) -> float:
    """rad/s^2, rms per axis; how much the rate of attitudes changes at an end of their table."""
    rows = slice(-_END_ROWS, None) if ahead else slice(0, _END_ROWS)
    t, attitude = t[rows], attitude[rows]
    rates = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / np.diff(t)[:, np.newaxis]
    if len(rates) < 2:
        return float(np.abs(rates).max()) / float(np.diff(t)[0])
    middle = 0.5 * (t[:-1] + t[1:])
    return float(np.sqrt(np.mean((np.diff(rates, axis=0) / np.diff(middle)[:, np.newaxis]) ** 2)))


def say_orientation(
    earth: TurningEarth, orbit: GivenOrbit | None, attitude: str | None, span: Span,
    radii: tuple[float, float] | None, files: InputFolder,
) -> None:  # fmt: skip
    """What the Earth's orientation, where axes of the stars needed it, adds to the sigma of the attitude."""
    turned = [is_inertial(axes) for axes in (orbit.axes if orbit else None, attitude)]
    if not any(turned):
        return
    middle = 0.5 * sum(span)
    sigma = earth.angle_sigma(middle)
    arm, height = 1.0, 0.0
    if turned[0] and orbit is not None:
        height = _height(orbit, span, radii)
        # where both turn the ground moves below them, where the orbit alone does the orbit
        arm = (WGS84[0] if turned[1] else WGS84[0] + height) / height
    files.attitude_sigmas.append(arm * sigma)
    ground = sigma * (WGS84[0] if turned[0] else 0.0)
    moved = f", {ground:.2g} m on the ground" if ground else ""
    words = f"{earth.words(middle)}{moved}"
    if ground > _FAR or not earth.table.covers(earth.day(middle)):
        files.doubts.append(
            f"{words}; taken into the sigma of the attitude ({arm * sigma:.2g} rad); give [platform] "
            "earth_orientation = a newer file of the IERS (finals2000A or C04)"
        )
    else:
        files.said.append(words)
