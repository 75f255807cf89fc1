"""The named pushbroom strips that tests, benchmarks and ``sightline simulate line-of-sight`` share.

A case is a set of options (``strip_options.py``); :func:`line_of_sight_case` draws everything that is
random in it from one seed and gives a :class:`StripScenario`: true cameras, cameras as a user would know
them, the scene and the images. Frames of a matrix instrument are in ``frames.py``; files are written by
``files.py``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Dem, Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.simulate import measured
from sightline.simulate.attitude_sensors import (
    ARC_SECOND,
    control_point_table,
    gyro_table,
    star_tracker_table,
)
from sightline.simulate.jitter import (
    ChirpJitter,
    JitterPart,
    JitterProfile,
    StepJitter,
    ToneJitter,
    curve_profile,
    nominal_profile,
    with_part,
)
from sightline.simulate.option_checks import options_of
from sightline.simulate.rendered import RenderedStrip
from sightline.simulate.scene import (
    POSTING,
    BandShine,
    Clouds,
    Extent,
    Relief,
    Scene,
    TextureLaw,
    random_relief,
    scattered_clouds,
    scene_layers,
)
from sightline.simulate.sensor import NODE_STEP, Radiometry, render_chunks, single_stages
from sightline.simulate.strip_options import CASE_OPTIONS, MOTIONS, StripOptions
from sightline.simulate.texture import Array, raster_layer

MOTION_MARGIN_LINES = 64
"""Lines by which the true motion is known beyond both ends of the strip."""

GROUND_MARGIN_PX = 64.0
"""Pixels of ground made beyond what the nominal cameras see."""


@dataclass(frozen=True, eq=False)
class BandTruth:
    """One detector line: what is given of it and what is true.

    Parameters
    ----------
    name : str
    lag : float
        s after the first band at which it sees the same ground.
    look_ahead : float
        rad
    offset_px : (float, float)
        True offset, forward and towards larger columns; nominally (0, 0).
    rotation : float
        rad, true rotation; nominally 0.
    nominal, true : LineDetector
    scale : float
        True magnification beside the first band's, less 1; nominally 0.
    departure_px : (columns, 2) or None
        True departure of each pixel from the line, forward and towards larger columns; nominally none.
    """

    name: str
    lag: float
    look_ahead: float
    offset_px: tuple[float, float]
    rotation: float
    nominal: LineDetector
    true: LineDetector
    scale: float = 0.0
    departure_px: Array | None = None


@dataclass(frozen=True, eq=False)
class StripScenario(RenderedStrip):
    """A pushbroom strip: truth, what a user would know, and the images.

    Parameters
    ----------
    case : str
    seed : int
    options : StripOptions
    bands : tuple of BandTruth
    reference : Trajectory
        As planned, without the motion.
    motion : Motion
        True motion of the line of sight, knots at the lines (and some beyond both ends).
    body : Motion
        The part of it that attitude sensors feel.
    scene : Scene
    radiometry : Radiometry
    """

    case: str
    seed: int
    options: StripOptions
    bands: tuple[BandTruth, ...]
    reference: Trajectory
    motion: Motion
    body: Motion
    scene: Scene
    radiometry: Radiometry

    @cached_property
    def cameras(self) -> tuple[PushbroomCamera, ...]:
        """The true cameras, one per band."""
        trajectory = self.reference.with_motion(self.motion)
        return tuple(
            PushbroomCamera(band.true, trajectory, FixedMount(), self.options.first_time(k), lines)
            for k, (band, (lines, _)) in enumerate(zip(self.bands, self.shapes, strict=True))
        )

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Lines and columns of each band."""
        return tuple(self.options.shape(k) for k in range(len(self.bands)))

    @cached_property
    def nominal_cameras(self) -> tuple[PushbroomCamera, ...]:
        """The cameras as written in the ACQUISITION file: no motion, nominal detectors."""
        return _nominal_cameras(self.bands, self.reference, self.options)

    @property
    def truth_times(self) -> Array:
        """As ever; beside bands of longer lines, so many lines more at both ends as one of those spans."""
        longest = max(math.ceil(self.options.ratios(k)[0]) for k in range(len(self.bands)))
        more = longest if longest > 1 else 0
        lines = np.arange(-more, self.options.lines + more, dtype=np.float64)
        return lines * self.options.line_period

    def chunks(self, band: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """Image of one band as (first line, block of lines), top to bottom; again alike at every call."""
        along, across = self.options.ratios(band)
        yield from render_chunks(
            self.cameras[band],
            self.scene,
            band,
            self.shapes[band],
            self.radiometry,
            self._stream("noise", band),
            node_step=1 if len(self.bands[band].true.rough_columns) else NODE_STEP,
            parts=(math.ceil(along), math.ceil(across)),
            stages=self._stages(band),
        )

    def shape_known(self, band: int) -> dict[str, Any]:
        """Bends, or where its CCDs meet, and the size of both."""
        options = self.options
        if options.pieces and options.piece_sigma_px:
            known = {"shape": "pieces", "shape_sigma_px": options.piece_sigma_px}
            return {**known, "pieces": options.pieces_of(band)}
        if options.bend_sigma_px:
            return {"shape": "polynomial", "shape_sigma_px": options.bend_sigma_px}
        return {}

    def _stages(self, band: int) -> list[list[PushbroomCamera]]:
        """Cameras of single stages, side by side those of columns of as many stages; empty without TDI."""
        counts, camera = self.options.column_stages(band), self.cameras[band]
        if counts is None:
            return []
        camera, out = dataclasses.replace(camera, time_reference=self.options.time_reference), []
        for columns in np.split(np.arange(len(counts)), np.flatnonzero(np.diff(counts)) + 1):
            side = []
            for one in single_stages(camera, int(counts[columns[0]])):
                looks = dataclasses.replace(one.detector, directions=one.detector.directions[columns])
                side.append(dataclasses.replace(one, detector=looks))
            out.append(side)
        return out

    def star_tracker(self, rate: float = 8.0, sigma: float = 3.0 * ARC_SECOND) -> Array:
        """Table t, roll, pitch, yaw, sigma of a star tracker on the body, during the strip."""
        span = (0.0, self.options.duration)
        return star_tracker_table(self.body, span, self._stream("star-tracker"), rate=rate, sigma=sigma)

    def gyro(self, rate: float = 100.0, random_walk: float = 2.91e-7) -> Array:
        """Table t_start, t_end, roll, pitch, yaw, sigma of a gyro on the body (1e-3 deg/rt-h by default)."""
        span = (0.0, self.options.duration)
        return gyro_table(self.body, span, self._stream("gyro"), rate=rate, random_walk=random_walk)

    def control_points(self, count: int, sigma: float = 1.0) -> tuple[list[str], Array]:
        """Names of images and table x, y, z, sigma (m), line, column of `count` points on the true ground."""
        relief = self.scene.relief
        ground = Plane(0.0) if relief is None else Dem(relief.heights, relief.transform)
        images, table = control_point_table(
            self.cameras, ground, self._stream("control-points"), count=count, sigma=sigma
        )
        return [self.bands[image].name for image in images], table

    def _stream(self, purpose: str, index: int = 0) -> np.random.SeedSequence:
        return _streams(self.seed)[purpose].spawn(index + 1)[index]


def _streams(seed: int) -> dict[str, np.random.SeedSequence]:
    """The independent random streams of a scenario, by purpose."""
    purposes = ["motion", "detectors", "texture", "relief", "clouds", "noise", "star-tracker", "gyro"]
    purposes += ["control-points"]
    return dict(zip(purposes, np.random.SeedSequence(seed).spawn(len(purposes)), strict=True))


def line_of_sight_case(
    case: str = "nominal",
    seed: int = 0,
    *,
    profile: JitterProfile | None = None,
    data: Path | None = None,
    **overrides: Any,
) -> StripScenario:
    """A pushbroom strip of a named case.

    Parameters
    ----------
    case : str
        "nominal", "relief", "clouds", "hard" (relief, clouds, SNR 40), "real" (ground, relief and motion),
        "other-family" (a measured motion, a chirp and a step) or "pan-xs" (a panchromatic band and three of
        four times its pixels).
    seed : int
        Decides everything that is random.
    profile : JitterProfile, optional
        Motion in place of that of the case.
    data : Path, optional
        Folder of the real data sets, else that of ``measured.data_folder``; read by the cases "real" and
        "other-family", and by what names real data in `overrides`.
    **overrides
        Fields of :class:`~sightline.simulate.strip_options.StripOptions`.

    Returns
    -------
    StripScenario

    Raises
    ------
    InputError
        Unknown case or option.
    FormatError
        Real data needed and not found.

    Examples
    --------
    >>> scenario = line_of_sight_case("nominal", 0, lines=64, columns=64)
    >>> scenario.image(0).shape
    (64, 64)
    """
    options = _options_of(case, overrides)
    streams = _streams(seed)
    motion, body = _draw_motion(options, profile or motion_profile(options.motion, data), streams["motion"])
    return StripScenario(
        case,
        seed,
        options,
        _draw_bands(options, streams["detectors"]),
        _reference(options),
        motion,
        body,
        _draw_scene(options, seed, data),
        Radiometry(snr=options.snr),
    )


def _options_of(case: str, overrides: dict[str, Any]) -> StripOptions:
    return options_of(StripOptions, CASE_OPTIONS, case, overrides)


def planned_cameras(case: str = "nominal", seed: int = 0, **overrides: Any) -> tuple[PushbroomCamera, ...]:
    """The nominal cameras of `line_of_sight_case`, nothing of its scene drawn; parameters as there."""
    options = _options_of(case, overrides)
    bands = _draw_bands(options, _streams(seed)["detectors"])
    return _nominal_cameras(bands, _reference(options), options)


def _nominal_cameras(
    bands: tuple[BandTruth, ...], reference: Trajectory, options: StripOptions
) -> tuple[PushbroomCamera, ...]:
    return tuple(
        PushbroomCamera(
            band.nominal,
            reference,
            FixedMount(),
            options.first_time(k),
            options.shape(k)[0],
            stages=options.column_stages(k),
            time_reference=options.time_reference,
        )
        for k, band in enumerate(bands)
    )


def motion_profile(name: str, data: Path | None = None) -> JitterProfile:
    """The motion of a name; see ``StripOptions`` for the names. `data`: folder of the real curves."""
    tones: tuple[JitterPart, ...] = (
        ToneJitter(0.25, 43.7),
        ToneJitter(0.15, 71.3),
        ToneJitter(0.08, 113.9),
    )
    foreign: tuple[JitterPart, ...] = (ChirpJitter(0.2, 15.0, 105.0), StepJitter(0.5))
    if name == "none":
        return JitterProfile((), (), ())
    if name == "nominal":
        return nominal_profile()
    if name == "late-tone":
        return with_part(nominal_profile(), ToneJitter(0.2, 64.0, since=0.5))
    if name == "step":
        return with_part(nominal_profile(), StepJitter(1.0))
    if name == "ck":
        t, angles = measured.mro_ck_curve(data)
        # the kernel was made from images without observable yaw: pitch played backwards takes its place
        angles[:, 2] = angles[::-1, 1]
        return curve_profile(t, angles, rms_px=1.0, extra=tones)
    if name == "isd":
        path = measured.data_file("linescan_isds/ctx_isd.json", data)
        return curve_profile(*measured.isd_attitude_curve(path), rms_px=0.5, stretch=4.0, extra=tones)
    extras = {"curve": (), "real": tones, "other-family": foreign}
    if name not in extras:
        raise InputError(f"unknown motion: got {name!r}; allowed are {', '.join(MOTIONS)}")
    return curve_profile(*measured.hirise_curve(data), extra=extras[name])


def _margin_lines(options: StripOptions) -> int:
    """Lines by which the motion is known beyond both ends, those of TDI stages included."""
    return MOTION_MARGIN_LINES + max(options.stages, default=0)


def _draw_motion(
    options: StripOptions, profile: JitterProfile, seed: np.random.SeedSequence
) -> tuple[Motion, Motion]:
    margin = _margin_lines(options)
    lines = np.arange(-margin, options.lines + margin, dtype=np.float64)
    return profile.draw(lines * options.line_period, options.rad_per_px, seed)


def _draw_bands(options: StripOptions, seed: np.random.SeedSequence) -> tuple[BandTruth, ...]:
    rng = np.random.default_rng(seed)
    offsets = options.offset_sigma_px * rng.standard_normal((len(options.names), 2))
    rotations = options.rotation_sigma * rng.standard_normal(len(options.names))
    scales = options.scale_sigma * rng.standard_normal(len(options.names))
    scales[0] = 0.0
    departures = [_departures(options, index, rng) for index in range(len(options.names))]
    bands = []
    for index, (name, lag) in enumerate(zip(options.names, options.lags, strict=True)):
        offset = (float(offsets[index, 0]), float(offsets[index, 1]))
        along, across = options.ratios(index)
        rotation, look_ahead = float(rotations[index]), options.look_ahead[index]
        nominal, true = (
            LineDetector.from_ifov(
                name,
                options.shape(index)[1],
                options.ifov * across,
                options.line_period * along,
                look_ahead=look_ahead,
                offset_px=shift,
                rotation=turn,
            )
            for shift, turn in (((0.0, 0.0), 0.0), (offset, rotation))
        )
        scale = float(scales[index])
        if scale:
            true = true.adjusted(scale=scale)
        departure = departures[index]
        if departure is not None:
            true = true.adjusted(*departure.T)
        bands.append(BandTruth(name, lag, look_ahead, offset, rotation, nominal, true, scale, departure))
    return tuple(bands)


def _departures(options: StripOptions, band: int, rng: np.random.Generator) -> Array | None:
    """(columns, 2) px by which the pixels of a band depart from a straight line; None of a straight one.

    Their mean is 0, and a bend does not turn or stretch the line as a whole.
    """
    columns = options.shape(band)[1]
    pieces, bend = options.pieces_of(band), options.bend_sigma_px
    if pieces and options.piece_sigma_px:
        # CCDs of one line do not overlap by a pixel
        steps = np.clip(options.piece_sigma_px * rng.standard_normal((len(pieces), 2)), -0.9, 0.9)
        number = np.searchsorted(pieces, np.arange(columns), side="right")
        out = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[number]
        return np.asarray(out - out.mean(axis=0))
    if not bend:
        return None
    arc, stretch = bend * rng.standard_normal((2, 2))
    u = np.linspace(-1.0, 1.0, columns)[:, None]
    out = np.asarray(arc * (1.5 * u**2 - 0.5) + stretch * (2.5 * u**3 - 1.5 * u))
    if np.diff(out[:, 1]).min() <= -0.9:
        raise InputError(
            f"`bend_sigma_px` = {bend:g} folds the line of band {options.names[band]}, of {columns} columns; "
            "make it smaller, or the line longer"
        )
    return out


def _reference(options: StripOptions) -> Trajectory:
    margin = _margin_lines(options) * options.line_period
    return Trajectory.level_flight(options.altitude, options.ground_speed, -margin, options.duration + margin)


def _ground_extent(options: StripOptions) -> Extent:
    """What the bands see of the plane z = 0, with a margin for offsets, motion and relief."""
    gsd_x, gsd_y = options.gsd
    half = (0.5 * options.columns + GROUND_MARGIN_PX) * gsd_x
    behind = options.ground_speed * max(*options.lags, 0.0) + GROUND_MARGIN_PX * gsd_y
    ahead = options.ground_speed * max(0.0, -min(options.lags)) + (options.lines + GROUND_MARGIN_PX) * gsd_y
    return Extent(-half, half, -behind, ahead)


def ground_cells(options: StripOptions) -> float:
    """About how many numbers the ground of a strip is made of: no side of a texture has above 8192."""
    width, height = _ground_extent(options).size
    cells = min(2.0 * width / options.gsd[0], 8192.0) * min(2.0 * height / options.gsd[1], 8192.0)
    if options.relief == "spectrum":
        width, height = _ground_extent(options).grown(600.0).size
        cells += 4.0 * (width / POSTING) * (height / POSTING)
    return cells


def _stretches(options: StripOptions, lines: tuple[tuple[int, int], ...]) -> tuple[tuple[float, float], ...]:
    """Line intervals of the first band as stretches of y, metres."""
    step = options.gsd[1]
    return tuple((first * step, (first + count) * step) for first, count in lines)


def _draw_scene(options: StripOptions, seed: int, data: Path | None) -> Scene:
    extent, streams = _ground_extent(options), _streams(seed)
    if options.ground == "spectrum":
        law = TextureLaw(options.contrast, options.gsd, options.mtf_nyquist)
        texture, bands = scene_layers(
            streams["texture"], extent, law, options.common_weights, options.gains, options.gammas
        )
    elif options.ground == "landsat":
        bands = _landsat_shine(options, extent, seed, data)
        texture = bands[0].common or raster_layer(np.zeros((4, 4)), options.gsd)
    else:
        raise InputError(f"unknown ground: got {options.ground!r}; allowed are 'spectrum', 'landsat'")
    return Scene(
        texture,
        bands,
        _draw_relief(options, extent, streams["relief"], data),
        _draw_clouds(options, extent, streams["clouds"]),
        _stretches(options, options.blank),
    )


def _landsat_shine(
    options: StripOptions, extent: Extent, seed: int, data: Path | None
) -> tuple[BandShine, ...]:
    """Real bands as grounds: each relative to its own mean, so that the mean digital number is 1200.

    The one scene that there is lies one of eight ways, turned and mirrored, in turn of the seeds: strips that
    saw the same of it would all err alike.
    """
    turns, mirrored = divmod(seed % 8, 2)
    rasters = np.rot90(measured.landsat_bands(data).astype(np.float64), turns, (1, 2))
    rasters = rasters[:, :, ::-1] if mirrored else rasters
    if len(options.names) > rasters.shape[0]:
        raise InputError(
            f"too many bands for the real ground: {len(options.names)}; it has {rasters.shape[0]} bands"
        )
    origin = (extent.west, extent.south)
    return tuple(
        BandShine(None, 1.0, gain, gamma, raster_layer(raster / raster.mean() - 1.0, options.gsd, origin))
        for raster, gain, gamma in zip(rasters, options.gains, options.gammas, strict=False)
    )


def _draw_relief(
    options: StripOptions, extent: Extent, seed: np.random.SeedSequence, data: Path | None
) -> Relief | None:
    around = extent.grown(600.0)
    if options.relief == "none":
        return None
    if options.relief == "spectrum":
        return random_relief(seed, around, options.relief_rms)
    if options.relief == "srtm":
        centre = (0.5 * (around.west + around.east), 0.5 * (around.south + around.north))
        return measured.srtm_relief(centre, around.size, data)
    raise InputError(f"unknown relief: got {options.relief!r}; allowed are 'none', 'spectrum', 'srtm'")


def _draw_clouds(options: StripOptions, extent: Extent, seed: np.random.SeedSequence) -> Clouds | None:
    if options.cloud_cover == 0.0 and not options.cloud_banks:
        return None
    banks = _stretches(options, options.cloud_banks)
    return scattered_clouds(seed, extent, options.cloud_cover, options.gsd, banks=banks)
