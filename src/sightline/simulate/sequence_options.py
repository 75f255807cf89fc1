"""What a simulated flight of a filter camera is made of, and what each named case changes of it.

Flights are drawn from their options in ``sequence.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sightline.errors import InputError
from sightline.simulate.option_checks import check_options

FILTERS = ("lvf", "stepwise", "mosaic", "rgb", "pan")
SPECTRA = ("auto", "law", "rededge", "landsat")
TEXTURES = ("spectrum", "rededge", "landsat")
ANCHOR_STRIDE = 20
"""Frames between two anchors at 80 % overlap, when a step is 1 % of the frame."""

REFERENCE_RATE = 25.0
"""Frames per second at which the frequencies of the jitter are those given."""

#: px; sides of frames: aerial cameras have 20,000.
MOST_PIXELS = 40_000


@dataclass(frozen=True)
class SequenceOptions:
    """What a flight is made of; the defaults are the reference simulation of frame sequences.

    Parameters
    ----------
    frames : int
        Of every flight line.
    shape : (int, int)
        px, lines and columns of a frame; lines run forward.
    focal_length_px : float
        px
    principal_point_px : (float, float) or None
        px, line and column; left out: the middle of the frame.
    distortion : tuple of float
        k1, k2, p1, p2, k3 in normalised coordinates.
    focal_error : float
        Relative: the true focal length is so much longer than the one given; not 0: given with that 1-sigma.
    altitude : float
        m above the mean ground; with the focal length it gives the size of a ground pixel.
    frame_rate : float
        Hz
    overlap : float
        Of successive frames, 0-1; with the frame rate it gives the speed.
    flight_lines : int
        Parallel lines, flown to and fro from west to east; frames are taken on the lines, not in the turns.
    cross_lines : int
        Lines flown afterwards across the others, evenly over their length.
    side_overlap : float
        Of neighbouring flight lines, 0-1.
    readout_time : float
        s from the exposure of line 0 to that of the last line; 0: all lines at once.
    filter : str
        "lvf" (linear variable: the wavelength runs along the lines), "stepwise" (groups of lines of one
        wavelength), "mosaic" (a small pattern repeated over the frame), "rgb" (three images at once), "pan".
    wavelengths_nm : (float, float)
        nm, of the first and the last line (or cell of the pattern).
    fwhm_nm : float
        nm, width of the Gaussian pass-band of a filter; of "rgb" 80, whatever is given.
    bands : int
        "stepwise": groups of lines. "lvf": groups of lines of which one wavelength is given each; 0: one of
        every line.
    pattern : int
        "mosaic": side of the pattern, px.
    jitter : float
        rad, rms about each axis of what linear interpolation between true attitudes 20 frames apart
        leaves.
    position_jitter : float
        m rms along each axis, below 0.4 Hz at 25 frames/s.
    position_sigma, position_bias_sigma : float
        m per axis, of the noise of every position given, and of a constant common to all; sigma 0: none
        given.
    attitude_sigma, attitude_bias_sigma : float
        rad per body axis, of the noise of every attitude given, and of a constant common to all; sigma 0:
        none given.
    relief : float
        Half the range of heights over the altitude.
    relief_scale : float
        Period, in altitudes, beyond which the spectrum of the relief stops growing.
    spectra : str
        Of the ground: "law" (built in), "rededge" or "landsat" (measured from real bands), "auto" (those of
        the real scene that `texture` names, else law).
    texture : str
        "spectrum" (drawn from a power law), or what a real scene of those names shows.
    contrast : float
        Of the brightness common to all wavelengths, standard deviation over mean ("spectrum").
    mtf_nyquist : float
        System MTF at half a cycle per pixel ("spectrum"; a real scene has its own).
    snr : float
        Mean over noise, of the mean ground.
    bits : int
        Of the converter: up to 8 are written in 8, more in 16.
    water : tuple of (int, int)
        Frames of the first flight line that see nothing but water, as [[20, 40]] or ["20-40"].
    missing : tuple of int
        Frames that were never delivered, as [3, "20-40"].
    unreadable : tuple of int
        Frames whose files are cut short, likewise.
    blurred : tuple of int
        Frames that are out of focus, likewise.
    blur_px : float
        px, sigma of their blur.
    cameras : int
        Of a rig, exposed together, each with one band, evenly over `wavelengths_nm`, and its own lens; 1: one
        camera with `filter`.
    rig_angle_sigma : float
        rad per axis; cameras are turned by so much against the first, which the file gives as this sigma.
    rig_place_sigma : float
        m per axis; their lenses lie so far off where the file gives them, with this sigma.
    rig_spacing : float
        m from lens to lens, in two rows.
    rig_lens_spread : float
        Relative; focal lengths differ by about so much, and are given exactly.
    rig_missing : tuple of (int, int)
        Captures and cameras, from 0, whose image was never delivered, as [[3, 1]].
    rig_overexposed : tuple of (int, int)
        Those whose image is saturated, likewise.
    """

    frames: int = 640
    shape: tuple[int, int] = (512, 640)
    focal_length_px: float = 800.0
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()
    focal_error: float = 0.0
    altitude: float = 80.0
    frame_rate: float = REFERENCE_RATE
    overlap: float = 0.99
    flight_lines: int = 1
    cross_lines: int = 0
    side_overlap: float = 0.4
    readout_time: float = 0.0
    filter: str = "lvf"
    wavelengths_nm: tuple[float, float] = (450.0, 900.0)
    fwhm_nm: float = 10.0
    bands: int = 0
    pattern: int = 4
    jitter: float = float(np.radians(0.335))
    position_jitter: float = 0.2
    position_sigma: float = 1.0
    position_bias_sigma: float = 2.0
    attitude_sigma: float = float(np.radians(0.5))
    attitude_bias_sigma: float = float(np.radians(1.0))
    relief: float = 0.03
    relief_scale: float = 0.75
    spectra: str = "auto"
    texture: str = "spectrum"
    contrast: float = 0.2
    mtf_nyquist: float = 0.15
    snr: float = 80.0
    bits: int = 12
    water: tuple[tuple[int, int], ...] = ()
    missing: tuple[int, ...] = ()
    unreadable: tuple[int, ...] = ()
    blurred: tuple[int, ...] = ()
    blur_px: float = 4.0
    cameras: int = 1
    rig_angle_sigma: float = float(np.radians(1.0))
    rig_place_sigma: float = 0.005
    rig_spacing: float = 0.04
    rig_lens_spread: float = 0.005
    rig_missing: tuple[tuple[int, int], ...] = ()
    rig_overexposed: tuple[tuple[int, int], ...] = ()

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "filter": FILTERS, "spectra": SPECTRA, "texture": TEXTURES,
    }  # fmt: skip
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "frames": (2, 1_000_000), "shape": (16, MOST_PIXELS), "focal_length_px": (10.0, 1e7),
        "principal_point_px": (-1e6, 1e6), "distortion": (-100.0, 100.0), "focal_error": (-0.49, 0.49),
        "altitude": (1.0, 1e7), "frame_rate": (1e-4, 1e5), "overlap": (0.0, 0.999),
        "flight_lines": (1, 1000), "cross_lines": (0, 1000), "side_overlap": (0.0, 0.95),
        "readout_time": (-1e4, 1e4), "wavelengths_nm": (400.0, 1000.0), "fwhm_nm": (0.1, 500.0),
        "bands": (0, MOST_PIXELS), "pattern": (2, 8), "jitter": (0.0, 0.02), "position_jitter": (0.0, 1e4),
        "position_sigma": (0.0, 1e5), "position_bias_sigma": (0.0, 1e5), "attitude_sigma": (0.0, 0.5),
        "attitude_bias_sigma": (0.0, 0.5), "relief": (0.0, 0.2), "relief_scale": (1e-3, 100.0),
        "contrast": (0.0, 10.0), "mtf_nyquist": (1e-3, 0.9), "snr": (0.1, 1e5), "bits": (4, 16),
        "water": (0, 1_000_000), "missing": (0, 1_000_000_000), "unreadable": (0, 1_000_000_000),
        "blurred": (0, 1_000_000_000), "blur_px": (0.0, 50.0), "cameras": (1, 20),
        "rig_angle_sigma": (0.0, 0.2), "rig_place_sigma": (0.0, 10.0), "rig_spacing": (0.0, 100.0),
        "rig_lens_spread": (0.0, 0.2), "rig_missing": (0, 1_000_000), "rig_overexposed": (0, 1_000_000),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        check_options(self)
        if not abs(self.readout_time) < 1.0 / self.frame_rate:
            raise InputError(
                f"`readout_time` must be shorter than the {1.0 / self.frame_rate:g} s between frames, "
                f"got {self.readout_time}"
            )
        self._check_filter()
        self._check_frames()
        self._check_rig()

    def _check_rig(self) -> None:
        for name in ("rig_missing", "rig_overexposed"):
            for frame, camera in getattr(self, name):
                if not (0 <= frame < self.total_frames and 0 <= camera < self.cameras):
                    raise InputError(
                        f"`{name}` names capture {frame} of camera {camera}; there are 0 to "
                        f"{self.total_frames - 1} of cameras 0 to {self.cameras - 1}"
                    )
        if self.cameras > 1 and (self.filter != "pan" or self.readout_time):
            raise InputError(
                f"the {self.cameras} cameras of a rig have a band each and expose all lines at once: "
                f'`filter` must be "pan" and `readout_time` 0, got {self.filter!r} and {self.readout_time}'
            )

    def _check_filter(self) -> None:
        low, high = self.wavelengths_nm
        if not low < high:
            raise InputError(f"`wavelengths_nm` must rise, got {low:g} to {high:g}")
        fewest = 2 if self.filter == "stepwise" else 0
        if not fewest <= self.bands <= self.shape[0]:
            raise InputError(
                f"`bands` must be from {fewest} to the {self.shape[0]} lines of a frame, got {self.bands}"
            )

    def _check_frames(self) -> None:
        for name in ("missing", "unreadable", "blurred"):
            wrong = [frame for frame in getattr(self, name) if not 0 <= frame < self.total_frames]
            if wrong:
                raise InputError(f"`{name}` names frame {wrong[0]}; there are 0 to {self.total_frames - 1}")
        if self.total_frames - len(set(self.missing)) < 2:
            raise InputError("`missing` leaves fewer than two frames")
        for first, last in self.water:
            if not 0 <= first <= last < self.frames:
                raise InputError(f"`water` must be frames from 0 to {self.frames - 1}, got {first} to {last}")

    @property
    def total_frames(self) -> int:
        """Frames of all flight lines."""
        return self.frames * (self.flight_lines + self.cross_lines)

    @property
    def gsd(self) -> float:
        """m of one pixel at the nadir of the mean ground."""
        return self.altitude / self.focal_length_px

    @property
    def given_focal_length_px(self) -> float:
        """Focal length that a user is given."""
        return self.focal_length_px / (1.0 + self.focal_error)

    @property
    def step(self) -> float:
        """m flown from frame to frame."""
        return (1.0 - self.overlap) * self.shape[0] * self.gsd

    @property
    def speed(self) -> float:
        """m/s"""
        return self.step * self.frame_rate

    @property
    def spacing(self) -> float:
        """m between neighbouring flight lines."""
        return (1.0 - self.side_overlap) * self.shape[1] * self.gsd

    @property
    def centre_px(self) -> tuple[float, float]:
        """The principal point, (line, column)."""
        middle = (0.5 * (self.shape[0] - 1), 0.5 * (self.shape[1] - 1))
        return self.principal_point_px or middle


_SMALL: dict[str, Any] = {"shape": (160, 200), "focal_length_px": 250.0, "bits": 8}

#: What each case changes of the defaults. Angles of the last two are 4.7 px of jitter, as of the first.
CASE_OPTIONS: dict[str, dict[str, Any]] = {
    "lvf": {},
    "stepwise": {"filter": "stepwise", "bands": 32},
    "mosaic": {"filter": "mosaic"},
    "rgb": {"filter": "rgb", "bits": 8},
    "pan": {"filter": "pan"},
    "small": {**_SMALL, "frames": 60, "overlap": 0.98},
    "cube-60": {"shape": (480, 320), "focal_length_px": 750.0, "frames": 200, "bands": 60},
    "two-lines": {
        "shape": (320, 400), "focal_length_px": 500.0, "frames": 200, "flight_lines": 2,
        "readout_time": 0.02,
    },
    "long": {**_SMALL, "frames": 10000},
    "rig": {
        "shape": (240, 320), "focal_length_px": 360.0, "frames": 40, "overlap": 0.75, "frame_rate": 1.0,
        "filter": "pan", "cameras": 5, "wavelengths_nm": (475.0, 840.0), "jitter": float(np.radians(0.5)),
        "bits": 12,
    },
    "aircraft": {
        "altitude": 1500.0, "frame_rate": 6.25, "position_jitter": 3.0, "position_sigma": 2.0,
        "position_bias_sigma": 3.0,
    },
    "cubesat": {
        "altitude": 500e3, "focal_length_px": 50e3, "frame_rate": 137.0, "relief": 1e-3,
        "relief_scale": 0.02, "jitter": 9.4e-5, "position_jitter": 0.0, "position_sigma": 10.0,
        "position_bias_sigma": 20.0, "attitude_sigma": 2e-4, "attitude_bias_sigma": 1e-3,
    },
}  # fmt: skip
