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
        How well the place (px of size `pixel`) and the direction (rad) of a band in a crop are known.
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
        instrument="Sentinel-2 MSI, bands of the visible and near infrared in sensor geometry (Level-1B)",
        lags={
            **{"B02": 0.0, "B08": 0.264, "B03": 0.527, "B04": 1.005},
            **{"B05": 1.269, "B06": 1.525, "B07": 1.79, "B8A": 2.055, "B01": 2.314, "B09": 2.586},
        },
        # the bound of 2 % taken as that of an even distribution
        lag_sigma=0.02 / 3.0**0.5,
        altitude=786e3,
        ground_speed=10.0 / 1.5e-3,
        line_period=1.5e-3,
        pixel=10.0,
        offset_sigma_px=3.0,
        rotation_sigma=3e-3,
        sources=(
            "lags of bands of 10 m, altitude 786 km, pixel 10 m: ESA, Sentinel-2 User Handbook, 2015; lags "
            "of bands of 20 and 60 m: Heiselberg and Heiselberg, Remote Sensing 13 (2021) 3016, table 1",
            "true lags depart from these by up to 2 %: Binet, Bergsma and Poulain, ISPRS Annals V-1-2022, 57",
            "line period 1.5 ms, speed 10 m a line: rounded from the 6.64 km/s that a circular orbit of this "
            "altitude has over the ground (Kepler's third law)",
        ),
        wide={"B05": 2, "B06": 2, "B07": 2, "B8A": 2, "B01": 6, "B09": 6},
        without="B10, B11, B12: of a focal plane of their own, whose side on each detector no source tells",
    ),
    "zy-3-mux": Preset(
        instrument="ZY-3 (01) MUX, four bands in sensor geometry",
        lags={"B1": 0.0, "B2": 0.1216, "B3": 0.224, "B4": 0.3264},
        lag_sigma=0.01,
        altitude=506e3,
        ground_speed=7.05e3,
        line_period=0.8e-3,
        pixel=5.8,
        offset_sigma_px=3.0,
        rotation_sigma=3e-3,
        sources=(
            "lags of 152, 128 and 128 lines, 121.6, 102.4 and 102.4 ms from band to band, and by them the "
            "line period: Ye and others, ISPRS Annals II-3/W4 (2015) 279, after Pan and others (2013)",
            "altitude 506 km, pixels of 5.8 m: eoPortal, ZY-3A; speed over the ground 7.05 km/s: that of a "
            "circular orbit of this altitude (Kepler's third law)",
            "how well these lags hold is not published: 1 % (1-sigma), as those of Sentinel-2 change with "
            "altitude and optics",
        ),
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
    (
        "aster",
    ): "lags of ASTER's bands in sensor geometry (level 1A): of its SWIR the interval of neighbours is "
    "published, 356.238 ms (Teshima and Iwasaki, IEEE TGRS 46 (2008) 222), not their order",
    ("prism", "alos"): "which lines of PRISM's detectors see the ground when",
    ("planet", "dove", "skysat"): "lags of Planet's bands, which differ from satellite to satellite",
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
