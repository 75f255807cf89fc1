"""JunoCam: raw framelets and metadata of a spinning camera → an ACQUISITION.toml with its images and masks.

A raw image is a pile of framelets of 128 lines: blue, green, red of the first exposure, of the second, ...
Camera values are those of the published instrument kernel; see ``docs/formats.md``.

Not here: what is done with them (``applications/spin_attitude.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.access import check_file, read_json
from sightline.errors import EstimationError, FormatError, foreign_errors
from sightline.estimation.robust import robust_sigma
from sightline.geometry.earth import from_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.two_body import propagate, velocity_between
from sightline.io.formats.images import open_image
from sightline.io.formats.tables import write_columns
from sightline.io.names import toml_string
from sightline.motion.spin.limb import LEAST_POINTS, LimbFit, attitude_from_limb

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

#: Jupiter: equatorial and polar radius (m), gravitational parameter (m^3/s^2), rotation (rad/s, System III).
RADII, MU, ROTATION = (71_492e3, 66_854e3), 1.26686531e17, 2.0 * np.pi / 35_729.711
#: Framelets of an exposure from the top, and line of the optical axis from the first line of each.
STRIPS = (("blue", 158.48), ("green", 3.48), ("red", -151.52))
LINES, COLUMNS, COLUMN = 128, 1648, 814.21
#: px; focal length 10.95637 mm in pixels of 7.4 um.
FOCAL = 10.95637e-3 / 7.4e-6
#: Radial distortion in tangents (published per px^2 and px^4).
DISTORTION = (-5.962420945566733e-8 * FOCAL**2, 2.738191004225615e-14 * FOCAL**4)
#: What is not known of these: focal length (share), column of the axis (px), k1, common line (px), strips
#: (px), and how differently colours are magnified.
FOCAL_SIGMA, COLUMN_SIGMA, K1_SIGMA, LINE_SIGMA, STRIP_SIGMA, SCALE_SIGMA = 1e-3, 1.0, 1e-3, 30.0, 0.1, 1e-4
#: m; of the layer of clouds and haze that each colour sees: about a scale height of the atmosphere.
LAYER_SIGMA = 25e3
#: s that the camera's clock adds to the delay between exposures, and the delay where no metadata says it.
CLOCK, DELAY = 1e-3, 0.373
#: Spin: rad per exposure about the column axis (line numbers fall with time) and its sigma; rad of the axis.
TURN, TURN_SIGMA, AXIS_SIGMA = -0.0778, 2e-4, 0.01
#: rad; of an attitude from the limb at least: where the centre is, and the turn about the line to it. rad/s;
#: speed over distance where neither is known: 40 km/s at 100,000 km.
ATTITUDE_SIGMA, TURN_ABOUT_SIGMA, PARALLAX_SIGMA = 1e-3, 0.05, 4e-4
#: Levels (8 bit) of blue, green, red below which a pixel is night or sky, and how far around these nothing is
#: used (px): the limb is no texture.
DARK, AROUND = (14.0, 18.0, 18.0), 24
#: Level from which on pixels are overexposed, and px around such (lines, columns) that their charge reaches.
SATURATED, BLOOM = 250, (9, 5)
#: Columns at the left that see nothing, and pixels (of all framelets of an exposure) that are a lit disc.
BLIND, LEAST_LIT = 26, 1000
#: A radiation hit stands out of its surroundings by so many sigmas, and so many levels.
HIT_SIGMAS, HIT_LEVELS = 6.0, 6.0

#: Bytes at the begin of a metadata file by which it is recognised.
_HEAD = 4096
#: Numbers of a metadata file and where they lie: s, degrees, km.
_EXPECTED = {
    "INTERFRAME_DELAY": (1e-3, 60.0),
    "SUB_SPACECRAFT_LATITUDE": (-90.0, 90.0),
    "SUB_SPACECRAFT_LONGITUDE": (-360.0, 360.0),
    "SPACECRAFT_ALTITUDE": (1.0, 1e8),
}
_NEEDED = f"PRODUCT_ID, START_TIME, {', '.join(_EXPECTED)} are needed"


def companding_table() -> NDArray[np.float32]:
    """The 256 values behind the square-root coded levels: 0 to 2879, in steps of 1, 2, 4, 8, 16, 32."""
    steps = [0, *[1] * 23, *[2] * 20, *[4] * 46, *[8] * 95, *[16] * 25, *[32] * 46]
    return np.cumsum(steps).astype(np.float32)


@dataclass(frozen=True)
class JunoMetadata:
    """What a metadata file says of an image.

    Attributes
    ----------
    product : str
    start : datetime
        UTC.
    delay : float
        s between exposures, as commanded.
    latitude, longitude : float
        rad; of the point under the spacecraft: planetographic, east (the file counts west).
    altitude : float
        m.
    """

    product: str
    start: datetime
    delay: float
    latitude: float
    longitude: float
    altitude: float

    def position(self) -> Array:
        """(3,) m; in Jupiter's turning axes at `start`."""
        return np.asarray(from_geodetic([[self.longitude, self.latitude, self.altitude]], RADII)[0])


