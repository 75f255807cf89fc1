"""Other ways to scan, other detectors: the instruments of S1's claims 14 to 20 and 22, over a real orbit.

Every case flies a circular orbit over the turning ellipsoid. A pushbroom camera is carried by the orbit, a
spinning platform (S1, fig. 16) or a scan mirror (fig. 17) sweeps the detector lines over the ground; the
focal planes are those of figs 18 to 20. :func:`instrument_case` draws everything random from one seed.

Not here: the reference strips over a flat world (``scenarios.py``); rendering (``earth_view.py``); files
(``instrument_files.py``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.circular_orbit import CircularOrbit
from sightline.geometry.earth import EARTH_RATE
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount, Pointing, ScanMirror
from sightline.geometry.rotations import orbital_axes
from sightline.geometry.spin import Spin
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.simulate.earth_view import ViewPlane, earth_chunks
from sightline.simulate.jitter import nominal_profile
from sightline.simulate.option_checks import (
    MOST_COLUMNS,
    MOST_LINES,
    check_names,
    check_options,
    options_of,
)
from sightline.simulate.rendered import RenderedStrip
from sightline.simulate.scenarios import GROUND_MARGIN_PX, MOTION_MARGIN_LINES, motion_profile
from sightline.simulate.scene import Scene, TextureLaw, scene_layers
from sightline.simulate.sensor import Radiometry
from sightline.simulate.strip_options import MOTIONS
from sightline.simulate.texture import Array

_TRUE_STEP, _MARGIN = 0.1, 3.0
"""s between the nodes of the true trajectory, and beyond the strip on both sides."""


@dataclass(frozen=True)
class DetectorOptions:
    """One detector line of a focal plane.

    Parameters
    ----------
    name : str
        Of it, and of its image.
    behind : float
        px (of the first detector) by which it looks behind the first: lines until it sees the same ground.
    columns : int
        px; 0: those of the instrument.
    aside : float
        px of its own, from the middle of the focal plane towards larger columns.
    fineness : float
        Its IFOV over that of the first detector.
    gain, gamma : float
        Of its brightness: factor and exponent.
    """

    name: str
    behind: float
    columns: int = 0
    aside: float = 0.0
    fineness: float = 1.0
    gain: float = 1.0
    gamma: float = 1.0

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "behind": (-1e5, 1e5), "columns": (0, MOST_COLUMNS), "aside": (-1e5, 1e5), "fineness": (0.1, 10.0),
        "gain": (0.01, 3.0), "gamma": (0.1, 3.0),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        check_options(self)
        if 0 < self.columns < 16:
            raise InputError(f"`columns` of a detector must be 16 or more, or 0, got {self.columns}")


_COLOURS = (
    DetectorOptions("PAN", 0.0),
    DetectorOptions("B1", 97.0, gain=0.85, gamma=0.9),
    DetectorOptions("B0", 110.0, gain=0.9),
    DetectorOptions("B2", 143.0, gain=0.8, gamma=0.8),
)
"""Four bands some mm apart, at lags that share no multiple within the lines' Nyquist frequency."""


