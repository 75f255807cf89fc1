"""An acquisition in plain words: what was understood, what is missing, what will be observable.

Geometry alone speaks: no image is matched. Behind ``sightline check``.

Not here: reading the file (``load.py``); what a recovery really saw (``summary.json``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.evaluation.band_words import passband_words
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Dem
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.acquisition.describe_spin import describe_spin, ground_words
from sightline.io.acquisition.ground import ground_steps, sampling_doubts, shared_ground
from sightline.io.acquisition.looks import look_words
from sightline.io.formats.images import RasterImage
from sightline.io.formats.instants import epoch_words
from sightline.motion.observability import (
    Passbands,
    averaged_away,
    blind_frequencies,
    passbands,
    shared_blind_frequencies,
)

# Lines and columns at which a pair is looked for, as parts of the image: the middle first; staggered
# detectors share their ends only.
_PLACES = (0.5, 0.3, 0.7, 0.1, 0.9)
_COLUMNS = (0.5, 0.97, 0.03, 0.75, 0.25, 0.992, 0.008)
# Blind frequencies named per pair; the rest are their multiples.
_NAMED = 4
# Half a field (px) below which matches to 0.03 px know yaw no better than attitude control does (1 mrad).
_NARROW_PX = 30.0
# s; lags below it are the rounding of times.
_NO_LAG = 1e-9
# Frames are many: each is described with so many that follow it.
_FRAMES_APART = 2


@dataclass(frozen=True)
class PairGeometry:
    """What the nominal cameras say of one pair of images.

    Attributes
    ----------
    a, b : str
        Names of the images.
    lag : float or None
        s; time in b minus time in a, of the same ground; None where the two see no common ground.
    parallax : float or None
        px in b per metre of height.
    overlap : float
        Share of the ground seen in a that b sees too.
    """

    a: str
    b: str
    lag: float | None
    parallax: float | None
    overlap: float


def pair_geometry(acquisition: Acquisition, first: int, second: int) -> PairGeometry:
    """Lag and parallax of two images, at the first place where both see the ground, and how much both see."""
    a, b = acquisition.cameras[first], acquisition.cameras[second]
    names = acquisition.names[first], acquisition.names[second]
    shape = acquisition.images[first].shape
    last = np.array(shape) - 1.0
    pixels = np.array([[part * last[0], side * last[1]] for side in _COLUMNS for part in _PLACES])
    ground = a.locate(pixels, acquisition.surface)
    seen = b.project(ground)
    inside = ((seen >= 0.0) & (seen <= np.array(b.shape) - 1.0)).all(axis=1)
    both = np.flatnonzero(inside)
    if not both.size:
        return PairGeometry(*names, None, None, 0.0)
    place = both[:1]
    lag = float(b.rays(seen[place]).t[0] - a.rays(pixels[place]).t[0])
    if abs(lag) < _NO_LAG:
        lag = 0.0
    raised = b.project(a.locate(pixels[place], acquisition.surface.raised(1.0)))
    parallax = float(np.linalg.norm(raised[0] - seen[place[0]]))
    overlap = shared_ground(a, b, acquisition.surface)
    return PairGeometry(*names, lag, parallax if np.isfinite(parallax) else None, overlap)


def describe_acquisition(acquisition: Acquisition) -> dict[str, Any]:
    """An acquisition in words and numbers.

    Returns
    -------
    dict
        ``understood``, ``missing``, ``observable``: lists of sentences. ``pairs``: a, b, lag (s),
        blind_frequencies (Hz), parallax (px per metre), overlap (share). ``passbands``: (low, high) in Hz,
        from one period in the time of the images on, where the pairs together leave at least half of a motion
        ten times stronger (in power) than the noise. ``shared_blind_frequencies``: Hz, rising; where all
        pairs together see least, between these.
        Frames of a spinning camera: ``describe_spin``.
    """
    if acquisition.frames and acquisition.spin is not None:
        return describe_spin(acquisition)
    reach = len(acquisition.bands) or _FRAMES_APART
    indices = combinations(range(len(acquisition.names)), 2)
    pairs = [pair_geometry(acquisition, i, j) for i, j in indices if j - i <= reach]
    lags = [pair.lag for pair in pairs if pair.lag]
    upper = _highest_frequency(acquisition)
    bands = _from(1.0 / _duration(acquisition), passbands(lags, upper)) if lags else ()
    shared = shared_blind_frequencies(lags, bands, upper) if lags else ()
    stages = _stage_times(acquisition)
    if lags and all(stages):
        averaged = averaged_away([time for times in stages for time in times], upper)
        shared = tuple(np.unique([*shared, *averaged]).tolist())
    return {
        "understood": _understood(acquisition),
        "missing": _missing(acquisition, pairs),
        "observable": _observable(acquisition, pairs, bands, shared, upper),
        "pairs": [
            {
                "a": pair.a,
                "b": pair.b,
                "lag": pair.lag,
                "parallax": pair.parallax,
                "overlap": pair.overlap,
                "blind_frequencies": _blind(acquisition, pair, upper),
            }
            for pair in pairs
        ],
        "passbands": bands,
        "shared_blind_frequencies": shared,
        "highest_frequency": upper,
    }


def _stage_times(acquisition: Acquisition) -> list[tuple[float, ...]]:
    """s that the stages of every image take; none without TDI."""
    return [c.stage_times if isinstance(c, PushbroomCamera) else () for c in acquisition.cameras]


def _blind(acquisition: Acquisition, pair: PairGeometry, upper: float) -> NDArray[np.float64]:
    """Frequencies (Hz) that a pair does not see: by its lag, and by the stages of both images."""
    if not pair.lag:
        return np.zeros(0)
    lag = blind_frequencies(pair.lag, upper)
    stages = dict(zip(acquisition.names, _stage_times(acquisition), strict=True))
    if not (stages[pair.a] and stages[pair.b]):
        return lag
    return np.unique(np.concatenate([lag, averaged_away([*stages[pair.a], *stages[pair.b]], upper)]))


def _highest_frequency(acquisition: Acquisition) -> float:
    """Hz: a quarter of the line rate, as S1 advises; for frames, half their rate.

    A pair of unlike lines is matched on the coarser ones: the second finest band has the rate that counts.
    """
    cameras = acquisition.cameras
    periods = sorted(c.detector.line_period for c in cameras if isinstance(c, PushbroomCamera))
    if periods:
        return 0.25 / periods[:2][-1]
    times = np.unique([camera.t for camera in cameras if not isinstance(camera, PushbroomCamera)])
    return float(0.5 / np.median(np.diff(times)))


def _duration(acquisition: Acquisition) -> float:
    """s that the motion is recovered over: the lines of the first band, or all frames."""
    camera = acquisition.cameras[0]
    if isinstance(camera, PushbroomCamera):
        first, last = camera.times(np.array([0.0, camera.lines - 1.0]))
        return float(abs(last - first))
    times = [camera.t for camera in acquisition.cameras if not isinstance(camera, PushbroomCamera)]
    return float(max(times) - min(times))


def _from(lowest: float, bands: Passbands) -> Passbands:
    """Bands less what lies below a frequency (Hz): less than a period looks like a drift."""
    return tuple((max(low, lowest), high) for low, high in bands if high > lowest)


def _understood(acquisition: Acquisition) -> list[str]:
    """What the file says, in the words of the conventions."""
    kind = "bands" if acquisition.bands else "frames"
    kind = kind if len(acquisition.names) > 1 else kind[:-1]
    epoch = epoch_words(acquisition.epoch)
    lines = [
        f"{acquisition.name}: {len(acquisition.names)} {kind}, platform {acquisition.platform}, "
        f"world {acquisition.world}, {epoch}"
    ]
    for name, image, camera in zip(acquisition.names, acquisition.images, acquisition.cameras, strict=True):
        if isinstance(camera, PushbroomCamera):
            start, end = camera.times(np.array([0.0, camera.lines - 1.0]))
            when = f"exposed from t = {start:.4f} to {end:.4f} s"
        else:
            when = f"exposed at t = {camera.t:.4f} s"
        of = f" ({image.words})" if isinstance(image, RasterImage) and image.count > 1 else ""
        lines.append(f"{name}: {image.shape[0]} lines x {image.shape[1]} columns, {when}{of}")
        if isinstance(camera, PushbroomCamera) and camera.stages is not None:
            lines.append(_stage_words(name, camera))
    lines += acquisition.sources
    ifov = acquisition.ifov * 1e6
    lines.append(
        f"one pixel is {ifov:.4g} urad; the field reaches {acquisition.half_field_px:.0f} px from its middle"
    )
    along, across = ground_steps(acquisition.cameras[0], acquisition.surface)
    if np.isfinite(along):
        lines.append(f"on the ground lines are {along:.3g} m apart and pixels {across:.3g} m wide")
    lines += look_words(acquisition)
    lines.append(
        f"ground: {ground_words(acquisition.surface)}, height known to {acquisition.height_sigma:g} m"
        + (f" (assumed: {' and '.join(acquisition.assumed)})" if acquisition.assumed else "")
    )
    first, last = _strip_times(acquisition)
    for sensor in acquisition.sensors:
        during = int(((sensor.t_start >= first) & (sensor.t_end <= last)).sum())
        lines.append(f"{sensor.kind} {sensor.name}: {len(sensor.t_start)} rows, {during} during the images")
    if acquisition.known_motion.spectra is not None:
        lines.append("spectrum of the motion: given, nothing will be fitted")
    elif acquisition.known_motion.tones:
        lines.append("known tones: " + ", ".join(f"{f:g} Hz" for f in acquisition.known_motion.tones))
    if acquisition.control_points is not None:
        lines.append(f"{len(acquisition.control_points.sigma)} control points")
    return lines


def _stage_words(name: str, camera: PushbroomCamera) -> str:
    """What the TDI of a band does to its motion."""
    assert camera.stages is not None
    counts, times = np.unique(camera.stages), [1e3 * time for time in camera.stage_times]
    several = "" if len(counts) == 1 else f" (columns differ: {', '.join(map(str, counts))})"
    which = {"centre": "the middle", "first-stage": "the first", "last-stage": "the last"}
    span = f"{times[-1]:.4g} ms" if len(counts) == 1 else f"{times[0]:.4g} to {times[-1]:.4g} ms"
    gone = averaged_away([0.001 * time for time in times], 2.5 / camera.stage_times[0])
    return (
        f"{name}: TDI of {counts[-1]} stages{several}; each pixel averages the motion over {span}, times and "
        f"look angle are of {which[camera.time_reference]} of them"
        + (f"; {_named(gone)} Hz and multiples are averaged away" if len(gone) else "")
    )


def _strip_times(acquisition: Acquisition) -> tuple[float, float]:
    """First and last exposure of all images, s."""
    ends: list[float] = []
    for camera in acquisition.cameras:
        if isinstance(camera, PushbroomCamera):
            ends += camera.times(np.array([0.0, camera.lines - 1.0])).tolist()
        else:
            ends.append(camera.t)
    return min(ends), max(ends)


def what_is_doubtful(acquisition: Acquisition) -> tuple[str, ...]:
    """What of an acquisition is hardly meant: how pixels lie on the ground, where it looks, its tables."""
    sampling = sampling_doubts(acquisition.surface, acquisition.cameras, acquisition.names)
    return (*sampling, *acquisition.doubts)


def _missing(acquisition: Acquisition, pairs: list[PairGeometry]) -> list[str]:
    """What would make the result better, or is needed for some of the files."""
    lines = [
        f"{pair.a} and {pair.b} see no common ground; check times and viewing angles"
        for pair in pairs
        if pair.lag is None
    ]
    lines += [
        f"{pair.a} and {pair.b} see the same ground at the same time: their matches hold no motion"
        for pair in pairs
        if pair.lag == 0.0
    ]
    lines += [f"suspicious: {words}" for words in what_is_doubtful(acquisition)]
    names = [("focal length", acquisition.lens.focal_length_sigma_px, "px")]
    names += [("principal point", acquisition.lens.principal_point_sigma_px, "px")]
    names += [("distortion k1", acquisition.lens.distortion_sigma, "")]
    lines += [
        f"{name}: known to {sigma:.4g} {unit}".rstrip() + ", will be estimated"
        for name, sigma, unit in names
        if sigma
    ]
    if acquisition.epoch is None:
        lines.append(
            "[acquisition] epoch: without it no CCSDS file can be written, and `export` gives no stac, nor "
            "csm, isd, ck and isis unless a sensor model brings the instant"
        )
    if not acquisition.sensors and acquisition.control_points is None:
        lines.append("attitude sensors or control points: without them sigma_absolute is infinite")
    if acquisition.bands and all(band.camera.stages is None for band in acquisition.bands):
        lines.append(
            "stages: none are given, so every line is taken for one exposure of its line_period; of a TDI "
            "detector give each [[band]] its stages, which no image tells"
        )
    if acquisition.assumed:
        lines.append(
            f"[surface] {' and '.join(acquisition.assumed)}: not given but assumed; give height and "
            "height_sigma, or a dem"
        )
    if acquisition.height_sigma > 0.0:
        lines.append(f"a DEM: the height's sigma widens that of pitch{_long_hills(acquisition)}")
    free = [band.name for band in acquisition.bands if band.offset_sigma_px > 0.0]
    if free and len(acquisition.bands) == 1:
        lines.append(f"exact focal-plane offset of {free[0]}: sigma_absolute cannot be less than its sigma")
    elif free:
        lines.append(f"exact focal-plane offsets of {', '.join(free)}: a steady drift is hidden by them")
    return lines


def _long_hills(acquisition: Acquisition) -> str:
    """What no height_sigma holds: hills so long beside the strip that they are curves of pitch and yaw."""
    camera = acquisition.cameras[0]
    along, _ = ground_steps(camera, acquisition.surface)
    if isinstance(acquisition.surface, Dem) or not np.isfinite(along):
        return ""
    length = 1e-3 * along * (camera.shape[0] - 1)
    return (
        f"; of hills longer than some third of the strip, {length:.3g} km, it does not hold all: they are "
        "curves of pitch and yaw, whose sigma may be several times too small"
    )


def _observable(
    acquisition: Acquisition,
    pairs: list[PairGeometry],
    bands: Passbands,
    shared: Sequence[float],
    upper: float,
) -> list[str]:
    """What the pairs can see, alone and together."""
    lines = []
    control = acquisition.control_points
    if len(acquisition.bands) == 1 and control is not None:
        rate = len(control.sigma) / max(_duration(acquisition), 1e-9)
        lines.append(
            f"what control points show alone: {len(control.sigma)} of them, of motions up to about "
            f"{min(0.5 * rate, upper):.3g} Hz; the rest is left to their scatter"
        )
    for pair in pairs:
        if pair.lag:
            named = _named(_blind(acquisition, pair, upper))
            lines.append(
                f"{pair.a} - {pair.b}: lag {_seconds(pair.lag)}, {100.0 * pair.overlap:.0f} % common "
                f"ground, blind at "
                + (f"{named} Hz" if named else f"no frequency below {upper:.4g} Hz")
                + (f", 100 m of height displace by {100.0 * pair.parallax:.3g} px" if pair.parallax else "")
            )
    if bands:
        lines.append(f"together, up to {upper:.4g} Hz: {passband_words(bands)}")
        where = f"at {_named(shared)} Hz" if shared else f"at no frequency from {bands[0][0]:.4g} Hz on"
        lines.append(f"together blind {where}")
    edge = 1e6 / acquisition.half_field_px
    ratio = 1.0 / (acquisition.half_field_px * acquisition.ifov)
    lines.append(
        f"yaw: {edge:.5g} urad move the edge of the field by one pixel: it is seen {ratio:.3g} times less "
        f"well than "
        "roll and pitch"
    )
    if acquisition.half_field_px < _NARROW_PX:
        lines.append(
            f"yaw: the field is narrow ({2 * acquisition.half_field_px + 1:.0f} columns); take it as unknown"
        )
    return lines


def _named(frequencies: Iterable[float]) -> str:
    """The lowest of some frequencies, Hz."""
    listed = [f"{f:.4g}" for f in frequencies]
    return ", ".join([*listed[:_NAMED], *(["..."] if len(listed) > _NAMED else [])])


def _seconds(lag: float) -> str:
    """A lag in the unit in which it is read most easily."""
    return f"{lag:.4g} s" if abs(lag) >= 1.0 else f"{lag * 1e3:.4g} ms"