def read_metadata(path: Path) -> JunoMetadata:
    """A metadata JSON file of an image.

    Raises
    ------
    FormatError
        If it is not JSON or lacks a value.
    """
    content = read_json(path, "a JunoCam metadata file")
    number: dict[str, float] = {}
    for key, (low, high) in _EXPECTED.items():
        with foreign_errors(f"{path}: {key}", "not as in a JunoCam metadata file", _NEEDED):
            number[key] = float(str(content[key]).split()[0])
        if not low <= number[key] <= high:
            raise FormatError(f"{path}: {key} = {number[key]:g} is not from {low:g} to {high:g}; {_NEEDED}")
    with foreign_errors(f"{path}: START_TIME", "not as in a JunoCam metadata file", _NEEDED):
        start = datetime.fromisoformat(content["START_TIME"]).replace(tzinfo=UTC)
    with foreign_errors(f"{path}: PRODUCT_ID", "not as in a JunoCam metadata file", _NEEDED):
        product = str(content["PRODUCT_ID"])
    return JunoMetadata(
        product,
        start,
        number["INTERFRAME_DELAY"],
        float(np.radians(number["SUB_SPACECRAFT_LATITUDE"])),
        float(-np.radians(number["SUB_SPACECRAFT_LONGITUDE"])),
        1e3 * number["SPACECRAFT_ALTITUDE"],
    )


def is_metadata(path: Path) -> bool:
    """Whether a file begins as metadata of JunoCam do; FormatError for what is no regular file."""
    check_file(path)
    with foreign_errors(path, "cannot be read", "check its permissions"), path.open("rb") as stream:
        head = stream.read(_HEAD)
    return head.lstrip().startswith(b"{") and b'"INSTRUMENT_ID": "JNC"' in re.sub(rb"\s*:\s*", b": ", head)


def read_framelets(path: Path) -> Pixels:
    """A raw image as (exposures, strips, lines, columns), 8 bit.

    Raises
    ------
    FormatError
        If it is no pile of whole exposures.
    """
    image = open_image(path)
    lines, columns = image.shape
    if columns != COLUMNS or lines % (LINES * len(STRIPS)) or image.dtype != np.uint8:
        raise FormatError(
            f"{path}: {lines} lines x {columns} columns of {image.dtype}; a raw JunoCam colour image has "
            f"{COLUMNS} columns and a multiple of {LINES * len(STRIPS)} lines of 8 bit (blue, green, red "
            f"framelets of {LINES} lines)"
        )
    pixels = image.read((0, lines), (0, columns))
    return pixels.astype(np.uint8).reshape(-1, len(STRIPS), LINES, COLUMNS)