@dataclass(frozen=True)
class InstrumentOptions:
    """An instrument, its orbit and how it looks at the ground.

    Parameters
    ----------
    scan : str
        "pushbroom", "spin" or "mirror".
    altitude : float
        m, of the circular orbit.
    inclination : float
        rad, of the orbit.
    off_nadir : float
        rad, of the line of sight in the middle of the strip.
    ifov : float
        rad per pixel of the first detector.
    line_period : float
        s; spin and mirror turn the line of sight by ``ifov / line_period``, which covers the ground evenly.
    lines, columns : int
        Of every image.
    detectors : tuple of DetectorOptions
        The detector lines of the focal plane.
    pairs : tuple of (str, str)
        Pairs to match, by name; empty: all.
    coherence : float
        Amplitude correlation of the textures of any two bands.
    snr : float
        Mean over noise.
    contrast : float
        Standard deviation over mean of the ground.
    mtf_nyquist : float
        System MTF at half a cycle per pixel.
    offset_sigma_px : float
        px, size of the unknown offsets of the detector lines.
    rotation_sigma : float
        rad, size of their unknown rotations.
    motion : str
        One of those of a strip.
    """

    scan: str = "pushbroom"
    altitude: float = 680e3
    inclination: float = np.radians(98.0)
    off_nadir: float = np.radians(20.0)
    ifov: float = 5e-6
    line_period: float = 5e-4
    lines: int = 1500
    columns: int = 640
    detectors: tuple[DetectorOptions, ...] = _COLOURS
    pairs: tuple[tuple[str, str], ...] = ()
    coherence: float = 0.97
    snr: float = 120.0
    contrast: float = 0.2
    mtf_nyquist: float = 0.15
    offset_sigma_px: float = 1.0
    rotation_sigma: float = 3e-4
    motion: str = "nominal"

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "scan": ("pushbroom", "spin", "mirror"), "motion": MOTIONS,
    }  # fmt: skip
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "altitude": (1e5, 1e8), "inclination": (0.0, np.pi), "off_nadir": (-1.5, 1.5), "ifov": (1e-8, 1e-2),
        "line_period": (1e-5, 0.05), "lines": (16, MOST_LINES), "columns": (16, MOST_COLUMNS),
        "coherence": (0.01, 1.0), "snr": (0.1, 1e5), "contrast": (0.0, 10.0), "mtf_nyquist": (1e-3, 0.9),
        "offset_sigma_px": (0.0, 1e3), "rotation_sigma": (0.0, 0.1),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_options(self)
        names = tuple(detector.name for detector in self.detectors)
        if not names:
            raise InputError("`detectors` must hold one detector line or more, got none")
        check_names("detectors", names)
        for pair in self.pairs:
            if not set(pair) <= set(names) or pair[0] == pair[1]:
                raise InputError(f"`pairs` must be of two of {', '.join(names)}, got {' and '.join(pair)}")
        limit = 0.98 * np.arcsin(6.35e6 / (6.37e6 + self.altitude))
        if not abs(self.off_nadir) < limit:
            raise InputError(
                "the middle of the strip looks past the Earth: off-nadir angle "
                f"{np.degrees(self.off_nadir):.4g} degrees; from {self.altitude / 1e3:.0f} km up to "
                f"{np.degrees(limit):.3g} are seen"
            )

    @property
    def duration(self) -> float:
        """s from the first line to the last."""
        return (self.lines - 1) * self.line_period

    @property
    def scan_rate(self) -> float:
        """rad/s at which spin or mirror carries the line of sight over one line per line period."""
        return self.ifov / self.line_period

    def width(self, detector: DetectorOptions) -> int:
        """Columns of a detector."""
        return detector.columns or self.columns

    @property
    def half_field(self) -> float:
        """rad from the middle of the first detector to its end."""
        return 0.5 * (self.width(self.detectors[0]) - 1) * self.ifov

    @property
    def rad_per_px(self) -> Array:
        """(3,) rad of one pixel of roll and pitch, and of yaw at the edge of the field.

        Behind a mirror, which looks far from the body's z, yaw shifts the whole image as roll and pitch do:
        one pixel of it is as small as theirs.
        """
        lever = 1.0 if self.scan == "mirror" else self.half_field
        return np.array([self.ifov, self.ifov, self.ifov / lever])


def _case(**changes: Any) -> dict[str, Any]:
    return changes


_GEO = {"altitude": 35_786e3, "inclination": np.radians(0.1), "ifov": 28e-6, "off_nadir": np.radians(5.0)}
# One lag alone, blind at its multiples: seen 20 degrees off the nadir it is 7 periods of the tone of 47 Hz.
_PAIR = (DetectorOptions("CCD1", 0.0, 500, -226.0), DetectorOptions("CCD2", 275.0, 500, 226.0))


