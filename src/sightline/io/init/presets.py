"""Instruments whose lags and geometry are published, for bands that come without metadata.

A preset is data alone. To add one, put a `Preset` into `PRESETS`; each number needs a published source.

Not here: the acquisition that is made of it (``bands.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sightline.errors import InputError


@dataclass(frozen=True)
class Preset:
    """What is published of a push-broom instrument.

    Attributes
    ----------
    instrument : str
        In words.
    lags : mapping
        Band to the s by which it sees the ground after the first.
    lag_sigma : float
        1-sigma of a lag, relative.
    altitude, ground_speed : float
        m, m/s.
    line_period : float
        s.
    pixel : float
        m on the ground.
    offset_sigma_px, rotation_sigma : float
        How well the place (px) and the direction (rad) of a band in a crop are known.
    sources : tuple of str
        Where each of these numbers comes from.
    wide : mapping
        Bands whose pixels and line periods are so many times `pixel` and `line_period`; 1 of all others.
    signed : bool
        Whether bands are known to see the ground after the first one, and not before it.
    epoch : str
        UTC of line 0 of the first band; empty where it is not known.
    without : str
        Bands of the instrument that it has not, and why.
    """

    instrument: str
    lags: Mapping[str, float]
    lag_sigma: float
    altitude: float
    ground_speed: float
    line_period: float
    pixel: float
    offset_sigma_px: float
    rotation_sigma: float
    sources: tuple[str, ...]
    wide: Mapping[str, int] = field(default_factory=dict)
    signed: bool = False
    epoch: str = ""
    without: str = ""

    def wide_of(self, band: str) -> int:
        """How many times as wide as `pixel` those of a band are."""
        return self.wide.get(band, 1)

    @property
    def ifov(self) -> float:
        """Tangent of the angle of one pixel."""
        return self.pixel / self.altitude


PRESETS = {
    "sentinel-2-msi": Preset(
        instrument="Sentinel-2 MSI, bands of 10 m in sensor geometry (Level-1B)",
        lags={"B02": 0.0, "B08": 0.264, "B03": 0.527, "B04": 1.005},
        # the bound of 2 % taken as that of an even distribution
        lag_sigma=0.02 / 3.0**0.5,
        altitude=786e3,
        ground_speed=10.0 / 1.5e-3,
        line_period=1.5e-3,
        pixel=10.0,
        offset_sigma_px=3.0,
        rotation_sigma=3e-3,
        sources=(
            "lags of the bands, altitude 786 km, pixel 10 m: ESA, Sentinel-2 User Handbook, 2015",
            "true lags depart from these by up to 2 %: Binet, Bergsma and Poulain, ISPRS Annals V-1-2022, 57",
            "line period 1.5 ms, speed 10 m a line: rounded from the 6.64 km/s that a circular orbit of this "
            "altitude has over the ground (Kepler's third law)",
        ),
        without="bands of 20 and 60 m: their lags are not among the sources of this preset",
    ),
    "pleiades": Preset(
        instrument="Pleiades HiRI, panchromatic and four colours in sensor geometry (levels L0, L1A)",
        lags={"PA": 0.0, "B1": 0.1525, "B0": 0.1591, "B3": 0.1657, "B2": 0.1723},
        # 3 ms of all of them
        lag_sigma=0.003 / 0.1625,
        altitude=694e3,
        ground_speed=0.7 / 0.1034e-3,
        line_period=0.1034e-3,
        pixel=0.7,
        offset_sigma_px=3.0,
        rotation_sigma=3e-3,
        sources=(
            "lags and line period: times of the bands' first rows in the metadata of a product of Pleiades "
            "1B (PHRDIMAP, Band_TS_List); whole frames of 6.6 ms that move together by 5 ms from product to "
            "product: 3 ms (1-sigma)",
            "altitude 694 km; pixels of .7 m, of the colours 2.8 m: CNES and Airbus, as eoPortal states them",
        ),
        wide={"B0": 4, "B1": 4, "B2": 4, "B3": 4},
        signed=True,
    ),
}


#: Instruments without a preset, by words of their names, and what would do.
_LACKING = {
    (
        "landsat",
        "oli",
    ): "when each band and module of Landsat's OLI sees the ground in sensor geometry (L0, L1R)",
    ("zy-3", "zy3", "ziyuan"): "times of the lines of ZY-3's cameras and where their detectors look",
    ("aster",): "lags of ASTER's bands in sensor geometry (level 1A)",
}
_HIRISE = "HiRISE needs no preset: give its EDRs, `sightline init CHANNELS... --out DIR`"


def preset(name: str) -> Preset:
    """A preset by its name; InputError lists what there is, and what is lacking of known instruments."""
    asked = name.casefold()
    if "hirise" in asked:
        raise InputError(f"--preset {name!r}: {_HIRISE}")
    for called, what in _LACKING.items():
        if any(word in asked for word in called):
            raise InputError(
                f"--preset {name!r}: no published source was found of {what}; give them yourself: `sightline "
                "init --template strip`, look_ahead and first_line_time of each [[band]]; presets are "
                f"{', '.join(PRESETS)}"
            )
    if name not in PRESETS:
        raise InputError(f"--preset {name!r} is not known; allowed: {', '.join(PRESETS)}")
    return PRESETS[name]