def radiation_hits(framelet: Pixels, dark: float) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Pixels of a framelet that particles brightened, and the levels around every pixel.

    Parameters
    ----------
    framelet : (lines, columns)
        8 bit, square-root coded: noise is about the same at all levels.
    dark : float
        Level of sky and night.

    Returns
    -------
    hits : (lines, columns) bool
    median : (lines, columns) float32
        Of 5 x 5 pixels.
    """
    from scipy import ndimage

    level = framelet.astype(np.float32)
    median = ndimage.median_filter(level, 5)
    lit = median > dark
    spread = robust_sigma((level - median)[lit]) if lit.sum() > 100 else 1.0
    hit = np.abs(level - median) > max(HIT_SIGMAS * max(spread, 0.7), HIT_LEVELS)
    # the limb is steep, and no hit
    steep = ndimage.maximum_filter(median, 5) - ndimage.minimum_filter(median, 5) > 4.0 * HIT_LEVELS
    return ndimage.binary_dilation(hit & ~steep, np.ones((3, 3), bool)), median


def unusable(hits: NDArray[np.bool_], median: NDArray[np.float32], dark: float) -> NDArray[np.bool_]:
    """Pixels of a framelet that must not be matched: radiation hits, sky, night side and limb.

    Parameters
    ----------
    hits, median : (lines, columns)
        Of `radiation_hits`.
    dark : float
        Level of sky and night.
    """
    from scipy import ndimage

    night = ndimage.binary_opening(ndimage.uniform_filter(median, 7) < dark, np.ones((5, 5), bool))
    # a dilation by a wide square: the largest of rows, then of columns, is many times faster
    out = hits | bloomed(median) | ndimage.maximum_filter(night, 2 * AROUND + 1, mode="constant")
    out[:, :BLIND] = True
    return np.asarray(out)


def bloomed(level: NDArray[np.float32] | Pixels, reach: tuple[int, int] = BLOOM) -> NDArray[np.bool_]:
    """Pixels of a framelet (lines, columns) that are overexposed, or within `reach` of such."""
    from scipy import ndimage

    around = tuple(2 * far + 1 for far in reach)
    return np.asarray(ndimage.maximum_filter(level >= SATURATED, around, mode="constant"))


def limb_points(framelets: Pixels) -> Array:
    """Places (N, 6) where sky turns to lit disc: exposure, strip, line, column, and where it gets brighter.

    The last two are a unit vector along lines and columns.

    Only green and red, and only where brightness rises steeply: the night side fades slowly. None near what
    is overexposed: charge that spills moves the limb, and its tail looks like one.
    """
    from scipy import ndimage

    out = []
    for exposure, strip in ((k, s) for k in range(len(framelets)) for s in (1, 2)):
        level = ndimage.gaussian_filter(
            ndimage.median_filter(framelets[exposure, strip].astype(np.float64), 3), 1.0
        )
        slope = np.stack(np.gradient(level), axis=-1)
        steep = (np.hypot(slope[..., 0], slope[..., 1]) > 3.0) & ~bloomed(
            framelets[exposure, strip], (AROUND, AROUND)
        )
        above = level - DARK[strip]
        for axis in (0, 1):
            # crossings between neighbours along one axis
            low = np.take(above, range(above.shape[axis] - 1), axis)
            high = np.take(above, range(1, above.shape[axis]), axis)
            line, column = np.nonzero((low * high < 0.0) & np.take(steep, range(above.shape[axis] - 1), axis))
            place = np.stack([line, column], axis=1).astype(np.float64)
            place[:, axis] += low[line, column] / (low[line, column] - high[line, column])
            inside = (place[:, 1] > BLIND + 10) & (place[:, 0] > 2) & (place[:, 0] < LINES - 3)
            head = np.tile([float(exposure), float(strip)], (int(inside.sum()), 1))
            rise = slope[line[inside], column[inside]]
            rise /= np.hypot(rise[:, 0], rise[:, 1])[:, None]
            out.append(np.hstack([head, place[inside], rise]))
    return np.concatenate(out)


def sun_direction(instant: datetime) -> Array:
    """(3,) unit vector to the Sun in Jupiter's turning axes, good to a degree.

    Notes
    -----
    Mean elements of Jupiter's orbit (E. M. Standish, 1992, valid 1800-2050); pole and prime meridian of the
    IAU working group.
    """
    days = (instant - datetime(2000, 1, 1, 11, 58, 56, tzinfo=UTC)).total_seconds() / 86_400.0
    centuries = days / 36_525.0
    e, semi = 0.04838624, 5.2028870
    node, perihelion, tilt = np.radians([100.47390909, 14.72847983, 1.30439695])
    mean = np.radians(34.39644051 + 3_034.74612775 * centuries) - perihelion
    anomaly = mean
    for _ in range(20):
        anomaly = mean + e * np.sin(anomaly)
    place = semi * np.array([np.cos(anomaly) - e, np.sqrt(1.0 - e * e) * np.sin(anomaly), 0.0])
    ecliptic = Rotation.from_euler("ZXZ", [node, tilt, perihelion - node]).apply(place)
    equatorial = Rotation.from_euler("X", np.radians(23.43928)).apply(-ecliptic)
    right_ascension, declination = np.radians([268.056595, 64.495303])
    prime = np.radians((284.95 + 870.536 * days) % 360.0)
    axes = Rotation.from_euler("ZXZ", [np.pi / 2 + right_ascension, np.pi / 2 - declination, prime])
    toward = axes.inv().apply(equatorial)
    return np.asarray(toward / np.linalg.norm(toward))


def arc(metadata: Sequence[JunoMetadata], which: int, t: Array) -> Array:
    """Positions (N, 3) m about the time of one image, in Jupiter's turning axes, `t` (N,) s after its start.

    Parameters
    ----------
    metadata : two JunoMetadata
        Minutes apart: a two-body arc joins their positions.
    which : int
        0 or 1.
    t : (N,)
        s.
    """
    seconds = [(item.start - metadata[0].start).total_seconds() for item in metadata[:2]]

    def still(turned: Array, at: Array) -> Array:
        """Turning axes at `at` s → axes that stand still since the first image."""
        return np.asarray(Rotation.from_rotvec(ROTATION * at[:, None] * [0.0, 0.0, 1.0]).apply(turned))

    first, second = (
        still(item.position()[None], np.array([at]))[0] for item, at in zip(metadata, seconds, strict=True)
    )
    velocity = velocity_between(first, second, seconds[1], MU)
    at = seconds[which] + t
    place, _ = propagate(first, velocity, at, MU)
    return np.asarray(Rotation.from_rotvec(-ROTATION * at[:, None] * [0.0, 0.0, 1.0]).apply(place))


def limb_attitude(framelets: Pixels, interval: float, position: Array, sun: Array) -> LimbFit:
    """Attitude of the body (= camera axes) at t = 0 from the limb in all exposures.

    Parameters
    ----------
    framelets : (exposures, strips, lines, columns)
    interval : float
        s between exposures.
    position : (exposures, 3)
        m; axes that stand still with Jupiter's at t = 0.
    sun : (3,)
        In the same axes. The lit side of the disc lies towards smaller columns.
    """
    points = limb_points(framelets)
    bright = float((framelets[:, 1:] >= SATURATED).mean())
    if len(points) < LEAST_POINTS and bright > 0.0:
        raise EstimationError(
            f"{len(points)} limb points beside what is overexposed ({100 * bright:.2g} % of green and red); "
            f"{LEAST_POINTS} or more are needed to find the attitude; take infinity, or another image"
        )
    directions, rising = np.empty((2, len(points), 3))
    for strip, (_, line) in enumerate(STRIPS):
        of = points[:, 1] == strip
        detector = AreaDetector("", (LINES, COLUMNS), FOCAL, (line + COMMON_LINE, COLUMN), DISTORTION)
        directions[of] = detector.directions(points[of, 2:4])
        rising[of] = detector.directions(points[of, 2:4] + points[of, 4:]) - directions[of]
    exposure = points[:, 0].astype(int)
    spun = Rotation.from_rotvec(TURN * exposure[:, None] * [1.0, 0.0, 0.0])
    rising /= np.linalg.norm(rising, axis=1)[:, None]
    hint = np.array([-1.0, 0.0, 0.0]), sun
    spin = exposure[:, None] * np.array([1.0, 0.0, 0.0]), TURN_SIGMA
    return attitude_from_limb(
        spun.apply(directions), position[exposure], RADII, hint, sun, spun.apply(rising), spin
    )


#: px; the published lines of the axis lie so far beside what the images show.
COMMON_LINE = -26.0


def write_junocam_acquisition(
    image: Path,
    out: Path,
    *,
    metadata: Sequence[Path] = (),
    infinity: bool = False,
) -> Path:
    """Write ``acquisition.toml`` with frames, masks and positions for one raw image.

    Parameters
    ----------
    image : path
        Raw PNG.
    out : path
        Folder; made if needed.
    metadata : paths
        Metadata of this image and of another of the same orbit; without them only ``infinity`` is possible.
    infinity : bool
        Take the surface for infinitely far, even with metadata.

    Returns
    -------
    Path
        The TOML file.

    Raises
    ------
    FormatError
        If the image is no raw image, no metadata belong to it, or nothing in it is lit.
    """
    out.mkdir(parents=True, exist_ok=True)
    begun = junocam_frames(image, metadata=metadata, infinity=infinity)
    begun.write(out)
    path = out / "acquisition.toml"
    path.write_text(begun.text, encoding="utf-8")
    return path


@dataclass(frozen=True, eq=False)
class JunocamFrames:
    """A raw image as frames: the text of its acquisition, and the files that this names.

    Attributes
    ----------
    text : str
        ACQUISITION.toml.
    levels, masks : dict
        Decoded levels (float32) and masks (uint8) of exposures, by their number.
    positions : dict or None
        Columns of ``positions.csv``.
    limb : LimbFit or None
        What the attitude rests on.
    """

    text: str
    levels: dict[int, NDArray[np.float32]]
    masks: dict[int, Pixels]
    positions: dict[str, Array] | None
    limb: LimbFit | None

    def write(self, out: Path) -> None:
        """Every file but the TOML into a folder."""
        for k, pixels in self.levels.items():
            np.save(out / f"exposure_{k:02}.npy", pixels)
            np.save(out / f"mask_{k:02}.npy", self.masks[k])
        if self.positions is not None:
            write_columns(out / "positions.csv", self.positions)


def junocam_frames(image: Path, *, metadata: Sequence[Path] = (), infinity: bool = False) -> JunocamFrames:
    """What `write_junocam_acquisition` writes; arguments and errors as there."""
    framelets = read_framelets(image)
    known = sorted((read_metadata(path) for path in metadata), key=lambda item: item.start)
    own = [k for k, item in enumerate(known) if item.product in image.name]
    far = infinity or not known
    if not far and (len(known) != 2 or len(own) != 1):
        raise FormatError(
            f"{image}: metadata of {', '.join(item.product for item in known)} given; that of the image and "
            "of one other of the same orbit are needed; or leave them out: the surface is then at infinity"
        )
    interval = CLOCK + (known[own[0]].delay if own else DELAY)
    levels, masks = _frames(framelets)
    positions: dict[str, Array] | None = None
    limb: LimbFit | None = None
    if far:
        platform = [
            "attitude = [0.0, 0.0, 0.0, 1.0]",
            "attitude_sigma = 0.0",
            "attitude_turn_sigma = 0.0",
        ]
        surface = ['kind = "infinity"', f"parallax_sigma = {PARALLAX_SIGMA}"]
        epoch: list[str] = []  # attitudes in axes of their own belong into no message
    else:
        positions, limb, platform = _located(framelets, interval, known, own[0])
        surface = [f"radii = [{RADII[0]}, {RADII[1]}]"]
        epoch = [f'epoch = "{known[own[0]].start.isoformat()}"']
    text = _toml(image.stem, epoch, platform, surface, interval, list(levels), far=far)
    return JunocamFrames(text, levels, masks, positions, limb)


def _frames(framelets: Pixels) -> tuple[dict[int, NDArray[np.float32]], dict[int, Pixels]]:
    """Decoded exposures and their masks, by the number of those that show the lit disc."""
    table = companding_table()
    levels, masks, lit_pixels = [], [], []
    for exposure in framelets:
        cleaned, marked = [], []
        lit_pixels.append(0)
        for strip, dark in zip(exposure, DARK, strict=True):
            hits, median = radiation_hits(strip, dark)
            lit_pixels[-1] += int((median[:, BLIND:] > dark).sum())
            # what stands in place of a hit is for the eye; it is masked all the same
            cleaned.append(np.where(hits, median, strip).astype(np.uint8))
            marked.append(unusable(hits, median, dark))
        levels.append(np.concatenate(cleaned))
        masks.append(np.concatenate(marked))
    lit = np.flatnonzero(np.array(lit_pixels) > LEAST_LIT)
    if len(lit) < 2:
        raise FormatError("no lit disc in the image: fewer than two exposures are brighter than the sky")
    exposures = list(range(int(lit[0]), int(lit[-1]) + 1))
    decoded = {k: table[levels[k]] for k in exposures}
    for pixels in decoded.values():
        pixels[:, :BLIND] = np.nan
    return decoded, {k: masks[k].astype(np.uint8) for k in exposures}


def _located(
    framelets: Pixels, interval: float, known: Sequence[JunoMetadata], which: int
) -> tuple[dict[str, Array], LimbFit, list[str]]:
    """Positions along the arc, the limb, and the lines of ``[platform]`` that say where the camera is."""
    t = interval * np.arange(-6.0, len(framelets) + 6.0)
    place = arc(known, which, t)
    positions = {"t": t, "x": place[:, 0], "y": place[:, 1], "z": place[:, 2]}
    seen = interval * np.arange(float(len(framelets)))
    still = Rotation.from_rotvec(ROTATION * seen[:, None] * [0.0, 0.0, 1.0]).apply(arc(known, which, seen))
    fit = limb_attitude(framelets, interval, still, sun_direction(known[which].start))
    lines = [
        'positions = "positions.csv"',
        f"world_rate = {ROTATION:.10g}",
        f"attitude = {fit.world_from_body.as_quat().tolist()}",
        f"# from {fit.kept} limb points, {FOCAL * fit.rms:.2f} px rms, {fit.height / 1e3:.0f} km above 1 bar",
        f"attitude_sigma = {max(ATTITUDE_SIGMA, fit.sigma):.3g}",
        f"attitude_turn_sigma = {max(TURN_ABOUT_SIGMA, fit.sigma_turn):.3g}   # about the line to the centre",
    ]
    return positions, fit, lines


def _toml(
    name: str,
    epoch: list[str],
    platform: list[str],
    surface: list[str],
    interval: float,
    exposures: Sequence[int],
    *,
    far: bool,
) -> str:
    """The text of the acquisition file."""
    strips = [
        f'[[camera.strip]]\nname = "{strip}"\nfirst_line = {k * LINES}\nlines = {LINES}\n'
        f"axis_line = {line + COMMON_LINE:.2f}\naxis_line_sigma_px = {STRIP_SIGMA}\n"
        f"scale_sigma = {SCALE_SIGMA}\n" + ("" if far else f"height_sigma = {LAYER_SIGMA}\n")
        for k, (strip, line) in enumerate(STRIPS)
    ]
    frames = [
        f'[[frame]]\nname = "{k:02}"\nimage = "exposure_{k:02}.npy"\nmask = "mask_{k:02}.npy"\n'
        f"time = {k * interval:.6f}\n"
        for k in exposures
    ]
    parts = [
        "[acquisition]",
        f"name = {toml_string(name)}",
        *epoch,
        "",
        "[platform]",
        'kind = "spin"',
        *platform,
        "axis = [1.0, 0.0, 0.0]",
        f"axis_sigma = {AXIS_SIGMA}",
        f"rate = {TURN / interval:.9f}",
        f"rate_sigma = {TURN_SIGMA / interval:.3g}",
        "",
        "[surface]",
        *surface,
        "",
        "[camera]",
        "body_from_camera = [0.0, 0.0, 0.0, 1.0]",
        f"focal_length_px = {FOCAL:.3f}",
        f"focal_length_sigma_px = {FOCAL_SIGMA * FOCAL:.3f}",
        f"principal_point_px = [0.0, {COLUMN}]",
        f"principal_point_sigma_px = {COLUMN_SIGMA}",
        f"distortion = {list(DISTORTION)}",
        f"distortion_sigma = {K1_SIGMA}",
        f"common_line_sigma_px = {LINE_SIGMA}",
        "",
    ]
    return "\n".join([*parts, *strips, *frames])
