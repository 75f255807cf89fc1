"""What a simulated pushbroom strip is made of, and what each named case changes of it.

Strips are drawn from their options in ``scenarios.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.camera import TIME_REFERENCES
from sightline.simulate.option_checks import MOST_COLUMNS, MOST_LINES, check_names, check_options
from sightline.simulate.texture import Array

MOTIONS = ("nominal", "late-tone", "step", "curve", "real", "other-family", "ck", "isd", "none")
RELIEFS = ("none", "spectrum", "srtm")
GROUNDS = ("spectrum", "landsat")


@dataclass(frozen=True)
class StripOptions:
    """What a strip is made of; the defaults are S1's reference scene, case ``nominal``.

    Parameters
    ----------
    lines, columns : int
        Of every band of the finest pixels.
    altitude : float
        m; straight and level over a flat Earth, flying north.
    ground_speed : float
        m/s
    ifov : float
        rad per pixel.
    line_period : float
        s
    names : tuple of str
        Of the bands, and of their images.
    lags : tuple of float
        s after the first band at which a band sees the same ground: ``tan(look_ahead) = -V lag / H``, so
        the first band looks straight down and sees the ground first, the others look behind.
    gains, gammas : tuple of float
        Of the brightness of each band: factor and exponent.
    coherence : float
        Amplitude correlation of the textures of any two bands.
    coherence_with_first : tuple of float
        In its place, that of each band with the first (whose own entry must be 1); empty: `coherence` for
        all. Two later bands then correlate as the product of theirs.
    snr : float
        Mean over noise.
    contrast : float
        Standard deviation over mean of the ground.
    mtf_nyquist : float
        System MTF at half a cycle per pixel.
    offset_sigma_px : float
        px, size of the unknown offsets of the bands (true values are drawn).
    rotation_sigma : float
        rad, size of the unknown rotations of the bands, likewise.
    scale_sigma : float
        Size of the unknown magnifications of the bands beside the first's, relative, likewise.
    bend_sigma_px : float
        px, size of the unknown bends of the bands at the ends of their lines: of the second degree (an arc)
        and of the third, along and across.
    pieces : tuple of int
        First column of every CCD after the first, of all bands, in columns of the finest; empty: one CCD.
    piece_sigma_px : float
        px, size of the unknown steps where they meet, along and across; none is larger than 0.9 px.
    pixel_ratios : tuple of float
        Pixels of each band over `ifov`; empty: 1 for all. `lines` and `columns` count pixels
        of ratio 1; a coarse pixel shows the mean over itself and over its exposure.
    line_ratios : tuple of float
        Line period of each band over `line_period`; empty: as `pixel_ratios`.
    stages : tuple of int
        TDI stages of every band, one number for each equal part of its columns; empty: no TDI. What a stage
        sees is rendered by itself, one line period and one pixel after the stage before.
    time_reference : str
        Which stage looks as the viewing angle says, at the time of the line: "centre" (the middle of all),
        "first-stage" or "last-stage".
    motion : str
        "nominal" (drift, broadband, tones), "late-tone" (with a tone that begins half-way), "step" (with a
        step), "curve" (measured), "other-family" (measured curve, chirp, step), "real" (measured curve, tones
        of 40-120 Hz), "ck" (C kernel of MRO), "isd" (attitudes of a line-scan model), "none". Measured ones
        are read from the folder that SIGHTLINE_DATA names.
    relief : str
        "none", "spectrum" (power law) or "srtm" (real heights, from SIGHTLINE_DATA).
    relief_rms : float
        m, for "spectrum".
    ground : str
        "spectrum" or "landsat" (four real bands, from SIGHTLINE_DATA, mirrored at their edges, one image
        pixel per pixel; seeds show them turned and mirrored in eight ways).
    cloud_cover : float
        Share of the strip under scattered clouds.
    cloud_banks : tuple of (int, int)
        First line (of the first band, nominally) and number of lines wholly under a flat white bank.
    blank : tuple of (int, int)
        First line and number of lines of ground without any texture.
    """

    lines: int = 3000
    columns: int = 1000
    altitude: float = 680e3
    ground_speed: float = 6800.0
    ifov: float = 5e-6
    line_period: float = 5e-4
    names: tuple[str, ...] = ("PAN", "B1", "B0", "B2")
    lags: tuple[float, ...] = (0.0, 0.1500, 0.1574, 0.1722)
    gains: tuple[float, ...] = (1.0, 0.85, 0.9, 0.8)
    gammas: tuple[float, ...] = (1.0, 0.9, 1.0, 0.8)
    coherence: float = 0.97
    coherence_with_first: tuple[float, ...] = ()
    snr: float = 120.0
    contrast: float = 0.2
    mtf_nyquist: float = 0.15
    offset_sigma_px: float = 1.0
    rotation_sigma: float = 3e-4
    scale_sigma: float = 0.0
    bend_sigma_px: float = 0.0
    pieces: tuple[int, ...] = ()
    piece_sigma_px: float = 0.3
    pixel_ratios: tuple[float, ...] = ()
    line_ratios: tuple[float, ...] = ()
    stages: tuple[int, ...] = ()
    time_reference: str = "centre"
    motion: str = "nominal"
    relief: str = "none"
    relief_rms: float = 300.0
    ground: str = "spectrum"
    cloud_cover: float = 0.0
    cloud_banks: tuple[tuple[int, int], ...] = ()
    blank: tuple[tuple[int, int], ...] = ()

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "motion": MOTIONS, "relief": RELIEFS, "ground": GROUNDS, "time_reference": tuple(TIME_REFERENCES),
    }  # fmt: skip
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lines": (16, MOST_LINES), "columns": (16, MOST_COLUMNS), "altitude": (100.0, 1e8),
        "ground_speed": (1.0, 1e5), "ifov": (1e-8, 1e-2), "line_period": (1e-5, 1.0), "lags": (-100.0, 100.0),
        "gains": (0.01, 3.0), "gammas": (0.1, 3.0), "coherence": (0.01, 1.0),
        "coherence_with_first": (0.01, 1.0), "snr": (0.1, 1e5), "contrast": (0.0, 10.0),
        "mtf_nyquist": (1e-3, 0.9), "offset_sigma_px": (0.0, 1e3), "rotation_sigma": (0.0, 0.1),
        "scale_sigma": (0.0, 0.1), "bend_sigma_px": (0.0, 10.0), "pieces": (1, MOST_COLUMNS),
        "piece_sigma_px": (0.0, 0.9), "pixel_ratios": (1.0, 6.0), "line_ratios": (1.0, 6.0),
        "stages": (1, 128),
        "relief_rms": (0.0, 3000.0), "cloud_cover": (0.0, 0.95),
        "cloud_banks": (0, MOST_LINES), "blank": (0, MOST_LINES),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_options(self)
        lengths = {len(self.names), len(self.lags), len(self.gains), len(self.gammas)}
        if len(lengths) != 1 or min(lengths) < 1:
            raise InputError(
                "`names`, `lags`, `gains` and `gammas` must have one entry per band, got lengths "
                f"{len(self.names)}, {len(self.lags)}, {len(self.gains)}, {len(self.gammas)}"
            )
        check_names("names", self.names)
        given = self.coherence_with_first
        if given and (len(given) != len(self.names) or given[0] != 1.0):
            raise InputError(
                "`coherence_with_first` must have one entry per band in (0, 1], 1 for the first; got "
                f"{given} for {len(self.names)} bands"
            )
        if any(b <= a for a, b in pairwise((0, *self.pieces, self.columns))):
            raise InputError(
                f"`pieces` must rise within columns 1 to {self.columns - 1}, where CCDs begin; got "
                f"{', '.join(map(str, self.pieces))}"
            )
        if self.pieces and self.bend_sigma_px:
            raise InputError(
                f"`pieces` and `bend_sigma_px` = {self.bend_sigma_px:g} are both given; a detector is in "
                "pieces or bent: keep one of them"
            )
        for name in ("pixel_ratios", "line_ratios"):
            ratios = getattr(self, name)
            if ratios and len(ratios) != len(self.names):
                raise InputError(
                    f"`{name}` must have one entry per band, or none; got {len(ratios)} for "
                    f"{len(self.names)} bands"
                )
        for name, (lines, columns) in zip(self.names, map(self.shape, range(len(self.names))), strict=True):
            if min(lines, columns) < 16:
                raise InputError(
                    f"band {name} would have {lines} lines and {columns} columns by its ratios: 16 or more "
                    "are needed; make the strip larger or the ratio smaller"
                )

    def ratios(self, band: int) -> tuple[float, float]:
        """Line period and pixel of a band over those of the finest."""
        across = self.pixel_ratios[band] if self.pixel_ratios else 1.0
        return (self.line_ratios[band] if self.line_ratios else across), across

    def shape(self, band: int) -> tuple[int, int]:
        """Lines and columns of a band."""
        along, across = self.ratios(band)
        return int(self.lines / along + 1e-9), int(self.columns / across + 1e-9)

    def column_stages(self, band: int) -> NDArray[np.int16] | None:
        """(columns,) TDI stages of a band; None without TDI."""
        if not self.stages:
            return None
        columns = self.shape(band)[1]
        return np.array(self.stages, dtype=np.int16)[np.arange(columns) * len(self.stages) // columns]

    def tdi_slip(self, band: int) -> float:
        """px by which the ground and the charge move apart over all stages of a band; 0 without TDI."""
        along, across = self.ratios(band)
        return (max(self.stages, default=1) - 1) * (self.gsd[1] * along / (self.gsd[0] * across) - 1.0)

    def first_time(self, band: int) -> float:
        """s, middle of the first exposure of a band: all begin together."""
        return 0.5 * (self.ratios(band)[0] - 1.0) * self.line_period

    def pieces_of(self, band: int) -> tuple[int, ...]:
        """First columns of the CCDs of a band after the first."""
        return tuple(round(column / self.ratios(band)[1]) for column in self.pieces)

    @property
    def common_weights(self) -> tuple[float, ...]:
        """Amplitude of the common ground in the texture of each band."""
        return self.coherence_with_first or (float(np.sqrt(self.coherence)),) * len(self.names)

    @property
    def gsd(self) -> tuple[float, float]:
        """m of one pixel across (x) and along (y) track, at the nadir of the plane z = 0."""
        return self.altitude * self.ifov, self.ground_speed * self.line_period

    @property
    def duration(self) -> float:
        """s from the first line to the last."""
        return (self.lines - 1) * self.line_period

    @property
    def half_field_px(self) -> float:
        """px from the middle of a line to its end: what turns yaw into pixels at the field's edge."""
        return 0.5 * (self.columns - 1)

    @property
    def rad_per_px(self) -> Array:
        """(3,) rad of one pixel of roll, of pitch, and of yaw at the edge of the field."""
        return np.array([self.ifov, self.ifov, 1.0 / self.half_field_px])

    @property
    def look_ahead(self) -> tuple[float, ...]:
        """rad, viewing angle of each band, forward positive."""
        return tuple(-float(np.arctan(self.ground_speed * lag / self.altitude)) + 0.0 for lag in self.lags)


CASE_OPTIONS: dict[str, dict[str, Any]] = {
    "nominal": {},
    "relief": {"relief": "spectrum"},
    "clouds": {"cloud_cover": 0.25, "cloud_banks": ((1400, 100),), "blank": ((600, 60),)},
    "hard": {"relief": "spectrum", "snr": 40.0, "coherence": 0.9, "cloud_cover": 0.15},
    "real": {
        "lines": 2400,
        "columns": 640,
        "relief": "srtm",
        "ground": "landsat",
        "motion": "real",
        "names": ("NIR", "RED", "GREEN", "BLUE"),
        "gains": (1.0, 1.0, 1.0, 1.0),
        "gammas": (1.0, 1.0, 1.0, 1.0),
    },
    "other-family": {"motion": "other-family"},
    "pan-xs": {"pixel_ratios": (1.0, 4.0, 4.0, 4.0)},
}
"""What each case changes."""

CASES = tuple(CASE_OPTIONS)
"""Names of the cases."""