def _lines_of(
    name: str, behind: float, numbers: tuple[int, ...], **others: Any
) -> tuple[DetectorOptions, ...]:
    """Some lines of a detector of many, each as an image."""
    return tuple(
        DetectorOptions(f"{name}{k:02d}", behind + k * others.get("fineness", 1.0), **others) for k in numbers
    )


#: One filter: nothing but noise distinguishes the images.
_SAME = {"coherence": 1.0, "rotation_sigma": 1e-5, "offset_sigma_px": 0.1}

INSTRUMENT_OPTIONS: dict[str, dict[str, Any]] = {
    "pushbroom": {},
    # 2 turns per minute, as JunoCam's spacecraft; 1 turn per minute
    "spin-leo": _case(scan="spin", altitude=700e3, ifov=1e-4, line_period=1e-4 / 0.20944),
    "spin-geo": _case(scan="spin", **_GEO, line_period=28e-6 / 0.10472),
    "mirror-leo": _case(scan="mirror", altitude=700e3, ifov=42e-6),
    "mirror-geo": _case(scan="mirror", **_GEO),
    "staggered": _case(detectors=_PAIR, coherence=1.0),
    "every-line": _case(
        detectors=_lines_of("L", 0.0, tuple(range(0, 64, 4))),
        pairs=(("L00", "L20"), ("L00", "L36"), ("L00", "L48"), ("L00", "L60")),
        **_SAME,
    ),
    "dedicated-matrix": _case(
        columns=1000,
        detectors=(
            DetectorOptions("PAN", 0.0),
            *_lines_of("M", 300.0, (0, 37, 99), columns=100, fineness=0.8),
        ),
    ),
    "dedicated-strip": _case(
        columns=1000, detectors=(DetectorOptions("PAN", 0.0), *_lines_of("S", 300.0, (0, 4, 9)))
    ),
    "multi-line": _case(detectors=_lines_of("T", 0.0, (0, 23, 41, 63)), **_SAME),
}
"""What each case changes."""

INSTRUMENT_CASES = tuple(INSTRUMENT_OPTIONS)
"""Names of the cases."""


@dataclass(frozen=True, eq=False)
class DetectorTruth:
    """One detector line: what is given of it and what is true.

    Parameters
    ----------
    options : DetectorOptions
    look_ahead : float
        rad, nominal viewing angle along the scan.
    offset_px : (float, float)
        True offset beyond the nominal, forward and towards larger columns.
    rotation : float
        rad, true rotation; nominally 0.
    nominal, true : LineDetector
    """

    options: DetectorOptions
    look_ahead: float
    offset_px: tuple[float, float]
    rotation: float
    nominal: LineDetector
    true: LineDetector

    @property
    def name(self) -> str:
        """Name of its image."""
        return self.options.name


