"""What a simulated pass of synchronous cameras is made of, and what each named case changes of it.

Passes are drawn from their options in ``stereo.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sightline.errors import InputError
from sightline.geometry.units import ARCSEC
from sightline.simulate.option_checks import MOST_SEED, check_options

RELIEFS = ("none", "smooth", "white", "spectrum", "dem")
JITTERS = ("white", "harmonic")
KNOWLEDGE = ("independent", "from-position")
EARTHS = ("sphere", "wgs84")
SIGNS = ("s2", "random")


@dataclass(frozen=True)
class StereoOptions:
    """What a pass is made of; the defaults are the reference scene of S2's table 6.

    Parameters
    ----------
    altitude : float
        m above the equatorial radius.
    inclination : float
        rad, of the orbit.
    latitude, longitude : float
        rad, of the place that an undisplaced spacecraft passes at the middle of the pass.
    separation : float
        s between the first and the last spacecraft.
    cameras : int
        Two or more.
    leader : int
        Which camera flies ahead: 1, or the last.
    node_offset, inclination_offset : float
        rad, between the orbits of the last and the first spacecraft; 0: one orbit.
    cross_track : float
        m, of the aim point to the left of the track.
    window : float
        s, over which the shots are spread.
    shots : int
        Of each camera.
    offset : float
        s, of the window's middle after the middle of the pass.
    earth : str
        "sphere" (S2's, 6371 km) or "wgs84".
    fov : float
        rad, across the columns.
    columns, lines : int
        Of a frame; 0 lines: as many as columns.
    focal_error : float
        Relative: the true focal length is so much longer than the one given; not 0: it is to be estimated.
    points : int
        On the ground, spread evenly at random.
    scene_size : float
        m, side of the square they lie on, sides east and north.
    relief : str
        "none", "smooth" (8 sinusoids of 4-12 km, mid-range zero), "white" (every point's height drawn by
        itself), "spectrum" (power law), "dem" (real heights).
    relief_range : float
        m, from the lowest to the highest ground of the scene; real heights keep their own.
    dem_file : str
        Of "dem": a raster whose middle is laid under the aim point; empty: Mont Ventoux, SRTM, from
        SIGHTLINE_DATA.
    ground_size : float
        m, side of the square on which the ground is known; 0: half as much again as the scene.
    dem_sigma : float
        m; above 0 the points stand so far from the DEM, which is then given with this sigma.
    sigma_px : float
        px per coordinate of a match: the noise that is given, and drawn.
    sigma_position : float
        m per axis, likewise.
    sigma_attitude : float
        rad per axis from shot to shot, likewise.
    noise_scale : float
        How much larger the noise drawn is than the noise given; 0: none.
    attitude_knowledge : str
        "independent": attitudes given are those planned from true positions. "from-position": they are
        rebuilt from the noisy positions.
    jitter : str
        "white", or "harmonic": a mirror that swings with the same rms, about each axis with its own phase.
    jitter_frequency : float
        Hz, of harmonic jitter.
    jitter_shared : bool
        Whether the mirrors of all cameras swing together.
    error : float
        rad, size of the constant errors of every camera about each axis.
    signs : str
        "s2": (+, -, +) for odd cameras and (-, +, +) for even ones, of S2's angles; "random": by the seed.
    angles : tuple of (float, float, float)
        rad, S2's angles of each camera in place of those two.
    drift : float
        rad/s by which every angle changes, signs by the seed; zero at the middle of the window.
    mismatch_share : float
        Share of the matches that are wrong in one of their images, by 2-50 px.
    match_share : float
        Share of the points that are found in a shot.
    track_shots : (int, int)
        Fewest and most shots in a row over which a point is tracked; [0, 0]: all.
    missing_images : float
        Share of the images that were never taken.
    unpaired : bool
        Sightings of a point by one camera alone are given too, and missed one by one.
    scene_seed : int
        Of ground, points and signs; below 0: as the rest.
    """

    altitude: float = 500e3
    inclination: float = float(np.radians(97.4))
    latitude: float = float(np.radians(55.0))
    longitude: float = 0.0
    separation: float = 70.0
    cameras: int = 2
    leader: int = 1
    node_offset: float = 0.0
    inclination_offset: float = 0.0
    cross_track: float = 0.0
    window: float = 64.0
    shots: int = 64
    offset: float = 0.0
    earth: str = "sphere"
    fov: float = float(np.radians(1.5))
    columns: int = 700
    lines: int = 0
    focal_error: float = 0.0
    points: int = 300
    scene_size: float = 11e3
    relief: str = "smooth"
    relief_range: float = 400.0
    dem_file: str = ""
    ground_size: float = 0.0
    dem_sigma: float = 0.0
    sigma_px: float = 0.1
    sigma_position: float = 7.5
    sigma_attitude: float = 1.8 * ARCSEC
    noise_scale: float = 1.0
    attitude_knowledge: str = "independent"
    jitter: str = "white"
    jitter_frequency: float = 0.11
    jitter_shared: bool = False
    error: float = 36.0 * ARCSEC
    signs: str = "s2"
    angles: tuple[tuple[float, float, float], ...] = ()
    drift: float = 0.0
    mismatch_share: float = 0.0
    match_share: float = 1.0
    track_shots: tuple[int, int] = (0, 0)
    missing_images: float = 0.0
    unpaired: bool = False
    scene_seed: int = -1

    WORDS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "relief": RELIEFS, "jitter": JITTERS, "attitude_knowledge": KNOWLEDGE, "earth": EARTHS,
        "signs": SIGNS,
    }  # fmt: skip
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "altitude": (1e3, 1e9), "inclination": (0.0, np.pi), "latitude": (-0.5 * np.pi, 0.5 * np.pi),
        "longitude": (-2.0 * np.pi, 2.0 * np.pi), "separation": (0.0, 1e5), "cameras": (2, 1000),
        "leader": (1, 1000), "node_offset": (-np.pi, np.pi), "inclination_offset": (-np.pi, np.pi),
        "cross_track": (-1e7, 1e7), "window": (0.0, 1e5), "shots": (1, 100_000), "offset": (-1e5, 1e5),
        "fov": (1e-7, 2.0943), "columns": (16, 40_000), "lines": (0, 40_000), "focal_error": (-0.49, 0.49),
        "points": (1, 1_000_000), "scene_size": (1.0, 1e6), "relief_range": (0.0, 1e5),
        "ground_size": (0.0, 5e5), "dem_sigma": (0.0, 1e4), "sigma_px": (1e-6, 100.0),
        "sigma_position": (0.0, 1e6), "sigma_attitude": (0.0, 0.05), "noise_scale": (0.0, 100.0),
        "jitter_frequency": (1e-6, 1e4), "error": (-0.1, 0.1), "angles": (-0.1, 0.1), "drift": (-0.01, 0.01),
        "mismatch_share": (0.0, 0.9), "match_share": (1e-6, 1.0), "track_shots": (0, 100_000),
        "missing_images": (0.0, 0.9), "scene_seed": (-1, MOST_SEED),
    }  # fmt: skip

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn; the orbit is checked where it is made."""
        check_options(self)
        if 0 < self.lines < 16:
            raise InputError(f"`lines` must be 16 or more, or 0 for as many as columns, got {self.lines}")
        self._check_sharing()

    def _check_sharing(self) -> None:
        fewest, most_shots = self.track_shots
        if not (fewest == most_shots == 0 or 1 <= fewest <= most_shots <= self.shots):
            raise InputError(
                f"`track_shots` must be (fewest, most) from 1 to the {self.shots} shots, or (0, 0) for all, "
                f"got {self.track_shots}"
            )
        if self.angles and (len(self.angles) != self.cameras or any(len(w) != 3 for w in self.angles)):
            raise InputError(
                f"`angles` must be roll, pitch, yaw of each of {self.cameras} cameras, got {self.angles}"
            )
        if self.attitude_knowledge == "from-position" and self.cameras != 2:
            raise InputError('attitude_knowledge "from-position" is for two cameras')
        if self.attitude_knowledge == "from-position" and self.missing_images > 0.0:
            raise InputError('attitude_knowledge "from-position" needs both cameras in every shot')
        if self.dem_file and self.relief != "dem":
            raise InputError(f'`dem_file` is for relief "dem", got {self.relief!r}')
        if self.dem_sigma > 0.0 and self.relief == "white":
            raise InputError('relief "white" has no DEM to give; choose another relief or dem_sigma 0')

    @property
    def frame(self) -> tuple[int, int]:
        """(lines, columns) of a frame."""
        return self.lines or self.columns, self.columns

    @property
    def focal_length_px(self) -> float:
        """As given."""
        return 0.5 * self.columns / float(np.tan(0.5 * self.fov))

    @property
    def by_sighting(self) -> bool:
        """Whether sightings are listed one by one: more than two cameras, or some alone in their shot."""
        return self.cameras > 2 or self.unpaired


# One scene and one set of constant errors, whatever the seed of the noise.
_FIXED: dict[str, Any] = {"scene_seed": 0}

CASE_OPTIONS: dict[str, dict[str, Any]] = {
    "A_paper_T6_K64": _FIXED,
    "B_paper_T7_K64": {**_FIXED, "sigma_px": 0.3},
    "C_paper_T8_K64_128s": {**_FIXED, "sigma_px": 0.3, "window": 128.0},
    "D_paper_T6_K128": {**_FIXED, "shots": 128, "points": 200},
    "E_modern_4k_sep40": {
        **_FIXED,
        "columns": 4000,
        "separation": 40.0,
        "points": 200,
        "sigma_px": 0.2,
    },
    "F_oblique_cross120_off20": {
        **_FIXED,
        "cross_track": 120e3,
        "offset": 20.0,
        "points": 200,
        "sigma_px": 0.3,
    },
    "G_good_orbit_K32": {
        **_FIXED,
        "shots": 32,
        "sigma_px": 0.05,
        "sigma_position": 1.0,
        "sigma_attitude": 0.3 * ARCSEC,
    },
    "H_equator_iss_sep90": {
        **_FIXED,
        "inclination": float(np.radians(51.6)),
        "latitude": 0.0,
        "separation": 90.0,
        "points": 100,
        "sigma_px": 0.3,
        "sigma_position": 5.0,
        "sigma_attitude": 1.2 * ARCSEC,
    },
    "A_random_relief_400": {"signs": "random"},
    "A_drift": {**_FIXED, "drift": 0.05 * ARCSEC},
    "A_three_cameras": {**_FIXED, "cameras": 3},
}
"""What each case changes: the first eight of kinds A to H, then the first of them with relief and errors
drawn by the seed, with a drift of the errors, and with a third camera between the two."""
