"""Instruments whose lags and geometry are published, for bands that come without metadata.

A preset is data alone. To add one, put a `Preset` into `PRESETS`; each number needs a published source.

Not here: the acquisition that is made of it (``bands.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sightline.errors import InputError


@dataclass(frozen=True)
class Preset:
    """What is published of a push-broom instrument whose bands have pixels alike.

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
    ),
}


def preset(name: str) -> Preset:
    """A preset by its name; InputError lists what there is."""
    if name not in PRESETS:
        raise InputError(f"--preset {name!r} is not known; allowed: {', '.join(PRESETS)}")
    return PRESETS[name]