@dataclass(frozen=True, eq=False)
class InstrumentScenario(RenderedStrip):
    """A strip of one instrument: truth, what a user would know, and the images.

    Parameters
    ----------
    case : str
    seed : int
    options : InstrumentOptions
    bands : tuple of DetectorTruth
    orbit : CircularOrbit
    spin : Spin or None
        Of a spinning platform.
    reference : Trajectory
        As planned, without the motion.
    pointing : Pointing
        Mount, or mirror.
    motion, body : Motion
        True motion of the line of sight, and the part of it that attitude sensors feel.
    radiometry : Radiometry
    """

    case: str
    seed: int
    options: InstrumentOptions
    bands: tuple[DetectorTruth, ...]
    orbit: CircularOrbit
    spin: Spin | None
    reference: Trajectory
    pointing: Pointing
    motion: Motion
    body: Motion
    radiometry: Radiometry

    def _camera(self, detector: LineDetector, trajectory: Trajectory) -> PushbroomCamera:
        return PushbroomCamera(detector, trajectory, self.pointing, 0.0, self.options.lines)

    @cached_property
    def cameras(self) -> tuple[PushbroomCamera, ...]:
        """The true cameras, one per detector line."""
        trajectory = self.reference.with_motion(self.motion)
        return tuple(self._camera(band.true, trajectory) for band in self.bands)

    @cached_property
    def nominal_cameras(self) -> tuple[PushbroomCamera, ...]:
        """The cameras as the ACQUISITION file gives them: no motion, nominal detectors."""
        return tuple(self._camera(band.nominal, self.reference) for band in self.bands)

    @cached_property
    def plane(self) -> ViewPlane:
        """Coordinates in which the ground's brightness is given."""
        return ViewPlane.of(self.nominal_cameras[0])

    @cached_property
    def scene(self) -> Scene:
        """The ground, drawn when first asked for."""
        options = self.options
        extent = self.plane.extent(list(self.nominal_cameras), GROUND_MARGIN_PX)
        law = TextureLaw(options.contrast, self.plane.pixel, options.mtf_nyquist)
        gains = tuple(band.options.gain for band in self.bands)
        gammas = tuple(band.options.gamma for band in self.bands)
        weights = (options.coherence**0.5,) * len(gains)
        return Scene(*scene_layers(self._stream("texture"), extent, law, weights, gains, gammas))

    def chunks(self, band: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """Image of one band as (first line, block of lines), top to bottom; again alike at every call."""
        noise = self._stream("noise").spawn(len(self.bands))[band]
        yield from earth_chunks(self.cameras[band], self.scene, self.plane, band, self.radiometry, noise)

    def _stream(self, purpose: str) -> np.random.SeedSequence:
        return _streams(self.seed)[purpose]


def _streams(seed: int) -> dict[str, np.random.SeedSequence]:
    """The independent random streams of a scenario, by purpose."""
    purposes = ("motion", "detectors", "texture", "noise")
    return dict(zip(purposes, np.random.SeedSequence([seed, 16]).spawn(len(purposes)), strict=True))


def instrument_case(case: str, seed: int = 0, **overrides: Any) -> InstrumentScenario:
    """A strip of a named instrument.

    Parameters
    ----------
    case : str
        One of `INSTRUMENT_CASES`.
    seed : int
        Decides everything that is random.
    **overrides
        Fields of :class:`InstrumentOptions`.

    Returns
    -------
    InstrumentScenario

    Raises
    ------
    InputError
        Unknown case or option, or a view past the Earth.

    Examples
    --------
    >>> scenario = instrument_case("spin-leo", 0, lines=64, columns=64)
    >>> scenario.image(0).shape
    (64, 64)
    """
    options = options_of(InstrumentOptions, INSTRUMENT_OPTIONS, case, overrides)
    streams = _streams(seed)
    # a low orbit north of the equator, a geostationary one near its node: latitudes of 40 and 0 degrees
    orbit = CircularOrbit(options.altitude, options.inclination, 0.2, 0.7 if options.altitude < 2e6 else 0.0)
    spin = _spin(options, orbit) if options.scan == "spin" else None
    lines = np.arange(-MOTION_MARGIN_LINES, options.lines + MOTION_MARGIN_LINES, dtype=np.float64)
    profile = nominal_profile() if options.motion == "nominal" else motion_profile(options.motion)
    motion, body = profile.draw(lines * options.line_period, options.rad_per_px, streams["motion"])
    return InstrumentScenario(
        case,
        seed,
        options,
        _draw_detectors(options, streams["detectors"]),
        orbit,
        spin,
        _reference(options, orbit, spin),
        _pointing(options),
        motion,
        body,
        Radiometry(snr=options.snr),
    )


def _draw_detectors(options: InstrumentOptions, seed: np.random.SeedSequence) -> tuple[DetectorTruth, ...]:
    rng = np.random.default_rng(seed)
    out = []
    for detector in options.detectors:
        offset = options.offset_sigma_px * rng.standard_normal(2)
        rotation = float(options.rotation_sigma * rng.standard_normal())
        look_ahead = float(np.arctan(-detector.behind * options.ifov)) + 0.0
        nominal, true = (
            LineDetector.from_ifov(
                detector.name,
                options.width(detector),
                options.ifov * detector.fineness,
                options.line_period,
                look_ahead=look_ahead,
                offset_px=(line, detector.aside + column),
                rotation=turn,
            )
            for line, column, turn in ((0.0, 0.0, 0.0), (*offset, rotation))
        )
        shift = (float(offset[0]), float(offset[1]))
        out.append(DetectorTruth(detector, look_ahead, shift, rotation, nominal, true))
    return tuple(out)


def table_times(options: InstrumentOptions, step: float) -> Array:
    """Times (N,) s, `step` apart, from some seconds before the strip to some after it."""
    last = options.duration + _MARGIN
    return np.arange(-np.ceil(_MARGIN / step), np.ceil(last / step) + 1.0) * step


def nominal_attitude(options: InstrumentOptions, orbit: CircularOrbit, t: Array) -> Rotation:
    """world_from_body at times `t` (N,) of a platform that does not spin.

    Body axes are the orbital ones (x along the ground track in a low orbit, east in a geostationary one, y to
    the right, z down), rolled to the right by the off-nadir angle for a pushbroom camera: a mirror does
    that itself.
    """
    position, velocity = orbit.earth_fixed(t)
    if options.altitude > 2e6:
        velocity = np.cross([0.0, 0.0, 1.0], position)
    level = orbital_axes(position, velocity)
    if options.scan == "mirror":
        return level
    return level * Rotation.from_rotvec([-options.off_nadir, 0.0, 0.0])


def _spin(options: InstrumentOptions, orbit: CircularOrbit) -> Spin:
    """A spin that sweeps the boresight over the ground, at the off-nadir angle in the middle of the strip.

    Body y is the axis: the direction of flight in a low orbit (lines run across the track), the north in a
    geostationary one (lines run west).
    """
    middle = 0.5 * options.duration
    level = nominal_attitude(dataclasses.replace(options, scan="mirror"), orbit, np.array([middle]))[0]
    forward, right, down = level.as_matrix().T
    axis = forward if options.altitude < 2e6 else -right
    tilt = Rotation.from_rotvec(options.off_nadir * axis)
    look = tilt.apply(down)
    body = Rotation.from_matrix(np.stack([np.cross(axis, look), axis, look], axis=1))
    turned = Rotation.from_rotvec([0.0, -options.scan_rate * middle, 0.0])
    world = Rotation.from_rotvec([0.0, 0.0, EARTH_RATE * middle])
    return Spin(world * body * turned, np.array([0.0, 1.0, 0.0]), options.scan_rate, EARTH_RATE)


def _reference(options: InstrumentOptions, orbit: CircularOrbit, spin: Spin | None) -> Trajectory:
    t = table_times(options, _TRUE_STEP)
    position, velocity = orbit.earth_fixed(t)
    if spin is not None:
        return spin.trajectory(t, position, (float(t[0]), float(t[-1])), velocity=velocity)
    return Trajectory(t, position, t, nominal_attitude(options, orbit, t), velocity=velocity)


def mirror_angles(options: InstrumentOptions) -> tuple[Array, Array]:
    """Times (N,) s and angles (N,) rad of the scan mirror: half of what the line of sight turns."""
    t = table_times(options, _TRUE_STEP)
    return t, 0.5 * (options.off_nadir + options.scan_rate * (t - 0.5 * options.duration))


def mirror_axes(options: InstrumentOptions) -> tuple[Array, Array, Rotation]:
    """Axis and normal (3,) of the scan mirror, and body_from_camera of the camera behind it.

    In a low orbit the mirror turns about the roll axis and sweeps across the track, to the left; in a
    geostationary one about the pitch axis, and sweeps east. Behind it lines run with the sweep; the image is
    turned over.
    """
    if options.altitude < 2e6:
        camera = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 1.0]), Rotation.from_matrix(camera)
    camera = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, -1.0]), Rotation.from_matrix(camera)


def _pointing(options: InstrumentOptions) -> Pointing:
    if options.scan != "mirror":
        return FixedMount()
    axis, normal, camera = mirror_axes(options)
    return ScanMirror(camera, axis, normal, *mirror_angles(options))
